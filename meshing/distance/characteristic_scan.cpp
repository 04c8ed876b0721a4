// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/distance/characteristic_scan.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

constexpr double widening = 1e-7;  // of every region, in grid intervals

// The axes across and along the slices; v is the one whose neighbours are nearest in memory.
constexpr int axis_u[3] = {1, 0, 0}, axis_v[3] = {2, 2, 1};

// Nearest point of the segment from a to b.
Vec3 nearest_on_segment(const Vec3& p, const Vec3& a, const Vec3& b) {
  const Vec3 ab = b - a;
  const double t = ab.dot(p - a) / ab.squaredNorm();
  if (!(t > 0)) return a;
  return t < 1 ? Vec3(a + t * ab) : b;
}

Vec3 nearest_on_triangle(const Vec3& p, const Vec3& a, const Vec3& b, const Vec3& c) {
  const Vec3 ab = b - a, ac = c - a, ap = p - a;
  const double d1 = ab.dot(ap), d2 = ac.dot(ap);
  const double ab2 = ab.squaredNorm(), ac2 = ac.squaredNorm(), abac = ab.dot(ac);
  const double determinant = ab.cross(ac).squaredNorm();
  const double v = (ac2 * d1 - abac * d2) / determinant, w = (ab2 * d2 - abac * d1) / determinant;
  if (v >= 0 && w >= 0 && v + w <= 1) return a + v * ab + w * ac;
  Vec3 best = nearest_on_segment(p, a, b);
  for (const Vec3& q : {nearest_on_segment(p, b, c), nearest_on_segment(p, c, a)})
    if ((q - p).squaredNorm() < (best - p).squaredNorm()) best = q;
  return best;
}

// A linear function of a slice's grid points: value + u_slope·u + v_slope·v.
struct SliceFunction {
  double value = 0, u_slope = 0, v_slope = 0;
  SliceFunction() = default;
  SliceFunction(const Vec3& gradient, const Vec3& zero_at, int axis, int slice)
      : value(gradient[axis] * slice - gradient.dot(zero_at)),
        u_slope(gradient[axis_u[axis]]),
        v_slope(gradient[axis_v[axis]]) {}
  double at(int u, int v) const { return value + u_slope * u + v_slope * v; }
};

// A feature's region in one slice: whether a grid point lies in it, and the squared distance there.
struct FaceSlice {
  SliceFunction inward[3], height;
  bool holds(int u, int v) const {
    return inward[0].at(u, v) >= -widening && inward[1].at(u, v) >= -widening && inward[2].at(u, v) >= -widening;
  }
  double squared_distance(int u, int v) const {
    const double h = height.at(u, v);
    return h * h;
  }
};

struct EdgeSlice {
  double length;
  SliceFunction along, inward[2], across[2];
  bool holds(int u, int v) const {
    const double t = along.at(u, v);
    return t >= -widening && t <= length + widening && inward[0].at(u, v) <= widening && inward[1].at(u, v) <= widening;
  }
  double squared_distance(int u, int v) const {
    const double x = across[0].at(u, v), y = across[1].at(u, v);
    return x * x + y * y;
  }
};

struct VertexSlice {
  double u0, v0, height2;
  std::vector<SliceFunction> along;
  bool holds(int u, int v) const {
    for (const SliceFunction& edge : along)
      if (edge.at(u, v) > widening) return false;
    return true;
  }
  double squared_distance(int u, int v) const { return height2 + (u - u0) * (u - u0) + (v - v0) * (v - v0); }
};

// Cuts a convex polygon with the half-plane a·x + b·y + c ≤ 0.
void clip(std::vector<Vec2>& polygon, double a, double b, double c, std::vector<Vec2>& scratch) {
  scratch.clear();
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    const Vec2 &p = polygon[i], &q = polygon[i + 1 < polygon.size() ? i + 1 : 0];
    const double at_p = a * p.x() + b * p.y() + c, at_q = a * q.x() + b * q.y() + c;
    if (at_p <= 0) scratch.push_back(p);
    if ((at_p <= 0) != (at_q <= 0)) scratch.push_back(p + at_p / (at_p - at_q) * (q - p));
  }
  polygon.swap(scratch);
}

}  // namespace

