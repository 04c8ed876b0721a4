// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/surface/repair.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

// One face's use of an edge a < b.
struct EdgeUse {
  std::int32_t a, b;
  std::int32_t face;
  bool forward;  // the face runs from a to b
};

// All uses, sorted by edge, then face.
std::vector<EdgeUse> collect_edges(const FaceMatrix& faces) {
  std::vector<EdgeUse> uses;
  uses.reserve(3 * static_cast<std::size_t>(faces.rows()));
  for (Eigen::Index f = 0; f < faces.rows(); ++f)
    for (int k = 0; k < 3; ++k) {
      const std::int32_t u = faces(f, k), v = faces(f, (k + 1) % 3);
      uses.push_back({std::min(u, v), std::max(u, v), static_cast<std::int32_t>(f), u < v});
    }
  std::sort(uses.begin(), uses.end(), [](const EdgeUse& x, const EdgeUse& y) {
    if (x.a != y.a) return x.a < y.a;
    if (x.b != y.b) return x.b < y.b;
    return x.face < y.face;
  });
  return uses;
}

// Calls visit(first use, count) for each edge.
template <class Visit>
void for_each_edge(const std::vector<EdgeUse>& uses, const Visit& visit) {
  for (std::size_t begin = 0, end; begin < uses.size(); begin = end) {
    end = begin + 1;
    while (end < uses.size() && uses[end].a == uses[begin].a && uses[end].b == uses[begin].b) ++end;
    visit(&uses[begin], static_cast<int>(end - begin));
  }
}

class DisjointSets {
 public:
  explicit DisjointSets(std::size_t count) : parent_(count) { std::iota(parent_.begin(), parent_.end(), 0); }
  int find(int i) {
    while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
    return i;
  }
  void unite(int i, int j) {
    i = find(i), j = find(j);
    if (i != j) parent_[std::max(i, j)] = std::min(i, j);
  }

 private:
  std::vector<int> parent_;
};

std::string at(const Vec3& p) { return fmt::format("({:.6g}, {:.6g}, {:.6g})", p.x(), p.y(), p.z()); }

std::string counted(int count, const char* one, const char* many) {
  return fmt::format("{} {}", count, count == 1 ? one : many);
}

// Keeps the faces marked, in their order.
void keep_faces(TriangleMesh& mesh, const std::vector<char>& keep) {
  Eigen::Index kept = 0;
  for (Eigen::Index f = 0; f < mesh.faces.rows(); ++f)
    if (keep[f]) mesh.faces.row(kept++) = mesh.faces.row(f).eval();
  mesh.faces.conservativeResize(kept, 3);
}

int merge_equal_vertices(TriangleMesh& mesh) {
  const int n = mesh.vertex_count();
  mesh.vertices.array() += 0.0;  // −0 becomes 0
  std::vector<int> order(n), target(n);
  std::iota(order.begin(), order.end(), 0);
  const auto compare = [&](int i, int j) {
    for (int axis = 0; axis < 3; ++axis)
      if (mesh.vertices(i, axis) != mesh.vertices(j, axis)) return mesh.vertices(i, axis) < mesh.vertices(j, axis);
    return i < j;
  };
  std::sort(order.begin(), order.end(), compare);
  int merged = 0;
  for (int i = 0; i < n; ++i) {
    const bool same = i > 0 && mesh.vertices.row(order[i]) == mesh.vertices.row(order[i - 1]);
    target[order[i]] = same ? target[order[i - 1]] : order[i];
    merged += same;
  }
  for (Eigen::Index f = 0; f < mesh.faces.rows(); ++f)
    for (int k = 0; k < 3; ++k) mesh.faces(f, k) = target[mesh.faces(f, k)];
  return merged;
}

int drop_repeated_faces(TriangleMesh& mesh) {
  const int m = mesh.face_count();
  std::vector<std::array<std::int32_t, 4>> keys(m);
  for (int f = 0; f < m; ++f) {
    keys[f] = {mesh.faces(f, 0), mesh.faces(f, 1), mesh.faces(f, 2), f};
    std::sort(keys[f].begin(), keys[f].begin() + 3);
  }
  std::sort(keys.begin(), keys.end());
  std::vector<char> keep(m, 1);
  int dropped = 0;
  for (int i = 0; i < m; ++i) {
    const auto& [a, b, c, f] = keys[i];
    const bool degenerate = a == b || b == c;
    const bool doubled = i > 0 && std::equal(keys[i].begin(), keys[i].begin() + 3, keys[i - 1].begin());
    if (degenerate || doubled) keep[f] = 0, ++dropped;
  }
  keep_faces(mesh, keep);
  return dropped;
}

