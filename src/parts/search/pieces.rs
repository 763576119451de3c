//! A splat cut into pieces.

use glam::{DVec3, Vec3};
use rand::Rng;
use rand::distr::Distribution as _;
use rand::distr::weighted::WeightedIndex;
use rand::seq::SliceRandom as _;
use scene::Gaussians;
use scene::rng::rng;

/// How a splat is cut.
struct PieceLimits {
    /// Pieces. Source: chosen by hand on one film, whose part is a fiftieth of the object.
    pieces: usize,
    /// Gaussians that are used. Source: chosen by hand: more than a hundred a piece.
    points: usize,
    /// Rounds of Lloyd's algorithm. Source: chosen by hand.
    rounds: usize,
    /// Opacity (logit) from which on a Gaussian counts: 0.3. Source: chosen by hand.
    opacity_logit: f32,
    /// Gaussians are left out that are so many times the median distance from the middle.
    /// Source: chosen by hand.
    far: f32,
}

/// The values in force.
const PIECES: PieceLimits =
    PieceLimits { pieces: 60, points: 8000, rounds: 40, opacity_logit: -0.85, far: 8.0 };

/// Points of a splat, and the piece that each belongs to.
pub(super) struct Pieces {
    /// Frame of the Gaussians.
    pub(super) points: Vec<Vec3>,
    /// By point.
    pub(super) labels: Vec<u8>,
    /// By piece.
    pub(super) centres: Vec<Vec3>,
}

impl Pieces {
    /// Cuts where Gaussians lie densest (k-means).
    pub(super) fn of(gaussians: &Gaussians, seed: u64) -> Self {
        let mut points = solid(gaussians);
        let mut rng = rng(seed, "pieces", 0);
        points.shuffle(&mut rng);
        points.truncate(PIECES.points);
        let mut centres = first_centres(&points, &mut rng);
        let mut labels = vec![0; points.len()];
        for _ in 0..PIECES.rounds {
            labels.iter_mut().zip(&points).for_each(|(label, p)| *label = nearest(&centres, *p));
            for (k, centre) in centres.iter_mut().enumerate() {
                let own = points.iter().zip(&labels).filter(|(_, l)| usize::from(**l) == k);
                let (sum, count) = own.fold((Vec3::ZERO, 0.0), |(s, n), (p, _)| (s + *p, n + 1.0));
                *centre = if count > 0.0 { sum / count } else { *centre };
            }
        }
        Self { points, labels, centres }
    }

    /// The same with points once more, as a piece of their own: what does not move with it fades,
    /// as does what moves with it of the others.
    pub(super) fn with(&self, points: &[DVec3]) -> Self {
        let more: Vec<Vec3> = points.iter().map(|p| p.as_vec3()).collect();
        let centre = more.iter().sum::<Vec3>() / more.len().max(1) as f32;
        let label = self.centres.len() as u8;
        Self {
            labels: self.labels.iter().copied().chain(more.iter().map(|_| label)).collect(),
            points: [self.points.as_slice(), &more].concat(),
            centres: [self.centres.as_slice(), &[centre]].concat(),
        }
    }

    /// The points of a piece.
    pub(super) fn own(&self, piece: usize) -> impl Iterator<Item = Vec3> {
        let all = self.points.iter().zip(&self.labels);
        all.filter(move |(_, l)| usize::from(**l) == piece).map(|(p, _)| *p)
    }

