// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <variant>
#include <vector>

#include "meshing/core/material.h"
#include "synthesis/material_sample.h"

namespace shellgrid {

// One family of veins: the zero set of a warped periodic function, so veins are sheets that go into depth.
struct VeinFamily {
  int cells = 2;                 // noise cells across the sample; more cells, denser veins
  double width = 2;              // mean width, mm
  double variation = 1;          // of the width: it runs over factors e^±variation
  double strength = 1;           // 0 … 1, share of the way from body to vein
  double coverage = 1;           // 0 … 1, share of the sheets that is there; elsewhere they fade out
  int waves_x = 0, waves_y = 0;  // whole waves across the sample that line the veins up; 0, 0: a network
};

struct MarblePattern {
  Material body, vein;
  std::vector<VeinFamily> veins;
  double warp = 6;        // amplitude of the domain warp, mm
  double cloudiness = 1;  // absorption of the body runs over factors e^±cloudiness
};

struct SpotsPattern {
  Material body, spot;
  int count = 60;
  double radius = 2;       // mean, mm
  double variation = 0.5;  // of the radius, share of it
  double softness = 0.4;   // mm over which a spot fades
};

struct LayersPattern {
  struct Layer {
    Material material;
    double thickness = 1;  // mm
  };
  std::vector<Layer> layers;  // from the top; the last one goes on to the bottom
  double waviness = 0;        // amplitude of the interfaces, mm
  int cells = 4;              // waves across the sample
};

// Balls on short stems over a ground: below its equator a ball overhangs, so the surface is no height field.
struct BumpsPattern {
  Material body, bump;
  int count = 40;
  double radius = 2;  // mm
  double lift = 0.5;  // height of a ball's centre above the ground, in radii
};

using SamplePattern = std::variant<MarblePattern, SpotsPattern, LayersPattern, BumpsPattern>;

struct SampleDefinition {
  int width = 128, height = 128;  // n_x, n_y, texels
  double voxel = 0.4;             // d_0, mm
  double thickness = 4;           // mm; n_z = thickness / voxel, rounded up
  double ior = 1.5;
  std::uint64_t seed = 1;
  SamplePattern pattern;
};

// The sample's size in voxels, without making it. Throws: InputError where a size is out of range or bumps are too
// deep.
Vec3i procedural_sample_size(const SampleDefinition& definition);

// The base volume V_b of a procedural material, tilable in x and y. Source: [STF §4, §5.1].
// Throws: InputError as procedural_sample_size.
MaterialSample make_procedural_sample(const SampleDefinition& definition);

// Marks interior voxels that touch free space through a face (or stand at the top) as surface. Their normals come from
// `outward` at the voxel's centre where it is given, else from the smoothed occupancy.
void mark_surface(MaterialSample& sample, const std::vector<Vec3f>* outward = nullptr);

}  // namespace shellgrid
