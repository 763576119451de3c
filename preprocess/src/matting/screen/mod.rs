//! The screen: whether there is one, its light without the object, its shadows.

pub(crate) mod clean_plate;
pub(crate) mod detect;
pub(crate) mod grid;
pub(crate) mod illumination;
pub(crate) mod shadows;
