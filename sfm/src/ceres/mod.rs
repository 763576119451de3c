//! ceres
