// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/hexahedra_optimization.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <deque>
#include <limits>
#include <map>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

// The eight corners of a cell side by side; in single precision of two cells. Single precision bears the energy of a
// cell that is not folded, because its corners are taken relative to one of them; sums over cells are in double.
template <class Real>
struct LanesOf;
template <>
struct LanesOf<double> {
  using Lanes = double __attribute__((vector_size(64)));
  using Bits = long long __attribute__((vector_size(64)));
  static constexpr int cells = 1;
  static constexpr Bits flip[3] = {{1, 0, 3, 2, 5, 4, 7, 6}, {2, 3, 0, 1, 6, 7, 4, 5}, {4, 5, 6, 7, 0, 1, 2, 3}};
  static constexpr Lanes sign[3] = {
      {1, -1, 1, -1, 1, -1, 1, -1}, {1, 1, -1, -1, 1, 1, -1, -1}, {1, 1, 1, 1, -1, -1, -1, -1}};
  // Smaller determinants count as this one: the energy stays finite.
  static constexpr double least_stand_in = 1e-30;
  static constexpr int root_steps = 4;
  static constexpr unsigned long long root_start = 0x553ef0ff289dd796ull;
  using Word = unsigned long long;
};
template <>
struct LanesOf<float> {
  using Lanes = float __attribute__((vector_size(64)));
  using Bits = int __attribute__((vector_size(64)));
  static constexpr int cells = 2;
  static constexpr Bits flip[3] = {{1, 0, 3, 2, 5, 4, 7, 6, 9, 8, 11, 10, 13, 12, 15, 14},
                                   {2, 3, 0, 1, 6, 7, 4, 5, 10, 11, 8, 9, 14, 15, 12, 13},
                                   {4, 5, 6, 7, 0, 1, 2, 3, 12, 13, 14, 15, 8, 9, 10, 11}};
  static constexpr Lanes sign[3] = {{1, -1, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1},
                                    {1, 1, -1, -1, 1, 1, -1, -1, 1, 1, -1, -1, 1, 1, -1, -1},
                                    {1, 1, 1, 1, -1, -1, -1, -1, 1, 1, 1, 1, -1, -1, -1, -1}};
  static constexpr float least_stand_in = 1e-9f;
  static constexpr int root_steps = 3;
  static constexpr std::uint32_t root_start = 0x54a2fa8eu;
  using Word = std::uint32_t;
};

using CellLanes = double __attribute__((vector_size(64)));

// A brick's points and their gradients lie four numbers apart, the fourth unused.
constexpr std::size_t stride = 4;
using Corners = std::array<std::uint16_t, 8>;

// The coordinates of eight corners side by side.
inline void gather(const double* points, const Corners* const* cells, LanesOf<double>::Lanes* out) {
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const auto at = [&](std::size_t k) { return points[stride * (*cells[0])[k] + axis]; };
    out[axis] = CellLanes{at(0), at(1), at(2), at(3), at(4), at(5), at(6), at(7)};
  }
}
inline void scatter(double* gradient, const Corners* const* cells, int, const LanesOf<double>::Lanes* values) {
  for (std::size_t k = 0; k < 8; ++k)
    for (std::size_t axis = 0; axis < 3; ++axis) gradient[stride * (*cells[0])[k] + axis] += values[axis][k];
}

