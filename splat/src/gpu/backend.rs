//! The backend: uploads, frames, steps, downloads.

use super::bound::{Bound, Stage};
use super::buffers::{Buffers, Limit, PHOTOS, Sizes, capacity, tiles};
use super::context::{Gpu, Opening};
use super::flight::{Flight, Pending, Report, WINDOW};
use super::kernels::Kernels;
use super::layout::{BLOCK, Counter, Frame, FrameFlag};
use super::pages::Pages;
use super::photos::{Photos, PlacedPhoto};
use crate::backend::{Backend, KernelTimes, Round, StepInput, StepOutput, Target, check};
use crate::camera::CameraConstants;
use crate::cpu::densify::densify_by_edit;
use crate::error::SplatError;
use crate::model::Model;
use crate::statistics::Statistics;
use crate::view::{PinholeView, RenderOptions, RenderOutput};
use scene::Decision;
use scene::FloatImage;
use std::ops::RangeInclusive;

/// What lies on the device for the view, and how the kernels are bound to it and to the model.
pub(super) type Screen = (Buffers, Bound);

/// The GPU backend. The model lives on the device; a copy stays on the host only until the first
/// step.
pub(crate) struct GpuBackend {
    pub(super) gpu: Gpu,
    pub(super) kernels: Kernels,
    pub(super) sizes: Sizes,
    sh_degree: u32,
    pub(super) pages: Option<Pages>,
    pub(super) screen: Option<Screen>,
    /// The model as uploaded, while the device has no moments.
    untrained: Option<(Model, Statistics)>,
    pub(super) photos: Photos,
    flight: Flight,
    /// Steps that may be under way: few after a change, in case its pairs need room.
    window: usize,
    /// What steps saw that nobody asked for yet.
    done: Vec<StepOutput>,
    /// What had to be done otherwise than asked for.
    pub(super) remarks: Vec<Decision>,
    pub(super) limit: Option<u64>,
    gain: Option<[f32; 3]>,
    /// Pairs for which there will be more room before the next view: what lies on the screen is
    /// lost where buffers grow.
    pub(super) crowded: usize,
    /// [`FrameFlag::Truncate`] once there is no room for all pairs.
    pub(super) truncate: u32,
}

impl GpuBackend {
    /// Opens an adapter and compiles the kernels.
    pub(crate) fn open(opening: &Opening) -> Result<Self, SplatError> {
        let gpu = Gpu::open(opening)?;
        let kernels = Kernels::new(&gpu)?;
        let flight = Flight::new(&gpu)?;
        gpu.check()?;
        Ok(Self {
            gpu,
            kernels,
            sizes: Sizes::default(),
            sh_degree: 0,
            pages: None,
            screen: None,
            untrained: None,
            photos: Photos::default(),
            flight,
            window: 1,
            done: Vec::new(),
            remarks: Vec::new(),
            limit: opening.memory,
            gain: None,
            crowded: 0,
            truncate: 0,
        })
    }

    /// Room for Gaussians, pairs and pixels. What stays of the same size keeps its contents.
    pub(super) fn resize(&mut self, needed: Sizes) -> Result<(), SplatError> {
        if self.screen.is_some() && self.sizes.hold(&needed) {
            return Ok(());
        }
        let sizes = Sizes {
            room: needed.room.max(self.sizes.room),
            pairs: needed.pairs.max(self.sizes.pairs).max(BLOCK as usize),
            pixels: needed.pixels.max(self.sizes.pixels).max(1),
            tiles: needed.tiles.max(self.sizes.tiles).max(1),
            training: needed.training || self.sizes.training,
        };
        let old = self.screen.take().map(|(buffers, _)| buffers);
        let buffers = Buffers::new(&self.gpu, &sizes, old)?;
        self.sizes = sizes;
        self.bind(buffers);
        self.gpu.check()
    }

    /// The same, but where there is no memory for it everything stays as it is: `false`.
    pub(super) fn try_resize(&mut self, sizes: Sizes) -> Result<bool, SplatError> {
        let before = self.sizes;
        match self.resize(sizes) {
            Ok(()) => Ok(true),
            Err(_) if self.gpu.check().is_ok() => {
                self.sizes = before;
                self.screen = None;
                self.resize(before).map(|()| false)
            }
            Err(error) => Err(error),
        }
    }

    /// Binds the kernels anew: after a change of the model's buffers or the view's.
    pub(super) fn bind(&mut self, buffers: Buffers) {
        if let Some(pages) = &self.pages {
            let bound = Bound::new(&self.gpu, &self.kernels, &buffers, pages, &self.sizes);
            self.screen = Some((buffers, bound));
        }
    }

