// Adjustment of a motion about one axis by Ceres with analytic Jacobians. See circular.h for the
// shapes.
#include "circular.h"

#include <glog/logging.h>

#include <deque>

#include "blocks.h"
#include "normal.h"

namespace sat_recon {
namespace {

constexpr std::uint32_t kNone = 0xffffffff;

// w (π(D (R Z(θ) X + t)) − pixel). Blocks: axis (R, t), angle, offset D, point, intrinsics. Poses
// have the ambient Jacobian [∂ω ∂t 0], from which the manifolds pick.
class CircularReprojection final : public ceres::CostFunction {
 public:
  CircularReprojection(int model, const double *pixel, double weight) : model_(model), weight_(weight) {
    pixel_[0] = pixel[0];
    pixel_[1] = pixel[1];
    set_num_residuals(2);
    mutable_parameter_block_sizes()->assign({kPoseSize, 1, kPoseSize, 3, kLayouts[model].size});
  }

  bool Evaluate(double const *const *parameters, double *residuals, double **jacobians) const override {
    const Eigen::Map<const Eigen::Quaterniond> q(parameters[0]), d(parameters[2]);
    const Eigen::Matrix3d rotation = q.normalized().toRotationMatrix(), offset = d.normalized().toRotationMatrix();
    const double s = std::sin(parameters[1][0]), c = std::cos(parameters[1][0]);
    const double *p = parameters[3];
    const Eigen::Vector3d turned(c * p[0] - s * p[1], s * p[0] + c * p[1], p[2]);
    const Eigen::Vector3d rotated = rotation * turned;
    const Eigen::Vector3d y = rotated + Eigen::Map<const Eigen::Vector3d>(parameters[0] + 4);
    const Eigen::Vector3d moved = offset * y;
    const Eigen::Vector3d x = moved + Eigen::Map<const Eigen::Vector3d>(parameters[2] + 4);
    if (jacobians == nullptr) {
      Project(model_, parameters[4], x, pixel_, weight_, residuals, nullptr, nullptr);
      return true;
    }
    Jacobian2x3 by_x;
    Project(model_, parameters[4], x, pixel_, weight_, residuals, &by_x, jacobians[4]);
    const Jacobian2x3 by_y = by_x * offset, by_turned = by_y * rotation;
    if (jacobians[0] != nullptr) Pose(rotated, by_y, jacobians[0]);
    if (jacobians[1] != nullptr)
      for (int row = 0; row < 2; ++row)
        jacobians[1][row] = by_turned(row, 1) * turned.x() - by_turned(row, 0) * turned.y();
    if (jacobians[2] != nullptr) Pose(moved, by_x, jacobians[2]);
    if (jacobians[3] != nullptr) {
      Eigen::Map<Jacobian2x3> j(jacobians[3]);
      j.col(0) = c * by_turned.col(0) + s * by_turned.col(1);
      j.col(1) = c * by_turned.col(1) - s * by_turned.col(0);
      j.col(2) = by_turned.col(2);
    }
    return true;
  }

 private:
  static void Pose(const Eigen::Vector3d &rotated, const Jacobian2x3 &by_result, double *out) {
    Eigen::Map<Eigen::Matrix<double, 2, kPoseSize, Eigen::RowMajor>> j(out);
    for (int row = 0; row < 2; ++row) j.row(row).head<3>() = rotated.cross(by_result.row(row).transpose());
    j.middleCols<3>(3) = by_result;
    j.col(6).setZero();
  }

