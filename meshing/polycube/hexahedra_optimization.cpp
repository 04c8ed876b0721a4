// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/hexahedra_optimization.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <deque>
#include <limits>
#include <map>

#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

// The eight corners of one cell side by side.
using Lanes = double __attribute__((vector_size(64)));
using LaneBits = long long __attribute__((vector_size(64)));

constexpr LaneBits flip_x = {1, 0, 3, 2, 5, 4, 7, 6};
constexpr LaneBits flip_y = {2, 3, 0, 1, 6, 7, 4, 5};
constexpr LaneBits flip_z = {4, 5, 6, 7, 0, 1, 2, 3};
constexpr Lanes sign_x = {1, -1, 1, -1, 1, -1, 1, -1};
constexpr Lanes sign_y = {1, 1, -1, -1, 1, 1, -1, -1};
constexpr Lanes sign_z = {1, 1, 1, 1, -1, -1, -1, -1};

struct LaneVector {
  Lanes x, y, z;
};

// One coordinate of a cell's eight corners.
inline void gather(const double* points, const LatticeHexahedron& cell, int axis, Lanes& out) {
  const auto at = [&](int k) { return points[3 * static_cast<std::size_t>(cell[k]) + static_cast<std::size_t>(axis)]; };
  out = Lanes{at(0), at(1), at(2), at(3), at(4), at(5), at(6), at(7)};
}
inline void cross(const LaneVector& a, const LaneVector& b, LaneVector& out) {
  out.x = a.y * b.z - a.z * b.y;
  out.y = a.z * b.x - a.x * b.z;
  out.z = a.x * b.y - a.y * b.x;
}

inline void edge(const Lanes& p, const LaneBits& flip, const Lanes& sign, Lanes& out) {
  out = (__builtin_shuffle(p, flip) - p) * sign;
}

// Adds to the gradient of corner positions what an edge's gradient contributes.
inline void scatter_edge(const Lanes& edge_gradient, const LaneBits& flip, const Lanes& sign, Lanes& out) {
  const Lanes signed_gradient = edge_gradient * sign;
  out += __builtin_shuffle(signed_gradient, flip) - signed_gradient;
}

// Each corner's value mixed with its neighbour's: what an edge is at a place inside. Its own adjoint.
inline void blend(LaneVector& v, const LaneBits& flip, double part) {
  v.x += part * (__builtin_shuffle(v.x, flip) - v.x);
  v.y += part * (__builtin_shuffle(v.y, flip) - v.y);
  v.z += part * (__builtin_shuffle(v.z, flip) - v.z);
}

// x^(−1/3) for positive x, by four Newton steps.
inline void inverse_cube_root(const Lanes& x, Lanes& out) {
  unsigned long long bits[8];
  std::memcpy(bits, &x, sizeof bits);
  for (unsigned long long& b : bits) b = 0x553ef0ff289dd796ull - b / 3;
  std::memcpy(&out, bits, sizeof bits);
  for (int i = 0; i < 4; ++i) out *= (4.0 - x * out * out * out) * (1.0 / 3);
}

constexpr int brick_edge = 6;

// The corner edges of a trilinear map's Jacobian at local coordinates (u, v, w).
Mat3 jacobian_at(const VertexMatrix& points, const LatticeHexahedron& cell, double u, double v, double w) {
  Mat3 jacobian = Mat3::Zero();
  for (int k = 0; k < 8; ++k) {
    const double a = k & 1 ? u : 1 - u, b = k >> 1 & 1 ? v : 1 - v, c = k >> 2 ? w : 1 - w;
    const Vec3 p = points.row(cell[k]).transpose();
    jacobian.col(0) += (k & 1 ? 1 : -1) * b * c * p;
    jacobian.col(1) += (k >> 1 & 1 ? 1 : -1) * a * c * p;
    jacobian.col(2) += (k >> 2 ? 1 : -1) * a * b * p;
  }
  return jacobian;
}

constexpr double two_point_gauss[2] = {0.21132486540518713, 0.7886751345948129};

// A lower bound of the determinant all over the cell: it is a polynomial of degree two in each coordinate, never below
// its least Bernstein coefficient.
double least_bernstein_coefficient(const VertexMatrix& points, const LatticeHexahedron& cell) {
  double value[27];
  for (int n = 0; n < 27; ++n)
    value[n] = jacobian_at(points, cell, 0.5 * (n % 3), 0.5 * (n / 3 % 3), 0.5 * (n / 9)).determinant();
  for (int stride : {1, 3, 9})
    for (int n = 0; n < 27; ++n)
      if (n / stride % 3 == 1) value[n] = 2 * value[n] - 0.5 * (value[n - stride] + value[n + stride]);
  return *std::min_element(value, value + 27);
}

