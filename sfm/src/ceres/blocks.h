// What the adjustments share: projection with derivatives, manifolds, priors on intrinsics, solver
// options.
#pragma once

#include <ceres/ceres.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include "sfm/src/ceres/mod.rs.h"

namespace sat_recon {

using Jacobian2x3 = Eigen::Matrix<double, 2, 3, Eigen::RowMajor>;

inline constexpr double kMinDepth = 1e-9;          // scenes are normalised to unit size before they get here
inline constexpr double kBehindResidualPx = 1e4;   // of a point that a trial step puts behind the camera
inline constexpr int kPoseSize = 7;

// Where a model keeps the parameters of the general one (fx fy cx cy k1 k2 p1 p2); −1: it has none.
struct Layout {
  int size, slot[8];
};
inline constexpr Layout kLayouts[5] = {
    {3, {0, 0, 1, 2, -1, -1, -1, -1}},  // SIMPLE_PINHOLE
    {4, {0, 1, 2, 3, -1, -1, -1, -1}},  // PINHOLE
    {4, {0, 0, 1, 2, 3, -1, -1, -1}},   // SIMPLE_RADIAL
    {5, {0, 0, 1, 2, 3, 4, -1, -1}},    // RADIAL
    {8, {0, 1, 2, 3, 4, 5, 6, 7}},      // OPENCV
};

// w (π(x) − pixel) for a point x in the camera frame. `by_x`: its derivative by x; `by_intrinsics`
// [2 × size]: by the parameters; either may be null. Behind the camera a large constant without
// slope, and false.
inline bool Project(int model, const double *intrinsics, const Eigen::Vector3d &x, const double *pixel, double weight,
                    double *residuals, Jacobian2x3 *by_x, double *by_intrinsics) {
  const Layout &layout = kLayouts[model];
  if (!(x.z() > kMinDepth)) {
    residuals[0] = residuals[1] = weight * kBehindResidualPx;
    if (by_x != nullptr) by_x->setZero();
    if (by_intrinsics != nullptr) std::fill(by_intrinsics, by_intrinsics + 2 * layout.size, 0.0);
    return false;
  }
  double c[8];
  for (int i = 0; i < 8; ++i) c[i] = layout.slot[i] < 0 ? 0.0 : intrinsics[layout.slot[i]];
  const double u = x.x() / x.z(), v = x.y() / x.z(), uv = u * v, r2 = u * u + v * v;
  const double radial = 1 + r2 * (c[4] + r2 * c[5]);
  const double du = u * radial + 2 * c[6] * uv + c[7] * (r2 + 2 * u * u);
  const double dv = v * radial + 2 * c[7] * uv + c[6] * (r2 + 2 * v * v);
  residuals[0] = weight * (c[0] * du + c[2] - pixel[0]);
  residuals[1] = weight * (c[1] * dv + c[3] - pixel[1]);
  if (by_x != nullptr) {
    const double slope = 2 * c[4] + 4 * r2 * c[5];  // d radial / d(r²/2)
    const double uu = radial + u * u * slope + 2 * c[6] * v + 6 * c[7] * u;
    const double vv = radial + v * v * slope + 2 * c[7] * u + 6 * c[6] * v;
    const double cross = uv * slope + 2 * c[6] * u + 2 * c[7] * v;
    const double wx = weight * c[0] / x.z(), wy = weight * c[1] / x.z();
    *by_x << wx * uu, wx * cross, -wx * (uu * u + cross * v), wy * cross, wy * vv, -wy * (cross * u + vv * v);
  }
  if (by_intrinsics != nullptr) {
    const double r4 = r2 * r2, a = weight * c[0], b = weight * c[1];
    const double full[2][8] = {{weight * du, 0, weight, 0, a * u * r2, a * u * r4, 2 * a * uv, a * (r2 + 2 * u * u)},
                               {0, weight * dv, 0, weight, b * v * r2, b * v * r4, b * (r2 + 2 * v * v), 2 * b * uv}};
    for (int row = 0; row < 2; ++row) {
      double *j = by_intrinsics + row * layout.size;
      std::fill(j, j + layout.size, 0.0);
      for (int i = 0; i < 8; ++i)
        if (layout.slot[i] >= 0) j[layout.slot[i]] += full[row][i];
    }
  }
  return true;
}

// R ← exp(ω) R, t ← t + δ; one coordinate of t may be held (−1: none), which fixes the scale of the
// scene.
class PoseManifold final : public ceres::Manifold {
 public:
  explicit PoseManifold(int held) : held_(held) {}
  int AmbientSize() const override { return kPoseSize; }
  int TangentSize() const override { return held_ < 0 ? 6 : 5; }

