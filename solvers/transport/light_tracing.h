// SPDX-License-Identifier: AGPL-3.0-or-later
// Exitance by light tracing: exact transport from any light to the vertices of an object's surface.
#pragma once
#include <array>
#include <optional>
#include <vector>

#include "solvers/render/lights.h"
#include "solvers/transport/light_emission.h"
#include "solvers/transport/path_campaign.h"
#include "solvers/transport/transport_object.h"

namespace shellgrid {

// Powers of three channels, W, each with its standard error.
struct PowerEstimate {
  std::array<Estimate, 3> channel;
};

struct LightTracingResult {
  // Per vertex, over its hat function: M_v = Σ Φ w h_v(x) / (N ∫ h_v dA), W mm⁻².
  std::vector<Rgb> exitance, exitance_error;      // what leaves, and its standard error
  std::vector<Rgb> irradiance, irradiance_error;  // q, what enters
  // Light that meets the surface from outside (where it may come back, each time), enters, leaves after having been
  // in matter, is mirrored; is absorbed in the core (or a homogeneous object) and in the shell; is lost by cracks; what
  // roulettes gave (negative: took), and what paths moved between channels that meet different coefficients: of each
  // path the sum over channels is 0, of each channel the mean. incoming = entering + mirrored; entering + roulette +
  // exchange = leaving + absorbed + lost: to rounding.
  PowerEstimate incoming, entering, leaving, mirrored, absorbed_core, absorbed_shell, lost, roulette, exchange;
  // √(∫ se² / ∫ M²) of the exitance, of the worst channel; none where no light left, or of a single path.
  std::optional<double> relative_error;
};

struct LightTracingOptions {
  std::uint64_t seed = 0;
  // Light that leaves the object or is mirrored may meet it again, as in nature; else it is gone.
  bool interreflection = true;
  // A path each for red, green and blue, instead of one for all with spectral weights: three times the work, and no
  // light moves between channels that meet different coefficients, so that white objects return each exactly.
  bool channels_apart = false;
};

class LightTracing {
 public:
  // `object` must outlive this. Without light all is zero. Throws: InputError where a light stands inside the object.
  LightTracing(const TransportObject& object, const std::vector<Light>& lights, const LightTracingOptions& options);
  PathKind kind() const;
  LightTracingResult result(const PathState& state) const;

 private:
  std::optional<double> relative_error(const PathState& state) const;

  const TransportObject& object_;
  LightTracingOptions options_;
  LightEmission emission_;
  std::vector<double> area_;  // ∫ h_v dA, mm²
};

}  // namespace shellgrid