Mat3 corner_jacobian(const VertexMatrix& points, const LatticeHexahedron& cell, int k) {
  Mat3 jacobian;
  for (int axis = 0; axis < 3; ++axis)
    jacobian.col(axis) = (points.row(cell[k | 1 << axis]) - points.row(cell[k & ~(1 << axis)])).transpose();
  return jacobian;
}

}  // namespace

std::array<double, 8> corner_jacobians(const VertexMatrix& points, const LatticeHexahedron& cell) {
  std::array<double, 8> result;
  for (int k = 0; k < 8; ++k) result[k] = corner_jacobian(points, cell, k).determinant();
  return result;
}

double least_jacobian(const VertexMatrix& points, const LatticeHexahedron& cell) {
  double least = std::numeric_limits<double>::max();
  for (double determinant : corner_jacobians(points, cell)) least = std::min(least, determinant);
  const double gauss[3] = {0.5 - std::sqrt(0.15), 0.5, 0.5 + std::sqrt(0.15)};
  for (double u : gauss)
    for (double v : gauss)
      for (double w : gauss) least = std::min(least, jacobian_at(points, cell, u, v, w).determinant());
  for (double u : two_point_gauss)
    for (double v : two_point_gauss)
      for (double w : two_point_gauss) least = std::min(least, jacobian_at(points, cell, u, v, w).determinant());
  return least;
}

double least_jacobian(const VertexMatrix& points, const LatticeHexahedron& cell, double enough) {
  // Edges differ from their mean by at most δ, and |det(A + E) − det A| ≤ Π(|aᵢ| + δᵢ) − Π|aᵢ| by multilinearity.
  Mat3 mean = Mat3::Zero();
  Vec3 edges[3][4];
  for (int axis = 0; axis < 3; ++axis)
    for (int k = 0, n = 0; k < 8; ++k) {
      if (k >> axis & 1) continue;
      edges[axis][n] = (points.row(cell[k | 1 << axis]) - points.row(cell[k])).transpose();
      mean.col(axis) += 0.25 * edges[axis][n++];
    }
  double lengths = 1, longest = 1;
  for (int axis = 0; axis < 3; ++axis) {
    double spread = 0;
    for (const Vec3& e : edges[axis]) spread = std::max(spread, (e - mean.col(axis)).squaredNorm());
    const double length = mean.col(axis).norm();
    lengths *= length, longest *= length + std::sqrt(spread);
  }
  const double bound = mean.determinant() - (longest - lengths);
  if (bound > enough) return bound;
  const double everywhere = least_bernstein_coefficient(points, cell);
  return everywhere > enough ? everywhere : least_jacobian(points, cell);
}

double scaled_jacobian(const VertexMatrix& points, const LatticeHexahedron& cell) {
  double least = 1;
  for (int k = 0; k < 8; ++k) {
    const Mat3 jacobian = corner_jacobian(points, cell, k);
    const double lengths = jacobian.col(0).norm() * jacobian.col(1).norm() * jacobian.col(2).norm();
    least = std::min(least, lengths > 0 ? jacobian.determinant() / lengths : -1.0);
  }
  return least;
}

HexahedraOptimization::HexahedraOptimization(std::vector<LatticeHexahedron> cells,
                                             const std::vector<Vec3i>& cell_lattice, std::vector<double> cell_height)
    : cells_(std::move(cells)), inverse_height_(std::move(cell_height)), colours_(8) {
  for (double& height : inverse_height_) height = 1 / height;
  std::map<std::array<int, 3>, std::vector<std::int32_t>> bricks;
  for (std::size_t c = 0; c < cells_.size(); ++c) {
    const auto brick = [](int i) { return (i + (1 << 20) * brick_edge) / brick_edge; };
    bricks[{brick(cell_lattice[c].x()), brick(cell_lattice[c].y()), brick(cell_lattice[c].z())}].push_back(
        static_cast<std::int32_t>(c));
  }
  for (auto& [place, members] : bricks)
    colours_[(place[0] & 1) | (place[1] & 1) << 1 | (place[2] & 1) << 2].push_back(std::move(members));
}

