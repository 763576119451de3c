//! The kernels: their sources, what they are bound to, and their pipelines, made once.

use super::context::Gpu;
use super::layout::{DensifyJob, Frame, GROUP, GatherJob, HalveJob, PageJob, ScanJob, SortJob};
use crate::error::SplatError;

/// What a binding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum BindingSlot {
    /// A uniform of so many bytes.
    Uniform(usize),
    /// A buffer that is read.
    Read,
    /// A buffer that is written, and perhaps read.
    Write,
}

use BindingSlot::{Read, Uniform, Write};

/// A WGSL module.
#[derive(Clone, Copy, Debug)]
pub(crate) struct KernelSource {
    /// File name without extension.
    pub(crate) name: &'static str,
    /// The files that make it up, in order.
    pub(crate) parts: &'static [&'static str],
    /// Bindings 0, 1, … of group 0.
    pub(crate) slots: &'static [BindingSlot],
    /// Entry points.
    pub(crate) entries: &'static [&'static str],
}

const FRAME: &str = include_str!("wgsl/frame.wgsl");
const SH: &str = include_str!("wgsl/sh.wgsl");
const PROJECTION: &str = include_str!("wgsl/projection.wgsl");
const SPLIT: &str = include_str!("wgsl/split.wgsl");
const VIEW: BindingSlot = Uniform(size_of::<Frame>());
const PAGE: BindingSlot = Uniform(size_of::<PageJob>());

/// All modules, in the order of a step.
pub(crate) const SOURCES: [KernelSource; 13] = [
    KernelSource {
        name: "project",
        parts: &[FRAME, SH, PROJECTION, include_str!("wgsl/project.wgsl")],
        slots: &[VIEW, PAGE, Read, Read, Write, Write, Write, Write],
        entries: &["main"],
    },
    KernelSource {
        name: "scan",
        parts: &[FRAME, include_str!("wgsl/scan.wgsl")],
        slots: &[Uniform(size_of::<ScanJob>()), Write, Write, Write],
        entries: &["reduce", "spine", "sweep", "whole"],
    },
    KernelSource {
        name: "compact",
        parts: &[FRAME, include_str!("wgsl/compact.wgsl")],
        slots: &[VIEW, Read, Read, Read, Write, Write],
        entries: &["main"],
    },
    KernelSource {
        name: "sort",
        parts: &[FRAME, include_str!("wgsl/sort.wgsl")],
        slots: &[Uniform(size_of::<SortJob>()), Read, Write, Read, Read, Write, Write],
        entries: &["histogram", "scatter"],
    },
    KernelSource {
        name: "pairs",
        parts: &[FRAME, include_str!("wgsl/pairs.wgsl")],
        slots: &[VIEW, Read, Read, Read, Read, Write, Write, Write, Write],
        entries: &["count", "emit"],
    },
    KernelSource {
        name: "ranges",
        parts: &[FRAME, include_str!("wgsl/ranges.wgsl")],
        slots: &[VIEW, Read, Read, Read, Read, Write, Write],
        entries: &["main"],
    },
    KernelSource {
        name: "rasterise",
        parts: &[FRAME, include_str!("wgsl/rasterise.wgsl")],
        slots: &[VIEW, Read, Read, Read, Write, Write, Write],
        entries: &["main"],
    },
    KernelSource {
        name: "loss",
        parts: &[FRAME, include_str!("wgsl/loss.wgsl")],
        slots: &[VIEW, Write, Read, Write, Write, Write, Write, Write],
        entries: &["statistics", "differentiate", "products", "total_products", "total"],
    },
    KernelSource {
        name: "rasterise_backward",
        parts: &[FRAME, include_str!("wgsl/rasterise_backward.wgsl")],
        slots: &[VIEW, Read, Read, Read, Read, Read, Write, Write, Write],
        entries: &["main"],
    },
    KernelSource {
        name: "adam",
        parts: &[FRAME, SH, PROJECTION, include_str!("wgsl/adam.wgsl")],
        slots: &[VIEW, PAGE, Write, Write, Read, Read, Read, Read, Write],
        entries: &["main"],
    },
    KernelSource {
        name: "densify",
        parts: &[FRAME, SPLIT, include_str!("wgsl/densify.wgsl")],
        slots: &[Uniform(size_of::<DensifyJob>()), Read, Write, Write, Write, Write, Read, Write, Write],
        entries: &["score", "choose", "judge", "place"],
    },
    KernelSource {
        name: "gather",
        parts: &[FRAME, include_str!("wgsl/gather.wgsl")],
        slots: &[Uniform(size_of::<GatherJob>()), Read, Read, Write],
        entries: &["main"],
    },
    KernelSource {
        name: "halve",
        parts: &[FRAME, SPLIT, include_str!("wgsl/halve.wgsl")],
        slots: &[Uniform(size_of::<HalveJob>()), Read, Write],
        entries: &["main"],
    },
];