using Quad = float __attribute__((vector_size(16)));
using Half = float __attribute__((vector_size(32)));
using Full = float __attribute__((vector_size(64)));
inline Half join(const Quad& a, const Quad& b) { return __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7); }
inline Full join(const Half& a, const Half& b) {
  return __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
}
inline void gather(const float* points, const Corners* const* cells, LanesOf<float>::Lanes* out) {
  Half x[2], y[2], z[2];
  for (int j = 0; j < 2; ++j) {
    const auto at = [&](std::size_t k) {
      Quad value;
      std::memcpy(&value, points + stride * (*cells[j])[k], sizeof value);
      return value;
    };
    const Full low = join(join(at(0), at(1)), join(at(2), at(3))), high = join(join(at(4), at(5)), join(at(6), at(7)));
    x[j] = __builtin_shufflevector(low, high, 0, 4, 8, 12, 16, 20, 24, 28);
    y[j] = __builtin_shufflevector(low, high, 1, 5, 9, 13, 17, 21, 25, 29);
    z[j] = __builtin_shufflevector(low, high, 2, 6, 10, 14, 18, 22, 26, 30);
  }
  out[0] = join(x[0], x[1]), out[1] = join(y[0], y[1]), out[2] = join(z[0], z[1]);
}
inline void scatter(float* gradient, const Corners* const* cells, int count, const LanesOf<float>::Lanes* values) {
  // Corners 0–3 and 4–7 of the first cell, then of the second, each as x y z and a number that does not count.
  const Full &x = values[0], &y = values[1], &z = values[2];
  Full rows[4];
  const Full a = __builtin_shufflevector(x, y, 0, 16, 0, 0, 1, 17, 0, 0, 2, 18, 0, 0, 3, 19, 0, 0);
  const Full b = __builtin_shufflevector(x, y, 4, 20, 4, 4, 5, 21, 4, 4, 6, 22, 4, 4, 7, 23, 4, 4);
  const Full c = __builtin_shufflevector(x, y, 8, 24, 8, 8, 9, 25, 8, 8, 10, 26, 8, 8, 11, 27, 8, 8);
  const Full d = __builtin_shufflevector(x, y, 12, 28, 12, 12, 13, 29, 12, 12, 14, 30, 12, 12, 15, 31, 12, 12);
  rows[0] = __builtin_shufflevector(a, z, 0, 1, 16, 3, 4, 5, 17, 7, 8, 9, 18, 11, 12, 13, 19, 15);
  rows[1] = __builtin_shufflevector(b, z, 0, 1, 20, 3, 4, 5, 21, 7, 8, 9, 22, 11, 12, 13, 23, 15);
  rows[2] = __builtin_shufflevector(c, z, 0, 1, 24, 3, 4, 5, 25, 7, 8, 9, 26, 11, 12, 13, 27, 15);
  rows[3] = __builtin_shufflevector(d, z, 0, 1, 28, 3, 4, 5, 29, 7, 8, 9, 30, 11, 12, 13, 31, 15);
  for (int j = 0; j < count; ++j)
    for (std::size_t k = 0; k < 8; ++k) {
      Quad row, value;
      std::memcpy(&row, reinterpret_cast<const char*>(&rows[2 * j + static_cast<int>(k / 4)]) + 16 * (k % 4),
                  sizeof row);
      float* place = gradient + stride * (*cells[j])[k];
      std::memcpy(&value, place, sizeof value);
      value += row;
      std::memcpy(place, &value, sizeof value);
    }
}
// The same value at all corners of each cell.
inline void spread(const double* values, LanesOf<double>::Lanes& out) { out = CellLanes{} + values[0]; }
inline void spread(const double* values, LanesOf<float>::Lanes& out) {
  const Half first = Half{} + static_cast<float>(values[0]), second = Half{} + static_cast<float>(values[1]);
  out = join(first, second);
}
inline void add_to_sum(const LanesOf<double>::Lanes& term, CellLanes& sum) { sum += term; }
inline void add_to_sum(const LanesOf<float>::Lanes& term, CellLanes& sum) {
  const Half first = __builtin_shufflevector(term, term, 0, 1, 2, 3, 4, 5, 6, 7);
  const Half second = __builtin_shufflevector(term, term, 8, 9, 10, 11, 12, 13, 14, 15);
  sum += __builtin_convertvector(first, CellLanes) + __builtin_convertvector(second, CellLanes);
}

// The energy of one cell, or of two, and its gradient: an evaluation at the corners or at places inside.
template <class Real>
class CellEnergy {
 public:
  using Traits = LanesOf<Real>;
  using Lanes = typename Traits::Lanes;
  using Bits = typename Traits::Bits;

  CellEnergy(const EnergyShares& shares, double epsilon)
      : epsilon2_(static_cast<Real>(epsilon * epsilon)),
        shape_share_(static_cast<Real>((1 - shares.volume) * (1 - shares.angle) / 3)),
        angle_share_(static_cast<Real>((1 - shares.volume) * shares.angle)),
        volume_share_(static_cast<Real>(0.5 * shares.volume)) {}

  void begin(const Real* points, const Corners* const* cells, const double* stretch) {
    spread(stretch, stretch_);
    Lanes p[3];
    gather(points, cells, p);
    for (int axis = 0; axis < 3; ++axis) {
      for (int e = 0; e < 3; ++e)
        edges_[e][axis] = (__builtin_shuffle(p[axis], Traits::flip[e]) - p[axis]) * Traits::sign[e];
      edges_[2][axis] *= stretch_;
      gradient_[axis] = Lanes{};
    }
  }

