//! Which mapper's model is taken: the incremental one's, the global one's, or the one that the observations bear out.

use crate::Knowledge;
use crate::global;
use crate::incremental::state::{MapState, MappingInput};
use crate::incremental::structureless_resection::agreement;
use crate::{SfmError, incremental};
use scene::decision::{Decision, MapperKind, Measurement, Quantity, Rule, Subject};
use scene::{Camera, Progress};
use serde::{Deserialize, Serialize};

/// How a model is made from verified pairs.
#[derive(clap::ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MapperChoice {
    /// Image by image; where that leaves images out, all at once too, and the better model is taken
    #[default]
    Auto,
    /// Image by image
    Incremental,
    /// All rotations, then all positions at once
    Global,
}

/// Share of the images that can be tied together below which a model is doubted.
const COMPLETE: f64 = 0.95;
/// How much more of the verified matches a model must agree with to be taken instead of the incremental one.
const BETTER: f64 = 1.02;

/// The model of all images that can be tied together; what was decided, where there was a choice.
pub(crate) fn map(
    input: &MappingInput<'_>,
    cameras: &[Camera],
    known: &[Knowledge],
    progress: &Progress,
) -> Result<(Option<MapState>, Option<Decision>), SfmError> {
    let choice = input.config.mapper;
    if choice == MapperChoice::Global {
        let started = incremental::sketch(input, cameras, known, progress)?;
        let Some(start) = started else { return Ok((None, None)) };
        let model = global::map(input, &start.cameras, known, progress)?;
        let said = model.as_ref().map(|m| decision(input, MapperKind::Global, &[(MapperKind::Global, m)]));
        return Ok((model, said));
    }
    let Some(first) = incremental::map(input, cameras, known, progress)? else { return Ok((None, None)) };
    let complete = first.registered_count() as f64 >= COMPLETE * reachable(input) as f64;
    if choice == MapperChoice::Incremental || complete {
        return Ok((Some(first), None));
    }
    let Some(second) = global::map(input, &first.cameras, known, progress)? else {
        return Ok((Some(first), None));
    };
    let [a, b] = [&first, &second].map(|s| count_agreeing(s, input).0 as f64);
    let taken = if b > BETTER * a { MapperKind::Global } else { MapperKind::Incremental };
    let decision =
        decision(input, taken, &[(MapperKind::Incremental, &first), (MapperKind::Global, &second)]);
    Ok((Some(if taken == MapperKind::Global { second } else { first }), Some(decision)))
}

/// Images in the largest part of the graph of verified pairs.
fn reachable(input: &MappingInput<'_>) -> usize {
    let n = input.keypoints.len();
    let mut part: Vec<usize> = (0..n).collect();
    fn find(part: &mut [usize], mut i: usize) -> usize {
        while part[i] != i {
            part[i] = part[part[i]];
            i = part[i];
        }
        i
    }
    for g in input.geometries {
        let (a, b) = (find(&mut part, g.a), find(&mut part, g.b));
        part[a.max(b)] = a.min(b);
    }
    let mut sizes = vec![0; n];
    (0..n).for_each(|i| sizes[find(&mut part, i)] += 1);
    sizes.into_iter().max().unwrap_or(0)
}

/// Matches of all verified pairs: (those that agree with a model, all); of pairs without two poses none agrees.
fn count_agreeing(state: &MapState, input: &MappingInput<'_>) -> (usize, usize) {
    let mut sums = (0, 0);
    for g in input.geometries {
        let (agreeing, all) = agreement(state, input, g).unwrap_or((0, g.inliers.len().min(200)));
        sums.0 += agreeing;
        sums.1 += all;
    }
    sums
}

fn decision(input: &MappingInput<'_>, taken: MapperKind, models: &[(MapperKind, &MapState)]) -> Decision {
    let decision = Decision::new(Subject::Mapper, taken, Rule::Evidence);
    models.iter().fold(decision, |decision, &(kind, state)| {
        let (agreeing, all) = count_agreeing(state, input);
        let scores = vec![
            Measurement::count(Quantity::RegisteredImages, state.registered_count()),
            Measurement::count(Quantity::AgreeingMatches, agreeing),
            Measurement::count(Quantity::Matches, all),
        ];
        decision.compared(kind, kind == taken, scores)
    })
}
