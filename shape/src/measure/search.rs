//! The search for planes and cylinders: RANSAC, the largest first (Schnabel et al., CGF 2007).

use super::elements::Elements;
use super::primitive::{AxisDeviations, CELL, Found, Primitive};
use super::types::MeasureOptions;
use rand::Rng as _;
use rayon::prelude::*;
use scene::rng::{Rng, rng};
use scene::{Cancelled, Progress};

/// How the search is done. Source of all: docs/decisions/16.
struct SearchLimits {
    /// Candidates of either kind a round.
    candidates: u64,
    /// Elements on which candidates are compared.
    scored_on: usize,
    /// Candidates of a round that are fitted.
    fitted: usize,
    /// How often a fit and the choice of its elements follow each other.
    rounds_of_a_fit: usize,
    /// Elements among which the second one of a cylinder is the nearest.
    tournament: usize,
    /// Most angle between the normals of an element and a shape, degrees.
    most_angle_deg: f64,
    /// Least angle between the normals that make a cylinder, degrees.
    least_turn_deg: f64,
    /// A cylinder goes round its axis at least so far, degrees.
    least_coverage_deg: f64,
    /// A cylinder explains so much more than the best plane, or it is one.
    cylinder_gain: f64,
    /// Radius of a cylinder, tolerances at least and box sides at most.
    radii: [f64; 2],
    /// Patches along a shape, within which errors are alike.
    patches: f64,
}

const LIMITS: SearchLimits = SearchLimits {
    candidates: 200,
    scored_on: 2000,
    fitted: 4,
    rounds_of_a_fit: 3,
    tournament: 16,
    most_angle_deg: 25.0,
    least_turn_deg: 10.0,
    least_coverage_deg: 90.0,
    cylinder_gain: 1.25,
    radii: [2.0, 0.6],
    patches: 6.0,
};

/// The shapes that hold at least the share of the area asked for, in order of their area.
pub(crate) fn shapes(
    elements: &Elements,
    options: &MeasureOptions,
    progress: &Progress,
) -> Result<Vec<Found>, Cancelled> {
    let mut left: Vec<usize> = (0..elements.areas.len()).collect();
    let least = options.least_share * elements.area(&left);
    let mut found = Vec::new();
    progress.begin("shapes", options.most_shapes);
    for round in 0..options.most_shapes as u64 {
        let best = round_of(elements, &left, options, round);
        let Some(best) = best.filter(|b| elements.area(&b.elements) >= least) else { break };
        let mut taken = vec![false; elements.areas.len()];
        best.elements.iter().for_each(|&i| taken[i] = true);
        left.retain(|&i| !taken[i]);
        found.push(best);
        progress.tick()?;
    }
    found.sort_by(|a, b| elements.area(&b.elements).total_cmp(&elements.area(&a.elements)));
    Ok(found)
}

/// The shape with the largest area among what is left.
fn round_of(elements: &Elements, left: &[usize], options: &MeasureOptions, round: u64) -> Option<Found> {
    let scored = elements.draw(left, LIMITS.scored_on, &mut rng(options.seed, "measure", round << 32));
    if scored.is_empty() {
        return None;
    }
    let planes = candidates(elements, &scored, options, |k| {
        let mut random = rng(options.seed, "measure plane", (round << 32) + k);
        elements.draw(&scored, 1, &mut random).first().map(|&i| Primitive::plane(elements, i))
    });
    let cylinders = candidates(elements, &scored, options, |k| {
        let mut random = rng(options.seed, "measure cylinder", (round << 32) + k);
        let i = scored[random.random_range(0..scored.len())];
        let j = partner(elements, &scored, i, &mut random)?;
        let least = LIMITS.radii[0] * options.tolerance;
        Primitive::cylinder(elements, [i, j], least, LIMITS.radii[1])
    });
    let plane = best_of(elements, left, planes, options);
    let cylinder = best_of(elements, left, cylinders, options).filter(|c| goes_round(elements, c));
    if area(elements, &cylinder) > LIMITS.cylinder_gain * area(elements, &plane) { cylinder } else { plane }
}

