// Adjustment of a motion about one axis by Ceres. Everything is validated on the Rust side.
#pragma once

#include <cstdint>

#include "rust/cxx.h"

namespace sat_recon {

struct CircularInput;
struct BundleOutcome;
struct Monitor;

// Minimises 1/2 Σ ρ(|w (π(camera, D_i (R Z(θ_i) X + t)) − pixel|²) + priors, Z(θ) a rotation about
// the world's z axis.
//   intrinsics [Σ num_params]  the cameras' parameters
//   axis       [7]             camera from turntable: quaternion x y z w of R, translation t
//   angles     [P]             θ_i, radians
//   offsets    [P × 7]         D_i: quaternion x y z w, translation; the identity where the
//       motion is about one axis
//   points     [N × 3]         turntable frame
BundleOutcome solve_circular(const CircularInput &input, rust::Slice<double> intrinsics, rust::Slice<double> axis,
                         rust::Slice<double> angles, rust::Slice<double> offsets, rust::Slice<double> points,
                         const Monitor &monitor);

// Marginal covariance, for unit noise, after the points are eliminated; offsets are taken as
// constant.
//   circular_covariance   [(3 + P)²]        row-major over the axis' three freedoms (see
//       CircularInput) and the angles; 0 where held
//   camera_covariance [Σ num_params²]   row-major for each camera; 0 where constant
// Returns false where the normal matrix cannot be inverted.
bool circular_covariance(const CircularInput &input, rust::Slice<const double> intrinsics, rust::Slice<const double> axis,
                     rust::Slice<const double> angles, rust::Slice<const double> offsets,
                     rust::Slice<const double> points, rust::Slice<double> circular_covariance,
                     rust::Slice<double> camera_covariance);

}  // namespace sat_recon
