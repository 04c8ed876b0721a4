// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <vector>

#include "meshing/core/triangle_mesh.h"
#include "meshing/core/vec.h"

namespace shellgrid {

// Inside flags of a closed surface on a regular lattice of samples, and between which neighbouring samples the surface
// passes: two samples inside with the surface between them belong to parts that only come near each other.
struct SampleRaster {
  static constexpr std::uint8_t inside_bit = 8;  // bits 0–2: the surface passes towards +x, +y, +z

  Vec3 lower = Vec3::Zero();  // corner of sample (0, 0, 0)'s cube
  double spacing = 1;         // of samples
  Vec3i size = Vec3i::Zero();
  std::vector<std::uint8_t> flags;

  std::uint8_t at(const Vec3i& s) const {
    if ((s.array() < 0).any() || (s.array() >= size.array()).any()) return 0;
    return flags[index(s)];
  }
  bool inside(const Vec3i& s) const { return at(s) & inside_bit; }
  std::size_t index(const Vec3i& s) const {
    return (static_cast<std::size_t>(s.x()) * size.y() + s.y()) * size.z() + s.z();
  }
  Vec3 centre(const Vec3i& s) const { return lower + spacing * (s.cast<double>() + Vec3::Constant(0.5)); }
};

// By the parity of crossings along columns of samples, one pass for each axis; inside flags are the z axis's.
SampleRaster rasterize(const TriangleMesh& surface, const Vec3& lower, double spacing, const Vec3i& size);

}  // namespace shellgrid
