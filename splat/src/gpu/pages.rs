//! The model on the device, in pages: no binding is larger than the adapter allows, however many
//! Gaussians there are. A page holds a range of Gaussians in planes (plane p of its l-th Gaussian
//! is entry `p · stride + l`).

use super::context::Gpu;
use super::kernels::Kernels;
use super::layout::{COLOUR_MOMENTS, GatherJob, PLANES, PageJob, STATISTICS};
use crate::error::SplatError;
use crate::model::{GEOMETRY, Model, padded};
use crate::statistics::Statistics;

/// Gaussians of a page are a multiple of this, unless it is the last.
/// Source: chosen by hand, never measured.
const GRAIN: usize = 64;

/// A range of Gaussians.
pub(crate) struct Page {
    /// Which they are.
    pub(crate) job: PageJob,
    /// [`PageJob`] for the kernels.
    pub(crate) uniform: wgpu::Buffer,
    /// \[39\]\[stride\], or \[11\]\[stride\] where nothing is trained.
    pub(crate) geometry: wgpu::Buffer,
    /// \[3K\]\[stride\].
    pub(crate) sh: wgpu::Buffer,
}

/// All of them.
pub(crate) struct Pages {
    /// In order.
    pub(crate) list: Vec<Page>,
    /// Gaussians.
    pub(crate) n: usize,
    /// SH values of a Gaussian, 3K.
    pub(crate) sh_stride: usize,
    /// Whether there are moments and statistics.
    pub(crate) training: bool,
}

/// The buffers of a page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PagePart {
    /// Geometry, clock, statistics.
    Geometry,
    /// Spherical harmonics.
    Sh,
}

impl PagePart {
    /// In the order in which they are replaced: the largest first, so that the others fit where it
    /// was.
    pub(crate) const ALL: [Self; 2] = [Self::Sh, Self::Geometry];

    fn planes(self, sh_stride: usize, training: bool) -> usize {
        match self {
            Self::Geometry if training => PLANES,
            Self::Geometry => GEOMETRY,
            Self::Sh => sh_stride,
        }
    }
}

/// Bytes of a Gaussian in all parts.
pub(crate) fn bytes_each(sh_stride: usize, training: bool) -> u64 {
    4 * PagePart::ALL.iter().map(|p| p.planes(sh_stride, training) as u64).sum::<u64>()
}

/// Bytes of a Gaussian in the largest part, which is there twice while Gaussians are added and
/// removed.
pub(crate) fn bytes_twice(sh_stride: usize) -> u64 {
    4 * PagePart::ALL.iter().map(|p| p.planes(sh_stride, true) as u64).max().unwrap_or(0)
}

/// Gaussians a page holds where no buffer may have more than `largest` bytes.
pub(crate) fn room(largest: u64, sh_stride: usize, training: bool) -> usize {
    let planes = PagePart::ALL.iter().map(|p| p.planes(sh_stride, training)).max().unwrap_or(1);
    ((largest / (4 * planes as u64)) as usize / GRAIN * GRAIN).clamp(GRAIN, 1 << 26)
}

/// Where the pages of `n` Gaussians begin, and how many each has; one even if there are none.
fn ranges(n: usize, room: usize) -> Vec<PageJob> {
    let pages = (0..n.div_ceil(room).max(1)).map(|k| {
        let count = room.min(n - k * room);
        let [first, count, stride] = [k * room, count, padded(count.max(1))].map(|v| v as u32);
        PageJob { first, count, stride, spare: 0 }
    });
    pages.collect()
}

impl Pages {
    /// Room for `n` Gaussians; parameters are whatever they are.
    pub(crate) fn new(gpu: &Gpu, n: usize, sh_stride: usize, training: bool) -> Result<Self, SplatError> {
        let room = room(gpu.largest_buffer(), sh_stride, training);
        let list = ranges(n, room).into_iter().map(|job| {
            let part = |p: PagePart| part(gpu, p, &job, sh_stride, training);
            let (geometry, sh) = (part(PagePart::Geometry)?, part(PagePart::Sh)?);
            Ok(Page { uniform: gpu.uniform(job)?, job, geometry, sh })
        });
        Ok(Self { list: list.collect::<Result<_, SplatError>>()?, n, sh_stride, training })
    }

