//! All charts on one sheet.

use super::charts::charts;
use super::flat::FlatChart;
use super::options::TextureOptions;
use crate::raster::covered;
use glam::DVec2;
use scene::geometry::Mesh;

/// Texels left free around a chart, so that neighbours do not shine through when the texture is
/// shrunk. Source: docs/decisions/16.
const GUTTER: f64 = 2.0;

/// Charts laid side by side.
#[derive(Clone, Debug)]
pub(super) struct Atlas {
    /// Width and height, texels.
    pub(super) size: [u32; 2],
    /// Which charts' triangles lie where, texels.
    pub(super) placed: Vec<PlacedTriangle>,
    /// How many charts there are.
    pub(super) charts: u32,
}

/// A triangle on the sheet.
#[derive(Clone, Debug)]
pub(super) struct PlacedTriangle {
    /// Its place in the mesh.
    pub(super) triangle: u32,
    /// Its chart.
    pub(super) chart: u32,
    /// Its corners, texels from the upper left corner of the sheet, y down.
    pub(super) corners: [DVec2; 3],
}

/// A texel and the point of the surface it shows.
#[derive(Clone, Copy, Debug)]
pub(super) struct Texel {
    /// Place in the sheet, row by row.
    pub(super) at: u32,
    /// The triangle of the mesh.
    pub(super) triangle: u32,
    /// Weights of its corners.
    pub(super) weights: [f32; 3],
}

impl Atlas {
    /// With texels of this side (scene units), or larger ones where the sheet would be wider or
    /// higher than asked.
    pub(super) fn new(mesh: &Mesh, mut texel: f64, options: &TextureOptions) -> Self {
        loop {
            let charts = charts(mesh, texel);
            let mut atlas = Self::pack(charts, texel);
            let most = f64::from(options.most_texels);
            let side = f64::from(atlas.size[0].max(atlas.size[1]));
            if side <= most || mesh.triangles.is_empty() {
                return atlas;
            }
            // Gutters do not shrink with the charts: a sheet of nothing else has to do.
            if texel > mesh.size() {
                atlas.placed.clear();
                return atlas;
            }
            texel *= (side / most).clamp(1.02, 4.0);
        }
    }

    /// Charts by their height in rows, about as wide as all are high (next fit by decreasing
    /// height: Coffman et al., SIAM J. Comput. 1980).
    fn pack(charts: Vec<FlatChart>, texel: f64) -> Self {
        let sizes: Vec<DVec2> = charts.iter().map(|c| (c.size / texel).ceil() + 2.0 * GUTTER).collect();
        let area: f64 = sizes.iter().map(|s| s.x * s.y).sum();
        let widest = sizes.iter().map(|s| s.x).fold(0.0, f64::max);
        // Sides are powers of two, as the oldest graphics interfaces want them.
        let width = f64::from((area.sqrt().max(widest).max(1.0).ceil() as u32).next_power_of_two());
        let mut order: Vec<usize> = (0..charts.len()).collect();
        order.sort_by(|&a, &b| sizes[b].y.total_cmp(&sizes[a].y).then(a.cmp(&b)));
        let (mut at, mut row) = (DVec2::ZERO, 0.0);
        let mut placed = Vec::new();
        for (chart, i) in (0..).zip(order) {
            if at.x + sizes[i].x > width {
                at = DVec2::new(0.0, at.y + row);
                row = 0.0;
            }
            row = f64::max(row, sizes[i].y);
            let corner = at + GUTTER;
            placed.extend(charts[i].triangles.iter().zip(&charts[i].corners).map(|(&triangle, corners)| {
                PlacedTriangle { triangle, chart, corners: corners.map(|p| corner + p / texel) }
            }));
            at.x += sizes[i].x;
        }
        let size = [width as u32, ((at.y + row) as u32).next_power_of_two()];
        Self { size, placed, charts: charts.len() as u32 }
    }

