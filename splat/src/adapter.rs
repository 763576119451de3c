//! The graphics adapters of this machine, in plain words. Empty without the feature `gpu`.

use serde::{Deserialize, Serialize};
use std::fmt;

/// What an adapter is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AdapterKind {
    /// A card with memory of its own.
    Discrete,
    /// Beside the processor, sharing its memory.
    Integrated,
    /// A card lent to a virtual machine.
    Virtual,
    /// The processor playing a graphics card, such as Mesa's llvmpipe: for tests.
    Software,
    /// The driver does not say.
    Unknown,
}

impl AdapterKind {
    /// Whether it is hardware, which is faster than the processor at this work.
    pub fn is_hardware(self) -> bool {
        matches!(self, Self::Discrete | Self::Integrated | Self::Virtual)
    }
}

/// An adapter that the GPU backend can be opened on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Adapter {
    /// The driver's name of it.
    pub name: String,
    /// Interface it is reached by, such as `Vulkan`.
    pub interface: String,
    /// Hardware or not.
    pub kind: AdapterKind,
    /// Driver and its version.
    pub driver: String,
    /// Largest buffer that a kernel can see, bytes.
    pub max_binding: u64,
}

impl fmt::Display for Adapter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = match self.kind {
            AdapterKind::Discrete => "discrete",
            AdapterKind::Integrated => "integrated",
            AdapterKind::Virtual => "virtual",
            AdapterKind::Software => "software",
            AdapterKind::Unknown => "of unknown kind",
        };
        write!(f, "{} ({kind}, {})", self.name, self.interface)
    }
}