CharacteristicScan::CharacteristicScan(const TriangleMesh& mesh, const GridFrame& frame, double reach,
                                       const Vec3i& lower, const Vec3i& upper)
    : mesh_(mesh), reach_(reach / frame.voxel * (1 + 1e-9) + widening) {
  const std::size_t vertex_count = static_cast<std::size_t>(mesh.vertex_count());
  const std::size_t face_count = static_cast<std::size_t>(mesh.face_count());
  vertices_.resize(mesh.vertices.rows(), 3);
  parallel_for(vertex_count, [&](std::size_t v) {
    vertices_.row(static_cast<Eigen::Index>(v)) = frame.to_index(mesh.vertex(static_cast<int>(v))).transpose();
  });
  normals_.resize(face_count);
  parallel_for(face_count, [&](std::size_t f) {
    const int h = 3 * static_cast<int>(f);
    const Vec3 ab = position(to(h)) - position(from(h)), ac = position(from(h + 2)) - position(from(h));
    const Vec3 normal = ab.cross(ac);
    const double length = normal.norm();
    normals_[f] = Vec3::Zero();
    if (length > 1e-13 * std::max(ab.squaredNorm(), ac.squaredNorm())) normals_[f] = normal / length;
  });

  // The half-edges that leave each vertex; 3f + k runs from corner k to corner k + 1 of face f.
  const std::int32_t half_edge_count = static_cast<std::int32_t>(3 * face_count);
  outgoing_.assign(vertex_count + 1, 0);
  for (std::int32_t h = 0; h < half_edge_count; ++h) ++outgoing_[from(h) + 1];
  for (std::size_t v = 0; v < vertex_count; ++v) outgoing_[v + 1] += outgoing_[v];
  half_edges_.resize(3 * face_count);
  std::vector<std::int32_t> next(outgoing_.begin(), outgoing_.end() - 1);
  for (std::int32_t h = 0; h < half_edge_count; ++h) half_edges_[next[from(h)]++] = h;

  std::vector<char> regular(3 * face_count);
  parallel_for(regular.size(), [&](std::size_t h) { regular[h] = is_regular(static_cast<int>(h)); });
  closed_ = std::all_of(regular.begin(), regular.end(), [](char flag) { return flag != 0; });

  // Faces, then edges, then vertices, whatever thread looks at them.
  constexpr std::size_t chunk = 2048;
  const std::size_t face_parts = (face_count + chunk - 1) / chunk, vertex_parts = (vertex_count + chunk - 1) / chunk;
  std::vector<std::vector<Piece>> parts(2 * face_parts + vertex_parts);
  parallel_for(
      parts.size(),
      [&](std::size_t part) {
        const bool faces = part < face_parts, edges = !faces && part < 2 * face_parts;
        const std::size_t begin = (part - (faces ? 0 : edges ? face_parts : 2 * face_parts)) * chunk;
        const std::size_t end = std::min(begin + chunk, faces || edges ? face_count : vertex_count);
        for (int i = static_cast<int>(begin); i < static_cast<int>(end); ++i) {
          if (faces)
            add_face(i, parts[part]);
          else if (edges)
            for (int k = 0; k < 3; ++k) add_edge(3 * i + k, parts[part]);
          else
            add_vertex(i, parts[part]);
        }
      },
      1);
  std::vector<std::size_t> first_piece(1, 0);
  for (const auto& part : parts) first_piece.push_back(first_piece.back() + part.size());
  pieces_.resize(first_piece.back());
  parallel_for(
      parts.size(),
      [&](std::size_t part) {
        std::copy(parts[part].begin(), parts[part].end(),
                  pieces_.begin() + static_cast<std::ptrdiff_t>(first_piece[part]));
        parts[part] = {};
      },
      1);
  distribute(lower, upper);
}

