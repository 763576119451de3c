// Normal equations of many poses in levels, and the part of their inverse that variances need.
#pragma once

#include <Eigen/Cholesky>
#include <algorithm>
#include <cstdint>
#include <utility>
#include <vector>

#include "blocks.h"

namespace sat_recon {

// A symmetric matrix whose columns lie in levels: a column has entries in common with those of its
// own level, of the levels beside it and of the border only; the border's may have entries with
// all. What the inverse costs grows with the number of levels times the cube of their size; nothing
// is approximated.
class LevelMatrix {
 public:
  static constexpr int kBorder = -1;

  explicit LevelMatrix(std::vector<int> level_of_column) : level_(std::move(level_of_column)) {
    const int levels = level_.empty() ? 0 : std::max(0, *std::max_element(level_.begin(), level_.end()) + 1);
    std::vector<int> size(levels, 0);
    int border = 0;
    for (const int level : level_) offset_.push_back(level == kBorder ? border++ : size[level]++);
    corner_ = Eigen::MatrixXd::Zero(border, border);
    for (int l = 0; l < levels; ++l) {
      diagonal_.emplace_back(Eigen::MatrixXd::Zero(size[l], size[l]));
      border_.emplace_back(Eigen::MatrixXd::Zero(border, size[l]));
      if (l + 1 < levels) below_.emplace_back(Eigen::MatrixXd::Zero(size[l + 1], size[l]));
    }
  }

  // The entry at (a, b). Of those that lie in two levels one is kept, for (a, b) and (b, a); the
  // other is a spare place.
  double &operator()(int a, int b) {
    const int of_a = level_[a], of_b = level_[b];
    if (of_a == of_b) return of_a == kBorder ? corner_(offset_[a], offset_[b]) : diagonal_[of_a](offset_[a], offset_[b]);
    if (of_a == kBorder) return border_[of_b](offset_[a], offset_[b]);
    if (of_b != kBorder && of_a == of_b + 1) return below_[of_b](offset_[a], offset_[b]);
    return spare_;
  }
  // After Invert, within one level or within the border.
  double operator()(int a, int b) const {
    const int level = level_[a];
    return level == kBorder ? corner_(offset_[a], offset_[b]) : diagonal_[level](offset_[a], offset_[b]);
  }

  // Puts the inverse's entries within each level and within the border in the place of the
  // matrix's; false where there is no inverse. Block Cholesky down the levels, then the inverse up
  // again (Takahashi, Fagan & Chen 1973).
  bool Invert() {
    const std::vector<Eigen::VectorXd> scale = Scale();
    const int levels = static_cast<int>(diagonal_.size());
    for (int l = 0; l < levels; ++l)
      if (!Eliminate(l)) return false;
    if (corner_.rows() > 0) {
      const Eigen::LLT<Eigen::MatrixXd> factor(corner_);
      if (factor.info() != Eigen::Success) return false;
      corner_ = factor.solve(Eigen::MatrixXd::Identity(corner_.rows(), corner_.cols())).eval();
    }
    Eigen::MatrixXd with_border;  // the inverse's entries of the border with the level above, [border × level]
    for (int l = levels - 1; l >= 0; --l) InvertLevel(l, with_border);
    for (int l = 0; l < levels; ++l) {
      diagonal_[l] = scale[l].asDiagonal() * diagonal_[l] * scale[l].asDiagonal();
      if (!diagonal_[l].allFinite()) return false;
    }
    corner_ = scale[levels].asDiagonal() * corner_ * scale[levels].asDiagonal();
    return corner_.allFinite();
  }

 private:
  // Gives all columns a unit diagonal; the factors of the levels, then of the border.
  std::vector<Eigen::VectorXd> Scale() {
    const auto of = [](const Eigen::MatrixXd &block) -> Eigen::VectorXd {
      return block.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
    };
    std::vector<Eigen::VectorXd> scale;
    for (const Eigen::MatrixXd &block : diagonal_) scale.push_back(of(block));
    scale.push_back(of(corner_));
    for (std::size_t l = 0; l < diagonal_.size(); ++l) {
      diagonal_[l] = scale[l].asDiagonal() * diagonal_[l] * scale[l].asDiagonal();
      border_[l] = scale.back().asDiagonal() * border_[l] * scale[l].asDiagonal();
      if (l < below_.size()) below_[l] = scale[l + 1].asDiagonal() * below_[l] * scale[l].asDiagonal();
    }
    corner_ = scale.back().asDiagonal() * corner_ * scale.back().asDiagonal();
    return scale;
  }

