//! A track's first window, to which every later one is compared: without it errors of each step
//! would add up. The window may shear and stretch as the surface turns (Shi & Tomasi, CVPR 1994;
//! solved with the template's own gradients: Baker & Matthews, IJCV 2004).

use super::pyramid::PyramidLevel;
use super::register::{SHORT, STEPS};
use super::window::{KltWindow, ReferencePatch, SIDE, centre, dot};
use crate::sift::{LANES, dispatch};
use crate::solvers::linalg::solve_spd;
use glam::{DMat2, DVec2};
use std::sync::LazyLock;

/// Farthest that the place may move from where it was looked for, pixels.
/// Source: measured: with the three others of `klt` so marked it was about halved and doubled:
/// 0.150° and 0.038° in case 3 (0.048°).
const FARTHEST: f64 = 2.0;
/// A window that is stretched or squeezed by more shows too little of the same.
/// Source: measured: with the three others of `klt` so marked it was about halved and doubled:
/// 0.150° and 0.038° in case 3 (0.048°).
const STRETCH: f64 = 1.8;
/// Standard deviation of the weights of a window of which the middle counts most, pixels.
/// Source: docs/decisions/05 (tried.md: 1.8 px and uniform weights are worse).
const MIDDLE: f32 = 2.5;
/// Those weights: far from the middle windows see other surfaces from another side.
static WEIGHTS: LazyLock<KltWindow> = LazyLock::new(|| {
    let mut weights = KltWindow::default();
    for (j, row) in weights.iter_mut().enumerate() {
        for (i, weight) in row[..SIDE].iter_mut().enumerate() {
            let (x, y) = from_middle(i, j);
            *weight = (-0.5 * (x * x + y * y) / (MIDDLE * MIDDLE)).exp();
        }
    }
    weights
});

/// Column `i` and row `j` of a window, from its middle.
fn from_middle(i: usize, j: usize) -> (f32, f32) {
    (i as f32 - (SIDE / 2) as f32, j as f32 - (SIDE / 2) as f32)
}

/// A window with its gradients and what the normal equations need of it.
#[derive(Clone, Debug)]
pub(crate) struct Reference {
    /// Without their mean.
    values: KltWindow,
    /// Derivatives by shear and stretch (4) and shift (2), without their means, times the pixels'
    /// weights.
    slopes: Box<[KltWindow; 6]>,
    /// `Σ w s sᵀ` over the pixels.
    normal: [[f64; 6]; 6],
    power: f32,
}

/// How the window lies in the newest image: shear and stretch, and place.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Warp {
    pub shape: DMat2,
    pub place: DVec2,
}

impl Reference {
    /// The window about a pixel; `None` near the border and where nothing is to be seen.
    pub(crate) fn new(level: &PyramidLevel, p: DVec2) -> Option<Self> {
        Self::of(&level.patch(p.x as f32, p.y as f32)?, None)
    }

    /// The window of a patch, of which the middle counts most; `None` where nothing is to be seen.
    pub(crate) fn central(patch: &ReferencePatch) -> Option<Self> {
        Self::of(patch, Some(&WEIGHTS))
    }

