//! Exact synthetic scenes for tests and benches.
