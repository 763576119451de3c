// Bundle adjustment by Ceres with analytic Jacobians. See bundle.h for the shapes.
#include "bundle.h"

#include <algorithm>
#include <ceres/ceres.h>
#include <glog/logging.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <deque>
#include <memory>
#include <string>
#include <vector>

#include "sfm/src/ceres/mod.rs.h"

namespace sat_recon {
namespace {

using Jacobian2x3 = Eigen::Matrix<double, 2, 3, Eigen::RowMajor>;
using Jacobian2x8 = Eigen::Matrix<double, 2, 8, Eigen::RowMajor>;

constexpr double kMinDepth = 1e-9;          // scenes are normalised to unit size before they get here
constexpr double kBehindResidualPx = 1e4;   // of a point that a trial step puts behind the camera
constexpr int kPoseSize = 7;

// Where a model keeps the parameters of the general one (fx fy cx cy k1 k2 p1 p2); −1: it has none.
struct Layout {
  int size, slot[8];
};
constexpr Layout kLayouts[5] = {
    {3, {0, 0, 1, 2, -1, -1, -1, -1}},  // SIMPLE_PINHOLE
    {4, {0, 1, 2, 3, -1, -1, -1, -1}},  // PINHOLE
    {4, {0, 0, 1, 2, 3, -1, -1, -1}},   // SIMPLE_RADIAL
    {5, {0, 0, 1, 2, 3, 4, -1, -1}},    // RADIAL
    {8, {0, 1, 2, 3, 4, 5, 6, 7}},      // OPENCV
};

// w (π(x) − pixel) and its derivatives by (rotation vector, translation), point and intrinsics. The pose's ambient
// Jacobian is [∂ω ∂t 0]: PoseManifold's "PlusJacobian" picks the first six columns, which spares the quaternion's.
class Reprojection final : public ceres::CostFunction {
 public:
  Reprojection(int model, const double *pixel, double weight) : model_(model), weight_(weight) {
    pixel_[0] = pixel[0];
    pixel_[1] = pixel[1];
    set_num_residuals(2);
    mutable_parameter_block_sizes()->assign({kPoseSize, 3, kLayouts[model].size});
  }

  bool Evaluate(double const *const *parameters, double *residuals, double **jacobians) const override {
    const Eigen::Map<const Eigen::Quaterniond> q(parameters[0]);
    const Eigen::Matrix3d rotation = q.normalized().toRotationMatrix();
    const Eigen::Vector3d rotated = rotation * Eigen::Map<const Eigen::Vector3d>(parameters[1]);
    const Eigen::Vector3d x = rotated + Eigen::Map<const Eigen::Vector3d>(parameters[0] + 4);
    const Layout &layout = kLayouts[model_];
    if (!(x.z() > kMinDepth)) return Behind(layout.size, residuals, jacobians);
    double c[8];
    for (int i = 0; i < 8; ++i) c[i] = layout.slot[i] < 0 ? 0.0 : parameters[2][layout.slot[i]];
    const double u = x.x() / x.z(), v = x.y() / x.z(), uv = u * v, r2 = u * u + v * v;
    const double radial = 1 + r2 * (c[4] + r2 * c[5]);
    const double du = u * radial + 2 * c[6] * uv + c[7] * (r2 + 2 * u * u);
    const double dv = v * radial + 2 * c[7] * uv + c[6] * (r2 + 2 * v * v);
    residuals[0] = weight_ * (c[0] * du + c[2] - pixel_[0]);
    residuals[1] = weight_ * (c[1] * dv + c[3] - pixel_[1]);
    if (jacobians == nullptr) return true;
    const double slope = 2 * c[4] + 4 * r2 * c[5];  // d radial / d(r²/2)
    const double uu = radial + u * u * slope + 2 * c[6] * v + 6 * c[7] * u;
    const double vv = radial + v * v * slope + 2 * c[7] * u + 6 * c[6] * v;
    const double cross = uv * slope + 2 * c[6] * u + 2 * c[7] * v;
    const double wx = weight_ * c[0] / x.z(), wy = weight_ * c[1] / x.z();
    Jacobian2x3 by_x;
    by_x << wx * uu, wx * cross, -wx * (uu * u + cross * v), wy * cross, wy * vv, -wy * (cross * u + vv * v);
    if (jacobians[0] != nullptr) {
      Eigen::Map<Eigen::Matrix<double, 2, kPoseSize, Eigen::RowMajor>> j(jacobians[0]);
      for (int row = 0; row < 2; ++row) j.row(row).head<3>() = rotated.cross(by_x.row(row).transpose());
      j.middleCols<3>(3) = by_x;
      j.col(6).setZero();
    }
    if (jacobians[1] != nullptr) Eigen::Map<Jacobian2x3>{jacobians[1]} = by_x * rotation;
    if (jacobians[2] != nullptr) {
      const double r4 = r2 * r2, a = weight_ * c[0], b = weight_ * c[1];
      const double full[2][8] = {{weight_ * du, 0, weight_, 0, a * u * r2, a * u * r4, 2 * a * uv, a * (r2 + 2 * u * u)},
                                 {0, weight_ * dv, 0, weight_, b * v * r2, b * v * r4, b * (r2 + 2 * v * v), 2 * b * uv}};
      for (int row = 0; row < 2; ++row) {
        double *j = jacobians[2] + row * layout.size;
        std::fill(j, j + layout.size, 0.0);
        for (int i = 0; i < 8; ++i)
          if (layout.slot[i] >= 0) j[layout.slot[i]] += full[row][i];
      }
    }
    return true;
  }

