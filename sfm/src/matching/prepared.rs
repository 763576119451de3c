//! Descriptors laid out for the matching kernels.

use scene::Features;

/// Length of a prepared descriptor; with it any dot product of two of them fits 16 bits without
/// sign.
/// Source: derived: `250² < 2¹⁶`, while 256² is not.
pub(super) const NORM: f32 = 250.0;
/// Descriptors a panel.
/// Source: derived: lanes of 16 bits in a vector of 256.
pub(super) const PANEL: usize = 16;
/// Rows that a kernel takes at once, and the most vectors of columns.
/// Source: derived: the 4 × 4 sums of a tile fill half of the 32 registers.
pub(super) const ROWS: usize = 4;
/// Descriptors that stay in the second-level cache while the rows of the other image pass.
/// Source: derived: 128 KiB, half of the smallest cache; no result depends on it.
pub(super) const BLOCK: usize = 1024;

/// The bytes of [`PANEL`] descriptors, aligned so that no vector of them lies in two cache lines.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(super) struct Panel(pub [u8; PANEL * Features::DIM]);

/// The descriptors of one image, scaled to length 250 and rounded to 7 bits: RootSIFT loses less
/// than 2 % of a unit by it, and two products of 7-bit numbers fit a signed 16-bit word, which is
/// what the processor multiplies fastest. Made once an image.
#[derive(Clone, Debug, Default)]
pub struct PreparedFeatures {
    /// Number of descriptors.
    len: usize,
    /// [len padded to a multiple of 64 × 128], row-major; padding is zero.
    rows: Vec<u8>,
    /// The same in panels of 16 descriptors: [panel × 128 / group × 16 × group], `group`
    /// consecutive components of each in turn.
    panels: Vec<Panel>,
    /// 1, 2 or 4: how many components the kernel multiplies and adds at once.
    group: usize,
}

impl PreparedFeatures {
    /// From descriptors of any length (they are normalised here).
    pub fn new(features: &Features) -> Self {
        Self::with_group(features, best_group())
    }

    /// For a kernel that takes `group` components at once.
    pub(super) fn with_group(features: &Features, group: usize) -> Self {
        let len = features.len();
        let padded = len.next_multiple_of(4 * PANEL);
        let mut rows = vec![0; padded * Features::DIM];
        for (row, descriptor) in
            rows.chunks_exact_mut(Features::DIM).zip(features.descriptors.chunks_exact(Features::DIM))
        {
            let norm = descriptor.iter().map(|&d| f32::from(d).powi(2)).sum::<f32>().sqrt();
            let scale = if norm > 0.0 { NORM / norm } else { 0.0 };
            for (r, &d) in row.iter_mut().zip(descriptor) {
                *r = (f32::from(d) * scale).round().min(127.0) as u8;
            }
        }
        let mut panels = vec![Panel([0; PANEL * Features::DIM]); padded / PANEL];
        for (Panel(panel), sixteen) in panels.iter_mut().zip(rows.chunks_exact(PANEL * Features::DIM)) {
            for (lane, row) in sixteen.chunks_exact(Features::DIM).enumerate() {
                for (k, some) in row.chunks_exact(group).enumerate() {
                    panel[(k * PANEL + lane) * group..][..group].copy_from_slice(some);
                }
            }
        }
        Self { len, rows, panels, group }
    }

    /// Memory of the descriptors, bytes.
    pub(super) fn bytes(&self) -> usize {
        self.rows.len() + size_of_val(self.panels.as_slice())
    }

    /// Number of descriptors.
    pub(crate) fn len(&self) -> usize {
        self.len
    }

    /// Whether there are none.
    pub(crate) fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Descriptor `i`.
    pub(super) fn row(&self, i: usize) -> &[u8] {
        &self.rows[i * Features::DIM..(i + 1) * Features::DIM]
    }

    /// How many components lie together in the panels.
    pub(super) fn group(&self) -> usize {
        self.group
    }

    /// All panels.
    pub(super) fn panels(&self) -> &[Panel] {
        &self.panels
    }
}

/// Components that the fastest kernel of this machine takes at once.
pub(super) fn best_group() -> usize {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx512bw") && std::arch::is_x86_feature_detected!("avx512vnni") {
        return 4;
    }
    if cfg!(target_arch = "aarch64") { 1 } else { 2 }
}

/// Squared Euclidean distance of the unit vectors behind a dot product of prepared descriptors.
pub(super) fn squared_distance(dot: u16) -> f32 {
    (2.0 - 2.0 * f32::from(dot) / (NORM * NORM)).max(0.0)
}

/// The dot product that belongs to a distance of unit vectors, rounded down; 0 from √2 on.
pub(super) fn dot_at_distance(distance: f32) -> u16 {
    ((1.0 - distance * distance / 2.0) * NORM * NORM).clamp(0.0, 65535.0) as u16
}
