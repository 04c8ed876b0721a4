// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/closed_forms.h"

#include <Eigen/Dense>
#include <cmath>
#include <numbers>

#include "solvers/scattering/fresnel.h"

namespace shellgrid {
namespace {

constexpr double pi = std::numbers::pi;

// sinh(k r)/r over its value at r = 0 scaled by e^{-k R}, so that nothing overflows; and its derivative.
double sphere_mode(double k, double r, double radius) {
  if (k == 0) return 1;
  if (k * r < 1e-4) return k * std::exp(-k * radius) * (1 + k * k * r * r / 6);
  return 0.5 * (std::exp(k * (r - radius)) - std::exp(-k * (r + radius))) / r;
}
double sphere_mode_slope(double k, double r, double radius) {
  if (k == 0) return 0;
  if (k * r < 1e-4) return k * std::exp(-k * radius) * k * k * r / 3;
  const double sum = 0.5 * (std::exp(k * (r - radius)) + std::exp(-k * (r + radius)));
  return (k * sum - sphere_mode(k, r, radius)) / r;
}

// e^{-k (r − from)}/r, and 1/r where k = 0.
double falling_mode(double k, double r, double from) { return std::exp(-k * (r - from)) / r; }
double falling_mode_slope(double k, double r, double from) { return -falling_mode(k, r, from) * (k + 1 / r); }

}  // namespace

double DiffusionCoefficients::decay() const { return std::sqrt(absorption / diffusion()); }

SlabSolution::SlabSolution(const DiffusionCoefficients& material, double thickness, double ior, double q0, double q1)
    : decay_(material.decay()), thickness_(thickness) {
  const DiffuseFresnel f = diffuse_fresnel(ior);
  const double d = material.diffusion(), c = f.boundary_factor, k = decay_;
  // φ = a e^{−kz} + b e^{−k(T−z)}, or a + b z without absorption.
  const double e = std::exp(-k * thickness);
  Eigen::Matrix2d system;
  if (k > 0)
    system << 1 + 2 * c * d * k, e * (1 - 2 * c * d * k), e * (1 - 2 * c * d * k), 1 + 2 * c * d * k;
  else
    system << 1, -2 * c * d, 1, thickness + 2 * c * d;
  const Eigen::Vector2d right = 4 / (1 - f.fluence_reflectance) * Eigen::Vector2d(q0, q1);
  const Eigen::Vector2d solution = system.inverse() * right;
  a_ = solution[0];
  b_ = solution[1];
  // −D ∂φ/∂n = (φ − 4q/(1 − R_φ)) / (2C).
  exitance_at_zero = q0 + (fluence(0) - right[0]) / (2 * c);
  exitance_at_thickness = q1 + (fluence(thickness) - right[1]) / (2 * c);
}

double SlabSolution::fluence(double z) const {
  if (decay_ == 0) return a_ + b_ * z;
  return a_ * std::exp(-decay_ * z) + b_ * std::exp(-decay_ * (thickness_ - z));
}

BeamSlabSolution::BeamSlabSolution(const DiffusionCoefficients& material, double thickness, double ior,
                                   double irradiance)
    : decay_(material.decay()), extinction_(material.absorption + material.reduced_scattering), thickness_(thickness) {
  const double d = material.diffusion(), reach = 2 * diffuse_fresnel(ior).boundary_factor * d, k = decay_;
  // φ = P e^{−σ_t' z} + a e^{−kz} + b e^{−k(T−z)}, or a + b z without absorption; φ + 2CD ∂φ/∂n = 0 at both ends.
  particular_ = irradiance * material.reduced_scattering / (material.absorption - d * extinction_ * extinction_);
  const double e = std::exp(-k * thickness), far = particular_ * std::exp(-extinction_ * thickness);
  Eigen::Matrix2d system;
  if (k > 0)
    system << 1 + reach * k, e * (1 - reach * k), e * (1 - reach * k), 1 + reach * k;
  else
    system << 1, -reach, 1, thickness + reach;
  const Eigen::Vector2d solution =
      system.inverse() * Eigen::Vector2d(-particular_ * (1 + reach * extinction_), -far * (1 - reach * extinction_));
  a_ = solution[0];
  b_ = solution[1];
  exitance_at_zero = fluence(0) * d / reach;
  exitance_at_thickness = fluence(thickness) * d / reach;
}

double BeamSlabSolution::fluence(double z) const {
  const double beam = particular_ * std::exp(-extinction_ * z);
  if (decay_ == 0) return beam + a_ + b_ * z;
  return beam + a_ * std::exp(-decay_ * z) + b_ * std::exp(-decay_ * (thickness_ - z));
}

SphereSolution::SphereSolution(const DiffusionCoefficients& material, double radius, double ior, double irradiance)
    : decay_(material.decay()) {
  const DiffuseFresnel f = diffuse_fresnel(ior);
  const double light = 4 * irradiance / (1 - f.fluence_reflectance);
  // The mode is scaled to the surface; φ = scale · mode(r) / mode(R).
  const double at_surface = sphere_mode(decay_, radius, radius);
  const double slope = sphere_mode_slope(decay_, radius, radius) / at_surface;
  const double surface = light / (1 + 2 * f.boundary_factor * material.diffusion() * slope);
  scale_ = surface / at_surface;
  radius_ = radius;
  exitance = irradiance - material.diffusion() * surface * slope;
}

double SphereSolution::fluence(double r) const { return scale_ * sphere_mode(decay_, r, radius_); }

TwoLayerSphereSolution::TwoLayerSphereSolution(const DiffusionCoefficients& inner, const DiffusionCoefficients& outer,
                                               double interface, double radius, double ior, double irradiance)
    : inner_decay_(inner.decay()), outer_decay_(outer.decay()), interface_(interface), radius_(radius) {
  const DiffuseFresnel f = diffuse_fresnel(ior);
  const double ki = inner_decay_, ko = outer_decay_, a = interface, big = radius;
  const double di = inner.diffusion(), d = outer.diffusion(), c = f.boundary_factor;
  // Inside: A · mode(r; a). Outside: B · mode(r; R) + E · falling(r; a).
  Eigen::Matrix3d system;
  system << sphere_mode(ki, a, a), -sphere_mode(ko, a, big), -falling_mode(ko, a, a),                           //
      di * sphere_mode_slope(ki, a, a), -d * sphere_mode_slope(ko, a, big), -d * falling_mode_slope(ko, a, a),  //
      0, sphere_mode(ko, big, big) + 2 * c * d * sphere_mode_slope(ko, big, big),
      falling_mode(ko, big, a) + 2 * c * d * falling_mode_slope(ko, big, a);
  const Eigen::Vector3d right(0, 0, 4 * irradiance / (1 - f.fluence_reflectance));
  const Eigen::Vector3d solution = system.fullPivLu().solve(right);
  inner_scale_ = solution[0];
  growing_ = solution[1];
  falling_ = solution[2];
  exitance = irradiance - d * (growing_ * sphere_mode_slope(ko, big, big) + falling_ * falling_mode_slope(ko, big, a));
}

double TwoLayerSphereSolution::fluence(double r) const {
  if (r <= interface_) return inner_scale_ * sphere_mode(inner_decay_, r, interface_);
  return growing_ * sphere_mode(outer_decay_, r, radius_) + falling_ * falling_mode(outer_decay_, r, interface_);
}

double dipole_reflectance(const DiffusionCoefficients& material, double ior, double r) {
  const double extinction = material.absorption + material.reduced_scattering;
  const double albedo = material.reduced_scattering / extinction;
  const double transport = std::sqrt(3 * material.absorption * extinction);
  const double real = 1 / extinction, virtual_depth = real * (1 + 4 * polynomial_boundary_factor(ior) / 3);
  auto source = [&](double depth) {
    const double distance = std::hypot(r, depth);
    return depth * (1 + transport * distance) * std::exp(-transport * distance) / (distance * distance * distance);
  };
  return albedo / (4 * pi) * (source(real) + source(virtual_depth));
}

double dipole_total_reflectance(double reduced_albedo, double ior) {
  const double root = std::sqrt(3 * (1 - reduced_albedo));
  return 0.5 * reduced_albedo * (1 + std::exp(-4.0 / 3 * polynomial_boundary_factor(ior) * root)) * std::exp(-root);
}

}  // namespace shellgrid
