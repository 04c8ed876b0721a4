// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/transport/light_tracing.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "meshing/core/error.h"

namespace shellgrid {
namespace {

// Scalars: three channels each.
enum Power : int {
  incoming,
  entering,
  leaving,
  mirrored_power,
  absorbed_core,
  absorbed_shell,
  lost_power,
  roulette,
  exchange,
  powers
};

// Tells the tally what becomes of one path's power.
class TracingVisitor {
 public:
  TracingVisitor(const TriangleMesh& mesh, double watts, bool may_come_back, ChunkTally& tally)
      : again(may_come_back), mesh_(mesh), watts_(watts), tally_(tally) {}
  // The path's end.
  ~TracingVisitor() {
    power_[exchange] = power_[leaving] + power_[absorbed_core] + power_[absorbed_shell] + power_[lost_power] -
                       power_[entering] - power_[roulette];
    for (int p = 0; p < powers; ++p)
      for (int c = 0; c < 3; ++c)
        if (power_[p][c] != 0) tally_.add(static_cast<std::size_t>(3 * p + c), watts_ * power_[p][c]);
  }
  TracingVisitor(const TracingVisitor&) = delete;
  TracingVisitor& operator=(const TracingVisitor&) = delete;

  void incoming(const LightPath& path) { power_[Power::incoming] += path.weight; }
  void entered(const LightPath& path, const Crossing& crossing) {
    power_[entering] += path.weight;
    deposit(path, crossing, static_cast<std::uint32_t>(mesh_.vertex_count()));
  }
  void left(const LightPath& path, const Crossing& crossing) {
    power_[leaving] += path.weight;
    deposit(path, crossing, 0);
  }
  void mirrored(const LightPath& path) { power_[mirrored_power] += path.weight; }
  void outside(const LightPath&, double) {}
  void absorbed(Double4 power, int region) { power_[region == 0 ? absorbed_core : absorbed_shell] += power; }
  void chance(Double4 power) { power_[roulette] += power; }
  void lost(Double4 power) { power_[lost_power] += power; }

  const bool again;

 private:
  void deposit(const LightPath& path, const Crossing& crossing, std::uint32_t first) {
    const Eigen::Array3d power(watts_ * path.weight[0], watts_ * path.weight[1], watts_ * path.weight[2]);
    for (int k = 0; k < 3; ++k)
      tally_.add_to_field(first + static_cast<std::uint32_t>(mesh_.faces(crossing.face_index, k)),
                          power * crossing.barycentric[k]);
  }

  const TriangleMesh& mesh_;
  const double watts_;
  ChunkTally& tally_;
  Double4 power_[powers] = {};
};

}  // namespace

LightTracing::LightTracing(const TransportObject& object, const std::vector<Light>& lights,
                           const LightTracingOptions& options)
    : object_(object),
      options_(options),
      emission_(lights, object.mesh(), object.surface().centre(), object.surface().radius()) {
  for (const Light& light : lights)
    if (const std::optional<Vec3> place = light_position(light); place && object.contains(*place))
      throw InputError("lights: a light stands inside the object");
  const TriangleMesh& mesh = object.mesh();
  area_.assign(static_cast<std::size_t>(mesh.vertex_count()), 0.0);
  for (int f = 0; f < mesh.face_count(); ++f) {
    const Vec3 a = mesh.corner(f, 0);
    const double third = (mesh.corner(f, 1) - a).cross(mesh.corner(f, 2) - a).norm() / 6;
    for (int k = 0; k < 3; ++k) area_[static_cast<std::size_t>(mesh.faces(f, k))] += third;
  }
}

PathKind LightTracing::kind() const {
  PathKind kind;
  kind.scalars = 3 * powers;
  kind.field_size = 2 * area_.size();
  kind.follow = [this](std::uint64_t index, ChunkTally& tally) {
    LightPath path{PathRandom(options_.seed, index)};
    const EmittedRay ray = emission_.emit(path.random);
    const double watts = lane_sum(ray.power);
    if (!(watts > 0)) return;
    path.point = ray.origin;
    path.direction = ray.direction;
    object_.begin(path);
    const auto follow = [&](Double4 weight, double power) {
      LightPath own = path;
      own.weight = weight;
      TracingVisitor visitor(object_.mesh(), power, options_.interreflection, tally);
      std::visit(
          [&](const auto& medium) {
            const TransportBody body = object_.body();
            BodyWalk<std::decay_t<decltype(medium)>, TracingVisitor>(body, medium, visitor, tally).follow(own);
          },
          object_.medium());
      path.random = own.random;
    };
    if (!options_.channels_apart) return follow(ray.power / watts, watts);
    for (int c = 0; c < 3; ++c) {
      Double4 alone = {};
      alone[c] = 1;
      if (ray.power[c] > 0) follow(alone, ray.power[c]);
    }
  };
  kind.relative_error = [this](const PathState& state) { return relative_error(state); };
  return kind;
}

std::optional<double> LightTracing::relative_error(const PathState& state) const {
  std::optional<double> worst;
  for (int c = 0; c < 3 && state.paths > 1; ++c) {
    double errors = 0, squares = 0;
    for (std::size_t v = 0; v < area_.size(); ++v) {
      if (!(area_[v] > 0)) continue;
      const Estimate e = estimate(state.field_sum[3 * v + c], state.field_square[3 * v + c],
                                  static_cast<double>(state.paths), 1 / area_[v]);
      errors += area_[v] * e.standard_error * e.standard_error;
      squares += area_[v] * e.value * e.value;
    }
    if (squares > 0) worst = std::max(worst.value_or(0), std::sqrt(errors / squares));
  }
  return worst;
}

LightTracingResult LightTracing::result(const PathState& state) const {
  LightTracingResult r;
  const auto paths = static_cast<double>(state.paths);
  const auto field = [&](std::size_t first, std::vector<Rgb>& value, std::vector<Rgb>& error) {
    for (std::size_t v = 0; v < area_.size(); ++v) {
      Rgb mean = Rgb::Zero(), deviation = Rgb::Zero();
      for (int c = 0; c < 3 && area_[v] > 0; ++c) {
        const std::size_t at = 3 * (first + v) + static_cast<std::size_t>(c);
        const Estimate e = estimate(state.field_sum[at], state.field_square[at], paths, 1 / area_[v]);
        mean[c] = static_cast<float>(e.value);
        deviation[c] = static_cast<float>(e.standard_error);
      }
      value.push_back(mean);
      error.push_back(deviation);
    }
  };
  field(0, r.exitance, r.exitance_error);
  field(area_.size(), r.irradiance, r.irradiance_error);
  const auto power = [&](Power p) {
    PowerEstimate e;
    for (int c = 0; c < 3; ++c) e.channel[c] = state.scalar(static_cast<std::size_t>(3 * p + c));
    return e;
  };
  r.incoming = power(incoming);
  r.entering = power(entering);
  r.leaving = power(leaving);
  r.mirrored = power(mirrored_power);
  r.absorbed_core = power(absorbed_core);
  r.absorbed_shell = power(absorbed_shell);
  r.lost = power(lost_power);
  r.roulette = power(roulette);
  r.exchange = power(exchange);
  r.relative_error = relative_error(state);
  return r;
}

}  // namespace shellgrid