    /// Root mean square of the distances of its points from its centre.
    pub(super) fn extent(&self, piece: usize) -> f64 {
        let squares: Vec<f64> =
            self.own(piece).map(|p| f64::from(p.distance_squared(self.centres[piece]))).collect();
        (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()
    }

    /// At most `most` points within `reach` times the extent of a piece of its centre.
    pub(super) fn around(&self, piece: usize, reach: f64, most: usize) -> Vec<DVec3> {
        let (centre, radius) = (self.centres[piece], (reach * self.extent(piece)) as f32);
        let near = self.points.iter().filter(|p| p.distance(centre) < radius);
        near.take(most).map(|p| p.as_dvec3()).collect()
    }
}

/// Gaussians that show something, without those far away.
fn solid(gaussians: &Gaussians) -> Vec<Vec3> {
    let all = gaussians.means.iter().zip(&gaussians.opacity_logits);
    let solid = all.filter(|(mean, logit)| **logit > PIECES.opacity_logit && mean.is_finite());
    let mut points: Vec<Vec3> = solid.map(|(mean, _)| *mean).collect();
    let middle = Vec3::from([0, 1, 2].map(|a| median(points.iter().map(|p| p[a]))));
    let usual = median(points.iter().map(|p| p.distance(middle)));
    points.retain(|p| p.distance(middle) <= PIECES.far * usual);
    points
}

/// 0 of nothing.
fn median(values: impl Iterator<Item = f32>) -> f32 {
    scene::overview::quantile(values.map(f64::from).collect(), 0.5).unwrap_or(0.0) as f32
}

/// First centres: points drawn by the squares of their distances from those before (k-means++,
/// Arthur and Vassilvitskii 2007).
fn first_centres(points: &[Vec3], rng: &mut impl Rng) -> Vec<Vec3> {
    let mut centres: Vec<Vec3> = points.first().copied().into_iter().collect();
    let mut squares: Vec<f32> = points.iter().map(|p| p.distance_squared(points[0])).collect();
    while centres.len() < PIECES.pieces.min(points.len()) {
        let Ok(by_square) = WeightedIndex::new(&squares) else { break };
        let new = points[by_square.sample(rng)];
        centres.push(new);
        squares.iter_mut().zip(points).for_each(|(d, p)| *d = d.min(p.distance_squared(new)));
    }
    centres
}

fn nearest(centres: &[Vec3], point: Vec3) -> u8 {
    let squares = centres.iter().map(|c| c.distance_squared(point));
    squares.enumerate().min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(k, _)| k as u8)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Quat;

    fn cloud(places: &[Vec3]) -> Gaussians {
        let n = places.len();
        Gaussians {
            means: places.to_vec(),
            log_scales: vec![Vec3::ZERO; n],
            rotations: vec![Quat::IDENTITY; n],
            opacity_logits: vec![1.0; n],
            sh: vec![0.0; 3 * n],
            sh_degree: 0,
        }
    }

    fn corner(k: usize) -> Vec3 {
        Vec3::new((k % 5) as f32, (k / 5 % 4) as f32, (k / 20) as f32)
    }

    #[test]
    fn clusters_become_pieces_and_what_is_far_or_hardly_there_belongs_to_none() {
        let mut places: Vec<Vec3> = (0..3000)
            .map(|i| corner(i % 60) + 0.01 * Vec3::new((i % 7) as f32, (i % 5) as f32, 0.0))
            .collect();
        places.push(Vec3::splat(1e4));
        places.push(Vec3::splat(f32::NAN));
        let mut gaussians = cloud(&places);
        gaussians.opacity_logits[17] = -3.0;
        let pieces = Pieces::of(&gaussians, 1);
        assert_eq!((pieces.points.len(), pieces.centres.len()), (2999, 60));
        for k in 0..60 {
            assert!((49..=50).contains(&pieces.own(k).count()), "{k}");
            assert!(pieces.extent(k) < 0.05, "{}", pieces.extent(k));
            assert!(pieces.around(k, 2.0, 20).len() == 20);
        }
    }

    #[test]
    fn few_gaussians_make_few_pieces() {
        assert!(Pieces::of(&cloud(&[]), 1).centres.is_empty());
        let three = Pieces::of(&cloud(&[Vec3::ZERO, Vec3::X, Vec3::Y]), 1);
        assert_eq!(three.centres.len(), 3);
    }
}
