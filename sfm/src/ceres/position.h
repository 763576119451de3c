// Positions from bearings by Ceres: global positioning once rotations are known.
#pragma once

#include <cstdint>

#include "bundle.h"

namespace sat_recon {

struct PositionInput;

// Minimises 1/2 Σ ρ(|v − d (X − c)|²) with Huber's ρ over camera centres c, points X and d ≥ 0:
// bearings v agree with X − c in direction, whatever its length. Pan et al., "Global
// Structure-from-Motion Revisited", ECCV 2024; the residual is that of Zhuang et al., "Baseline
// Desensitizing in Translation Averaging", CVPR 2018.
//   centres [P × 3], points [N × 3], scales [M]  starts (anything), then the result, up to a
//                                                similarity without turn
BundleOutcome solve_positions(const PositionInput &input, rust::Slice<double> centres, rust::Slice<double> points,
                              rust::Slice<double> scales, const Monitor &monitor);

}  // namespace sat_recon
