//! Pieces of masks that are no part of the object: its shadow on the floor, the rim of a pole.
//!
//! What a mask shows apart from its largest piece stays where it can belong to the object:
//! somewhere along the rays of most of its pixels lies a place that more than half of the other
//! views cover.
//! That is the visual hull (Laurentini 1994) of a majority of the masks, as masks lose parts here
//! and there. A shadow turns with the lamp, not with the object, and what stands still in the
//! pictures stands nowhere in the object's frame.

use crate::disjoint_sets::DisjointSets;
use crate::error::SfmError;
use crate::sift::unreadable;
use crate::statistics::median;
use crate::undistort::cannot_write;
use glam::{DVec2, DVec3};
use image::GrayImage;
use rayon::prelude::*;
use scene::decision::{Choice, Decision, Quantity, Remark, Rule, Subject};
use scene::{Camera, Pose, PosedImage, Progress, Reconstruction};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// How pieces are judged.
struct PieceRules {
    /// Coverage (of 255) from which a pixel is covered. Source: as for the splat's hull.
    covered: u8,
    /// Views with a mask from which pieces are judged, and which have to see a place to say
    /// anything about it. Source: as for the splat's hull.
    least_views: usize,
    /// Cells along the longer side of a picture in which places are looked up: coarse, in favour
    /// of the piece. Source: on case 4 pieces of its shadow are covered by 20 to 50 % of the
    /// views, those of the object, on six turns that did not choose it, by 65 to 100 %.
    cells: u32,
    /// Pixels of a piece that are asked. Source: judgement.
    pixels: usize,
    /// Places along a ray; from one to the next a picture at a right angle moves by a cell and a
    /// half. Source: judgement.
    places: usize,
    /// They lie between the distance of the points divided and multiplied by this. Source:
    /// judgement: cameras stay outside of the object.
    reach: f64,
    /// Views that are asked about a place at most, spread evenly. Source: as for fusion.
    views: usize,
    /// Pieces of a mask that are judged, the largest first: a mask of noise has thousands. Source:
    /// judgement: case 4 has at most 7.
    pieces: usize,
    /// Rounds at most: pieces of the same shadow cover one another until some of them have gone.
    /// Source: case 4 takes two.
    rounds: usize,
}

/// See [`PieceRules`].
const RULES: PieceRules = PieceRules {
    covered: 8,
    least_views: 8,
    cells: 80,
    pixels: 24,
    places: 96,
    reach: 2.0,
    views: 120,
    pieces: 32,
    rounds: 4,
};

/// What was removed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct RemovedPieces {
    /// Pieces.
    pub pieces: usize,
    /// Masks that they were removed from.
    pub masks: usize,
}

impl RemovedPieces {
    /// What a report says of it.
    pub(crate) fn decision(self) -> Option<Decision> {
        let removed = Decision::new(Subject::MattePieces, Choice::count(self.pieces), Rule::Evidence);
        let removed = removed.measured(Quantity::Images, self.masks as f64);
        (self.pieces > 0).then(|| removed.remarked(Remark::OtherMasksDisagree))
    }
}

/// Connected pixels of a mask.
struct Piece {
    pixels: Vec<u32>,
    removed: bool,
}

/// A mask as other views ask for it.
struct OutlinedView<'a> {
    path: PathBuf,
    camera: &'a Camera,
    pose: Pose,
    /// Side of a cell, pixels.
    cell: u32,
    /// Cells in a row.
    columns: u32,
    /// Covered pixels of each cell.
    counts: Vec<u32>,
    /// The pieces that are judged: not the largest.
    pieces: Vec<Piece>,
}

/// Removes from the masks in `folder` (by the images' names with `.png`) the pieces that most other
/// views contradict. `model` has pinhole cameras of the masks' sizes.
pub(crate) fn remove_contradicted(
    folder: &Path,
    model: &Reconstruction,
    progress: &Progress,
) -> Result<RemovedPieces, SfmError> {
    let images: Vec<&PosedImage> = model.images.values().collect();
    let views = images.par_iter().map(|image| OutlinedView::read(folder, image, &model.cameras));
    let views: Vec<Option<OutlinedView>> = views.collect::<Result<_, _>>()?;
    let mut views: Vec<OutlinedView> = views.into_iter().flatten().collect();
    if views.len() < RULES.least_views || model.points.is_empty() {
        return Ok(RemovedPieces::default());
    }
    let centre = middle(model);
    for _ in 0..RULES.rounds {
        progress.check().map_err(SfmError::from)?;
        let contradicted: Vec<Vec<usize>> =
            (0..views.len()).into_par_iter().map(|i| contradicted(&views, i, centre)).collect();
        if contradicted.iter().all(Vec::is_empty) {
            break;
        }
        for (view, pieces) in views.iter_mut().zip(contradicted) {
            pieces.into_iter().for_each(|k| view.forget(k));
        }
    }
    views.par_iter().try_for_each(OutlinedView::write)?;
    let removed = views.iter().map(|v| v.pieces.iter().filter(|p| p.removed).count());
    let removed: Vec<usize> = removed.filter(|n| *n > 0).collect();
    Ok(RemovedPieces { pieces: removed.iter().sum(), masks: removed.len() })
}

