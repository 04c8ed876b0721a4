// SPDX-License-Identifier: AGPL-3.0-or-later
// Light at a surface as the matter below sees it: from all of the surface about, by irradiance correction kernels.
#pragma once
#include <atomic>
#include <cstdint>
#include <memory>
#include <vector>

#include "solvers/diffusion/channel_lanes.h"
#include "solvers/shell_texture/lazy_list.h"
#include "solvers/shell_texture/vertex_buckets.h"

namespace shellgrid {

// How light that is uneven about a place reaches the matter below: as if it were even; by one kernel, the mean of all;
// or by the kernel of each place of entry.
enum class IrradianceCorrection { none, one_kernel, kernels };
IrradianceKernels corrected_by(const IrradianceKernels& kernels, IrradianceCorrection correction);

// Some bands of kernels with what lies at one distance side by side, four bands in a register.
class BandKernels {
 public:
  using Lanes = float __attribute__((vector_size(64)));  // red, green, blue and nothing, of four bands

  BandKernels() = default;
  BandKernels(const IrradianceKernels& kernels, int first_band, int end_band);
  int bands() const { return bands_; }
  int wide() const { return (bands_ + 3) / 4; }  // registers
  // `area` times each band's value at that distance, mm; as IrradianceKernels::value.
  void at(int kernel, float distance, float area, Lanes* values) const;
  // One kernel: the sum of these, by their areas.
  BandKernels sum(const std::vector<std::pair<int, float>>& kernel_areas) const;

 private:
  int bands_ = 0, rings_ = 0;
  float per_ring_ = 0;
  std::vector<Lanes> values_;  // at (kernel · (rings + 1) + ring) · wide; the last ring's are 0
};

// How bright light of each of the table's directions makes the matter of a band, of unit irradiance across it: at band
// · directions + direction; the bottom's, what passes through it. Means of the sample. bottom_alone: the others' are
// that of the cosine.
std::vector<Vec3f> band_responses(const ShellTextureLookup& texture, bool bottom_alone);

// The shell texture function takes the light that one place of the surface gets to shine on all of the sample. Where it
// does not, at the borders of shadows and where the surface turns away, scattered light comes from the light about:
// Σ_u A_u κ(d_u) L_u / Σ_u A_u κ(d_u), with κ the kernel of the place u and L_u its light by the table's directions.
// Even light stays even. Source: [STF §7, irradiance correction], there I_0(x') plus the kernel's sum of I_0(u) −
// I_0(x'), of photons from each u; the same but for the sum's normalisation.
//
// Worked out where it is asked for. Threads may share it.
class SpreadLight {
 public:
  // coordinates: of the vertices in the sample, texels. kernels may be none: then nothing spreads. responses: of the
  // kernels' bands, or none: that of the cosine. All must outlive this. Throws: InputError where sizes do not match.
  SpreadLight(const IncidentLight& incident, const IrradianceKernels& kernels, const Vec3i& sample,
              const std::vector<Vec2f>& coordinates, const std::vector<Vec3f>& responses = {});

  // The light itself: ordered by direction, each once.
  const std::vector<DirectionWeight>& at(int vertex) const;
  // The light of which matter in bands of depth scatters its share.
  struct Bands {
    std::vector<Vec3f> own;                          // how bright `at` would make each
    std::vector<Vec3f> strength;                     // how bright it is; empty where it is `at` itself
    std::vector<std::vector<DirectionWeight>> list;  // of each; empty where it is `at` in that strength
  };
  // For each of the kernels' bands but the bottom; `at` itself within `unevenness` of the brightest. Not kept.
  Bands spread(int vertex) const;
  // The same for what passes through the bottom alone.
  std::vector<DirectionWeight> at_bottom(int vertex) const;

  // The kernels' band of a layer of voxels; -1: none.
  int band_of(int layer) const { return kernels_.empty() ? -1 : kernels_.band_of(layer); }

  std::int64_t spread_vertices() const { return spread_vertices_; }
  static constexpr double unevenness = 0.01;
  // Light that differs by less from that about it is the same in another strength, of its own.
  static constexpr double gentle = 0.2;

 private:
  struct Entry {
    std::vector<DirectionWeight> light;
    Vec3f irradiance = Vec3f::Zero();
  };
  const Entry& entry(int vertex) const;
  // Of a bucket's members, one after the other.
  struct Source {
    Vec3f place = Vec3f::Zero();
    float area = 0;
    Float4 irradiance = {};
    int kernel = 0;
  };
  struct LitBucket {
    Entry mean;
    std::vector<Source> sources;
  };
  const LitBucket& lit(int bucket) const;
  struct LitReach {
    std::vector<BandKernels::Lanes> responses;  // to a bucket's mean, then to its members
    BandKernels whole;                          // of light all over it, all its area at once
  };
  // By distance; of light that enters at a vertex, and all over a bucket.
  struct Reach {
    BandKernels point, whole;
    std::vector<BandKernels::Lanes> response;                                   // at direction · wide
    LazyList<LitReach> lit = {};                                                // of buckets
    mutable std::vector<std::atomic<std::uint8_t>> even = {}, even_about = {};  // 0 unknown, 1 uneven, 2 even
  };
  const LitReach& lit(int bucket, const Reach& reach) const;
  Bands worked_out(int vertex, const Reach& reach) const;
  // Whether light is even all about a bucket, as told by its own and its neighbours' means.
  bool is_even_about(int bucket, const Reach& reach) const;
  bool is_even(int bucket, const Reach& reach) const;
  int kernel_of(int vertex) const;
  const std::vector<int>& about(int bucket) const;  // the buckets of which light may reach its matter

  const IncidentLight& incident_;
  IrradianceKernels kernels_;
  Vec3i sample_;
  const std::vector<Vec2f>& coordinates_;
  Reach within_, bottom_;         // of all bands but the bottom; of the bottom
  double radius_ = 0, edge_ = 0;  // of what counts, mm; of the buckets' cells, mm
  std::vector<float> areas_;      // of vertices, mm²
  VertexBuckets buckets_;
  std::vector<std::vector<std::pair<int, float>>> kernel_areas_;  // of buckets: kernels and their areas, mm²
  LazyList<Entry> entries_;
  LazyList<LitBucket> lit_;
  LazyList<std::vector<int>> about_;
  mutable std::atomic<std::int64_t> spread_vertices_{0};
};

}  // namespace shellgrid
