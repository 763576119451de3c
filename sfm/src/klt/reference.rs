//! A track's first window, to which every later one is compared: without it errors of each step would add up. The
//! window may shear and stretch as the surface turns (Shi & Tomasi, CVPR 1994; solved with the template's own gradients:
//! Baker & Matthews, IJCV 2004).

use super::pyramid::Level;
use crate::solvers::linalg::solve_spd;
use glam::{DMat2, DVec2};

/// Half the side of the window, pixels.
const HALF: usize = 7;
/// Side of the window.
const SIDE: usize = 2 * HALF + 1;
/// Samples of the window.
const COUNT: usize = SIDE * SIDE;
/// Most steps.
const STEPS: usize = 15;
/// A shorter step ends the search, pixels at the window's border.
const SHORT: f64 = 0.01;
/// Farthest that the place may move from where it was looked for, pixels.
const FARTHEST: f64 = 2.0;
/// A window that is stretched or squeezed by more shows too little of the same.
const STRETCH: (f64, f64) = (0.55, 1.8);

/// A window with its gradients and what the normal equations need of it.
#[derive(Clone, Debug)]
pub(super) struct Reference {
    /// [COUNT] without their mean.
    values: Vec<f32>,
    /// [6 × COUNT] derivatives by shear and stretch (4) and shift (2), without their means.
    slopes: Vec<f32>,
    normal: [[f64; 6]; 6],
    power: f32,
}

/// How the window lies in the newest image: shear and stretch, and place.
#[derive(Clone, Copy, Debug)]
pub(super) struct Warp {
    pub shape: DMat2,
    pub place: DVec2,
}

impl Reference {
    /// The window about a pixel; `None` near the border and where nothing is to be seen.
    pub fn new(level: &Level, p: DVec2) -> Option<Self> {
        let outer = SIDE + 2;
        let mut patch = vec![0.0; outer * outer];
        if !level.window(p.x as f32, p.y as f32, outer, &mut patch) {
            return None;
        }
        let (mut values, mut slopes) = (vec![0.0; COUNT], vec![0.0; 6 * COUNT]);
        for j in 0..SIDE {
            for i in 0..SIDE {
                let (k, at) = (j * SIDE + i, (j + 1) * outer + i + 1);
                let gx = 0.5 * (patch[at + 1] - patch[at - 1]);
                let gy = 0.5 * (patch[at + outer] - patch[at - outer]);
                let (wx, wy) = (i as f32 - HALF as f32, j as f32 - HALF as f32);
                values[k] = patch[at];
                for (row, s) in [gx * wx, gx * wy, gy * wx, gy * wy, gx, gy].into_iter().enumerate() {
                    slopes[row * COUNT + k] = s;
                }
            }
        }
        centre(&mut values);
        slopes.chunks_exact_mut(COUNT).for_each(centre);
        let mut normal = [[0.0; 6]; 6];
        for (a, row) in normal.iter_mut().enumerate() {
            for (b, cell) in row.iter_mut().enumerate() {
                *cell =
                    f64::from(dot(&slopes[a * COUNT..(a + 1) * COUNT], &slopes[b * COUNT..(b + 1) * COUNT]));
            }
            row[a] *= 1.0 + 1e-4; // directions that the window does not show stay
        }
        let power = dot(&values, &values);
        (power > 0.0 && solve_spd(&normal, &[0.0; 6]).is_some()).then_some(Self {
            values,
            slopes,
            normal,
            power,
        })
    }