    /// The model in other pages: more or fewer Gaussians, another degree.
    pub(super) fn turn(&mut self, pages: Pages) -> Result<(), SplatError> {
        let room = pages.n;
        self.pages = Some(pages);
        // Bound to the old pages.
        if let Some((buffers, _)) = self.screen.take() {
            self.bind(buffers);
        }
        self.window = 1;
        self.resize(Sizes { room: self.roomy(room), ..self.sizes })
    }

    /// Room for `n` Gaussians and some that will come, unless there is room already.
    pub(super) fn roomy(&self, n: usize) -> usize {
        let more = if n <= self.sizes.room { self.sizes.room } else { n + n / 4 };
        let plan = Buffers::plan(&Sizes { room: more, ..self.sizes });
        let largest = plan.iter().map(|b| b.1).max().unwrap_or(0);
        let total: u64 = plan.iter().map(|b| b.1).sum();
        let fits = largest <= self.gpu.largest_buffer() && self.limit.is_none_or(|limit| total < limit / 2);
        if fits { more } else { n.max(self.sizes.room) }
    }

    /// Makes room for a view, and for moments before the first step.
    pub(super) fn prepare(&mut self, view: &PinholeView, training: bool) -> Result<(), SplatError> {
        let (pixels, tiles) = (view.width * view.height, tiles(view.width, view.height));
        if self.crowded > 0 {
            self.settle_all()?;
            self.widen()?;
        }
        if training && let Some((model, statistics)) = self.untrained.take() {
            self.settle_all()?;
            let pages = Pages::new(&self.gpu, model.len, model.sh_stride(), true)?;
            pages.upload(&self.gpu, &model, &statistics);
            self.turn(pages)?;
        }
        let needed = Sizes { pixels, tiles, training, ..self.sizes };
        if self.screen.is_none() || !self.sizes.hold(&needed) {
            self.settle_all()?;
            self.window = 1;
        }
        self.resize(needed)
    }

    pub(super) fn frame_of(&self, view: &PinholeView, options: &RenderOptions) -> Frame {
        let camera = CameraConstants::new(view, options, self.sh_degree);
        let [r, g, b] = options.background;
        let [ur, ug, ub] = self.gain.unwrap_or([1.0; 3]).map(f32::recip);
        let (n, sh_stride) = self.pages.as_ref().map_or((0, 3), |p| (p.n, p.sh_stride));
        Frame {
            background: [r, g, b, 0.0],
            unit: [ur, ug, ub, 1.0],
            n: n as u32,
            sh_stride: sh_stride as u32,
            ..Frame::of_camera(&camera)
        }
    }

    fn submit(&mut self, mut step: Pending) {
        step.frame.pair_capacity = self.sizes.pairs as u32;
        let keep = if self.sizes.training { FrameFlag::Keep as u32 } else { 0 };
        step.frame.flags |= self.truncate | keep;
        if let Some((buffers, bound)) = &self.screen {
            self.flight.submit(&self.gpu, &self.kernels, (buffers, bound), step);
        }
    }

    /// Waits for the steps under way and notes what they saw. Where pairs did not fit nothing has
    /// moved: those steps are repeated with more room, or without the farthest pairs where there is
    /// no more. Returns the last one's report.
    pub(super) fn settle_all(&mut self) -> Result<Report, SplatError> {
        let mut last = Report::default();
        loop {
            let finished = self.flight.collect(&self.gpu)?;
            let most = finished.iter().map(|(_, report)| report.pairs()).max().unwrap_or(0);
            let mut again = Vec::new();
            for (step, report) in finished {
                let overfull = report.pairs() > step.frame.pair_capacity as usize;
                let halted =
                    *step.stages.end() == Stage::Optimise && report.counters[Counter::Halt as usize] != 0;
                if (overfull && step.frame.flags & FrameFlag::Truncate as u32 == 0) || halted {
                    again.push(step);
                    continue;
                }
                last = report;
                if let (Some(lambda), Some(photo)) = (step.step, &step.photo) {
                    let (loss, mse) = report.loss(photo.weights, lambda);
                    let [visible, non_finite] = [Counter::Visible, Counter::NonFinite]
                        .map(|counter| report.counters[counter as usize] as usize);
                    let pairs = report.pairs();
                    self.done.push(StepOutput {
                        loss,
                        mse,
                        visible,
                        pairs,
                        non_finite,
                        ..StepOutput::default()
                    });
                }
            }
            if most > self.sizes.pairs / 8 * 7 {
                self.crowded = most;
            }
            if again.is_empty() {
                return Ok(last);
            }
            self.widen()?;
            self.window = 1;
            if let Some((buffers, _)) = &self.screen {
                self.gpu.write(&buffers.counters, 4 * Counter::Halt as u64, &[0u32]);
            }
            again.into_iter().for_each(|step| self.submit(step));
        }
    }