/// The median of the points.
fn middle(model: &Reconstruction) -> DVec3 {
    let places = model.points.values().map(|p| p.position);
    DVec3::from_array([0, 1, 2].map(|axis| median(places.clone().map(|x| x[axis]).collect())))
}

/// The pieces of a view that most others contradict.
fn contradicted(views: &[OutlinedView], view: usize, centre: DVec3) -> Vec<usize> {
    let pieces = views[view].pieces.iter().enumerate().filter(|(_, p)| !p.removed);
    let wrong = pieces.filter(|(_, piece)| {
        let step = piece.pixels.len().div_ceil(RULES.pixels);
        let asked = piece.pixels.iter().step_by(step);
        let (mut all, mut supported) = (0, 0);
        for pixel in asked {
            all += 1;
            supported += usize::from(is_supported(views, view, *pixel, centre));
        }
        supported * 2 < all
    });
    wrong.map(|(k, _)| k).collect()
}

/// Whether some place along a pixel's ray is covered by most of the other views that see it; also
/// where no place is seen by enough of them.
fn is_supported(views: &[OutlinedView], view: usize, pixel: u32, centre: DVec3) -> bool {
    let own = &views[view];
    let at = DVec2::new(f64::from(pixel % own.camera.width), f64::from(pixel / own.camera.width)) + 0.5;
    let (eye, away) = (own.pose.centre(), own.pose.inverse().rotation * own.camera.ray(at));
    let distance = eye.distance(centre);
    let mut judged = false;
    for k in 0..RULES.places {
        let exponent = 2.0 * k as f64 / (RULES.places - 1) as f64 - 1.0;
        let place = eye + away * (distance * RULES.reach.powf(exponent));
        match majority(views, view, place) {
            Some(true) => return true,
            Some(false) => judged = true,
            None => {}
        }
    }
    !judged
}

/// Whether most of the other views that see a place cover it; `None` where too few see it.
fn majority(views: &[OutlinedView], view: usize, place: DVec3) -> Option<bool> {
    let (mut covered, mut bare) = (0, 0);
    let asked = views.iter().enumerate().step_by(views.len().div_ceil(RULES.views));
    let asked = asked.filter(|(i, _)| *i != view);
    for (_, other) in asked {
        match other.covers(place) {
            Some(true) => covered += 1,
            Some(false) => bare += 1,
            None => {}
        }
        if bare * 2 > views.len().min(RULES.views) {
            return Some(false);
        }
    }
    (covered + bare + 1 >= RULES.least_views).then_some(covered > bare)
}

impl<'a> OutlinedView<'a> {
    /// `None` where the image has no mask or one of another size.
    fn read(
        folder: &Path,
        image: &PosedImage,
        cameras: &'a BTreeMap<u32, Camera>,
    ) -> Result<Option<Self>, SfmError> {
        let (path, camera) = (folder.join(format!("{}.png", image.name)), &cameras[&image.camera]);
        if !path.exists() {
            return Ok(None);
        }
        let mask = open(&path)?;
        // Who loads it says so.
        if mask.dimensions() != (camera.width, camera.height) {
            return Ok(None);
        }
        let cell = camera.width.max(camera.height).div_ceil(RULES.cells).max(1);
        let columns = camera.width.div_ceil(cell);
        let mut counts = vec![0; (columns * camera.height.div_ceil(cell)) as usize];
        for (x, y, _) in mask.enumerate_pixels().filter(|(_, _, p)| p.0[0] >= RULES.covered) {
            counts[(y / cell * columns + x / cell) as usize] += 1;
        }
        let pieces = pieces(&mask);
        Ok(Some(Self { path, camera, pose: image.pose, cell, columns, counts, pieces }))
    }

