// SPDX-License-Identifier: AGPL-3.0-or-later
#include <algorithm>
#include <array>
#include <cmath>

#include "meshing/core/parallel.h"
#include "meshing/surface/half_edges.h"
#include "meshing/surface/repair.h"
#include "meshing/surface/retiling.h"

namespace shellgrid {
namespace {

constexpr double allowed = 0.22;  // distance between the surfaces beyond which the mesh changes, spacings
constexpr int passes = 12;
constexpr int most_crossings = 500;  // beyond which the object is too thin for the spacing, and nothing is changed

// A triangle's smallest height over its longest edge.
double height_ratio(const Vec3& a, const Vec3& b, const Vec3& c) {
  const double longest = std::max({(b - a).squaredNorm(), (c - b).squaredNorm(), (a - c).squaredNorm()});
  return (b - a).cross(c - a).norm() / longest;
}

}  // namespace

// Where another surface can be farthest: at vertices, along edges that bend by 10 degrees or more, on wide faces.
std::vector<Vec3> Retiling::probes() const {
  std::vector<Vec3> points;
  const double step = 0.5 * options_.spacing;
  for (int v = 0; v < input_.vertex_count(); ++v) points.push_back(input_.vertex(v));
  const HalfEdges half_edges = build_half_edges(input_);
  for (std::int32_t h = 0; h < 3 * input_.face_count(); ++h) {
    const std::int32_t twin = half_edges.twin[h];
    if (twin < h || face_normals_[h / 3].dot(face_normals_[twin / 3]) > 0.985) continue;
    const Vec3 a = input_.vertex(HalfEdges::from(input_, h)), b = input_.vertex(HalfEdges::to(input_, h));
    const int parts = static_cast<int>(std::min(1e6, std::ceil((b - a).norm() / step)));
    for (int i = 1; i < parts; ++i) points.push_back(a + static_cast<double>(i) / parts * (b - a));
  }
  for (int f = 0; f < input_.face_count(); ++f) {
    const Vec3 a = input_.corner(f, 0), ab = input_.corner(f, 1) - a, ac = input_.corner(f, 2) - a;
    const int n = std::min(1000, static_cast<int>(std::sqrt(ab.cross(ac).norm()) / options_.spacing));
    for (int i = 0; i < n; ++i)
      for (int j = 0; i + j < n; ++j) points.push_back(a + (i + 1.0 / 3) / n * ab + (j + 1.0 / 3) / n * ac);
  }
  return points;
}

void Retiling::fit() {
  const double spacing2 = options_.spacing * options_.spacing;
  const std::vector<Vec3> points = probes();
  std::vector<char> near(mesh_.n_vertices(), 1), changed;
  std::vector<std::int32_t> vertex_of(points.size(), 0);  // near the point
  std::vector<Vec3> given_up;
  bool everywhere = true;
  for (int pass = 0; pass < passes; ++pass) {
    std::vector<Misfit> misfits = find_misfits(points, near, everywhere, vertex_of);
    misfits.erase(std::remove_if(misfits.begin(), misfits.end(),
                                 [&](const Misfit& misfit) {
                                   return std::any_of(given_up.begin(), given_up.end(), [&](const Vec3& p) {
                                     return (p - misfit.point).squaredNorm() < 0.1 * spacing2;
                                   });
                                 }),
                  misfits.end());
    if (misfits.empty()) {
      if (everywhere) break;
      everywhere = true;  // once more, all of it
      near.assign(mesh_.n_vertices(), 1);
      continue;
    }
    everywhere = false;
    std::stable_sort(misfits.begin(), misfits.end(),
                     [](const Misfit& a, const Misfit& b) { return a.squared_distance > b.squared_distance; });
    room_ = pass < 5 ? Room{0.4, 1.7, 0.2} : Room{0.3, 2, 0.12};
    near.assign(mesh_.n_vertices(), 0);
    for (const Misfit& misfit : misfits)
      for (const VertexHandle v : mesh_.fv_range(FaceHandle(misfit.face))) near[v.idx()] = 1;
    if (given_up.size() > 4 * most_crossings) break;
    if (change(misfits, changed, given_up)) {
      near.resize(mesh_.n_vertices(), 1);
      for (std::size_t v = 0; v < near.size(); ++v) near[v] |= changed[v];
      near = grown(near);
    } else {
      if (pass >= 5) break;
      pass = 4;  // there is more room from then on
    }
  }
}

// Changes the mesh towards as many misfits as have room, so that it does not cross itself anew. Marks the vertices
// changed; returns whether there are any.
bool Retiling::change(std::vector<Misfit> misfits, std::vector<char>& changed, std::vector<Vec3>& given_up) {
  const Mesh before = mesh_;
  for (int attempt = 0; attempt < 6; ++attempt) {
    changed.assign(mesh_.n_vertices(), 0);
    std::vector<std::size_t> reached;
    for (std::size_t i = 0; i < misfits.size(); ++i)
      if (reach(misfits[i], changed)) reached.push_back(i);
    if (reached.empty()) return false;
    changed.resize(mesh_.n_vertices(), 1);
    for (int round = 0; round < 2; ++round) {
      changed = grown(changed);
      if (round == 0) flip_towards_surface(changed);
      relax(changed);
    }
    const TriangleMesh result = extract();
    std::vector<char> faces(static_cast<std::size_t>(result.face_count()), 0);
    for (int f = 0; f < result.face_count(); ++f)
      for (int k = 0; k < 3; ++k) faces[f] |= changed[result.faces(f, k)];
    const SelfIntersections crossings = find_self_intersections(result, faces, folded_flat);
    if (crossings.pairs == 0) return true;
    if (crossings.pairs > most_crossings) break;
    // Again, without the nearest to each crossing.
    std::vector<char> drop(misfits.size(), 0);
    for (const auto& [face, other] : crossings.face_pairs)
      for (const int f : {face, other}) {
        const Vec3 middle = (result.corner(f, 0) + result.corner(f, 1) + result.corner(f, 2)) / 3;
        const auto distance = [&](std::size_t i) { return (misfits[i].point - middle).squaredNorm(); };
        drop[*std::min_element(reached.begin(), reached.end(),
                               [&](std::size_t i, std::size_t j) { return distance(i) < distance(j); })] = 1;
      }
    std::size_t kept = 0;
    for (std::size_t i = 0; i < misfits.size(); ++i)
      if (drop[i])
        given_up.push_back(misfits[i].point);
      else
        misfits[kept++] = misfits[i];
    misfits.resize(kept);
    mesh_ = before;
    refresh();
  }
  mesh_ = before;
  refresh();
  return false;
}

// Points of the input and edges farther from the other surface than allowed. Looks only at the part of the mesh that
// is marked, and only at points that were near it last time.
std::vector<Retiling::Misfit> Retiling::find_misfits(const std::vector<Vec3>& points, const std::vector<char>& near,
                                                     bool everywhere, std::vector<std::int32_t>& vertex_of) const {
  const double limit = allowed * allowed * options_.spacing * options_.spacing;
  std::vector<char> rim = near;
  for (int ring = 0; !everywhere && ring < 2; ++ring) rim = grown(rim);
  TriangleMesh part = extract();
  std::vector<int> face_of;
  for (int f = 0; f < part.face_count(); ++f)
    if (rim[part.faces(f, 0)] || rim[part.faces(f, 1)] || rim[part.faces(f, 2)]) {
      part.faces.row(static_cast<Eigen::Index>(face_of.size())) = part.faces.row(f).eval();
      face_of.push_back(f);
    }
  part.faces.conservativeResize(static_cast<Eigen::Index>(face_of.size()), 3);
  const ClosestPointQuery query(part);
  std::vector<char> is_far(points.size(), 0);
  parallel_for(points.size(), [&](std::size_t i) {
    if (!near[vertex_of[i]]) return;
    const SurfacePoint found = query.nearest(points[i]);
    int k = 0;
    found.barycentric.maxCoeff(&k);
    vertex_of[i] = part.faces(found.face_index, k);
    is_far[i] = found.squared_distance > limit;
  });
  std::vector<Misfit> misfits;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (!is_far[i]) continue;
    const SurfacePoint found = query.nearest(points[i]);
    misfits.push_back({found.squared_distance, points[i], face_of[found.face_index], found.barycentric, -1});
  }
  add_bridges(near, misfits);
  return misfits;
}

