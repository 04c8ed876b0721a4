// SPDX-License-Identifier: AGPL-3.0-or-later
// What every source of samples shares: an empty block, its voxels, mixtures of materials, the surface.
#pragma once
#include <vector>

#include "meshing/core/parallel.h"
#include "synthesis/material_sample.h"

namespace shellgrid {

// A block of interior voxels without coefficients. size: n_x, n_y, n_z; voxel: mm.
MaterialSample allocate_sample(const Vec3i& size, double voxel, double ior);

void store_material(MaterialSample& sample, std::size_t index, const Material& material);

// Mixes so that equal steps of `share` (0: a, 1: b) are equal ratios of absorption: vein edges fade like stains do.
Material mix_like_stains(const Material& a, const Material& b, double share);

// The material of a volume that several fill in shares: absorption, scattering and the scattered light's mean cosine
// are averages by volume. Source: [STF §5.1].
class Composition {
 public:
  void add(const Material& material, double share) {
    const float w = static_cast<float>(share);
    const Rgb scattering = material.scattering();
    absorption_ += w * material.absorption();
    scattering_ += w * scattering;
    forward_ += w * scattering * material.anisotropy;
    share_ += share;
  }
  double share() const { return share_; }
  // Of what was added, whatever its share in all. Zero where nothing was.
  Material material() const;

 private:
  Rgb absorption_ = Rgb::Zero(), scattering_ = Rgb::Zero(), forward_ = Rgb::Zero();
  double share_ = 0;
};

// Calls body(index, centre) for each voxel, on all threads; the centre is in voxels.
template <class Body>
void for_each_voxel(const MaterialSample& sample, const Body& body) {
  const int nx = sample.size.x(), ny = sample.size.y();
  parallel_for(
      sample.voxel_count(),
      [&](std::size_t index) {
        const int x = static_cast<int>(index % nx), y = static_cast<int>(index / nx % ny);
        const int z = static_cast<int>(index / nx / ny);
        body(index, Vec3(x + 0.5, y + 0.5, z + 0.5));
      },
      64);
}

// Points spread over the torus [0, n_x)×[0, n_y) so that each is far from the earlier ones (best of many candidates).
std::vector<Vec2> spread_points(int count, double nx, double ny, std::uint64_t seed);

// Marks interior voxels that touch free space through a face (or stand at the top) as surface. Their normals come from
// `outward` at the voxel's centre where it is given, else from the smoothed occupancy.
void mark_surface(MaterialSample& sample, const std::vector<Vec3f>* outward = nullptr);

}  // namespace shellgrid
