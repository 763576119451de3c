//! What all rules ask of evidence: how much of it, and from how many views.

/// Views that a rule asks: what a look costs must not grow with their number.
/// Source: docs/decisions/14 (its looks judge by 48 views).
pub(super) const SAMPLE: usize = 48;
/// Training views from which gains and poses are asked about. Source: of two views either could be
/// wrong.
pub(super) const LEAST_VIEWS: usize = 3;
/// Part of the squared error that gains or motions of views must explain to be modelled, a share.
/// Source: docs/decisions/14 (own poses left at most 0.02 to explain, poses 0.06° off 0.17 and
/// more) and 12 (of a scene lit evenly the second look at gains saw -0.03).
pub(super) const EXPLAINED: f64 = 0.1;
/// What validation views must gain by a degree of the harmonics, or by more Gaussians, dB.
/// Source: chosen by hand, never measured.
pub(super) const LEAST_GAIN: f64 = 0.02;
