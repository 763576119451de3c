//! Cuts a mesh into pieces that lie flat: charts.

use super::flat::FlatChart;
use glam::DVec3;
use scene::geometry::Mesh;
use std::cmp::Ordering;
use std::collections::{BTreeMap, BinaryHeap, HashMap};

/// How charts are cut. Source of all: docs/decisions/16.
struct ChartLimits {
    /// A triangle is added to a chart up to this angle from its normal, degrees.
    grow_deg: f64,
    /// A small chart is joined to a neighbour if none of its triangles is farther from that one's
    /// normal, degrees; no triangle of a chart ever is.
    join_deg: f64,
    /// A small chart has fewer triangles.
    small: usize,
    /// How often what overlaps in a chart is cut again; after that each triangle is a chart.
    cuts: usize,
}

const LIMITS: ChartLimits = ChartLimits { grow_deg: 45.0, join_deg: 75.0, small: 12, cuts: 6 };

/// Charts of all triangles, each connected and laid flat, with no two triangles over the middle of
/// one texel of this size.
pub(super) fn charts(mesh: &Mesh, texel: f64) -> Vec<FlatChart> {
    let cutter = Cutter::new(mesh);
    let (mut done, mut left) = (Vec::new(), (0..mesh.triangles.len() as u32).collect::<Vec<_>>());
    for _ in 0..LIMITS.cuts {
        if left.is_empty() {
            return done;
        }
        let labels = cutter.cut(&left);
        left = Vec::new();
        for triangles in labels.into_values() {
            let normal = cutter.normal(&triangles);
            let (near, far) = triangles.into_iter().partition(|&t| cutter.faces(t, normal, LIMITS.join_deg));
            left.extend::<Vec<u32>>(far);
            let (chart, over) = FlatChart::new(mesh, near, normal, texel);
            left.extend(over);
            done.extend(chart);
        }
        left.sort_unstable();
    }
    for triangle in left {
        done.extend(FlatChart::new(mesh, vec![triangle], cutter.normals[triangle as usize], texel).0);
    }
    done
}

struct Cutter {
    /// Twice the triangles' areas along their normals.
    weighted: Vec<DVec3>,
    /// Unit normals; zero without area.
    normals: Vec<DVec3>,
    /// Triangles that share a side.
    neighbours: Vec<Vec<u32>>,
}

/// A triangle that may be added to a chart: the one that faces most alike first.
struct Offer {
    alike: f64,
    triangle: u32,
}

impl PartialEq for Offer {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Offer {}

impl PartialOrd for Offer {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Offer {
    fn cmp(&self, other: &Self) -> Ordering {
        self.alike.total_cmp(&other.alike).then(other.triangle.cmp(&self.triangle))
    }
}

impl Cutter {
    fn new(mesh: &Mesh) -> Self {
        let size = mesh.size();
        let weighted: Vec<DVec3> = (0..mesh.triangles.len())
            .map(|i| {
                let [a, b, c] = mesh.corners(i).map(|v| v / size);
                (b - a).cross(c - a)
            })
            .collect();
        let mut by_side: HashMap<[u32; 2], Vec<u32>> = HashMap::new();
        for (i, t) in (0..).zip(&mesh.triangles) {
            for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                by_side.entry([a.min(b), a.max(b)]).or_default().push(i);
            }
        }
        let neighbours = (0..).zip(&mesh.triangles).map(|(i, t)| {
            let sides = [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])].map(|(a, b)| [a.min(b), a.max(b)]);
            sides.iter().flat_map(|s| &by_side[s]).copied().filter(|&j| j != i).collect()
        });
        let neighbours = neighbours.collect();
        let normals = weighted.iter().map(|n| n.normalize_or_zero()).collect();
        Self { weighted, normals, neighbours }
    }

    fn normal(&self, triangles: &[u32]) -> DVec3 {
        let sum: DVec3 = triangles.iter().map(|&t| self.weighted[t as usize]).sum();
        sum.try_normalize().unwrap_or(DVec3::Z)
    }

    /// In no unit.
    fn area(&self, triangle: u32) -> f64 {
        self.weighted[triangle as usize].length()
    }

    /// Whether a triangle is no farther from a normal than an angle, degrees; without area it may
    /// be anywhere.
    fn faces(&self, triangle: u32, normal: DVec3, degrees: f64) -> bool {
        let own = self.normals[triangle as usize];
        own == DVec3::ZERO || own.dot(normal) >= degrees.to_radians().cos()
    }

    /// Connected pieces of these triangles that face about the same way.
    fn cut(&self, of: &[u32]) -> BTreeMap<u32, Vec<u32>> {
        let mut label: HashMap<u32, Option<u32>> = of.iter().map(|&t| (t, None)).collect();
        let mut seeds = of.to_vec();
        seeds.sort_by(|&a, &b| self.area(b).total_cmp(&self.area(a)).then(a.cmp(&b)));
        let mut charts = BTreeMap::new();
        for seed in seeds {
            if label[&seed].is_none() {
                charts.insert(seed, self.grow(seed, &mut label));
            }
        }
        self.join_small(&mut charts, &mut label);
        charts
    }

    /// The chart of a seed: neighbours are added, the one most alike first, as long as they face as
    /// the chart does on the whole.
    fn grow(&self, seed: u32, label: &mut HashMap<u32, Option<u32>>) -> Vec<u32> {
        let mut sum = DVec3::ZERO;
        let mut chart = Vec::new();
        let mut offers = BinaryHeap::from([Offer { alike: 1.0, triangle: seed }]);
        while let Some(Offer { triangle, .. }) = offers.pop() {
            let normal = sum.normalize_or(self.normals[seed as usize]);
            if label[&triangle].is_some() || !self.faces(triangle, normal, LIMITS.grow_deg) {
                continue;
            }
            label.insert(triangle, Some(seed));
            chart.push(triangle);
            sum += self.weighted[triangle as usize];
            for &next in &self.neighbours[triangle as usize] {
                if label.get(&next) == Some(&None) {
                    offers.push(Offer { alike: self.normals[next as usize].dot(normal), triangle: next });
                }
            }
        }
        chart
    }

    /// Joins small charts to the neighbour with which they share most sides, if they face its way.
    fn join_small(&self, charts: &mut BTreeMap<u32, Vec<u32>>, label: &mut HashMap<u32, Option<u32>>) {
        let mut small: Vec<u32> =
            charts.iter().filter(|(_, c)| c.len() < LIMITS.small).map(|(&seed, _)| seed).collect();
        small.sort_by_key(|seed| (charts[seed].len(), *seed));
        for seed in small {
            let mut shared: BTreeMap<u32, usize> = BTreeMap::new();
            for &next in charts[&seed].iter().flat_map(|&t| &self.neighbours[t as usize]) {
                if let Some(Some(other)) = label.get(&next)
                    && *other != seed
                {
                    *shared.entry(*other).or_default() += 1;
                }
            }
            let fits = |other: u32| {
                let normal = self.normal(&charts[&other]);
                charts[&seed].iter().all(|&t| self.faces(t, normal, LIMITS.join_deg))
            };
            let best =
                shared.into_iter().filter(|&(other, _)| fits(other)).max_by_key(|&(other, n)| (n, other));
            if let Some((other, _)) = best
                && let Some(moved) = charts.remove(&seed)
            {
                moved.iter().for_each(|&t| _ = label.insert(t, Some(other)));
                charts.entry(other).or_default().extend(moved);
            }
        }
    }
}
