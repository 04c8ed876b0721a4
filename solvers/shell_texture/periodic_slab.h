// SPDX-License-Identifier: AGPL-3.0-or-later
// A base volume as a layer without ends: it repeats along x and y, has its mesostructure surface on top, and is open
// below, where the core begins.
#pragma once
#include <cstdint>
#include <memory>
#include <vector>

#include "solvers/shell_texture/base_volume.h"
#include "solvers/shell_texture/slab_leaps.h"
#include "solvers/transport/transport_surface.h"

namespace shellgrid {

class PeriodicSlab {
 public:
  using Matter = SlabMatter;

  // Throws: InputError where arrays do not fit the size, coefficients are none, or all voxels are free space.
  explicit PeriodicSlab(const BaseVolume& volume);

  double width(int axis) const { return width_[axis]; }  // along x, y
  double depth() const { return depth_; }
  double voxel() const { return voxel_; }
  // Refractive index of the matter below a point of its surface, over that of free space.
  double ior(const Vec3& point, const Vec3& normal) const;
  bool is_matter_at_bottom(double x, double y) const;
  std::size_t texel_at(const Vec3& point) const;  // of the bottom
  const Vec3i& size() const { return size_; }
  // Above this height (z, negative upwards: depth) there is no matter.
  double top() const { return top_; }
  const Matter& matter(std::size_t voxel_index) const { return matter_[voxel_index]; }
  // Share of each voxel that is matter.
  const std::vector<float>& share() const { return share_; }
  const SlabLeaps& leaps() const { return leaps_; }
  // Whether parts of the mesostructure surface lie in a voxel. Above the volume its uppermost voxels go on.
  bool has_surface(std::size_t voxel_index) const { return first_facet_[voxel_index] < first_facet_[voxel_index + 1]; }

  // The nearest meeting with the mesostructure surface not farther than `limit`, from a point with x and y within the
  // tile; `limit` must not reach beyond its sides. x, y, z in mm, z the depth; the normal points out of the matter.
  bool meet_surface(const Vec3& point, const Vec3& direction, double limit, bool in_matter, double& distance,
                    Vec3& normal) const;
  // The same for light in matter, of the parts in one voxel, for distances from `begin` to `limit`.
  bool leave_within(std::size_t voxel_index, const Vec3& point, const Vec3& direction, double begin, double limit,
                    double& distance, Vec3& normal) const;

 private:
  // A facet's plane, and the weights of two of its corners by place.
  struct Facet {
    struct Form {
      double x, y, z, constant;
      double along(const Vec3& v) const { return x * v.x() + y * v.y() + z * v.z(); }
      double at(const Vec3& v) const { return along(v) + constant; }
    };
    Form plane, weight[2];
  };
  void weigh_voxels();
  void sort_surface(const TriangleMesh& boundary);
  void spread_indices(const BaseVolume& volume);

  Vec3i size_ = Vec3i::Zero();
  double voxel_ = 1, ior_ = 1, depth_ = 0, top_ = 0;
  double width_[2] = {};
  bool flat_ = true;           // no free space: the surface is the plane z = 0
  double lowest_surface_ = 0;  // below it there is matter everywhere
  std::vector<Matter> matter_;
  std::vector<float> share_;
  std::vector<Facet> facets_;               // by voxel
  std::vector<std::uint32_t> first_facet_;  // of each voxel, and past the last
  SlabLeaps leaps_;
  std::vector<float> iors_;        // per voxel, that of the surface nearest by; none where all is ior_
  std::vector<char> bottom_free_;  // per texel
  TriangleMesh boundary_;          // of matter, where there is free space
  std::unique_ptr<TransportSurface> surface_;
};

}  // namespace shellgrid
