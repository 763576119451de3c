//! An Instant NeRF that learns and renders on a graphics adapter: rays are drawn and marched here,
//! all else happens there.

use super::gradient::{RayBatch, TrainingRay};
use super::hash_grid::{CHUNK, FEATURES};
use super::network::{LATENT, LOG_DENSITY, encode_direction};
use super::render::SampleRound;
use super::{InstantNgp, rays};
use crate::FieldError;
use crate::adam::{AdamMoments, AdamRates};
use crate::field::{Kept, RadianceField, StepPlace, StepReport};
use crate::gpu::samples::{DeviceRay, RayResult, SampleArrays, SampleJob};
use crate::gpu::stack::{DeviceLayer, DeviceLayers, DeviceParameters, DeviceStack};
use crate::gpu::{DeviceArray, FieldBatch, FieldKit};
use crate::rays::{Draw, PhotoRays};
use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;
use scene::sh::SH_COUNT;
use serde_json::Value;
use splat::{PinholeView, RenderOutput};
use std::sync::{Arc, Mutex, PoisonError};

/// Samples whose activations are held at a time. Source: chosen by hand: 300 MB in training.
const GROUP: usize = 1 << 17;
/// Layers whose outputs are the density and the colour. Source: derived, see [`layers`].
const OUTPUTS: [usize; 2] = [1, 4];
/// Threads of a group of `hash.wgsl`. Source: as there.
const THREADS: usize = 256;

/// The uniform of `hash.wgsl`, field by field.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct HashJob {
    points: u32,
    width: u32,
}

/// A level as `hash.wgsl` has it.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct DeviceLevel {
    scale: f32,
    strides: [u32; 3],
    dense: u32,
    entries: u32,
    first: u32,
    unused: u32,
}

/// Arrays of a group of samples.
struct NgpWork {
    rows: usize,
    training: bool,
    layers: DeviceLayers,
    samples: SampleArrays,
    points: DeviceArray,
}

/// An Instant NeRF on an adapter.
pub(crate) struct NgpOnDevice {
    /// What is not on the adapter, and what was fetched from it.
    host: InstantNgp,
    kit: Arc<FieldKit>,
    stack: DeviceStack,
    levels: DeviceArray,
    tables: DeviceParameters,
    networks: DeviceParameters,
    work: Mutex<NgpWork>,
}

/// Both networks as one: density in layers 0 and 1, colour in the others.
fn layers(host: &InstantNgp) -> Vec<DeviceLayer> {
    let widths = [host.network.density.widths(), host.network.colour.widths()];
    let mut begin = 0;
    let mut all = Vec::new();
    for (network, widths) in widths.into_iter().enumerate() {
        for (index, w) in widths.windows(2).enumerate() {
            let first = index == 0;
            all.push(DeviceLayer {
                taken: if !first { w[0] } else { network * LATENT },
                beside: first.then(|| (network, w[0] - network * LATENT)),
                outputs: w[1],
                weights: begin,
                bias: None,
                relu: index + 2 < widths.len(),
            });
            begin += w[0] * w[1];
        }
    }
    all
}

impl NgpOnDevice {
    /// The same field on an adapter.
    pub(crate) fn new(host: InstantNgp, kit: &Arc<FieldKit>) -> Result<Self, FieldError> {
        let mut first = 0;
        let levels: Vec<DeviceLevel> = host
            .grid
            .tables
            .iter()
            .map(|table| {
                let l = table.level;
                let (dense, entries) = (u32::from(l.dense), l.entries as u32);
                first += entries;
                let first = first - entries;
                DeviceLevel { scale: l.scale, strides: l.strides, dense, entries, first, unused: 0 }
            })
            .collect();
        let stack = DeviceStack::new(&[host.network.density.inputs(), SH_COUNT], layers(&host));
        let work = NgpWork {
            rows: 0,
            training: false,
            layers: stack.layers(kit, 0, false)?,
            samples: SampleArrays::new(kit)?,
            points: kit.device.array("points", 0)?,
        };
        let [tables, networks] = parameters(&host, kit)?;
        let levels = kit.device.filled("levels", &levels)?;
        Ok(Self { host, kit: kit.clone(), stack, levels, tables, networks, work: Mutex::new(work) })
    }

