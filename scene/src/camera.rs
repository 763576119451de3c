//! Camera models as COLMAP defines them, and what projects through them.

use glam::{DVec2, DVec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The camera models that are read, solved and written. `u, v` are normalised image coordinates
/// `x/z, y/z`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
pub enum CameraModel {
    /// `f, cx, cy`
    SimplePinhole,
    /// `fx, fy, cx, cy`
    Pinhole,
    /// `f, cx, cy, k`: radial factor `1 + k r²`
    SimpleRadial,
    /// `f, cx, cy, k1, k2`: radial factor `1 + k1 r² + k2 r⁴`
    Radial,
    /// `fx, fy, cx, cy, k1, k2, p1, p2` (Brown–Conrady, as OpenCV)
    Opencv,
}

impl CameraModel {
    /// Every model, in the order of COLMAP's numbers.
    pub const ALL: [Self; 5] =
        [Self::SimplePinhole, Self::Pinhole, Self::SimpleRadial, Self::Radial, Self::Opencv];

    /// COLMAP's name of the model.
    pub fn name(self) -> &'static str {
        match self {
            Self::SimplePinhole => "SIMPLE_PINHOLE",
            Self::Pinhole => "PINHOLE",
            Self::SimpleRadial => "SIMPLE_RADIAL",
            Self::Radial => "RADIAL",
            Self::Opencv => "OPENCV",
        }
    }

    /// The model of that COLMAP name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|m| m.name() == name)
    }

    /// COLMAP's number of the model in binary files.
    pub fn colmap_id(self) -> i32 {
        self as i32
    }

    /// The model with that COLMAP number.
    pub fn from_colmap_id(id: i32) -> Option<Self> {
        usize::try_from(id).ok().and_then(|i| Self::ALL.get(i).copied())
    }

    /// How many parameters the model has.
    pub fn num_params(self) -> usize {
        match self {
            Self::SimplePinhole => 3,
            Self::Pinhole | Self::SimpleRadial => 4,
            Self::Radial => 5,
            Self::Opencv => 8,
        }
    }

    /// How many of the leading parameters are focal lengths.
    pub fn num_focals(self) -> usize {
        match self {
            Self::Pinhole | Self::Opencv => 2,
            _ => 1,
        }
    }
}

/// Intrinsics shared by one or more images.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// COLMAP camera number.
    pub id: u32,
    /// Which parameters [`Camera::params`] holds.
    pub model: CameraModel,
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// The model's parameters in COLMAP's order.
    pub params: Vec<f64>,
    /// Whether the focal length was known beforehand (EXIF, flag, calibration).
    pub has_prior_focal: bool,
}

impl Camera {
    /// A camera whose principal point is the image centre and whose distortion is zero.
    pub fn centred(id: u32, model: CameraModel, width: u32, height: u32, focal_px: f64) -> Self {
        let mut params = vec![focal_px; model.num_focals()];
        params.extend([f64::from(width) / 2.0, f64::from(height) / 2.0]);
        params.resize(model.num_params(), 0.0);
        Self { id, model, width, height, params, has_prior_focal: false }
    }

    /// Focal lengths in x and y, pixels.
    pub fn focal(&self) -> DVec2 {
        DVec2::new(self.params[0], self.params[self.model.num_focals() - 1])
    }

    /// Mean focal length, pixels.
    pub fn mean_focal(&self) -> f64 {
        let f = self.focal();
        (f.x + f.y) / 2.0
    }

    /// Principal point, pixels.
    pub fn principal_point(&self) -> DVec2 {
        let i = self.model.num_focals();
        DVec2::new(self.params[i], self.params[i + 1])
    }

    /// Distortion parameters (empty for pinhole models).
    pub fn distortion(&self) -> &[f64] {
        &self.params[self.model.num_focals() + 2..]
    }

    /// Distorted from ideal normalised image coordinates.
    pub fn distort(&self, u: DVec2) -> DVec2 {
        let k = self.distortion();
        let r2 = u.length_squared();
        match self.model {
            CameraModel::SimplePinhole | CameraModel::Pinhole => u,
            CameraModel::SimpleRadial => u * (1.0 + k[0] * r2),
            CameraModel::Radial => u * (1.0 + r2 * (k[0] + r2 * k[1])),
            CameraModel::Opencv => {
                let (p1, p2, xy) = (k[2], k[3], u.x * u.y);
                u * (1.0 + r2 * (k[0] + r2 * k[1]))
                    + DVec2::new(
                        2.0 * p1 * xy + p2 * (r2 + 2.0 * u.x * u.x),
                        2.0 * p2 * xy + p1 * (r2 + 2.0 * u.y * u.y),
                    )
            }
        }
    }

