// Bundle adjustment by Ceres with analytic Jacobians. See bundle.h for the shapes.
#include "bundle.h"

#include <glog/logging.h>

#include <deque>

#include "blocks.h"
#include "levels.h"
#include "normal.h"

namespace sat_recon {
namespace {

// w (π(x) − pixel) and its derivatives by (rotation vector, translation), point and intrinsics. The
// pose's ambient Jacobian is [∂ω ∂t 0]: PoseManifold's "PlusJacobian" picks the first six columns,
// which spares the quaternion's.
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
    if (jacobians == nullptr) {
      Project(model_, parameters[2], x, pixel_, weight_, residuals, nullptr, nullptr);
      return true;
    }
    Jacobian2x3 by_x;
    Project(model_, parameters[2], x, pixel_, weight_, residuals, &by_x, jacobians[2]);
    if (jacobians[0] != nullptr) {
      Eigen::Map<Eigen::Matrix<double, 2, kPoseSize, Eigen::RowMajor>> j(jacobians[0]);
      for (int row = 0; row < 2; ++row) j.row(row).head<3>() = rotated.cross(by_x.row(row).transpose());
      j.middleCols<3>(3) = by_x;
      j.col(6).setZero();
    }
    if (jacobians[1] != nullptr) Eigen::Map<Jacobian2x3>{jacobians[1]} = by_x * rotation;
    return true;
  }

 private:
  int model_;
  double weight_, pixel_[2];
};

// What is expected of a pose beside the observations, in standard deviations: log(R R₀⁻¹), and the
// place R c + t of a point c of the world. Its Jacobian by (ω, t) is that of Reprojection.
class ExpectedPose final : public ceres::CostFunction {
 public:
  ExpectedPose(const BundleInput &input, std::size_t pose)
      : rotation_(input.expected_rotation.data() + 4 * pose),
        place_(input.expected_place.data() + 3 * pose),
        centre_(input.expected_centre.data()),
        by_rotation_(1 / input.expected_sigma[0]),
        by_place_(1 / input.expected_sigma[1]) {
    set_num_residuals(6);
    mutable_parameter_block_sizes()->assign({kPoseSize});
  }

  bool Evaluate(double const *const *parameters, double *residuals, double **jacobians) const override {
    const Eigen::Map<const Eigen::Quaterniond> q(parameters[0]);
    const Eigen::Quaterniond step = q.normalized() * rotation_.conjugate();
    const Eigen::Vector3d half = step.w() < 0 ? Eigen::Vector3d(-step.vec()) : Eigen::Vector3d(step.vec());
    const double sine = half.norm(), angle = 2 * std::atan2(sine, std::abs(step.w()));
    const Eigen::Vector3d log = (sine > 1e-12 ? angle / sine : 2.0) * half;
    const Eigen::Vector3d turned = q.normalized() * centre_;
    Eigen::Map<Eigen::Matrix<double, 6, 1>> r(residuals);
    r << by_rotation_ * log, by_place_ * (turned + Eigen::Map<const Eigen::Vector3d>(parameters[0] + 4) - place_);
    if (jacobians == nullptr || jacobians[0] == nullptr) return true;
    Eigen::Map<Eigen::Matrix<double, 6, kPoseSize, Eigen::RowMajor>> j(jacobians[0]);
    j.setZero();
    // log(exp(ω) exp(r)) ≈ r + (1 − ½ [r]ₓ + ⅟₁₂ [r]ₓ²) ω
    const Eigen::Matrix3d cross = Skew(log);
    j.block<3, 3>(0, 0) = by_rotation_ * (Eigen::Matrix3d::Identity() - 0.5 * cross + cross * cross / 12);
    j.block<3, 3>(3, 0) = -by_place_ * Skew(turned);
    j.block<3, 3>(3, 3) = by_place_ * Eigen::Matrix3d::Identity();
    return true;
  }

 private:
  static Eigen::Matrix3d Skew(const Eigen::Vector3d &v) {
    Eigen::Matrix3d m;
    m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
    return m;
  }
  const Eigen::Map<const Eigen::Quaterniond> rotation_;
  const Eigen::Map<const Eigen::Vector3d> place_, centre_;
  double by_rotation_, by_place_;
};

}  // namespace

