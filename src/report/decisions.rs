//! What was decided and why, in short sentences.

use super::html::escape;
use crate::pipeline::RunRecord;
use serde::{Deserialize, Serialize};
use splat::PoseRefinement;

/// Something that a run has to settle one way or the other.
struct Topic {
    title: &'static str,
    /// Words by which the stages name it.
    words: &'static [&'static str],
    /// What is so where no stage decided on it.
    otherwise: fn(&RunRecord) -> Option<[String; 2]>,
}

const TOPICS: [Topic; 8] = [
    Topic { title: "Camera model", words: &["camera model"], otherwise: camera },
    Topic { title: "Motion", words: &["motion"], otherwise: motion },
    Topic { title: "Background", words: &["background"], otherwise: background },
    Topic { title: "SH degree", words: &["spherical-harmonic degree", "sh degree"], otherwise: degree },
    Topic { title: "Number of Gaussians", words: &["number of gaussians"], otherwise: count },
    Topic { title: "Poses in training", words: &["poses in training"], otherwise: training_poses },
    Topic { title: "Exposure", words: &["exposure"], otherwise: exposure },
    Topic { title: "Light", words: &["light", "shading"], otherwise: light },
];

fn said(choice: &str, why: String) -> Option<[String; 2]> {
    Some([choice.to_owned(), why])
}

fn is_imported(record: &RunRecord) -> bool {
    record.poses.as_ref().is_some_and(|p| p.imported)
}

fn camera(record: &RunRecord) -> Option<[String; 2]> {
    is_imported(record).then(|| ["as given".to_owned(), "the input brings its cameras".to_owned()])
}

fn motion(record: &RunRecord) -> Option<[String; 2]> {
    if is_imported(record) {
        return said("as given", "the input brings its poses".to_owned());
    }
    record.poses.as_ref().filter(|p| p.no_model.is_none())?;
    said("free", "nothing was assumed of how camera and object move".to_owned())
}

fn background(record: &RunRecord) -> Option<[String; 2]> {
    record.splat.as_ref()?;
    let frames = record.frames.as_ref()?;
    let masks = frames.frames.iter().filter(|f| f.mask.is_some()).count();
    match (masks, record.config.dataset.alpha) {
        (0, _) => said("part of the scene", "no frame has a matte".to_owned()),
        (n, splat::AlphaMode::Transparent) => said(
            "transparent",
            format!(
                "{n} of {} frames have a matte; training changes the colour behind them at random",
                frames.len()
            ),
        ),
        (n, splat::AlphaMode::Ignore) => {
            said("ignored", format!("asked for by --alpha; {n} of {} frames have a matte", frames.len()))
        }
    }
}

fn degree(record: &RunRecord) -> Option<[String; 2]> {
    let splat = record.splat.as_ref()?;
    said(&splat.sh_degree.to_string(), "as configured; no view was spared to judge it".to_owned())
}

fn count(record: &RunRecord) -> Option<[String; 2]> {
    let splat = record.splat.as_ref()?;
    said(&splat.gaussians.to_string(), "as planned; no view was spared to judge it".to_owned())
}

fn exposure(record: &RunRecord) -> Option<[String; 2]> {
    record.splat.as_ref()?;
    said("the same for all views", "not examined at this quality".to_owned())
}

fn training_poses(record: &RunRecord) -> Option<[String; 2]> {
    record.splat.as_ref()?;
    match record.config.train.refine_poses {
        PoseRefinement::On => said("refined", "asked for by --refine-poses".to_owned()),
        PoseRefinement::Off => said("as given", "asked for by --refine-poses".to_owned()),
        PoseRefinement::Auto => said("as given", "not examined: too few views or steps".to_owned()),
    }
}

fn light(record: &RunRecord) -> Option<[String; 2]> {
    record.splat.as_ref()?;
    said("no model of its own", "the spherical harmonics carry what changes with the direction".to_owned())
}

/// A decision as it is shown: title, choice, evidence.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Shown {
    /// Topic.
    pub title: String,
    /// What was chosen.
    pub choice: String,
    /// The figures that decided.
    pub evidence: String,
}

/// The topics that every reader asks for first, then all that was decided beside.
pub fn shown(record: &RunRecord) -> Vec<Shown> {
    let poses = record.poses.iter().flat_map(|p| &p.decisions);
    let made: Vec<&[String; 3]> = poses.chain(record.splat.iter().flat_map(|s| &s.decisions)).collect();
    let mut used = vec![false; made.len()];
    let mut all = Vec::new();
    for topic in &TOPICS {
        let mut found = false;
        for (i, [what, choice, evidence]) in made.iter().enumerate() {
            let what = what.to_lowercase();
            if !used[i] && topic.words.iter().any(|w| what.starts_with(w)) {
                (used[i], found) = (true, true);
                let (choice, evidence) = (choice.clone(), evidence.clone());
                all.push(Shown { title: topic.title.to_owned(), choice, evidence });
            }
        }
        if !found && let Some([choice, evidence]) = (topic.otherwise)(record) {
            all.push(Shown { title: topic.title.to_owned(), choice, evidence });
        }
    }
    for ([what, choice, evidence], _) in made.into_iter().zip(used).filter(|(_, used)| !used) {
        let mut title = what.clone();
        if let Some(first) = title.get_mut(0..1) {
            first.make_ascii_uppercase();
        }
        all.push(Shown { title, choice: choice.clone(), evidence: evidence.clone() });
    }
    all
}

/// Evidence longer than this is folded away behind its beginning.
const LONG: usize = 160;

/// The decisions as a list of cards.
pub fn section(record: &RunRecord) -> String {
    let card = |d: &Shown| {
        let [title, choice, evidence] = [&d.title, &d.choice, &d.evidence].map(|t| escape(t));
        let why = if d.evidence.chars().count() <= LONG {
            format!("<p>{evidence}</p>")
        } else {
            let lines: String = evidence.split("; ").map(|part| format!("<li>{part}</li>")).collect();
            let start: String = d.evidence.chars().take(LONG / 2).collect();
            let start = start.rsplit_once(' ').map_or(start.as_str(), |s| s.0);
            format!("<details><summary>{} …</summary><ul>{lines}</ul></details>", escape(start))
        };
        format!("<div class=\"card\"><h3>{title}</h3><b>{choice}</b>{why}</div>")
    };
    let cards: String = record.decisions.iter().map(card).collect();
    if cards.is_empty() {
        cards
    } else {
        format!("<h2>What was decided, and why</h2><div class=\"cards\">{cards}</div>")
    }
}