    /// Ideal from distorted normalised coordinates: Newton's method on [`Camera::distort`] with a
    /// numeric Jacobian; falls back to the distorted point where the model cannot be inverted.
    pub fn undistort(&self, d: DVec2) -> DVec2 {
        if self.distortion().iter().all(|&k| k == 0.0) {
            return d;
        }
        let mut u = d;
        for _ in 0..50 {
            let h = 1e-7 * (1.0 + u.length());
            let f = self.distort(u) - d;
            let jx = (self.distort(u + DVec2::X * h) - self.distort(u - DVec2::X * h)) / (2.0 * h);
            let jy = (self.distort(u + DVec2::Y * h) - self.distort(u - DVec2::Y * h)) / (2.0 * h);
            let det = jx.x * jy.y - jy.x * jx.y;
            if det.abs() < 1e-12 {
                return d;
            }
            let step = DVec2::new(jy.y * f.x - jy.x * f.y, jx.x * f.y - jx.y * f.x) / det;
            u -= step;
            if step.length() < 1e-13 * (1.0 + u.length()) {
                break;
            }
        }
        if u.is_finite() && (self.distort(u) - d).length() < 1e-6 { u } else { d }
    }

    /// Pixel of a point in the camera frame; `None` at or behind the camera plane.
    pub fn project(&self, x_cam: DVec3) -> Option<DVec2> {
        if x_cam.z <= 0.0 {
            return None;
        }
        let pixel = self.distort(x_cam.truncate() / x_cam.z) * self.focal() + self.principal_point();
        pixel.is_finite().then_some(pixel)
    }

    /// Ideal normalised image coordinates `(x/z, y/z)` of a pixel.
    pub fn unproject(&self, pixel: DVec2) -> DVec2 {
        self.undistort((pixel - self.principal_point()) / self.focal())
    }

    /// Unit ray of a pixel, camera frame.
    pub fn ray(&self, pixel: DVec2) -> DVec3 {
        self.unproject(pixel).extend(1.0).normalize()
    }

    /// Normal of the surface through a pixel and its right and lower neighbours, whose depths are
    /// given; camera frame, unit (zero where the three points are collinear).
    pub fn surface_normal(&self, pixel: [u32; 2], [here, right, below]: [f64; 3]) -> DVec3 {
        let centre = DVec2::new(f64::from(pixel[0]) + 0.5, f64::from(pixel[1]) + 0.5);
        let p = self.unproject(centre).extend(1.0) * here;
        let px = self.unproject(centre + DVec2::X).extend(1.0) * right;
        let py = self.unproject(centre + DVec2::Y).extend(1.0) * below;
        (py - p).cross(px - p).normalize_or_zero()
    }

    /// The camera of the same image at another size (pixels scale about the image corner).
    pub fn scaled(&self, width: u32, height: u32) -> Self {
        let s =
            DVec2::new(f64::from(width) / f64::from(self.width), f64::from(height) / f64::from(self.height));
        let mut camera = Self { width, height, ..self.clone() };
        let n = self.model.num_focals();
        camera.params[0] *= if n == 1 { (s.x + s.y) / 2.0 } else { s.x };
        if n == 2 {
            camera.params[1] *= s.y;
        }
        camera.params[n] *= s.x;
        camera.params[n + 1] *= s.y;
        camera
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unprojecting_a_projection_returns_the_direction_for_every_model() {
        for model in CameraModel::ALL {
            let mut camera = Camera::centred(1, model, 640, 480, 700.0);
            let n = model.num_focals() + 2;
            let k = [-0.12, 0.03, 0.001, -0.002];
            for (p, k) in camera.params[n..].iter_mut().zip(k) {
                *p = k;
            }
            for i in 0..100 {
                let x =
                    DVec3::new(f64::from(i % 10) * 0.1 - 0.45, f64::from(i / 10) * 0.08 - 0.36, 1.0) * 3.0;
                let pixel = camera.project(x).unwrap();
                let u = camera.unproject(pixel);
                assert!((u - x.truncate() / x.z).length() < 1e-10, "{model:?} {x}");
            }
        }
    }

    #[test]
    fn a_plane_that_faces_the_camera_has_its_normal_along_the_optical_axis() {
        let camera = Camera::centred(1, CameraModel::Pinhole, 64, 48, 50.0);
        assert!((camera.surface_normal([10, 20], [2.0; 3]) + DVec3::Z).length() < 1e-12);
    }

    #[test]
    fn points_behind_the_camera_have_no_pixel() {
        let camera = Camera::centred(1, CameraModel::SimplePinhole, 640, 480, 700.0);
        assert!(camera.project(DVec3::new(0.1, 0.1, -1.0)).is_none());
        assert!(camera.project(DVec3::ZERO).is_none());
        assert!(camera.project(DVec3::new(1e300, 0.0, 1e-300)).is_none());
    }
}