BundleOutcome solve_bundle(const BundleInput &input, rust::Slice<double> intrinsics, rust::Slice<double> poses,
                           rust::Slice<double> points, const Monitor &monitor) {
  FLAGS_minloglevel = 3;  // glog would write Ceres' warnings to stderr
  // Ceres orders the blocks of a group by address: in one allocation their order does not depend on
  // the heap.
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
  std::deque<ExpectedPose> expected;
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
  }
  for (std::size_t i = 0; 4 * i < input.expected_rotation.size(); ++i) {
    expected.emplace_back(input, i);
    problem.AddResidualBlock(&expected.back(), nullptr, poses_at + kPoseSize * i);
  }
  const auto group = [&](double *block, int number) {
    if (problem.HasParameterBlock(block)) ordering->AddElementToGroup(block, number);
  };
  for (std::size_t i = 0; i < input.point_held.size(); ++i) group(points.data() + 3 * i, 0);
  for (std::size_t i = 0; i < input.pose_held.size(); ++i) group(poses_at + kPoseSize * i, 1);
  for (const std::size_t offset : input.camera_offsets) group(intrinsics_at + offset, 1);
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
  return MakeOutcome(summary);
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
  columns.camera = CameraColumns(input, columns.size);
  return columns;
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
  ObservationRows own(rows);
  for (int k = 0; k < 6; ++k) own.Add(columns.pose[pose][k], by_pose, kPoseSize, k);
  for (int k = 0; k < size; ++k) own.Add(columns.camera[camera][k], by_camera, size, k);
  own.Finish(loss, residuals, by_point);
}

// Adds JᵀJ over the columns with all points eliminated; priors are not in it.
template <class Matrix>
void AddReducedNormal(const BundleInput &input, const Columns &columns, rust::Slice<const double> intrinsics,
                      rust::Slice<const double> poses, rust::Slice<const double> points, Matrix &normal,
                      Eigen::VectorXd *gradient = nullptr) {
  const std::unique_ptr<ceres::LossFunction> loss = MakeLoss(input);
  std::vector<std::vector<std::size_t>> of_point(input.point_held.size());
  for (std::size_t i = 0; i < input.observation_point.size(); ++i) of_point[input.observation_point[i]].push_back(i);
  for (std::size_t point = 0; point < of_point.size(); ++point) {
    PointRows rows;
    for (const std::size_t i : of_point[point]) {
      const std::size_t pose = input.observation_pose[i];
      double const *const blocks[3] = {poses.data() + kPoseSize * pose, points.data() + 3 * point,
                                       intrinsics.data() + input.camera_offsets[input.pose_camera[pose]]};
      AddObservation(input, columns, loss.get(), i, blocks, rows);
    }
    if (!rows.at.empty()) Eliminate(rows, input.point_held[point] != 0, normal, gradient);
  }
}

// Adds what is expected of the poses.
template <class Matrix>
void AddExpectedPoses(const BundleInput &input, const Columns &columns, rust::Slice<const double> poses,
                      Matrix &normal) {
  for (std::size_t i = 0; 4 * i < input.expected_rotation.size(); ++i) {
    double residuals[6];
    Eigen::Matrix<double, 6, kPoseSize, Eigen::RowMajor> by_pose;
    double const *const block = poses.data() + kPoseSize * i;
    double *const jacobian = by_pose.data();
    ExpectedPose(input, i).Evaluate(&block, residuals, const_cast<double **>(&jacobian));
    const std::vector<int> &column = columns.pose[i];
    for (int a = 0; a < 6; ++a)
      for (int b = 0; b < 6; ++b)
        if (column[a] >= 0 && column[b] >= 0) normal(column[a], column[b]) += by_pose.col(a).dot(by_pose.col(b));
  }
}

