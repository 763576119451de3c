//! The top of the report: a picture of what came out, and what to do with it.

use super::html::InlinePicture;
use crate::record::{Evaluation, RunRecord};
use anyhow::Result;
use maud::{Markup, html};
use std::path::Path;

/// Longest side of the picture, pixels. Source: the width of the page, 1100 points.
const HERO_SIZE: u32 = 1100;

/// The held-out view of median PSNR as it was rendered: neither the best nor the worst.
pub(super) fn hero(out: &Path, evaluation: &Evaluation) -> Result<Markup> {
    let mut views: Vec<_> = evaluation.views.iter().collect();
    views.sort_by(|a, b| a.metrics.psnr.total_cmp(&b.metrics.psnr));
    let Some(view) = views.get(views.len() / 2) else { return Ok(Markup::default()) };
    let picture = InlinePicture::read(&view.picture(out, "renders")?, HERO_SIZE)?;
    let caption =
        format!("Rendered, from where {} was taken: a photo that training has not seen.", view.name);
    Ok(html! {
        figure.hero {
            (picture.element(None, &caption))
            figcaption { (caption) }
        }
    })
}

/// Commands that make something of the results, with the folder as it is named here.
pub(super) fn next_steps(out: &Path, record: &RunRecord) -> Markup {
    let has_poses = record.poses.as_ref().is_some_and(|p| p.no_model.is_none());
    if !has_poses {
        return Markup::default();
    }
    let (folder, has_splat) = (out.display(), record.splat.is_some());
    let mut steps = Vec::new();
    if has_splat {
        steps.push((format!("sat-recon view {folder}"), "look at the splat, crop it, cut floaters away"));
        steps.push((format!("sat-recon render {folder} -o orbit.mp4"), "a film round the object"));
        steps.push((format!("sat-recon export {folder} --for gsplat"), "train on with another program"));
        steps.push((format!("sat-recon export {folder} --mesh -o mesh.glb"), "a mesh with a texture"));
        steps.push((format!("sat-recon measure {folder}"), "sizes, planes, cylinders, angles"));
    } else {
        steps.push((format!("sat-recon {folder}"), "train a splat on these poses"));
        steps.push((format!("sat-recon export {folder} --for colmap"), "go on with another program"));
    }
    html! {
        h2 { "What next" }
        @if out.join(crate::view::PAGE).is_file() {
            p { a.button href=(crate::view::PAGE) { "Open the splat in 3D" } " It opens from disk, without a server." }
        }
        table.next {
            @for (command, what) in &steps { tr { td { (what) } td { code { (command) } } } }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::{PoseSummary, SplatSummary};

    #[test]
    fn next_steps_are_those_that_can_be_taken() {
        let parsed = crate::config::parse(["sat-recon", "video.mp4"].map(str::to_owned).to_vec());
        let crate::args::Command::Run(config) = parsed.unwrap().unwrap().cli.command else {
            panic!("an input alone means run")
        };
        let mut record = RunRecord::begun(*config, Vec::new());
        let steps = |record: &RunRecord| next_steps(Path::new("out"), record).into_string();
        assert_eq!(steps(&record), "", "nothing came out");
        record.poses = Some(PoseSummary::default());
        assert!(steps(&record).contains("train a splat") && !steps(&record).contains("sat-recon view"));
        record.splat = Some(SplatSummary::default());
        assert!(
            steps(&record).contains("<code>sat-recon view out</code>") && !steps(&record).contains("href")
        );
    }
}