// The vertices marked and their neighbours.
std::vector<char> Retiling::grown(const std::vector<char>& marks) const {
  std::vector<char> result = marks;
  for (std::size_t i = 0; i < mesh_.n_edges(); ++i) {
    const HalfedgeHandle h = mesh_.halfedge_handle(EdgeHandle(static_cast<int>(i)), 0);
    const int a = mesh_.from_vertex_handle(h).idx(), b = mesh_.to_vertex_handle(h).idx();
    if (marks[a]) result[b] = 1;
    if (marks[b]) result[a] = 1;
  }
  return result;
}

// Edges whose middle hangs in the air, with the point of the input below.
void Retiling::add_bridges(const std::vector<char>& near, std::vector<Misfit>& misfits) const {
  const double limit = allowed * allowed * options_.spacing * options_.spacing;
  std::vector<Misfit> found(mesh_.n_edges());
  parallel_for(found.size(), [&](std::size_t i) {
    const EdgeHandle e(static_cast<int>(i));
    Misfit& misfit = found[i];
    misfit.squared_distance = 0;
    const HalfedgeHandle h = mesh_.halfedge_handle(e, 0);
    const VertexHandle a = mesh_.from_vertex_handle(h), b = mesh_.to_vertex_handle(h);
    if (!near[a.idx()] || !near[b.idx()]) return;
    const Vec3 c = position(mesh_.to_vertex_handle(mesh_.next_halfedge_handle(h)));
    const Vec3 d = position(mesh_.to_vertex_handle(mesh_.next_halfedge_handle(mesh_.opposite_halfedge_handle(h))));
    const Vec3 n = cross_of(position(a), position(b), c).normalized(),
               m = cross_of(position(b), position(a), d).normalized();
    if (n.dot(m) > 0.9) return;
    const Vec3 middle = 0.5 * (position(a) + position(b));
    const SurfacePoint below = surface_.nearest(middle);
    if (below.squared_distance < limit || face_normals_[below.face_index].dot(n + m) <= 0) return;
    const FaceHandle face = mesh_.face_handle(h);
    misfit = {below.squared_distance, below.point, face.idx(), Vec3::Zero(), e.idx()};
    // The face's corners in the order that extract() gives them.
    const HalfedgeHandle first = mesh_.halfedge_handle(face);
    const std::array<VertexHandle, 3> corners = {mesh_.from_vertex_handle(first), mesh_.to_vertex_handle(first),
                                                 mesh_.to_vertex_handle(mesh_.next_halfedge_handle(first))};
    for (int k = 0; k < 3; ++k) misfit.barycentric[k] = corners[k] == a || corners[k] == b ? 0.5 : 0.0;
  });
  for (const Misfit& misfit : found)
    if (misfit.squared_distance > 0) misfits.push_back(misfit);
}