bool CharacteristicScan::is_regular(int half_edge) const {
  const int a = from(half_edge), b = to(half_edge);
  int along = 0, against = 0;
  for (std::int32_t i = outgoing_[a]; i < outgoing_[a + 1]; ++i) along += to(half_edges_[i]) == b;
  for (std::int32_t i = outgoing_[b]; i < outgoing_[b + 1]; ++i) against += to(half_edges_[i]) == a;
  return along == 1 && against == 1;
}

int CharacteristicScan::twin(int half_edge) const {
  const int a = from(half_edge), b = to(half_edge);
  if (!closed_ && !is_regular(half_edge)) return -1;
  for (std::int32_t i = outgoing_[b]; i < outgoing_[b + 1]; ++i)
    if (to(half_edges_[i]) == a) return half_edges_[i];
  return -1;
}

Vec3 CharacteristicScan::inner_normal(int half_edge) const {
  return normals_[half_edge / 3].cross((position(to(half_edge)) - position(from(half_edge))).normalized());
}

void CharacteristicScan::add_piece(std::int32_t feature, int axis, const std::vector<Vec3>& origins,
                                   const std::vector<Vec3>& rays, double first, double last,
                                   std::vector<Piece>& pieces) const {
  constexpr double margin = 2 * widening;
  Piece piece;
  piece.feature = feature;
  piece.axis = axis;
  piece.first = static_cast<std::int32_t>(std::ceil(first - margin));
  piece.last = static_cast<std::int32_t>(std::floor(last + margin));
  if (piece.first > piece.last) return;
  for (int line = 0; line < 2; ++line)
    for (int side = 0; side < 2; ++side) {
      const int across = side == 0 ? axis_u[axis] : axis_v[axis];
      const Vec3& ray = rays[std::min<std::size_t>(line, rays.size() - 1)];
      const double slope = ray[axis] == 0 ? 0 : ray[across] / ray[axis];
      double lower = std::numeric_limits<double>::infinity(), upper = -lower;
      for (const Vec3& origin : origins) {
        lower = std::min(lower, origin[across] - slope * origin[axis]);
        upper = std::max(upper, origin[across] - slope * origin[axis]);
      }
      piece.slope[line][side] = slope;
      piece.lower[line][side] = lower - margin;
      piece.upper[line][side] = upper + margin;
    }
  pieces.push_back(piece);
}

void CharacteristicScan::add_face(int face, std::vector<Piece>& pieces) const {
  const Vec3& normal = normals_[face];
  if (normal.isZero(0)) return;  // its edges see what it sees
  int axis = 0;
  const double steepness = normal.cwiseAbs().maxCoeff(&axis);
  const std::vector<Vec3> corners = {position(from(3 * face)), position(from(3 * face + 1)),
                                     position(from(3 * face + 2))};
  const auto [low, high] = std::minmax({corners[0][axis], corners[1][axis], corners[2][axis]});
  add_piece(face, axis, corners, {normal}, low - reach_ * steepness, high + reach_ * steepness, pieces);
}