double HexahedraOptimization::evaluate(const VertexMatrix& points, double epsilon, VertexMatrix& gradient,
                                       double& least) const {
  gradient.setZero(points.rows(), 3);
  double energy = 0;
  least = std::numeric_limits<double>::max();
  const double epsilon2 = epsilon * epsilon;
  for (const auto& bricks : colours_) {
    std::vector<double> brick_energy(bricks.size(), 0), brick_least(bricks.size(), 1e300);
    parallel_for(
        bricks.size(),
        [&](std::size_t brick) {
          Lanes sum = {};
          double lowest = std::numeric_limits<double>::max();
          for (std::int32_t c : bricks[brick]) {
            const LatticeHexahedron& cell = cells_[c];
            LaneVector p;
            gather(points.data(), cell, 0, p.x), gather(points.data(), cell, 1, p.y),
                gather(points.data(), cell, 2, p.z);
            const double stretch = inverse_height_[c];
            LaneVector corner_a, corner_b, corner_d, g = {};
            edge(p.x, flip_x, sign_x, corner_a.x), edge(p.y, flip_x, sign_x, corner_a.y),
                edge(p.z, flip_x, sign_x, corner_a.z);
            edge(p.x, flip_y, sign_y, corner_b.x), edge(p.y, flip_y, sign_y, corner_b.y),
                edge(p.z, flip_y, sign_y, corner_b.z);
            edge(p.x, flip_z, sign_z, corner_d.x), edge(p.y, flip_z, sign_z, corner_d.y),
                edge(p.z, flip_z, sign_z, corner_d.z);
            corner_d.x *= stretch, corner_d.y *= stretch, corner_d.z *= stretch;
            // At the corners, or at eight points inside, `place` being how far they lie from the corners.
            const auto add = [&](const double* place, double share) {
              LaneVector a = corner_a, b = corner_b, d = corner_d, bd, da, ab;
              if (place) {
                blend(a, flip_y, place[1]), blend(a, flip_z, place[2]);
                blend(b, flip_x, place[0]), blend(b, flip_z, place[2]);
                blend(d, flip_x, place[0]), blend(d, flip_y, place[1]);
              }
              cross(b, d, bd), cross(d, a, da), cross(a, b, ab);
              const Lanes det = a.x * bd.x + a.y * bd.y + a.z * bd.z;
              for (int k = 0; k < 8; ++k) lowest = std::min(lowest, det[k]);
              const Lanes trace = a.x * a.x + a.y * a.y + a.z * a.z + b.x * b.x + b.y * b.y + b.z * b.z + d.x * d.x +
                                  d.y * d.y + d.z * d.z;
              // [Garanzha2021] eq. 4: a positive stand-in for the determinant.
              Lanes root, chi;
              for (int k = 0; k < 8; ++k) root[k] = std::sqrt(epsilon2 + det[k] * det[k]);
              for (int k = 0; k < 8; ++k)
                chi[k] = det[k] >= 0 ? 0.5 * (det[k] + root[k]) : 0.5 * epsilon2 / (root[k] - det[k]);
              for (int k = 0; k < 8; ++k) chi[k] = std::max(chi[k], 1e-30);
              const Lanes slope = chi / (root + 1e-300);
              Lanes third;
              inverse_cube_root(chi, third);
              const Lanes inverse_chi = third * third * third;
              const Lanes shape = ((1 - theta) / 3) * third * third;
              const Lanes volume = theta * (1.0 + det * det) * 0.5 * inverse_chi;
              const double weight = share * (cell_weight.empty() ? 1.0 : cell_weight[c]) / 8;
              sum += weight * (shape * trace + volume);
              const Lanes edge_factor = (2 * weight) * shape;
              const Lanes det_factor = weight * (-(2.0 / 3) * shape * trace * inverse_chi * slope +
                                                 theta * det * inverse_chi - volume * inverse_chi * slope);
              LaneVector ga, gb, gd;
              ga.x = edge_factor * a.x + det_factor * bd.x, ga.y = edge_factor * a.y + det_factor * bd.y;
              ga.z = edge_factor * a.z + det_factor * bd.z;
              gb.x = edge_factor * b.x + det_factor * da.x, gb.y = edge_factor * b.y + det_factor * da.y;
              gb.z = edge_factor * b.z + det_factor * da.z;
              gd.x = (edge_factor * d.x + det_factor * ab.x) * stretch;
              gd.y = (edge_factor * d.y + det_factor * ab.y) * stretch;
              gd.z = (edge_factor * d.z + det_factor * ab.z) * stretch;
              if (place) {
                blend(ga, flip_y, place[1]), blend(ga, flip_z, place[2]);
                blend(gb, flip_x, place[0]), blend(gb, flip_z, place[2]);
                blend(gd, flip_x, place[0]), blend(gd, flip_y, place[1]);
              }
              scatter_edge(ga.x, flip_x, sign_x, g.x), scatter_edge(ga.y, flip_x, sign_x, g.y);
              scatter_edge(ga.z, flip_x, sign_x, g.z), scatter_edge(gb.x, flip_y, sign_y, g.x);
              scatter_edge(gb.y, flip_y, sign_y, g.y), scatter_edge(gb.z, flip_y, sign_y, g.z);
              scatter_edge(gd.x, flip_z, sign_z, g.x), scatter_edge(gd.y, flip_z, sign_z, g.y);
              scatter_edge(gd.z, flip_z, sign_z, g.z);
            };
            add(nullptr, 1);
            if (!inside.empty() && inside[c])
              for (int n = 0; n < 8; ++n) {
                const double gauss = 0.5 - std::sqrt(0.15);
                const double place[3] = {n & 1 ? 0.5 : gauss, n >> 1 & 1 ? 0.5 : gauss, n >> 2 ? 0.5 : gauss};
                add(place, 0.25);
              }
            for (int k = 0; k < 8; ++k) {
              double* row = gradient.data() + 3 * static_cast<std::size_t>(cell[k]);
              row[0] += g.x[k], row[1] += g.y[k], row[2] += g.z[k];
            }
          }
          double total = 0;
          for (int k = 0; k < 8; ++k) total += sum[k];
          brick_energy[brick] = total;
          brick_least[brick] = lowest;
        },
        1);
    for (double e : brick_energy) energy += e;
    for (double l : brick_least) least = std::min(least, l);
  }
  for (const PlaneAttraction& pull : plane_attractions) {
    const Vec3 r = points.row(pull.point).transpose() - pull.target;
    const double along = r.dot(pull.normal);
    energy += pull.weight * (along * along + pull.tangential * r.squaredNorm());
    gradient.row(pull.point) += (2 * pull.weight * (along * pull.normal + pull.tangential * r)).transpose();
  }
  for (const QuadAttraction& pull : quad_attractions) {
    Vec3 r = -pull.target;
    for (int k = 0; k < 4; ++k) r += pull.beta[k] * points.row(pull.corners[k]).transpose();
    energy += 0.5 * pull.weight * r.squaredNorm();
    for (int k = 0; k < 4; ++k) gradient.row(pull.corners[k]) += (pull.weight * pull.beta[k] * r).transpose();
  }
  if (!locked.empty())
    for (Eigen::Index i = 0; i < points.rows(); ++i)
      if (locked[i]) gradient.row(i).setZero();
  if (epsilon == 0 && !(least > 0)) energy = std::numeric_limits<double>::infinity();
  return energy;
}