int drop_unreferenced_vertices(TriangleMesh& mesh) {
  std::vector<int> index(mesh.vertex_count(), -1);
  for (Eigen::Index f = 0; f < mesh.faces.rows(); ++f)
    for (int k = 0; k < 3; ++k) index[mesh.faces(f, k)] = 0;
  int kept = 0;
  for (int v = 0; v < mesh.vertex_count(); ++v)
    if (index[v] == 0) {
      mesh.vertices.row(kept) = mesh.vertices.row(v).eval();
      index[v] = kept++;
    }
  const int dropped = mesh.vertex_count() - kept;
  mesh.vertices.conservativeResize(kept, 3);
  for (Eigen::Index f = 0; f < mesh.faces.rows(); ++f)
    for (int k = 0; k < 3; ++k) mesh.faces(f, k) = index[mesh.faces(f, k)];
  return dropped;
}

// The corner opposite the longest edge where a face's height is below 1e-10 of that edge, else −1.
int flat_corner(const TriangleMesh& mesh, int face) {
  const Vec3 a = mesh.corner(face, 0), b = mesh.corner(face, 1), c = mesh.corner(face, 2);
  const std::array<double, 3> opposite = {(c - b).squaredNorm(), (a - c).squaredNorm(), (b - a).squaredNorm()};
  const int k = static_cast<int>(std::max_element(opposite.begin(), opposite.end()) - opposite.begin());
  return (b - a).cross(c - a).norm() < 1e-10 * opposite[k] ? k : -1;
}

// Flips the longest edge of faces without area, so that their corner splits the neighbour.
int flip_flat_faces(TriangleMesh& mesh) {
  int flipped = 0;
  for (int round = 0; round < 20; ++round) {
    std::vector<int> flat;
    for (int f = 0; f < mesh.face_count(); ++f)
      if (flat_corner(mesh, f) >= 0) flat.push_back(f);
    if (flat.empty()) break;
    const std::vector<EdgeUse> uses = collect_edges(mesh.faces);
    std::vector<char> touched(mesh.face_count(), 0);
    std::vector<char> keep(mesh.face_count(), 1);
    int changed = 0;
    const auto edge_range = [&](int u, int v) {
      const EdgeUse key{std::min(u, v), std::max(u, v), 0, true};
      return std::equal_range(uses.begin(), uses.end(), key,
                              [](const EdgeUse& x, const EdgeUse& y) { return x.a != y.a ? x.a < y.a : x.b < y.b; });
    };
    for (const int f : flat) {
      if (touched[f]) continue;
      const int k = flat_corner(mesh, f);
      const int c = mesh.faces(f, k), a = mesh.faces(f, (k + 1) % 3), b = mesh.faces(f, (k + 2) % 3);
      const auto [begin, end] = edge_range(a, b);
      if (end - begin != 2) continue;
      const int other = begin->face == f ? (begin + 1)->face : begin->face;
      if (touched[other]) continue;
      int d = -1;
      bool same_way = false;
      for (int j = 0; j < 3; ++j) {
        const int u = mesh.faces(other, j), v = mesh.faces(other, (j + 1) % 3);
        if (u != a && u != b) d = u;
        if (u == a && v == b) same_way = true;
      }
      const auto [existing, existing_end] = edge_range(c, d);
      if (d < 0 || c == d || same_way || existing != existing_end) continue;
      mesh.faces.row(f) << c, a, d;
      mesh.faces.row(other) << d, b, c;
      touched[f] = touched[other] = 1;
      ++changed;
    }
    flipped += changed;
    if (changed == 0) break;
  }
  return flipped;
}

