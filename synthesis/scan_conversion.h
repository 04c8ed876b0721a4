// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "meshing/core/triangle_mesh.h"
#include "synthesis/material_sample.h"

namespace shellgrid {

// Where a part's mesh stands: p ↦ turn · (scale ∘ p) + position.
struct PartPlacement {
  Vec3 position = Vec3::Zero();  // mm
  Mat3 turn = Mat3::Identity();
};

// One body of a modelled sample, or, where `free`, what is taken out of the bodies below it.
struct ScanPart {
  TriangleMesh mesh;  // closed, outward; empty: the half-space z ≤ 0
  Vec3 scale = Vec3::Ones();
  std::vector<PartPlacement> placements = {PartPlacement()};
  Material material;
  bool free = false;
  int priority = 0;  // where parts overlap the highest one counts; of equal ones the later
  double ior = 0;    // refractive index where this part makes the surface; 0: the sample's
};

struct ScanOptions {
  int width = 96, height = 96;  // n_x, n_y
  double voxel = 0.4;           // mm
  double thickness = 4;         // mm
  double ior = 1.5;
  double top = 0;            // z of the sample's top, mm; the sample's depth runs down from there
  int samples_per_edge = 4;  // of a voxel, for partial volumes: 1 … 8
};

struct ScanResult {
  MaterialSample sample;
  double above_top = 0;      // height of what stands above the top and is cut off, mm
  std::vector<int> unused;   // parts with matter that own no place of the sample
  double lost_material = 0;  // share of the material in voxels that are less than half full, and so are free space
};

// The highest z of the bodies, mm: where a sample's top may lie. Half-spaces and free parts count too where there is
// nothing else.
double highest_point(const std::vector<ScanPart>& parts);

// Scan conversion: x and y of the parts are the sample's, in mm, and wrap around after its width and height, so that
// the sample tiles exactly whatever stands across its border; z points up. Each voxel is asked at `samples_per_edge`³
// places which part it lies in; a voxel at least half in material is material, its coefficients averages by volume over
// the parts in it, the other voxels free space. Normals are the gradient of the signed distance to the composed bodies.
// Source: [STF §5.1].
// Throws: InputError for a mesh that is not closed, oriented and outward; a size out of range; no material at all.
ScanResult scan_convert(const std::vector<ScanPart>& parts, const ScanOptions& options);

}  // namespace shellgrid
