// SPDX-License-Identifier: AGPL-3.0-or-later
// Where in a periodic slab many collisions can be taken at once: in homogeneous matter of many mean free paths.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "meshing/core/vec.h"
#include "solvers/transport/diffuse_leap.h"

namespace shellgrid {

struct SlabMatter {
  Float4 extinction = {}, albedo = {}, anisotropy = {};  // mm⁻¹
  bool operator==(const SlabMatter& other) const;
};

class SlabLeaps {
 public:
  SlabLeaps() = default;
  // Voxels (i, j, k) with i fastest, k downwards; the slab repeats along i and j. `whole`: all of the voxel is matter,
  // and no surface is in it.
  SlabLeaps(const Vec3i& size, double voxel, const std::vector<SlabMatter>& matter, const std::vector<char>& whole);

  // Null: there no leap is possible.
  const ChannelLeaps* at(std::size_t voxel_index) const {
    if (kind_.empty() || kind_[voxel_index] < 0) return nullptr;
    return &leaps_[kind_[voxel_index]];
  }
  // How far at least it is from a point of that voxel to other matter, a surface or the slab's top and bottom, mm.
  double clearance(std::size_t voxel_index, const Vec3& point) const;

 private:
  Vec3i size_ = Vec3i::Zero();
  double voxel_ = 1;
  std::vector<std::int32_t> kind_;  // per voxel; −1: none. Empty: no voxel has any
  // About a voxel, so many voxels of the same matter: of all neighbours alike, or beside, above and below.
  struct Reach {
    std::uint16_t around = 0, beside = 0, above = 0, below = 0;
  };
  std::vector<Reach> reaches_;
  std::vector<ChannelLeaps> leaps_;
};

}  // namespace shellgrid