// Turns faces so that neighbours across two-sided edges agree with the lowest face of their component. Components then
// look outward each for itself.
int turn_faces(TriangleMesh& mesh) {
  const int m = mesh.face_count();
  struct Link {
    int face = -1;
    bool agrees = true;
  };
  std::vector<std::array<Link, 3>> links(m);
  std::vector<int> used(m, 0);
  for_each_edge(collect_edges(mesh.faces), [&](const EdgeUse* use, int count) {
    if (count != 2) return;
    const bool agrees = use[0].forward != use[1].forward;
    links[use[0].face][used[use[0].face]++] = {use[1].face, agrees};
    links[use[1].face][used[use[1].face]++] = {use[0].face, agrees};
  });
  std::vector<signed char> turn(m, -1);
  std::vector<int> component;
  int turned = 0;
  for (int seed = 0; seed < m; ++seed) {
    if (turn[seed] >= 0) continue;
    component.assign(1, seed);
    turn[seed] = 0;
    for (std::size_t i = 0; i < component.size(); ++i)
      for (const Link& link : links[component[i]])
        if (link.face >= 0 && turn[link.face] < 0) {
          turn[link.face] = static_cast<signed char>(turn[component[i]] ^ (link.agrees ? 0 : 1));
          component.push_back(link.face);
        }
    double volume = 0;
    const Vec3 centre = mesh.corner(seed, 0);
    for (const int f : component) {
      const Vec3 a = mesh.corner(f, 0) - centre, b = mesh.corner(f, 1) - centre, c = mesh.corner(f, 2) - centre;
      volume += (turn[f] ? -1 : 1) * a.dot(b.cross(c));
    }
    for (const int f : component)
      if ((turn[f] != 0) != (volume < 0)) {
        std::swap(mesh.faces(f, 1), mesh.faces(f, 2));
        ++turned;
      }
  }
  return turned;
}

// Fills every loop of boundary edges. Faces already agree.
int fill_holes(TriangleMesh& mesh) {
  const std::vector<EdgeUse> uses = collect_edges(mesh.faces);
  std::vector<int> next(mesh.vertex_count(), -1);
  std::vector<char> branching(mesh.vertex_count(), 0);
  for_each_edge(uses, [&](const EdgeUse* use, int count) {
    if (count != 1) return;
    // The hole's side of the edge runs against the face's.
    const int from = use->forward ? use->b : use->a, to = use->forward ? use->a : use->b;
    if (next[from] >= 0) branching[from] = 1;
    next[from] = to;
  });
  const auto has_edge = [&](int u, int v) {
    const auto at = std::lower_bound(
        uses.begin(), uses.end(), std::minmax(u, v),
        [](const EdgeUse& x, const auto& edge) { return x.a != edge.first ? x.a < edge.first : x.b < edge.second; });
    return at != uses.end() && at->a == std::min(u, v) && at->b == std::max(u, v);
  };
  std::vector<Eigen::Vector3i> patches;
  std::vector<Vec3> centres;
  int closed = 0;
  for (int start = 0; start < mesh.vertex_count(); ++start) {
    if (next[start] < 0) continue;
    std::vector<int> loop;
    bool simple = true;
    int v = start;
    while (next[v] >= 0) {
      simple = simple && !branching[v];
      loop.push_back(v);
      const int following = next[v];
      next[v] = -1;
      v = following;
    }
    if (v != start || !simple || loop.size() < 3) continue;
    std::vector<Vec3> polyline;
    for (const int i : loop) polyline.push_back(mesh.vertex(i));
    const int size = static_cast<int>(loop.size());
    std::vector<Eigen::Vector3i> patch = triangulate_hole(polyline);
    bool usable = !patch.empty(), keeps_sense = false;
    for (const Eigen::Vector3i& t : patch)
      for (int k = 0; k < 3; ++k) {
        const int u = t[k], v = t[(k + 1) % 3];
        // The triangulation keeps the polyline's sense or reverses it as a whole.
        keeps_sense |= u == 0 && v == 1;
        const bool on_loop = (u + 1) % size == v || (v + 1) % size == u;
        usable &= on_loop || !has_edge(loop[u], loop[v]);
      }
    if (usable) {
      for (const Eigen::Vector3i& t : patch)
        patches.emplace_back(loop[t[0]], loop[keeps_sense ? t[1] : t[2]], loop[keeps_sense ? t[2] : t[1]]);
    } else {  // the patch would meet edges that are there already: a fan about the middle meets none
      Vec3 sum = Vec3::Zero();
      for (const Vec3& p : polyline) sum += p;
      const int centre = mesh.vertex_count() + static_cast<int>(centres.size());
      centres.push_back(sum / size);
      for (int i = 0; i < size; ++i) patches.emplace_back(loop[i], loop[(i + 1) % size], centre);
    }
    ++closed;
  }
  const Eigen::Index first_centre = mesh.vertices.rows();
  mesh.vertices.conservativeResize(first_centre + static_cast<Eigen::Index>(centres.size()), 3);
  for (std::size_t i = 0; i < centres.size(); ++i)
    mesh.vertices.row(first_centre + static_cast<Eigen::Index>(i)) = centres[i].transpose();
  const Eigen::Index first = mesh.faces.rows();
  mesh.faces.conservativeResize(first + static_cast<Eigen::Index>(patches.size()), 3);
  for (std::size_t i = 0; i < patches.size(); ++i)
    mesh.faces.row(first + static_cast<Eigen::Index>(i)) = patches[i].transpose();
  return closed;
}

