//! Where to compute: chosen by flags, or by what this machine has.

use crate::adapter::Adapter;
use crate::backend::Backend;
use crate::cpu::CpuBackend;
use crate::error::SplatError;
use clap::{Args, ValueEnum};
use scene::Decision;
use scene::decision::{Choice, Remark, Rule, Subject};
use serde::{Deserialize, Serialize};

/// The choice of backend.
#[derive(ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BackendChoice {
    /// A graphics card where there is one, else the processor
    #[default]
    Auto,
    /// The processor
    Cpu,
    /// A graphics adapter, hardware first; an emulated one will do
    Gpu,
}

/// Where training and rendering run.
#[derive(Args, Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DeviceConfig {
    /// Where the splat is trained and rendered
    #[arg(long, value_enum, default_value_t = BackendChoice::Auto, help_heading = "Splat")]
    pub backend: BackendChoice,
    /// Use the graphics adapter whose name contains this ('sat-recon doctor' lists them)
    #[arg(long, value_name = "NAME", help_heading = "Splat")]
    pub gpu: Option<String>,
    /// Never use more of the graphics adapter's memory than this, MiB: fewer Gaussians if need be
    #[arg(long, value_name = "MIB", value_parser = clap::value_parser!(u64).range(16..), help_heading = "Splat")]
    pub vram_limit: Option<u64>,
}

/// How the names of graphics cards in `/dev` begin. Source: the kernel's own drivers (`dri`,
/// `kfd`), NVIDIA's for cards and boards, Windows's for its Linux (`dxg`), ARM's, Qualcomm's,
/// Imagination's.
const CARDS: [&str; 9] = ["dri", "kfd", "nvidia", "nvhost", "nvmap", "dxg", "mali", "kgsl", "pvr"];

impl DeviceConfig {
    /// The same, but the processor where parts move: graphics adapters know of none.
    pub(crate) fn for_parts(&self, moving: bool) -> Self {
        let mut device = self.clone();
        if moving {
            (device.backend, device.gpu) = (BackendChoice::Cpu, None);
        }
        device
    }
}

/// Opens what the configuration asks for, and says what was chosen and why.
pub fn open(config: &DeviceConfig) -> Result<(Box<dyn Backend>, Decision), SplatError> {
    let wanted = config.backend == BackendChoice::Gpu || config.gpu.is_some();
    if config.backend == BackendChoice::Cpu {
        return Ok(processor(|name| decision(name, Rule::Requested)));
    }
    if wanted {
        let backend = adapter(config, config.gpu.as_deref())?;
        let decision = decision(backend.name(), Rule::Requested);
        return Ok((backend, decision));
    }
    let found = if may_have_a_card() { adapters() } else { Vec::new() };
    let Some(best) = found.into_iter().find(|a| a.kind.is_hardware()) else {
        return Ok(processor(|name| decision(name, Rule::Evidence).remarked(Remark::NoGraphicsCard)));
    };
    Ok(match adapter(config, Some(&best.name)) {
        Ok(backend) => {
            let decision = decision(backend.name(), Rule::Evidence).remarked(Remark::FirstGraphicsCard);
            (backend, decision)
        }
        Err(why) => processor(|name| decision(name, Rule::Failed).quoting(why.to_string())),
    })
}

/// Whether the system has a device that a driver of a graphics card could talk to. Where it has
/// none, asking the drivers costs 40 MiB for as long as the program runs: Mesa's loads LLVM.
fn may_have_a_card() -> bool {
    if !cfg!(target_os = "linux") {
        return true;
    }
    let Ok(devices) = std::fs::read_dir("/dev") else { return true };
    devices.flatten().any(|device| {
        let name = device.file_name();
        CARDS.iter().any(|card| name.to_string_lossy().starts_with(card))
    })
}

fn decision(name: String, rule: Rule) -> Decision {
    Decision::new(Subject::Backend, Choice::Device(name), rule)
}

/// The processor, and the decision for it, made of its name.
fn processor(decide: impl FnOnce(String) -> Decision) -> (Box<dyn Backend>, Decision) {
    let backend = CpuBackend::default();
    let decision = decide(Backend::name(&backend));
    (Box::new(backend), decision)
}

#[cfg(feature = "gpu")]
fn adapter(config: &DeviceConfig, name: Option<&str>) -> Result<Box<dyn Backend>, SplatError> {
    let (name, memory) = (name.map(str::to_owned), config.vram_limit.map(|mib| mib << 20));
    let opening = crate::gpu::Opening { name, memory, ..Default::default() };
    Ok(Box::new(crate::gpu::GpuBackend::open(&opening)?))
}

#[cfg(not(feature = "gpu"))]
fn adapter(_: &DeviceConfig, name: Option<&str>) -> Result<Box<dyn Backend>, SplatError> {
    let present = "none: this program was built without the feature gpu".to_owned();
    Err(SplatError::NoAdapter { wanted: name.unwrap_or("any").to_owned(), present })
}

/// The adapters of this machine, hardware first; those of equal kind in the driver's order.
pub fn adapters() -> Vec<Adapter> {
    #[cfg(feature = "gpu")]
    return crate::gpu::adapters();
    #[cfg(not(feature = "gpu"))]
    Vec::new()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(backend: BackendChoice, gpu: Option<&str>) -> DeviceConfig {
        DeviceConfig { backend, gpu: gpu.map(str::to_owned), vram_limit: None }
    }

    #[test]
    fn the_processor_is_never_played_by_an_emulated_adapter() {
        let (backend, decision) = open(&config(BackendChoice::Auto, None)).unwrap();
        assert_eq!(Choice::Device(backend.name()), decision.choice);
        let hardware = adapters().iter().any(|a| a.kind.is_hardware());
        assert_eq!(backend.name().starts_with("processor"), !hardware, "{decision:?}");
        let (backend, decision) = open(&config(BackendChoice::Cpu, Some("anything"))).unwrap();
        assert!(backend.name().starts_with("processor"), "{decision:?}");
    }

    #[test]
    fn an_adapter_that_is_not_there_is_an_error_that_names_those_that_are() {
        let Err(error) = open(&config(BackendChoice::Auto, Some("no such adapter"))) else {
            panic!("it was opened");
        };
        assert!(error.to_string().contains("no such adapter"), "{error}");
        for adapter in adapters() {
            assert!(error.to_string().contains(&adapter.name), "{error}");
        }
    }
}
