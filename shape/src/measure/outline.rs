//! Outlines of flat things: hulls, rectangles, circles, and where an edge lies.

use super::least_squares::{ResidualRow, solve};
use glam::DVec2;
use scene::motion_report::Estimate;
use std::f64::consts::TAU;

/// Cells along an edge, and sectors of a circle. Source: docs/decisions/16.
pub(crate) const CELLS: usize = 16;

/// Corners of the convex hull, anticlockwise (Andrew, Information Processing Letters 1979).
pub(crate) fn convex_hull(points: impl Iterator<Item = DVec2>) -> Vec<DVec2> {
    let mut points: Vec<DVec2> = points.collect();
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    let mut hull = half_hull(points.iter());
    hull.extend(half_hull(points.iter().rev()));
    if hull.is_empty() { points } else { hull }
}

/// The chain that turns left all the way, without its last point.
fn half_hull<'a>(points: impl Iterator<Item = &'a DVec2>) -> Vec<DVec2> {
    let mut chain: Vec<DVec2> = Vec::new();
    for &p in points {
        while let [.., a, b] = chain[..]
            && (b - a).perp_dot(p - b) <= 0.0
        {
            chain.pop();
        }
        chain.push(p);
    }
    chain.pop();
    chain
}

/// Direction of a side of the least rectangle around a hull, one of whose sides lies along it
/// (Freeman and Shapira, CACM 1975), and the rectangle's sides.
pub(crate) fn least_rectangle(hull: &[DVec2]) -> (DVec2, DVec2) {
    let mut best = (DVec2::X, DVec2::INFINITY);
    for (i, a) in hull.iter().enumerate() {
        let Some(along) = (hull[(i + 1) % hull.len()] - a).try_normalize() else { continue };
        let turned = hull.iter().map(|p| DVec2::new(p.dot(along), p.dot(along.perp())));
        let low = turned.clone().fold(DVec2::INFINITY, DVec2::min);
        let sides = turned.fold(DVec2::NEG_INFINITY, DVec2::max) - low;
        if !(sides.element_product() >= best.1.element_product()) {
            best = (along, sides);
        }
    }
    if best.1.is_finite() { best } else { (DVec2::X, DVec2::ZERO) }
}

/// Where a surface ends: `points` are heights towards the end, and the cell in which each lies. The
/// mean of the cells' highest points that lie within `tolerance` of the highest of all, and their
/// standard deviation (not that of the mean: errors of neighbours are alike) with `noise` added.
/// With fewer than three such cells it is the highest point.
pub(crate) fn end(points: impl Iterator<Item = (f64, usize)>, tolerance: f64, noise: f64) -> Estimate {
    let mut tops: Vec<f64> = Vec::new();
    for (height, cell) in points {
        if cell >= tops.len() {
            tops.resize(cell + 1, f64::NEG_INFINITY);
        }
        tops[cell] = tops[cell].max(height);
    }
    let highest = tops.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    tops.retain(|t| *t >= highest - tolerance);
    if tops.len() < 3 {
        return Estimate { value: highest, deviation: noise };
    }
    let n = tops.len() as f64;
    let mean = tops.iter().sum::<f64>() / n;
    let variance = tops.iter().map(|t| (t - mean).powi(2)).sum::<f64>() / (n - 1.0);
    Estimate { value: mean, deviation: variance.sqrt().hypot(noise) }
}

/// Length from the end in direction −1 to that in direction +1 of `points`: heights and cells.
pub(crate) fn length(points: &[(f64, usize)], tolerance: f64, noise: f64) -> (f64, Estimate) {
    let up = end(points.iter().copied(), tolerance, noise);
    let down = end(points.iter().map(|(h, cell)| (-h, *cell)), tolerance, noise);
    let deviation = up.deviation.hypot(down.deviation);
    ((up.value - down.value) / 2.0, Estimate { value: up.value + down.value, deviation })
}

/// A circle.
pub(crate) struct Circle {
    pub(crate) centre: DVec2,
    pub(crate) radius: f64,
    /// Root mean square distance of its points.
    pub(crate) rms: f64,
    /// Standard deviation of the radius.
    pub(crate) deviation: f64,
}

