//! How stereo is done.

use scene::PosedPhoto;

/// Standard deviation of what rounding to whole numbers adds. Source: 1/√12.
const ROUNDING: f32 = 0.29;

/// How stereo is done.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StereoSettings {
    /// Resolutions, each half the one below.
    pub levels: u32,
    /// The longest side of a picture at the finest level, pixels.
    pub most_side: u32,
    /// Other views in which a patch is looked for.
    pub neighbours: usize,
    /// Of these so many, in which it looks most alike, count.
    pub best: usize,
    /// Angle at the object between a view and its neighbours, degrees: least and most.
    pub angles_deg: [f64; 2],
    /// Share of the points at either end of a view's depths that is left out: some are wrong.
    pub tail: f64,
    /// A view's depths reach so much farther than the points', as a share of their range: not all
    /// of the object has points.
    pub reach: f64,
    /// Rounds over all pixels by their likeness alone, at the coarsest level.
    pub first_rounds: u32,
    /// Rounds at any other level; the neighbours' depths count too.
    pub rounds: u32,
    /// Standard deviation of the bilateral weights in brightness, of 255.
    pub sigma_grey: f32,
    /// Standard deviation of the noise of the pictures, of 255: a patch with less contrast is like
    /// any other.
    pub noise: f32,
    /// A neighbour's plane is not tried if it moves the patch by fewer pixels and its normal
    /// differs by less than this.
    pub same: [f32; 2],
    /// Largest random change of a depth, in pixels that it moves the patch, and of a normal (unit).
    pub changes: [f32; 2],
    /// Least change, as a share of the largest.
    pub least_change: f32,
    /// Cost of a pixel between a plane and what the neighbour has there.
    pub geometric: f32,
    /// Cost of a pixel between a plane and those around it, where the picture says nothing.
    pub smooth: f32,
    /// Whether the masks are outlines of the object: beside them there is nothing.
    pub outlines: bool,
    /// With outlines: cost of a pixel between a plane and the visual hull, where the picture says
    /// nothing.
    pub hull: f32,
    /// When views agree on a depth.
    pub tolerance: Tolerance,
    /// A depth stays if so many other views agree.
    pub agreeing: u8,
    /// Cost above which a depth does not stay.
    pub most_cost: f32,
    /// Views that are asked whether they look through a depth, at most.
    pub witnesses: usize,
    /// Seed of the random planes.
    pub seed: u64,
}

/// When two depths mean the same place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerance {
    /// Pixels between a pixel and where it comes back to, less than this.
    pub px: f32,
    /// Difference of the depths as a share of the depth, less than this.
    pub depth: f32,
}

impl Default for StereoSettings {
    fn default() -> Self {
        Self {
            levels: 3,
            most_side: 1200,
            neighbours: 8,
            best: 4,
            angles_deg: [4.0, 26.0],
            tail: 0.01,
            reach: 0.25,
            first_rounds: 4,
            rounds: 2,
            sigma_grey: 40.0,
            noise: 1.2,
            same: [0.03, 0.03],
            changes: [4.0, 0.7],
            least_change: 1.0 / 80.0,
            geometric: 0.15,
            smooth: 0.2,
            outlines: false,
            hull: 0.5,
            tolerance: Tolerance { px: 1.0, depth: 0.01 },
            agreeing: 2,
            most_cost: 1.5,
            witnesses: 100,
            seed: 0,
        }
    }
}

impl StereoSettings {
    /// How often the pictures are halved before the finest level.
    pub(crate) fn first_level(&self, views: &[PosedPhoto]) -> u32 {
        let side = views.iter().map(|v| v.camera.width.max(v.camera.height)).max().unwrap_or(0);
        (0..u32::BITS - 1).find(|l| side >> l <= self.most_side.max(1)).unwrap_or(0)
    }

    /// Rounds over all pixels at a level.
    pub(crate) fn rounds(&self, level: u32) -> u32 {
        if level + 1 == self.levels { self.first_rounds + self.rounds } else { self.rounds }
    }

    /// Standard deviation of the noise at a level: means over squares have less, but for what their
    /// rounding adds.
    pub(crate) fn noise_at(&self, level: u32) -> f32 {
        self.noise / (1 << level) as f32 + ROUNDING
    }

    /// Whether the depths of other views count in a round.
    pub(crate) fn is_geometric(&self, level: u32, round: u32) -> bool {
        level + 1 < self.levels || round >= self.first_rounds
    }
}
