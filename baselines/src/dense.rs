//! Products with the weights of a dense layer: forward, and backward to inputs and weights.
//!
//! Activations are `[rows][width]`, a row a sample; widths are multiples of [`PANEL`], rows of
//! [`ROWS`]. Weights are packed in panels of [`PANEL`] outputs, `[outputs / PANEL][inputs][PANEL]`,
//! so that each product reads them in order. Every sum has a fixed order.

use splat::simd::{Isa, Simd};
use splat::simd_kernel;

/// Outputs that lie beside each other in a panel of weights.
/// Source: two registers of AVX2, one of AVX-512; 6 rows of them fill the 16 registers of AVX2.
pub(crate) const PANEL: usize = 16;
/// Rows of a tile held in registers. Source: see [`PANEL`].
pub(crate) const ROWS: usize = 6;
/// Inputs of a tile of weight gradients. Source: eight sums hide the latency of a product of AVX2.
const INPUTS: usize = 4;
/// Rows of which weight gradients are added up at a time.
/// Source: a panel of them and some columns of the other factor fill half a first-level cache.
const FEW_ROWS: usize = 192;

/// A width rounded up to whole panels.
pub(crate) fn padded(width: usize) -> usize {
    width.next_multiple_of(PANEL)
}

/// A number of rows rounded up to whole tiles.
pub(crate) fn padded_rows(rows: usize) -> usize {
    rows.next_multiple_of(ROWS)
}

/// `y = x W (+ bias)`, negative values 0 where `relu`.
pub(crate) struct Product<'a> {
    /// [rows × inputs]
    pub(crate) x: &'a [f32],
    pub(crate) inputs: usize,
    /// [outputs / PANEL × inputs × PANEL]
    pub(crate) panels: &'a [f32],
    /// [outputs]
    pub(crate) bias: Option<&'a [f32]>,
    pub(crate) outputs: usize,
    /// [rows × outputs]
    pub(crate) y: &'a mut [f32],
    pub(crate) relu: bool,
}

/// `grads += xᵀ dy`, and the sums of `dy` onto `bias`.
pub(crate) struct WeightGradient<'a> {
    /// [rows × inputs]
    pub(crate) x: &'a [f32],
    pub(crate) inputs: usize,
    /// [rows × outputs]
    pub(crate) dy: &'a [f32],
    pub(crate) outputs: usize,
    /// [outputs / PANEL × inputs × PANEL]
    pub(crate) grads: &'a mut [f32],
    /// [outputs]
    pub(crate) bias: Option<&'a mut [f32]>,
    /// Room for both factors in the order in which they are read.
    pub(crate) packed: &'a mut Vec<f32>,
}

#[inline(always)]
fn product_generic<S: Simd>(a: &mut Product) {
    match S::LANES {
        4 => product_by::<S, 4>(a),
        8 => product_by::<S, 2>(a),
        _ => product_by::<S, 1>(a),
    }
}
simd_kernel!(fn product_kernel(a: &mut Product) = product_generic);

/// See [`Product`].
pub(crate) fn product(mut a: Product) {
    let rows = a.x.len() / a.inputs;
    assert!(rows.is_multiple_of(ROWS) && a.outputs.is_multiple_of(PANEL), "whole tiles");
    assert_eq!((a.x.len(), a.y.len()), (rows * a.inputs, rows * a.outputs));
    assert_eq!(a.panels.len(), a.inputs * a.outputs);
    assert!(a.bias.is_none_or(|b| b.len() == a.outputs));
    product_kernel(Isa::best(), &mut a);
}

#[inline(always)]
fn product_by<S: Simd, const V: usize>(a: &mut Product) {
    let (inputs, outputs) = (a.inputs, a.outputs);
    let (rows, zero) = (a.y.len() / outputs, S::splat(0.0));
    for column in (0..outputs).step_by(PANEL) {
        let panel = &a.panels[column * inputs..][..PANEL * inputs];
        let mut first = [zero; V];
        if let Some(bias) = a.bias {
            for v in 0..V {
                first[v] = S::read(&bias[column + v * S::LANES..]);
            }
        }
        for row in (0..rows).step_by(ROWS) {
            let x = &a.x[row * inputs..][..ROWS * inputs];
            // SAFETY: x has ROWS rows of `inputs`, the panel V · LANES weights for each input.
            let sums = unsafe { tile::<S, V>(x.as_ptr(), inputs, panel.as_ptr(), first) };
            for (r, sums) in sums.iter().enumerate() {
                let y = &mut a.y[(row + r) * outputs + column..][..PANEL];
                for (v, sum) in sums.iter().enumerate() {
                    let sum = if a.relu { sum.max(zero) } else { *sum };
                    sum.write(&mut y[v * S::LANES..]);
                }
            }
        }
    }
}