double HexahedraOptimization::least_corner_jacobian(const VertexMatrix& points) const {
  std::vector<double> least((cells_.size() + 4095) / 4096, std::numeric_limits<double>::max());
  parallel_chunks(cells_.size(), 4096, [&](std::size_t begin, std::size_t end) {
    for (std::size_t c = begin; c < end; ++c) {
      for (double determinant : corner_jacobians(points, cells_[c]))
        least[begin / 4096] = std::min(least[begin / 4096], determinant * inverse_height_[c]);
      if (!inside.empty() && inside[c])
        least[begin / 4096] = std::min(least[begin / 4096], least_jacobian(points, cells_[c]) * inverse_height_[c]);
    }
  });
  double result = std::numeric_limits<double>::max();
  for (double l : least) result = std::min(result, l);
  return result;
}

double HexahedraOptimization::minimize(VertexMatrix& points, int iterations, double epsilon) const {
  const std::size_t count = static_cast<std::size_t>(points.rows());
  const auto dot = [&](const VertexMatrix& a, const VertexMatrix& b) {
    return parallel_sum(
        3 * count, 0.0, [&](std::size_t i) { return a.data()[i] * b.data()[i]; }, 16384);
  };
  const auto add_scaled = [&](VertexMatrix& a, double factor, const VertexMatrix& b) {
    parallel_chunks(3 * count, 16384, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) a.data()[i] += factor * b.data()[i];
    });
  };
  // Per point (stiffness·I + curvature of the attractions)⁻¹. Of a thin layer's points, inner ones move with their
  // outer ones; the unknown beside is the link in units of its length.
  constexpr double stiffness = 4;
  const auto is_locked = [&](std::size_t i) { return !locked.empty() && locked[i]; };
  struct Link {
    std::size_t inner, outer;
  };
  std::vector<Link> links;
  std::vector<double> scale(count, 1);
  for (std::size_t i = 0; i < twin.size(); ++i) {
    if (twin[i] < 0) continue;
    const std::size_t inner = static_cast<std::size_t>(twin[i]);
    if (!is_locked(i) && !is_locked(inner)) links.push_back({inner, i});
    if (!is_locked(i)) scale[i] = link_length;
    if (is_locked(i)) scale[inner] = link_length;
  }
  std::vector<Mat3> inverse_blocks(count, Mat3::Zero());
  for (const PlaneAttraction& pull : plane_attractions)
    inverse_blocks[pull.point] +=
        2 * pull.weight * (pull.normal * pull.normal.transpose() + pull.tangential * Mat3::Identity());
  for (const QuadAttraction& pull : quad_attractions)
    for (int k = 0; k < 4; ++k)
      inverse_blocks[pull.corners[k]].diagonal().array() += pull.weight * std::abs(pull.beta[k]);
  for (const Link& link : links) inverse_blocks[link.inner] += inverse_blocks[link.outer];
  parallel_for(count, [&](std::size_t i) {
    const double s2 = scale[i] * scale[i];
    inverse_blocks[i] = Mat3((s2 * inverse_blocks[i] + stiffness * Mat3::Identity()).inverse() * s2);
  });
  const auto precondition = [&](VertexMatrix& v) {
    parallel_for(
        links.size(), [&](std::size_t i) { v.row(links[i].inner) += v.row(links[i].outer); }, 2048);
    parallel_for(
        count, [&](std::size_t i) { v.row(i) = (inverse_blocks[i] * v.row(i).transpose()).eval().transpose(); }, 2048);
    parallel_for(
        links.size(), [&](std::size_t i) { v.row(links[i].outer) += v.row(links[i].inner); }, 2048);
  };

  struct Pair {
    VertexMatrix step, change;
    double rho;
  };
  std::deque<Pair> memory;
  VertexMatrix gradient, trial, trial_gradient, direction;
  double least;
  double energy = evaluate(points, epsilon, gradient, least);
  for (int iteration = 0; iteration < iterations; ++iteration) {
    direction = gradient;
    std::vector<double> alpha(memory.size());
    for (std::size_t m = memory.size(); m-- > 0;) {
      alpha[m] = memory[m].rho * dot(memory[m].step, direction);
      add_scaled(direction, -alpha[m], memory[m].change);
    }
    precondition(direction);
    if (!memory.empty()) {
      VertexMatrix scaled = memory.back().change;
      precondition(scaled);
      direction *= 1 / (memory.back().rho * dot(memory.back().change, scaled));
    }
    for (std::size_t m = 0; m < memory.size(); ++m)
      add_scaled(direction, alpha[m] - memory[m].rho * dot(memory[m].change, direction), memory[m].step);
    const double slope = -dot(gradient, direction);
    if (!(slope < 0)) {
      if (memory.empty()) break;
      memory.clear();
      continue;
    }
    // No point may jump farther than half a cell.
    double step = std::min(1.0, 0.5 / std::max(1e-30, direction.rowwise().norm().maxCoeff()));
    bool accepted = false;
    double trial_energy = energy;
    for (int halving = 0; halving < 24; ++halving, step *= 0.5) {
      trial = points;
      add_scaled(trial, -step, direction);
      trial_energy = evaluate(trial, epsilon, trial_gradient, least);
      if (trial_energy <= energy + 1e-4 * step * slope) {
        accepted = true;
        break;
      }
    }
    if (!accepted) {
      if (memory.empty()) break;
      memory.clear();
      continue;
    }
    Pair pair{trial - points, trial_gradient - gradient, 0};
    const double curvature = dot(pair.step, pair.change);
    const double decrease = energy - trial_energy;
    points.swap(trial);
    gradient.swap(trial_gradient);
    energy = trial_energy;
    if (curvature > 1e-14 * dot(pair.change, pair.change)) {
      pair.rho = 1 / curvature;
      memory.push_back(std::move(pair));
      if (memory.size() > 7) memory.pop_front();
    }
    if (decrease < 1e-6 * std::abs(energy)) break;
  }
  return energy;
}

}  // namespace shellgrid