/// The circle whose outline these points are, the farthest of each of several sectors about their
/// middle: `None` where a quarter of the sectors or more holds none.
pub(crate) fn outline_circle(points: &[DVec2], middle: DVec2) -> Option<Circle> {
    let sectors = 2 * CELLS;
    let mut farthest: Vec<Option<DVec2>> = vec![None; sectors];
    for p in points {
        let d = *p - middle;
        let sector = ((d.y.atan2(d.x) / TAU + 1.0).fract() * sectors as f64) as usize % sectors;
        let far = &mut farthest[sector];
        if far.is_none_or(|f| f.distance(middle) < d.length()) {
            *far = Some(*p);
        }
    }
    let rim: Vec<DVec2> = farthest.into_iter().flatten().collect();
    if 4 * rim.len() < 3 * sectors {
        return None;
    }
    let (mut centre, mut radius) = (middle, 0.0);
    let mut deviation = 0.0;
    for _ in 0..8 {
        if radius == 0.0 {
            radius = rim.iter().map(|p| p.distance(centre)).sum::<f64>() / rim.len() as f64;
        }
        let rows: Vec<ResidualRow<3>> = (0..)
            .zip(&rim)
            .map(|(i, p)| {
                let away = (*p - centre).normalize_or_zero();
                let residual = p.distance(centre) - radius;
                // Neighbouring sectors err alike.
                ResidualRow {
                    derivatives: [-away.x, -away.y, -1.0],
                    residual,
                    weight: 1.0,
                    patch: [i / 2, 0, 0],
                }
            })
            .collect();
        let solution = solve(&rows)?;
        centre += DVec2::new(solution.step[0], solution.step[1]);
        radius += solution.step[2];
        deviation = solution.covariance[2][2].sqrt();
    }
    let squares: f64 = rim.iter().map(|p| (p.distance(centre) - radius).powi(2)).sum();
    Some(Circle { centre, radius, rms: (squares / rim.len() as f64).sqrt(), deviation })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_rectangle_of_a_turned_one_is_itself() {
        for turn in [0.0, 0.3, 1.2, 3.0] {
            let axis = DVec2::from_angle(turn);
            let points = (0..=20).flat_map(|i| {
                (0..=20).map(move |j| axis.rotate(DVec2::new(0.2 * f64::from(i), 0.05 * f64::from(j))))
            });
            let hull = convex_hull(points);
            let (_, sides) = least_rectangle(&hull);
            let sides = [sides.max_element(), sides.min_element()];
            assert!((sides[0] - 4.0).abs() < 1e-9 && (sides[1] - 1.0).abs() < 1e-9, "{turn}: {sides:?}");
        }
        assert_eq!(least_rectangle(&convex_hull(std::iter::empty())).1, DVec2::ZERO);
        assert_eq!(least_rectangle(&convex_hull([DVec2::ONE; 3].into_iter())).1, DVec2::ZERO);
    }

    #[test]
    fn an_edge_is_the_mean_of_its_cells_and_a_tip_the_highest_point() {
        let edge = [(1.0, 0), (1.02, 1), (0.98, 2), (0.3, 0), (0.5, 3)];
        let found = end(edge.into_iter(), 0.1, 0.0);
        assert!((found.value - 1.0).abs() < 1e-12 && (found.deviation - 0.02).abs() < 1e-12, "{found:?}");
        let found = end([(1.0, 0), (0.2, 1), (0.1, 2)].into_iter(), 0.1, 0.05);
        assert_eq!((found.value, found.deviation), (1.0, 0.05));
    }

    #[test]
    fn circles_are_found_and_squares_are_none() {
        let at = |i: u32, r: f64| DVec2::new(3.0, -2.0) + DVec2::from_angle(f64::from(i) * 0.01) * r;
        let ring: Vec<DVec2> = (0..629).map(|i| at(i, 0.5)).collect();
        let found = outline_circle(&ring, DVec2::new(3.05, -2.03)).unwrap();
        assert!((found.radius - 0.5).abs() < 1e-9 && found.rms < 1e-9, "{}", found.radius);
        assert!(found.centre.distance(DVec2::new(3.0, -2.0)) < 1e-9);
        assert!(outline_circle(&ring[..300], DVec2::new(3.0, -2.0)).is_none());
        let square: Vec<DVec2> = (0..100)
            .flat_map(|i| {
                [(1.0, 0), (-1.0, 0), (1.0, 1), (-1.0, 1)].map(|(s, k)| {
                    let t = f64::from(i) / 50.0 - 1.0;
                    if k == 0 { DVec2::new(s, t) } else { DVec2::new(t, s) }
                })
            })
            .collect();
        assert!(outline_circle(&square, DVec2::ZERO).unwrap().rms > 0.1);
    }
}
