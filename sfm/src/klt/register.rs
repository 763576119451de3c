//! Where a window of one image lies in the next (Lucas & Kanade 1981; pyramids: Bouguet 2000; the template's own
//! gradients and normal matrix: Baker & Matthews, IJCV 2004).

use super::pyramid::{Pyramid, PyramidLevel};
use super::window::{EMPTY, KltWindow, SIDE, centre, dot};
use crate::sift::dispatch;
use glam::DVec2;

/// Side of the window with the ring that gradients need.
const OUTER: usize = SIDE + 2;
/// Most steps on a level.
const STEPS: usize = 12;
/// A step shorter than this ends a level, pixels of the level.
const SHORT: f32 = 0.004;
/// Least correlation of the window with what it was found to be.
const CORRELATION: f32 = 0.8;

/// The window of a template, without its mean, with its gradients (without theirs) and the inverse normal matrix.
struct Template {
    values: KltWindow,
    gx: KltWindow,
    gy: KltWindow,
    /// Σ of the gradients times the values.
    own: [f32; 2],
    inverse: [f32; 3],
    deviation: f32,
}

impl Template {
    #[inline(always)]
    fn new(level: &PyramidLevel, x: f32, y: f32) -> Option<Self> {
        let mut outer = [0.0; OUTER * OUTER];
        if !level.window(x, y, OUTER, &mut outer) {
            return None;
        }
        let mut parts = [EMPTY; 3];
        let [values, gx, gy] = &mut parts;
        for j in 0..SIDE {
            let rows: [&[f32]; 3] = std::array::from_fn(|k| &outer[(j + k) * OUTER..(j + k + 1) * OUTER]);
            for i in 0..SIDE {
                values[j][i] = rows[1][i + 1];
                gx[j][i] = 0.5 * (rows[1][i + 2] - rows[1][i]);
                gy[j][i] = 0.5 * (rows[2][i + 1] - rows[0][i + 1]);
            }
        }
        parts.iter_mut().for_each(centre);
        let [values, gx, gy] = parts;
        let (a, b, c) = (dot(&gx, &gx), dot(&gx, &gy), dot(&gy, &gy));
        let determinant = a * c - b * b;
        let deviation = dot(&values, &values).sqrt();
        if !(determinant > 1e-6 * (a + c) * (a + c)) || !(deviation > 0.0) {
            return None;
        }
        let own = [dot(&gx, &values), dot(&gy, &values)];
        let inverse = [c / determinant, -b / determinant, a / determinant];
        Some(Self { values, gx, gy, own, inverse, deviation })
    }

    /// Moves (x, y) on `level` to where the window fits, brightness and contrast aside; the correlation there.
    #[inline(always)]
    fn fit(&self, level: &PyramidLevel, x: &mut f32, y: &mut f32) -> Option<f32> {
        let mut window = EMPTY;
        let (start_x, start_y) = (*x, *y);
        for _ in 0..STEPS {
            if !level.padded_window(*x, *y, &mut window) {
                return None;
            }
            centre(&mut window);
            let power = dot(&window, &window);
            if !(power > 0.0) {
                return None;
            }
            let gain = self.deviation / power.sqrt();
            let (ex, ey) =
                (gain * dot(&self.gx, &window) - self.own[0], gain * dot(&self.gy, &window) - self.own[1]);
            let (dx, dy) =
                (self.inverse[0] * ex + self.inverse[1] * ey, self.inverse[1] * ex + self.inverse[2] * ey);
            (*x, *y) = (*x - dx, *y - dy);
            // A window that leaves its own ground is lost.
            if !((*x - start_x).hypot(*y - start_y) < SIDE as f32) {
                return None;
            }
            if dx.hypot(dy) < SHORT {
                break;
            }
        }
        if !level.padded_window(*x, *y, &mut window) {
            return None;
        }
        centre(&mut window);
        Some(dot(&window, &self.values) / (dot(&window, &window).sqrt() * self.deviation))
    }
}

dispatch! {
/// Where the point `p` of `from` lies in `to`, found near `guess`; `None` where the window is lost. Pixels of the
/// finest level, first pixel's centre at 0.5.
pub(super) fn follow(from: &Pyramid, to: &Pyramid, p: DVec2, guess: DVec2) -> Option<DVec2> {
    let (mut x, mut y) = (guess.x as f32, guess.y as f32);
    let top = from.levels.len().min(to.levels.len());
    let mut correlation = 0.0;
    for k in (0..top).rev() {
        let scale = 1.0 / (1u32 << k) as f32;
        let template = Template::new(&from.levels[k], p.x as f32 * scale, p.y as f32 * scale);
        let (mut lx, mut ly) = (x * scale, y * scale);
        // No closure: it would be compiled for the baseline.
        let found = match &template {
            Some(t) => t.fit(&to.levels[k], &mut lx, &mut ly),
            None => None,
        };
        match found {
            Some(c) => (x, y, correlation) = (lx / scale, ly / scale, c),
            // Near the border a coarse window does not fit into the image: the finer ones may.
            None if k > 0 => {}
            None => return None,
        }
    }
    (correlation >= CORRELATION).then(|| DVec2::new(f64::from(x), f64::from(y))).filter(|p| p.is_finite())
}
}
