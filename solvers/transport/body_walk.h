// SPDX-License-Identifier: AGPL-3.0-or-later
// A light path about and in an object: the loop of all transport.
#pragma once
#include <limits>

#include "solvers/transport/clearance_grid.h"
#include "solvers/transport/dielectric.h"
#include "solvers/transport/diffuse_leap.h"
#include "solvers/transport/light_path.h"
#include "solvers/transport/path_tally.h"
#include "solvers/transport/phase.h"
#include "solvers/transport/spectral_weight.h"
#include "solvers/transport/surface_distance.h"
#include "solvers/transport/transport_surface.h"

namespace shellgrid {

// The object: its surfaces, how far they surely are, and its refractive index, inside over outside.
struct TransportBody {
  const TransportSurface& surface;
  const ClearanceGrid& clearance;
  double ior = 1;
  const SurfaceDistance* distance = nullptr;  // exactly, where a lower bound does not do
};

// Gets a path that comes from outside, before it meets anything, and follows it to its end. What happens is told to the
// visitor:
//   incoming(path)            it meets the outer surface from outside
//   entered(path, crossing)   from outside it passes into matter; the crossing of the outer surface
//   left(path, crossing)      having been in matter it crosses the outer surface outwards
//   mirrored(path)            it turns back from the surfaces without having been in matter
//   outside(path, distance)   a stretch outside is ahead of it, to the next crossing or without end
//   absorbed(power, region), chance(power)   what matter takes; what roulettes give (or, negative, take)
//   lost(power)               a path slipped through the surface, or was cut off
// and visitor.again says whether light that left or was mirrored may come back.
// Source: PHYSICS "The judge".
template <class Medium, class Visitor>
class BodyWalk {
 public:
  BodyWalk(const TransportBody& body, const Medium& medium, Visitor& visitor, ChunkTally& tally)
      : body_(body), medium_(medium), visitor_(visitor), tally_(tally) {}

  void follow(LightPath& path) {
    for (;;) {
      const bool goes_on = path.in_matter() ? through_matter(path) : through_space(path);
      if (!goes_on) return;
    }
  }

 private:
  bool through_space(LightPath& path) {
    constexpr double infinite = std::numeric_limits<double>::infinity();
    const bool outside = !path.inside[0];
    const double approach = outside ? way_to_object(path) : 0;
    if (approach < 0) {
      visitor_.outside(path, infinite);
      return false;
    }
    tally_.note(PathEvent::rays);
    // Sheets thinner than rounding would be left and entered for ever.
    const bool stuck = crossings_on_the_spot_ > most_on_the_spot;
    const bool found = body_.surface.next(path.point + approach * path.direction, path.direction, infinite, path.inside,
                                          crossing_, !stuck);
    if (stuck) crossings_on_the_spot_ = 0;
    if (outside) visitor_.outside(path, found ? approach + crossing_.distance : infinite);
    if (!found && !outside) {
      tally_.note(PathEvent::lost);
      if (path.entered) visitor_.lost(path.weight);
    }
    return found && meet(path);
  }

  // From afar to the sphere about the object, mm: rounding is relative to where a ray begins. Negative: it passes by.
  double way_to_object(const LightPath& path) const {
    const Vec3 from = path.point - body_.surface.centre();
    const double radius = 1.0001 * body_.surface.radius();
    if (from.squaredNorm() <= radius * radius) return 0;
    // Squared distance of the line and the centre, from the part of `from` across it.
    const double b = from.dot(path.direction), miss = (from - b * path.direction).squaredNorm();
    if (b >= 0 || miss >= radius * radius) return -1;
    return -b - std::sqrt(radius * radius - miss);
  }

  bool through_matter(LightPath& path) {
    const double clearance = body_.clearance.at(path.point);
    bool found = false, asked = false;
    const auto ahead = [&](double limit) {
      asked = true;
      tally_.note(PathEvent::rays);
      found = body_.surface.next(path.point, path.direction, limit, path.inside, crossing_);
      return found ? crossing_.distance : std::numeric_limits<double>::infinity();
    };
    const bool collides = medium_.fly(path, clearance, ahead, tally_);
    if (!asked) tally_.note(PathEvent::rays_skipped);
    if (collides) {
      if (asked && !body_.clearance.contains(path.point)) return lose(path);
      return collide(path);
    }
    if (!found) return lose(path);
    return meet(path);
  }

  bool lose(LightPath& path) {
    tally_.note(PathEvent::lost);
    visitor_.lost(path.weight);
    return false;
  }

  bool collide(LightPath& path) {
    tally_.note(PathEvent::collisions);
    const ScatteringPlace& place = medium_.place(path);
    if (!place.white) {
      const Double4 kept = path.weight * place.albedo;
      visitor_.absorbed(path.weight - kept, place.region);
      path.weight = kept;
      if (!survives_faint(path)) return false;
    }
    const Vec3 before = path.direction;
    scatter(path, place);
    if (path.events >= leaps_begin)
      if (const ChannelLeaps* leaps = medium_.leaps(path); leaps && !leap(path, *leaps, before, place.region))
        return false;
    return outlives_limit(path);
  }