  // `place`: how far the eight places lie from the corners, or null for the corners; a `share` of zero judges nothing.
  void add(const Real* place, const double* shares) {
    Lanes weight;
    spread(shares, weight);
    Lanes e[3][3], cross[3][3], g[3][3];
    std::memcpy(e, edges_, sizeof e);
    if (place) blend(e, place);
    for (int i = 0; i < 3; ++i) {
      const Lanes *u = e[(i + 1) % 3], *v = e[(i + 2) % 3];
      for (int axis = 0; axis < 3; ++axis)
        cross[i][axis] = u[(axis + 1) % 3] * v[(axis + 2) % 3] - u[(axis + 2) % 3] * v[(axis + 1) % 3];
    }
    const Lanes det = e[0][0] * cross[0][0] + e[0][1] * cross[0][1] + e[0][2] * cross[0][2];
    lowest_ = (det < lowest_) & (weight > 0) ? det : lowest_;
    Lanes squares[3];
    for (int i = 0; i < 3; ++i) squares[i] = e[i][0] * e[i][0] + e[i][1] * e[i][1] + e[i][2] * e[i][2];
    const Lanes trace = squares[0] + squares[1] + squares[2];
    // [Garanzha2021] eq. 4: a positive stand-in for the determinant.
    const Lanes least = Lanes{} + Traits::least_stand_in;
    Lanes root, third;
    square_root(epsilon2_ + det * det, root);
    Lanes chi = det >= 0 ? Real(0.5) * (det + root) : Real(0.5) * epsilon2_ / (root - det);
    chi = chi > least ? chi : least;
    root = root > least ? root : least;
    const Lanes slope = chi / root;
    inverse_cube_root(chi, third);
    const Lanes inverse_chi = third * third * third;
    const Lanes shape = shape_share_ * third * third;
    const Lanes volume = volume_share_ * (Real(1) + det * det) * inverse_chi;
    Lanes product;
    square_root(squares[0] * squares[1] * squares[2], product);
    const Lanes angle = angle_share_ * product * inverse_chi;
    add_to_sum(weight * (shape * trace + angle + volume), sum_);
    const Lanes edge_factor = Real(2) * weight * shape;
    const Lanes det_factor = weight * inverse_chi *
                             (Real(2) * volume_share_ * det - (Real(2.0 / 3) * shape * trace + angle + volume) * slope);
    for (int i = 0; i < 3; ++i) {
      const Lanes least_square = Lanes{} + Real(1e-20);
      const Lanes factor = edge_factor + weight * angle / (squares[i] > least_square ? squares[i] : least_square);
      for (int axis = 0; axis < 3; ++axis) g[i][axis] = factor * e[i][axis] + det_factor * cross[i][axis];
    }
    if (place) blend(g, place);
    for (int axis = 0; axis < 3; ++axis) {
      g[2][axis] *= stretch_;
      for (int i = 0; i < 3; ++i) {
        const Lanes signed_gradient = g[i][axis] * Traits::sign[i];
        gradient_[axis] += __builtin_shuffle(signed_gradient, Traits::flip[i]) - signed_gradient;
      }
    }
  }

  const Lanes* gradient() const { return gradient_; }

  double sum() const {
    double total = 0;
    for (int k = 0; k < 8; ++k) total += sum_[k];
    return total;
  }
  double lowest() const {
    double least = std::numeric_limits<double>::max();
    for (int k = 0; k < 8 * Traits::cells; ++k) least = std::min(least, static_cast<double>(lowest_[k]));
    return least;
  }

 private:
  // Each corner's edges mixed with its neighbours': what they are at places inside. Its own adjoint.
  static void blend(Lanes (&e)[3][3], const Real* place) {
    for (int i = 0; i < 3; ++i)
      for (int other = 0; other < 3; ++other)
        if (other != i)
          for (int axis = 0; axis < 3; ++axis)
            e[i][axis] += place[other] * (__builtin_shuffle(e[i][axis], Traits::flip[other]) - e[i][axis]);
  }
  static void square_root(const Lanes& x, Lanes& out) {
    Real values[8 * Traits::cells];
    std::memcpy(values, &x, sizeof values);
    for (Real& value : values) value = std::sqrt(value);
    std::memcpy(&out, values, sizeof values);
  }
  // x^(−1/3) for positive x, by Newton steps.
  static void inverse_cube_root(const Lanes& x, Lanes& out) {
    typename Traits::Word bits[8 * Traits::cells];
    std::memcpy(bits, &x, sizeof bits);
    for (auto& word : bits) word = Traits::root_start - word / 3;
    std::memcpy(&out, bits, sizeof bits);
    for (int i = 0; i < Traits::root_steps; ++i) out *= (Real(4) - x * out * out * out) * Real(1.0 / 3);
  }

