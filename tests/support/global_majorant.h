// SPDX-License-Identifier: AGPL-3.0-or-later
// Delta tracking below one majorant for a whole object: the plainest exact way, to compare with.
#pragma once
#include <algorithm>
#include <limits>

#include "meshing/shell/shell_volume.h"
#include "solvers/transport/diffuse_leap.h"
#include "solvers/transport/homogeneous_medium.h"
#include "solvers/transport/light_path.h"
#include "solvers/transport/path_tally.h"
#include "solvers/transport/spectral_weight.h"

namespace shellgrid::test {

class GlobalMajorantMedium {
 public:
  // Voxels without a sample are the core's, as in a shell; those that reach out of the object, too.
  explicit GlobalMajorantMedium(const ShellVolume& shell) : shell_(shell) {
    majorant_ = shell.core.extinction.maxCoeff();
    shell.extinction.for_each_active(
        [&](int, int, int, const Vec3f& value) { majorant_ = std::max<double>(majorant_, value.maxCoeff()); });
  }

  template <class Ahead, class Tally>
  bool fly(LightPath& path, double clearance, const Ahead& ahead, Tally& tally) const {
    double t = 0, wall = clearance;
    bool asked = false;
    for (;;) {
      t += path.random.exponential() / majorant_;
      if (t >= wall && !asked) {
        asked = true;
        wall = ahead(std::numeric_limits<double>::infinity());
      }
      if (t >= wall) return false;
      const Material here = material(path.point + t * path.direction);
      const Double4 sigma = to_double(to_lanes(here.extinction)), real = path.weight * sigma;
      if (path.random.next() * majorant_ * lane_sum(path.weight) < lane_sum(real)) {
        path.weight = reweighted(path.weight, real);
        path.point += t * path.direction;
        return true;
      }
      path.weight = reweighted(path.weight, path.weight * (lane_broadcast(majorant_) - sigma));
      tally.note(PathEvent::null_collisions);
    }
  }

  // It does not know where matter is homogeneous.
  const ChannelLeaps* leaps(const LightPath&) const { return nullptr; }
  double reach(const LightPath&) const { return 0; }
  ScatteringPlace place(const LightPath& path) const {
    const Material here = material(path.point);
    return scattering_place(here.albedo, here.anisotropy, 0);
  }

 private:
  Material material(const Vec3& point) const {
    const Vec3 index = shell_.frame.to_index(point);
    const Vec3i v = (index + Vec3::Constant(0.5)).array().floor().matrix().cast<int>();
    const int leaf = shell_.extinction.find_leaf(shell_.extinction.leaf_of(v.x(), v.y(), v.z()));
    const int offset = shell_.extinction.offset_of(v.x(), v.y(), v.z());
    if (leaf < 0 || !shell_.extinction.mask_test(shell_.extinction.leaf_mask(leaf), offset)) return shell_.core;
    return {shell_.extinction.leaf_values(leaf)[offset].array(), shell_.albedo.leaf_values(leaf)[offset].array(),
            shell_.anisotropy.leaf_values(leaf)[offset].array()};
  }

  const ShellVolume& shell_;
  double majorant_ = 0;
};

}  // namespace shellgrid::test