/// `first + x W` for a tile of rows and one panel.
/// # Safety
/// `x` points to ROWS rows of `inputs`, `w` to V registers for each input.
#[inline(always)]
unsafe fn tile<S: Simd, const V: usize>(
    mut x: *const f32,
    inputs: usize,
    mut w: *const f32,
    first: [S; V],
) -> [[S; V]; ROWS] {
    let mut sums = [first; ROWS];
    for _ in 0..inputs {
        let mut weights = first;
        for (v, weight) in weights.iter_mut().enumerate() {
            // SAFETY: the caller vouches for the panel.
            *weight = unsafe { S::load(w.add(v * S::LANES)) };
        }
        for (r, sums) in sums.iter_mut().enumerate() {
            // SAFETY: the caller vouches for the rows.
            let value = S::splat(unsafe { *x.add(r * inputs) });
            for v in 0..V {
                sums[v] = value.fma(weights[v], sums[v]);
            }
        }
        // SAFETY: at most one past the end.
        (x, w) = unsafe { (x.add(1), w.add(PANEL)) };
    }
    sums
}

#[inline(always)]
fn weights_generic<S: Simd>(a: &mut WeightGradient) {
    match S::LANES {
        4 => weights_by::<S, 4>(a),
        8 => weights_by::<S, 2>(a),
        _ => weights_by::<S, 1>(a),
    }
}
simd_kernel!(fn weights_kernel(a: &mut WeightGradient) = weights_generic);

/// See [`WeightGradient`].
pub(crate) fn weight_gradient(mut a: WeightGradient) {
    let rows = a.x.len() / a.inputs;
    assert!(a.inputs.is_multiple_of(INPUTS) && a.outputs.is_multiple_of(PANEL), "whole tiles");
    assert_eq!((a.x.len(), a.dy.len()), (rows * a.inputs, rows * a.outputs));
    assert_eq!(a.grads.len(), a.inputs * a.outputs);
    weights_kernel(Isa::best(), &mut a);
    if let Some(bias) = a.bias {
        for dy in a.dy.chunks_exact(a.outputs) {
            bias.iter_mut().zip(dy).for_each(|(b, g)| *b += g);
        }
    }
}

#[inline(always)]
fn weights_by<S: Simd, const V: usize>(a: &mut WeightGradient) {
    let (inputs, outputs) = (a.inputs, a.outputs);
    let blocks = a.x.chunks(FEW_ROWS * inputs).zip(a.dy.chunks(FEW_ROWS * outputs));
    for (x, dy) in blocks {
        let rows = x.len() / inputs;
        a.packed.resize(rows * (inputs + PANEL), 0.0);
        let (packed, panel_of_dy) = a.packed.split_at_mut(rows * inputs);
        pack::<INPUTS>(x, inputs, packed);
        for column in (0..outputs).step_by(PANEL) {
            pack::<PANEL>(&dy[column..], outputs, panel_of_dy);
            let panel = &mut a.grads[column * inputs..][..PANEL * inputs];
            for i in (0..inputs).step_by(INPUTS) {
                let place = &mut panel[i * PANEL..][..INPUTS * PANEL];
                add_products::<S, V>(rows, &packed[i * rows..], panel_of_dy, place);
            }
        }
    }
}

/// Adds a tile of weight gradients: `xᵀ dy` of INPUTS packed columns and a packed panel.
#[inline(always)]
fn add_products<S: Simd, const V: usize>(rows: usize, x: &[f32], dy: &[f32], place: &mut [f32]) {
    let (x, dy) = (&x[..rows * INPUTS], &dy[..rows * PANEL]);
    let mut sums = [[S::splat(0.0); V]; INPUTS];
    for k in 0..INPUTS {
        for v in 0..V {
            sums[k][v] = S::read(&place[k * PANEL + v * S::LANES..]);
        }
    }
    // SAFETY: both hold `rows` rows, of INPUTS and of PANEL values.
    let sums = unsafe { outer::<S, V>(rows, x.as_ptr(), dy.as_ptr(), sums) };
    for k in 0..INPUTS {
        for v in 0..V {
            sums[k][v].write(&mut place[k * PANEL + v * S::LANES..]);
        }
    }
}

/// Columns of `from`, which is `stride` wide, in blocks of N beside each other: [blocks][rows][N];
/// as many blocks as fit into `to`.
#[inline(always)]
fn pack<const N: usize>(from: &[f32], stride: usize, to: &mut [f32]) {
    let rows = from.len().div_ceil(stride);
    for (block, to) in to.chunks_exact_mut(rows * N).enumerate() {
        for (row, to) in to.as_chunks_mut::<N>().0.iter_mut().enumerate() {
            to.copy_from_slice(&from[row * stride + block * N..][..N]);
        }
    }
}