  const Real epsilon2_, shape_share_, angle_share_, volume_share_;
  Lanes stretch_{}, edges_[3][3], gradient_[3];
  Lanes lowest_ = Lanes{} + std::numeric_limits<Real>::max();
  CellLanes sum_{};
};

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
  // The columns of the Jacobian at 3×3 places of the other two coordinates, first at the corners, then half-way.
  Vec3 columns[3][9];
  for (int axis = 0; axis < 3; ++axis) {
    const int u = 1 << (axis + 1) % 3, v = 1 << (axis + 2) % 3, along = 1 << axis;
    Vec3* column = columns[axis];
    for (int n = 0; n < 4; ++n) {
      const int low = (n & 1 ? u : 0) | (n & 2 ? v : 0);
      column[(n & 1 ? 2 : 0) + (n & 2 ? 6 : 0)] = (points.row(cell[low | along]) - points.row(cell[low])).transpose();
    }
    column[1] = 0.5 * (column[0] + column[2]), column[7] = 0.5 * (column[6] + column[8]);
    for (int n = 0; n < 3; ++n) column[3 + n] = 0.5 * (column[n] + column[6 + n]);
  }
  double value[27];
  for (int n = 0; n < 27; ++n) {
    const int x = n % 3, y = n / 3 % 3, z = n / 9;
    value[n] = columns[0][y + 3 * z].dot(columns[1][z + 3 * x].cross(columns[2][x + 3 * y]));
  }
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
  std::map<std::array<int, 3>, Brick> bricks;
  for (std::size_t c = 0; c < cells_.size(); ++c) {
    const auto brick = [](int i) { return (i + (1 << 20) * brick_edge) / brick_edge; };
    bricks[{brick(cell_lattice[c].x()), brick(cell_lattice[c].y()), brick(cell_lattice[c].z())}].cells.push_back(
        static_cast<std::int32_t>(c));
  }
  for (auto& [place, brick] : bricks)
    colours_[(place[0] & 1) | (place[1] & 1) << 1 | (place[2] & 1) << 2].push_back(std::move(brick));
  for (std::vector<Brick>& colour : colours_)
    parallel_for(
        colour.size(),
        [&](std::size_t b) {
          Brick& brick = colour[b];
          for (std::int32_t c : brick.cells)
            brick.points.insert(brick.points.end(), cells_[c].begin(), cells_[c].end());
          std::sort(brick.points.begin(), brick.points.end());
          brick.points.erase(std::unique(brick.points.begin(), brick.points.end()), brick.points.end());
          if (brick.points.size() > std::numeric_limits<std::uint16_t>::max())
            throw InternalError("hexahedra: too many cells at one place of the lattice");
          brick.corners.resize(brick.cells.size());
          for (std::size_t n = 0; n < brick.cells.size(); ++n)
            for (std::size_t k = 0; k < 8; ++k)
              brick.corners[n][k] = static_cast<std::uint16_t>(
                  std::lower_bound(brick.points.begin(), brick.points.end(), cells_[brick.cells[n]][k]) -
                  brick.points.begin());
        },
        1);
}

