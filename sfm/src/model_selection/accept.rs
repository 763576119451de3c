//! Whether a step's result is taken: by what of the images and observations a model explains,
//! before and after.
//!
//! This is another question than the one of [`crate::model_selection::evidence`]: models that
//! differ in their parameters are compared there, by their likelihoods on the same observations;
//! here models are compared whose matches and observations differ, so that no likelihood is common
//! to both, and what counts is how much they explain.

/// A change that has a cost, or a risk, must explain more by this factor.
/// Source: docs/decisions/05 and 07 (2 % more matches).
const MORE: f64 = 1.02;
/// A second set of features must have as many matches again: where both find the same spots, they
/// are half as many again and nothing is won.
/// Source: docs/decisions/09.
const DOUBLE: f64 = 2.0;
/// Share of images and observations that a change must keep; errors may grow by its inverse.
/// Source: docs/decisions/11 (a tenth).
const KEPT: f64 = 0.9;
/// Share of a plane's observations that an adjusted model must keep; of noise it keeps few.
/// Source: docs/decisions/11.
const OF_PLANE: f64 = 0.6;

/// What changes with a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Change {
    /// Features of blurred copies beside the first; support: verified matches.
    BlurredFeatures,
    /// The global mapper's model; support: sampled matches that agree with it.
    GlobalMapper,
    /// All images in their places on a ring; support: images that are where the ring has them.
    ImagesOnRing,
    /// Pairs set aside that repeated structure made; support: matches of trusted pairs that agree.
    FewerPairs,
    /// Pairs that did not pass before; support is not asked.
    MorePairs,
    /// More matches along the model's lines; support: matches.
    DenserTracks,
    /// Keypoints moved to where their windows fit; support and error: of the moved ones.
    MovedKeypoints,
    /// Places of a plane; support: their observations before and after an adjustment.
    PlanePlaces,
    /// Observations of a plane; support and error: of all others.
    PlaneTracks,
}

/// What a model explains.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Support {
    /// Images with a pose.
    pub images: usize,
    /// Matches or observations that it explains.
    pub explained: usize,
    /// Their median error, pixels, where it is asked.
    pub error_px: Option<f64>,
}

impl Support {
    /// So many matches or observations; images and error are not asked.
    pub(crate) fn of(explained: usize) -> Self {
        Self { explained, ..Self::default() }
    }
}

/// Ratios of after to before that a change must reach: images at least, what is explained at least
/// or, where it must grow, above; error below.
struct Demand {
    images: f64,
    explained: f64,
    must_grow: bool,
    error: f64,
}

impl Demand {
    const ANY: Self = Self { images: 0.0, explained: 0.0, must_grow: false, error: f64::INFINITY };

    const fn growth(explained: f64) -> Self {
        Self { explained, must_grow: true, ..Self::ANY }
    }
}

impl Change {
    fn demand(self) -> Demand {
        match self {
            Self::BlurredFeatures => Demand::growth(DOUBLE),
            Self::GlobalMapper | Self::DenserTracks => Demand::growth(MORE),
            Self::ImagesOnRing => Demand::growth(1.0),
            Self::FewerPairs => Demand { images: KEPT, ..Demand::growth(MORE) },
            Self::MorePairs => Demand { images: 1.0, ..Demand::ANY },
            Self::MovedKeypoints => Demand { explained: KEPT, error: 1.0, ..Demand::ANY },
            Self::PlanePlaces => Demand { explained: OF_PLANE, ..Demand::ANY },
            Self::PlaneTracks => Demand { explained: KEPT, error: 1.0 / KEPT, ..Demand::ANY },
        }
    }
}

/// Whether the model after a change is taken instead of the one before.
pub(crate) fn accept(change: Change, before: &Support, after: &Support) -> bool {
    let demand = change.demand();
    let (had, has) = (demand.explained * before.explained as f64, after.explained as f64);
    let explained = if demand.must_grow { has > had } else { has >= had };
    let error = match (before.error_px, after.error_px) {
        (Some(before), Some(after)) => after < demand.error * before,
        _ => true,
    };
    explained && error && after.images as f64 >= demand.images * before.images as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn growth_is_asked_where_a_change_costs_something() {
        assert!(accept(Change::BlurredFeatures, &Support::of(100), &Support::of(201)));
        assert!(!accept(Change::BlurredFeatures, &Support::of(100), &Support::of(199)));
        assert!(!accept(Change::GlobalMapper, &Support::of(0), &Support::of(0)), "nothing is no gain");
        assert!(accept(Change::MorePairs, &Support::of(7), &Support::of(0)));
    }

    #[test]
    fn images_and_errors_must_not_be_lost() {
        let images = |images, explained| Support { images, ..Support::of(explained) };
        assert!(accept(Change::FewerPairs, &images(100, 1000), &images(90, 1100)));
        assert!(!accept(Change::FewerPairs, &images(100, 1000), &images(89, 1100)));
        let error = |error_px| Support { error_px: Some(error_px), ..Support::of(100) };
        assert!(accept(Change::MovedKeypoints, &error(0.3), &error(0.2)));
        assert!(!accept(Change::MovedKeypoints, &error(0.3), &error(0.3)));
        assert!(!accept(Change::MovedKeypoints, &error(f64::INFINITY), &error(f64::INFINITY)));
        assert!(accept(Change::PlaneTracks, &error(0.3), &error(0.32)));
    }
}
