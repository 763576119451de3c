//! Cholesky's factor of a covariance, and values in whose units errors are independent.

/// `aᵀ b`.
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// Cholesky's lower factor of a symmetric matrix (what is above its diagonal has no meaning).
pub(crate) fn cholesky(mut s: Vec<f64>, n: usize) -> Option<Vec<f64>> {
    for i in 0..n {
        for k in 0..=i {
            let (above, own) = s.split_at(i * n);
            let row = if k == i { &own[..k] } else { &above[k * n..k * n + k] };
            let rest = own[k] - dot(&own[..k], row);
            s[i * n + k] = match i == k {
                true if !(rest > 0.0) => return None,
                true => rest.sqrt(),
                false => rest / s[k * n + k],
            };
        }
    }
    Some(s)
}

/// `(L Lᵀ)⁻¹ v`.
pub(crate) fn solved(l: &[f64], v: &[f64]) -> Vec<f64> {
    let mut x = whiten(l, v);
    let n = x.len();
    for i in (0..n).rev() {
        x[i] /= l[i * n + i];
        let (rest, own) = x.split_at_mut(i);
        rest.iter_mut().zip(&l[i * n..i * n + i]).for_each(|(r, factor)| *r -= factor * own[0]);
    }
    x
}

/// `L⁻¹ v`.
pub(crate) fn whiten(l: &[f64], v: &[f64]) -> Vec<f64> {
    let n = v.len();
    let mut out: Vec<f64> = Vec::with_capacity(n);
    for i in 0..n {
        let done = dot(&l[i * n..i * n + i], &out);
        out.push((v[i] - done) / l[i * n + i]);
    }
    out
}