template <class Real>
double HexahedraOptimization::cell_energies(const VertexMatrix& points, double epsilon, VertexMatrix& gradient,
                                            double& least) const {
  constexpr int width = LanesOf<Real>::cells;
  const Real gauss = static_cast<Real>(0.5 - std::sqrt(0.15)), half = static_cast<Real>(0.5);
  double energy = 0;
  for (const auto& bricks : colours_) {
    std::vector<double> brick_energy(bricks.size(), 0), brick_least(bricks.size(), 1e300);
    parallel_for(
        bricks.size(),
        [&](std::size_t brick) {
          const Brick& here = bricks[brick];
          const std::vector<std::int32_t>& members = here.cells;
          // A copy of the points, relative to one of them, so that single precision suffices.
          std::vector<Real> local(stride * here.points.size()), local_gradient(stride * here.points.size(), Real(0));
          const double* origin = points.data() + 3 * static_cast<std::size_t>(here.points.front());
          for (std::size_t p = 0; p < here.points.size(); ++p)
            for (std::size_t axis = 0; axis < 3; ++axis)
              local[stride * p + axis] =
                  static_cast<Real>(points.data()[3 * static_cast<std::size_t>(here.points[p]) + axis] - origin[axis]);
          CellEnergy<Real> lanes(epsilon > 0 ? folded_shares : shares, epsilon);
          for (std::size_t first = 0; first < members.size(); first += width) {
            const int count = static_cast<int>(std::min<std::size_t>(width, members.size() - first));
            const Corners* corners[width];
            double stretch[width], share[width], inside_share[width];
            bool judged = false;
            for (int j = 0; j < width; ++j) {
              const std::size_t member = first + static_cast<std::size_t>(std::min(j, count - 1));
              const std::int32_t c = members[member];
              corners[j] = &here.corners[member];
              stretch[j] = inverse_height_[c];
              share[j] = j >= count ? 0 : cell_weight.empty() ? 0.125 : 0.125 * cell_weight[c];
              inside_share[j] = !inside.empty() && inside[c] ? 0.25 * share[j] : 0;
              judged = judged || inside_share[j] > 0;
            }
            lanes.begin(local.data(), corners, stretch);
            lanes.add(nullptr, share);
            if (judged)
              for (int n = 0; n < 8; ++n) {
                const Real place[3] = {n & 1 ? half : gauss, n >> 1 & 1 ? half : gauss, n >> 2 ? half : gauss};
                lanes.add(place, inside_share);
              }
            scatter(local_gradient.data(), corners, count, lanes.gradient());
          }
          for (std::size_t p = 0; p < here.points.size(); ++p)
            for (std::size_t axis = 0; axis < 3; ++axis)
              gradient.data()[3 * static_cast<std::size_t>(here.points[p]) + axis] +=
                  static_cast<double>(local_gradient[stride * p + axis]);
          brick_energy[brick] = lanes.sum();
          brick_least[brick] = lanes.lowest();
        },
        1);
    for (double e : brick_energy) energy += e;
    for (double l : brick_least) least = std::min(least, l);
  }
  return energy;
}

