//! ransac