// The level of each column: its pose's; of a camera's that of its poses, where they lie in one,
// else the border.
std::vector<int> LevelsOfColumns(const BundleInput &input, const Columns &columns) {
  constexpr int kUnused = -2;
  const std::vector<int> of_pose = PoseLevels(input);
  std::vector<int> of_camera(columns.camera.size(), kUnused), result(columns.size, LevelMatrix::kBorder);
  for (std::size_t i = 0; i < of_pose.size(); ++i) {
    for (const int column : columns.pose[i])
      if (column >= 0) result[column] = of_pose[i];
    // What a constant pose sees may lie anywhere.
    int &level = of_camera[input.pose_camera[i]];
    level = level == kUnused || level == of_pose[i] ? of_pose[i] : LevelMatrix::kBorder;
  }
  for (std::size_t c = 0; c < of_camera.size(); ++c)
    for (const int column : columns.camera[c])
      if (column >= 0) result[column] = std::max(of_camera[c], LevelMatrix::kBorder);
  return result;
}

}  // namespace

bool bundle_covariance(const BundleInput &input, rust::Slice<const double> intrinsics, rust::Slice<const double> poses,
                       rust::Slice<const double> points, rust::Slice<double> pose_covariance,
                       rust::Slice<double> camera_covariance) {
  const Columns columns = MakeColumns(input);
  if (columns.size == 0) return false;
  LevelMatrix normal(LevelsOfColumns(input, columns));
  AddReducedNormal(input, columns, intrinsics, poses, points, normal);
  AddIntrinsicsPriors(input, columns.camera, normal);
  AddExpectedPoses(input, columns, poses, normal);
  if (!normal.Invert()) return false;
  const LevelMatrix &covariance = normal;
  for (std::size_t i = 0; i < columns.pose.size(); ++i)
    CopyBlock(covariance, columns.pose[i], pose_covariance.data() + 36 * i);
  CopyCameraBlocks(covariance, columns.camera, camera_covariance.data());
  return true;
}

bool camera_information(const BundleInput &input, rust::Slice<const double> intrinsics, rust::Slice<const double> poses,
                        rust::Slice<const double> points, rust::Slice<double> information) {
  const Columns columns = MakeColumns(input);
  Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(columns.size, columns.size);
  AddReducedNormal(input, columns, intrinsics, poses, points, normal);
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

bool pose_information(const BundleInput &input, rust::Slice<const double> intrinsics, rust::Slice<const double> poses,
                      rust::Slice<const double> points, rust::Slice<double> information, rust::Slice<double> slope) {
  const Columns columns = MakeColumns(input);
  Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(columns.size, columns.size);
  Eigen::VectorXd gradient = Eigen::VectorXd::Zero(columns.size);
  AddReducedNormal(input, columns, intrinsics, poses, points, normal, &gradient);
  AddIntrinsicsPriors(input, columns.camera, normal);
  for (std::size_t c = 0; c < columns.camera.size(); ++c)
    for (std::size_t i = 0; i < columns.camera[c].size(); ++i) {
      const std::size_t k = input.camera_offsets[c] + i;
      const int column = columns.camera[c][i];
      if (input.prior_sigma[k] > 0 && column >= 0)
        gradient(column) += (intrinsics[k] - input.prior_mean[k]) / (input.prior_sigma[k] * input.prior_sigma[k]);
    }
  const int of_poses = static_cast<int>(slope.size()), rest = columns.size - of_poses;
  if (rest < 0 || information.size() != slope.size() * slope.size()) return false;
  Eigen::MatrixXd marginal = normal.topLeftCorner(of_poses, of_poses);
  Eigen::VectorXd left = gradient.head(of_poses);
  if (rest > 0) {
    const Eigen::VectorXd scale = normal.diagonal().tail(rest).cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
    const Eigen::LLT<Eigen::MatrixXd> factor(scale.asDiagonal() * normal.bottomRightCorner(rest, rest) *
                                             scale.asDiagonal());
    if (factor.info() != Eigen::Success) return false;
    const Eigen::MatrixXd cross = scale.asDiagonal() * normal.bottomLeftCorner(rest, of_poses);
    marginal -= cross.transpose() * factor.solve(cross);
    left -= cross.transpose() * factor.solve(scale.asDiagonal() * gradient.tail(rest));
  }
  if (!marginal.allFinite() || !left.allFinite()) return false;
  Eigen::Map<Eigen::MatrixXd>(information.data(), of_poses, of_poses) = marginal;
  Eigen::Map<Eigen::VectorXd>(slope.data(), of_poses) = left;
  return true;
}

}  // namespace sat_recon
