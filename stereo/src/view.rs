//! What stereo is given.

use scene::PosedPhoto;

/// Why there are no depths.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StereoError {
    /// A view is not what was promised.
    #[error("view {view}: {why}")]
    View {
        /// Its place in the list.
        view: usize,
        /// What is wrong.
        why: &'static str,
    },
    /// The user asked to stop.
    #[error(transparent)]
    Cancelled(#[from] scene::Cancelled),
}

/// An error if a view is not what was promised.
pub(crate) fn check(views: &[PosedPhoto]) -> Result<(), StereoError> {
    for (view, v) in views.iter().enumerate() {
        let pixels = v.camera.width as usize * v.camera.height as usize;
        let pinhole = v.camera.distortion().iter().all(|k| *k == 0.0);
        let finite = v.pose.is_finite() && v.camera.params.iter().all(|p| p.is_finite());
        let why = match () {
            () if !pinhole => "its camera has distortion",
            () if !finite => "its camera or pose is not finite",
            () if !(v.camera.focal().min_element() > 0.0) => "its focal length is not positive",
            () if pixels == 0 || v.rgb.len() != pixels * 3 => "its picture is not of the camera's size",
            () if v.mask.is_some_and(|m| m.len() != pixels) => "its mask is not of the camera's size",
            () => continue,
        };
        return Err(StereoError::View { view, why });
    }
    Ok(())
}
