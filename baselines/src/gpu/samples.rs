//! Between networks and rays: what kernels of samples are told, and their arrays.

use super::device::{DeviceArray, FieldBatch, folded};
use super::kit::FieldKit;
use super::stack::DeviceLayers;
use crate::composite::OPAQUE;
use crate::error::FieldError;
use crate::rays::Sighting;
use bytemuck::{Pod, Zeroable};

/// How outputs of networks are densities and colours, and colours losses.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct SampleJob {
    pub(crate) rows: u32,
    pub(crate) spread_width: u32,
    pub(crate) density_width: u32,
    pub(crate) colour_width: u32,
    pub(crate) density_column: u32,
    /// 1: density is an exponential, rays end where they are opaque, Huber's loss; 0: a rectifier
    /// and squares.
    pub(crate) fast: u32,
    pub(crate) rays: u32,
    /// Weight of a ray's loss.
    pub(crate) weight: f32,
    pub(crate) linear_from: f32,
    pub(crate) log_density: f32,
    pub(crate) opaque: f32,
}

/// A ray as the kernels see it.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct DeviceRay {
    begin: u32,
    count: u32,
    colour: [f32; 3],
    background: [f32; 3],
}

impl DeviceRay {
    /// Of samples from `begin` on.
    pub(crate) fn new(begin: usize, count: usize, sighting: &Sighting) -> Self {
        let Sighting { colour, background, .. } = *sighting;
        Self { begin: begin as u32, count: count as u32, colour, background }
    }
}

/// What a ray's kernel says: loss, squared error, samples seen, transmittance.
pub(crate) type RayResult = [f32; 4];

/// Arrays of samples and rays, as large as needed.
pub(crate) struct SampleArrays {
    /// Rows that all samples of a ray share.
    pub(crate) of_rays: DeviceArray,
    /// Ray of each sample.
    pub(crate) owners: DeviceArray,
    /// Lengths of steps.
    pub(crate) steps: DeviceArray,
    pub(crate) rays: DeviceArray,
    /// Colour and density of each sample.
    pub(crate) shaded: DeviceArray,
    pub(crate) results: DeviceArray,
}

impl SampleArrays {
    /// Without room.
    pub(crate) fn new(kit: &FieldKit) -> Result<Self, FieldError> {
        let array = || kit.device.array("samples", 0);
        Ok(Self {
            of_rays: array()?,
            owners: array()?,
            steps: array()?,
            rays: array()?,
            shaded: array()?,
            results: array()?,
        })
    }

    /// Puts in place what samples share by ray.
    pub(crate) fn share(
        &mut self,
        kit: &FieldKit,
        of_rays: &[f32],
        owners: &[u32],
    ) -> Result<(), FieldError> {
        kit.device.grown(&mut self.of_rays, of_rays.len())?;
        kit.device.grown(&mut self.owners, owners.len())?;
        kit.device.grown(&mut self.shaded, 4 * owners.len())?;
        kit.device.write(&self.of_rays, of_rays);
        kit.device.write(&self.owners, owners);
        Ok(())
    }

    /// Puts rays and steps in place.
    pub(crate) fn sight(
        &mut self,
        kit: &FieldKit,
        rays: &[DeviceRay],
        steps: &[f32],
    ) -> Result<(), FieldError> {
        kit.device.grown(&mut self.rays, size_of_val(rays) / 4)?;
        kit.device.grown(&mut self.results, 4 * rays.len())?;
        kit.device.grown(&mut self.steps, steps.len())?;
        kit.device.write(&self.rays, rays);
        kit.device.write(&self.steps, steps);
        Ok(())
    }

    /// Rows of rays to their samples, into input `input` of a network.
    pub(crate) fn spread<'a>(
        &self,
        (kit, batch): (&'a FieldKit, &mut FieldBatch<'a>),
        job: &SampleJob,
        layers: &DeviceLayers,
        input: usize,
    ) {
        let arrays = [
            &self.of_rays,
            &self.owners,
            &layers.inputs[input],
            &layers.outputs[0],
            &layers.outputs[1],
            &self.shaded,
        ];
        let threads = job.rows as usize * job.spread_width as usize;
        batch.run((&kit.rays, 0), job, &arrays, folded(threads, 256));
    }

    /// Colours and densities of layers' outputs.
    pub(crate) fn shade<'a>(
        &self,
        (kit, batch): (&'a FieldKit, &mut FieldBatch<'a>),
        job: &SampleJob,
        layers: &DeviceLayers,
        [density, colour]: [usize; 2],
    ) {
        let outputs = &layers.outputs;
        let arrays = [
            &self.of_rays,
            &self.owners,
            &layers.inputs[0],
            &outputs[density],
            &outputs[colour],
            &self.shaded,
        ];
        batch.run((&kit.rays, 1), job, &arrays, folded(job.rows as usize, 256));
    }

    /// Colours of rays, losses, and the gradients of layers' outputs, which were cleared.
    pub(crate) fn composite<'a>(
        &self,
        (kit, batch): (&'a FieldKit, &mut FieldBatch<'a>),
        job: &SampleJob,
        layers: &DeviceLayers,
        [density, colour]: [usize; 2],
    ) {
        let of = &layers.of_outputs;
        let arrays = [&self.rays, &self.steps, &self.shaded, &of[density], &of[colour], &self.results];
        batch.run((&kit.composite, 0), job, &arrays, folded(job.rays as usize, 64));
    }
}

impl SampleJob {
    /// Of a field like Instant NeRF (see [`Self::fast`]) or NeRF; the rest is the method's.
    pub(crate) fn new(rows: usize, fast: bool, log_density: f32) -> Self {
        Self { rows: rows as u32, fast: u32::from(fast), log_density, opaque: OPAQUE, ..Self::zeroed() }
    }
}
