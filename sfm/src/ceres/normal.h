// Normal equations with the points eliminated, and the covariance they give.
#pragma once

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <vector>

#include "blocks.h"

namespace sat_recon {

template <class Matrix>
void CopyBlock(const Matrix &covariance, const std::vector<int> &columns, double *out) {
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
  std::vector<Eigen::Vector2d> residual;
};

// `gradient` (may be null): Jᵀr with the point eliminated is added to it.
template <class Matrix>
void Eliminate(const PointRows &rows, bool point_held, Matrix &normal, Eigen::VectorXd *gradient = nullptr) {
  const int n = static_cast<int>(rows.columns.size());
  Eigen::MatrixXd block = Eigen::MatrixXd::Zero(n, n), cross = Eigen::MatrixXd::Zero(n, 3);
  Eigen::Matrix3d own = Eigen::Matrix3d::Zero();
  Eigen::VectorXd slope = Eigen::VectorXd::Zero(n);
  Eigen::Vector3d own_slope = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < rows.at.size(); ++i) {
    const std::vector<int> &at = rows.at[i];
    const Eigen::MatrixXd square = rows.by_camera[i].transpose() * rows.by_camera[i];
    const Eigen::MatrixXd mixed = rows.by_camera[i].transpose() * rows.by_point[i];
    own += rows.by_point[i].transpose() * rows.by_point[i];
    own_slope += rows.by_point[i].transpose() * rows.residual[i];
    const Eigen::VectorXd by_camera = rows.by_camera[i].transpose() * rows.residual[i];
    for (std::size_t a = 0; a < at.size(); ++a) {
      slope(at[a]) += by_camera(a);
      cross.row(at[a]) += mixed.row(a);
      for (std::size_t b = 0; b < at.size(); ++b) block(at[a], at[b]) += square(a, b);
    }
  }
  if (!point_held) {
    const Eigen::LDLT<Eigen::Matrix3d> factor(own);
    if (factor.info() != Eigen::Success || factor.vectorD().minCoeff() <= 0) return;  // no depth: says nothing
    block -= cross * factor.solve(cross.transpose());
    slope -= cross * factor.solve(own_slope);
  }
  if (gradient != nullptr)
    for (int a = 0; a < n; ++a) (*gradient)(rows.columns[a]) += slope(a);
  for (int a = 0; a < n; ++a)
    for (int b = 0; b < n; ++b) normal(rows.columns[a], rows.columns[b]) += block(a, b);
}

inline int Place(std::vector<int> &columns, int column) {
  const auto found = std::find(columns.begin(), columns.end(), column);
  if (found != columns.end()) return static_cast<int>(found - columns.begin());
  columns.push_back(column);
  return static_cast<int>(columns.size()) - 1;
}

// Collects the free columns of one observation's Jacobian.
class ObservationRows {
 public:
  explicit ObservationRows(PointRows &rows) : rows_(rows) {}
  // Column `k` of a row-major 2 × `stride` Jacobian belongs to column `column` of the system (−1:
  // constant).
  void Add(int column, const double *jacobian, int stride, int k) {
    if (column < 0) return;
    at_.push_back(Place(rows_.columns, column));
    kept_.emplace_back(jacobian[k], jacobian[stride + k]);
  }
  // Weighs all by the loss's slope at these residuals and hands them over.
  void Finish(const ceres::LossFunction *loss, const double *residuals, const Jacobian2x3 &by_point) {
    double weight = 1;
    if (loss != nullptr) {
      double rho[3];
      loss->Evaluate(residuals[0] * residuals[0] + residuals[1] * residuals[1], rho);
      weight = std::sqrt(rho[1]);
    }
    Eigen::MatrixXd dense(2, static_cast<int>(kept_.size()));
    for (std::size_t k = 0; k < kept_.size(); ++k) dense.col(static_cast<int>(k)) = weight * kept_[k];
    rows_.at.push_back(at_);
    rows_.by_camera.push_back(dense);
    rows_.by_point.push_back(weight * by_point);
    rows_.residual.emplace_back(weight * residuals[0], weight * residuals[1]);
  }

 private:
  PointRows &rows_;
  std::vector<int> at_;
  std::vector<Eigen::Vector2d> kept_;
};

// Columns of the intrinsics that are solved for, counted on from `size`.
inline std::vector<std::vector<int>> CameraColumns(const BundleInput &input, int &size) {
  std::vector<std::vector<int>> columns;
  for (std::size_t c = 0; c < input.camera_models.size(); ++c) {
    std::vector<int> column(kLayouts[input.camera_models[c]].size, -1);
    for (std::size_t i = 0; i < column.size(); ++i)
      if (Free(input, c, static_cast<int>(i))) column[i] = size++;
    columns.push_back(column);
  }
  return columns;
}

template <class Matrix>
void AddIntrinsicsPriors(const BundleInput &input, const std::vector<std::vector<int>> &columns, Matrix &normal) {
  for (std::size_t c = 0; c < columns.size(); ++c)
    for (std::size_t i = 0; i < columns[c].size(); ++i) {
      const double sigma = input.prior_sigma[input.camera_offsets[c] + i];
      const int column = columns[c][i];
      if (sigma > 0 && column >= 0) normal(column, column) += 1 / (sigma * sigma);
    }
}

// The inverse; false where there is none.
inline bool Invert(const Eigen::MatrixXd &normal, Eigen::MatrixXd &covariance) {
  const Eigen::VectorXd scale = normal.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  const Eigen::MatrixXd scaled = scale.asDiagonal() * normal * scale.asDiagonal();
  const Eigen::LLT<Eigen::MatrixXd> factor(scaled);
  if (factor.info() != Eigen::Success) return false;
  covariance = factor.solve(Eigen::MatrixXd::Identity(normal.rows(), normal.cols()));
  covariance = scale.asDiagonal() * covariance * scale.asDiagonal();
  return covariance.allFinite();
}

template <class Matrix>
void CopyCameraBlocks(const Matrix &covariance, const std::vector<std::vector<int>> &columns, double *out) {
  for (const std::vector<int> &camera : columns) {
    CopyBlock(covariance, camera, out);
    out += camera.size() * camera.size();
  }
}

}  // namespace sat_recon
