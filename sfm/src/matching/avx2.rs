//! The AVX2 kernel: 4 rows against 32 columns at a time, 16 columns a vector.
//!
//! `vpmaddubsw` multiplies 32 pairs of 7-bit numbers and adds them two by two without overflow; sums wrap modulo
//! 2¹⁶ and begin at −32768, so that the unsigned dot product is compared as a signed number.

use super::kernel::TopTwo;
use super::prepared::{DIM, PANEL, PreparedFeatures};
use std::arch::x86_64::*;

const ROWS: usize = 4;
/// Descriptors of `b` that stay in the second-level cache while the rows of `a` pass (128 KiB).
const BLOCK: usize = 1024;

/// See [`super::kernel::top_two`].
#[target_feature(enable = "avx2")]
pub(super) fn sweep(a: &PreparedFeatures, b: &PreparedFeatures, rows: &mut TopTwo, columns: &mut TopTwo) {
    let mut words = [[0_u16; DIM / 2]; ROWS];
    for j0 in (0..b.len()).step_by(BLOCK) {
        let j1 = (j0 + BLOCK).min(b.len());
        for i in (0..a.len()).step_by(ROWS) {
            for (r, words) in words.iter_mut().enumerate() {
                for (word, pair) in words.iter_mut().zip(a.row(i + r).chunks_exact(2)) {
                    *word = u16::from_le_bytes([pair[0], pair[1]]);
                }
            }
            let mut expanded = [[0_u32; ROWS]; DIM / 2];
            for (k, e) in expanded.iter_mut().enumerate() {
                *e = std::array::from_fn(|r| u32::from(words[r][k]) * 0x1_0001);
            }
            let mut j = j0;
            while j < j1 {
                let panels = &b.panels()[j * DIM..];
                if j + PANEL < j1 {
                    let dots =
                        tile(&expanded, [&panels[..PANEL * DIM], &panels[PANEL * DIM..2 * PANEL * DIM]]);
                    offer(&dots, i, j, [a.len(), b.len()], rows, columns);
                    j += 2 * PANEL;
                } else {
                    let dots = tile(&expanded, [&panels[..PANEL * DIM]]);
                    offer(&dots, i, j, [a.len(), b.len()], rows, columns);
                    j += PANEL;
                }
            }
        }
    }
}

/// Biased dot products of 4 rows with the columns of `N` panels.
#[inline]
#[target_feature(enable = "avx2")]
fn tile<const N: usize>(rows: &[[u32; ROWS]; DIM / 2], panels: [&[u8]; N]) -> [[__m256i; N]; ROWS] {
    let mut sums = [[_mm256_set1_epi16(i16::MIN); N]; ROWS];
    for p in panels {
        assert!(p.len() >= PANEL * DIM);
    }
    for (k, row) in rows.iter().enumerate() {
        // SAFETY: every panel has DIM / 2 vectors of 32 bytes (asserted above); k < DIM / 2.
        let columns = panels.map(|p| unsafe { _mm256_loadu_si256(p.as_ptr().add(k * 32).cast()) });
        for (sums, &pair) in sums.iter_mut().zip(row) {
            let pair = _mm256_set1_epi32(pair as i32);
            for (sum, column) in sums.iter_mut().zip(columns) {
                *sum = _mm256_add_epi16(*sum, _mm256_maddubs_epi16(pair, column));
            }
        }
    }
    sums
}

/// Enters the dot products of a tile at (`i`, `j`) that beat a second-best; nearly always none does.
#[inline]
#[target_feature(enable = "avx2")]
fn offer<const N: usize>(
    dots: &[[__m256i; N]; ROWS],
    i: usize,
    j: usize,
    [rows_len, columns_len]: [usize; 2],
    rows: &mut TopTwo,
    columns: &mut TopTwo,
) {
    let mut better = [[_mm256_setzero_si256(); N]; ROWS];
    let mut any = _mm256_setzero_si256();
    assert!(j + N * PANEL <= columns.second.len() && i + ROWS <= rows.second.len());
    for n in 0..N {
        // SAFETY: within `columns.second` (asserted above).
        let column = unsafe { _mm256_loadu_si256(columns.second.as_ptr().add(j + n * PANEL).cast()) };
        for r in 0..ROWS {
            let row = _mm256_set1_epi16(rows.second[i + r]);
            let lower = _mm256_min_epi16(row, column);
            better[r][n] = _mm256_cmpgt_epi16(dots[r][n], lower);
            any = _mm256_or_si256(any, better[r][n]);
        }
    }
    if _mm256_testz_si256(any, any) != 0 {
        return;
    }
    for r in 0..ROWS.min(rows_len - i) {
        for n in 0..N {
            let mut lanes = _mm256_movemask_epi8(better[r][n]) as u32 & 0x5555_5555;
            if lanes == 0 {
                continue;
            }
            let mut values = [0_i16; PANEL];
            // SAFETY: 32 bytes.
            unsafe { _mm256_storeu_si256(values.as_mut_ptr().cast(), dots[r][n]) };
            while lanes != 0 {
                let lane = lanes.trailing_zeros() as usize / 2;
                lanes &= lanes - 1;
                let column = j + n * PANEL + lane;
                if column < columns_len {
                    rows.offer(i + r, values[lane], column as u32);
                    columns.offer(column, values[lane], (i + r) as u32);
                }
            }
        }
    }
}