    fn job(&self, rows: usize) -> SampleJob {
        SampleJob {
            spread_width: SH_COUNT as u32,
            density_width: self.stack.width(OUTPUTS[0]) as u32,
            colour_width: self.stack.width(OUTPUTS[1]) as u32,
            linear_from: self.host.settings.linear_from,
            ..SampleJob::new(rows, true, LOG_DENSITY)
        }
    }

    /// Runs an entry of `hash.wgsl` over the features or their gradients.
    fn hash<'a>(
        &'a self,
        batch: &mut FieldBatch<'a>,
        (entry, rows): (usize, usize),
        (tables, points, features): (&DeviceArray, &DeviceArray, &DeviceArray),
    ) {
        let width = (self.stack.input_width(0) / FEATURES) as u32;
        let job = HashJob { points: rows as u32, width };
        let arrays = [&self.levels, points, tables, features, &self.tables.sums];
        let groups = [rows.div_ceil(THREADS) as u32, self.host.grid.tables.len() as u32, 1];
        batch.run((&self.kit.hash, entry), &job, &arrays, groups);
    }

    /// Encodes points and evaluates layers; the networks are those learnt (`training`) or shown.
    fn forward<'a>(
        &'a self,
        batch: &mut FieldBatch<'a>,
        work: &NgpWork,
        job: &SampleJob,
        (training, with_colours): (bool, bool),
    ) {
        let rows = job.rows as usize;
        let parameters = if training { &self.networks.values } else { self.networks.shown() };
        // Tables are shown as they are learnt, as on the processor.
        self.hash(batch, (0, rows), (&self.tables.values, &work.points, &work.layers.inputs[0]));
        let count = if with_colours { self.stack.len() } else { OUTPUTS[0] + 1 };
        if with_colours {
            work.samples.spread((&self.kit, batch), job, &work.layers, 1);
        }
        self.stack.forward((&self.kit, batch), parameters, &work.layers, rows, 0..count);
        work.samples.shade((&self.kit, batch), job, &work.layers, OUTPUTS);
    }

    /// Colours and densities of the samples of a round of a picture.
    fn shade(&self, round: &SampleRound) -> Result<Vec<[f32; 4]>, FieldError> {
        let mut work = self.work.lock().unwrap_or_else(PoisonError::into_inner);
        let mut all = Vec::with_capacity(round.points.len());
        for (points, owners) in round.points.chunks(GROUP).zip(round.owners.chunks(GROUP)) {
            work.prepare(self, points, false)?;
            work.samples.share(&self.kit, round.directions.as_flattened(), owners)?;
            let mut batch = self.kit.device.batch();
            self.forward(&mut batch, &work, &self.job(points.len()), (false, true));
            batch.submit()?;
            all.extend(self.kit.device.read::<[f32; 4]>(&work.samples.shaded, points.len())?);
        }
        Ok(all)
    }

    /// Densities of points, by the networks that are learnt.
    fn densities(&self, points: &[[f32; 3]]) -> Result<Vec<f32>, FieldError> {
        let mut work = self.work.lock().unwrap_or_else(PoisonError::into_inner);
        let mut all = Vec::with_capacity(points.len());
        for points in points.chunks(GROUP) {
            work.prepare(self, points, false)?;
            work.samples.share(&self.kit, &[0.0; SH_COUNT], &vec![0; points.len()])?;
            let mut batch = self.kit.device.batch();
            self.forward(&mut batch, &work, &self.job(points.len()), (true, false));
            batch.submit()?;
            let shaded = self.kit.device.read::<[f32; 4]>(&work.samples.shaded, points.len())?;
            all.extend(shaded.iter().map(|s| s[3]));
        }
        Ok(all)
    }

    /// Adds the gradients of a step; what each ray says.
    pub(super) fn gradients(&mut self, all: &RayBatch) -> Result<Vec<RayResult>, FieldError> {
        let mut work = self.work.lock().unwrap_or_else(PoisonError::into_inner);
        let mut results = Vec::with_capacity(all.rays.len());
        let mut rays = &all.rays[..];
        while let Some(first) = rays.first() {
            // A ray has fewer samples than a group holds.
            let fitting = rays.iter().take_while(|r| r.begin + r.count - first.begin <= GROUP);
            let (group, rest) = rays.split_at(fitting.count().max(1));
            rays = rest;
            self.group(all, group, &mut work)?;
            results.extend(self.kit.device.read::<RayResult>(&work.samples.results, group.len())?);
        }
        Ok(results)
    }

    fn group(&self, all: &RayBatch, rays: &[TrainingRay], work: &mut NgpWork) -> Result<(), FieldError> {
        let kit = &*self.kit;
        let first = rays[0].begin;
        let rows: usize = rays.iter().map(|r| r.count).sum();
        let of_rays: Vec<[f32; SH_COUNT]> = rays.iter().map(|r| encode_direction(&r.sighting.ray)).collect();
        let owners: Vec<u32> = (0..).zip(rays).flat_map(|(i, r)| std::iter::repeat_n(i, r.count)).collect();
        let of_device: Vec<DeviceRay> =
            rays.iter().map(|r| DeviceRay::new(r.begin - first, r.count, &r.sighting)).collect();
        let steps: Vec<f32> = all.samples[first..first + rows].iter().map(|s| s.dt).collect();
        work.prepare(self, &all.points[first..first + rows], true)?;
        work.samples.share(kit, of_rays.as_flattened(), &owners)?;
        work.samples.sight(kit, &of_device, &steps)?;
        let weight = 1.0 / all.rays.len() as f32;
        let job = SampleJob { rays: rays.len() as u32, weight, ..self.job(rows) };
        let mut batch = kit.device.batch();
        self.forward(&mut batch, work, &job, (true, true));
        self.stack.clear(&mut batch, &work.layers);
        work.samples.composite((kit, &mut batch), &job, &work.layers, OUTPUTS);
        let wanted = [true, false];
        self.stack.backward((kit, &mut batch), &self.networks, &work.layers, rows, &wanted);
        self.hash(&mut batch, (1, rows), (&self.tables.values, &work.points, &work.layers.of_inputs[0]));
        batch.submit()
    }

    /// Adam on networks and tables.
    pub(super) fn descend(&mut self, place: StepPlace) -> Result<(), FieldError> {
        let rates = self.host.rates(place);
        let kit = self.kit.clone();
        let mut batch = kit.device.batch();
        let with_decay = AdamRates { decay: self.host.settings.decay, ..rates };
        self.networks.step(&kit, &mut batch, &with_decay);
        self.tables.step(&kit, &mut batch, &rates);
        batch.submit()
    }

    /// See [`InstantNgp::step`].
    fn step(&mut self, photos: &PhotoRays, place: StepPlace) -> Result<StepReport, FieldError> {
        if place.step.is_multiple_of(self.host.settings.occupancy.every) {
            self.update_occupancy(place)?;
        }
        let sightings = photos.sample(Draw::anywhere(self.host.rays), place.seed, place.step);
        let batch = self.host.march(&sightings, place);
        let results = self.gradients(&batch)?;
        self.descend(place)?;
        let sum = |k: usize| results.iter().map(|r| f64::from(r[k])).sum::<f64>();
        Ok(self.host.report(&batch, [sum(0), sum(1)], sum(2) as usize))
    }

    /// See [`InstantNgp::update_occupancy`].
    fn update_occupancy(&mut self, place: StepPlace) -> Result<(), FieldError> {
        let mut densities = std::mem::take(&mut self.host.occupancy.density);
        let host = &self.host;
        let chosen = densities.par_chunks_mut(CHUNK).enumerate();
        let chosen: Vec<_> = chosen.map(|(index, chunk)| host.revisited(index, chunk, place)).collect();
        let points: Vec<[f32; 3]> = chosen.iter().flat_map(|(_, points)| points).copied().collect();
        let found = self.densities(&points);
        if let Ok(found) = &found {
            let cells = chosen
                .iter()
                .enumerate()
                .flat_map(|(c, (cells, _))| cells.iter().map(move |i| c * CHUNK + i));
            cells.zip(found).for_each(|(i, d)| densities[i] = densities[i].max(*d));
        }
        self.host.occupancy.set_density(densities);
        found.map(|_| ())
    }
}

