// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <string>
#include <vector>

#include "meshing/core/vec.h"

namespace shellgrid {

// A triangle mesh. Faces are counter-clockwise seen from outside.
struct TriangleMesh {
  VertexMatrix vertices;  // n×3, mm
  FaceMatrix faces;       // m×3, indices into vertices

  int vertex_count() const { return static_cast<int>(vertices.rows()); }
  int face_count() const { return static_cast<int>(faces.rows()); }
  Vec3 vertex(int vertex_index) const { return vertices.row(vertex_index).transpose(); }
  Vec3 corner(int face_index, int k) const { return vertices.row(faces(face_index, k)).transpose(); }
};

// One value per vertex under a name that files carry: MeshLab's `quality`, `s`, `t`, ours `texture_u`.
struct VertexProperty {
  std::string name;
  std::vector<float> values;  // n
};

// A mesh and what is known at its vertices: what one PLY file holds.
struct AttributedMesh {
  TriangleMesh mesh;
  std::vector<VertexProperty> properties;

  // The property of that name, or null.
  const std::vector<float>* find(const std::string& name) const {
    for (const VertexProperty& property : properties)
      if (property.name == name) return &property.values;
    return nullptr;
  }
};

}  // namespace shellgrid
