// Bundle adjustment by Ceres: the one call that crosses from Rust. Everything is validated on the
// Rust side: finite numbers, indices in range, at least one observation.
#pragma once

#include <cstdint>
#include <memory>

#include "rust/cxx.h"

namespace sat_recon {

struct BundleInput;
struct BundleOutcome;
struct Monitor;

// Minimises 1/2 Σ ρ(|w (π(camera, pose, point) − pixel)|²) + priors over everything not held
// constant.
//   intrinsics [Σ num_params]  the cameras' parameters, one camera after the other
//   poses      [P × 7]         cam_from_world: quaternion x y z w, translation
//   points     [N × 3]         world
BundleOutcome solve_bundle(const BundleInput &input, rust::Slice<double> intrinsics, rust::Slice<double> poses,
                           rust::Slice<double> points, const Monitor &monitor);

// Marginal covariance, for unit noise, of intrinsics and poses after the points are eliminated.
// pose_covariance   [P × 36]         row-major over (rotation vector on the left of R, translation)
//   camera_covariance [Σ num_params²]  row-major for each camera
// Both are 0 where constant. Returns false where the normal matrix cannot be inverted.
bool bundle_covariance(const BundleInput &input, rust::Slice<const double> intrinsics, rust::Slice<const double> poses,
                       rust::Slice<const double> points, rust::Slice<double> pose_covariance,
                       rust::Slice<double> camera_covariance);

// Information (inverse covariance, for unit noise) of all free intrinsics jointly after points and
// poses are eliminated; priors are not in it.
//   information [F × F]  symmetric, over the free parameters of all cameras in their order
// Returns false where the poses cannot be eliminated.
bool camera_information(const BundleInput &input, rust::Slice<const double> intrinsics, rust::Slice<const double> poses,
                        rust::Slice<const double> points, rust::Slice<double> information);

// The quadratic that the cost is in all poses after points and intrinsics are eliminated; priors on
// intrinsics are in it, what is expected of poses is not.
//   information [6P × 6P]  symmetric, over (ω, t) of all poses, none of them held
//   slope       [6P]       of the cost where it is now
// Returns false where the intrinsics cannot be eliminated.
bool pose_information(const BundleInput &input, rust::Slice<const double> intrinsics, rust::Slice<const double> poses,
                      rust::Slice<const double> points, rust::Slice<double> information, rust::Slice<double> slope);

}  // namespace sat_recon