    /// The window's place and shape in an image, found near `start`, and the correlation there.
    pub fn find(&self, level: &Level, start: Warp) -> Option<(Warp, f64)> {
        let mut warp = start;
        let mut window = vec![0.0; COUNT];
        for _ in 0..STEPS {
            sample(level, &warp, &mut window)?;
            centre(&mut window);
            let power = dot(&window, &window);
            if !(power > 0.0) {
                return None;
            }
            let gain = (self.power / power).sqrt();
            window.iter_mut().zip(&self.values).for_each(|(w, v)| *w = gain * *w - v);
            let right: [f64; 6] =
                std::array::from_fn(|a| f64::from(dot(&self.slopes[a * COUNT..(a + 1) * COUNT], &window)));
            let d = solve_spd(&self.normal, &right)?;
            // The step of the template, inverted and put before the warp.
            let step = DMat2::from_cols(DVec2::new(1.0 + d[0], d[2]), DVec2::new(d[1], 1.0 + d[3]));
            if !(step.determinant() > 0.2) {
                return None;
            }
            warp.shape *= step.inverse();
            warp.place -= warp.shape * DVec2::new(d[4], d[5]);
            if !(warp.place.distance(start.place) < FARTHEST) {
                return None;
            }
            let longest = d[..4].iter().fold(0.0f64, |m, v| m.max(v.abs())) * HALF as f64;
            if longest.max(d[4].hypot(d[5])) < SHORT {
                break;
            }
        }
        sample(level, &warp, &mut window)?;
        centre(&mut window);
        let correlation = dot(&window, &self.values) / (dot(&window, &window) * self.power).sqrt();
        let (low, high) = stretches(warp.shape);
        (low > STRETCH.0 && high < STRETCH.1 && warp.place.is_finite())
            .then_some((warp, f64::from(correlation)))
    }
}

fn dot(a: &[f32], b: &[f32]) -> f32 {
    // Eight sums side by side, so that the loop is vectorised.
    let mut sums = [0.0f32; 8];
    let (ca, ra) = a.as_chunks::<8>();
    let (cb, rb) = b.as_chunks::<8>();
    for (x, y) in ca.iter().zip(cb) {
        (0..8).for_each(|k| sums[k] += x[k] * y[k]);
    }
    sums.iter().sum::<f32>() + ra.iter().zip(rb).map(|(x, y)| x * y).sum::<f32>()
}

fn centre(values: &mut [f32]) {
    let mean = values.iter().sum::<f32>() / values.len() as f32;
    values.iter_mut().for_each(|v| *v -= mean);
}

/// Singular values, the smaller first.
fn stretches(m: DMat2) -> (f64, f64) {
    let (p, q) = (m.x_axis.length_squared() + m.y_axis.length_squared(), m.determinant());
    let root = (p * p - 4.0 * q * q).max(0.0).sqrt();
    ((0.5 * (p - root)).max(0.0).sqrt(), (0.5 * (p + root)).sqrt())
}

/// Bilinear samples of the warped window; `None` where it leaves the image.
fn sample(level: &Level, warp: &Warp, out: &mut [f32]) -> Option<()> {
    let h = HALF as f64;
    for corner in [DVec2::new(-h, -h), DVec2::new(h, -h), DVec2::new(-h, h), DVec2::new(h, h)] {
        let p = warp.place + warp.shape * corner - 0.5;
        let inside =
            p.x >= 0.0 && p.y >= 0.0 && p.x < level.width as f64 - 1.0 && p.y < level.height as f64 - 1.0;
        if !inside {
            return None;
        }
    }
    let (right, down) = (warp.shape.x_axis, warp.shape.y_axis);
    for (j, line) in out.chunks_exact_mut(SIDE).enumerate() {
        let start = warp.place + down * (j as f64 - h) - right * h - 0.5;
        let (x0, y0, dx, dy) = (start.x as f32, start.y as f32, right.x as f32, right.y as f32);
        for (i, o) in line.iter_mut().enumerate() {
            let (x, y) = ((x0 + dx * i as f32).max(0.0), (y0 + dy * i as f32).max(0.0));
            let (column, row) = ((x as usize).min(level.width - 2), (y as usize).min(level.height - 2));
            let (fx, fy) = (x - column as f32, y - row as f32);
            let at = row * level.width + column;
            let (a, b) = (&level.data[at..at + 2], &level.data[at + level.width..at + level.width + 2]);
            let (top, bottom) = (a[0] + fx * (a[1] - a[0]), b[0] + fx * (b[1] - b[0]));
            *o = top + fy * (bottom - top);
        }
    }
    Some(())
}
