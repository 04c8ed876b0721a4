// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <array>
#include <cstdint>

#include "solvers/render/scene_geometry.h"

namespace shellgrid {

// Shadow rays from one place, a few at once.
class ShadowRays {
 public:
  ShadowRays(const SceneGeometry& geometry, const Vec3& origin) : geometry_(geometry), origin_(origin) {}
  // `unhide` is called, sooner or later, with each `which` that nothing hides.
  template <class Unhide>
  void ask(int which, const Vec3& direction, double distance, const Unhide& unhide) {
    which_[waiting_] = which;
    ways_[waiting_] = direction;
    distances_[waiting_] = distance;
    if (++waiting_ == SceneGeometry::most_rays) finish(unhide);
  }
  template <class Unhide>
  void finish(const Unhide& unhide) {
    if (waiting_ == 0) return;
    const std::uint32_t hidden = geometry_.occluded(origin_, ways_.data(), distances_.data(), waiting_);
    for (int k = 0; k < waiting_; ++k)
      if (!(hidden >> k & 1)) unhide(which_[k]);
    traced_ += waiting_;
    waiting_ = 0;
  }
  std::int64_t traced() const { return traced_; }

 private:
  const SceneGeometry& geometry_;
  Vec3 origin_;
  std::array<int, SceneGeometry::most_rays> which_;
  std::array<Vec3, SceneGeometry::most_rays> ways_;
  std::array<double, SceneGeometry::most_rays> distances_;
  int waiting_ = 0;
  std::int64_t traced_ = 0;
};

}  // namespace shellgrid