  // Takes many collisions at once where all about is homogeneous. False where the path ends.
  bool leap(LightPath& path, const ChannelLeaps& leaps, const Vec3& before, int region) {
    const double reach = medium_.reach(path);
    if (!(leaps.radius(std::min(reach, body_.surface.radius()), path.weight) > 0)) return true;
    if (!scattered_evenly(leaps.anisotropy, before.dot(path.direction), path.random)) return true;
    double radius = leaps.radius(std::min(reach, body_.clearance.at(path.point)), path.weight);
    if (radius == 0 && body_.distance && path.events >= path.next_distance) {
      radius = leaps.radius(std::min(reach, body_.distance->at(path.point)), path.weight);
      path.next_distance = path.events + distance_interval;
    }
    if (radius == 0) return true;
    tally_.note(PathEvent::leaps);
    const Double4 taken = path.weight * leaps.loss(radius);
    visitor_.absorbed(taken, region);
    path.weight -= taken;
    if (!survives_faint(path)) return false;
    path.point += radius * even_direction(path.random);
    path.direction = even_direction(path.random);
    return true;
  }

  // False where the path ends.
  bool survives_faint(LightPath& path) {
    const Double4 kept = path.weight;
    const double sum = lane_sum(kept);
    if (sum >= faint) return true;
    double revived_sum = sum;
    const bool survives = survives_faintness(revived_sum, path.random);
    const Double4 after = survives ? kept * (revived_sum / sum) : Double4{};
    visitor_.chance(after - kept);
    if (!survives) {
      tally_.note(PathEvent::roulette);
      return false;
    }
    path.weight = after;
    return true;
  }

  static void scatter(LightPath& path, const ScatteringPlace& place) {
    if (place.one_anisotropy) {
      path.direction = scattered(path.direction, place.anisotropy[0], path.random);
      return;
    }
    const int channel = choose_channel(path.weight, path.random.next());
    const double cosine = henyey_greenstein_cosine(place.anisotropy[channel], path.random.next());
    Double4 density = {};
    for (int c = 0; c < 3; ++c) density[c] = henyey_greenstein(place.anisotropy[c], cosine);
    path.weight = reweighted(path.weight, path.weight * density);
    path.direction = direction_about(path.direction, cosine, path.random.azimuth());
  }

  bool outlives_limit(LightPath& path) {
    if (++path.events < path.next_limit) return true;
    const Double4 before = path.weight;
    switch (meet_event_limit(path.events, path.next_limit, path.random)) {
      case LimitOutcome::goes_on:
        path.weight *= limit_weight;
        visitor_.chance(path.weight - before);
        return true;
      case LimitOutcome::ended:
        tally_.note(PathEvent::limit_roulette);
        visitor_.chance(-before);
        return false;
      case LimitOutcome::cut_off:
        tally_.note(PathEvent::cut_off);
        visitor_.lost(before);
        return false;
    }
    return false;
  }

  // At the crossing.
  bool meet(LightPath& path) {
    const bool outer = crossing_.surface == SurfaceKind::outer, from_outside = !path.inside[0];
    const bool was_in_matter = path.in_matter();
    crossings_on_the_spot_ = crossing_.distance <= body_.surface.tolerance() ? crossings_on_the_spot_ + 1 : 0;
    path.point = crossing_.point;
    std::array<bool, 2> beyond = path.inside;
    beyond[static_cast<int>(crossing_.surface)] = !beyond[static_cast<int>(crossing_.surface)];
    const bool will_be_in_matter = beyond[0] && !beyond[1];
    if (outer && from_outside) {
      tally_.note(PathEvent::object_met);
      visitor_.incoming(path);
      entrance_ = crossing_;
      path.entered = false;
    }
    if (was_in_matter != will_be_in_matter) {
      tally_.note(PathEvent::boundary_meetings);
      const double relative_ior = was_in_matter ? 1 / body_.ior : body_.ior;
      // Against the light; at grazing angles rounding must not turn it round.
      const bool outwards = path.inside[static_cast<int>(crossing_.surface)];
      const Vec3 normal = outwards ? Vec3(-crossing_.normal) : crossing_.normal;
      const double cosine = std::clamp(-normal.dot(path.direction), 0.0, 1.0);
      const BoundaryMeeting meeting = meet_boundary(cosine, relative_ior);
      if (meeting.reflectance > 0 && path.random.next() < meeting.reflectance) {
        path.direction = mirrored(path.direction, normal, cosine);
        if (from_outside) {
          visitor_.mirrored(path);
          if (!visitor_.again) return false;
        }
        return outlives_limit(path);
      }
      if (relative_ior != 1)
        path.direction = refracted(path.direction, normal, cosine, meeting.cosine_beyond, relative_ior);
      if (will_be_in_matter && !path.entered) {
        path.entered = true;
        visitor_.entered(path, entrance_);
      }
    }
    path.inside = beyond;
    if (outer && !from_outside) {
      if (path.entered)
        visitor_.left(path, crossing_);
      else
        visitor_.mirrored(path);
      path.entered = false;
      if (!visitor_.again) return false;
    }
    return outlives_limit(path);
  }

  const TransportBody& body_;
  const Medium& medium_;
  Visitor& visitor_;
  ChunkTally& tally_;
  static constexpr int most_on_the_spot = 8;
  static constexpr std::uint64_t distance_interval = 32;  // events; the exact distance is dear
  Crossing crossing_, entrance_;
  int crossings_on_the_spot_ = 0;
};

}  // namespace shellgrid