 private:
  bool Behind(int size, double *residuals, double **jacobians) const {
    residuals[0] = residuals[1] = weight_ * kBehindResidualPx;
    if (jacobians == nullptr) return true;
    const int sizes[3] = {kPoseSize, 3, size};
    for (int b = 0; b < 3; ++b)
      if (jacobians[b] != nullptr) std::fill(jacobians[b], jacobians[b] + 2 * sizes[b], 0.0);
    return true;
  }

  int model_;
  double weight_, pixel_[2];
};

// R ← exp(ω) R, t ← t + δ; one coordinate of t may be held (−1: none), which fixes the scale of the scene.
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
  // [7 × tangent], or its transpose: the columns (ω, t without the held coordinate) of the ambient Jacobian.
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

std::unique_ptr<ceres::LossFunction> MakeLoss(const BundleInput &input) {
  switch (input.loss) {
    case 1: return std::make_unique<ceres::HuberLoss>(input.loss_scale);
    case 2: return std::make_unique<ceres::SoftLOneLoss>(input.loss_scale);
    case 3: return std::make_unique<ceres::CauchyLoss>(input.loss_scale);
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

bool Free(const BundleInput &input, std::size_t camera, int parameter) {
  return input.intrinsics_free[input.camera_offsets[camera] + parameter] != 0;
}

// Holds what is constant and gives every other camera its manifold.
void AddCameras(const BundleInput &input, double *intrinsics, std::vector<std::unique_ptr<ceres::CostFunction>> &priors,
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

ceres::Solver::Options MakeOptions(const BundleInput &input) {
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
  return options;
}

}  // namespace

BundleOutcome solve_bundle(const BundleInput &input, rust::Slice<double> intrinsics, rust::Slice<double> poses,
                           rust::Slice<double> points, const Monitor &monitor) {
  FLAGS_minloglevel = 3;  // glog would write Ceres' warnings to stderr
  // Ceres orders the blocks of a group by address: in one allocation their order does not depend on the heap.
  std::vector<double> together(intrinsics.begin(), intrinsics.end());
  together.insert(together.end(), poses.begin(), poses.end());
  double *const intrinsics_at = together.data();
  double *const poses_at = together.data() + intrinsics.size();
  const std::unique_ptr<ceres::LossFunction> loss = MakeLoss(input);
  ceres::Problem::Options ownership;
  ownership.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ownership.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ownership.manifold_ownership = ceres::TAKE_OWNERSHIP;
  ownership.disable_all_safety_checks = true;
  std::deque<Reprojection> costs;
  std::vector<std::unique_ptr<ceres::CostFunction>> priors;
  ceres::Problem problem(ownership);
  const std::size_t count = input.observation_pose.size();
  const auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t pose = input.observation_pose[i], point = input.observation_point[i];
    const std::size_t camera = input.pose_camera[pose];
    costs.emplace_back(input.camera_models[camera], input.pixels.data() + 2 * i, input.weights[i]);
    double *const blocks[3] = {poses_at + kPoseSize * pose, points.data() + 3 * point,
                               intrinsics_at + input.camera_offsets[camera]};
    problem.AddResidualBlock(&costs.back(), loss.get(), blocks, 3);
    ordering->AddElementToGroup(blocks[0], 1);
    ordering->AddElementToGroup(blocks[1], 0);
    ordering->AddElementToGroup(blocks[2], 1);
  }
  for (std::size_t i = 0; i < input.pose_held.size(); ++i) {
    double *block = poses_at + kPoseSize * i;
    if (!problem.HasParameterBlock(block)) continue;
    if (input.pose_held[i] == 7) {
      problem.SetParameterBlockConstant(block);
    } else {
      problem.SetManifold(block, new PoseManifold(static_cast<int>(input.pose_held[i]) - 1));
    }
  }
  for (std::size_t i = 0; i < input.point_held.size(); ++i) {
    double *block = points.data() + 3 * i;
    if (input.point_held[i] != 0 && problem.HasParameterBlock(block)) problem.SetParameterBlockConstant(block);
  }
  AddCameras(input, intrinsics_at, priors, problem);
  ceres::Solver::Options options = MakeOptions(input);
  options.linear_solver_ordering = ordering;
  Watch watch(monitor);
  options.callbacks.push_back(&watch);
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  std::copy(intrinsics_at, poses_at, intrinsics.begin());
  std::copy(poses_at, together.data() + together.size(), poses.begin());
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

namespace {

// First column of each free block in the reduced system; −1: constant.
struct Columns {
  std::vector<std::vector<int>> pose, camera;
  int size = 0;
};

Columns MakeColumns(const BundleInput &input) {
  Columns columns;
  for (const std::uint8_t held : input.pose_held) {
    std::vector<int> column(6, -1);
    const int dropped = held == 0 ? -1 : held + 2;
    for (int i = 0; held != 7 && i < 6; ++i)
      if (i != dropped) column[i] = columns.size++;
    columns.pose.push_back(column);
  }
  for (std::size_t c = 0; c < input.camera_models.size(); ++c) {
    std::vector<int> column(kLayouts[input.camera_models[c]].size, -1);
    for (std::size_t i = 0; i < column.size(); ++i)
      if (Free(input, c, static_cast<int>(i))) column[i] = columns.size++;
    columns.camera.push_back(column);
  }
  return columns;
}

void CopyBlock(const Eigen::MatrixXd &covariance, const std::vector<int> &columns, double *out) {
  const std::size_t n = columns.size();
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t k = 0; k < n; ++k)
      out[i * n + k] = columns[i] < 0 || columns[k] < 0 ? 0.0 : covariance(columns[i], columns[k]);
}

// JᵀJ of one point's observations with the point eliminated, added to `normal`.
// rows: Jacobian of each observation by its camera-side columns; the residuals' noise is one pixel.
struct PointRows {
  std::vector<int> columns;           // of all observations of the point, without repetition
  std::vector<Eigen::MatrixXd> by_camera;
  std::vector<std::vector<int>> at;
  std::vector<Jacobian2x3> by_point;
};

void Eliminate(const PointRows &rows, bool point_held, Eigen::MatrixXd &normal) {
  const int n = static_cast<int>(rows.columns.size());
  Eigen::MatrixXd block = Eigen::MatrixXd::Zero(n, n), cross = Eigen::MatrixXd::Zero(n, 3);
  Eigen::Matrix3d own = Eigen::Matrix3d::Zero();
  for (std::size_t i = 0; i < rows.at.size(); ++i) {
    const std::vector<int> &at = rows.at[i];
    const Eigen::MatrixXd square = rows.by_camera[i].transpose() * rows.by_camera[i];
    const Eigen::MatrixXd mixed = rows.by_camera[i].transpose() * rows.by_point[i];
    own += rows.by_point[i].transpose() * rows.by_point[i];
    for (std::size_t a = 0; a < at.size(); ++a) {
      cross.row(at[a]) += mixed.row(a);
      for (std::size_t b = 0; b < at.size(); ++b) block(at[a], at[b]) += square(a, b);
    }
  }
  if (!point_held) {
    const Eigen::LDLT<Eigen::Matrix3d> factor(own);
    if (factor.info() != Eigen::Success || factor.vectorD().minCoeff() <= 0) return;  // no depth: says nothing
    block -= cross * factor.solve(cross.transpose());
  }
  for (int a = 0; a < n; ++a)
    for (int b = 0; b < n; ++b) normal(rows.columns[a], rows.columns[b]) += block(a, b);
}

int Place(std::vector<int> &columns, int column) {
  const auto found = std::find(columns.begin(), columns.end(), column);
  if (found != columns.end()) return static_cast<int>(found - columns.begin());
  columns.push_back(column);
  return static_cast<int>(columns.size()) - 1;
}

void AddObservation(const BundleInput &input, const Columns &columns, const ceres::LossFunction *loss, std::size_t i,
                    double const *const *blocks, PointRows &rows) {
  const std::size_t pose = input.observation_pose[i], camera = input.pose_camera[pose];
  const int size = kLayouts[input.camera_models[camera]].size;
  const Reprojection cost(input.camera_models[camera], input.pixels.data() + 2 * i, input.weights[i]);
  double residuals[2], by_pose[2 * kPoseSize], by_camera[16];
  Jacobian2x3 by_point;
  double *jacobians[3] = {by_pose, by_point.data(), by_camera};
  cost.Evaluate(blocks, residuals, jacobians);
  double weight = 1;
  if (loss != nullptr) {
    double rho[3];
    loss->Evaluate(residuals[0] * residuals[0] + residuals[1] * residuals[1], rho);
    weight = std::sqrt(rho[1]);
  }
  std::vector<int> at;
  std::vector<Eigen::Vector2d> kept;
  for (int k = 0; k < 6; ++k)
    if (const int column = columns.pose[pose][k]; column >= 0) {
      at.push_back(Place(rows.columns, column));
      kept.emplace_back(by_pose[k], by_pose[kPoseSize + k]);
    }
  for (int k = 0; k < size; ++k)
    if (const int column = columns.camera[camera][k]; column >= 0) {
      at.push_back(Place(rows.columns, column));
      kept.emplace_back(by_camera[k], by_camera[size + k]);
    }
  Eigen::MatrixXd dense(2, static_cast<int>(kept.size()));
  for (std::size_t k = 0; k < kept.size(); ++k) dense.col(static_cast<int>(k)) = weight * kept[k];
  rows.at.push_back(at);
  rows.by_camera.push_back(dense);
  rows.by_point.push_back(weight * by_point);
}

// JᵀJ over the columns with all points eliminated; priors are not in it.
Eigen::MatrixXd ReducedNormal(const BundleInput &input, const Columns &columns, rust::Slice<const double> intrinsics,
                              rust::Slice<const double> poses, rust::Slice<const double> points) {
  const std::unique_ptr<ceres::LossFunction> loss = MakeLoss(input);
  std::vector<std::vector<std::size_t>> of_point(input.point_held.size());
  for (std::size_t i = 0; i < input.observation_point.size(); ++i) of_point[input.observation_point[i]].push_back(i);
  Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(columns.size, columns.size);
  for (std::size_t point = 0; point < of_point.size(); ++point) {
    PointRows rows;
    for (const std::size_t i : of_point[point]) {
      const std::size_t pose = input.observation_pose[i];
      double const *const blocks[3] = {poses.data() + kPoseSize * pose, points.data() + 3 * point,
                                       intrinsics.data() + input.camera_offsets[input.pose_camera[pose]]};
      AddObservation(input, columns, loss.get(), i, blocks, rows);
    }
    if (!rows.at.empty()) Eliminate(rows, input.point_held[point] != 0, normal);
  }
  return normal;
}

}  // namespace

bool bundle_covariance(const BundleInput &input, rust::Slice<const double> intrinsics, rust::Slice<const double> poses,
                       rust::Slice<const double> points, rust::Slice<double> pose_covariance,
                       rust::Slice<double> camera_covariance) {
  const Columns columns = MakeColumns(input);
  if (columns.size == 0) return false;
  Eigen::MatrixXd normal = ReducedNormal(input, columns, intrinsics, poses, points);
  for (std::size_t c = 0; c < columns.camera.size(); ++c)
    for (std::size_t i = 0; i < columns.camera[c].size(); ++i) {
      const double sigma = input.prior_sigma[input.camera_offsets[c] + i];
      const int column = columns.camera[c][i];
      if (sigma > 0 && column >= 0) normal(column, column) += 1 / (sigma * sigma);
    }
  const Eigen::VectorXd scale = normal.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  const Eigen::MatrixXd scaled = scale.asDiagonal() * normal * scale.asDiagonal();
  const Eigen::LLT<Eigen::MatrixXd> factor(scaled);
  if (factor.info() != Eigen::Success) return false;
  Eigen::MatrixXd covariance = factor.solve(Eigen::MatrixXd::Identity(columns.size, columns.size));
  covariance = scale.asDiagonal() * covariance * scale.asDiagonal();
  if (!covariance.allFinite()) return false;
  for (std::size_t i = 0; i < columns.pose.size(); ++i)
    CopyBlock(covariance, columns.pose[i], pose_covariance.data() + 36 * i);
  std::size_t offset = 0;
  for (const std::vector<int> &camera : columns.camera) {
    CopyBlock(covariance, camera, camera_covariance.data() + offset);
    offset += camera.size() * camera.size();
  }
  return true;
}

bool camera_information(const BundleInput &input, rust::Slice<const double> intrinsics, rust::Slice<const double> poses,
                        rust::Slice<const double> points, rust::Slice<double> information) {
  const Columns columns = MakeColumns(input);
  const Eigen::MatrixXd normal = ReducedNormal(input, columns, intrinsics, poses, points);
  int of_poses = 0;  // the columns of the poses come first
  for (const std::vector<int> &pose : columns.pose)
    for (const int column : pose) of_poses += column >= 0 ? 1 : 0;
  const int rest = columns.size - of_poses;
  if (rest <= 0 || information.size() != static_cast<std::size_t>(rest) * rest) return false;
  Eigen::MatrixXd marginal = normal.bottomRightCorner(rest, rest);
  if (of_poses > 0) {
    const Eigen::VectorXd scale =
        normal.diagonal().head(of_poses).cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
    const Eigen::LLT<Eigen::MatrixXd> factor(scale.asDiagonal() * normal.topLeftCorner(of_poses, of_poses) *
                                             scale.asDiagonal());
    if (factor.info() != Eigen::Success) return false;
    const Eigen::MatrixXd cross = scale.asDiagonal() * normal.topRightCorner(of_poses, rest);
    marginal -= cross.transpose() * factor.solve(cross);
  }
  if (!marginal.allFinite()) return false;
  Eigen::Map<Eigen::MatrixXd>(information.data(), rest, rest) = marginal;
  return true;
}

}  // namespace sat_recon