    fn of(patch: &ReferencePatch, weights: Option<&KltWindow>) -> Option<Self> {
        let (mut values, mut slopes) = (KltWindow::default(), Box::new([KltWindow::default(); 6]));
        for j in 0..SIDE {
            for i in 0..SIDE {
                let at = (j + 1) * (SIDE + 2) + i + 1;
                let gx = 0.5 * (patch[at + 1] - patch[at - 1]);
                let gy = 0.5 * (patch[at + SIDE + 2] - patch[at - SIDE - 2]);
                let (wx, wy) = from_middle(i, j);
                values[j][i] = patch[at];
                for (slope, s) in slopes.iter_mut().zip([gx * wx, gx * wy, gy * wx, gy * wy, gx, gy]) {
                    slope[j][i] = s;
                }
            }
        }
        centre(&mut values);
        slopes.iter_mut().for_each(centre);
        let bare = slopes.clone();
        if let Some(weights) = weights {
            for slope in slopes.iter_mut() {
                slope.iter_mut().flatten().zip(weights.iter().flatten()).for_each(|(s, w)| *s *= w);
            }
        }
        let mut normal = [[0.0; 6]; 6];
        for (a, row) in normal.iter_mut().enumerate() {
            for (b, cell) in row.iter_mut().enumerate() {
                *cell = f64::from(dot(&slopes[a], &bare[b]));
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

    /// Standard deviation of a place where the windows have this correlation, pixels: what is left
    /// over, `2 (1 − c) Σ v² / n` a pixel, times the inverse of the normal equations.
    pub(crate) fn deviation(&self, correlation: f64) -> f64 {
        let [x, y] = [4, 5].map(|k| {
            let unit = std::array::from_fn(|i| if i == k { 1.0 } else { 0.0 });
            solve_spd(&self.normal, &unit).map_or(f64::INFINITY, |column: [f64; 6]| column[k])
        });
        let left = 2.0 * (1.0 - correlation).max(0.0) * f64::from(self.power / (SIDE * SIDE) as f32);
        (left * 0.5 * (x + y)).sqrt()
    }

    /// The window's place and shape in an image, found near `start`, and the correlation there.
    pub(crate) fn find(&self, level: &PyramidLevel, start: Warp) -> Option<(Warp, f64)> {
        search(self, level, start)
    }
}

dispatch! {
fn search(reference: &Reference, level: &PyramidLevel, start: Warp) -> Option<(Warp, f64)> {
    let mut warp = start;
    let mut window = KltWindow::default();
    for _ in 0..STEPS {
        sample(level, &warp, &mut window)?;
        centre(&mut window);
        let power = dot(&window, &window);
        if !(power > 0.0) {
            return None;
        }
        let gain = (reference.power / power).sqrt();
        for (row, values) in window.iter_mut().zip(&reference.values) {
            for k in 0..LANES {
                row[k] = gain * row[k] - values[k];
            }
        }
        let mut right = [0.0; 6];
        for (r, slope) in right.iter_mut().zip(reference.slopes.iter()) {
            *r = f64::from(dot(slope, &window));
        }
        let d = solve_spd(&reference.normal, &right)?;
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
        let longest = d[0].abs().max(d[1].abs()).max(d[2].abs()).max(d[3].abs()) * (SIDE / 2) as f64;
        if longest.max(d[4].hypot(d[5])) < SHORT {
            break;
        }
    }
    sample(level, &warp, &mut window)?;
    centre(&mut window);
    let correlation =
        dot(&window, &reference.values) / (dot(&window, &window) * reference.power).sqrt();
    let (low, high) = stretches(warp.shape);
    let good = low > 1.0 / STRETCH && high < STRETCH && warp.place.is_finite();
    if good { Some((warp, f64::from(correlation))) } else { None }
}
}

/// Singular values, the smaller first.
fn stretches(m: DMat2) -> (f64, f64) {
    let (p, q) = (m.x_axis.length_squared() + m.y_axis.length_squared(), m.determinant());
    let root = (p * p - 4.0 * q * q).max(0.0).sqrt();
    ((0.5 * (p - root)).max(0.0).sqrt(), (0.5 * (p + root)).sqrt())
}

/// Bilinear samples of the warped window; `None` where it leaves the image.
#[inline(always)]
fn sample(level: &PyramidLevel, warp: &Warp, out: &mut KltWindow) -> Option<()> {
    let h = (SIDE / 2) as f64;
    for corner in [DVec2::new(-h, -h), DVec2::new(h, -h), DVec2::new(-h, h), DVec2::new(h, h)] {
        let p = warp.place + warp.shape * corner - 0.5;
        let inside =
            p.x >= 0.0 && p.y >= 0.0 && p.x < level.width as f64 - 1.0 && p.y < level.height as f64 - 1.0;
        if !inside {
            return None;
        }
    }
    // The last pixel that has neighbours to the right and below; rounding and the empty column may
    // lie beyond.
    let (last_x, last_y) = ((level.width - 2) as f32, (level.height - 2) as f32);
    let (right, down) = (warp.shape.x_axis, warp.shape.y_axis);
    let (dx, dy) = (right.x as f32, right.y as f32);
    for (j, line) in out.iter_mut().enumerate() {
        let start = warp.place + down * (j as f64 - h) - right * h - 0.5;
        let (x0, y0) = (start.x as f32, start.y as f32);
        let (mut fx, mut fy, mut at) = ([0.0f32; LANES], [0.0f32; LANES], [0i32; LANES]);
        for i in 0..LANES {
            let (x, y) = ((x0 + dx * i as f32).max(0.0), (y0 + dy * i as f32).max(0.0));
            // SAFETY: both are at least 0 and at most the last column and row, which fit 32 bits.
            let (column, row) =
                unsafe { (x.min(last_x).to_int_unchecked::<i32>(), y.min(last_y).to_int_unchecked::<i32>()) };
            (fx[i], fy[i]) = (x - column as f32, y - row as f32);
            at[i] = row * level.width as i32 + column;
        }
        let mut pixels = [[0.0f32; LANES]; 4];
        for i in 0..SIDE {
            let at = at[i] as usize;
            let above = &level.data[at..at + 2];
            let below = &level.data[at + level.width..at + level.width + 2];
            (pixels[0][i], pixels[1][i]) = (above[0], above[1]);
            (pixels[2][i], pixels[3][i]) = (below[0], below[1]);
        }
        for i in 0..LANES {
            let [a, b, c, d] = [pixels[0][i], pixels[1][i], pixels[2][i], pixels[3][i]];
            let (top, bottom) = (a + fx[i] * (b - a), c + fx[i] * (d - c));
            line[i] = top + fy[i] * (bottom - top);
        }
        line[SIDE] = 0.0;
    }
    Some(())
}
