//! A NeRF or D-NeRF that learns and renders on a graphics adapter: rays and depths are drawn here,
//! all else happens there.

use super::depths::{refine, weights};
use super::gradient::SightedRay;
use super::network::{NerfRay, POSITION_OCTAVES, TIME_OCTAVES, TRUNK};
use super::{Nerf, rays};
use crate::FieldError;
use crate::field::{Kept, RadianceField, StepPlace, StepReport};
use crate::gpu::samples::{DeviceRay, RayResult, SampleArrays, SampleJob};
use crate::gpu::stack::{DeviceLayers, DeviceParameters, DeviceStack};
use crate::gpu::{DeviceArray, FieldBatch, FieldKit};
use crate::rays::PhotoRays;
use bytemuck::{Pod, Zeroable};
use serde_json::Value;
use splat::{PinholeView, RenderOutput};
use std::sync::{Arc, Mutex, PoisonError};

/// Samples whose activations are held at a time. Source: chosen by hand: 340 MB at the papers'
/// sizes in training, twice that where something is deformed.
const GROUP: usize = 1 << 14;
/// Layers whose outputs are the density and the colour. Source: derived, see the network.
const OUTPUTS: [usize; 2] = [TRUNK, TRUNK + 2];
/// Threads of a group of `waves.wgsl`. Source: as there.
const THREADS: usize = 64;

/// The uniform of `waves.wgsl`, field by field.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct WaveJob {
    rows: u32,
    width: u32,
    moves_width: u32,
    octaves: u32,
    time_octaves: u32,
}

/// Where the samples of a step lie: drawn in the order in which the processor draws them.
#[derive(Clone, Debug, Default)]
pub(super) struct DrawnDepths {
    /// Coarse depths, as many a ray.
    pub(super) coarse: Vec<f32>,
    /// Offsets of the fine depths, as many a ray.
    pub(super) offsets: Vec<f32>,
}

/// Arrays of a group of samples.
struct NerfWork {
    rows: usize,
    training: bool,
    radiance: DeviceLayers,
    deformation: Option<DeviceLayers>,
    samples: SampleArrays,
    points: DeviceArray,
    spare: [DeviceArray; 3],
}

/// A NeRF or D-NeRF on an adapter.
pub(crate) struct NerfOnDevice {
    /// What is not on the adapter, and what was fetched from it.
    host: Nerf,
    kit: Arc<FieldKit>,
    radiance: DeviceStack,
    deformation: Option<DeviceStack>,
    /// As the host's weights.
    parameters: [DeviceParameters; 2],
    work: Mutex<NerfWork>,
}

fn parameters(host: &Nerf, kit: &FieldKit) -> Result<[DeviceParameters; 2], FieldError> {
    let [first, second] =
        [0, 1].map(|part| DeviceParameters::new(kit, &[(&host.weights[part], &host.moments[part])], false));
    Ok([first?, second?])
}

impl NerfOnDevice {
    /// The same field on an adapter.
    pub(crate) fn new(host: Nerf, kit: &Arc<FieldKit>) -> Result<Self, FieldError> {
        let radiance = host.networks.radiance.on_device();
        let deformation = host.networks.deformation.as_ref().map(|d| d.on_device());
        let array = || kit.device.array("spare", 0);
        let work = NerfWork {
            rows: 0,
            training: false,
            radiance: radiance.layers(kit, 0, false)?,
            deformation: deformation.as_ref().map(|d| d.layers(kit, 0, false)).transpose()?,
            samples: SampleArrays::new(kit)?,
            points: array()?,
            spare: [array()?, array()?, array()?],
        };
        let parameters = parameters(&host, kit)?;
        let work = Mutex::new(work);
        Ok(Self { host, kit: kit.clone(), radiance, deformation, parameters, work })
    }

