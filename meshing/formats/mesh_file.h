// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <map>
#include <string>

#include "meshing/core/triangle_mesh.h"

namespace shellgrid {

// Reads a mesh by its extension: .ply (ASCII, both binary orders), .obj, .off, .stl (ASCII and
// binary; corners at equal coordinates become one vertex). Polygons are fanned into triangles. Float vertex properties
// of a PLY file other than x y z are kept. Throws: InputError, one line, for an empty, truncated or malformed file, a
// header that promises more than the file holds, an index out of range, coordinates that are not finite.
AttributedMesh read_mesh(const std::string& path);
// The same, but the file may hold points without faces.
AttributedMesh read_points(const std::string& path);

// Writes binary little-endian PLY: double x y z, float properties in their order, int triangles.
// Properties named red, green, blue become uchar, clamped to 0…255. Deterministic bytes; written atomically.
// notes: a word and a line of text each, comments "shellgrid WORD TEXT".
void write_ply(const std::string& path, const AttributedMesh& mesh,
               const std::map<std::string, std::string>& notes = {});
// The notes of a PLY file; none of other files. Throws: InputError where it cannot be read.
std::map<std::string, std::string> read_notes(const std::string& path);

// Faceless points with properties, for views.
void write_point_ply(const std::string& path, const VertexMatrix& points,
                     const std::vector<VertexProperty>& properties);

}  // namespace shellgrid