  // D = L Lᵀ in the place of D; what lies below becomes (·) L⁻ᵀ and is taken from the rest.
  bool Eliminate(int l) {
    const Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>> factor(diagonal_[l]);
    if (factor.info() != Eigen::Success) return false;
    const auto upper = diagonal_[l].transpose().triangularView<Eigen::Upper>();
    const bool bordered = corner_.rows() > 0, last = l == static_cast<int>(below_.size());
    if (bordered) {
      upper.solveInPlace<Eigen::OnTheRight>(border_[l]);
      corner_.noalias() -= border_[l] * border_[l].transpose();
    }
    if (last) return true;
    upper.solveInPlace<Eigen::OnTheRight>(below_[l]);
    diagonal_[l + 1].selfadjointView<Eigen::Lower>().rankUpdate(below_[l], -1.0);
    if (bordered) border_[l + 1].noalias() -= border_[l] * below_[l].transpose();
    return true;
  }

  // With Y = (what lies below) L⁻¹ and Z the inverse below: (L Lᵀ)⁻¹ + Yᵀ Z Y. `with_border`: Z's
  // entries of the border with the level above on entry, with this level on return.
  void InvertLevel(int l, Eigen::MatrixXd &with_border) {
    const auto lower = diagonal_[l].triangularView<Eigen::Lower>();
    const int size = static_cast<int>(diagonal_[l].rows());
    Eigen::MatrixXd inverse = Eigen::MatrixXd::Identity(size, size);
    lower.solveInPlace(inverse);
    diagonal_[l].transpose().triangularView<Eigen::Upper>().solveInPlace(inverse);
    const bool bordered = corner_.rows() > 0, last = l == static_cast<int>(below_.size());
    Eigen::MatrixXd of_border(corner_.rows(), size);
    if (bordered) {
      lower.solveInPlace<Eigen::OnTheRight>(border_[l]);
      of_border.noalias() = corner_ * border_[l];
    }
    if (!last) {
      lower.solveInPlace<Eigen::OnTheRight>(below_[l]);
      Eigen::MatrixXd of_next = diagonal_[l + 1] * below_[l];
      if (bordered) {
        of_next.noalias() += with_border.transpose() * border_[l];
        of_border.noalias() += with_border * below_[l];
      }
      inverse.noalias() += below_[l].transpose() * of_next;
    }
    if (bordered) inverse.noalias() += border_[l].transpose() * of_border;
    diagonal_[l] = inverse;
    with_border = -of_border;
  }

  std::vector<int> level_, offset_;
  std::vector<Eigen::MatrixXd> diagonal_;  // of each level
  std::vector<Eigen::MatrixXd> below_;     // [level + 1 × level]
  std::vector<Eigen::MatrixXd> border_;    // [border × level]
  Eigen::MatrixXd corner_;
  double spare_ = 0;
};

// Poses by how many common points they are away from one at the rim, each piece of the scene after
// the other; −1 where a pose is constant. Poses that share a point are at most one level apart.
inline std::vector<int> PoseLevels(const BundleInput &input) {
  const std::size_t poses = input.pose_held.size();
  std::vector<std::vector<std::uint32_t>> of_pose(poses), of_point(input.point_held.size());
  for (std::size_t i = 0; i < input.observation_pose.size(); ++i) {
    if (input.pose_held[input.observation_pose[i]] == 7) continue;
    of_pose[input.observation_pose[i]].push_back(input.observation_point[i]);
    of_point[input.observation_point[i]].push_back(input.observation_pose[i]);
  }
  std::vector<int> level(poses, -1);
  // Numbers what can be reached from `root`; the poses in the order in which they were.
  const auto search = [&](std::uint32_t root, int first) {
    std::vector<bool> seen(of_point.size(), false);
    std::vector<std::uint32_t> order{root};
    level[root] = first;
    for (std::size_t i = 0; i < order.size(); ++i)
      for (const std::uint32_t point : of_pose[order[i]]) {
        if (seen[point]) continue;
        seen[point] = true;
        for (const std::uint32_t pose : of_point[point])
          if (level[pose] < 0) {
            level[pose] = level[order[i]] + 1;
            order.push_back(pose);
          }
      }
    return order;
  };
  int next = 0;
  for (std::size_t root = 0; root < poses; ++root) {
    if (input.pose_held[root] == 7 || level[root] >= 0) continue;
    const std::vector<std::uint32_t> reached = search(static_cast<std::uint32_t>(root), 0);
    for (const std::uint32_t pose : reached) level[pose] = -1;
    next = level[search(reached.back(), next).back()] + 1;
  }
  return level;
}

}  // namespace sat_recon