impl KernelSource {
    /// The whole module, for adapters with subgroup operations or without: lines between
    /// `//#if subgroups`, `//#else` and `//#endif` are chosen, and where the subgroup's numbers are
    /// arguments they are put in or left out.
    pub(crate) fn text(&self, subgroups: bool) -> String {
        let (mut text, mut kept) = (String::new(), true);
        for line in self.parts.iter().flat_map(|part| part.lines()) {
            match line.trim() {
                "//#if subgroups" => kept = subgroups,
                "//#else" => kept = !subgroups,
                "//#endif" => kept = true,
                // Dropped lines stay as empty ones, so that messages name the right line.
                _ if kept => text.push_str(line),
                _ => {}
            }
            text.push('\n');
        }
        let (arguments, passed) = if subgroups {
            (
                ", @builtin(subgroup_invocation_id) subgroup_lane: u32, @builtin(subgroup_size) lanes: u32",
                ", subgroup_lane, lanes",
            )
        } else {
            ("", "")
        };
        text.replace("/*lanes*/", arguments).replace("/*use lanes*/", passed)
    }
}

/// A module's layout and its pipelines, in the order of its entry points.
pub(crate) struct Module {
    name: &'static str,
    layout: wgpu::BindGroupLayout,
    pipelines: Vec<wgpu::ComputePipeline>,
}

