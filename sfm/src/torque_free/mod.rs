//! Torque-free motion of a rigid body: a spacecraft that tumbles before a camera.
//!
//! Free poses that obey Euler's equations within what they are known to are held near the motion
//! that they show; its spin, nutation and ratios of inertia are reported.

mod deviations;
mod dynamics;
mod fit;
mod hold;
mod likely;
mod motion;
mod report;

pub(crate) use hold::consider;