  bool Plus(const double *x, const double *delta, double *y) const override {
    const Eigen::Vector3d omega(delta[0], delta[1], delta[2]);
    const double angle = omega.norm();
    const double s = angle > 1e-12 ? std::sin(angle / 2) / angle : 0.5;
    const Eigen::Quaterniond step(std::cos(angle / 2), s * omega.x(), s * omega.y(), s * omega.z());
    const Eigen::Quaterniond q(x[3], x[0], x[1], x[2]);
    const Eigen::Quaterniond moved = (step * q).normalized();
    y[0] = moved.x(), y[1] = moved.y(), y[2] = moved.z(), y[3] = moved.w();
    for (int i = 0, k = 3; i < 3; ++i) y[4 + i] = x[4 + i] + (i == held_ ? 0.0 : delta[k++]);
    return true;
  }
  bool PlusJacobian(const double *, double *jacobian) const override { return Selection(jacobian, false); }
  bool Minus(const double *y, const double *x, double *delta) const override {
    const Eigen::Quaterniond qy(y[3], y[0], y[1], y[2]), qx(x[3], x[0], x[1], x[2]);
    const Eigen::AngleAxisd step(qy * qx.conjugate());
    for (int i = 0; i < 3; ++i) delta[i] = step.angle() * step.axis()[i];
    for (int i = 0, k = 3; i < 3; ++i)
      if (i != held_) delta[k++] = y[4 + i] - x[4 + i];
    return true;
  }
  bool MinusJacobian(const double *, double *jacobian) const override { return Selection(jacobian, true); }

 private:
  // [7 × tangent], or its transpose: the columns (ω, t without the held coordinate) of the ambient
  // Jacobian.
  bool Selection(double *jacobian, bool transposed) const {
    const int n = TangentSize();
    std::fill(jacobian, jacobian + kPoseSize * n, 0.0);
    const int dropped = held_ < 0 ? -1 : held_ + 3;
    for (int row = 0, k = 0; row < 6; ++row)
      if (row != dropped) jacobian[transposed ? k++ * kPoseSize + row : row * n + k++] = 1.0;
    return true;
  }
  int held_;
};
// (p − mean) / sigma for the parameters that have a prior (sigma > 0).
class IntrinsicsPrior final : public ceres::CostFunction {
 public:
  IntrinsicsPrior(int size, const double *mean, const double *sigma) : mean_(mean), sigma_(sigma) {
    set_num_residuals(size);
    mutable_parameter_block_sizes()->assign({size});
  }
  bool Evaluate(double const *const *parameters, double *residuals, double **jacobians) const override {
    const int n = num_residuals();
    for (int i = 0; i < n; ++i) residuals[i] = sigma_[i] > 0 ? (parameters[0][i] - mean_[i]) / sigma_[i] : 0.0;
    if (jacobians != nullptr && jacobians[0] != nullptr) {
      std::fill(jacobians[0], jacobians[0] + n * n, 0.0);
      for (int i = 0; i < n; ++i) jacobians[0][i * n + i] = sigma_[i] > 0 ? 1 / sigma_[i] : 0.0;
    }
    return true;
  }