  int model_;
  double weight_, pixel_[2];
};

// R ← exp(b₀ δ₀ + b₁ δ₁) R, t ← t + b₂ δ₂ with unit vectors b: turning about the axis, moving along
// it and scaling the scene change nothing in the images, so three freedoms are left.
class AxisManifold final : public ceres::Manifold {
 public:
  explicit AxisManifold(const double *basis) : b_(basis) {}
  int AmbientSize() const override { return kPoseSize; }
  int TangentSize() const override { return 3; }
  bool Plus(const double *x, const double *delta, double *y) const override {
    const Eigen::Vector3d omega = b_.col(0) * delta[0] + b_.col(1) * delta[1];
    const double angle = omega.norm();
    const double s = angle > 1e-12 ? std::sin(angle / 2) / angle : 0.5;
    const Eigen::Quaterniond step(std::cos(angle / 2), s * omega.x(), s * omega.y(), s * omega.z());
    const Eigen::Quaterniond moved = (step * Eigen::Quaterniond(x[3], x[0], x[1], x[2])).normalized();
    y[0] = moved.x(), y[1] = moved.y(), y[2] = moved.z(), y[3] = moved.w();
    for (int i = 0; i < 3; ++i) y[4 + i] = x[4 + i] + b_(i, 2) * delta[2];
    return true;
  }
  bool PlusJacobian(const double *, double *jacobian) const override {
    Eigen::Map<Eigen::Matrix<double, kPoseSize, 3, Eigen::RowMajor>> j(jacobian);
    j.setZero();
    j.block<3, 2>(0, 0) = b_.leftCols<2>();
    j.block<3, 1>(3, 2) = b_.col(2);
    return true;
  }
  bool Minus(const double *y, const double *x, double *delta) const override {
    const Eigen::Quaterniond qy(y[3], y[0], y[1], y[2]), qx(x[3], x[0], x[1], x[2]);
    const Eigen::AngleAxisd step(qy * qx.conjugate());
    delta[0] = step.angle() * step.axis().dot(b_.col(0));
    delta[1] = step.angle() * step.axis().dot(b_.col(1));
    delta[2] = Eigen::Vector3d(y[4] - x[4], y[5] - x[5], y[6] - x[6]).dot(b_.col(2));
    return true;
  }
  bool MinusJacobian(const double *x, double *jacobian) const override {
    double plus[kPoseSize * 3];
    PlusJacobian(x, plus);
    for (int i = 0; i < 3; ++i)
      for (int k = 0; k < kPoseSize; ++k) jacobian[i * kPoseSize + k] = plus[k * 3 + i];
    return true;
  }

 private:
  const Eigen::Map<const Eigen::Matrix3d> b_;
};

// w (Σ c_k θ_k − target) over up to three angles.
class AngleRelation final : public ceres::CostFunction {
 public:
  AngleRelation(int count, const double *coefficients, double target, double weight)
      : coefficients_(coefficients), target_(target), weight_(weight) {
    set_num_residuals(1);
    mutable_parameter_block_sizes()->assign(count, 1);
  }
  bool Evaluate(double const *const *parameters, double *residuals, double **jacobians) const override {
    const int count = static_cast<int>(parameter_block_sizes().size());
    double sum = -target_;
    for (int i = 0; i < count; ++i) sum += coefficients_[i] * parameters[i][0];
    residuals[0] = weight_ * sum;
    for (int i = 0; jacobians != nullptr && i < count; ++i)
      if (jacobians[i] != nullptr) jacobians[i][0] = weight_ * coefficients_[i];
    return true;
  }

 private:
  const double *coefficients_;
  double target_, weight_;
};

// w (n · R e_z − target): the axis makes a known angle with a direction n of the camera's frame.
// d(n · z) = ω · (z × n).
class AxisLevel final : public ceres::CostFunction {
 public:
  AxisLevel(const double *normal, double target, double weight) : normal_(normal), target_(target), weight_(weight) {
    set_num_residuals(1);
    mutable_parameter_block_sizes()->assign({kPoseSize});
  }
  bool Evaluate(double const *const *parameters, double *residuals, double **jacobians) const override {
    const Eigen::Map<const Eigen::Quaterniond> q(parameters[0]);
    const Eigen::Map<const Eigen::Vector3d> normal(normal_);
    const Eigen::Vector3d z = q.normalized() * Eigen::Vector3d::UnitZ();
    residuals[0] = weight_ * (normal.dot(z) - target_);
    if (jacobians == nullptr || jacobians[0] == nullptr) return true;
    Eigen::Map<Eigen::Matrix<double, 1, kPoseSize>> j(jacobians[0]);
    j.setZero();
    j.head<3>() = weight_ * z.cross(normal).transpose();
    return true;
  }

 private:
  const double *normal_;
  double target_, weight_;
};

// Offsets are small: rotation vector over its standard deviation, translation over its own.
class OffsetPrior final : public ceres::CostFunction {
 public:
  explicit OffsetPrior(const double *sigma) : sigma_(sigma) {
    set_num_residuals(6);
    mutable_parameter_block_sizes()->assign({kPoseSize});
  }
  bool Evaluate(double const *const *parameters, double *residuals, double **jacobians) const override {
    const double *p = parameters[0], sign = p[3] < 0 ? -2.0 : 2.0;  // 2 · vector part: the rotation vector of small turns
    for (int i = 0; i < 3; ++i) {
      residuals[i] = sign * p[i] / sigma_[0];
      residuals[3 + i] = p[4 + i] / sigma_[1];
    }
    if (jacobians == nullptr || jacobians[0] == nullptr) return true;
    std::fill(jacobians[0], jacobians[0] + 6 * kPoseSize, 0.0);
    for (int i = 0; i < 3; ++i) {
      jacobians[0][i * kPoseSize + i] = 1 / sigma_[0];
      jacobians[0][(3 + i) * kPoseSize + 3 + i] = 1 / sigma_[1];
    }
    return true;
  }