    /// Bytes of all pages, by part.
    pub(crate) fn memory(&self) -> Vec<(&'static str, u64)> {
        let parts = [("geometry", PagePart::Geometry), ("sh", PagePart::Sh)];
        let sizes = parts.map(|(name, part)| (name, self.list.iter().map(|p| p.part(part).size()).sum()));
        sizes.to_vec()
    }

    /// Writes parameters, and where there is room for them moments and statistics.
    pub(crate) fn upload(&self, gpu: &Gpu, model: &Model, s: &Statistics) {
        let none = vec![0.0; padded(self.n)];
        let statistics = [&s.gradient, &s.visible].map(|sums| if sums.len() < self.n { &none } else { sums });
        let moments = model.geometry_m.iter().chain(&model.geometry_v).chain(&model.sh_v);
        for page in &self.list {
            let PageJob { first, count, stride, .. } = page.job;
            let (first, count, stride) = (first as usize, count as usize, stride as usize);
            let mut geometry = Vec::with_capacity(page.geometry.size() as usize / 4);
            let planes = model.geometry.iter().chain(moments.clone()).chain([&model.steps]).chain(statistics);
            for plane in planes.take(if self.training { PLANES } else { GEOMETRY }) {
                geometry.extend_from_slice(&plane[first..first + count]);
                geometry.resize(geometry.len() + stride - count, 0.0);
            }
            gpu.write(&page.geometry, 0, &geometry);
            gpu.write(&page.sh, 0, &self.planes_of(&page.job, &model.sh));
        }
    }

    /// A page's part of [N × K × 3] values as planes.
    fn planes_of(&self, job: &PageJob, values: &[f32]) -> Vec<f32> {
        let [first, count, stride] = [job.first, job.count, job.stride].map(|v| v as usize);
        let mut out = vec![0.0; self.sh_stride * stride];
        let own = values[first * self.sh_stride..].chunks_exact(self.sh_stride).take(count);
        for (l, gaussian) in own.enumerate() {
            gaussian.iter().enumerate().for_each(|(k, v)| out[k * stride + l] = *v);
        }
        out
    }

    /// Reads everything back; only where there are moments.
    pub(crate) fn download(&self, gpu: &Gpu, sh_degree: u32) -> Result<(Model, Statistics), SplatError> {
        let mut planes = vec![vec![0.0f32; padded(self.n)]; PLANES];
        let mut sh = vec![0.0f32; self.n * self.sh_stride];
        for page in &self.list {
            let PageJob { first, count, stride, .. } = page.job;
            let (first, count, stride) = (first as usize, count as usize, stride as usize);
            let read = |b: &wgpu::Buffer| gpu.read::<f32>(b, 0, b.size() as usize / 4);
            for (plane, from) in planes.iter_mut().zip(read(&page.geometry)?.chunks_exact(stride)) {
                plane[first..first + count].copy_from_slice(&from[..count]);
            }
            let from = read(&page.sh)?;
            let own = sh[first * self.sh_stride..].chunks_exact_mut(self.sh_stride).take(count);
            for (l, gaussian) in own.enumerate() {
                gaussian.iter_mut().enumerate().for_each(|(k, to)| *to = from[k * stride + l]);
            }
        }
        let statistics = planes.split_off(STATISTICS);
        let [gradient, visible] = take(statistics);
        let mut rest = planes.into_iter();
        let mut next = || -> [Vec<f32>; GEOMETRY] { take(rest.by_ref().take(GEOMETRY).collect()) };
        let (geometry, geometry_m, geometry_v) = (next(), next(), next());
        debug_assert_eq!(COLOUR_MOMENTS, 3 * GEOMETRY);
        let sh_v = take(rest.by_ref().take(3).collect());
        let steps = rest.next().unwrap_or_default();
        let part = Vec::new();
        let model = Model { len: self.n, sh_degree, geometry, geometry_m, geometry_v, sh, sh_v, steps, part };
        Ok((model, Statistics { gradient, visible }))
    }

