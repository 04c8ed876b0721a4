// SPDX-License-Identifier: AGPL-3.0-or-later
// Looking up a shell texture function at any point and direction, whichever way its values are stored.
#pragma once
#include <memory>
#include <vector>

#include "solvers/diffusion/wide_lanes.h"
#include "solvers/shell_texture/direction_blend.h"
#include "solvers/shell_texture/shell_texture.h"

namespace shellgrid {

// Fluence: I_s and I_m.
struct VoxelLight {
  Vec3f single = Vec3f::Zero(), multiple = Vec3f::Zero();
};

// Light from several directions, made ready for one look-up: made once, used for many voxels.
struct PreparedLight {
  std::vector<DirectionWeight> list;
  std::vector<float> coefficients;  // what a codec makes of it
};

class ShellTextureReader;

// The function itself. Threads may share it; each reads with a reader of its own, which must not outlive it.
class ShellTextureLookup {
 public:
  virtual ~ShellTextureLookup() = default;
  const Vec3i& size() const { return size_; }
  double voxel() const { return voxel_; }  // mm
  const LightDirections& directions() const { return directions_; }
  const std::vector<float>& matter() const { return matter_; }  // per voxel: share of it that is matter
  // Per texel of the bottom and direction, at direction · texels + texel: irradiance that passes down into the core,
  // for unit irradiance across the direction; from below for unit irradiance on the bottom.
  const std::vector<Vec3f>& below() const { return below_; }
  const IrradianceKernels& kernels() const { return kernels_; }

  // Throws: InputError for a direction that the table does not have.
  PreparedLight prepare(std::vector<DirectionWeight> list) const;
  PreparedLight prepare_direction(const Vec3& to_light) const {
    return prepare(blend_directions(directions_, to_light));
  }
  // Downward irradiance into the core below (x, y), in texels: bilinear, wrapped.
  Vec3f below(float x, float y, const PreparedLight& light) const;
  Vec3f below_of_back_light(float x, float y) const;

  virtual std::unique_ptr<ShellTextureReader> reader() const = 0;
  virtual std::size_t bytes() const = 0;  // of the voxels' values, as they are stored

 protected:
  // Takes everything of the texture but I_s and I_m.
  explicit ShellTextureLookup(const ShellTexture& texture);
  virtual void find_coefficients(PreparedLight&) const {}

 private:
  Vec3f below_at(float x, float y, int direction) const;

  Vec3i size_;
  double voxel_;
  LightDirections directions_;
  std::vector<float> matter_;
  std::vector<Vec3f> below_;
  IrradianceKernels kernels_;
};

// Points are in voxels: voxel (x, y, z) covers [x, x+1)×[y, y+1)×[z, z+1), z is depth. x and y wrap around; above the
// first and below the last layer's middle the layer goes on. Trilinear; a voxel counts as much as it holds matter, so
// that free space does not darken the surface; points without matter about them take that of the layers below.
// Source: [STF §7].
class ShellTextureReader {
 public:
  virtual ~ShellTextureReader() = default;
  VoxelLight at(const Vec3f& point, const PreparedLight& light);
  // I_m(ω_b): for radiance L from below the fluence is 2π L of it.
  Vec3f back(const Vec3f& point);

  // One voxel's value: I_s and I_m summed over the light's directions, each times its weight. `voxel_index` below the
  // number of voxels.
  virtual VoxelLight voxel_light(std::size_t voxel_index, const PreparedLight& light) = 0;
  virtual Vec3f voxel_back(std::size_t voxel_index) = 0;

 protected:
  explicit ShellTextureReader(const ShellTextureLookup& lookup) : lookup_(lookup) {}

 private:
  template <class Value, class Read>
  Value interpolate(const Vec3f& point, const Read& read);

  const ShellTextureLookup& lookup_;
};

// Values in single precision, those of a voxel side by side.
struct StoredVoxels {
  explicit StoredVoxels(const ShellTexture& texture);  // zeros, of its size
  VoxelLight& at(std::size_t voxel, int direction) { return light.data()[voxel * directions + direction]; }
  const VoxelLight* row(std::size_t voxel) const { return light.data() + voxel * directions; }

  int directions = 0;
  StreamBuffer<VoxelLight> light;
  std::vector<Vec3f> back;
};
// texture: its own I_s and I_m are not looked at.
std::unique_ptr<ShellTextureLookup> look_up_voxels(const ShellTexture& texture, StoredVoxels voxels);
// The values as they are.
std::unique_ptr<ShellTextureLookup> look_up_as_it_is(const ShellTexture& texture);
// Of what passes through its bottom alone: it has no reader.
std::unique_ptr<ShellTextureLookup> look_up_bottom(const ShellTexture& texture);

}  // namespace shellgrid