/// Of what was found, if anything.
fn area(elements: &Elements, found: &Option<Found>) -> f64 {
    found.as_ref().map_or(0.0, |f| elements.area(&f.elements))
}

/// The element nearest to `i` of a few drawn that face another way.
fn partner(elements: &Elements, among: &[usize], i: usize, random: &mut Rng) -> Option<usize> {
    let drawn = (0..LIMITS.tournament).map(|_| among[random.random_range(0..among.len())]);
    let least = LIMITS.least_turn_deg.to_radians().sin();
    let turned = drawn.filter(|&j| elements.normals[i].cross(elements.normals[j]).length() > least);
    let here = elements.middle(i);
    turned.min_by(|&a, &b| {
        let [a, b] = [a, b].map(|j| elements.middle(j).distance_squared(here));
        a.total_cmp(&b)
    })
}

/// The best candidates, best first.
fn candidates(
    elements: &Elements,
    scored: &[usize],
    options: &MeasureOptions,
    make: impl Fn(u64) -> Option<Primitive> + Sync,
) -> Vec<Primitive> {
    let cosine = LIMITS.most_angle_deg.to_radians().cos();
    let score =
        |p: &Primitive| scored.iter().filter(|&&i| p.fits(elements, i, options.tolerance, cosine)).count();
    let mut all: Vec<(usize, Primitive)> =
        (0..LIMITS.candidates).into_par_iter().filter_map(|k| make(k).map(|p| (score(&p), p))).collect();
    all.sort_by_key(|(n, _)| std::cmp::Reverse(*n));
    all.truncate(LIMITS.fitted);
    all.into_iter().map(|(_, p)| p).collect()
}

/// Of candidates, fitted to all elements near them, the one whose connected part is largest.
fn best_of(
    elements: &Elements,
    left: &[usize],
    candidates: Vec<Primitive>,
    options: &MeasureOptions,
) -> Option<Found> {
    let fitted: Vec<Found> =
        candidates.into_par_iter().filter_map(|p| fit(elements, left, p, options)).collect();
    fitted
        .into_iter()
        .reduce(|a, b| if elements.area(&b.elements) > elements.area(&a.elements) { b } else { a })
}

fn fit(elements: &Elements, left: &[usize], start: Primitive, options: &MeasureOptions) -> Option<Found> {
    let cosine = LIMITS.most_angle_deg.to_radians().cos();
    let mut found = Found { primitive: start, deviations: AxisDeviations::default(), elements: vec![] };
    for _ in 0..LIMITS.rounds_of_a_fit {
        let fits =
            left.iter().copied().filter(|&i| found.primitive.fits(elements, i, options.tolerance, cosine));
        let near: Vec<usize> = fits.collect();
        found.elements = elements.largest_part(&near, CELL * options.tolerance);
        if found.elements.is_empty() {
            return None;
        }
        let extent = extent(elements, &found.elements);
        (found.primitive, found.deviations) =
            found.primitive.fitted(elements, &found.elements, extent / LIMITS.patches)?;
        if !found.deviations.is_finite() {
            // Too few patches to tell: all that is known is that the surface lies within tolerance.
            found.deviations = AxisDeviations {
                angle: options.tolerance / extent,
                offset: options.tolerance,
                radius: options.tolerance,
            };
        }
    }
    found.elements.retain(|&i| found.primitive.fits(elements, i, options.tolerance, cosine));
    (!found.elements.is_empty()).then_some(found)
}

/// Longest side of the box around elements.
fn extent(elements: &Elements, of: &[usize]) -> f64 {
    let corners: Vec<_> = of.iter().flat_map(|&i| elements.corners[i]).collect();
    let (low, high) = crate::decimate::bounds(&corners);
    (high - low).max_element()
}

/// Whether a cylinder's elements go far enough round it that no plane could do.
fn goes_round(elements: &Elements, found: &Found) -> bool {
    found.coverage_deg(elements) >= LIMITS.least_coverage_deg
}
