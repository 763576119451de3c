//! Where a window of one image lies in the next (Lucas & Kanade 1981; pyramids: Bouguet 2000; the template's own
//! gradients and normal matrix: Baker & Matthews, IJCV 2004).

use super::pyramid::{Level, Pyramid};
use glam::DVec2;

/// Half the side of the window, pixels.
const HALF: usize = 7;
/// Side of the window.
const SIDE: usize = 2 * HALF + 1;
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
    values: [f32; SIDE * SIDE],
    gx: [f32; SIDE * SIDE],
    gy: [f32; SIDE * SIDE],
    inverse: [f32; 3],
    deviation: f32,
}

fn mean(values: &[f32]) -> f32 {
    values.iter().sum::<f32>() / values.len() as f32
}

impl Template {
    fn new(level: &Level, x: f32, y: f32) -> Option<Self> {
        let mut outer = [0.0; OUTER * OUTER];
        if !level.window(x, y, OUTER, &mut outer) {
            return None;
        }
        let mut t = Self {
            values: [0.0; SIDE * SIDE],
            gx: [0.0; SIDE * SIDE],
            gy: [0.0; SIDE * SIDE],
            inverse: [0.0; 3],
            deviation: 0.0,
        };
        for j in 0..SIDE {
            let rows: [&[f32]; 3] = std::array::from_fn(|k| &outer[(j + k) * OUTER..(j + k + 1) * OUTER]);
            for i in 0..SIDE {
                t.values[j * SIDE + i] = rows[1][i + 1];
                t.gx[j * SIDE + i] = 0.5 * (rows[1][i + 2] - rows[1][i]);
                t.gy[j * SIDE + i] = 0.5 * (rows[2][i + 1] - rows[0][i + 1]);
            }
        }
        for part in [&mut t.values, &mut t.gx, &mut t.gy] {
            let m = mean(part);
            part.iter_mut().for_each(|v| *v -= m);
        }
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f32>();
        let (a, b, c) = (dot(&t.gx, &t.gx), dot(&t.gx, &t.gy), dot(&t.gy, &t.gy));
        let determinant = a * c - b * b;
        t.deviation = dot(&t.values, &t.values).sqrt();
        if !(determinant > 1e-6 * (a + c) * (a + c)) || !(t.deviation > 0.0) {
            return None;
        }
        t.inverse = [c / determinant, -b / determinant, a / determinant];
        Some(t)
    }

    /// Moves (x, y) on `level` to where the window fits, brightness and contrast aside; the correlation there.
    fn fit(&self, level: &Level, x: &mut f32, y: &mut f32) -> Option<f32> {
        let mut window = [0.0; SIDE * SIDE];
        let (start_x, start_y) = (*x, *y);
        for _ in 0..STEPS {
            if !level.window(*x, *y, SIDE, &mut window) {
                return None;
            }
            let m = mean(&window);
            let (mut power, mut bx, mut by) = (0.0f32, 0.0f32, 0.0f32);
            for ((w, gx), gy) in window.iter().zip(&self.gx).zip(&self.gy) {
                let v = w - m;
                power += v * v;
                bx += gx * v;
                by += gy * v;
            }
            if !(power > 0.0) {
                return None;
            }
            let gain = self.deviation / power.sqrt();
            let dot = |g: &[f32]| g.iter().zip(&self.values).map(|(g, v)| g * v).sum::<f32>();
            let (ex, ey) = (gain * bx - dot(&self.gx), gain * by - dot(&self.gy));
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
        if !level.window(*x, *y, SIDE, &mut window) {
            return None;
        }
        let m = mean(&window);
        let (mut power, mut with) = (0.0f32, 0.0f32);
        for (w, v) in window.iter().zip(&self.values) {
            power += (w - m) * (w - m);
            with += (w - m) * v;
        }
        Some(with / (power.sqrt() * self.deviation))
    }
}

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
        let found = template.and_then(|t| t.fit(&to.levels[k], &mut lx, &mut ly));
        match found {
            Some(c) => (x, y, correlation) = (lx / scale, ly / scale, c),
            // Near the border a coarse window does not fit into the image: the finer ones may.
            None if k > 0 => {}
            None => return None,
        }
    }
    (correlation >= CORRELATION).then(|| DVec2::new(f64::from(x), f64::from(y))).filter(|p| p.is_finite())
}
