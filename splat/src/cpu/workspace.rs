//! The buffers of a view and the kernels run over them in parallel.

use super::adam::{Adam, adam};
use super::dispatch::Isa;
use super::loss::{LossInput, LossValue, loss};
use super::model_part::ModelPart;
use super::model_part::PART;
use super::project::{CULLED, Project, Record, project};
use super::rasterise::{Backward, Forward, SUMS, Visit, backward, forward, visit};
use super::shared::SharedSlice;
use super::sort::Bins;
use super::target::{TargetSource, compose, reached_tiles};
use super::tile::{ACROSS, PIXELS, PlaneShape, TILE, Tile, TilePlane};
use crate::backend::Target;
use crate::camera::PartCameras;
use crate::model::Model;
use crate::parts::PartPulls;
use rayon::prelude::*;
use std::sync::Mutex;

/// Everything that lives between the kernels of a step. Kept between steps, so that nothing is
/// allocated in the loop. Invariant: every plane that is in use has the size that `shape` says, and
/// `used` an entry a tile.
#[derive(Debug, Default)]
pub(super) struct KernelWorkspace {
    records: Vec<Record>,
    keys: Vec<u32>,
    bins: Bins,
    shape: PlaneShape,
    rgb: [Vec<f32>; 3],
    transmittance: Vec<f32>,
    depth: Vec<f32>,
    used: Vec<u32>,
    /// Tiles that weights reach; empty: all.
    reached: Vec<bool>,
    target: [Vec<f32>; 3],
    weight: Vec<f32>,
    gradient: [Vec<f32>; 3],
    sums: Vec<[f32; SUMS]>,
    /// Of the loss.
    parts: Vec<[f64; 3]>,
    /// Targets are divided by this.
    pub(super) gain: Option<[f32; 3]>,
    /// What pulls at moving parts, by groups of Gaussians.
    pulls: Vec<Mutex<PartPulls>>,
}

/// The picture that the last [`KernelWorkspace::forward`] drew: planes whose rows are `stride`
/// apart.
pub(super) struct DrawnPlanes<'a> {
    pub(super) stride: usize,
    pub(super) rgb: &'a [Vec<f32>; 3],
    pub(super) transmittance: &'a [f32],
    pub(super) depth: &'a [f32],
}

/// What it is compared with, and what of it counts.
pub(super) struct TargetPlanes<'a> {
    pub(super) target: &'a [Vec<f32>; 3],
    pub(super) weight: Option<&'a [f32]>,
}

impl KernelWorkspace {
    /// The Gaussians' records and depth keys.
    pub(super) fn project(&mut self, isa: Isa, model: &Model, cameras: &PartCameras) {
        self.records.resize(model.len, Record::default());
        self.keys.resize(model.len, CULLED);
        let chunks = self.records.par_chunks_mut(PART).zip(self.keys.par_chunks_mut(PART)).enumerate();
        chunks.for_each(|(chunk, (records, keys))| {
            project(isa, &mut Project { model, cameras, start: chunk * PART, records, keys });
        });
    }

    /// Sorts them and puts them into the tiles of an image.
    pub(super) fn sort(&mut self, width: usize, height: usize) {
        self.bins.fill(&self.keys, &self.records, width, height);
        self.shape = PlaneShape { width, height };
        let plane = self.shape.plane();
        for planes in [&mut self.rgb, &mut self.target, &mut self.gradient] {
            planes.iter_mut().for_each(|p| p.resize(plane, 0.0));
        }
        self.transmittance.resize(plane, 1.0);
        self.used.resize(plane / PIXELS, 0);
    }

    /// Gaussians that touch a tile, and Gaussian–tile pairs.
    pub(super) fn visible_and_pairs(&self) -> [usize; 2] {
        [self.bins.visible(), self.bins.pairs()]
    }