/// `sums + xᵀ dy` for INPUTS columns of `x` and one panel of `dy`.
/// # Safety
/// Both point to `rows` rows, of INPUTS values and of V registers.
#[inline(always)]
unsafe fn outer<S: Simd, const V: usize>(
    rows: usize,
    mut x: *const f32,
    mut dy: *const f32,
    mut sums: [[S; V]; INPUTS],
) -> [[S; V]; INPUTS] {
    for _ in 0..rows {
        let mut gradients = sums[0];
        for (v, gradient) in gradients.iter_mut().enumerate() {
            // SAFETY: the caller vouches for the rows.
            *gradient = unsafe { S::load(dy.add(v * S::LANES)) };
        }
        for (k, sums) in sums.iter_mut().enumerate() {
            // SAFETY: the caller vouches for the rows.
            let value = S::splat(unsafe { *x.add(k) });
            for v in 0..V {
                sums[v] = value.fma(gradients[v], sums[v]);
            }
        }
        // SAFETY: at most one past the end.
        (x, dy) = unsafe { (x.add(INPUTS), dy.add(PANEL)) };
    }
    sums
}

/// Sets `dy` to 0 where the activation `y` is not positive: backward through the rectifier.
pub(crate) fn rectify(dy: &mut [f32], y: &[f32]) {
    for (g, &y) in dy.iter_mut().zip(y) {
        *g = if y > 0.0 { *g } else { 0.0 };
    }
}

/// Where weight (input, output) lies in the panels of a layer.
pub(crate) fn place(input: usize, output: usize, inputs: usize) -> usize {
    (output / PANEL * inputs + input) * PANEL + output % PANEL
}

/// The panels of the transposed weights, for the product that leads back to the inputs.
pub(crate) fn transpose(panels: &[f32], inputs: usize, outputs: usize, transposed: &mut [f32]) {
    for o in 0..outputs {
        for i in 0..inputs {
            transposed[place(o, i, outputs)] = panels[place(i, o, inputs)];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng as _;

    fn random(n: usize, index: u64) -> Vec<f32> {
        let mut rng = scene::rng::rng(7, "dense", index);
        (0..n).map(|_| rng.random_range(-1.0..1.0)).collect()
    }

    #[test]
    fn the_products_agree_with_sums_in_f64() {
        for (rows, inputs, outputs) in [(6, 16, 16), (12, 32, 64), (18, 64, 48)] {
            let (x, panels, dy) =
                (random(rows * inputs, 0), random(inputs * outputs, 1), random(rows * outputs, 2));
            let bias = random(outputs, 3);
            let at = |i, o| f64::from(panels[place(i, o, inputs)]);
            let mut y = vec![0.0; rows * outputs];
            let bias_of = Some(bias.as_slice());
            product(Product {
                x: &x,
                inputs,
                panels: &panels,
                bias: bias_of,
                outputs,
                y: &mut y,
                relu: true,
            });
            let (mut grads, mut sums) = (vec![0.0; inputs * outputs], vec![0.0; outputs]);
            let bias_sums = Some(sums.as_mut_slice());
            weight_gradient(WeightGradient {
                x: &x,
                inputs,
                dy: &dy,
                outputs,
                grads: &mut grads,
                bias: bias_sums,
                packed: &mut Vec::new(),
            });
            let (mut back, mut dx) = (vec![0.0; inputs * outputs], vec![0.0; rows * inputs]);
            transpose(&panels, inputs, outputs, &mut back);
            product(Product {
                x: &dy,
                inputs: outputs,
                panels: &back,
                bias: None,
                outputs: inputs,
                y: &mut dx,
                relu: false,
            });
            for r in 0..rows {
                for o in 0..outputs {
                    let sum: f64 = (0..inputs).map(|i| f64::from(x[r * inputs + i]) * at(i, o)).sum();
                    let truth = (sum + f64::from(bias[o])).max(0.0);
                    assert!((f64::from(y[r * outputs + o]) - truth).abs() < 1e-5);
                }
                for i in 0..inputs {
                    let truth: f64 = (0..outputs).map(|o| f64::from(dy[r * outputs + o]) * at(i, o)).sum();
                    assert!((f64::from(dx[r * inputs + i]) - truth).abs() < 1e-5);
                }
            }
            for o in 0..outputs {
                let column = |r: usize| f64::from(dy[r * outputs + o]);
                assert!((f64::from(sums[o]) - (0..rows).map(column).sum::<f64>()).abs() < 1e-5);
                for i in 0..inputs {
                    let truth: f64 = (0..rows).map(|r| f64::from(x[r * inputs + i]) * column(r)).sum();
                    assert!((f64::from(grads[place(i, o, inputs)]) - truth).abs() < 1e-5);
                }
            }
        }
    }
}
