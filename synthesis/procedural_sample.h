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

// Growth rings about a pith along x, cut lengthwise (a board): the pith lies below or above the top in the middle of y.
struct WoodPattern {
  Material body, ring;      // of early and of late wood
  double ring_width = 3;    // mm
  double pith_depth = 12;   // of the pith below the top, mm; negative: above it
  double waviness = 1;      // amplitude by which rings deviate, mm
  double fibre_length = 8;  // of the fibres along x, mm
  double fibres = 0.5;      // absorption runs over factors e^±fibres from fibre to fibre
  double pores = 0.03;      // share of the early wood's cross-section in dark vessels along the fibres, 0 … 0.3
};

// Cells about scattered points, between walls of even width. Source: [Worley1996].
struct CellsPattern {
  Material body, wall;
  int cells = 8;          // across n_x
  double wall_width = 1;  // mm
  double variation = 1;   // absorption runs over factors e^±variation from cell to cell
  double jitter = 1;      // of the points about a lattice, 0 … 1
};

// Bent tapering blades on a ground, overlapping and drooping: no height field.
struct GrassPattern {
  Material body, blade;
  int count = 150;
  double height = 3;    // the tallest blade's tip above the ground, mm
  double radius = 0.5;  // of a blade at its root, mm
  double bend = 0.7;    // 0: upright; 1: the tip is as far aside as the blade is long
};

// Yarns over and under each other above a backing: no height field.
struct WeavePattern {
  Material body, warp, weft;           // backing, yarns along y, yarns along x
  int warp_count = 8, weft_count = 8;  // across the sample; multiples of `over` + `under`
  int over = 1, under = 1;             // 1, 1: plain weave; 2, 2: twill
  double fill = 0.9;                   // a yarn's width over the yarns' distance
  double height = 1;                   // half a yarn's thickness, mm
  int strands = 3;                     // twisted together in a yarn; 0: smooth
};

using SamplePattern = std::variant<MarblePattern, SpotsPattern, LayersPattern, BumpsPattern, WoodPattern, CellsPattern,
                                   GrassPattern, WeavePattern>;

struct SampleDefinition {
  int width = 128, height = 128;  // n_x, n_y, texels
  double voxel = 0.4;             // d_0, mm
  double thickness = 4;           // mm; n_z = thickness / voxel, rounded up
  double ior = 1.5;
  std::uint64_t seed = 1;
  SamplePattern pattern;
};

// The sample's size in voxels, without making it. Throws: InputError where a size is out of range, a relief too
// deep, or yarns make no whole repeats.
Vec3i procedural_sample_size(const SampleDefinition& definition);

// The base volume V_b of a procedural material, tilable in x and y. Source: [STF §4, §5.1].
// Throws: InputError as procedural_sample_size.
MaterialSample make_procedural_sample(const SampleDefinition& definition);

}  // namespace shellgrid
