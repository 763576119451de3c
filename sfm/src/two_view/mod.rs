//! two_view
