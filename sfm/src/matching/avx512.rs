//! The AVX-512 kernel: 4 rows against 64 columns at a time, 16 columns a vector.
//!
//! `vpdpbusd` multiplies 64 pairs of 8-bit numbers and adds them four by four to 32-bit sums, which begin at −32768 so
//! that they compare with the biased numbers of [`TopTwo`].

// Tiles are small squares: rows and vectors are counted, not iterated.
#![allow(clippy::needless_range_loop)]

use super::kernel::TopTwo;
use super::prepared::{DIM, PANEL, PreparedFeatures};
use std::arch::x86_64::*;

const ROWS: usize = 4;
/// Vectors of columns.
const WIDE: usize = 4;
/// Steps of four components.
const STEPS: usize = DIM / 4;
/// Descriptors of `b` that stay in the second-level cache while the rows of `a` pass (256 KiB).
const BLOCK: usize = 2048;
/// Four panels: the columns of a tile.
type Columns = [u8; WIDE * PANEL * DIM];
/// Dot products of a tile, biased.
type Dots = [[__m512i; WIDE]; ROWS];

/// See [`super::kernel::top_two`].
#[target_feature(enable = "avx512f,avx512bw,avx512vnni")]
pub(super) fn sweep(a: &PreparedFeatures, b: &PreparedFeatures, rows: &mut TopTwo, columns: &mut TopTwo) {
    let (tiles, _) = b.panels().as_chunks::<{ WIDE * PANEL * DIM }>();
    let mut words = [[0_i32; ROWS]; STEPS];
    for (block, tiles) in tiles.chunks(BLOCK / (WIDE * PANEL)).enumerate() {
        for i in (0..a.len()).step_by(ROWS) {
            for r in 0..ROWS {
                for (w, four) in words.iter_mut().zip(a.row(i + r).as_chunks::<4>().0) {
                    w[r] = i32::from_le_bytes(*four);
                }
            }
            for (t, tile) in tiles.iter().enumerate() {
                let dots = multiply(&words, tile);
                let j = block * BLOCK + t * WIDE * PANEL;
                for r in 0..ROWS {
                    for n in 0..WIDE {
                        let lanes = above(dots[r][n], i + r, j + n * PANEL, rows, columns);
                        if lanes != 0 {
                            offer(
                                dots[r][n],
                                lanes,
                                [i + r, j + n * PANEL],
                                [a.len(), b.len()],
                                rows,
                                columns,
                            );
                        }
                    }
                }
            }
        }
    }
}

/// Biased dot products of 4 rows with the 64 columns of a tile.
#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512vnni")]
fn multiply(rows: &[[i32; ROWS]; STEPS], tile: &Columns) -> Dots {
    let mut sums = [[_mm512_set1_epi32(i32::from(i16::MIN)); WIDE]; ROWS];
    for (k, row) in rows.iter().enumerate() {
        let mut column = [_mm512_setzero_si512(); WIDE];
        for n in 0..WIDE {
            // SAFETY: k < STEPS, and each of the WIDE panels holds STEPS vectors of 64 bytes.
            column[n] = unsafe { _mm512_loadu_si512(tile.as_ptr().add(n * PANEL * DIM + k * 64).cast()) };
        }
        for r in 0..ROWS {
            let four = _mm512_set1_epi32(row[r]);
            for n in 0..WIDE {
                sums[r][n] = _mm512_dpbusd_epi32(sums[r][n], column[n], four);
            }
        }
    }
    sums
}

/// Lanes above the second-best of the row or of their column: nearly always none.
#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512vnni")]
fn above(dots: __m512i, i: usize, j: usize, rows: &TopTwo, columns: &TopTwo) -> u16 {
    let values = &columns.second[j..j + PANEL];
    // SAFETY: 16 values of 2 bytes.
    let column = _mm512_cvtepi16_epi32(unsafe { _mm256_loadu_si256(values.as_ptr().cast()) });
    let row = _mm512_set1_epi32(i32::from(rows.second[i]));
    _mm512_cmpgt_epi32_mask(dots, _mm512_min_epi32(row, column))
}

/// Enters the dot products of a row with 16 columns.
#[inline(never)]
#[target_feature(enable = "avx512f,avx512bw,avx512vnni")]
fn offer(
    dots: __m512i,
    mut lanes: u16,
    [i, j]: [usize; 2],
    len: [usize; 2],
    rows: &mut TopTwo,
    columns: &mut TopTwo,
) {
    if i >= len[0] {
        return;
    }
    let mut values = [0_i32; PANEL];
    // SAFETY: 64 bytes.
    unsafe { _mm512_storeu_si512(values.as_mut_ptr().cast(), dots) };
    while lanes != 0 {
        let lane = lanes.trailing_zeros() as usize;
        lanes &= lanes - 1;
        if j + lane < len[1] {
            // Biased sums of unit vectors of length 250 fit 16 bits.
            rows.offer(i, values[lane] as i16, (j + lane) as u32);
            columns.offer(j + lane, values[lane] as i16, i as u32);
        }
    }
}