double HexahedraOptimization::evaluate(const VertexMatrix& points, double epsilon, VertexMatrix& gradient,
                                       double& least) const {
  gradient.setZero(points.rows(), 3);
  least = std::numeric_limits<double>::max();
  double energy = single_precision ? cell_energies<float>(points, epsilon, gradient, least)
                                   : cell_energies<double>(points, epsilon, gradient, least);
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
  // The sum of body(begin, end) over ranges of coordinates, in an order of its own.
  const auto accumulate = [&](const auto& body) {
    constexpr std::size_t chunk = 12288;
    std::vector<double> partial((3 * count + chunk - 1) / chunk, 0);
    parallel_chunks(3 * count, chunk,
                    [&](std::size_t begin, std::size_t end) { partial[begin / chunk] = body(begin, end); });
    double total = 0;
    for (double part : partial) total += part;
    return total;
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

  // Steps and changes of the gradient; in single precision, because they must move through memory at every iteration.
  struct Pair {
    std::vector<float> step, change;
    double rho = 0, scale = 1;
  };
  // Sums of a range's terms, eight side by side: the compiler may not reorder them itself.
  const auto sum_of = [](std::size_t begin, std::size_t end, const auto& term) {
    double sums[8] = {};
    std::size_t i = begin;
    for (; i + 8 <= end; i += 8)
      for (std::size_t k = 0; k < 8; ++k) sums[k] += term(i + k);
    for (; i < end; ++i) sums[0] += term(i);
    return ((sums[0] + sums[4]) + (sums[2] + sums[6])) + ((sums[1] + sums[5]) + (sums[3] + sums[7]));
  };
  // v += factor·p, and the product of the result with q.
  const auto add_and_dot = [&](VertexMatrix& v, double factor, const std::vector<float>* p,
                               const std::vector<float>* q) {
    return accumulate([&](std::size_t begin, std::size_t end) {
      double* __restrict out = v.data();
      if (p)
        for (std::size_t i = begin; i < end; ++i) out[i] += factor * static_cast<double>((*p)[i]);
      const float* other = q ? q->data() : nullptr;
      return q ? sum_of(begin, end, [&](std::size_t i) { return out[i] * static_cast<double>(other[i]); }) : 0.0;
    });
  };
  std::deque<Pair> memory;
  VertexMatrix gradient, trial(points.rows(), 3), trial_gradient, direction(points.rows(), 3);
  double least;
  double energy = evaluate(points, epsilon, gradient, least);
  for (int iteration = 0; iteration < iterations; ++iteration) {
    parallel_chunks(3 * count, 12288, [&](std::size_t begin, std::size_t end) {
      std::copy(gradient.data() + begin, gradient.data() + end, direction.data() + begin);
    });
    std::vector<double> alpha(memory.size());
    double product = memory.empty() ? 0 : add_and_dot(direction, 0, nullptr, &memory.back().step);
    for (std::size_t m = memory.size(); m-- > 0;) {
      alpha[m] = memory[m].rho * product;
      product = add_and_dot(direction, -alpha[m], &memory[m].change, m > 0 ? &memory[m - 1].step : nullptr);
    }
    precondition(direction);
    const double scaling = memory.empty() ? 1 : memory.back().scale;
    if (!memory.empty()) {
      product = accumulate([&](std::size_t begin, std::size_t end) {
        double* __restrict out = direction.data();
        for (std::size_t i = begin; i < end; ++i) out[i] *= scaling;
        const float* change = memory.front().change.data();
        return sum_of(begin, end, [&](std::size_t i) { return out[i] * static_cast<double>(change[i]); });
      });
    }
    for (std::size_t m = 0; m < memory.size(); ++m)
      product = add_and_dot(direction, alpha[m] - memory[m].rho * product, &memory[m].step,
                            m + 1 < memory.size() ? &memory[m + 1].change : nullptr);
    const double slope = -accumulate([&](std::size_t begin, std::size_t end) {
      const double *g = gradient.data(), *d = direction.data();
      return sum_of(begin, end, [&](std::size_t i) { return g[i] * d[i]; });
    });
    if (!(slope < 0)) {
      if (memory.empty()) break;
      memory.clear();
      continue;
    }
    // No point may jump farther than half a cell.
    double longest = 1e-60;
    for (std::size_t i = 0; i < count; ++i)
      longest = std::max(longest, direction.data()[3 * i] * direction.data()[3 * i] +
                                      direction.data()[3 * i + 1] * direction.data()[3 * i + 1] +
                                      direction.data()[3 * i + 2] * direction.data()[3 * i + 2]);
    double step = std::min(1.0, 0.5 / std::sqrt(longest));
    bool accepted = false;
    double trial_energy = energy;
    for (int halving = 0; halving < 24; ++halving, step *= 0.5) {
      parallel_chunks(3 * count, 12288, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) trial.data()[i] = points.data()[i] - step * direction.data()[i];
      });
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
    Pair pair{std::vector<float>(3 * count), std::vector<float>(3 * count)};
    double change2 = 0;
    {
      constexpr std::size_t chunk = 12288;
      std::vector<double> partial((3 * count + chunk - 1) / chunk, 0);
      pair.rho = accumulate([&](std::size_t begin, std::size_t end) {
        float *step_out = pair.step.data(), *change_out = pair.change.data();
        const double *to = trial.data(), *from = points.data(), *g_to = trial_gradient.data(),
                     *g_from = gradient.data();
        for (std::size_t i = begin; i < end; ++i) step_out[i] = static_cast<float>(to[i] - from[i]);
        for (std::size_t i = begin; i < end; ++i) change_out[i] = static_cast<float>(g_to[i] - g_from[i]);
        partial[begin / chunk] = sum_of(begin, end, [&](std::size_t i) {
          const double y = static_cast<double>(change_out[i]);
          return y * y;
        });
        return sum_of(begin, end, [&](std::size_t i) {
          return static_cast<double>(step_out[i]) * static_cast<double>(change_out[i]);
        });
      });
      for (double part : partial) change2 += part;
    }
    const double decrease = energy - trial_energy;
    points.swap(trial);
    gradient.swap(trial_gradient);
    energy = trial_energy;
    if (pair.rho > 1e-14 * change2) {
      // The inverse Hessian's guess fits the last change: s·y / y·P y.
      parallel_chunks(3 * count, 12288, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) trial.data()[i] = static_cast<double>(pair.change[i]);
      });
      precondition(trial);
      pair.scale = pair.rho / add_and_dot(trial, 0, nullptr, &pair.change);
      pair.rho = 1 / pair.rho;
      memory.push_back(std::move(pair));
      if (memory.size() > 7) memory.pop_front();
    }
    if (decrease < 1e-6 * std::abs(energy)) break;
  }
  return energy;
}

}  // namespace shellgrid
