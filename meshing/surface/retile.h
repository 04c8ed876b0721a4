// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "meshing/core/progress.h"
#include "meshing/core/triangle_mesh.h"

namespace shellgrid {

// Around these points edges shorten to `factor` times the spacing, within `core` spacings; farther off they grow, and
// from `reach` spacings on they are as elsewhere.
struct Refinement {
  std::vector<Vec3> at;
  double factor = 1, core = 0, reach = 4;
};

struct RetileOptions {
  double spacing = 0.4;       // mean edge length asked for, mm
  double feature_angle = 45;  // degrees between face normals beyond which an edge is sharp; 180: none
  int iterations = 6;         // rounds of splitting, collapsing, flipping and relaxing
  std::vector<Refinement> refinements;
};

// Retiles a closed surface with nearly equilateral triangles whose mean edge is the spacing. Vertices stay on the input
// surface; chains of sharp edges longer than ten spacings are kept. Vertices and faces come in Morton order.
// Source: [BotschKobbelt2004 §4].
// Deviates: the target length follows the measured mean edge from round to round, so that the mean and not the
// thresholds meet the spacing. The result may intersect itself where the surface is finer than the spacing: check it.
TriangleMesh retile_surface(const TriangleMesh& mesh, const RetileOptions& options, Progress& progress = no_progress());

// Splits edges longer than `longest` at their middles until there are none; the surface itself does not change.
TriangleMesh subdivide_long_edges(const TriangleMesh& mesh, double longest);

// Orders vertices along a Morton curve and faces by their lowest vertex, so that neighbours in space are neighbours in
// memory.
TriangleMesh order_by_position(const TriangleMesh& mesh);

}  // namespace shellgrid
