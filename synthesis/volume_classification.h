// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "meshing/core/scalar_volume.h"
#include "synthesis/material_sample.h"

namespace shellgrid {

// What a measured value means. From `from` to `to` a place is all of this; between one class and the next it is a
// mixture of both, linear in the value: a place half way holds half of each.
struct VoxelClass {
  double from = 0, to = 0;
  Material material;
  bool free = false;  // free space
};

struct ClassificationOptions {
  std::vector<VoxelClass> classes;  // by rising value
  double voxel = 0;                 // edge of the sample's voxels, mm; 0: the volume's finest spacing
  double ior = 1.5;
  int down = 2;         // the volume's axis that is the sample's depth: 0, 1, 2
  bool descend = true;  // whether depth grows along that axis; else against it
  bool mirror = false;  // beside its mirror images, so that it tiles: twice as wide and high [STF §8]
  // Whether a border between two classes that are no neighbours by value is told from the classes between them: by the
  // values where the border begins and ends, along the gradient. Source: [Sereda2006 §3].
  bool trace_borders = true;
  double surface = 0.5;  // the share of material at which the mesostructure surface lies, 0 … 1
};

struct ClassificationResult {
  MaterialSample sample;
  std::vector<double> shares;  // of the whole block in each class, partial volumes counted
  double enclosed_free = 0;    // share of free space that the outside does not reach: bubbles
};

// A base volume of a measured one: each voxel's composition by the opacity transfer function of its classes (the mean
// over the measured places that the voxel covers, or trilinear between them), coefficients averaged by composition, the
// outermost isosurface of the material's share as the mesostructure surface. Free space that is not reached from the
// top becomes matter that hardly extinguishes. Axes besides the depth keep their order. Source: [Levoy1988 §3], [STF
// §5.1]. Deviates: opacity is not weighted by the gradient's magnitude, which would thin the interiors; partial volumes
// say the same at borders. Throws: InputError for classes out of order, a volume too small or large, no material at
// all.
ClassificationResult classify_volume(const ScalarVolume& volume, const ClassificationOptions& options);

}  // namespace shellgrid
