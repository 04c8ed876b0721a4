// SPDX-License-Identifier: AGPL-3.0-or-later
// Which of many faint parallel lights places of a surface see, told by a few of them for all about.
#pragma once
#include <atomic>
#include <cstdint>
#include <memory>
#include <vector>

#include "solvers/render/scene_geometry.h"
#include "solvers/shell_texture/lazy_list.h"
#include "solvers/shell_texture/vertex_buckets.h"

namespace shellgrid {

// An environment stands as hundreds of lights, and most of them are hidden from all of a neighbourhood or from none of
// it. Each cell of the surface asks at one of its vertices; where it and the cells beside it agree on a light, so do
// the vertices in it. An obstacle that is smaller than a cell and lies between them is missed, of a light that is but
// a hundredth of all. Worked out where it is asked for. Threads may share it.
class SharedVisibility {
 public:
  // lights: unit vectors towards them. All but those must outlive this.
  SharedVisibility(const TexturedFrames& frames, const SceneGeometry& geometry, std::vector<Vec3> lights);

  // Bits of lights on which the cells about a vertex agree; of the others the vertex must ask itself. Of those below
  // its horizon nothing is said.
  struct Agreed {
    std::vector<std::uint64_t> known_words, seen_words;
    // Of lights 16 · `block` to 16 · `block` + 15.
    std::uint32_t known(std::size_t block) const { return known_words[block / 4] >> block % 4 * 16 & 0xffff; }
    std::uint32_t seen(std::size_t block) const { return seen_words[block / 4] >> block % 4 * 16 & 0xffff; }
  };
  // None where cells would hold too few vertices to gain by it.
  const Agreed* about(int vertex) const;
  std::int64_t shadow_rays() const { return shadow_rays_; }

 private:
  struct Sample {
    std::vector<std::uint64_t> seen, hidden;
  };
  const Sample& sample(int cell) const;

  TexturedFrames frames_;
  const SceneGeometry& geometry_;
  std::vector<Vec3> lights_;
  VertexBuckets cells_;
  LazyList<Sample> samples_;
  LazyList<Agreed> agreed_;
  mutable std::atomic<std::int64_t> shadow_rays_{0};
};

}  // namespace shellgrid