/// Tables and networks of a field, to an adapter.
fn parameters(host: &InstantNgp, kit: &FieldKit) -> Result<[DeviceParameters; 2], FieldError> {
    let tables: Vec<(&[f32], &AdamMoments)> =
        host.grid.tables.iter().map(|t| (t.values.as_flattened(), &t.moments)).collect();
    let networks: Vec<(&[f32], &AdamMoments)> =
        host.weights.iter().map(Vec::as_slice).zip(&host.moments).collect();
    Ok([DeviceParameters::new(kit, &tables, true)?, DeviceParameters::new(kit, &networks, false)?])
}

impl NgpWork {
    /// Makes room for points and puts them in place.
    fn prepare(
        &mut self,
        field: &NgpOnDevice,
        points: &[[f32; 3]],
        training: bool,
    ) -> Result<(), FieldError> {
        let kit = &*field.kit;
        if points.len() > self.rows || training && !self.training {
            (self.rows, self.training) =
                (self.rows.max(points.len().next_power_of_two()), training || self.training);
            self.layers = field.stack.layers(kit, self.rows, self.training)?;
        }
        kit.device.grown(&mut self.points, 3 * points.len())?;
        kit.device.write(&self.points, points.as_flattened());
        Ok(())
    }
}

impl RadianceField for NgpOnDevice {
    fn train_step(&mut self, photos: &PhotoRays, place: StepPlace) -> Result<StepReport, FieldError> {
        self.step(photos, place)
    }