    /// Whether its mask covers a place; `None` outside the picture.
    fn covers(&self, place: DVec3) -> Option<bool> {
        let at = self.camera.project(self.pose.transform(place))?;
        let (width, height) = (f64::from(self.camera.width), f64::from(self.camera.height));
        let inside = at.x >= 0.0 && at.y >= 0.0 && at.x < width && at.y < height;
        let [x, y] = [at.x, at.y].map(|v| v as u32 / self.cell);
        inside.then(|| self.counts[(y * self.columns + x) as usize] > 0)
    }

    /// Removes a piece, for other views too.
    fn forget(&mut self, piece: usize) {
        let piece = &mut self.pieces[piece];
        piece.removed = true;
        for pixel in &piece.pixels {
            let (x, y) = (pixel % self.camera.width, pixel / self.camera.width);
            self.counts[(y / self.cell * self.columns + x / self.cell) as usize] -= 1;
        }
    }

    /// Writes the mask without what was removed.
    fn write(&self) -> Result<(), SfmError> {
        if self.pieces.iter().all(|p| !p.removed) {
            return Ok(());
        }
        let mut mask = open(&self.path)?;
        for pixel in self.pieces.iter().filter(|p| p.removed).flat_map(|p| &p.pixels) {
            mask.as_mut()[*pixel as usize] = 0;
        }
        // The file may be another name of the one that the matte was written to.
        std::fs::remove_file(&self.path).map_err(|e| cannot_write(&self.path, &e))?;
        mask.save(&self.path).map_err(|e| cannot_write(&self.path, &e))
    }
}

fn open(path: &Path) -> Result<GrayImage, SfmError> {
    scene::io::load_mask(path).map_err(|e| unreadable(path, &e))
}

