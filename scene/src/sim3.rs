//! Similarity transforms and the robust alignment of two reconstructions.
