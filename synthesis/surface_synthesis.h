// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "meshing/core/progress.h"
#include "meshing/surface/direction_field.h"
#include "synthesis/tangent_neighbours.h"
#include "synthesis/texton_set.h"

namespace shellgrid {

struct SynthesisOptions {
  int coarse_passes = 6;                    // correction passes at the coarsest level
  int passes = 2;                           // at each finer level
  int final_passes = 4;                     // at the finest
  double jitter = 0.4;                      // of upsampled coordinates, in texels of the level
  int least_jitter_level = 2;               // finer levels are not jittered
  int relaxation_sweeps = 2;                // of coordinates within a patch, after each correction pass
  double incoherence_penalty = 1.05;        // factor on the distance of candidates that do not continue a neighbour
  Vec3 direction = Vec3(0, 1, 0);           // the texture's u runs this way where the surface allows
  std::vector<DirectionConstraint> orient;  // where it must run otherwise
  std::uint64_t seed = 0;
};

// Where the direction field is singular: the texture's directions turn once around it.
struct Singularity {
  Vec3 point;  // the middle of its face, mm
  int index;   // +1 or −1
};

// A texture coordinate for every vertex of a surface.
struct SurfaceTexture {
  TexturedSurface surface;
  VertexHierarchy hierarchy;
  std::vector<Vec2f> coordinate;  // n: [0, n_x)×[0, n_y), texels; the texel is (floor u, floor v)
  std::vector<float> coherence;   // n: share of the eight neighbours that continue the vertex's patch, 0 … 1
  std::vector<Singularity> singularities;
};

// Grows the sample over the mesh itself, without an atlas: coarse to fine on nested vertex sets, each vertex takes the
// coordinate whose surroundings look most like what its eight tangent-plane neighbours have, among the continuations
// of these neighbours and the candidates most like them. Vertices of one colour of a greedy colouring change at once,
// so the result is the same at any thread count.
// Source: [STF §6], [LefebvreHoppe2006 §4–5], [Tong2002].
// mesh: manifold; its mean edge length must be within 0.4 to 1.7 of textons.voxel.
// Throws: InputError for a mesh that does not fit.
SurfaceTexture synthesize_surface(const TriangleMesh& mesh, const TextonSet& textons, const SynthesisOptions& options,
                                  Progress& progress = no_progress());

}  // namespace shellgrid