    fn render(
        &self,
        view: &PinholeView,
        time: f32,
        background: [f32; 3],
    ) -> Result<RenderOutput, FieldError> {
        rays::picture(view, time, (background, rays::LARGE_BLOCK), &|rays, out| {
            self.host.trace(rays, background, out, &mut |round| self.shade(&round))
        })
    }

    fn fetch(&mut self) -> Result<(), FieldError> {
        let host = &mut self.host;
        let tables = host.grid.tables.iter_mut();
        let mut tables: Vec<_> = tables.map(|t| (t.values.as_flattened_mut(), &mut t.moments)).collect();
        self.tables.fetch(&self.kit, &mut tables)?;
        let weights = host.weights.iter_mut().map(Vec::as_mut_slice);
        let mut networks: Vec<_> = weights.zip(&mut host.moments).collect();
        self.networks.fetch(&self.kit, &mut networks)
    }

    fn size(&self) -> usize {
        self.host.size()
    }

    fn arrays(&self, kept: Kept) -> (Vec<&[f32]>, Value) {
        self.host.kept_arrays(kept)
    }

    fn restore(&mut self, kept: Kept, arrays: Vec<Vec<f32>>, notes: &Value) -> Result<(), String> {
        self.host.take_arrays(kept, arrays, notes)?;
        let [tables, networks] = parameters(&self.host, &self.kit).map_err(|e| e.to_string())?;
        (self.tables, self.networks) = (tables, networks);
        Ok(())
    }
}

#[cfg(test)]
impl NgpOnDevice {
    pub(super) fn host(&self) -> &InstantNgp {
        &self.host
    }

    pub(super) fn network_gradient(&self) -> Vec<f32> {
        self.networks.read_gradient(&self.kit)
    }

    pub(super) fn table_gradient(&self) -> Vec<f32> {
        self.tables.read_gradient(&self.kit)
    }

    /// Colours of a batch's rays.
    pub(super) fn colours(&self, batch: &RayBatch) -> Vec<f32> {
        let directions: Vec<_> = batch.rays.iter().map(|r| encode_direction(&r.sighting.ray)).collect();
        let owners: Vec<u32> =
            (0..).zip(&batch.rays).flat_map(|(i, r)| std::iter::repeat_n(i, r.count)).collect();
        let round = SampleRound { points: &batch.points, owners: &owners, directions: &directions };
        let shaded = self.shade(&round).unwrap();
        let all = batch.rays.iter().flat_map(|ray| {
            let own = ray.begin..ray.begin + ray.count;
            let dt = |i: usize| batch.samples[i].dt;
            let densities = own.clone().map(|i| shaded[i][3]);
            let count = crate::composite::seen(densities, own.clone().map(dt));
            let samples = own.take(count).map(|i| {
                let [r, g, b, density] = shaded[i];
                (density, dt(i), 0.0, [r, g, b])
            });
            crate::composite::compose(samples, ray.sighting.background).rgb
        });
        all.collect()
    }
}