// Brings the mesh to a point. A vertex moves once in a pass, and so does nothing around it.
bool Retiling::reach(const Misfit& misfit, std::vector<char>& changed) {
  const HalfedgeHandle first = mesh_.halfedge_handle(FaceHandle(misfit.face));
  std::array<HalfedgeHandle, 3> sides = {first, mesh_.next_halfedge_handle(first),
                                         mesh_.next_halfedge_handle(mesh_.next_halfedge_handle(first))};
  std::array<int, 3> order = {0, 1, 2};  // by falling weight
  std::stable_sort(order.begin(), order.end(),
                   [&](int i, int j) { return misfit.barycentric[i] > misfit.barycentric[j]; });
  for (const HalfedgeHandle side : sides)
    if (const int v = mesh_.from_vertex_handle(side).idx(); v >= static_cast<int>(changed.size()) || changed[v])
      return false;
  const auto mark = [&](VertexHandle v) {
    if (v.idx() < static_cast<int>(changed.size())) changed[v.idx()] = 1;
  };
  if (misfit.edge >= 0) {
    const EdgeHandle e(misfit.edge);
    const HalfedgeHandle h = mesh_.halfedge_handle(e, 0);
    std::array<VertexHandle, 4> corners = {
        mesh_.from_vertex_handle(h), mesh_.to_vertex_handle(h), mesh_.to_vertex_handle(mesh_.next_halfedge_handle(h)),
        mesh_.to_vertex_handle(mesh_.next_halfedge_handle(mesh_.opposite_halfedge_handle(h)))};
    if (may_flip_towards_surface(e)) {
      mesh_.flip(e);
      for (const VertexHandle v : corners) mark(v);
      return true;
    }
  }
  for (const int k : order) {
    const VertexHandle v = mesh_.from_vertex_handle(sides[k]);
    if (misfit.barycentric[k] < 0.25 || mesh_.status(v).locked() || mesh_.status(v).feature()) continue;
    if (!may_move(v, misfit.point)) continue;
    mesh_.set_point(v, to_point(misfit.point));
    mesh_.status(v).set_locked(true);
    mark(v);
    for (const VertexHandle w : mesh_.vv_range(v)) mark(w);
    return true;
  }
  // Sides by falling weight of their ends: side k runs from corner k to corner k + 1.
  std::array<int, 3> by_weight = {(order[2] + 1) % 3, (order[1] + 1) % 3, (order[0] + 1) % 3};
  for (const int k : by_weight) {
    const HalfedgeHandle h = sides[k];
    const EdgeHandle e = mesh_.edge_handle(h);
    if (misfit.barycentric[k] + misfit.barycentric[(k + 1) % 3] < 0.5 || mesh_.status(e).feature()) continue;
    if (!may_split(h, misfit.point)) continue;
    split(e);
    const VertexHandle v(static_cast<int>(mesh_.n_vertices()) - 1);
    mesh_.set_point(v, to_point(misfit.point));
    mesh_.status(v).set_locked(true);
    for (const VertexHandle w : mesh_.vv_range(v)) mark(w);
    return true;
  }
  return false;
}

