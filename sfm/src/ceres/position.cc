// Positions from bearings by Ceres with analytic Jacobians. See position.h for the shapes.
#include "position.h"

#include <glog/logging.h>

#include <deque>

#include "blocks.h"

namespace sat_recon {
namespace {

constexpr double kSmallestScale = 1e-5;

// v − d (X − c). Blocks: d, X, c.
class Bearing final : public ceres::CostFunction {
 public:
  explicit Bearing(const double *direction) : v_(direction) {
    set_num_residuals(3);
    mutable_parameter_block_sizes()->assign({1, 3, 3});
  }

  bool Evaluate(double const *const *parameters, double *residuals, double **jacobians) const override {
    const double d = parameters[0][0];
    for (int i = 0; i < 3; ++i) {
      const double offset = parameters[1][i] - parameters[2][i];
      residuals[i] = v_[i] - d * offset;
      if (jacobians == nullptr) continue;
      if (jacobians[0] != nullptr) jacobians[0][i] = -offset;
      for (int k = 0; k < 3; ++k) {
        if (jacobians[1] != nullptr) jacobians[1][3 * i + k] = i == k ? -d : 0.0;
        if (jacobians[2] != nullptr) jacobians[2][3 * i + k] = i == k ? d : 0.0;
      }
    }
    return true;
  }

 private:
  const double *v_;
};

}  // namespace

BundleOutcome solve_positions(const PositionInput &input, rust::Slice<double> centres, rust::Slice<double> points,
                              rust::Slice<double> scales, const Monitor &monitor) {
  FLAGS_minloglevel = 3;
  // One allocation: see solve_bundle.
  std::vector<double> together(scales.begin(), scales.end());
  together.insert(together.end(), points.begin(), points.end());
  together.insert(together.end(), centres.begin(), centres.end());
  double *const scales_at = together.data();
  double *const points_at = scales_at + scales.size();
  double *const centres_at = points_at + points.size();
  ceres::HuberLoss loss(input.loss_scale);
  ceres::Problem::Options ownership;
  ownership.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ownership.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ownership.disable_all_safety_checks = true;
  ceres::Problem problem(ownership);
  std::deque<Bearing> costs;
  const auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  for (std::size_t i = 0; i < input.observation_camera.size(); ++i) {
    costs.emplace_back(input.directions.data() + 3 * i);
    double *const blocks[3] = {scales_at + i, points_at + 3 * std::size_t{input.observation_point[i]},
                               centres_at + 3 * std::size_t{input.observation_camera[i]}};
    problem.AddResidualBlock(&costs.back(), &loss, blocks, 3);
    problem.SetParameterLowerBound(blocks[0], 0, kSmallestScale);
    ordering->AddElementToGroup(blocks[0], 0);
  }
  for (std::size_t i = 0; i < points.size(); i += 3)
    if (problem.HasParameterBlock(points_at + i)) ordering->AddElementToGroup(points_at + i, 1);
  for (std::size_t i = 0; i < centres.size(); i += 3)
    if (problem.HasParameterBlock(centres_at + i)) ordering->AddElementToGroup(centres_at + i, 2);
  ceres::Solver::Options options;
  options.max_num_iterations = input.max_iterations;
  options.function_tolerance = input.function_tolerance;
  options.logging_type = ceres::SILENT;
  options.num_threads = 1;
  options.linear_solver_type = ceres::SPARSE_SCHUR;
  options.sparse_linear_algebra_library_type = ceres::EIGEN_SPARSE;
  options.dense_linear_algebra_library_type = ceres::EIGEN;
  options.linear_solver_ordering = ordering;
  Watch watch(monitor);
  options.callbacks.push_back(&watch);
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  std::copy(scales_at, points_at, scales.begin());
  std::copy(points_at, centres_at, points.begin());
  std::copy(centres_at, together.data() + together.size(), centres.begin());
  return MakeOutcome(summary);
}

}  // namespace sat_recon