    /// The last picture; its depth only where it was asked for.
    pub(super) fn drawn(&self) -> DrawnPlanes<'_> {
        let stride = self.shape.stride();
        DrawnPlanes { stride, rgb: &self.rgb, transmittance: &self.transmittance, depth: &self.depth }
    }

    /// Rasterises all tiles that count for a target (all of them without one); the others keep what
    /// they show.
    pub(super) fn forward(
        &mut self,
        isa: Isa,
        background: [f32; 3],
        target: Option<&Target>,
        with_depth: bool,
    ) {
        self.reached.clear();
        if let Some(Target { mask: Some(mask), transparent: false, .. }) = target {
            reached_tiles(mask, self.shape, &mut self.reached);
        }
        self.depth.resize(if with_depth { self.shape.plane() } else { 0 }, 0.0);
        let (shape, records, bins, reached) = (self.shape, &self.records, &self.bins, &self.reached);
        let rgb = self.rgb.each_mut().map(|p| SharedSlice::new(p.as_mut_slice()));
        let transmittance = SharedSlice::new(self.transmittance.as_mut_slice());
        let depth = with_depth.then(|| SharedSlice::new(self.depth.as_mut_slice()));
        self.used.par_iter_mut().enumerate().for_each(|(t, used)| {
            if reached.get(t) == Some(&false) {
                *used = 0;
                return;
            }
            let tile = shape.tile(t);
            let (mut colour, mut clear, mut far) =
                ([TilePlane::filled(0.0); 3], TilePlane::filled(1.0), TilePlane::filled(0.0));
            let mut a = Forward {
                records,
                list: bins.gaussians_of(t),
                tile,
                background,
                rgb: &mut colour,
                transmittance: &mut clear,
                depth: with_depth.then_some(&mut far),
                used: 0,
            };
            forward(isa, &mut a);
            *used = a.used as u32;
            // SAFETY: tiles do not overlap, and each is drawn by one task.
            unsafe {
                for (plane, values) in rgb.iter().zip(&colour) {
                    scatter(values, plane, &tile);
                }
                scatter(&clear, &transmittance, &tile);
                if let Some(depth) = &depth {
                    scatter(&far, depth, &tile);
                }
            }
        });
    }

    /// Gaussian–pixel pairs that the last [`KernelWorkspace::forward`] evaluated.
    pub(super) fn gaussian_pixels(&self, isa: Isa) -> u64 {
        let mut pixels = 0;
        for (t, &used) in self.used.iter().enumerate() {
            let list = &self.bins.gaussians_of(t)[..used as usize];
            let mut a = Visit { records: &self.records, list, tile: self.shape.tile(t), pixels: 0 };
            visit(isa, &mut a);
            pixels += a.pixels;
        }
        pixels
    }

    /// Target planes (and weights) from 8-bit pixels, composed over the background where masks mean
    /// transparency.
    pub(super) fn set_target(&mut self, isa: Isa, target: &Target, background: [f32; 3]) {
        let weighted = target.mask.is_some() && !target.transparent;
        self.weight.resize(if weighted { self.shape.plane() } else { 0 }, 0.0);
        let source = TargetSource { shape: self.shape, target, background, gain: self.gain };
        compose(isa, &source, &self.rgb, &mut self.target, &mut self.weight);
    }

    /// What [`KernelWorkspace::set_target`] made.
    pub(super) fn target(&self) -> TargetPlanes<'_> {
        let weight = Some(self.weight.as_slice()).filter(|weight| !weight.is_empty());
        TargetPlanes { target: &self.target, weight }
    }

    /// The loss of the picture against the target, and dL/d(colour).
    pub(super) fn loss(&mut self, isa: Isa, lambda: f32) -> LossValue {
        let weight = Some(self.weight.as_slice()).filter(|weight| !weight.is_empty());
        let input = LossInput { shape: self.shape, rgb: &self.rgb, target: &self.target, weight, lambda };
        loss(isa, &input, &mut self.gradient, &mut self.parts)
    }

    /// dL/d(colour), [height × width × 3], from elsewhere.
    pub(super) fn set_gradient(&mut self, gradient: &[f32]) {
        let (width, stride) = (self.shape.width, self.shape.stride());
        for (c, plane) in self.gradient.iter_mut().enumerate() {
            plane.fill(0.0);
            for (i, pixel) in gradient.chunks_exact(3).enumerate() {
                plane[i / width * stride + i % width] = pixel[c];
            }
        }
    }

    /// Sums of all pairs from dL/d(colour).
    pub(super) fn backward(&mut self, isa: Isa) {
        let (shape, records, bins, used) = (self.shape, &self.records, &self.bins, &self.used);
        let (rgb, gradient) = (&self.rgb, &self.gradient);
        self.sums.resize(bins.pairs(), [0.0; SUMS]);
        let all = SharedSlice::new(self.sums.as_mut_slice());
        (0..used.len()).into_par_iter().for_each(|t| {
            let used = used[t] as usize;
            // SAFETY: the pairs of tiles do not overlap, and each tile is worked on by one task.
            let sums = unsafe { all.part(bins.pairs_of(t)) };
            sums[used..].fill([0.0; SUMS]);
            if used == 0 {
                return;
            }
            let tile = shape.tile(t);
            let local = gradient.each_ref().map(|plane| tile.gather(plane));
            let mut remaining = TilePlane::filled(0.0);
            for (gradient, plane) in local.iter().zip(rgb) {
                let colour = tile.gather(plane);
                for i in 0..PIXELS {
                    remaining.0[i] += colour.0[i] * gradient.0[i];
                }
            }
            let list = &bins.gaussians_of(t)[..used];
            let sums = &mut sums[..used];
            let remaining = &mut remaining;
            backward(isa, &mut Backward { records, list, tile, gradient: &local, remaining, sums });
        });
    }

    /// `o dL/do` of Gaussian `i`, after [`KernelWorkspace::backward`].
    pub(super) fn opacity_sum(&self, i: usize) -> f32 {
        self.bins.positions_of(i).iter().map(|&position| self.sums[position as usize][0]).sum()
    }

    /// project backward and Adam (or plain gradients); returns how many gradients were not finite,
    /// and what pulls at moving parts. Their sums do not depend on how the work is shared out.
    pub(super) fn optimise(
        &mut self,
        isa: Isa,
        model: ModelPart,
        cameras: &PartCameras,
    ) -> (usize, PartPulls) {
        let groups = if cameras.moving() > 0 { model.count.div_ceil(PART) } else { 0 };
        self.pulls.clear();
        self.pulls.resize_with(groups, Default::default);
        let parts = rayon::iter::split(model, ModelPart::halve);
        let steps = parts.map(|part| {
            let (bins, keys, sums, pulls) = (&self.bins, &self.keys, &self.sums, &self.pulls[..]);
            let mut a = Adam { part, cameras, bins, keys, sums, pulls, non_finite: 0 };
            adam(isa, &mut a);
            a.non_finite
        });
        let non_finite = steps.sum();
        let mut all = PartPulls::default();
        for group in &mut self.pulls {
            let group = group.get_mut().unwrap_or_else(std::sync::PoisonError::into_inner);
            all.iter_mut().zip(group.iter()).for_each(|(sum, pull)| sum.add(pull));
        }
        (non_finite, all)
    }
}

