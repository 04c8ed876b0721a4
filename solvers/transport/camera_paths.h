// SPDX-License-Identifier: AGPL-3.0-or-later
// True radiance in a picture: camera paths through an object to lights that they can hit.
#pragma once
#include <optional>
#include <vector>

#include "meshing/core/image.h"
#include "solvers/render/camera.h"
#include "solvers/render/lights.h"
#include "solvers/transport/path_campaign.h"
#include "solvers/transport/transport_object.h"

namespace shellgrid {

struct CameraPathOptions {
  std::uint64_t seed = 0;
  std::optional<Rgb> background;  // what the camera sees behind everything; absent: the environment
};

// Paths from the camera, pixel by pixel, row by row, over and over: path p belongs to pixel p mod width·height. A path
// gathers the radiance of what it meets outside: environment and area lights. Samples lie in a tent about the pixel.
// Source: PHYSICS "The judge".
class CameraPaths {
 public:
  // `object` must outlive this. Throws: InputError where a light has no extent (no path could hit it), or the camera
  // is inside the object.
  CameraPaths(const TransportObject& object, const std::vector<Light>& lights, const Camera& camera,
              const CameraPathOptions& options);
  PathKind kind() const;
  // Layers R G B (radiance, W mm⁻² sr⁻¹), A (share of samples that meet the object), exitance.R/G/B (of that what has
  // been in matter), error.R/G/B (standard error of R G B). Pixels without samples are 0.
  Image picture(const PathState& state) const;
  // √(∑ se² / ∑ L²) over the pixels, of the worst channel; none where no light was seen.
  std::optional<double> relative_error(const PathState& state) const;
  std::size_t pixel_count() const { return pixels_; }

 private:
  double samples_of(std::size_t pixel, const PathState& state) const;

  const TransportObject& object_;
  std::vector<EnvironmentLight> environments_;
  std::vector<AreaLight> areas_;
  Camera camera_;
  CameraRays rays_;
  CameraPathOptions options_;
  std::size_t pixels_;
};

}  // namespace shellgrid