double box_diagonal(const TriangleMesh& mesh) {
  if (mesh.vertex_count() == 0) return 0;
  return (mesh.vertices.colwise().maxCoeff() - mesh.vertices.colwise().minCoeff()).norm();
}

void require_sound(const TriangleMesh& mesh) {
  if (mesh.face_count() == 0 || mesh.vertex_count() == 0) throw InputError("the mesh has no faces");
  if (!mesh.vertices.allFinite()) throw InputError("the mesh has coordinates that are not finite numbers");
  if (mesh.faces.minCoeff() < 0 || mesh.faces.maxCoeff() >= mesh.vertex_count())
    throw InputError("the mesh has a face index out of range");
}

void require_not_flat(const TriangleMesh& mesh) {
  const double diagonal = box_diagonal(mesh);
  if (!(std::abs(enclosed_volume(mesh)) > 1e-9 * diagonal * diagonal * diagonal))
    throw InputError(fmt::format("the mesh is flat: it encloses no volume (box diagonal {:.6g})", diagonal));
}

void refuse_defects(const TriangleMesh& mesh, const SurfaceDefects& defects, bool several_components,
                    const std::string& holes_advice, const std::string& advice) {
  if (defects.non_manifold_edges > 0)
    throw InputError(fmt::format("{}, first at {}; expected two faces at every edge{}",
                                 counted(defects.non_manifold_edges, "non-manifold edge", "non-manifold edges"),
                                 at(defects.non_manifold_edge_at), advice));
  if (defects.boundary_edges > 0)
    throw InputError(fmt::format("{}, first at {}; expected a closed surface{}",
                                 counted(defects.boundary_edges, "boundary edge", "boundary edges"),
                                 at(defects.boundary_at), holes_advice));
  if (defects.misoriented_edges > 0)
    throw InputError(
        fmt::format("{} between faces that look opposite ways, first at {}; expected an oriented surface{}",
                    counted(defects.misoriented_edges, "edge", "edges"), at(defects.misoriented_at), advice));
  if (defects.non_manifold_vertices > 0)
    throw InputError(fmt::format("{}, first at {}; expected one fan of faces at every vertex{}",
                                 counted(defects.non_manifold_vertices, "non-manifold vertex", "non-manifold vertices"),
                                 at(defects.non_manifold_vertex_at), advice));
  if (defects.components > 1 && !several_components)
    throw InputError(fmt::format("{} components, the second at {}; expected one connected surface{}",
                                 defects.components, at(defects.second_component_at), advice));
  require_not_flat(mesh);
}

}  // namespace

double enclosed_volume(const TriangleMesh& mesh) {
  if (mesh.face_count() == 0) return 0;
  const Vec3 centre = mesh.corner(0, 0);
  return parallel_sum(mesh.face_count(), 0.0, [&](std::size_t f) {
    const int face = static_cast<int>(f);
    return (mesh.corner(face, 0) - centre).dot((mesh.corner(face, 1) - centre).cross(mesh.corner(face, 2) - centre)) /
           6;
  });
}

int genus(const TriangleMesh& mesh) {
  // A closed triangle mesh has 3/2 edges a face.
  return 1 - (mesh.vertex_count() - mesh.face_count() / 2) / 2;
}