void CharacteristicScan::add_edge(int half_edge, std::vector<Piece>& pieces) const {
  const int opposite = twin(half_edge);
  if (opposite >= 0 && from(half_edge) > to(half_edge)) return;  // its twin's turn
  const std::int32_t feature = mesh_.face_count() + half_edge;
  const std::vector<Vec3> ends = {position(from(half_edge)), position(to(half_edge))};
  if (ends[0] == ends[1]) return;
  const Vec3 n = normals_[half_edge / 3], other = opposite < 0 ? Vec3(Vec3::Zero()) : normals_[opposite / 3];
  if (n.isZero(0) || other.isZero(0)) {
    // Where a face's plane is not known, the box around all that may be in reach.
    const Vec3 out = Vec3::Constant(reach_);
    const Vec3 lower = ends[0].cwiseMin(ends[1]) - out, upper = ends[0].cwiseMax(ends[1]) + out;
    add_piece(feature, 0, {lower, upper}, {Vec3::Zero()}, lower.x(), upper.x(), pieces);
    return;
  }
  // The wedge opens, by `turn`, from the one face's normal to the other's; where the edge is hollow, from their
  // opposites.
  const double turn = std::atan2(n.cross(other).norm(), n.dot(other));
  if (turn * reach_ < 0.25 * widening) return;
  const Vec3 inward = inner_normal(half_edge);
  const Vec3 start = inward.dot(other) < 0 ? n : Vec3(-n);
  const int parts = static_cast<int>(std::ceil(turn / (std::numbers::pi / 6)));
  const auto ray = [&](double angle) -> Vec3 { return std::cos(angle) * start - std::sin(angle) * inward; };
  for (int part = 0; part < parts; ++part) {
    const std::vector<Vec3> rays = {ray(turn * part / parts), ray(turn * (part + 1) / parts)};
    const Vec3 middle = rays[0] + rays[1];
    int axis = 0;
    middle.cwiseAbs().maxCoeff(&axis);
    // Rays between the two are steeper by no more than 1/cos 15°.
    const double height = reach_ * std::min(1.0, 1.04 * std::max(std::abs(rays[0][axis]), std::abs(rays[1][axis])));
    const auto [low, high] = std::minmax(ends[0][axis], ends[1][axis]);
    if (middle[axis] > 0)
      add_piece(feature, axis, ends, rays, low, high + height, pieces);
    else
      add_piece(feature, axis, ends, rays, low - height, high, pieces);
  }
}

void CharacteristicScan::add_vertex(int vertex, std::vector<Piece>& pieces) const {
  const std::int32_t begin = outgoing_[vertex], end = outgoing_[vertex + 1];
  if (begin == end) return;
  const Vec3 centre = position(vertex);
  std::vector<Vec3> edges;
  for (std::int32_t i = begin; i < end; ++i) edges.push_back(position(to(half_edges_[i])) - centre);
  std::vector<Vec2> polygon, scratch;
  for (int axis = 0; axis < 3; ++axis)
    for (const double sign : {1.0, -1.0}) {
      // The directions (x, y, ±1) of the cone that have their greatest component along the axis.
      polygon = {{-1, -1}, {1, -1}, {1, 1}, {-1, 1}};
      for (const Vec3& edge : edges) {
        clip(polygon, edge[axis_u[axis]], edge[axis_v[axis]], sign * edge[axis], scratch);
        if (polygon.empty()) break;
      }
      if (polygon.empty()) continue;
      Vec3 rays[2];
      for (const int side : {0, 1}) {
        const auto [low, high] = std::minmax_element(polygon.begin(), polygon.end(),
                                                     [&](const Vec2& p, const Vec2& q) { return p[side] < q[side]; });
        const int across = side == 0 ? axis_u[axis] : axis_v[axis];
        rays[0][across] = (*low)[side];
        rays[1][across] = (*high)[side];
      }
      rays[0][axis] = rays[1][axis] = sign;
      const double tip = centre[axis];
      add_piece(4 * mesh_.face_count() + vertex, axis, {centre}, {rays[0], rays[1]}, sign > 0 ? tip : tip - reach_,
                sign > 0 ? tip + reach_ : tip, pieces);
    }
}