    fn job(&self, rows: usize) -> SampleJob {
        SampleJob {
            spread_width: self.radiance.input_width(1) as u32,
            density_width: self.radiance.width(OUTPUTS[0]) as u32,
            colour_width: self.radiance.width(OUTPUTS[1]) as u32,
            density_column: self.host.networks.density as u32,
            ..SampleJob::new(rows, false, 0.0)
        }
    }

    /// Parameters of the radiance in a pass.
    fn radiance_of(&self, pass: usize) -> &DeviceParameters {
        &self.parameters[if self.host.shape.deformed { 0 } else { pass }]
    }

    /// Runs an entry of `waves.wgsl`.
    fn waves<'a>(&'a self, batch: &mut FieldBatch<'a>, work: &NerfWork, rows: usize, entry: usize) {
        let [a, b, c] = &work.spare;
        let (radiance, moved) = (&work.radiance, work.deformation.as_ref());
        let (encoded, of_encoded, moves, of_moves) = match (entry, moved) {
            (0, Some(moved)) => (&moved.inputs[0], a, b, c),
            (1, Some(moved)) => (&radiance.inputs[0], a, &moved.outputs[TRUNK], c),
            (2, Some(moved)) => (&radiance.inputs[0], &radiance.of_inputs[0], b, &moved.of_outputs[TRUNK]),
            _ => (&radiance.inputs[0], a, b, c),
        };
        let deformation = self.deformation.as_ref();
        let width = match (entry, deformation) {
            (0, Some(deformation)) => deformation.input_width(0),
            _ => self.radiance.input_width(0),
        };
        let job = WaveJob {
            rows: rows as u32,
            width: width as u32,
            moves_width: deformation.map_or(0, |d| d.width(TRUNK)) as u32,
            octaves: POSITION_OCTAVES as u32,
            time_octaves: TIME_OCTAVES as u32,
        };
        let arrays = [&work.points, encoded, of_encoded, moves, of_moves];
        batch.run((&self.kit.waves, entry), &job, &arrays, [rows.div_ceil(THREADS) as u32, 1, 1]);
    }

    /// Colours and densities of samples that are in place.
    fn forward<'a>(&'a self, batch: &mut FieldBatch<'a>, work: &NerfWork, job: &SampleJob, pass: usize) {
        let rows = job.rows as usize;
        if let (Some(stack), Some(layers)) = (&self.deformation, &work.deformation) {
            self.waves(batch, work, rows, 0);
            let parameters = &self.parameters[1].values;
            stack.forward((&self.kit, batch), parameters, layers, rows, 0..stack.len());
        }
        self.waves(batch, work, rows, 1);
        work.samples.spread((&self.kit, batch), job, &work.radiance, 1);
        let parameters = &self.radiance_of(pass).values;
        let all = 0..self.radiance.len();
        self.radiance.forward((&self.kit, batch), parameters, &work.radiance, rows, all);
        work.samples.shade((&self.kit, batch), job, &work.radiance, OUTPUTS);
    }

    /// From the gradients of colours and densities to those of the parameters.
    fn backward<'a>(&'a self, batch: &mut FieldBatch<'a>, work: &NerfWork, rows: usize, pass: usize) {
        let wanted = [self.deformation.is_some(), false];
        let parameters = self.radiance_of(pass);
        self.radiance.backward((&self.kit, batch), parameters, &work.radiance, rows, &wanted);
        if let (Some(stack), Some(layers)) = (&self.deformation, &work.deformation) {
            stack.clear(batch, layers);
            self.waves(batch, work, rows, 2);
            stack.backward((&self.kit, batch), &self.parameters[1], layers, rows, &[false]);
        }
    }

    /// Colour and density of each sample of rays at `depths`, as many a ray.
    pub(super) fn shade(
        &self,
        pass: usize,
        rays: &[NerfRay],
        depths: &[f32],
    ) -> Result<Vec<[f32; 4]>, FieldError> {
        let mut work = self.work.lock().unwrap_or_else(PoisonError::into_inner);
        work.prepare(self, rays.iter(), depths, false)?;
        let mut batch = self.kit.device.batch();
        self.forward(&mut batch, &work, &self.job(depths.len()), pass);
        batch.submit()?;
        self.kit.device.read(&work.samples.shaded, depths.len())
    }

    /// Adds the gradients of a pass over a group of rays; densities of its samples, and what each
    /// ray says.
    fn pass(
        &self,
        pass: usize,
        rays: &[SightedRay],
        depths: &[f32],
        count: usize,
    ) -> Result<(Vec<f32>, Vec<RayResult>), FieldError> {
        let mut work = self.work.lock().unwrap_or_else(PoisonError::into_inner);
        let (kit, each, unit) = (&*self.kit, depths.len() / rays.len(), self.host.unit());
        work.prepare(self, rays.iter().map(|r| &r.ray), depths, true)?;
        let of_device: Vec<DeviceRay> =
            (0..).zip(rays).map(|(i, r)| DeviceRay::new(i * each, each, &r.sighting)).collect();
        let steps: Vec<f32> = rays
            .iter()
            .zip(depths.chunks_exact(each))
            .flat_map(|(r, depths)| r.reach.steps(depths).map(|dt| dt * unit))
            .collect();
        work.samples.sight(kit, &of_device, &steps)?;
        let (rays, weight) = (rays.len() as u32, 1.0 / count as f32);
        let job = SampleJob { rays, weight, ..self.job(depths.len()) };
        let mut batch = kit.device.batch();
        self.forward(&mut batch, &work, &job, pass);
        self.radiance.clear(&mut batch, &work.radiance);
        work.samples.composite((kit, &mut batch), &job, &work.radiance, OUTPUTS);
        self.backward(&mut batch, &work, depths.len(), pass);
        batch.submit()?;
        let shaded = kit.device.read::<[f32; 4]>(&work.samples.shaded, depths.len())?;
        let results = kit.device.read(&work.samples.results, rays as usize)?;
        Ok((shaded.iter().map(|s| s[3]).collect(), results))
    }

    /// Adds the gradients of both passes, each ray's loss as one of `count`; the sums of losses and
    /// of the fine pass's squared errors.
    pub(super) fn gradients(
        &mut self,
        rays: &[SightedRay],
        count: usize,
        drawn: &DrawnDepths,
    ) -> Result<[f64; 2], FieldError> {
        let ([coarse, fine], unit) = (self.host.shape.samples, self.host.unit());
        let size = (GROUP / (coarse + fine)).max(1);
        let mut sums = [0.0; 2];
        let drawn = drawn.coarse.chunks(size * coarse).zip(drawn.offsets.chunks(size * fine));
        for (group, (first, offsets)) in rays.chunks(size).zip(drawn) {
            let (densities, results) = self.pass(0, group, first, count)?;
            sums[0] += results.iter().map(|r| f64::from(r[0])).sum::<f64>();
            let (mut second, mut shares) = (Vec::new(), Vec::new());
            let each = densities.chunks_exact(coarse).zip(offsets.chunks_exact(fine));
            for ((r, depths), (densities, offsets)) in group.iter().zip(first.chunks_exact(coarse)).zip(each)
            {
                let steps = r.reach.steps(depths).map(|dt| dt * unit);
                weights(densities.iter().copied(), steps, &mut shares);
                let mut offsets = offsets.iter().copied();
                refine(depths, &shares, fine, &mut || offsets.next().unwrap_or_default(), &mut second);
            }
            let (_, results) = self.pass(1, group, &second, count)?;
            sums[0] += results.iter().map(|r| f64::from(r[0])).sum::<f64>();
            sums[1] += results.iter().map(|r| f64::from(r[1])).sum::<f64>();
        }
        Ok(sums)
    }

    /// Adam on both parts.
    pub(super) fn descend(&mut self, place: StepPlace) -> Result<(), FieldError> {
        let (kit, rates) = (self.kit.clone(), self.host.rates(place));
        let mut batch = kit.device.batch();
        self.parameters.iter_mut().for_each(|p| p.step(&kit, &mut batch, &rates));
        batch.submit()
    }
}

