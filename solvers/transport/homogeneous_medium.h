// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cmath>
#include <limits>

#include "meshing/core/error.h"
#include "meshing/core/material.h"
#include "solvers/transport/diffuse_leap.h"
#include "solvers/transport/light_path.h"
#include "solvers/transport/spectral_weight.h"

namespace shellgrid {

// Throws: InputError for coefficients that no matter has.
inline void check_transport_material(const Material& material) {
  const bool finite =
      material.extinction.isFinite().all() && material.albedo.isFinite().all() && material.anisotropy.isFinite().all();
  if (!finite || (material.extinction < 0).any() || (material.albedo < 0).any() || (material.albedo > 1).any() ||
      (material.anisotropy.abs() >= 1).any())
    throw InputError("material: extinction must be finite and not negative, albedo in 0 … 1, anisotropy in (-1, 1)");
}

inline ScatteringPlace scattering_place(const Rgb& albedo, const Rgb& anisotropy, int region) {
  ScatteringPlace place;
  place.albedo = to_double(to_lanes(albedo));
  place.anisotropy = to_double(to_lanes(anisotropy));
  place.white = (albedo == 1).all();
  place.one_anisotropy = (anisotropy == anisotropy[0]).all();
  place.region = region;
  return place;
}

// The same matter everywhere.
class HomogeneousMedium {
 public:
  // Throws: InputError.
  explicit HomogeneousMedium(const Material& material) {
    check_transport_material(material);
    extinction_ = to_double(to_lanes(material.extinction));
    place_ = scattering_place(material.albedo, material.anisotropy, 0);
    grey_ = (material.extinction == material.extinction[0]).all();
    leaps_ = channel_leaps(extinction_, place_.albedo, place_.anisotropy);
  }

  // Flies on to the next collision and returns true, or to the next crossing of a surface, whose distance is
  // ahead(limit): infinite where there is none within the limit. Nothing is ahead nearer than `clearance`.
  template <class Ahead, class Tally>
  bool fly(LightPath& path, double clearance, const Ahead& ahead, Tally&) const {
    const int channel = grey_ ? 0 : choose_channel(path.weight, path.random.next());
    const double sigma = extinction_[channel];
    const double free = sigma > 0 ? path.random.exponential() / sigma : std::numeric_limits<double>::infinity();
    if (!(free < clearance)) {
      const double wall = ahead(free);
      if (wall <= free) {
        if (!grey_ && std::isfinite(wall))
          path.weight =
              reweighted(path.weight, path.weight * lane_exponential((lane_broadcast(sigma) - extinction_) * wall));
        return false;
      }
    }
    if (!grey_)
      path.weight = reweighted(
          path.weight, path.weight * extinction_ * lane_exponential((lane_broadcast(sigma) - extinction_) * free));
    path.point += free * path.direction;
    return true;
  }
  // Of the collision that the last flight ended in.
  const ScatteringPlace& place(const LightPath&) const { return place_; }

  // How the matter of the last collision is leapt through, null: not at all; and how far about it there is surely no
  // other, mm.
  const ChannelLeaps* leaps(const LightPath&) const { return leaps_.possible ? &leaps_ : nullptr; }
  double reach(const LightPath&) const { return std::numeric_limits<double>::infinity(); }

 private:
  Double4 extinction_ = {};
  ScatteringPlace place_;
  ChannelLeaps leaps_;
  bool grey_ = true;
};

}  // namespace shellgrid