 private:
  const double *sigma_;
};

int RelationSize(const CircularInput &input, std::size_t relation) {
  return input.relation_angles[3 * relation + 2] == kNone ? 2 : 3;
}

}  // namespace

BundleOutcome solve_circular(const CircularInput &input, rust::Slice<double> intrinsics, rust::Slice<double> axis,
                         rust::Slice<double> angles, rust::Slice<double> offsets, rust::Slice<double> points,
                         const Monitor &monitor) {
  FLAGS_minloglevel = 3;
  const BundleInput &bundle = input.bundle;
  // One allocation: see solve_bundle.
  std::vector<double> together(intrinsics.begin(), intrinsics.end());
  for (const rust::Slice<double> &part : {axis, angles, offsets}) together.insert(together.end(), part.begin(), part.end());
  double *const intrinsics_at = together.data();
  double *const axis_at = intrinsics_at + intrinsics.size();
  double *const angles_at = axis_at + kPoseSize;
  double *const offsets_at = angles_at + angles.size();
  const std::unique_ptr<ceres::LossFunction> loss = MakeLoss(bundle);
  ceres::Problem::Options ownership;
  ownership.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ownership.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ownership.manifold_ownership = ceres::TAKE_OWNERSHIP;
  ownership.disable_all_safety_checks = true;
  std::deque<CircularReprojection> costs;
  std::vector<std::unique_ptr<ceres::CostFunction>> priors;
  ceres::Problem problem(ownership);
  const auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  for (std::size_t i = 0; i < bundle.observation_pose.size(); ++i) {
    const std::size_t pose = bundle.observation_pose[i], point = bundle.observation_point[i];
    const std::size_t camera = bundle.pose_camera[pose];
    costs.emplace_back(bundle.camera_models[camera], bundle.pixels.data() + 2 * i, bundle.weights[i]);
    double *const blocks[5] = {axis_at, angles_at + pose, offsets_at + kPoseSize * pose, points.data() + 3 * point,
                               intrinsics_at + bundle.camera_offsets[camera]};
    problem.AddResidualBlock(&costs.back(), loss.get(), blocks, 5);
    for (int b = 0; b < 5; ++b) ordering->AddElementToGroup(blocks[b], b == 3 ? 0 : 1);
  }
  for (std::size_t r = 0; r < input.relation_weights.size(); ++r) {
    const int count = RelationSize(input, r);
    std::vector<double *> blocks;
    for (int k = 0; k < count; ++k) blocks.push_back(angles_at + input.relation_angles[3 * r + k]);
    for (double *block : blocks) ordering->AddElementToGroup(block, 1);
    priors.push_back(std::make_unique<AngleRelation>(count, input.relation_coefficients.data() + 3 * r,
                                                     input.relation_targets[r], input.relation_weights[r]));
    problem.AddResidualBlock(priors.back().get(), nullptr, blocks);
  }
  for (std::size_t l = 0; l < input.level_weights.size(); ++l) {
    priors.push_back(std::make_unique<AxisLevel>(input.level_normals.data() + 3 * l, input.level_targets[l],
                                                 input.level_weights[l]));
    problem.AddResidualBlock(priors.back().get(), nullptr, axis_at);
  }
  if (input.axis_held) {
    problem.SetParameterBlockConstant(axis_at);
  } else {
    problem.SetManifold(axis_at, new AxisManifold(input.axis_basis.data()));
  }
  for (std::size_t i = 0; i < angles.size(); ++i) {
    double *const offset = offsets_at + kPoseSize * i;
    if (input.angle_held[i] != 0 && problem.HasParameterBlock(angles_at + i))
      problem.SetParameterBlockConstant(angles_at + i);
    if (!problem.HasParameterBlock(offset)) continue;
    if (input.offset_sigma[0] > 0) {
      problem.SetManifold(offset, new PoseManifold(-1));
      priors.push_back(std::make_unique<OffsetPrior>(input.offset_sigma.data()));
      problem.AddResidualBlock(priors.back().get(), nullptr, offset);
    } else {
      problem.SetParameterBlockConstant(offset);
    }
  }
  AddCameras(bundle, intrinsics_at, priors, problem);
  ceres::Solver::Options options = MakeOptions(bundle);
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.linear_solver_ordering = ordering;
  Watch watch(monitor);
  options.callbacks.push_back(&watch);
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  std::copy(intrinsics_at, axis_at, intrinsics.begin());
  std::copy(axis_at, angles_at, axis.begin());
  std::copy(angles_at, offsets_at, angles.begin());
  std::copy(offsets_at, together.data() + together.size(), offsets.begin());
  return MakeOutcome(summary);
}

bool circular_covariance(const CircularInput &input, rust::Slice<const double> intrinsics, rust::Slice<const double> axis,
                     rust::Slice<const double> angles, rust::Slice<const double> offsets,
                     rust::Slice<const double> points, rust::Slice<double> circular_covariance,
                     rust::Slice<double> camera_covariance) {
  const BundleInput &bundle = input.bundle;
  int size = 0;
  std::vector<int> columns(3 + angles.size(), -1);
  for (int k = 0; k < 3 && !input.axis_held; ++k) columns[k] = size++;
  for (std::size_t i = 0; i < angles.size(); ++i)
    if (input.angle_held[i] == 0) columns[3 + i] = size++;
  const std::vector<std::vector<int>> of_cameras = CameraColumns(bundle, size);
  if (size == 0) return false;
  const std::unique_ptr<ceres::LossFunction> loss = MakeLoss(bundle);
  const Eigen::Map<const Eigen::Matrix3d> basis(input.axis_basis.data());
  std::vector<std::vector<std::size_t>> of_point(bundle.point_held.size());
  for (std::size_t i = 0; i < bundle.observation_point.size(); ++i) of_point[bundle.observation_point[i]].push_back(i);
  Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(size, size);
  for (std::size_t point = 0; point < of_point.size(); ++point) {
    PointRows rows;
    for (const std::size_t i : of_point[point]) {
      const std::size_t pose = bundle.observation_pose[i], camera = bundle.pose_camera[pose];
      const CircularReprojection cost(bundle.camera_models[camera], bundle.pixels.data() + 2 * i, bundle.weights[i]);
      double const *const blocks[5] = {axis.data(), angles.data() + pose, offsets.data() + kPoseSize * pose,
                                       points.data() + 3 * point, intrinsics.data() + bundle.camera_offsets[camera]};
      double residuals[2], by_axis[2 * kPoseSize], by_angle[2], by_camera[16];
      Jacobian2x3 by_point;
      double *jacobians[5] = {by_axis, by_angle, nullptr, by_point.data(), by_camera};
      cost.Evaluate(blocks, residuals, jacobians);
      Jacobian2x3 by_freedom;
      for (int row = 0; row < 2; ++row)
        for (int k = 0; k < 3; ++k)
          by_freedom(row, k) =
              Eigen::Map<const Eigen::Vector3d>(by_axis + row * kPoseSize + (k == 2 ? 3 : 0)).dot(basis.col(k));
      ObservationRows own(rows);
      for (int k = 0; k < 3; ++k) own.Add(columns[k], by_freedom.data(), 3, k);
      own.Add(columns[3 + pose], by_angle, 1, 0);
      const int parameters = kLayouts[bundle.camera_models[camera]].size;
      for (int k = 0; k < parameters; ++k) own.Add(of_cameras[camera][k], by_camera, parameters, k);
      own.Finish(loss.get(), residuals, by_point);
    }
    if (!rows.at.empty()) Eliminate(rows, bundle.point_held[point] != 0, normal);
  }
  for (std::size_t r = 0; r < input.relation_weights.size(); ++r)
    for (int i = 0; i < RelationSize(input, r); ++i)
      for (int k = 0; k < RelationSize(input, r); ++k) {
        const int a = columns[3 + input.relation_angles[3 * r + i]], b = columns[3 + input.relation_angles[3 * r + k]];
        const double w = input.relation_weights[r];
        if (a >= 0 && b >= 0)
          normal(a, b) += w * w * input.relation_coefficients[3 * r + i] * input.relation_coefficients[3 * r + k];
      }
  for (std::size_t l = 0; l < input.level_weights.size() && !input.axis_held; ++l) {
    const AxisLevel level(input.level_normals.data() + 3 * l, input.level_targets[l], input.level_weights[l]);
    double residual, by_axis[kPoseSize];
    double const *const block[1] = {axis.data()};
    double *jacobian[1] = {by_axis};
    level.Evaluate(block, &residual, jacobian);
    const Eigen::RowVector3d row = Eigen::Map<const Eigen::RowVector3d>(by_axis) * basis;
    // The third freedom moves the axis along: no direction.
    for (int a = 0; a < 2; ++a)
      for (int b = 0; b < 2; ++b) normal(columns[a], columns[b]) += row[a] * row[b];
  }
  AddIntrinsicsPriors(bundle, of_cameras, normal);
  Eigen::MatrixXd covariance;
  if (!Invert(normal, covariance)) return false;
  CopyBlock(covariance, columns, circular_covariance.data());
  CopyCameraBlocks(covariance, of_cameras, camera_covariance.data());
  return true;
}

}  // namespace sat_recon