 private:
  const double *mean_, *sigma_;
};

inline std::unique_ptr<ceres::LossFunction> MakeLoss(const BundleInput &input) {
  switch (input.loss) {
    case 1: return std::make_unique<ceres::SoftLOneLoss>(input.loss_scale);
    case 2: return std::make_unique<ceres::CauchyLoss>(input.loss_scale);
    default: return nullptr;
  }
}

class Watch final : public ceres::IterationCallback {
 public:
  explicit Watch(const Monitor &monitor) : monitor_(monitor) {}
  ceres::CallbackReturnType operator()(const ceres::IterationSummary &) override {
    return is_cancelled(monitor_) ? ceres::SOLVER_ABORT : ceres::SOLVER_CONTINUE;
  }

 private:
  const Monitor &monitor_;
};

inline bool Free(const BundleInput &input, std::size_t camera, int parameter) {
  return input.intrinsics_free[input.camera_offsets[camera] + parameter] != 0;
}

// Holds what is constant and gives every other camera its manifold.
inline void AddCameras(const BundleInput &input, double *intrinsics, std::vector<std::unique_ptr<ceres::CostFunction>> &priors,
                ceres::Problem &problem) {
  for (std::size_t c = 0; c < input.camera_models.size(); ++c) {
    const int size = kLayouts[input.camera_models[c]].size;
    double *block = intrinsics + input.camera_offsets[c];
    if (!problem.HasParameterBlock(block)) continue;
    std::vector<int> held;
    for (int i = 0; i < size; ++i)
      if (!Free(input, c, i)) held.push_back(i);
    if (static_cast<int>(held.size()) == size) {
      problem.SetParameterBlockConstant(block);
      continue;
    }
    if (!held.empty()) problem.SetManifold(block, new ceres::SubsetManifold(size, held));
    const double *sigma = input.prior_sigma.data() + input.camera_offsets[c];
    if (std::any_of(sigma, sigma + size, [](double s) { return s > 0; })) {
      priors.push_back(
          std::make_unique<IntrinsicsPrior>(size, input.prior_mean.data() + input.camera_offsets[c], sigma));
      problem.AddResidualBlock(priors.back().get(), nullptr, block);
    }
  }
}

// Free poses from which on the reduced system of the poses is not formed. On rings a point is
// seen by a share of all images, so that forming it grows with their square and its factor with
// their cube. Source: `make bench` (rings): direct is faster at 100 images, conjugate gradients at
// 300.
constexpr std::size_t kManyPoses = 200;

inline ceres::Solver::Options MakeOptions(const BundleInput &input) {
  ceres::Solver::Options options;
  options.max_num_iterations = input.max_iterations;
  options.function_tolerance = input.function_tolerance;
  options.gradient_tolerance = 1e-14;
  options.parameter_tolerance = input.parameter_tolerance;
  options.logging_type = ceres::SILENT;
  options.num_threads = 1;  // sums over threads would depend on their order
  options.dense_linear_algebra_library_type = ceres::EIGEN;
  options.sparse_linear_algebra_library_type = ceres::EIGEN_SPARSE;
  options.initial_trust_region_radius = 1e8;  // starts are good and some directions (focal length against depth) are flat
  const std::size_t free_poses = input.free_poses;
  options.linear_solver_type = free_poses <= 60 ? ceres::DENSE_SCHUR : ceres::SPARSE_SCHUR;
  if (free_poses > kManyPoses) {
    options.linear_solver_type = ceres::ITERATIVE_SCHUR;
    options.preconditioner_type = ceres::SCHUR_JACOBI;
  }
  return options;
}

inline BundleOutcome MakeOutcome(const ceres::Solver::Summary &summary) {
  BundleOutcome outcome;
  outcome.initial_cost = summary.initial_cost;
  outcome.final_cost = summary.final_cost;
  outcome.iterations = static_cast<std::uint32_t>(summary.iterations.size());
  outcome.usable = summary.IsSolutionUsable();
  outcome.converged = summary.termination_type == ceres::CONVERGENCE;
  outcome.cancelled = summary.termination_type == ceres::USER_FAILURE;
  outcome.message = summary.message;
  return outcome;
}

}  // namespace sat_recon
