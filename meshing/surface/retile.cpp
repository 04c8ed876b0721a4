// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/surface/retile.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/surface/retiling.h"

namespace shellgrid {

Retiling::Retiling(const TriangleMesh& input, const RetileOptions& options)
    : input_(input), options_(options), surface_(input) {
  face_normals_.resize(input.face_count());
  for (int f = 0; f < input.face_count(); ++f)
    face_normals_[f] = cross_of(input.corner(f, 0), input.corner(f, 1), input.corner(f, 2)).normalized();
  load(input);
  refresh();
  find_features();
  find_tips();
  for (const Refinement& refinement : options.refinements) {
    if (refinement.at.empty()) continue;
    VertexMatrix points(static_cast<Eigen::Index>(refinement.at.size()), 3);
    for (std::size_t i = 0; i < refinement.at.size(); ++i)
      points.row(static_cast<Eigen::Index>(i)) = refinement.at[i].transpose();
    refined_.push_back({points, NearestVertexQuery(points), refinement.factor, refinement.core, refinement.reach});
  }
}

TriangleMesh Retiling::run(Progress& progress) {
  double target = options_.spacing / 0.95, last_variation = std::numeric_limits<double>::infinity();
  progress.begin("retiling", options_.iterations);
  // A few rounds more where the edges have not settled, as on large flat faces.
  for (int iteration = 0; iteration < 3 * options_.iterations; ++iteration) {
    if (iteration >= options_.iterations) {
      const auto [mean, variation] = edge_statistics();
      const bool even = !refined_.empty() || variation < 0.145 || variation > last_variation - 0.0008;
      if (even && (std::abs(mean / options_.spacing - 1) < 0.01 || iteration >= 2 * options_.iterations)) break;
      last_variation = variation;
    }
    split_long(4.0 / 3 * target);
    collapse_short(4.0 / 5 * target, 4.0 / 3 * target);
    flip();
    relax();
    target *= std::clamp(options_.spacing / mean_edge(), 0.95, 1.05);
    progress.advance();
  }
  for (int pass = 0; pass < 2; ++pass) {
    flip();
    relax();
  }
  fit();
  progress.end();
  return extract();
}

void Retiling::split_long(double longest) {
  const double limit = longest * longest;
  std::vector<std::pair<double, int>> queue;
  for (;;) {
    // Longest first within a round; new edges wait for the next one.
    queue.clear();
    for (std::size_t e = 0; e < mesh_.n_edges(); ++e) {
      const double length = scaled_squared_length(EdgeHandle(static_cast<int>(e)));
      if (length > limit) queue.emplace_back(-length, static_cast<int>(e));
    }
    if (queue.empty()) break;
    std::sort(queue.begin(), queue.end());
    for (const auto& entry : queue) split(EdgeHandle(entry.second));
    if (mesh_.n_vertices() > 50'000'000)
      throw InputError("retiling needs more than 5e7 vertices; ask for a larger spacing");
  }
}

TriangleMesh Retiling::extract() const {
  TriangleMesh result;
  result.vertices.resize(static_cast<Eigen::Index>(mesh_.n_vertices()), 3);
  for (std::size_t v = 0; v < mesh_.n_vertices(); ++v)
    result.vertices.row(static_cast<Eigen::Index>(v)) = position(static_cast<int>(v)).transpose();
  result.faces.resize(static_cast<Eigen::Index>(mesh_.n_faces()), 3);
  for (std::size_t f = 0; f < mesh_.n_faces(); ++f) {
    const HalfedgeHandle h = mesh_.halfedge_handle(FaceHandle(static_cast<int>(f)));
    result.faces.row(static_cast<Eigen::Index>(f)) << mesh_.from_vertex_handle(h).idx(),
        mesh_.to_vertex_handle(h).idx(), mesh_.to_vertex_handle(mesh_.next_halfedge_handle(h)).idx();
  }
  return result;
}

double Retiling::squared_length(EdgeHandle e) const {
  const HalfedgeHandle h = mesh_.halfedge_handle(e, 0);
  return (position(mesh_.to_vertex_handle(h)) - position(mesh_.from_vertex_handle(h))).squaredNorm();
}

double Retiling::scaled_squared_length(EdgeHandle e) const {
  const double length = squared_length(e);
  if (refined_.empty()) return length;
  const HalfedgeHandle h = mesh_.halfedge_handle(e, 0);
  const double scale = size_factor(0.5 * (position(mesh_.to_vertex_handle(h)) + position(mesh_.from_vertex_handle(h))));
  return length / (scale * scale);
}

double Retiling::size_factor(const Vec3& p) const {
  double factor = 1;
  for (const Refined& refined : refined_) {
    const double distance = (refined.at.row(refined.query.nearest(p)).transpose() - p).norm() / options_.spacing;
    const double share = std::clamp((distance - refined.core) / (refined.reach - refined.core), 0.0, 1.0);
    factor = std::min(factor, refined.factor + (1 - refined.factor) * share);
  }
  return factor;
}

double Retiling::mean_edge() const {
  return parallel_sum(mesh_.n_edges(), 0.0,
                      [&](std::size_t e) { return std::sqrt(squared_length(EdgeHandle(static_cast<int>(e)))); }) /
         static_cast<double>(mesh_.n_edges());
}

std::pair<double, double> Retiling::edge_statistics() const {
  const double mean = mean_edge();
  const double squares = parallel_sum(mesh_.n_edges(), 0.0,
                                      [&](std::size_t e) { return squared_length(EdgeHandle(static_cast<int>(e))); }) /
                         static_cast<double>(mesh_.n_edges());
  return {mean, std::sqrt(std::max(0.0, squares / (mean * mean) - 1))};
}

void Retiling::load(const TriangleMesh& input) {
  mesh_.reserve(input.vertex_count(), 3 * static_cast<std::size_t>(input.face_count()) / 2, input.face_count());
  for (int v = 0; v < input.vertex_count(); ++v) mesh_.add_vertex(to_point(input.vertex(v)));
  for (int f = 0; f < input.face_count(); ++f) {
    const FaceHandle added = mesh_.add_face(VertexHandle(input.faces(f, 0)), VertexHandle(input.faces(f, 1)),
                                            VertexHandle(input.faces(f, 2)));
    if (!added.is_valid()) throw InternalError("retile_surface: the input is not a closed manifold");
  }
}

void Retiling::split(EdgeHandle e) {
  const HalfedgeHandle h = mesh_.halfedge_handle(e, 0);
  const VertexHandle a = mesh_.from_vertex_handle(h), b = mesh_.to_vertex_handle(h);
  const bool feature = mesh_.status(e).feature();
  const VertexHandle middle = mesh_.add_vertex((mesh_.point(a) + mesh_.point(b)) * 0.5);
  refresh();
  mesh_.split(e, middle);
  for (const VertexHandle end : {a, b})
    mesh_.status(mesh_.edge_handle(mesh_.find_halfedge(middle, end))).set_feature(feature);
  mesh_.status(middle).set_feature(feature);
}

void Retiling::collapse_short(double shortest, double longest) {
  const double limit = shortest * shortest;
  for (std::size_t e = 0; e < mesh_.n_edges(); ++e) {
    const EdgeHandle edge(static_cast<int>(e));
    if (mesh_.status(edge).deleted() || scaled_squared_length(edge) >= limit) continue;
    for (int side = 0; side < 2; ++side) {
      const HalfedgeHandle h = mesh_.halfedge_handle(edge, side);
      if (!may_collapse(h, longest * longest)) continue;
      collapse(h);
      break;
    }
  }
  mesh_.garbage_collection();
  refresh();
}

bool Retiling::may_collapse(HalfedgeHandle h, double longest_squared) {
  const VertexHandle from = mesh_.from_vertex_handle(h), to = mesh_.to_vertex_handle(h);
  if (mesh_.status(from).locked()) return false;
  if (mesh_.status(from).feature() && !mesh_.status(mesh_.edge_handle(h)).feature()) return false;
  const Vec3 target = position(to);
  const double factor = size_factor(target);
  longest_squared *= factor * factor;
  for (const VertexHandle v : mesh_.vv_range(from))
    if ((position(v) - target).squaredNorm() > longest_squared) return false;
  if (!mesh_.is_collapse_ok(h)) return false;
  const Vec3 source = position(from);
  for (const HalfedgeHandle out : mesh_.voh_range(from)) {
    const VertexHandle p = mesh_.to_vertex_handle(out);
    const VertexHandle q = mesh_.to_vertex_handle(mesh_.next_halfedge_handle(out));
    if (p == to || q == to) continue;
    const Vec3 before = cross_of(source, position(p), position(q));
    const Vec3 after = cross_of(target, position(p), position(q));
    if (!(before.dot(after) > 0.5 * before.norm() * after.norm())) return false;
  }
  return true;
}

void Retiling::collapse(HalfedgeHandle h) {
  const VertexHandle to = mesh_.to_vertex_handle(h);
  // Two edges become one at either side: it is sharp where one of the two is.
  std::array<std::pair<VertexHandle, bool>, 2> sides;
  for (int side = 0; side < 2; ++side) {
    const HalfedgeHandle inner = side == 0 ? h : mesh_.opposite_halfedge_handle(h);
    const HalfedgeHandle next = mesh_.next_halfedge_handle(inner), after = mesh_.next_halfedge_handle(next);
    sides[side] = {mesh_.to_vertex_handle(next),
                   mesh_.status(mesh_.edge_handle(next)).feature() || mesh_.status(mesh_.edge_handle(after)).feature()};
  }
  mesh_.collapse(h);
  for (const auto& [v, feature] : sides) {
    const HalfedgeHandle joined = mesh_.find_halfedge(to, v);
    if (joined.is_valid()) mesh_.status(mesh_.edge_handle(joined)).set_feature(feature);
  }
}

void Retiling::flip() {
  std::vector<int> valence(mesh_.n_vertices(), 0);
  for (std::size_t e = 0; e < mesh_.n_edges(); ++e)
    for (int side = 0; side < 2; ++side)
      ++valence[mesh_.to_vertex_handle(mesh_.halfedge_handle(EdgeHandle(static_cast<int>(e)), side)).idx()];
  const auto excess = [&](int v, int change) { return std::abs(valence[v] + change - 6); };
  for (std::size_t i = 0; i < mesh_.n_edges(); ++i) {
    const EdgeHandle e(static_cast<int>(i));
    if (mesh_.status(e).feature()) continue;
    const HalfedgeHandle h = mesh_.halfedge_handle(e, 0), o = mesh_.halfedge_handle(e, 1);
    const VertexHandle a = mesh_.from_vertex_handle(h), b = mesh_.to_vertex_handle(h);
    const VertexHandle c = mesh_.to_vertex_handle(mesh_.next_halfedge_handle(h));
    const VertexHandle d = mesh_.to_vertex_handle(mesh_.next_halfedge_handle(o));
    const int before = excess(a.idx(), 0) + excess(b.idx(), 0) + excess(c.idx(), 0) + excess(d.idx(), 0);
    const int after = excess(a.idx(), -1) + excess(b.idx(), -1) + excess(c.idx(), 1) + excess(d.idx(), 1);
    if (after >= before || valence[a.idx()] <= 3 || valence[b.idx()] <= 3) continue;
    if (!mesh_.is_flip_ok(e) || !flip_keeps_shape(position(a), position(b), position(c), position(d))) continue;
    mesh_.flip(e);
    --valence[a.idx()], --valence[b.idx()], ++valence[c.idx()], ++valence[d.idx()];
  }
}

bool Retiling::flip_keeps_shape(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
  const Vec3 old_sum = cross_of(a, b, c) + cross_of(b, a, d);
  const Vec3 first = cross_of(c, a, d), second = cross_of(d, b, c);
  const double size = old_sum.norm();
  if (!(first.dot(old_sum) > 0.5 * first.norm() * size && second.dot(old_sum) > 0.5 * second.norm() * size))
    return false;
  if (!(first.dot(second) > 0.5 * first.norm() * second.norm())) return false;
  return std::min(first.norm(), second.norm()) > 0.1 * (c - d).squaredNorm();
}

void Retiling::relax(const std::vector<char>& active) {
  const std::size_t n = mesh_.n_vertices();
  std::vector<Vec3> moved(n);
  parallel_for(n, [&](std::size_t v) {
    const VertexHandle handle(static_cast<int>(v));
    moved[v] = active.empty() || active[v] ? relaxed_position(handle) : position(handle);
  });
  // Where a face would turn over, its corners stay.
  std::vector<char> turns(mesh_.n_faces());
  for (int round = 0; round < 4; ++round) {
    parallel_for(turns.size(), [&](std::size_t f) { turns[f] = turns_over(FaceHandle(static_cast<int>(f)), moved); });
    bool any = false;
    for (std::size_t f = 0; f < turns.size(); ++f) {
      if (!turns[f]) continue;
      for (const VertexHandle v : mesh_.fv_range(FaceHandle(static_cast<int>(f)))) moved[v.idx()] = position(v);
      any = true;
    }
    if (!any) break;
  }
  parallel_for(n, [&](std::size_t v) { mesh_.set_point(VertexHandle(static_cast<int>(v)), to_point(moved[v])); });
}

Vec3 Retiling::relaxed_position(VertexHandle v) const {
  const Vec3 here = position(v);
  if (mesh_.status(v).locked()) return here;
  if (mesh_.status(v).feature()) {
    Vec3 sum = Vec3::Zero();
    int count = 0;
    for (const HalfedgeHandle out : mesh_.voh_range(v))
      if (mesh_.status(mesh_.edge_handle(out)).feature()) sum += position(mesh_.to_vertex_handle(out)), ++count;
    if (count != 2) return here;
    return features_.nearest(0.5 * here + 0.25 * sum).point;
  }
  Vec3 sum = Vec3::Zero(), normal = Vec3::Zero();
  int count = 0;
  for (const HalfedgeHandle out : mesh_.voh_range(v)) {
    const Vec3 p = position(mesh_.to_vertex_handle(out));
    normal += cross_of(here, p, position(mesh_.to_vertex_handle(mesh_.next_halfedge_handle(out))));
    sum += p;
    ++count;
  }
  normal.normalize();
  Vec3 step = sum / count - here;
  step -= normal.dot(step) * normal;
  if (!step.allFinite()) return here;
  // The vertex lies on the surface or is the middle of a chord of it: the nearest point is not far.
  SurfacePoint found = surface_.nearest(here + step, step.norm() + 0.2 * options_.spacing);
  if (found.face_index < 0) found = surface_.nearest(here + step);
  // Not onto the far side of a thin wall.
  return face_normals_[found.face_index].dot(normal) > 0 ? found.point : here;
}

bool Retiling::turns_over(FaceHandle f, const std::vector<Vec3>& moved) const {
  const HalfedgeHandle h = mesh_.halfedge_handle(f);
  const VertexHandle a = mesh_.from_vertex_handle(h), b = mesh_.to_vertex_handle(h);
  const VertexHandle c = mesh_.to_vertex_handle(mesh_.next_halfedge_handle(h));
  const Vec3 before = cross_of(position(a), position(b), position(c));
  const Vec3 after = cross_of(moved[a.idx()], moved[b.idx()], moved[c.idx()]);
  const double turn = before.dot(after);
  return !(turn > 0) || turn * turn < 0.09 * before.squaredNorm() * after.squaredNorm();
}

namespace {

// Every third bit of a 21-bit number.
std::uint64_t spread_bits(std::uint64_t x) {
  x = (x | x << 32) & 0x1f00000000ffffull;
  x = (x | x << 16) & 0x1f0000ff0000ffull;
  x = (x | x << 8) & 0x100f00f00f00f00full;
  x = (x | x << 4) & 0x10c30c30c30c30c3ull;
  return (x | x << 2) & 0x1249249249249249ull;
}

}  // namespace

TriangleMesh order_by_position(const TriangleMesh& mesh) {
  const int n = mesh.vertex_count();
  if (n == 0) return mesh;
  const Eigen::RowVector3d lower = mesh.vertices.colwise().minCoeff();
  const double extent = (mesh.vertices.colwise().maxCoeff() - lower).maxCoeff();
  std::vector<std::pair<std::uint64_t, int>> order(n);
  for (int v = 0; v < n; ++v) {
    std::uint64_t code = 0;
    for (int axis = 0; axis < 3; ++axis)
      code |= spread_bits(static_cast<std::uint64_t>((mesh.vertices(v, axis) - lower[axis]) / extent * 2097151))
              << axis;
    order[v] = {code, v};
  }
  std::sort(order.begin(), order.end());
  TriangleMesh result;
  result.vertices.resize(n, 3);
  std::vector<int> place(n);
  for (int i = 0; i < n; ++i) {
    place[order[i].second] = i;
    result.vertices.row(i) = mesh.vertices.row(order[i].second);
  }
  // Each face starts at its lowest corner.
  std::vector<std::array<std::int32_t, 3>> faces(mesh.face_count());
  for (int f = 0; f < mesh.face_count(); ++f) {
    for (int k = 0; k < 3; ++k) faces[f][k] = place[mesh.faces(f, k)];
    std::rotate(faces[f].begin(), std::min_element(faces[f].begin(), faces[f].end()), faces[f].end());
  }
  std::sort(faces.begin(), faces.end());
  result.faces.resize(mesh.face_count(), 3);
  for (int f = 0; f < mesh.face_count(); ++f) result.faces.row(f) << faces[f][0], faces[f][1], faces[f][2];
  return result;
}

TriangleMesh retile_surface(const TriangleMesh& mesh, const RetileOptions& options, Progress& progress) {
  return order_by_position(Retiling(mesh, options).run(progress));
}

TriangleMesh subdivide_long_edges(const TriangleMesh& mesh, double longest) {
  RetileOptions options;
  options.spacing = longest;
  Retiling retiling(mesh, options);
  retiling.split_long(longest);
  return order_by_position(retiling.extract());
}

}  // namespace shellgrid