/// # Safety
/// No other task uses the tile's pixels of the plane.
unsafe fn scatter(values: &TilePlane, plane: &SharedSlice<f32>, tile: &Tile) {
    for y in 0..TILE {
        // SAFETY: the row is the tile's, of which the caller vouches that no other task uses it.
        let row = unsafe { plane.part(tile.row(y)..tile.row(y) + TILE) };
        for (to, from) in row.chunks_exact_mut(ACROSS).zip(values.row(y)) {
            to.copy_from_slice(from);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::{PinholeView, RenderOptions};
    use glam::{Mat3, Quat, Vec3};
    use rand::Rng as _;
    use scene::Gaussians;

    fn gaussians(n: usize) -> Gaussians {
        let mut rng = scene::rng::rng(3, "reach", 0);
        let mut of =
            |low: f32, high: f32| Vec3::from_array(std::array::from_fn(|_| rng.random_range(low..high)));
        let mut g = Gaussians::default();
        for _ in 0..n {
            g.means.push(of(-1.0, 1.0));
            g.log_scales.push(of(-4.0, -1.5));
            g.rotations.push(Quat::from_scaled_axis(of(-1.0, 1.0)));
            g.opacity_logits.push(of(-2.0, 2.0).x);
            g.sh.extend(of(-1.0, 1.0).to_array());
        }
        g
    }

    /// A picture whose weights leave most tiles out has the gradients that it has when all tiles
    /// are drawn.
    #[test]
    fn tiles_that_no_weight_reaches_have_no_part_in_the_gradient() {
        let (width, height) = (100, 70);
        let view = PinholeView {
            rotation: Mat3::IDENTITY,
            translation: Vec3::new(0.0, 0.0, 3.0),
            focal: [90.0; 2],
            centre: [50.0, 35.0],
            width,
            height,
            parts: crate::parts::PartPlaces::NONE,
        };
        let rgb: Vec<u8> = (0..width * height * 3).map(|i| (i * 37 % 251) as u8).collect();
        let mask: Vec<u8> = (0..width * height)
            .map(|i| if (30..44).contains(&(i % width)) && i / width > 50 { 200 } else { 0 })
            .collect();
        let target = Target { rgb: &rgb, mask: Some(&mask), transparent: false, photo: None };
        let (isa, model) = (Isa::best(), Model::from_gaussians(&gaussians(300)));
        let cameras = PartCameras::new(&view, &RenderOptions::default(), 0);
        let mut work = KernelWorkspace::default();
        work.project(isa, &model, &cameras);
        work.sort(width, height);
        let mut found: Vec<(f32, Vec<[f32; SUMS]>, usize)> = Vec::new();
        for counted in [None, Some(&target)] {
            work.forward(isa, [0.0; 3], counted, false);
            work.set_target(isa, &target, [0.0; 3]);
            let loss = work.loss(isa, 0.2).loss;
            work.backward(isa);
            let drawn = work.used.iter().filter(|&&u| u > 0).count();
            found.push((loss, work.sums.clone(), drawn));
        }
        assert!(found[0].2 > 30 && found[1].2 <= 9, "{} and {} tiles", found[0].2, found[1].2);
        assert_eq!(found[0].0, found[1].0);
        assert!(found[0].1.iter().any(|sums| sums[0] != 0.0));
        for (all, some) in found[0].1.iter().zip(&found[1].1) {
            assert_eq!(all[..9], some[..9]);
        }
    }
}
