//! The NEON kernel: 4 rows against 16 columns at a time, 8 columns a vector.
//!
//! `umlal` multiplies eight pairs of 7-bit numbers and adds them to sums of 16 bits, one component
//! of all columns after the other; sums without sign wrap modulo 2¹⁶ and are compared with their
//! highest bit flipped.

// Tiles are small squares: rows and vectors are counted, not iterated.
#![allow(clippy::needless_range_loop)]

use super::prepared::{BLOCK, PANEL, Panel, PreparedFeatures, ROWS};
use super::top_two::TopTwo;
use scene::Features;
use std::arch::aarch64::*;

/// Dot products of a tile, biased; a vector holds half of a panel's columns.
type NeonDots = [[int16x8_t; 2]; ROWS];

/// See [`super::kernel::top_two`]; of panels of single components.
#[target_feature(enable = "neon")]
pub(super) fn sweep(a: &PreparedFeatures, b: &PreparedFeatures, rows: &mut TopTwo, columns: &mut TopTwo) {
    for (block, panels) in b.panels().chunks(BLOCK / PANEL).enumerate() {
        for i in (0..a.len()).step_by(ROWS) {
            let own: [&[u8]; ROWS] = std::array::from_fn(|r| a.row(i + r));
            for (t, panel) in panels.iter().enumerate() {
                let dots = multiply(own, panel);
                let j = block * BLOCK + t * PANEL;
                if beats(&dots, i, j, rows, columns) {
                    offer(&dots, [i, j], [a.len(), b.len()], rows, columns);
                }
            }
        }
    }
}

/// Biased dot products of 4 rows with the 16 columns of a panel.
#[inline]
#[target_feature(enable = "neon")]
fn multiply(rows: [&[u8]; ROWS], panel: &Panel) -> NeonDots {
    let mut sums = [[vdupq_n_u16(0); 2]; ROWS];
    for k in 0..Features::DIM {
        // SAFETY: k < Features::DIM, and a panel holds Features::DIM vectors of 16 bytes.
        let column = unsafe { vld1q_u8(panel.0.as_ptr().add(k * PANEL)) };
        for r in 0..ROWS {
            let own = vdupq_n_u8(rows[r][k]);
            sums[r][0] = vmlal_u8(sums[r][0], vget_low_u8(column), vget_low_u8(own));
            sums[r][1] = vmlal_high_u8(sums[r][1], column, own);
        }
    }
    let flip = vdupq_n_u16(0x8000);
    sums.map(|two| two.map(|sum| vreinterpretq_s16_u16(veorq_u16(sum, flip))))
}

/// The lower of a row's second-best and those of 8 columns from `j` on.
#[inline]
#[target_feature(enable = "neon")]
fn lower(row: i16, columns: &TopTwo, j: usize) -> int16x8_t {
    let values = &columns.second[j..j + PANEL / 2];
    // SAFETY: 8 values of 2 bytes.
    vminq_s16(vdupq_n_s16(row), unsafe { vld1q_s16(values.as_ptr()) })
}

/// Whether a dot product of the tile is above the second-best of its row or of its column: nearly
/// always no.
#[inline]
#[target_feature(enable = "neon")]
fn beats(dots: &NeonDots, i: usize, j: usize, rows: &TopTwo, columns: &TopTwo) -> bool {
    let mut any = vdupq_n_u16(0);
    for (dots, &second) in dots.iter().zip(&rows.second[i..i + ROWS]) {
        for n in 0..2 {
            any = vorrq_u16(any, vcgtq_s16(dots[n], lower(second, columns, j + n * PANEL / 2)));
        }
    }
    vmaxvq_u16(any) != 0
}

/// Enters the dot products of the tile at (`i`, `j`).
#[inline(never)]
#[target_feature(enable = "neon")]
fn offer(dots: &NeonDots, [i, j]: [usize; 2], len: [usize; 2], rows: &mut TopTwo, columns: &mut TopTwo) {
    for r in 0..ROWS.min(len[0] - i) {
        for n in 0..2 {
            let first = j + n * PANEL / 2;
            let above = vcgtq_s16(dots[r][n], lower(rows.second[i + r], columns, first));
            if vmaxvq_u16(above) == 0 {
                continue;
            }
            let (mut values, mut beaten) = ([0_i16; PANEL / 2], [0_u16; PANEL / 2]);
            // SAFETY: 16 bytes each.
            unsafe {
                vst1q_s16(values.as_mut_ptr(), dots[r][n]);
                vst1q_u16(beaten.as_mut_ptr(), above);
            }
            for lane in (0..PANEL / 2).filter(|&lane| beaten[lane] != 0 && first + lane < len[1]) {
                rows.offer(i + r, values[lane], (first + lane) as u32);
                columns.offer(first + lane, values[lane], (i + r) as u32);
            }
        }
    }
}
