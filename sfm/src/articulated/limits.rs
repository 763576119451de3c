//! The numbers that were chosen for moving parts. Lengths are multiples of the object's size.

/// A track that leaves more than so many times the usual error as a part of the body is looked at,
/// and residuals count less and less from so many standard deviations on. Source: derived: three
/// standard deviations are rare.
pub(super) const MOVING: f64 = 3.0;
/// A track belongs to a part that leaves no more than so many times the usual error. Source: two
/// standard deviations; what is left over is looked at for other parts.
pub(super) const BELONGS: f64 = 2.0;
/// Least noise of a track, pixels: that of exact tracks. Source: chosen by hand, never measured.
pub(super) const LEAST_NOISE_PX: f64 = 0.02;
/// What stays at one place in the picture for as long as it is followed is none of the object, or
/// a reflection: it goes less far than this, pixels. Source: chosen by hand, never measured.
pub(super) const STAYS_PX: f64 = 2.0;
/// Points farther from the middle than so many times the object's size are none of the object.
/// Source: derived: the object reaches to one half; poses may be as wrong again.
pub(super) const FARTHEST: f64 = 2.0;
/// Views without which a track says nothing of a motion. Source: derived: a point and a rate leave
/// as many numbers over as they take.
pub(super) const LEAST_VIEWS: usize = 5;
/// A part has so many tracks. Source: chosen by hand, never measured.
pub(super) const LEAST_TRACKS: usize = 10;
/// Of a place's neighbours in the picture so many are asked which motion they follow. Source: the
/// module's tests: of ten, half are the body's for one of two arrays, which is then no part.
pub(super) const NEIGHBOURS: usize = 6;
/// What the camera goes round less than this share of the way round the body is no part of it.
/// Source: docs/decisions/22 (the rim of a can 0.1, arrays of a turning body 1).
pub(super) const FOLLOWS: f64 = 0.25;
/// A part turns by so much, radians, or it is an error of the poses. Source: chosen by hand.
pub(super) const LEAST_TURN: f64 = 0.05;

/// Groups of neighbouring tracks that are tried, tracks of a group, and frames over which it is
/// looked at. Source: derived: a part with a tenth of the odd tracks is met four times; an axis, a
/// rate and ten points from over a hundred observations; an angle is nearly steady over so short a
/// time.
pub(super) const GROUP: [usize; 3] = [40, 10, 20];
/// Axes that are tried. Source: derived: every direction is within 12° of one.
pub(super) const DIRECTIONS: usize = 160;
/// Turns over the frames that are tried, degrees. Source: derived: by the least a point at the end
/// of the object moves by a pixel, and the largest between frames is followed; the search around
/// the best reaches over their ratio of 1.6.
pub(super) const TURNS_DEG: [f64; 10] =
    [1.5, 2.3641, 3.7259, 5.8723, 9.2551, 14.5866, 22.9893, 36.2325, 57.1045, 90.0];
/// Of the axes and turns that were tried so many are improved. Source: chosen by hand, never
/// measured.
pub(super) const KEPT: usize = 6;

/// How unsteady motions may be: standard deviations of the change of rate from frame to frame,
/// radians (of the body also sizes). Source: derived: the least adds up to a degree over 100
/// frames; the greatest, which is taken before anything is known, is half a degree, more than
/// motors do.
pub(super) const BENDS: [f64; 6] = [3e-5, 9e-5, 2.7e-4, 8.1e-4, 2.43e-3, 7.29e-3];
/// Unknowns of a joint beside its angles. Source: derived: two of the axis, two of the place.
pub(super) const SHARED: usize = 4;
/// Standard deviation of what is known by definition: of the first angle (radians), of the frame
/// and the scale. Source: derived: far less than any angle is known to.
pub(super) const ANCHOR: f64 = 1e-6;
/// Standard deviations of intrinsics beforehand: what a focal length may differ from what it was,
/// as a share of it, and terms of distortion. Source: chosen by hand: weak; of lenses that are no
/// fisheyes.
pub(super) const INTRINSICS: [f64; 2] = [0.3, 0.1];
/// A pose is held so loosely (radians, object sizes) that only what nothing else determines, frame
/// and scale, stays. Source: chosen by hand.
pub(super) const HELD: f64 = 1.0;
/// How often cameras, poses and joints are adjusted, and tracks shared out again. Source: chosen by
/// hand, never measured.
pub(super) const ADJUSTMENTS: usize = 3;
/// Of two chains the simpler one is taken if it has at most so much less evidence (logarithm): so
/// much the same joints differ by when they are found from another start. Source:
/// docs/decisions/22.
pub(super) const SIMPLER: f64 = 20.0;
/// A chain that has so much less evidence after a rough adjustment is not adjusted further.
/// Source: derived: ten times what equals differ by.
pub(super) const HOPELESS: f64 = 10.0 * SIMPLER;
/// A step of an adjustment that gains less than this share of the cost is the last: of a rough one,
/// of a good one. Source: chosen by hand: a few units of evidence, and hundredths.
pub(super) const TOLERANCES: [f64; 2] = [1e-4, 1e-6];
