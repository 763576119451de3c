//! Where a window of one image lies in the next (Lucas & Kanade 1981; pyramids: Bouguet 2000; the
//! template's own gradients and normal matrix: Baker & Matthews, IJCV 2004).

use super::pyramid::{Pyramid, PyramidLevel};
use super::window::{KltWindow, SIDE, centre, dot};
use crate::sift::dispatch;
use glam::DVec2;

/// Most steps on a level.
/// Source: measured: one limit for both searches, without a check of the correlation here, gives
/// 0.046° in case 3; 12 steps here and 15 of 0.01 px against the first window gave 0.048°.
pub(super) const STEPS: usize = 15;
/// A step shorter than this ends the search, pixels of the level.
/// Source: measured with [`STEPS`].
pub(super) const SHORT: f64 = 0.004;

/// What registration needs of a template's window: its gradients without their means, and the
/// inverse normal matrix.
struct Template {
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
        let outer = level.patch(x, y)?;
        let mut parts = [KltWindow::default(); 3];
        let [values, gx, gy] = &mut parts;
        for j in 0..SIDE {
            for i in 0..SIDE {
                let at = (j + 1) * (SIDE + 2) + i + 1;
                values[j][i] = outer[at];
                gx[j][i] = 0.5 * (outer[at + 1] - outer[at - 1]);
                gy[j][i] = 0.5 * (outer[at + SIDE + 2] - outer[at - SIDE - 2]);
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
        Some(Self { gx, gy, own, inverse, deviation })
    }

    /// Where the window fits on `level` near the start, brightness and contrast aside; `None` where
    /// it is lost.
    #[inline(always)]
    fn fit(&self, level: &PyramidLevel, (start_x, start_y): (f32, f32)) -> Option<(f32, f32)> {
        let mut window = KltWindow::default();
        let (mut x, mut y) = (start_x, start_y);
        for _ in 0..STEPS {
            if !level.padded_window(x, y, &mut window) {
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
            (x, y) = (x - dx, y - dy);
            // A window that leaves its own ground is lost.
            if !((x - start_x).hypot(y - start_y) < SIDE as f32) {
                return None;
            }
            if dx.hypot(dy) < SHORT as f32 {
                break;
            }
        }
        Some((x, y))
    }
}

dispatch! {
/// Where the point `p` of `from` lies in `to`, found near `guess`; `None` where the window is lost.
/// Pixels of the finest level, first pixel's centre at 0.5.
pub(super) fn follow(from: &Pyramid, to: &Pyramid, p: DVec2, guess: DVec2) -> Option<DVec2> {
    let (mut x, mut y) = (guess.x as f32, guess.y as f32);
    let top = from.levels.len().min(to.levels.len());
    for k in (0..top).rev() {
        let scale = 1.0 / (1u32 << k) as f32;
        let template = Template::new(&from.levels[k], p.x as f32 * scale, p.y as f32 * scale);
        // No closure: it would be compiled for the baseline.
        let found = match &template {
            Some(t) => t.fit(&to.levels[k], (x * scale, y * scale)),
            None => None,
        };
        match found {
            Some(place) => (x, y) = (place.0 / scale, place.1 / scale),
            // Near the border a coarse window does not fit into the image: the finer ones may.
            None if k > 0 => {}
            None => return None,
        }
    }
    Some(DVec2::new(f64::from(x), f64::from(y))).filter(|p| p.is_finite())
}
}