impl NerfWork {
    /// Makes room for samples and puts them in place.
    fn prepare<'a>(
        &mut self,
        field: &NerfOnDevice,
        rays: impl ExactSizeIterator<Item = &'a NerfRay>,
        depths: &[f32],
        training: bool,
    ) -> Result<(), FieldError> {
        let (kit, rows, each) = (&*field.kit, depths.len(), depths.len() / rays.len().max(1));
        if rows > self.rows || training && !self.training {
            (self.rows, self.training) = (self.rows.max(rows.next_power_of_two()), training || self.training);
            self.radiance = field.radiance.layers(kit, self.rows, self.training)?;
            let deformation = field.deformation.as_ref();
            self.deformation = deformation.map(|d| d.layers(kit, self.rows, self.training)).transpose()?;
        }
        let width = field.radiance.input_width(1);
        let (mut points, mut directions) = (Vec::with_capacity(rows), Vec::new());
        for (ray, depths) in rays.zip(depths.chunks_exact(each)) {
            points.extend(depths.iter().map(|&t| {
                let [x, y, z] = ray.at(t);
                [x, y, z, ray.time]
            }));
            directions.extend(ray.encoded);
            directions.resize(directions.len().next_multiple_of(width), 0.0);
        }
        kit.device.grown(&mut self.points, 4 * rows)?;
        kit.device.write(&self.points, &points);
        let owners: Vec<u32> = (0..rows).map(|i| (i / each) as u32).collect();
        self.samples.share(kit, &directions, &owners)
    }
}

