// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/transport/camera_paths.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "meshing/core/error.h"

namespace shellgrid {
namespace {

double tent(double u) { return u < 0.5 ? std::sqrt(2 * u) - 1 : 1 - std::sqrt(2 - 2 * u); }

struct Emitters {
  const std::vector<EnvironmentLight>& environments;
  const std::vector<AreaLight>& areas;
  const std::optional<Rgb>& background;
};

// Gathers what a path meets outside.
class GatheringVisitor {
 public:
  explicit GatheringVisitor(const Emitters& emitters) : emitters_(emitters) {}

  void incoming(const LightPath&) { met_object = true; }
  void entered(const LightPath&, const Crossing&) {}
  void left(const LightPath&, const Crossing&) { been_in_matter_ = true; }
  void mirrored(const LightPath&) {}
  void outside(const LightPath& path, double distance) {
    Rgb sum = Rgb::Zero();
    for (const AreaLight& area : emitters_.areas) sum += radiance(area, path.point, path.direction, distance);
    if (!std::isfinite(distance)) {
      if (!met_object && emitters_.background)
        sum += *emitters_.background;
      else
        for (const EnvironmentLight& environment : emitters_.environments) sum += radiance(environment, path.direction);
    }
    const Double4 seen = 3 * path.weight * to_double(to_lanes(sum));
    total += seen;
    if (been_in_matter_) from_matter += seen;
  }
  void absorbed(Double4, int) {}
  void chance(Double4) {}
  void lost(Double4) {}

  static constexpr bool again = true;
  Double4 total = {}, from_matter = {};
  bool met_object = false;

 private:
  const Emitters& emitters_;
  bool been_in_matter_ = false;
};

Eigen::Array3d channels(Double4 a) { return {a[0], a[1], a[2]}; }

}  // namespace

CameraPaths::CameraPaths(const TransportObject& object, const std::vector<Light>& lights, const Camera& camera,
                         const CameraPathOptions& options)
    : object_(object),
      camera_(camera),
      rays_(camera),
      options_(options),
      pixels_(static_cast<std::size_t>(camera.width) * static_cast<std::size_t>(camera.height)) {
  for (const Light& light : lights) {
    if (const auto* environment = std::get_if<EnvironmentLight>(&light)) {
      environments_.push_back(*environment);
    } else if (const auto* area = std::get_if<AreaLight>(&light)) {
      if (object.contains(area->position)) throw InputError("lights: a light stands inside the object");
      areas_.push_back(*area);
    } else if (const auto* point = std::get_if<PointLight>(&light);
               ((point ? point->intensity : std::get<DirectionalLight>(light).irradiance) > 0).any()) {
      throw InputError(
          "lights: camera paths hit no directional or point light; trace their light into exitance (.ply) instead, or "
          "give them extent (area, environment)");
    }
  }
  if (object.contains(camera.position)) throw InputError("camera: it is inside the object");
}

PathKind CameraPaths::kind() const {
  PathKind kind;
  kind.field_size = 3 * pixels_;
  kind.follow = [this](std::uint64_t index, ChunkTally& tally) {
    const auto pixel = static_cast<std::size_t>(index % pixels_);
    const auto column = static_cast<double>(pixel % static_cast<std::size_t>(camera_.width)),
               row = static_cast<double>(pixel / static_cast<std::size_t>(camera_.width));
    LightPath path{PathRandom(options_.seed, index)};
    path.point = rays_.origin();
    const double x = column + 0.5 + tent(path.random.next()), y = row + 0.5 + tent(path.random.next());
    path.direction = rays_.direction(x, y);
    path.weight = Double4{1.0 / 3, 1.0 / 3, 1.0 / 3, 0};
    object_.begin(path);
    const Emitters emitters{environments_, areas_, options_.background};
    GatheringVisitor visitor(emitters);
    std::visit(
        [&](const auto& medium) {
          const TransportBody body = object_.body();
          BodyWalk<std::decay_t<decltype(medium)>, GatheringVisitor>(body, medium, visitor, tally).follow(path);
        },
        object_.medium());
    const auto place = static_cast<std::uint32_t>(pixel), stride = static_cast<std::uint32_t>(pixels_);
    if (lane_sum(visitor.total) > 0) tally.add_to_field(place, channels(visitor.total));
    if (lane_sum(visitor.from_matter) > 0) tally.add_to_field(stride + place, channels(visitor.from_matter));
    if (visitor.met_object) tally.add_to_field(2 * stride + place, Eigen::Array3d(1, 0, 0));
  };
  kind.relative_error = [this](const PathState& state) { return relative_error(state); };
  return kind;
}

double CameraPaths::samples_of(std::size_t pixel, const PathState& state) const {
  return static_cast<double>(state.paths / pixels_ + (pixel < state.paths % pixels_ ? 1 : 0));
}

std::optional<double> CameraPaths::relative_error(const PathState& state) const {
  std::optional<double> worst;
  for (std::size_t c = 0; c < 3 && state.paths > 1; ++c) {
    double errors = 0, squares = 0;
    for (std::size_t pixel = 0; pixel < pixels_; ++pixel) {
      const std::size_t at = 3 * pixel + c;
      const Estimate e = estimate(state.field_sum[at], state.field_square[at], samples_of(pixel, state));
      errors += e.standard_error * e.standard_error;
      squares += e.value * e.value;
    }
    if (squares > 0) worst = std::max(worst.value_or(0), std::sqrt(errors / squares));
  }
  return worst;
}

Image CameraPaths::picture(const PathState& state) const {
  Image image;
  image.width = camera_.width;
  image.height = camera_.height;
  image.channels.reserve(10);
  const auto fill = [&](const char* name, std::size_t first, std::size_t channel, bool error) {
    std::vector<float>& values = image.add(name).values;
    for (std::size_t pixel = 0; pixel < pixels_; ++pixel) {
      const std::size_t at = 3 * (first + pixel) + channel;
      const Estimate e = estimate(state.field_sum[at], state.field_square[at], samples_of(pixel, state));
      values[pixel] = static_cast<float>(error ? e.standard_error : e.value);
    }
  };
  fill("R", 0, 0, false);
  fill("G", 0, 1, false);
  fill("B", 0, 2, false);
  fill("A", 2 * pixels_, 0, false);
  fill("exitance.R", pixels_, 0, false);
  fill("exitance.G", pixels_, 1, false);
  fill("exitance.B", pixels_, 2, false);
  fill("error.R", 0, 0, true);
  fill("error.G", 0, 1, true);
  fill("error.B", 0, 2, true);
  return image;
}

}  // namespace shellgrid