SurfaceDefects find_defects(const TriangleMesh& mesh) {
  SurfaceDefects defects;
  DisjointSets corners(3 * static_cast<std::size_t>(mesh.face_count()));
  DisjointSets faces(mesh.face_count());
  const auto corner_of = [&](int face, int vertex) {
    int k = 0;
    while (mesh.faces(face, k) != vertex) ++k;
    return 3 * face + k;
  };
  for_each_edge(collect_edges(mesh.faces), [&](const EdgeUse* use, int count) {
    const Vec3 middle = 0.5 * (mesh.vertex(use->a) + mesh.vertex(use->b));
    for (int i = 1; i < count; ++i) faces.unite(use[0].face, use[i].face);
    if (count == 1 && defects.boundary_edges++ == 0) defects.boundary_at = middle;
    if (count > 2 && defects.non_manifold_edges++ == 0) defects.non_manifold_edge_at = middle;
    if (count != 2) return;
    if (use[0].forward == use[1].forward && defects.misoriented_edges++ == 0) defects.misoriented_at = middle;
    for (const int v : {use->a, use->b}) corners.unite(corner_of(use[0].face, v), corner_of(use[1].face, v));
  });
  std::vector<int> fan(mesh.vertex_count(), -1);
  std::vector<char> counted_already(mesh.vertex_count(), 0);
  for (int f = 0; f < mesh.face_count(); ++f) {
    if (faces.find(f) == f && defects.components++ == 1) defects.second_component_at = mesh.corner(f, 0);
    for (int k = 0; k < 3; ++k) {
      const int v = mesh.faces(f, k), root = corners.find(3 * f + k);
      if (fan[v] < 0) fan[v] = root;
      if (fan[v] == root || counted_already[v]) continue;
      counted_already[v] = 1;
      if (defects.non_manifold_vertices++ == 0) defects.non_manifold_vertex_at = mesh.vertex(v);
    }
  }
  return defects;
}

void require_closed_surface(const TriangleMesh& mesh, bool several_components) {
  require_sound(mesh);
  refuse_defects(mesh, find_defects(mesh), several_components, "; try sg-prepare --close-holes or --rewrap",
                 "; try sg-prepare --rewrap");
  if (enclosed_volume(mesh) < 0) throw InputError("the mesh's faces look inward; try sg-prepare, which turns them");
}

void require_outward_triangles(const TriangleMesh& mesh) {
  require_sound(mesh);
  require_not_flat(mesh);
  if (enclosed_volume(mesh) < 0) throw InputError("the mesh's faces look inward; try sg-prepare, which turns them");
}

TriangleMesh repair_surface(const TriangleMesh& input, bool close_holes, RepairReport& report, Progress& progress) {
  require_sound(input);
  TriangleMesh mesh = input;
  report.merged_vertices = merge_equal_vertices(mesh);
  report.dropped_faces = drop_repeated_faces(mesh);
  report.turned_faces = turn_faces(mesh);
  report.flattened_faces = flip_flat_faces(mesh);
  report.unreferenced_vertices = drop_unreferenced_vertices(mesh) - report.merged_vertices;
  if (mesh.face_count() == 0) throw InputError("every face of the mesh is degenerate");
  if (close_holes) {
    report.closed_holes = fill_holes(mesh);
    if (report.closed_holes > 0) {
      report.turned_faces += turn_faces(mesh);
      progress.warn(fmt::format("closed {}", counted(report.closed_holes, "hole", "holes")));
    }
  }
  const SurfaceDefects defects = find_defects(mesh);
  if (defects.boundary_edges == 0 || defects.components == 1) {
    // A sheet without thickness is flat before it is open.
    const Vec3 extent = (mesh.vertices.colwise().maxCoeff() - mesh.vertices.colwise().minCoeff()).transpose();
    if (extent.minCoeff() <= 1e-12 * extent.maxCoeff()) require_not_flat(mesh);
  }
  refuse_defects(mesh, defects, false,
                 close_holes ? " after closing holes; try --rewrap" : "; try --close-holes or --rewrap",
                 "; try --rewrap");
  for (int f = 0; f < mesh.face_count(); ++f)
    if (flat_corner(mesh, f) >= 0)
      throw InputError(fmt::format("a triangle without area that cannot be flipped away, at {}; try --rewrap",
                                   at(mesh.corner(f, 0))));
  const SelfIntersections crossings = find_self_intersections(mesh);
  if (crossings.pairs > 0)
    throw InputError(
        fmt::format("{} of triangles intersect, first at {}; expected a surface that does not cross itself; "
                    "try --rewrap",
                    counted(crossings.pairs, "pair", "pairs"), at(crossings.at)));
  return mesh;
}

}  // namespace shellgrid