impl RadianceField for NerfOnDevice {
    fn train_step(&mut self, photos: &PhotoRays, place: StepPlace) -> Result<StepReport, FieldError> {
        let (rays, missed) = self.host.sighted(photos, place);
        let drawn = self.host.drawn(&rays, place);
        let sums = self.gradients(&rays, missed.count.max(1), &drawn)?;
        self.descend(place)?;
        Ok(self.host.report(rays.len(), &missed, sums))
    }

    fn render(
        &self,
        view: &PinholeView,
        time: f32,
        background: [f32; 3],
    ) -> Result<RenderOutput, FieldError> {
        rays::picture(view, time, (background, rays::LARGE_BLOCK), &|rays, out| {
            let mut shade = |pass: usize, rays: &[NerfRay], depths: &[f32]| self.shade(pass, rays, depths);
            self.host.trace((rays, GROUP), background, out, &mut shade)
        })
    }

    fn fetch(&mut self) -> Result<(), FieldError> {
        let parts = self.host.weights.iter_mut().zip(&mut self.host.moments);
        for (parameters, (weights, moments)) in self.parameters.iter().zip(parts) {
            parameters.fetch(&self.kit, &mut [(weights, moments)])?;
        }
        Ok(())
    }

    fn size(&self) -> usize {
        self.host.size()
    }

    fn arrays(&self, kept: Kept) -> (Vec<&[f32]>, Value) {
        self.host.arrays(kept)
    }

    fn restore(&mut self, kept: Kept, arrays: Vec<Vec<f32>>, notes: &Value) -> Result<(), String> {
        self.host.restore(kept, arrays, notes)?;
        self.parameters = parameters(&self.host, &self.kit).map_err(|e| e.to_string())?;
        Ok(())
    }
}

#[cfg(test)]
impl NerfOnDevice {
    pub(super) fn host(&self) -> &Nerf {
        &self.host
    }

    pub(super) fn gradient(&self, part: usize) -> Vec<f32> {
        self.parameters[part].read_gradient(&self.kit)
    }
}