    /// Runs the stages and waits for them.
    pub(super) fn run(
        &mut self,
        frame: Frame,
        stages: RangeInclusive<Stage>,
        photo: Option<PlacedPhoto>,
    ) -> Result<Report, SplatError> {
        self.settle_all()?;
        self.submit(Pending { frame, stages, photo, step: None });
        self.settle_all()
    }

    /// Puts the target on the device, if it is not there yet.
    pub(super) fn place(&mut self, target: &Target) -> Option<PlacedPhoto> {
        let budget = self.limit.map(|limit| (limit as f64 * PHOTOS) as u64);
        let (buffers, _) = self.screen.as_ref()?;
        Some(self.photos.place(&self.gpu, &buffers.goal, target, budget))
    }

    fn begin(&mut self, input: &StepInput) -> Result<(), SplatError> {
        self.prepare(input.view, true)?;
        let resident = input.target.photo.is_some();
        if !resident {
            self.settle_all()?; // the goal is overwritten
        }
        let Some(photo) = self.place(&input.target) else { return Ok(()) };
        let inverse = if photo.weights > 0.0 { 1.0 / (3.0 * photo.weights) } else { 0.0 };
        let frame = self.frame_of(input.view, &input.options);
        let frame = Frame {
            flags: frame.flags | photo.flags,
            lambda: input.lambda_dssim,
            inv_count: inverse as f32,
            rate_mean: input.rates.mean,
            rate_log_scale: input.rates.log_scale,
            rate_rotation: input.rates.rotation,
            rate_opacity: input.rates.opacity,
            rate_sh0: input.rates.sh0,
            rate_sh_rest: input.rates.sh_rest,
            ..frame
        };
        let stays = photo.shelf.is_some();
        let stages = Stage::Project..=Stage::Optimise;
        self.submit(Pending { frame, stages, photo: Some(photo), step: Some(input.lambda_dssim) });
        if !stays || self.flight.count() >= self.window {
            self.settle_all()?;
            self.window = (2 * self.window).min(WINDOW);
        }
        Ok(())
    }

    /// Lets the host change the model.
    fn edit_on_host(
        &mut self,
        change: &mut dyn FnMut(&mut Model, &mut Statistics),
    ) -> Result<(), SplatError> {
        let (mut model, mut statistics) = self.download()?;
        change(&mut model, &mut statistics);
        statistics.fit(model.len);
        self.upload(model, statistics)
    }
}

impl Backend for GpuBackend {
    fn name(&self) -> String {
        self.gpu.adapter.to_string()
    }

    fn upload(&mut self, model: Model, statistics: Statistics) -> Result<(), SplatError> {
        check(&model, &statistics)?;
        self.settle_all()?;
        self.sh_degree = model.sh_degree;
        let training = self.sizes.training;
        self.pages = None; // its memory may be needed
        let pages = Pages::new(&self.gpu, model.len, model.sh_stride(), training)?;
        pages.upload(&self.gpu, &model, &statistics);
        self.untrained = (!training).then_some((model, statistics));
        self.turn(pages)
    }

    fn download(&mut self) -> Result<(Model, Statistics), SplatError> {
        self.settle_all()?;
        if let Some(held) = &self.untrained {
            return Ok(held.clone());
        }
        self.pages.as_ref().map_or_else(|| Ok(Default::default()), |p| p.download(&self.gpu, self.sh_degree))
    }

    fn edit(&mut self, change: &mut dyn FnMut(&mut Model, &mut Statistics)) -> Result<(), SplatError> {
        self.edit_on_host(change)
    }

    fn densify(&mut self, round: &Round) -> Result<usize, SplatError> {
        self.settle_all()?;
        match self.densify_here(round)? {
            Some(unseen) => Ok(unseen),
            None => densify_by_edit(self, round),
        }
    }

    fn set_sh_degree(&mut self, degree: u32) -> Result<(), SplatError> {
        self.settle_all()?;
        let stride = 3 * (degree.min(3) as usize + 1).pow(2);
        let turned = match (&self.pages, &self.untrained) {
            (Some(pages), None) => pages.with_sh_stride(&self.gpu, stride)?,
            _ => None,
        };
        match turned {
            Some(pages) => {
                self.sh_degree = degree.min(3);
                self.turn(pages)
            }
            None => self.edit_on_host(&mut |model, _| model.set_sh_degree(degree)),
        }
    }

    fn gaussians(&self) -> usize {
        self.pages.as_ref().map_or(0, |p| p.n)
    }

    fn sh_degree(&self) -> u32 {
        self.sh_degree
    }

