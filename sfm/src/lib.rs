//! sfm