/// Connected pixels (8 neighbours) of a mask but for the largest group, the larger first.
fn pieces(mask: &GrayImage) -> Vec<Piece> {
    let (width, values) = (mask.width() as usize, mask.as_raw());
    let is_covered = |i: usize| values[i] >= RULES.covered;
    let mut sets = DisjointSets::new(values.len());
    for i in (0..values.len()).filter(|i| is_covered(*i)) {
        let (x, y) = (i % width, i / width);
        let left = (x > 0).then(|| i - 1);
        let above =
            (y > 0).then(|| (i - width - usize::from(x > 0))..=(i - width + usize::from(x + 1 < width)));
        let before = left.into_iter().chain(above.into_iter().flatten());
        before.filter(|j| is_covered(*j)).for_each(|j| {
            sets.join(i, j);
        });
    }
    let mut groups: BTreeMap<usize, Vec<u32>> = BTreeMap::new();
    for i in (0..values.len()).filter(|i| is_covered(*i)) {
        groups.entry(sets.find(i)).or_default().push(i as u32);
    }
    let mut groups: Vec<Vec<u32>> = groups.into_values().collect();
    groups.sort_by_key(|pixels| std::cmp::Reverse(pixels.len()));
    let smaller = groups.into_iter().skip(1).take(RULES.pieces);
    smaller.map(|pixels| Piece { pixels, removed: false }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Luma;
    use scene::{CameraModel, ScenePoint};

    /// What a mask shows beside the ball at the origin.
    #[derive(Clone, Copy, PartialEq)]
    enum Beside {
        /// A small ball that turns with the large one and is lost in each fourth mask.
        Part,
        /// A spot that stands still in the pictures.
        Shadow,
    }

    const VIEWS: usize = 40;

    fn camera() -> Camera {
        Camera::centred(1, CameraModel::Pinhole, 160, 120, 150.0)
    }

    /// Views from all around; the scene is `scale` times as large as the one of radius 3.
    fn model(scale: f64) -> Reconstruction {
        let mut model = Reconstruction::default();
        model.cameras.insert(1, camera());
        for k in 0..VIEWS {
            let angle = k as f64 / VIEWS as f64 * std::f64::consts::TAU;
            let eye = scale * DVec3::new(3.0 * angle.cos(), 3.0 * angle.sin(), 1.0);
            let (id, name) = (k as u32 + 1, format!("{k:02}.png"));
            let pose = Pose::look_at(eye, DVec3::ZERO, DVec3::Z);
            model.images.insert(id, PosedImage { id, camera: 1, name, pose, observations: Vec::new() });
        }
        let point = ScenePoint { position: DVec3::ZERO, rgb: [9; 3], error_px: 0.1, track: Vec::new() };
        model.points.insert(1, point);
        model
    }

    /// Whether the ray of a pixel's middle meets a ball.
    fn meets(pose: &Pose, pixel: [u32; 2], centre: DVec3, radius: f64) -> bool {
        let at = DVec2::new(f64::from(pixel[0]), f64::from(pixel[1])) + 0.5;
        pose.transform(centre).cross(camera().ray(at).normalize()).length() < radius
    }

    fn mask(pose: &Pose, k: usize, scale: f64, beside: &[Beside]) -> GrayImage {
        let has_part = beside.contains(&Beside::Part) && !k.is_multiple_of(4);
        let has_shadow = beside.contains(&Beside::Shadow);
        GrayImage::from_fn(160, 120, |x, y| {
            let body = meets(pose, [x, y], DVec3::ZERO, scale * 0.5);
            let part = has_part && meets(pose, [x, y], scale * DVec3::new(0.0, 0.0, 0.75), scale * 0.06);
            let shadow = has_shadow && x > 120 && y > 95;
            Luma([255 * u8::from(body || part || shadow)])
        })
    }

    fn path(folder: &Path, image: &PosedImage) -> PathBuf {
        folder.join(format!("{}.png", image.name))
    }

    fn removed(folder: &Path, model: &Reconstruction) -> RemovedPieces {
        remove_contradicted(folder, model, &Progress::silent()).unwrap()
    }

    /// Writes masks, removes what is contradicted, and returns what was and the masks.
    fn cleaned(name: &str, scale: f64, beside: &[Beside]) -> (RemovedPieces, Vec<GrayImage>) {
        let folder = std::env::temp_dir().join(format!("sat-recon-pieces-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let model = model(scale);
        for (k, image) in model.images.values().enumerate() {
            mask(&image.pose, k, scale, beside).save(path(&folder, image)).unwrap();
        }
        let removed = removed(&folder, &model);
        let masks = model.images.values().map(|image| open(&path(&folder, image)).unwrap()).collect();
        std::fs::remove_dir_all(&folder).unwrap();
        (removed, masks)
    }

    #[test]
    fn a_shadow_goes_and_a_part_that_some_masks_lose_stays_at_any_scale() {
        for scale in [1e-6, 1.0, 1e6] {
            let name = format!("shadow{scale}");
            let (removed, masks) = cleaned(&name, scale, &[Beside::Part, Beside::Shadow]);
            assert_eq!(removed, RemovedPieces { pieces: VIEWS, masks: VIEWS });
            for (k, (mask, image)) in masks.iter().zip(model(scale).images.values()).enumerate() {
                assert!(*mask == self::mask(&image.pose, k, scale, &[Beside::Part]), "mask {k}");
            }
        }
    }

    #[test]
    fn of_a_mask_of_noise_the_larger_pieces_are_judged() {
        let noise = GrayImage::from_fn(120, 90, |x, y| {
            let speck = x.is_multiple_of(4) && y.is_multiple_of(4);
            Luma([255 * u8::from(speck || (x < 40 && y < 40) || ((60..70).contains(&x) && y > 80))])
        });
        let sizes: Vec<usize> = pieces(&noise).iter().map(|p| p.pixels.len()).collect();
        assert_eq!(sizes.len(), RULES.pieces);
        assert!(sizes[0] >= 90 && sizes[1..].iter().all(|n| *n == 1), "{sizes:?}");
    }

    #[test]
    fn masks_of_nothing_and_few_masks_stay_as_they_are() {
        let folder = std::env::temp_dir().join(format!("sat-recon-pieces-few-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (model, both) = (model(1.0), [Beside::Shadow]);
        assert_eq!(removed(&folder, &model), RemovedPieces::default(), "no masks");
        for (k, image) in model.images.values().enumerate().take(7) {
            mask(&image.pose, k, 1.0, &both).save(path(&folder, image)).unwrap();
        }
        assert_eq!(removed(&folder, &model), RemovedPieces::default(), "seven");
        for image in model.images.values() {
            GrayImage::new(160, 120).save(path(&folder, image)).unwrap();
        }
        assert_eq!(removed(&folder, &model), RemovedPieces::default(), "black ones");
        for image in model.images.values() {
            GrayImage::from_pixel(160, 900, Luma([255])).save(path(&folder, image)).unwrap();
        }
        assert_eq!(removed(&folder, &model), RemovedPieces::default(), "of another size");
        std::fs::write(folder.join("00.png.png"), b"no picture").unwrap();
        let error = remove_contradicted(&folder, &model, &Progress::silent()).unwrap_err();
        assert!(error.to_string().contains("00.png.png"), "{error}");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
