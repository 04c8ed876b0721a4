// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <vector>

#include "meshing/core/progress.h"
#include "meshing/core/triangle_mesh.h"

namespace shellgrid {

// What repair changed.
struct RepairReport {
  int merged_vertices = 0;        // at equal coordinates, into the one of lowest index
  int dropped_faces = 0;          // with a repeated corner, or on the same three corners as an earlier one
  int flattened_faces = 0;        // of no area, flipped away
  int unreferenced_vertices = 0;  // dropped
  int turned_faces = 0;           // to agree with their neighbours and to look outward
  int closed_holes = 0;
};

// What keeps a mesh from bounding a solid: counts, and where the first of each is.
struct SurfaceDefects {
  int boundary_edges = 0, non_manifold_edges = 0, non_manifold_vertices = 0, misoriented_edges = 0;
  int components = 0;
  Vec3 boundary_at = Vec3::Zero(), non_manifold_edge_at = Vec3::Zero(), non_manifold_vertex_at = Vec3::Zero();
  Vec3 misoriented_at = Vec3::Zero(), second_component_at = Vec3::Zero();
};

// Two triangles that meet where they should not.
struct SelfIntersections {
  int pairs = 0;
  Vec3 at = Vec3::Zero();                       // a corner of the first pair
  std::vector<std::pair<int, int>> face_pairs;  // sorted
};

// Makes a closed, oriented surface of a mesh: merges vertices at equal coordinates, drops degenerate and doubled
// faces and unreferenced vertices, turns faces to agree, looks outward, and closes holes where asked.
// Throws: InputError, one line with counts and one location, for a mesh that is empty, flat, open, not manifold, not
// orientable, of several components or self-intersecting after that.
TriangleMesh repair_surface(const TriangleMesh& mesh, bool close_holes, RepairReport& report,
                            Progress& progress = no_progress());

// Counts a mesh's defects by connectivity alone.
SurfaceDefects find_defects(const TriangleMesh& mesh);

// Pairs of triangles that intersect other than in their shared corners and edges, by exact predicates. Where faces are
// marked (m), only pairs with a marked one. A triangle without area counts as a pair with itself, and in no other.
// Neighbours folded onto each other count where the angle between them, in radians, is less than least_angle.
SelfIntersections find_self_intersections(const TriangleMesh& mesh, const std::vector<char>& marked = {},
                                          double least_angle = 0);

// The angle between neighbours below which the rounding of coordinates, or a tetrahedral mesher, takes them for
// crossing.
constexpr double folded_flat = 1e-5;

// Throws InputError unless the mesh is closed, manifold, consistently oriented and looking outward; one component
// unless `several_components`. Self-intersection is not looked at.
void require_closed_surface(const TriangleMesh& mesh, bool several_components = false);

// Throws InputError unless the mesh has faces of finite corners, and encloses more than nothing by its triangles'
// signed volume.
void require_outward_triangles(const TriangleMesh& mesh);

// Volume enclosed, mm³; negative where faces look inward.
double enclosed_volume(const TriangleMesh& mesh);

// Handles of a closed connected surface: 1 − (vertices − edges + faces)/2.
int genus(const TriangleMesh& mesh);

// Triangles that fill the hole bounded by a closed polyline, as indices into it; empty where none was found.
std::vector<Eigen::Vector3i> triangulate_hole(const std::vector<Vec3>& polyline);

}  // namespace shellgrid
