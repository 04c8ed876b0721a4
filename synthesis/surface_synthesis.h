// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "meshing/core/progress.h"
#include "meshing/surface/direction_field.h"
#include "synthesis/tangent_neighbours.h"
#include "synthesis/texton_set.h"

namespace shellgrid {

// What a user painted on the surface, vertex by vertex; each may be empty.
struct SurfacePaint {
  std::vector<std::int32_t> sample;  // n: which of the samples is wanted
  std::vector<Vec3f> direction;      // n: where the sample's u must run so; zero: free
  std::vector<float> scale;          // n: how much larger than it is the sample appears
};

enum class SynthesisMethod {
  coherence,   // coherent candidates in appearance space, coarse to fine
  exhaustive,  // the same, rounds of windows included, but every texel is a candidate: the yardstick of their choice
  textons,  // the paper's sweep, see sweep_textons; passes, jitter, penalties and paint of samples have no part in it
};

struct SynthesisOptions {
  SynthesisMethod method = SynthesisMethod::coherence;
  int neighbourhood = 7;       // of the paper's sweep: places across
  int coarse_passes = 6;       // correction passes at the coarsest level
  int passes = 1;              // at each finer level
  int final_passes = 1;        // at the finest
  double jitter = 0.4;         // of upsampled coordinates, in texels of the level
  int least_jitter_level = 2;  // finer levels are not jittered
  int relaxation_sweeps = 2;   // of coordinates within a patch, after each correction pass
  int window_passes =
      2;  // then rounds of discrete optimisation of windows, see optimize_windows; one more at coarse levels
  double evenness = 0.1;           // price of places used too often, see optimize_windows, at the coarse levels
  double final_evenness = 0.01;    // and at the finest
  double incoherence_penalty = 1;  // factor on the distance of candidates that do not continue a neighbour
  double turn_penalty = 1.3;       // a further factor for those that are turned
  Vec3 direction = Vec3(0, 1, 0);  // the texture's u runs this way where the surface allows
  std::vector<DirectionConstraint> orient;  // where it must run otherwise
  SurfacePaint paint;
  double blend_width = 4;   // how far a sample may reach into another's area, texels
  double blend_cost = 1.0;  // price of the farthest, in variances of the appearance
  std::uint64_t seed = 0;
};

// Where the direction field is singular: the texture's directions turn by index · 360° around it.
struct Singularity {
  Vec3 point;    // the middle of its face, mm
  double index;  // a multiple of 1/symmetry
};

// A place in a sample for every vertex of a surface.
struct SurfaceTexture {
  TexturedSurface surface;  // directions: as the sample lies at each vertex, turns of symmetric samples included
  VertexHierarchy hierarchy;
  std::vector<Vec2f> coordinate;     // n: [0, n_x)×[0, n_y), texels; the texel is (floor u, floor v)
  std::vector<std::int32_t> sample;  // n: of which sample
  std::vector<float> coherence;      // n: share of the eight neighbours that continue the vertex's patch, 0 … 1
  std::vector<Singularity> singularities;
  long comparisons = 0;  // of a place's surroundings with a texel's, in all
};

// Grows the samples over the mesh itself, without an atlas: coarse to fine on nested vertex sets, each vertex takes the
// coordinate whose surroundings look most like what its eight tangent-plane neighbours have, among the continuations
// of these neighbours and the candidates most like them. Vertices of one colour of a greedy colouring change at once,
// so the result is the same at any thread count.
// Symmetric samples lie in any of their turns, and the directions are only defined up to such turns, so that their
// singularities are as much milder. Near the border between areas of two samples a vertex may take the place of either,
// at a price that grows with the way across: the border runs where they match best, and nothing is averaged.
// Source: [STF §6], [LefebvreHoppe2006 §4–5], [Tong2002].
// mesh: manifold; its mean edge length must be within 0.4 to 1.7 of textons.voxel.
// Throws: InputError for a mesh or paint that does not fit.
SurfaceTexture synthesize_surface(const TriangleMesh& mesh, const TextonSet& textons, const SynthesisOptions& options,
                                  Progress& progress = no_progress());

}  // namespace shellgrid
