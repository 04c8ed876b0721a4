// SPDX-License-Identifier: AGPL-3.0-or-later
// Transport in shapes that published tables and closed forms know: slab, half-space, sphere of shells.
#pragma once
#include <string>
#include <vector>

#include "solvers/transport/diffuse_leap.h"
#include "solvers/transport/path_campaign.h"

namespace shellgrid {

enum class TallyShape { slab, half_space, sphere };

// centre: into all directions alike from a sphere's centre. parallel: one direction; normal to a slab. diffuse: the
// same radiance from all directions outside.
enum class TallySource { centre, parallel, diffuse };

// One medium, grey. Coefficients in mm⁻¹.
struct TallyLayer {
  double absorption = 0, scattering = 1, anisotropy = 0;
  double radius = 0;  // of a sphere's shell: to where it reaches, mm
};

struct TallyProblem {
  TallyShape shape = TallyShape::slab;
  TallySource source = TallySource::parallel;
  std::vector<TallyLayer> layers = {TallyLayer()};  // of a sphere from inside out, else one
  double thickness = 1;                             // of a slab, mm
  double ior = 1;                                   // of all layers, over that of the outside
  int bins = 50;                                    // of the radial profile
  double extent = 0;  // of the profile, mm; 0: a sphere's radius, else ten transport mean free paths
  std::uint64_t seed = 0;
  bool leaps = true;  // deep inside, many collisions at once
};

// Shares of the light sent.
struct TallyResult {
  Estimate diffuse_reflectance;    // of what entered, what leaves on the side that the light comes from; a sphere: all
  Estimate specular_reflectance;   // mirrored at the first boundary
  Estimate transmittance;          // what leaves on a slab's other side; from a sphere's centre: what leaves
  Estimate unscattered;            // of the transmittance, what never met matter
  std::vector<Estimate> absorbed;  // per layer
  Estimate lost;                   // of paths that were cut off
  // Rings of a slab's and a half-space's surfaces about the beam: what leaves there over the rings' area, mm⁻².
  // Shells of a sphere: the mean fluence, mm⁻².
  std::vector<double> radius;  // edges of the bins, mm: one more than bins
  std::vector<Estimate> reflectance_profile, transmittance_profile, fluence_profile;
};

// Slab and half-space lie in z ≥ 0 with light from z < 0. Throws: InputError for what is not finite or out of range.
class TallyTransport {
 public:
  explicit TallyTransport(const TallyProblem& problem);
  // What is to be followed; valid as long as this lives. The error is the largest relative one of diffuse_reflectance
  // and transmittance.
  PathKind kind() const;
  TallyResult result(const PathState& state) const;
  const TallyProblem& problem() const { return problem_; }

 private:
  enum Slot : std::size_t { reflected, specular, transmitted, unscattered, lost, first_layer };
  struct Medium {
    double extinction, albedo, anisotropy, inverse_extinction, outer, inner;  // shells: radii
    DiffuseLeap leap;
  };
  struct Walk;
  void follow_slab(Walk& walk) const;
  void follow_sphere(Walk& walk) const;
  // `clearance`: how far the layer surely reaches about the point, mm.
  bool interact(Walk& walk, std::size_t layer, double clearance) const;
  bool leap(Walk& walk, std::size_t layer, double radius) const;
  bool outlived(Walk& walk) const;
  void track(const Walk& walk, double length) const;
  std::size_t profile_slot(int profile, std::size_t bin) const {
    return first_layer + media_.size() + profile * bins_ + bin;
  }

  TallyProblem problem_;
  std::vector<Medium> media_;
  std::size_t bins_;
  double bin_width_;
};

}  // namespace shellgrid