    /// The texels whose middles lie in a triangle, each once; a chart without any gets one.
    pub(super) fn texels(&self) -> Vec<Texel> {
        let [width, height] = self.size.map(i64::from);
        let mut taken = vec![false; (width * height) as usize];
        let mut texels = Vec::new();
        let mut seen = vec![false; self.charts as usize];
        for p in &self.placed {
            covered(p.corners, |[x, y], weights| {
                if (0..width).contains(&x) && (0..height).contains(&y) {
                    let at = (y * width + x) as usize;
                    if !std::mem::replace(&mut taken[at], true) {
                        seen[p.chart as usize] = true;
                        let weights = weights.map(|w| w as f32);
                        texels.push(Texel { at: at as u32, triangle: p.triangle, weights });
                    }
                }
            });
        }
        for p in &self.placed {
            if !std::mem::replace(&mut seen[p.chart as usize], true) {
                let middle = p.corners.iter().sum::<DVec2>() / 3.0;
                let at = middle.y as u32 * self.size[0] + middle.x as u32;
                if let Some(free) = taken.get_mut(at as usize).filter(|t| !**t) {
                    *free = true;
                    texels.push(Texel { at, triangle: p.triangle, weights: [1.0 / 3.0; 3] });
                }
            }
        }
        texels
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{box_mesh, cylinder, sphere};
    use glam::DVec3;

    /// Checks that every triangle is there once, whole, on the sheet and without mirror, that no
    /// texel is of two charts, and returns how many charts there are.
    fn check(mesh: &Mesh, texel: f64, most: u32) -> u32 {
        let atlas =
            Atlas::new(mesh, texel, &TextureOptions { most_texels: most, ..TextureOptions::default() });
        let mut count = vec![0; mesh.triangles.len()];
        let mut chart_of = std::collections::HashMap::new();
        assert!(atlas.size[0] <= most && atlas.size[1] <= most, "{:?}", atlas.size);
        let mut stretch = vec![];
        for p in &atlas.placed {
            count[p.triangle as usize] += 1;
            let [a, b, c] = p.corners;
            for corner in p.corners {
                assert!(corner.min_element() >= GUTTER - 1e-6);
                assert!(corner.x <= f64::from(atlas.size[0]) - GUTTER + 1e-6);
                assert!(corner.y <= f64::from(atlas.size[1]) - GUTTER + 1e-6);
            }
            let [x, y, z] = mesh.corners(p.triangle as usize);
            let area = (y - x).cross(z - x).length() / texel.powi(2);
            let flat = (b - a).perp_dot(c - a);
            assert!(flat > 0.0, "a triangle is mirrored: {flat} of {area}");
            stretch.push(flat / area);
            covered(p.corners, |at, weights| {
                if weights.iter().all(|w| *w > 1e-6) {
                    let other = *chart_of.entry(at).or_insert((p.chart, p.triangle));
                    assert_eq!(other, (p.chart, p.triangle), "texel {at:?} is of two triangles");
                }
            });
            // The gutter keeps charts apart when neighbours are mixed.
            covered(p.corners, |[x, y], _| {
                for (dx, dy) in [(-1, 0), (1, 0), (0, -1), (0, 1)] {
                    let near = chart_of.get(&[x + dx, y + dy]);
                    assert!(near.is_none_or(|(chart, _)| *chart == p.chart), "charts touch");
                }
            });
        }
        assert!(count.iter().all(|n| *n == 1), "each triangle is on the sheet once");
        let (low, high) = stretch.iter().fold((f64::INFINITY, 0.0_f64), |(l, h), s| (l.min(*s), h.max(*s)));
        assert!(high / low < 1.0 / 75.0_f64.to_radians().cos() + 1e-6, "stretched {low} to {high}");
        let texels = atlas.texels();
        let mut places: Vec<u32> = texels.iter().map(|t| t.at).collect();
        places.sort_unstable();
        places.dedup();
        assert_eq!(places.len(), texels.len(), "each texel once");
        atlas.charts
    }

    #[test]
    fn a_box_has_six_charts_and_none_overlap() {
        assert_eq!(check(&box_mesh(DVec3::new(1.0, 0.7, 0.4), 8), 0.01, 4096), 6);
        assert_eq!(check(&box_mesh(DVec3::splat(1e-6), 3), 1e-8, 4096), 6);
        assert_eq!(check(&box_mesh(DVec3::splat(1e6), 3), 1e4, 4096), 6);
    }

    #[test]
    fn round_and_folded_surfaces_do_not_overlap_either() {
        assert!(check(&cylinder(0.3, 1.0, 40), 0.01, 4096) < 20);
        assert!(check(&sphere(1.0, 30), 0.02, 4096) < 40);
        // A ramp that winds up four times faces up everywhere, and lies over itself.
        let mut ramp = Mesh::default();
        for i in 0..=128 {
            let (sin, cos) = (f64::from(i) * std::f64::consts::TAU / 32.0).sin_cos();
            for r in [0.5, 1.0] {
                ramp.vertices.push(DVec3::new(r * cos, r * sin, 0.01 * f64::from(i)));
            }
        }
        for i in 0..128 {
            let v = 2 * i;
            ramp.triangles.extend([[v, v + 1, v + 3], [v, v + 3, v + 2]]);
        }
        assert!(check(&ramp, 0.01, 4096) >= 4);
    }

    #[test]
    fn a_sheet_that_would_be_too_large_has_coarser_texels() {
        let mesh = box_mesh(DVec3::ONE, 4);
        for most in [64, 200, 500] {
            let atlas =
                Atlas::new(&mesh, 4e-3, &TextureOptions { most_texels: most, ..TextureOptions::default() });
            assert!(atlas.size[0].max(atlas.size[1]) <= most, "{:?}", atlas.size);
            assert!(atlas.size.iter().all(|n| n.is_power_of_two()));
            assert!(atlas.size[0] * atlas.size[1] * 16 > most * most, "{most}: {:?}", atlas.size);
            assert_eq!(atlas.placed.len(), mesh.triangles.len());
        }
    }
}
