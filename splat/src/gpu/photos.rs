//! Photos that stay on the device: 8-bit RGBA, the mask in alpha, sent once.

use super::context::Gpu;
use super::layout::FrameFlag;
use crate::backend::Target;
use std::collections::HashMap;

/// Bytes of the first buffer that photos share, and of the largest; each is twice the one before.
/// Source: chosen by hand, never measured.
const SHELVES: [u64; 2] = [1 << 20, 64 << 20];

/// Where a photo lies, and what its mask means.
#[derive(Clone)]
pub(crate) struct PlacedPhoto {
    /// The buffer; nothing where the photo was written to the goal itself.
    pub(crate) shelf: Option<wgpu::Buffer>,
    /// First byte.
    pub(crate) offset: u64,
    /// Bytes.
    pub(crate) bytes: u64,
    /// Flags of its mask.
    pub(crate) flags: u32,
    /// Sum of its weights.
    pub(crate) weights: f64,
}

/// The photos seen so far, by number and size.
#[derive(Default)]
pub(crate) struct Photos {
    held: HashMap<(u32, u64), PlacedPhoto>,
    shelves: Vec<wgpu::Buffer>,
    /// Bytes used of the last shelf.
    used: u64,
    /// No more room: the others are sent in every step.
    full: bool,
}

impl Photos {
    /// Bytes of all shelves.
    pub(crate) fn memory(&self) -> u64 {
        self.shelves.iter().map(wgpu::Buffer::size).sum()
    }

    /// How many lie here.
    #[cfg(test)]
    pub(crate) fn count(&self) -> usize {
        self.held.len()
    }

    /// Where the target lies; it is sent if need be: to a shelf if it has a number and there is
    /// room for it (of `budget` bytes), otherwise to `goal`.
    pub(crate) fn place(
        &mut self,
        gpu: &Gpu,
        goal: &wgpu::Buffer,
        target: &Target,
        budget: Option<u64>,
    ) -> PlacedPhoto {
        let bytes = 4 * (target.rgb.len() / 3) as u64;
        let key = target.photo.map(|number| (number, bytes));
        if let Some(photo) = key.and_then(|key| self.held.get(&key)) {
            return photo.clone();
        }
        let (flags, weights) = mask_of(target);
        let place = key.and_then(|_| self.room(gpu, bytes, budget));
        let (shelf, offset) = place.map_or((None, 0), |(shelf, offset)| (Some(shelf), offset));
        gpu.write(shelf.as_ref().unwrap_or(goal), offset, &rgba(target));
        let photo = PlacedPhoto { shelf, offset, bytes, flags, weights };
        if let Some(key) = key.filter(|_| photo.shelf.is_some()) {
            self.held.insert(key, photo.clone());
        }
        photo
    }

    fn room(&mut self, gpu: &Gpu, bytes: u64, budget: Option<u64>) -> Option<(wgpu::Buffer, u64)> {
        let fits = self.shelves.last().is_some_and(|shelf| self.used + bytes <= shelf.size());
        if !fits {
            let size = self.shelves.last().map_or(SHELVES[0], |last| (2 * last.size()).min(SHELVES[1]));
            let size = size.min(gpu.largest_buffer()).min(budget.unwrap_or(size)).max(bytes);
            if self.full || budget.is_some_and(|most| self.memory() + size > most) {
                self.full = true;
                return None;
            }
            let Ok(shelf) = gpu.buffer("photos", size / 4 * 4, None) else {
                self.full = true;
                return None;
            };
            self.shelves.push(shelf);
            self.used = 0;
        }
        let offset = self.used;
        self.used += bytes;
        self.shelves.last().map(|shelf| (shelf.clone(), offset))
    }
}

/// Flags of the target's mask, and the sum of its weights.
fn mask_of(target: &Target) -> (u32, f64) {
    let count = target.rgb.len() / 3;
    match target.mask {
        Some(_) if target.transparent => (FrameFlag::Coverage as u32, count as f64),
        Some(mask) => {
            (FrameFlag::Weighted as u32, mask.iter().map(|&m| u64::from(m)).sum::<u64>() as f64 / 255.0)
        }
        None => (0, count as f64),
    }
}

fn rgba(target: &Target) -> Vec<[u8; 4]> {
    let pixels = target.rgb.chunks_exact(3);
    match target.mask {
        Some(mask) => pixels.zip(mask).map(|(c, &m)| [c[0], c[1], c[2], m]).collect(),
        None => pixels.map(|c| [c[0], c[1], c[2], 255]).collect(),
    }
}
