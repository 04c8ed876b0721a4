// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <algorithm>

#include "meshing/core/progress.h"
#include "meshing/core/triangle_mesh.h"
#include "meshing/surface/repair.h"
#include "meshing/surface/rewrap.h"
#include "meshing/surface/surface_quality.h"

namespace shellgrid {

struct PrepareOptions {
  double size = 0;            // longest edge of the bounding box, mm; 0 keeps the file's units
  double spacing = 0.4;       // mean edge length of the retiled surface, mm
  double feature_angle = 45;  // degrees; see RetileOptions
  bool close_holes = false;
  // Resolution of a wrap that takes the input's place, mm in the result, or as a share of the bounding box's longest
  // edge; 0: none. See rewrap_surface.
  double rewrap = 0, rewrap_share = 0;
  bool retile = true;
  double longest_edge = 0;  // of triangles that are not retiled: longer edges are split, mm; 0: none
};

struct PreparedSurface {
  TriangleMesh mesh;  // closed, oriented, one component, centred on the origin
  RepairReport repair;
  RewrapReport rewrap;  // lengths in mm of the result; resolution 0: not rewrapped
  EdgeStatistics edges;
  int genus = 0;
  double volume = 0;            // mm³
  double scale = 1;             // output length over input length
  double to_input = 0;          // sampled distance from the result to the repaired input or the wrap, mm
  double from_input = 0;        // and back, mm
  double refined_edge = 0;      // length to which edges were shortened in places, mm; 0: nowhere
  CreaseFigures creases;        // of the repaired input, kept by the result
  int retiling_attempts = 0;    // 0: not retiled
  bool kept_triangles = false;  // the repaired triangles were only subdivided, because retiling crossed itself
  double farthest() const { return std::max(to_input, from_input); }
};

// Repairs, scales, centres and retiles a mesh. Where the retiled surface intersects itself it is tried again with
// finer spacing around the crossings, and at last the repaired triangles are only subdivided, with a warning. Where it
// is farther than 0.3 spacings from the input it is tried again with finer spacing there, a few times.
// Throws: InputError, as repair_surface; for a spacing too coarse for the object.
PreparedSurface prepare_surface(const TriangleMesh& mesh, const PrepareOptions& options,
                                Progress& progress = no_progress());

}  // namespace shellgrid
