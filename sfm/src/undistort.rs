//! undistort