    /// The model with another number of SH values a Gaussian: planes are copied, new ones are zero.
    /// Nothing where pages would have to be of another size.
    pub(crate) fn with_sh_stride(&self, gpu: &Gpu, sh_stride: usize) -> Result<Option<Self>, SplatError> {
        let (old, new) = (self.sh_stride, Self::new(gpu, self.n, sh_stride, self.training)?);
        if new.list.len() != self.list.len() {
            return Ok(None);
        }
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        for (from, to) in self.list.iter().zip(&new.list) {
            let plane = 4 * u64::from(from.job.stride);
            let kept = old.min(sh_stride) as u64 * plane;
            encoder.copy_buffer_to_buffer(&from.geometry, 0, &to.geometry, 0, from.geometry.size());
            encoder.copy_buffer_to_buffer(&from.sh, 0, &to.sh, 0, kept);
        }
        gpu.queue.submit([encoder.finish()]);
        Ok(Some(new))
    }

    /// Makes the model the one whose Gaussian j is the present `source[j]` (densify.wgsl,
    /// split.wgsl); halves of split Gaussians begin without moments, all without statistics.
    /// Part by part, so that only one is there twice; `false`, and nothing has changed, where
    /// there is no memory for that.
    pub(crate) fn gather(
        &mut self,
        gpu: &Gpu,
        kernels: &Kernels,
        source: &wgpu::Buffer,
        n: usize,
    ) -> Result<bool, SplatError> {
        let jobs = ranges(n, room(gpu.largest_buffer(), self.sh_stride, self.training));
        let mut parts = Vec::new();
        for kind in PagePart::ALL {
            let made: Result<Vec<_>, _> =
                jobs.iter().map(|job| part(gpu, kind, job, self.sh_stride, self.training)).collect();
            let made = match made {
                Ok(made) => made,
                Err(_) if parts.is_empty() => return gpu.check().map(|()| false),
                Err(error) => return Err(error),
            };
            let mut encoder = gpu.device.create_command_encoder(&Default::default());
            for (job, new) in jobs.iter().zip(&made) {
                for old in &self.list {
                    let uniform = gpu.uniform(self.gather_job(kind, job, &old.job))?;
                    let bound = [&uniform, source, old.part(kind), new];
                    kernels.gather.once(gpu, &mut encoder, 0, &bound, job.count);
                }
            }
            gpu.queue.submit([encoder.finish()]);
            // The old part's memory is free from here on.
            for old in &mut self.list {
                *old.part_mut(kind) = old.uniform.clone();
            }
            gpu.wait()?;
            parts.push(made.into_iter());
        }
        let mut next = |k: usize| parts[k].next().ok_or_else(|| gpu.error("a page is missing"));
        self.list.clear();
        for job in jobs {
            let (sh, geometry) = (next(0)?, next(1)?);
            self.list.push(Page { uniform: gpu.uniform(job)?, job, geometry, sh });
        }
        self.n = n;
        Ok(true)
    }

    fn gather_job(&self, part: PagePart, job: &PageJob, old: &PageJob) -> GatherJob {
        let planes = part.planes(self.sh_stride, self.training) as u32;
        let (clear_fresh, clear_all) = match part {
            PagePart::Geometry => (GEOMETRY as u32, STATISTICS as u32),
            PagePart::Sh => (planes, planes),
        };
        GatherJob {
            first: job.first,
            count: job.count,
            stride: job.stride,
            old_first: old.first,
            old_count: old.count,
            old_stride: old.stride,
            planes,
            clear_fresh,
            clear_all,
            ..GatherJob::default()
        }
    }
}

impl Page {
    fn part(&self, part: PagePart) -> &wgpu::Buffer {
        match part {
            PagePart::Geometry => &self.geometry,
            PagePart::Sh => &self.sh,
        }
    }

    fn part_mut(&mut self, part: PagePart) -> &mut wgpu::Buffer {
        match part {
            PagePart::Geometry => &mut self.geometry,
            PagePart::Sh => &mut self.sh,
        }
    }
}

fn part(
    gpu: &Gpu,
    part: PagePart,
    job: &PageJob,
    sh_stride: usize,
    training: bool,
) -> Result<wgpu::Buffer, SplatError> {
    let (name, planes) = (format!("{part:?}"), part.planes(sh_stride, training));
    gpu.buffer(&name, 4 * (planes.max(1) * job.stride as usize) as u64, None)
}

/// The planes as an array; empty ones where there are too few.
fn take<const N: usize>(planes: Vec<Vec<f32>>) -> [Vec<f32>; N] {
    let mut planes = planes.into_iter();
    std::array::from_fn(|_| planes.next().unwrap_or_default())
}
