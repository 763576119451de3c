//! The AVX-512 kernel: 4 rows against 64 columns at a time, 16 columns a vector.
//!
//! `vpdpbusd` multiplies 64 pairs of 8-bit numbers and adds them four by four to 32-bit sums, which
//! begin at −32768 so that they compare with the biased numbers of [`TopTwo`].

// Tiles are small squares: rows and vectors are counted, not iterated.
#![allow(clippy::needless_range_loop)]

use super::prepared::{BLOCK, PANEL, Panel, PreparedFeatures, ROWS};
use super::top_two::TopTwo;
use scene::Features;
use std::arch::x86_64::*;

/// Fours of rows that a tile meets while it lies in the first-level cache (8 KiB, and as much for
/// the tile).
/// Source: derived from its size.
const FOURS: usize = 16;
/// As many panels as rows: the columns of a tile.
type Avx512Columns = [Panel; ROWS];
/// Four rows: the word of each at every step.
type Avx512Words = [[i32; ROWS]; Features::DIM / 4];
/// Dot products of a tile, biased.
type Avx512Dots = [[__m512i; ROWS]; ROWS];

/// See [`super::kernel::top_two`].
#[target_feature(enable = "avx512f,avx512bw,avx512vnni")]
pub(super) fn sweep(a: &PreparedFeatures, b: &PreparedFeatures, rows: &mut TopTwo, columns: &mut TopTwo) {
    let (tiles, _) = b.panels().as_chunks::<ROWS>();
    let mut words: [Avx512Words; FOURS] = [[[0; ROWS]; Features::DIM / 4]; FOURS];
    for (block, tiles) in tiles.chunks(BLOCK / (ROWS * PANEL)).enumerate() {
        for first in (0..a.len()).step_by(FOURS * ROWS) {
            let fours = (a.len() - first).div_ceil(ROWS).min(FOURS);
            for (f, words) in words[..fours].iter_mut().enumerate() {
                fill(words, a, first + f * ROWS);
            }
            for (t, tile) in tiles.iter().enumerate() {
                let j = block * BLOCK + t * ROWS * PANEL;
                for (f, words) in words[..fours].iter().enumerate() {
                    let (i, dots) = (first + f * ROWS, multiply(words, tile));
                    let lanes = above(&dots, i, j, rows, columns);
                    for r in 0..ROWS {
                        if lanes[r] != 0 {
                            offer(&dots[r], lanes[r], [i + r, j], [a.len(), b.len()], rows, columns);
                        }
                    }
                }
            }
        }
    }
}

fn fill(words: &mut Avx512Words, a: &PreparedFeatures, i: usize) {
    for r in 0..ROWS {
        for (w, four) in words.iter_mut().zip(a.row(i + r).as_chunks::<4>().0) {
            w[r] = i32::from_le_bytes(*four);
        }
    }
}

/// Biased dot products of 4 rows with the 64 columns of a tile.
#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512vnni")]
fn multiply(rows: &Avx512Words, tile: &Avx512Columns) -> Avx512Dots {
    let mut sums = [[_mm512_set1_epi32(i32::from(i16::MIN)); ROWS]; ROWS];
    for (k, row) in rows.iter().enumerate() {
        let mut column = [_mm512_setzero_si512(); ROWS];
        for n in 0..ROWS {
            // SAFETY: a panel holds a vector of 64 bytes for each of the steps that are counted,
            // the first of them aligned.
            column[n] = unsafe { _mm512_load_si512(tile[n].0.as_ptr().add(k * 64).cast()) };
        }
        for r in 0..ROWS {
            let four = _mm512_set1_epi32(row[r]);
            for n in 0..ROWS {
                sums[r][n] = _mm512_dpbusd_epi32(sums[r][n], column[n], four);
            }
        }
    }
    sums
}

/// The dot products of each row that are above its second-best or their column's, a bit a column.
#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512vnni")]
fn above(dots: &Avx512Dots, i: usize, j: usize, rows: &TopTwo, columns: &TopTwo) -> [u64; ROWS] {
    let mut column = [_mm512_setzero_si512(); ROWS];
    for n in 0..ROWS {
        let values = &columns.second[j + n * PANEL..j + (n + 1) * PANEL];
        // SAFETY: 16 values of 2 bytes.
        column[n] = _mm512_cvtepi16_epi32(unsafe { _mm256_loadu_si256(values.as_ptr().cast()) });
    }
    let mut lanes = [0; ROWS];
    for r in 0..ROWS {
        let row = _mm512_set1_epi32(i32::from(rows.second[i + r]));
        for n in 0..ROWS {
            let mask = _mm512_cmpgt_epi32_mask(dots[r][n], _mm512_min_epi32(row, column[n]));
            lanes[r] |= u64::from(mask) << (n * PANEL);
        }
    }
    lanes
}

/// Enters the dot products of row `i` with the 64 columns from `j` on.
#[inline(never)]
#[target_feature(enable = "avx512f,avx512bw,avx512vnni")]
fn offer(
    dots: &[__m512i; ROWS],
    mut lanes: u64,
    [i, j]: [usize; 2],
    len: [usize; 2],
    rows: &mut TopTwo,
    columns: &mut TopTwo,
) {
    if i >= len[0] {
        return;
    }
    let mut values = [[0_i32; PANEL]; ROWS];
    for (values, dots) in values.iter_mut().zip(dots) {
        // SAFETY: 64 bytes.
        unsafe { _mm512_storeu_si512(values.as_mut_ptr().cast(), *dots) };
    }
    while lanes != 0 {
        let lane = lanes.trailing_zeros() as usize;
        lanes &= lanes - 1;
        if j + lane < len[1] {
            // Biased sums of unit vectors of length 250 fit 16 bits.
            let value = values[lane / PANEL][lane % PANEL] as i16;
            rows.offer(i, value, (j + lane) as u32);
            columns.offer(j + lane, value, i as u32);
        }
    }
}
