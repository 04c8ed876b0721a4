// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include "meshing/core/comparison.h"
#include "meshing/core/triangle_mesh.h"

namespace shellgrid {

// How two artefacts of one kind differ; the second is the reference.
struct ArtefactComparison {
  std::string kind;                  // "image", "volume", "grid", "mesh"
  std::vector<Comparison> figures;   // per channel, grid, array or property
  std::vector<std::string> remarks;  // what could not be compared, one line each
  // The difference at each pixel (images) or vertex (the rest): Euclidean norm over what is compared there.
  std::vector<float> difference;
  int width = 0, height = 0;  // of images
  TriangleMesh mesh;          // of meshes; points without faces of volumes and grids
};

// Compares two images (exr, png: channels of the same name), two volumes (vdb: grids of the same name and type over the
// samples active in either), two unstructured grids (hdf: points and arrays of the same name and shape) or two meshes:
// where the faces agree, positions and properties at each vertex, else the distances of each surface's vertices and
// face centres to the other, mm (their maximum is the sampled two-sided Hausdorff distance; relative to the diagonal).
// Throws: InputError for files of different kinds, sizes, frames or cells, or without anything in common.
ArtefactComparison compare_artefacts(const std::string& path, const std::string& reference_path);

// Writes the picture of the difference: for images a false-colour PNG, else a PLY with `quality` and colours. `white`
// is the difference shown brightest; 0 stands for the greatest there is. Throws: InputError for another extension.
void write_difference(const std::string& path, const ArtefactComparison& comparison, double white);

}  // namespace shellgrid
