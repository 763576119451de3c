//! The AVX2 kernel: 4 rows against 32 columns at a time, 16 columns a vector.
//!
//! `vpmaddubsw` multiplies 32 pairs of 7-bit numbers and adds them two by two without overflow;
//! sums wrap modulo 2¹⁶ and begin at −32768, so that the unsigned dot product is compared as a
//! signed number.

// Tiles are small squares: rows and vectors are counted, not iterated.
#![allow(clippy::needless_range_loop)]

use super::prepared::{BLOCK, PANEL, Panel, PreparedFeatures, ROWS};
use super::top_two::TopTwo;
use scene::Features;
use std::arch::x86_64::*;

/// Four rows: two components of each at every step, twice.
type Avx2Words = [[u32; ROWS]; Features::DIM / 2];
/// Two panels: the columns of a tile.
type Avx2Columns = [Panel; 2];
/// Dot products of a tile, biased.
type Avx2Dots = [[__m256i; 2]; ROWS];

/// See [`super::kernel::top_two`].
#[target_feature(enable = "avx2")]
pub(super) fn sweep(a: &PreparedFeatures, b: &PreparedFeatures, rows: &mut TopTwo, columns: &mut TopTwo) {
    let (tiles, _) = b.panels().as_chunks::<2>();
    let mut expanded: Avx2Words = [[0; ROWS]; Features::DIM / 2];
    for (block, tiles) in tiles.chunks(BLOCK / (2 * PANEL)).enumerate() {
        for i in (0..a.len()).step_by(ROWS) {
            for r in 0..ROWS {
                for (e, pair) in expanded.iter_mut().zip(a.row(i + r).chunks_exact(2)) {
                    e[r] = u32::from(u16::from_le_bytes([pair[0], pair[1]])) * 0x1_0001;
                }
            }
            for (t, tile) in tiles.iter().enumerate() {
                let dots = multiply(&expanded, tile);
                let j = block * BLOCK + t * 2 * PANEL;
                if beats(&dots, i, j, rows, columns) {
                    offer(&dots, [i, j], [a.len(), b.len()], rows, columns);
                }
            }
        }
    }
}

/// Biased dot products of 4 rows with the 32 columns of a tile.
#[inline]
#[target_feature(enable = "avx2")]
fn multiply(rows: &Avx2Words, tile: &Avx2Columns) -> Avx2Dots {
    let mut sums = [[_mm256_set1_epi16(i16::MIN); 2]; ROWS];
    let [left, right] = tile;
    for (k, row) in rows.iter().enumerate() {
        // SAFETY: both panels hold a vector of 32 bytes for each of the steps that are counted.
        let (x, y) = unsafe {
            let (x, y) = (left.0.as_ptr().add(k * 32), right.0.as_ptr().add(k * 32));
            (_mm256_loadu_si256(x.cast()), _mm256_loadu_si256(y.cast()))
        };
        for r in 0..ROWS {
            let pair = _mm256_set1_epi32(row[r] as i32);
            sums[r][0] = _mm256_add_epi16(sums[r][0], _mm256_maddubs_epi16(pair, x));
            sums[r][1] = _mm256_add_epi16(sums[r][1], _mm256_maddubs_epi16(pair, y));
        }
    }
    sums
}

/// The second-best of 16 columns from `j` on.
#[inline]
#[target_feature(enable = "avx2")]
fn seconds(columns: &TopTwo, j: usize) -> __m256i {
    let values = &columns.second[j..j + PANEL];
    // SAFETY: 16 values of 2 bytes.
    unsafe { _mm256_loadu_si256(values.as_ptr().cast()) }
}

/// Whether a dot product of the tile is above the second-best of its row or of its column: nearly
/// always no.
#[inline]
#[target_feature(enable = "avx2")]
fn beats(dots: &Avx2Dots, i: usize, j: usize, rows: &TopTwo, columns: &TopTwo) -> bool {
    let column = [seconds(columns, j), seconds(columns, j + PANEL)];
    let mut any = _mm256_setzero_si256();
    for (dots, &second) in dots.iter().zip(&rows.second[i..i + ROWS]) {
        let row = _mm256_set1_epi16(second);
        for n in 0..2 {
            let lower = _mm256_min_epi16(row, column[n]);
            any = _mm256_or_si256(any, _mm256_cmpgt_epi16(dots[n], lower));
        }
    }
    _mm256_testz_si256(any, any) == 0
}

/// Enters the dot products of the tile at (`i`, `j`).
#[inline(never)]
#[target_feature(enable = "avx2")]
fn offer(dots: &Avx2Dots, [i, j]: [usize; 2], len: [usize; 2], rows: &mut TopTwo, columns: &mut TopTwo) {
    for r in 0..ROWS.min(len[0] - i) {
        for n in 0..2 {
            let first = j + n * PANEL;
            let row = _mm256_set1_epi16(rows.second[i + r]);
            let lower = _mm256_min_epi16(row, seconds(columns, first));
            let mut lanes = _mm256_movemask_epi8(_mm256_cmpgt_epi16(dots[r][n], lower)) as u32 & 0x5555_5555;
            if lanes == 0 {
                continue;
            }
            let mut values = [0_i16; PANEL];
            // SAFETY: 32 bytes.
            unsafe { _mm256_storeu_si256(values.as_mut_ptr().cast(), dots[r][n]) };
            while lanes != 0 {
                let lane = lanes.trailing_zeros() as usize / 2;
                lanes &= lanes - 1;
                if first + lane < len[1] {
                    rows.offer(i + r, values[lane], (first + lane) as u32);
                    columns.offer(first + lane, values[lane], (i + r) as u32);
                }
            }
        }
    }
}