impl Module {
    fn new(gpu: &Gpu, source: &KernelSource) -> Self {
        let device = &gpu.device;
        let entries: Vec<wgpu::BindGroupLayoutEntry> = (0..)
            .zip(source.slots)
            .map(|(binding, slot)| wgpu::BindGroupLayoutEntry {
                binding,
                visibility: wgpu::ShaderStages::COMPUTE,
                ty: wgpu::BindingType::Buffer {
                    ty: match slot {
                        Uniform(_) => wgpu::BufferBindingType::Uniform,
                        Read => wgpu::BufferBindingType::Storage { read_only: true },
                        Write => wgpu::BufferBindingType::Storage { read_only: false },
                    },
                    has_dynamic_offset: false,
                    min_binding_size: None,
                },
                count: None,
            })
            .collect();
        let descriptor = wgpu::BindGroupLayoutDescriptor { label: Some(source.name), entries: &entries };
        let layout = device.create_bind_group_layout(&descriptor);
        let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(source.name),
            bind_group_layouts: &[Some(&layout)],
            immediate_size: 0,
        });
        let descriptor = wgpu::ShaderModuleDescriptor {
            label: Some(source.name),
            source: wgpu::ShaderSource::Wgsl(source.text(gpu.subgroups).into()),
        };
        // SAFETY: the kernels are ours: every index is held below the length that it is bound with
        // by a test in the kernel, every loop has an end that does not depend on floats, no divisor
        // is zero. What naga would add else is a limit on every access to shared memory and a
        // counter in every loop, the innermost ones too.
        let shader = unsafe {
            device.create_shader_module_trusted(descriptor, wgpu::ShaderRuntimeChecks::unchecked())
        };
        let pipelines = source.entries.iter().map(|entry| {
            device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(source.name),
                layout: Some(&pipeline_layout),
                module: &shader,
                entry_point: Some(entry),
                // Every kernel writes its shared memory before it reads it.
                compilation_options: wgpu::PipelineCompilationOptions {
                    zero_initialize_workgroup_memory: false,
                    ..Default::default()
                },
                cache: gpu.pipelines.as_ref().map(|p| p.cache()),
            })
        });
        Self { name: source.name, layout, pipelines: pipelines.collect() }
    }

    /// Binds buffers to the module's bindings, in order.
    pub(crate) fn bind(&self, gpu: &Gpu, bindings: &[wgpu::BindingResource]) -> wgpu::BindGroup {
        let entries: Vec<wgpu::BindGroupEntry> = (0..)
            .zip(bindings)
            .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource: resource.clone() })
            .collect();
        gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(self.name),
            layout: &self.layout,
            entries: &entries,
        })
    }

    /// Binds buffers and runs an entry point for so many threads: for what happens rarely.
    pub(crate) fn once(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        entry: usize,
        buffers: &[&wgpu::Buffer],
        threads: u32,
    ) {
        let resources: Vec<_> = buffers.iter().map(|b| b.as_entire_binding()).collect();
        let bound = self.bind(gpu, &resources);
        let mut pass = encoder.begin_compute_pass(&Default::default());
        self.run(&mut pass, entry, &bound, threads.div_ceil(GROUP), 1);
    }

    /// Runs entry point `entry` in `groups` groups, `layers` times in z.
    pub(crate) fn run(
        &self,
        pass: &mut wgpu::ComputePass,
        entry: usize,
        bound: &wgpu::BindGroup,
        groups: u32,
        layers: u32,
    ) {
        // No dimension may have more than 65,535 groups; the kernels fold y into their number.
        let width = groups.min(65_535);
        let height = if width == 0 { 0 } else { groups.div_ceil(width) };
        pass.set_pipeline(&self.pipelines[entry]);
        pass.set_bind_group(0, bound, &[]);
        pass.dispatch_workgroups(width, height, layers);
    }
}

/// All pipelines.
pub(crate) struct Kernels {
    /// Gaussians to the screen.
    pub(crate) project: Module,
    /// Prefix sums: reduce, spine, sweep.
    pub(crate) scan: Module,
    /// The seen ones.
    pub(crate) compact: Module,
    /// Radix sort: histogram, scatter.
    pub(crate) sort: Module,
    /// Gaussian-tile pairs: count, emit.
    pub(crate) pairs: Module,
    /// Where tiles begin.
    pub(crate) ranges: Module,
    /// Pixels.
    pub(crate) rasterise: Module,
    /// Loss: statistics, differentiate, total.
    pub(crate) loss: Module,
    /// Rasterise backward.
    pub(crate) rasterise_backward: Module,
    /// Project backward and Adam.
    pub(crate) adam: Module,
    /// Densification: score, choose, judge, place.
    pub(crate) densify: Module,
    /// Planes from the old model to the new one.
    pub(crate) gather: Module,
    /// Halves of split Gaussians.
    pub(crate) halve: Module,
}

impl Kernels {
    /// Compiles all of them.
    pub(crate) fn new(gpu: &Gpu) -> Result<Self, SplatError> {
        let [
            project,
            scan,
            compact,
            sort,
            pairs,
            ranges,
            rasterise,
            loss,
            rasterise_backward,
            adam,
            densify,
            gather,
            halve,
        ] = SOURCES.each_ref().map(|source| Module::new(gpu, source));
        gpu.check()?;
        if let Some(pipelines) = &gpu.pipelines {
            pipelines.store();
        }
        Ok(Self {
            project,
            scan,
            compact,
            sort,
            pairs,
            ranges,
            rasterise,
            loss,
            rasterise_backward,
            adam,
            densify,
            gather,
            halve,
        })
    }
}