// Gives each block the pieces that pass through it, in their order.
void CharacteristicScan::distribute(const Vec3i& lower, const Vec3i& upper) {
  const Vec3i counts = upper - lower;
  struct Visit {
    std::int32_t block, piece;
  };
  constexpr std::size_t chunk = 4096;
  std::vector<std::vector<Visit>> parts((pieces_.size() + chunk - 1) / chunk);
  parallel_chunks(pieces_.size(), chunk, [&](std::size_t begin, std::size_t end) {
    std::vector<Visit>& visits = parts[begin / chunk];
    for (std::size_t i = begin; i < end; ++i) {
      const Piece& piece = pieces_[i];
      const int axis = piece.axis, u = axis_u[axis], v = axis_v[axis];
      for (int s = std::max(piece.first >> block_bits, lower[axis]);
           s <= std::min(piece.last >> block_bits, upper[axis] - 1); ++s) {
        const int first = std::max(piece.first, s << block_bits);
        const int last = std::min(piece.last, (s << block_bits) + block_edge - 1);
        const Rectangle a = rectangle(piece, first), b = rectangle(piece, last);
        Vec3i from, to;
        from[axis] = to[axis] = s;
        for (const int side : {0, 1}) {
          const int across = side == 0 ? u : v;
          from[across] = std::max(std::min(a.lower[side], b.lower[side]) >> block_bits, lower[across]);
          to[across] = std::min(std::max(a.upper[side], b.upper[side]) >> block_bits, upper[across] - 1);
        }
        for (int x = from.x(); x <= to.x(); ++x)
          for (int y = from.y(); y <= to.y(); ++y)
            for (int z = from.z(); z <= to.z(); ++z) {
              const Vec3i at = Vec3i(x, y, z) - lower;
              visits.push_back({(at.x() * counts.y() + at.y()) * counts.z() + at.z(), static_cast<std::int32_t>(i)});
            }
      }
    }
  });
  std::vector<std::size_t> next(static_cast<std::size_t>(counts.prod()) + 1, 0);
  for (const auto& visits : parts)
    for (const Visit& visit : visits) ++next[visit.block + 1];
  for (std::size_t b = 0; b + 1 < next.size(); ++b) {
    if (next[b + 1] > 0) {
      const int block = static_cast<int>(b), yz = counts.y() * counts.z();
      blocks_.push_back(
          {lower + Vec3i(block / yz, block / counts.z() % counts.y(), block % counts.z()), next[b], next[b + 1]});
    }
    next[b + 1] += next[b];
  }
  by_block_.resize(next.back());
  for (const auto& visits : parts)
    for (const Visit& visit : visits) by_block_[next[visit.block]++] = visit.piece;
}

// The grid points of a slice that may lie in the region.
CharacteristicScan::Rectangle CharacteristicScan::rectangle(const Piece& piece, int slice) {
  Rectangle result;
  for (int side = 0; side < 2; ++side) {
    const double low = std::min(piece.lower[0][side] + piece.slope[0][side] * slice,
                                piece.lower[1][side] + piece.slope[1][side] * slice);
    const double high = std::max(piece.upper[0][side] + piece.slope[0][side] * slice,
                                 piece.upper[1][side] + piece.slope[1][side] * slice);
    result.lower[side] = static_cast<int>(std::ceil(low));
    result.upper[side] = static_cast<int>(std::floor(high));
  }
  return result;
}

template <class Slice>
std::int64_t CharacteristicScan::scan_piece(const Piece& piece, const Vec3i& corner, const Slice& slice_at,
                                            double* squared_distance, std::int32_t* feature) {
  constexpr int stride[3] = {block_edge * block_edge, block_edge, 1};
  const int axis = piece.axis, u_axis = axis_u[axis], v_axis = axis_v[axis];
  const int first = std::max(piece.first, corner[axis]);
  const int last = std::min(piece.last, corner[axis] + block_edge - 1);
  std::int64_t compared = 0;
  for (int s = first; s <= last; ++s) {
    const Rectangle area = rectangle(piece, s);
    const int u0 = std::max(area.lower[0], corner[u_axis]);
    const int u1 = std::min(area.upper[0], corner[u_axis] + block_edge - 1);
    const int v0 = std::max(area.lower[1], corner[v_axis]);
    const int v1 = std::min(area.upper[1], corner[v_axis] + block_edge - 1);
    if (u0 > u1 || v0 > v1) continue;
    compared += static_cast<std::int64_t>(u1 - u0 + 1) * (v1 - v0 + 1);
    const auto& slice = slice_at(s - corner[axis]);
    for (int u = u0 - corner[u_axis]; u <= u1 - corner[u_axis]; ++u)
      for (int v = v0 - corner[v_axis]; v <= v1 - corner[v_axis]; ++v) {
        if (!slice.holds(u, v)) continue;
        const int at = (s - corner[axis]) * stride[axis] + u * stride[u_axis] + v * stride[v_axis];
        const double distance = slice.squared_distance(u, v);
        if (distance < squared_distance[at]) squared_distance[at] = distance, feature[at] = piece.feature;
      }
  }
  return compared;
}