    fn capacity(&self, sh_degree: u32, pixels: usize) -> Option<(usize, String)> {
        let largest = self.gpu.largest_buffer();
        let (most, limit) = capacity(3 * (sh_degree as usize + 1).pow(2), pixels, largest, self.limit);
        Some((
            most,
            match limit {
                Limit::Binding => format!("a buffer of {} may have {} MiB", self.gpu.adapter, largest >> 20),
                Limit::Memory => format!("--vram-limit {}", self.limit.unwrap_or(0) >> 20),
            },
        ))
    }

    fn render(&mut self, view: &PinholeView, options: &RenderOptions) -> Result<RenderOutput, SplatError> {
        self.render_only(view, options)?;
        self.settle_all()?;
        let (w, h) = (view.width, view.height);
        let mut out = RenderOutput {
            rgb: FloatImage::zeros(w, h, 3),
            alpha: FloatImage::zeros(w, h, 1),
            depth: FloatImage::zeros(w, h, 1),
        };
        let Some((b, _)) = &self.screen else { return Ok(out) };
        let image: Vec<[f32; 4]> = self.gpu.read(&b.image, 0, w * h)?;
        for (i, [red, green, blue, clear]) in image.into_iter().enumerate() {
            out.rgb.data[3 * i..3 * i + 3].copy_from_slice(&[red, green, blue]);
            out.alpha.data[i] = 1.0 - clear;
        }
        out.depth.data = self.gpu.read(&b.depth, 0, w * h)?;
        Ok(out)
    }

    fn render_only(&mut self, view: &PinholeView, options: &RenderOptions) -> Result<(), SplatError> {
        self.prepare(view, false)?;
        let frame = self.frame_of(view, options);
        let stages = Stage::Project..=Stage::Forward;
        self.submit(Pending { frame, stages, photo: None, step: None });
        if self.flight.count() >= self.window {
            self.settle_all()?;
            self.window = (2 * self.window).min(WINDOW);
        }
        Ok(())
    }

    fn memory(&self) -> Vec<(&'static str, u64)> {
        let mut all = self.pages.as_ref().map_or_else(Vec::new, Pages::memory);
        if self.screen.is_some() {
            all.extend(Buffers::plan(&self.sizes));
        }
        all.push(("photos", self.photos.memory()));
        all
    }

    fn step(&mut self, input: &StepInput) -> Result<StepOutput, SplatError> {
        self.begin(input)?;
        self.settle_all()?;
        // Earlier steps' outputs are left to those who ask for them.
        self.done.pop().ok_or_else(|| self.gpu.error("a step was not taken"))
    }

    fn advance(&mut self, input: &StepInput) -> Result<Vec<StepOutput>, SplatError> {
        self.begin(input)?;
        Ok(std::mem::take(&mut self.done))
    }

    fn settle(&mut self) -> Result<Vec<StepOutput>, SplatError> {
        self.settle_all()?;
        Ok(std::mem::take(&mut self.done))
    }

    fn mean_square_error(
        &mut self,
        view: &PinholeView,
        target: &Target,
        options: &RenderOptions,
    ) -> Result<f64, SplatError> {
        self.prepare(view, true)?;
        self.settle_all()?;
        let Some(photo) = self.place(target) else { return Ok(0.0) };
        let (frame, weights) = (self.frame_of(view, options), photo.weights);
        let frame = Frame { flags: frame.flags | photo.flags, ..frame };
        let report = self.run(frame, Stage::Project..=Stage::Loss, Some(photo))?;
        Ok(f64::from(report.loss(weights, 0.0).1))
    }

    fn products(
        &mut self,
        view: &PinholeView,
        target: &Target,
        options: &RenderOptions,
    ) -> Result<[[f64; 3]; 3], SplatError> {
        self.set_gain(None);
        self.prepare(view, true)?;
        self.settle_all()?;
        let Some(photo) = self.place(target) else { return Ok([[0.0; 3]; 3]) };
        let frame = self.frame_of(view, options);
        let frame = Frame { flags: frame.flags | photo.flags, ..frame };
        let report = self.run(frame, Stage::Project..=Stage::Products, Some(photo))?;
        Ok(std::array::from_fn(|k| std::array::from_fn(|c| f64::from(report.sums[c][k]))))
    }

    fn opacity_gradients(
        &mut self,
        view: &PinholeView,
        options: &RenderOptions,
        gradient: &[f32],
    ) -> Result<Vec<f32>, SplatError> {
        self.logit_gradients(view, options, gradient)
    }

    fn set_gain(&mut self, gain: Option<[f32; 3]>) {
        self.gain = gain;
    }

    fn times(&self) -> KernelTimes {
        self.flight.times
    }

    fn remarks(&mut self) -> Vec<Decision> {
        std::mem::take(&mut self.remarks)
    }
}
