// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/synthesis_level.h"

#include <cmath>

#include "meshing/core/parallel.h"

namespace shellgrid {

const std::array<Vec2f, SynthesisLevel::slots> SynthesisLevel::offsets = {
    Vec2f(1, 0), Vec2f(1, 1), Vec2f(0, 1), Vec2f(-1, 1), Vec2f(-1, 0), Vec2f(-1, -1), Vec2f(0, -1), Vec2f(1, -1)};

namespace {

constexpr int slots = SynthesisLevel::slots;

// Splits the level's vertices so that no vertex has a neighbour, or is one, in its own group. Greedy, in vertex order.
void color_vertices(SynthesisLevel& level, int mesh_vertices) {
  const int count = static_cast<int>(level.vertices.size());
  std::vector<std::int32_t> position(mesh_vertices, -1);
  for (int i = 0; i < count; ++i) position[level.vertices[i]] = i;
  std::vector<std::int32_t> offsets(count + 1, 0), readers(level.neighbours.size());
  const auto neighbour_of = [&](int i, int s) {
    const std::int32_t v = level.neighbours[static_cast<std::size_t>(i) * slots + s].vertex;
    return v < 0 ? -1 : position[v];
  };
  for (int i = 0; i < count; ++i)
    for (int s = 0; s < slots; ++s)
      if (const int j = neighbour_of(i, s); j >= 0) ++offsets[j + 1];
  for (int i = 0; i < count; ++i) offsets[i + 1] += offsets[i];
  std::vector<std::int32_t> fill(offsets.begin(), offsets.end() - 1);
  for (int i = 0; i < count; ++i)
    for (int s = 0; s < slots; ++s)
      if (const int j = neighbour_of(i, s); j >= 0) readers[fill[j]++] = i;
  std::vector<std::int32_t> color(count, -1), taken;
  for (int i = 0; i < count; ++i) {
    const auto mark = [&](int j) {
      if (j < 0 || j == i || color[j] < 0) return;
      taken[color[j]] = i;
    };
    taken.resize(level.groups.size(), -1);
    for (int s = 0; s < slots; ++s) mark(neighbour_of(i, s));
    for (int at = offsets[i]; at < offsets[i + 1]; ++at) mark(readers[at]);
    int free = 0;
    while (free < static_cast<int>(taken.size()) && taken[free] == i) ++free;
    if (free == static_cast<int>(taken.size())) level.groups.emplace_back(), taken.push_back(-1);
    color[i] = free;
    level.groups[free].push_back(i);
  }
}

}  // namespace

SynthesisLevel build_synthesis_level(const TexturedSurface& surface, const VertexHierarchy& hierarchy, int l,
                                     double voxel, int symmetry) {
  SynthesisLevel level;
  level.vertices = hierarchy.levels[l].vertices;
  level.neighbours.resize(level.vertices.size() * slots);
  const double step = std::ldexp(1.0, l);
  parallel_for(
      level.vertices.size(),
      [&](std::size_t i) {
        for (int s = 0; s < slots; ++s)
          level.neighbours[i * slots + s] =
              find_tangent_neighbour(surface, hierarchy.levels[l], level.vertices[i],
                                     SynthesisLevel::offsets[s].cast<double>() * step, voxel, symmetry);
      },
      64);
  color_vertices(level, surface.mesh.vertex_count());
  return level;
}

}  // namespace shellgrid