std::int64_t CharacteristicScan::scan(const Block& block, double* squared_distance, std::int32_t* feature) const {
  std::int64_t compared = 0;
  const Vec3i corner = block.coordinate * block_edge;
  const Vec3 origin = corner.cast<double>();
  const int face_count = mesh_.face_count();
  VertexSlice cone;
  for (std::size_t i = block.first; i < block.first + block.count; ++i) {
    const Piece& piece = pieces_[by_block_[i]];
    const int axis = piece.axis;
    if (piece.feature < face_count) {
      const int h = 3 * piece.feature;
      const Vec3 inward[3] = {inner_normal(h), inner_normal(h + 1), inner_normal(h + 2)};
      const Vec3 corners[3] = {position(from(h)) - origin, position(from(h + 1)) - origin,
                               position(from(h + 2)) - origin};
      compared += scan_piece(
          piece, corner,
          [&](int s) {
            FaceSlice slice;
            for (int k = 0; k < 3; ++k) slice.inward[k] = {inward[k], corners[k], axis, s};
            slice.height = {normals_[piece.feature], corners[0], axis, s};
            return slice;
          },
          squared_distance, feature);
    } else if (piece.feature < 4 * face_count) {
      const int h = piece.feature - face_count, other = twin(h);
      const Vec3 a = position(from(h)) - origin, b = position(to(h)) - origin;
      // An edge without a wedge takes all around it.
      const Vec3 inward[2] = {other < 0 ? Vec3(Vec3::Zero()) : inner_normal(h),
                              other < 0 ? Vec3(Vec3::Zero()) : inner_normal(other)};
      const Vec3 along = (b - a).normalized();
      const Vec3 across = inward[0].isZero(0) ? along.unitOrthogonal() : inward[0];
      const Vec3 upward = along.cross(across);
      compared += scan_piece(
          piece, corner,
          [&](int s) {
            EdgeSlice slice;
            slice.length = (b - a).norm();
            slice.along = {along, a, axis, s};
            // Either face's plane from the corner that the face itself takes.
            slice.inward[0] = {inward[0], a, axis, s};
            slice.inward[1] = {inward[1], b, axis, s};
            slice.across[0] = {across, a, axis, s};
            slice.across[1] = {upward, a, axis, s};
            return slice;
          },
          squared_distance, feature);
    } else {
      const int vertex = piece.feature - 4 * face_count;
      const Vec3 centre = position(vertex) - origin;
      compared += scan_piece(
          piece, corner,
          [&](int s) -> const VertexSlice& {
            cone.u0 = centre[axis_u[axis]];
            cone.v0 = centre[axis_v[axis]];
            cone.height2 = (s - centre[axis]) * (s - centre[axis]);
            cone.along.clear();
            for (std::int32_t e = outgoing_[vertex]; e < outgoing_[vertex + 1]; ++e)
              cone.along.emplace_back((position(to(half_edges_[e])) - position(vertex)).stableNormalized(), centre,
                                      axis, s);
            return cone;
          },
          squared_distance, feature);
    }
  }
  return compared;
}

Vec3 CharacteristicScan::nearest_point(std::int32_t feature, const Vec3& p) const {
  const int face_count = mesh_.face_count();
  if (feature < face_count)
    return nearest_on_triangle(p, mesh_.corner(feature, 0), mesh_.corner(feature, 1), mesh_.corner(feature, 2));
  if (feature >= 4 * face_count) return mesh_.vertex(feature - 4 * face_count);
  const int h = feature - face_count;
  return nearest_on_segment(p, mesh_.vertex(from(h)), mesh_.vertex(to(h)));
}

int CharacteristicScan::face_of(std::int32_t feature) const {
  const int face_count = mesh_.face_count();
  if (feature < face_count) return feature;
  if (feature >= 4 * face_count) return half_edges_[outgoing_[feature - 4 * face_count]] / 3;
  return (feature - face_count) / 3;
}

}  // namespace shellgrid