bool Retiling::has_room(const Vec3& a, const Vec3& b, const Vec3& c) const {
  const double scale = options_.spacing * size_factor(a);
  for (const double length : {(b - a).norm(), (c - a).norm()})
    if (length < room_.shortest * scale || length > room_.longest * scale) return false;
  return height_ratio(a, b, c) > room_.height;
}

bool Retiling::may_move(VertexHandle v, const Vec3& to) const {
  const Vec3 from = position(v);
  for (const HalfedgeHandle out : mesh_.voh_range(v)) {
    const HalfedgeHandle far = mesh_.next_halfedge_handle(out), beyond = mesh_.opposite_halfedge_handle(far);
    const Vec3 p = position(mesh_.to_vertex_handle(out)), q = position(mesh_.to_vertex_handle(far));
    if (!has_room(to, p, q)) return false;
    const Vec3 before = cross_of(from, p, q).normalized(), after = cross_of(to, p, q).normalized();
    if (after.dot(before) < 0.3) return false;
    const Vec3 other =
        cross_of(q, p, position(mesh_.to_vertex_handle(mesh_.next_halfedge_handle(beyond)))).normalized();
    if (after.dot(other) < std::min(-0.3, before.dot(other))) return false;
  }
  return true;
}

bool Retiling::may_split(HalfedgeHandle h, const Vec3& at) const {
  for (const HalfedgeHandle side : {h, mesh_.opposite_halfedge_handle(h)}) {
    const Vec3 a = position(mesh_.from_vertex_handle(side)), b = position(mesh_.to_vertex_handle(side));
    const Vec3 c = position(mesh_.to_vertex_handle(mesh_.next_halfedge_handle(side)));
    const Vec3 before = cross_of(a, b, c).normalized();
    for (const auto& [p, q] : {std::pair(b, c), std::pair(c, a)}) {
      if (!has_room(at, p, q)) return false;
      if (cross_of(at, p, q).normalized().dot(before) < 0.3) return false;
    }
  }
  return true;
}

// Whether an edge's middle is farther from the input than the other diagonal's, and turning it makes sound faces.
bool Retiling::may_flip_towards_surface(EdgeHandle e) const {
  if (mesh_.status(e).feature() || !mesh_.is_flip_ok(e)) return false;
  const HalfedgeHandle h = mesh_.halfedge_handle(e, 0), o = mesh_.halfedge_handle(e, 1);
  const VertexHandle a = mesh_.from_vertex_handle(h), b = mesh_.to_vertex_handle(h);
  if (mesh_.valence(a) <= 4 || mesh_.valence(b) <= 4) return false;
  const Vec3 p = position(a), q = position(b), r = position(mesh_.to_vertex_handle(mesh_.next_halfedge_handle(h))),
             s = position(mesh_.to_vertex_handle(mesh_.next_halfedge_handle(o)));
  if ((r - s).norm() > room_.longest * options_.spacing) return false;
  const double gain = 0.05 * options_.spacing, before = std::sqrt(surface_.nearest(0.5 * (p + q)).squared_distance);
  if (before <= gain || std::sqrt(surface_.nearest(0.5 * (r + s)).squared_distance) >= before - gain) return false;
  // Faces (p, q, r), (q, p, s) become (r, p, s), (s, q, r): neither a needle nor turned away from the input.
  const Vec3 normals[2] = {cross_of(r, p, s).normalized(), cross_of(s, q, r).normalized()};
  if (normals[0].dot(normals[1]) < -0.2) return false;
  if (std::min(height_ratio(r, p, s), height_ratio(s, q, r)) < room_.height) return false;
  for (int side = 0; side < 2; ++side) {
    const SurfacePoint below = surface_.nearest((r + s + (side == 0 ? p : q)) / 3);
    if (face_normals_[below.face_index].dot(normals[side]) < 0.3) return false;
  }
  return true;
}

void Retiling::flip_towards_surface(const std::vector<char>& active) {
  for (std::size_t i = 0; i < mesh_.n_edges(); ++i) {
    const EdgeHandle e(static_cast<int>(i));
    const HalfedgeHandle h = mesh_.halfedge_handle(e, 0);
    if (active[mesh_.from_vertex_handle(h).idx()] && active[mesh_.to_vertex_handle(h).idx()] &&
        may_flip_towards_surface(e))
      mesh_.flip(e);
  }
}

}  // namespace shellgrid
