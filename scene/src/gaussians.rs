//! A cloud of 3D Gaussians: the parameters that are trained, stored and rendered.

use glam::{DVec3, Quat, Vec3};
use serde::{Deserialize, Serialize};

/// Factors of degree 0 and 1: 1 / (2√π), √3 / (2√π). Source: derived from unit norm on the sphere.
pub const SH_LOW: [f64; 2] = [0.282_094_791_773_878_1, 0.488_602_511_902_919_9];
/// Factors of degree 2 by |m|: √15/(2√π), √5/(4√π), √15/(4√π) (xy and its like; z²; x² − y²).
/// Source: derived as [`SH_LOW`].
pub const SH_2: [f64; 3] = [1.092_548_430_592_079, 0.315_391_565_252_52, 0.546_274_215_296_039_5];
/// Factors of degree 3: √70/(8√π), √105/(2√π), √42/(8√π), √7/(4√π), √105/(4√π) (|m| = 3; xyz; |m| =
/// 1; m = 0; z (x² − y²)). Source: derived as [`SH_LOW`].
pub const SH_3: [f64; 5] = [
    0.590_043_589_926_643_5,
    2.890_611_442_640_554,
    0.457_045_799_464_465_7,
    0.373_176_332_590_115_4,
    1.445_305_721_320_277,
];

/// Zeroth-order spherical-harmonic constant `1 / (2 √π)`, no unit. Source: derived.
pub const SH_C0: f32 = SH_LOW[0] as f32;

/// N Gaussians as arrays; all have the same spherical-harmonic degree.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Gaussians {
    /// \[N\] centres, world frame, scene units.
    pub means: Vec<Vec3>,
    /// \[N\] natural logarithms of the three standard deviations along the local axes.
    pub log_scales: Vec<Vec3>,
    /// \[N\] local to world; need not be unit (normalised on use; zero norm means identity).
    pub rotations: Vec<Quat>,
    /// \[N\] opacity = 1 / (1 + exp(−logit)).
    pub opacity_logits: Vec<f32>,
    /// [N × K × 3], K = (degree + 1)²; coefficient-major: `sh[(i·K + k)·3 + channel]`; rgb = 0.5 +
    /// Σ Y_k sh_k, clamped at 0.
    pub sh: Vec<f32>,
    /// 0 to 3.
    pub sh_degree: u32,
}

impl Gaussians {
    /// Median distance of the means from a place, scene units; 1 where there are none.
    pub fn median_distance(&self, from: DVec3) -> f64 {
        let mut distances: Vec<f64> = self.means.iter().map(|m| m.as_dvec3().distance(from)).collect();
        if distances.is_empty() {
            return 1.0;
        }
        let middle = distances.len() / 2;
        *distances.select_nth_unstable_by(middle, f64::total_cmp).1
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// Coefficients a channel, K = (degree + 1)².
    pub fn sh_coefficients(&self) -> usize {
        (self.sh_degree as usize + 1).pow(2)
    }

    /// Opacity of Gaussian `i`, in (0, 1).
    pub fn opacity(&self, i: usize) -> f32 {
        1.0 / (1.0 + (-self.opacity_logits[i]).exp())
    }

    /// Leaves out all but those whose index `keep` accepts.
    pub fn retain(&mut self, keep: impl Fn(usize) -> bool) {
        fn filter<T: Copy>(values: &mut Vec<T>, width: usize, keep: &impl Fn(usize) -> bool) {
            let mut at = 0;
            values.retain(|_| (keep(at / width), at += 1).0);
        }
        let stride = self.sh_coefficients() * 3;
        filter(&mut self.means, 1, &keep);
        filter(&mut self.log_scales, 1, &keep);
        filter(&mut self.rotations, 1, &keep);
        filter(&mut self.opacity_logits, 1, &keep);
        filter(&mut self.sh, stride, &keep);
    }

    /// Whether the arrays agree in length; the message says which does not.
    pub fn validate(&self) -> Result<(), String> {
        let n = self.len();
        let expected = [
            ("log_scales", self.log_scales.len(), n),
            ("rotations", self.rotations.len(), n),
            ("opacity_logits", self.opacity_logits.len(), n),
            ("sh", self.sh.len(), n * self.sh_coefficients() * 3),
        ];
        if self.sh_degree > 3 {
            return Err(format!("spherical-harmonic degree {} is above 3", self.sh_degree));
        }
        match expected.into_iter().find(|(_, found, needed)| found != needed) {
            Some((what, found, needed)) => Err(format!("{n} gaussians need {needed} {what}, found {found}")),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_retained_keeps_all_of_its_numbers() {
        let mut g = Gaussians { sh_degree: 1, ..Gaussians::default() };
        for i in 0..5 {
            let v = i as f32;
            g.means.push(Vec3::splat(v));
            g.log_scales.push(Vec3::splat(v));
            g.rotations.push(Quat::from_xyzw(v, 0.0, 0.0, 1.0));
            g.opacity_logits.push(v);
            g.sh.extend([v; 12]);
        }
        g.retain(|i| i % 2 == 1);
        assert_eq!((g.validate(), g.len()), (Ok(()), 2));
        for (i, v) in [1.0, 3.0].into_iter().enumerate() {
            assert_eq!(
                (g.means[i].x, g.log_scales[i].x, g.rotations[i].x, g.opacity_logits[i]),
                (v, v, v, v)
            );
            assert_eq!(g.sh[i * 12..(i + 1) * 12], [v; 12]);
        }
    }
}
