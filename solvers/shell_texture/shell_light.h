// SPDX-License-Identifier: AGPL-3.0-or-later
// The light within a shell, voxel by voxel, worked out where it is asked for.
#pragma once
#include <array>
#include <atomic>
#include <cstdint>
#include <limits>
#include <memory>
#include <vector>

#include "meshing/shell/shell_volume.h"
#include "meshing/surface/closest_point.h"
#include "solvers/shell_texture/body_shape.h"
#include "solvers/shell_texture/lazy_list.h"
#include "solvers/shell_texture/shell_curvature.h"
#include "solvers/shell_texture/spread_light.h"

namespace shellgrid {

// Which parts of the light are wanted.
struct ShellLightParts {
  bool outside = true, core = true;
};

// Threads may share it; each asks through a reader of its own.
class ShellLight {
 public:
  // core: exitance of the core below each vertex of the surface, or empty. curvature: of the shell, or none: it is
  // taken as flat. All must outlive this. Throws: InputError where the core does not have the surface's size.
  ShellLight(const ShellVolume& shell, const TexturedFrames& frames, const SpreadLight& incident,
             const ShellTextureLookup& texture, const std::vector<Rgb>& core, const ShellLightParts& parts,
             const ShellCurvature* curvature = nullptr, const BodyShape& shape = {});

  const ShellVolume& shell() const { return shell_; }
  // Linear between the vertices about a point; `vertex` is the nearest one.
  Rgb core_exitance(int vertex, const Vec3& point) const { return core_exitance(place_about(vertex, point)); }
  bool has_core() const { return !core_.empty() && parts_.core; }

  struct Counts {
    std::int64_t voxels = 0, leaves = 0, vertices = 0;
  };
  Counts counts() const;

 private:
  static constexpr int leaf_size = TwoLevelGrid<Vec3f>::leaf_size;
  // The beams in one voxel of matter.
  struct Beams {
    Rgb source = Rgb::Zero();  // φ/4π of the beams in its middle
    Rgb share = Rgb::Zero();   // of the sample's beams: by curvature, and of the voxel's mean in its middle
    Rgb fall = Rgb::Zero();    // optical depth of a voxel along the beams; 0 where matter does not fill the voxel
    Vec3f normal = Vec3f::Zero();
    float from_middle = 0;     // of the sample's voxel, outwards, to that of this one, voxels
    float way = 0;             // of the beams for each step down; 0 where matter does not fill the voxel
    std::int32_t vertex = -1;  // of the surface, nearest
  };
  // Values are written once, then their flag is set: 0 unknown, 1 being written, 2 there.
  struct Leaf {
    Leaf() {}  // values stay as the memory has them
    // φ of scattered light and the core's, W mm⁻²; in the last lane 1 where there is matter, else all 0.
    mutable std::array<Float4, leaf_size> multiple;
    mutable std::array<Beams, leaf_size> beams;
    mutable std::array<std::atomic<std::uint8_t>, leaf_size> flags = {};
  };

 public:
  class Reader {
   public:
    explicit Reader(const ShellLight& light) : light_(light), texture_(light.texture_.reader()) {}

    // φ of the multiple kind about a point, by its grid coordinates: trilinear between voxels of matter. None where
    // there is no matter.
    Rgb multiple(const Vec3& index);
    // The vertex nearest to that voxel of the eight about a point which weighs most; -1 without matter.
    std::int32_t vertex(const Vec3& index);
    // ∑ I_0 I_s p of the beams at a point of that voxel: what they scatter along −`direction`, a ray of sight. Within
    // the voxel they fall as matter of its extinction lets them, so that the mean stays the table's: s mm on along the
    // ray it is e^{`growth` s} as much.
    Rgb beams(const Vec3i& voxel, const Vec3& index, const Vec3& direction, const Vec3f& anisotropy,
              const Rgb& extinction, Rgb& growth);

