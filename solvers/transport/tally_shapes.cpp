// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/transport/tally_shapes.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "meshing/core/error.h"
#include "solvers/transport/dielectric.h"
#include "solvers/transport/path_random.h"
#include "solvers/transport/phase.h"
#include "solvers/transport/roulette.h"

namespace shellgrid {
namespace {

constexpr double pi = std::numbers::pi;

void check(const TallyProblem& p) {
  const auto need = [](bool good, const std::string& what) {
    if (!good) throw InputError(what);
  };
  need(!p.layers.empty(), "tally: no layers");
  need(p.shape == TallyShape::sphere || p.layers.size() == 1, "tally: only a sphere has more than one layer");
  need(p.shape == TallyShape::sphere || p.source != TallySource::centre, "tally: only a sphere has a centre");
  need(p.shape != TallyShape::slab || (p.thickness > 0 && std::isfinite(p.thickness)),
       "tally: the slab's thickness must be above 0");
  need(p.ior >= 1 && p.ior <= 10, "tally: the refractive index must be 1 … 10");
  need(p.bins >= 1 && p.bins <= 100000, "tally: 1 … 100000 bins");
  need(p.extent >= 0 && std::isfinite(p.extent), "tally: the profile's extent must not be negative");
  double radius = 0;
  for (const TallyLayer& layer : p.layers) {
    need(layer.absorption >= 0 && layer.scattering >= 0 && std::isfinite(layer.absorption + layer.scattering),
         "tally: coefficients must be finite and not negative");
    need(std::abs(layer.anisotropy) < 1, "tally: anisotropies must lie between -1 and 1");
    if (p.shape != TallyShape::sphere) continue;
    need(std::isfinite(layer.radius) && layer.radius > radius,
         fmt::format("tally: radii must rise from inside out; {} mm does not exceed {} mm", layer.radius, radius));
    radius = layer.radius;
  }
  need(p.shape != TallyShape::half_space || p.layers[0].absorption + p.layers[0].scattering > 0,
       "tally: a half-space must hold matter");
}

double default_extent(const TallyProblem& p) {
  if (p.shape == TallyShape::sphere) return p.layers.back().radius;
  if (p.extent > 0) return p.extent;
  const TallyLayer& layer = p.layers[0];
  const double reduced = layer.absorption + layer.scattering * (1 - layer.anisotropy);
  if (reduced > 0) return 10 / reduced;
  return p.thickness;
}

}  // namespace

struct TallyTransport::Walk {
  PathRandom random;
  ChunkTally& tally;
  double weight = 1;
  Vec3 point = Vec3::Zero(), direction = Vec3(0, 0, 1);
  std::uint64_t events = 0, next_limit = event_limit;
  bool scattered_once = false;
};

TallyTransport::TallyTransport(const TallyProblem& problem) : problem_(problem) {
  check(problem);
  double inner = 0;
  for (const TallyLayer& layer : problem.layers) {
    const double extinction = layer.absorption + layer.scattering;
    media_.push_back({extinction, extinction > 0 ? layer.scattering / extinction : 1, layer.anisotropy, 1 / extinction,
                      layer.radius, inner,
                      problem.leaps && extinction > 0
                          ? DiffuseLeap(extinction, layer.scattering / extinction, layer.anisotropy)
                          : DiffuseLeap()});
    inner = layer.radius;
  }
  bins_ = static_cast<std::size_t>(problem.bins);
  problem_.extent = default_extent(problem);
  bin_width_ = problem_.extent / static_cast<double>(bins_);
}

PathKind TallyTransport::kind() const {
  PathKind kind;
  kind.scalars = profile_slot(2, 0);
  kind.follow = [this](std::uint64_t path, ChunkTally& tally) {
    Walk walk{PathRandom(problem_.seed, path), tally};
    tally.note(PathEvent::object_met);
    problem_.shape == TallyShape::sphere ? follow_sphere(walk) : follow_slab(walk);
  };
  kind.relative_error = [](const PathState& state) {
    std::optional<double> worst;
    for (const Slot slot : {reflected, transmitted}) {
      const Estimate e = state.scalar(slot);
      if (e.value > 0 && state.paths > 1) worst = std::max(worst.value_or(0), e.standard_error / e.value);
    }
    return worst;
  };
  return kind;
}

// Absorbs, or scatters. False where the path ends.
bool TallyTransport::interact(Walk& walk, std::size_t layer, double clearance) const {
  const Medium& medium = media_[layer];
  walk.scattered_once = true;
  walk.tally.note(PathEvent::collisions);
  if (medium.albedo < 1) {
    walk.tally.add(first_layer + layer, walk.weight * (1 - medium.albedo));
    walk.weight *= medium.albedo;
    if (!survives_faintness(walk.weight, walk.random)) {
      walk.tally.note(PathEvent::roulette);
      return false;
    }
  }
  const Vec3 before = walk.direction;
  walk.direction = scattered(before, medium.anisotropy, walk.random);
  if (walk.events >= leaps_begin && medium.leap.possible()) {
    const double radius = medium.leap.radius(clearance);
    if (radius > 0 && scattered_evenly(medium.anisotropy, before.dot(walk.direction), walk.random) &&
        !leap(walk, layer, radius))
      return false;
  }
  return outlived(walk);
}

// False where the path ends.
bool TallyTransport::leap(Walk& walk, std::size_t layer, double radius) const {
  const DiffuseLeap& how = media_[layer].leap;
  walk.tally.note(PathEvent::leaps);
  if (problem_.shape == TallyShape::sphere) {
    // What passes on the way is counted at one place of it, drawn in proportion.
    const double r = (walk.point + how.place(radius, walk.random) * even_direction(walk.random)).norm();
    walk.tally.add(profile_slot(0, std::min(bins_ - 1, static_cast<std::size_t>(r / bin_width_))),
                   walk.weight * how.length(radius));
  }
  const double taken = walk.weight * how.loss(radius);
  if (taken > 0) {
    walk.tally.add(first_layer + layer, taken);
    walk.weight -= taken;
    if (!survives_faintness(walk.weight, walk.random)) {
      walk.tally.note(PathEvent::roulette);
      return false;
    }
  }
  walk.point += radius * even_direction(walk.random);
  walk.direction = even_direction(walk.random);
  return true;
}

bool TallyTransport::outlived(Walk& walk) const {
  if (++walk.events < walk.next_limit) return true;
  switch (meet_event_limit(walk.events, walk.next_limit, walk.random)) {
    case LimitOutcome::goes_on:
      walk.weight *= limit_weight;
      return true;
    case LimitOutcome::ended:
      walk.tally.note(PathEvent::limit_roulette);
      return false;
    case LimitOutcome::cut_off:
      walk.tally.note(PathEvent::cut_off);
      walk.tally.add(lost, walk.weight);
      return false;
  }
  return false;
}

void TallyTransport::follow_slab(Walk& walk) const {
  const Medium& medium = media_[0];
  const double infinite = std::numeric_limits<double>::infinity();
  const double thickness = problem_.shape == TallyShape::slab ? problem_.thickness : infinite;
  const double cosine = problem_.source == TallySource::diffuse ? std::sqrt(1 - walk.random.next()) : 1;
  const BoundaryMeeting entry = meet_boundary(cosine, problem_.ior);
  walk.tally.add(specular, entry.reflectance);
  walk.weight = 1 - entry.reflectance;
  if (!(walk.weight > 0)) return;
  const double sine = std::sqrt(std::max(0.0, 1 - cosine * cosine)) / problem_.ior;
  walk.direction = Vec3(sine, 0, std::sqrt(std::max(0.0, 1 - sine * sine)));
  const auto leave = [&](Slot slot, int profile) {
    walk.tally.add(slot, walk.weight);
    const double r = std::hypot(walk.point.x(), walk.point.y());
    if (r < problem_.extent)
      walk.tally.add(profile_slot(profile, std::min(bins_ - 1, static_cast<std::size_t>(r / bin_width_))), walk.weight);
  };
  for (;;) {
    const double free = medium.extinction > 0 ? walk.random.exponential() * medium.inverse_extinction : infinite;
    const double along = walk.direction.z();
    const double wall = along > 0   ? (thickness - walk.point.z()) / along
                        : along < 0 ? -walk.point.z() / along
                                    : infinite;
    if (free < wall) {
      walk.point += free * walk.direction;
      if (!interact(walk, 0, std::min(walk.point.z(), thickness - walk.point.z()))) return;
      continue;
    }
    if (!(wall < infinite)) {  // along a slab of nothing, or into a half-space beyond all numbers
      walk.tally.note(PathEvent::cut_off);
      walk.tally.add(lost, walk.weight);
      return;
    }
    walk.tally.note(PathEvent::boundary_meetings);
    walk.point += std::max(0.0, wall) * walk.direction;
    walk.point.z() = along > 0 ? thickness : 0;
    const BoundaryMeeting meeting = meet_boundary(std::abs(along), 1 / problem_.ior);
    if (meeting.reflectance == 0 || walk.random.next() >= meeting.reflectance) {
      if (along > 0) {
        leave(transmitted, 1);
        if (!walk.scattered_once) walk.tally.add(unscattered, walk.weight);
      } else {
        leave(reflected, 0);
      }
      return;
    }
    walk.direction.z() = -along;
    if (!outlived(walk)) return;
  }
}

// Adds weight·length to the shells of the profile that the segment crosses.
void TallyTransport::track(const Walk& walk, double length) const {
  const double b = walk.point.dot(walk.direction), square = walk.point.squaredNorm();
  const double miss = std::max(0.0, square - b * b);  // squared, of the line and the centre
  auto bin = std::min(bins_ - 1, static_cast<std::size_t>(std::sqrt(square) / bin_width_));
  double at = 0;
  bool inwards = b < 0;
  while (at < length) {
    double end;
    std::size_t next = bin;
    const double inner = static_cast<double>(bin) * bin_width_;
    if (inwards && inner * inner > miss) {
      end = -b - std::sqrt(inner * inner - miss);
      next = bin - 1;
    } else {
      const double outer = static_cast<double>(bin + 1) * bin_width_;
      inwards = false;
      end = bin + 1 == bins_ ? length : -b + std::sqrt(std::max(0.0, outer * outer - miss));
      next = bin + 1;
    }
    end = std::clamp(end, at, length);
    if (end > at) walk.tally.add(profile_slot(0, bin), walk.weight * (end - at));
    if (end >= length) return;
    at = end;
    bin = next;
  }
}

void TallyTransport::follow_sphere(Walk& walk) const {
  const double infinite = std::numeric_limits<double>::infinity();
  const double radius = media_.back().outer;
  std::size_t layer = 0;
  const bool from_outside = problem_.source != TallySource::centre;
  if (!from_outside) {
    walk.direction = even_direction(walk.random);
  } else {
    // A sphere looks alike from everywhere: parallel and diffuse light differ in nothing that is tallied here.
    const double sine = std::sqrt(walk.random.next()), cosine = std::sqrt(1 - sine * sine);
    const BoundaryMeeting entry = meet_boundary(cosine, problem_.ior);
    walk.tally.add(specular, entry.reflectance);
    walk.weight = 1 - entry.reflectance;
    if (!(walk.weight > 0)) return;
    layer = media_.size() - 1;
    walk.point = radius * Vec3(sine, 0, -cosine);
    walk.direction = refracted(Vec3(0, 0, 1), walk.point / radius, cosine, entry.cosine_beyond, problem_.ior);
  }
  double optical = walk.random.exponential();
  for (;;) {
    const Medium& medium = media_[layer];
    const double b = walk.point.dot(walk.direction), square = walk.point.squaredNorm();
    // The inner sphere, if it lies ahead, else the outer one.
    const double inner = b * b - (square - medium.inner * medium.inner);
    const bool goes_in = b < 0 && layer > 0 && inner > 0;
    const double outer = b * b - (square - medium.outer * medium.outer);
    const double wall = std::max(0.0, goes_in ? -b - std::sqrt(inner) : -b + std::sqrt(std::max(0.0, outer)));
    const double free = medium.extinction > 0 ? optical * medium.inverse_extinction : infinite;
    track(walk, std::min(free, wall));
    if (free < wall) {
      walk.point += free * walk.direction;
      const double from_centre = walk.point.norm();
      if (!interact(walk, layer,
                    std::min(medium.outer - from_centre, layer > 0 ? from_centre - medium.inner : infinite)))
        return;
      optical = walk.random.exponential();
      continue;
    }
    walk.point += wall * walk.direction;
    optical -= wall * medium.extinction;
    if (goes_in || layer + 1 < media_.size()) {
      layer = goes_in ? layer - 1 : layer + 1;
      continue;
    }
    walk.tally.note(PathEvent::boundary_meetings);
    walk.point *= radius / walk.point.norm();
    const Vec3 inward = -walk.point / radius;
    const double cosine = std::clamp(-inward.dot(walk.direction), 0.0, 1.0);
    const BoundaryMeeting meeting = meet_boundary(cosine, 1 / problem_.ior);
    if (meeting.reflectance == 0 || walk.random.next() >= meeting.reflectance) {
      walk.tally.add(from_outside ? reflected : transmitted, walk.weight);
      if (!walk.scattered_once) walk.tally.add(unscattered, walk.weight);
      return;
    }
    walk.direction = mirrored(walk.direction, inward, cosine);
    optical = walk.random.exponential();
    if (!outlived(walk)) return;
  }
}

TallyResult TallyTransport::result(const PathState& state) const {
  TallyResult r;
  r.diffuse_reflectance = state.scalar(reflected);
  r.specular_reflectance = state.scalar(specular);
  r.transmittance = state.scalar(transmitted);
  r.unscattered = state.scalar(unscattered);
  r.lost = state.scalar(lost);
  for (std::size_t k = 0; k < media_.size(); ++k) r.absorbed.push_back(state.scalar(first_layer + k));
  for (std::size_t k = 0; k <= bins_; ++k) r.radius.push_back(static_cast<double>(k) * bin_width_);
  for (std::size_t k = 0; k < bins_; ++k) {
    const double a = r.radius[k], b = r.radius[k + 1];
    if (problem_.shape == TallyShape::sphere) {
      r.fluence_profile.push_back(state.scalar(profile_slot(0, k), 1 / (4 * pi / 3 * (b * b * b - a * a * a))));
      continue;
    }
    const double ring = 1 / (pi * (b * b - a * a));
    r.reflectance_profile.push_back(state.scalar(profile_slot(0, k), ring));
    if (problem_.shape == TallyShape::slab) r.transmittance_profile.push_back(state.scalar(profile_slot(1, k), ring));
  }
  return r;
}

}  // namespace shellgrid