   private:
    struct Found {
      Vec3i at = Vec3i::Constant(std::numeric_limits<int>::min());
      int index = -1;
      const Leaf* leaf = nullptr;
    };
    const Found& find_leaf(const Vec3i& leaf_at);
    // The voxel's light is there then.
    void need(const Found& found, int offset, const Vec3i& voxel);

    const ShellLight& light_;
    std::unique_ptr<ShellTextureReader> texture_;
    int vertex_ = -1;              // found last
    std::array<Found, 8> leaves_;  // read last, by their places' last bits
    // The last light that was weighted by a phase function.
    int phase_vertex_ = -1;
    Vec3 phase_direction_ = Vec3::Zero();
    Vec3f phase_anisotropy_ = Vec3f::Zero();
    PreparedLight phase_light_;
  };

 private:
  // multiple: with its last lane.
  void work_out(int leaf_index, int offset, const Vec3i& voxel, ShellTextureReader& texture, int& vertex,
                Float4& multiple, Beams& beams) const;
  struct SurfaceLight {
    PreparedLight light;
    Vec3f irradiance = Vec3f::Zero();
  };
  struct VertexLight {
    SurfaceLight light;
    // How bright `light` would make each of the kernels' bands, and how bright the light about does; the latter empty
    // where that is the same.
    std::vector<Vec3f> own, strength;
    std::vector<SurfaceLight> spread;  // the light about as each band sees it; none where it is `light` in its strength
    float way = 0;  // of refracted beams for each step down, 1/cosθ; of many beams the one that serves for all
    const SurfaceLight& in_band(int band) const { return spread.empty() ? light : spread[band]; }
    const Vec3f& strength_in_band(int band) const { return strength.empty() ? own[band] : strength[band]; }
    // Of `in_band`'s list.
    const Vec3f& list_strength(int band) const { return spread.empty() ? own[band] : strength[band]; }
  };
  const VertexLight& light_at(int vertex) const;
  SurfaceLight prepared(std::vector<DirectionWeight> list) const;
  // A triangle's vertices and barycentric weights: where a point lies above or below the faces about a vertex.
  struct SurfacePlace {
    std::array<int, 3> vertices = {};
    std::array<float, 3> weights = {};
  };
  SurfacePlace place_about(int vertex, const Vec3& point) const;
  static Rgb at_place(const std::vector<Rgb>& values, const SurfacePlace& place) {
    return place.weights[0] * values[place.vertices[0]] + place.weights[1] * values[place.vertices[1]] +
           place.weights[2] * values[place.vertices[2]];
  }
  Rgb core_exitance(const SurfacePlace& place) const { return at_place(core_, place); }
  // A list of light, its strength, and that in which it is meant.
  struct Part {
    const SurfaceLight& light;
    const Vec3f &list, &strength;
  };
  // `look_up` of the light of the place's vertices, linear between them. own: of the nearest one. part: of a vertex's.
  template <class PartOf, class LookUp>
  Vec3f between(const SurfacePlace& place, const VertexLight& own, const PartOf& part, const LookUp& look_up) const;
  // The table's direction within matter below a smooth surface.
  Vec3 refracted_direction(int direction) const;
  std::size_t sample_voxel(const Vec3f& place, float& outwards) const;

  bool is_matter(std::size_t sampled) const { return texture_.matter()[sampled] > 0.999f; }

  const ShellVolume& shell_;
  TexturedFrames frames_;
  const SpreadLight& incident_;
  const ShellTextureLookup& texture_;
  const std::vector<Rgb>& core_;
  ShellLightParts parts_;
  const ShellCurvature* curvature_;
  BodyShape shape_;
  double relative_ior_;
  NearestVertexQuery vertices_;
  std::vector<int> first_face_, faces_about_;  // of vertices: of vertex v from first_face_[v] on
  LazyList<Leaf> leaves_;
  LazyList<VertexLight> lights_;  // of vertices
  mutable std::atomic<std::int64_t> voxels_{0};
};

}  // namespace shellgrid
