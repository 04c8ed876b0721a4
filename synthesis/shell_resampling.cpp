// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/shell_resampling.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

using Mask = TwoLevelGrid<float>::Mask;

// The field names mesh vertices by their indices: each must lie within an edge of the nearest point that it stands for.
void require_field_of_mesh(const TriangleMesh& mesh, const DistanceField& distance) {
  double longest = 0;
  for (int f = 0; f < mesh.face_count(); ++f)
    for (int k = 0; k < 3; ++k) longest = std::max(longest, (mesh.corner(f, k) - mesh.corner(f, (k + 1) % 3)).norm());
  bool fits = true;
  distance.nearest_vertex.for_each_active([&](int i, int j, int k, std::int32_t v) {
    const Vec3 nearest = distance.nearest_point.value(i, j, k).cast<double>();
    fits = fits && v >= 0 && v < mesh.vertex_count() && (mesh.vertex(v) - nearest).norm() <= 1.01 * longest;
  });
  if (!fits) throw InputError("the distance field is of another mesh; make both from one surface.ply");
}

void check_inputs(const TexturedMesh& mesh, const DistanceField& distance,
                  const std::vector<const MaterialSample*>& samples, double thickness) {
  if (samples.empty()) throw InternalError("a sample expected");
  const MaterialSample& sample = *samples.front();
  for (const MaterialSample* other : samples)
    if (std::abs(other->voxel - sample.voxel) > 1e-4 * sample.voxel)
      throw InputError(
          fmt::format("the samples' voxels are {} mm and {} mm; they must be equal; try sg-sample --voxel {}",
                      sample.voxel, other->voxel, sample.voxel));
  for (std::size_t k = 0; k < std::min(samples.size(), mesh.sample_sizes.size()); ++k)
    for (int axis = 0; axis < 2; ++axis)
      if (const int n = mesh.sample_sizes[k][axis]; n > 0 && n != samples[k]->size[axis])
        throw InputError(fmt::format(
            "sample {} has {} x {} texels and the mesh carries one of {} x {}; give the sample that "
            "sg-textons had",
            k, samples[k]->size.x(), samples[k]->size.y(), mesh.sample_sizes[k].x(), mesh.sample_sizes[k].y()));
  if (mesh.sample.empty() && samples.size() > 1)
    throw InputError(fmt::format(
        "the mesh carries one sample and {} are given; it must say where each belongs, in the property 'sample'",
        samples.size()));
  for (const std::int32_t wanted : mesh.sample)
    if (wanted >= static_cast<std::int32_t>(samples.size()))
      throw InputError(
          fmt::format("the mesh carries {} samples and {} {} given; name all of them, in sg-textons' order",
                      *std::max_element(mesh.sample.begin(), mesh.sample.end()) + 1, samples.size(),
                      samples.size() == 1 ? "is" : "are"));
  if (std::abs(distance.frame.voxel - sample.voxel) > 1e-4 * sample.voxel)
    throw InputError(
        fmt::format("the distance field's voxel is {} mm and the sample's {} mm; they must be equal; try "
                    "sg-distance --voxel {}",
                    distance.frame.voxel, sample.voxel, sample.voxel));
  if (!(thickness > 0)) throw InputError("the shell's thickness must be above 0");
  if (distance.inside_band < thickness * (1 - 1e-6))
    throw InputError(
        fmt::format("the distance field reaches {} mm inside and the shell is {} mm thick; try "
                    "sg-distance --inside {}",
                    distance.inside_band, thickness, thickness + 2 * sample.voxel));
  if (static_cast<int>(mesh.coordinate.size()) != mesh.mesh.vertex_count())
    throw InternalError("one texture coordinate a vertex expected");
  require_field_of_mesh(mesh.mesh, distance);
}

float wrap(float t, int n) {
  const auto size = static_cast<float>(n);
  t -= size * std::floor(t / size);
  return t < size ? t : 0;
}

// What interpolated coordinates change against nearest ones.
struct Difference {
  double voxels = 0, changed = 0, incoherent = 0;
  double extinction = 0, albedo = 0;                                       // squared differences
  Eigen::Array<double, 6, 1> sum = Eigen::Array<double, 6, 1>::Zero();     // of σ_t' and α'
  Eigen::Array<double, 6, 1> square = Eigen::Array<double, 6, 1>::Zero();  // and of their squares

  static Rgb reduced_albedo(const Material& m) {
    const Rgb extinction = m.reduced_extinction();
    return (extinction > 0).select(m.reduced_scattering() / extinction, Rgb::Zero());
  }
  void add(const Material& own, const Material& paper, bool is_changed, bool is_coherent) {
    ++voxels;
    incoherent += !is_coherent;
    Eigen::Array<double, 6, 1> f;
    f << own.reduced_extinction().cast<double>(), reduced_albedo(own).cast<double>();
    sum += f;
    square += f.square();
    if (!is_changed) return;
    ++changed;
    extinction += (own.reduced_extinction() - paper.reduced_extinction()).cast<double>().square().sum();
    albedo += (reduced_albedo(own) - reduced_albedo(paper)).cast<double>().square().sum();
  }
  Difference operator+(const Difference& o) const {
    Difference d = *this;
    d.voxels += o.voxels, d.changed += o.changed, d.incoherent += o.incoherent;
    d.extinction += o.extinction, d.albedo += o.albedo;
    d.sum += o.sum, d.square += o.square;
    return d;
  }
  void tell(ShellStatistics& s) const {
    if (!(voxels > 0)) return;
    const Eigen::Array<double, 6, 1> variance = (square / voxels - (sum / voxels).square()).max(0.0);
    s.incoherent_share = incoherent / voxels;
    s.changed_share = changed / voxels;
    s.extinction_rms = std::sqrt(extinction / (3 * voxels));
    s.albedo_rms = std::sqrt(albedo / (3 * voxels));
    s.extinction_deviation = std::sqrt(variance.head<3>().mean());
    s.albedo_deviation = std::sqrt(variance.tail<3>().mean());
  }
};

}  // namespace

std::size_t sample_voxel(const MaterialSample& sample, const Vec3f& texture_coordinate) {
  const auto wrapped = [](float t, int n) {
    const int i = static_cast<int>(std::floor(t)) % n;
    return i < 0 ? i + n : i;
  };
  const int z = std::clamp(static_cast<int>(texture_coordinate.z()), 0, sample.size.z() - 1);
  return sample.index(wrapped(texture_coordinate.x(), sample.size.x()),
                      wrapped(texture_coordinate.y(), sample.size.y()), z);
}

ShellVolume resample_shell(const TexturedMesh& mesh, const DistanceField& distance,
                           const std::vector<const MaterialSample*>& samples, const Material& core, double thickness,
                           ShellCoordinates coordinates, ShellStatistics* statistics, Progress& progress) {
  check_inputs(mesh, distance, samples, thickness);
  const double sample_edge = samples.front()->voxel;
  bool own_indices = false;
  std::vector<Eigen::Vector2i> sizes;
  for (const MaterialSample* sample : samples) {
    sizes.push_back(sample->size.head<2>());
    own_indices = own_indices || !sample->surface_ior.empty();
  }
  const TwoLevelGrid<float>& field = distance.distance;
  const float deepest = static_cast<float>(-thickness * (1 + 1e-6));
  const auto is_shell = [&](float d) { return d <= 0 && d >= deepest; };

  // First which samples are shell, leaf by leaf; then only leaves that hold some are allocated.
  std::vector<Mask> masks(field.leaf_count(), Mask{});
  std::vector<char> used(field.leaf_count(), 0);
  parallel_for(
      field.leaf_count(),
      [&](std::size_t leaf) {
        const float* values = field.leaf_values(static_cast<int>(leaf));
        for (int n = 0; n < 512; ++n)
          if (TwoLevelGrid<float>::mask_test(field.leaf_mask(static_cast<int>(leaf)), n) && is_shell(values[n]))
            TwoLevelGrid<float>::mask_set(masks[leaf], n), used[leaf] = 1;
      },
      8);
  if (std::find(used.begin(), used.end(), 1) == used.end())
    throw InputError(
        fmt::format("no grid point lies in a shell {} mm thick on a grid of {} mm; make it thicker or the voxel "
                    "smaller",
                    thickness, distance.frame.voxel));
  ShellVolume shell;
  shell.frame = distance.frame;
  shell.core = core;
  shell.thickness = thickness;
  shell.ior = samples.front()->ior;
  const TwoLevelGrid<Vec3f> empty(field.lower_leaf(), field.leaf_counts(), Vec3f::Zero());
  shell.texture_coordinate = shell.extinction = shell.albedo = shell.anisotropy = shell.normal = empty;
  shell.kind = TwoLevelGrid<std::int32_t>(field.lower_leaf(), field.leaf_counts(), 1);
  shell.surface_ior = TwoLevelGrid<float>(field.lower_leaf(), field.leaf_counts(), 0.0f);
  TwoLevelGrid<Vec3f>* const colors[] = {&shell.texture_coordinate, &shell.extinction, &shell.albedo, &shell.anisotropy,
                                         &shell.normal};
  std::vector<int> source;  // the distance field's leaf of each shell leaf
  for (int leaf = 0; leaf < field.leaf_count(); ++leaf) {
    if (!used[leaf]) continue;
    source.push_back(leaf);
    for (TwoLevelGrid<Vec3f>* grid : colors)
      grid->leaf_mask(grid->allocate_leaf(field.leaf_coordinate(leaf))) = masks[leaf];
    shell.kind.leaf_mask(shell.kind.allocate_leaf(field.leaf_coordinate(leaf))) = masks[leaf];
    if (own_indices)
      shell.surface_ior.leaf_mask(shell.surface_ior.allocate_leaf(field.leaf_coordinate(leaf))) = masks[leaf];
  }

  const bool interpolate = coordinates == ShellCoordinates::interpolated;
  const SurfacePlaces places(mesh, sizes, sample_edge);
  progress.begin("shell", static_cast<long>(source.size()));
  std::vector<char> foreign(source.size(), 0);
  std::vector<Difference> differences(source.size());
  parallel_for(
      source.size(),
      [&](std::size_t at) {
        const int leaf = static_cast<int>(at);
        const Vec3i coordinate = field.leaf_coordinate(source[at]);
        const int vertex_leaf = distance.nearest_vertex.find_leaf(coordinate);
        const int point_leaf = distance.nearest_point.find_leaf(coordinate);
        for (int n = 0; n < 512; ++n) {
          if (!TwoLevelGrid<float>::mask_test(masks[source[at]], n)) continue;
          const std::int32_t vertex =
              vertex_leaf < 0 || point_leaf < 0 ? -1 : distance.nearest_vertex.leaf_values(vertex_leaf)[n];
          if (vertex < 0 || vertex >= mesh.mesh.vertex_count()) {
            foreign[at] = 1;
            continue;
          }
          const float depth = static_cast<float>(-field.leaf_values(source[at])[n] / sample_edge);
          SurfacePlace place = places.nearest(vertex);
          Vec3f t(place.coordinate.x(), place.coordinate.y(), std::max(0.0f, depth));
          const MaterialSample* paper_sample = samples[place.sample];
          std::size_t voxel = sample_voxel(*paper_sample, t);
          Difference& difference = differences[at];
          if (interpolate) {
            const std::size_t paper = voxel;
            place =
                places.interpolated(vertex, distance.nearest_point.leaf_values(point_leaf)[n].template cast<double>());
            const MaterialSample* own = samples[place.sample];
            t.x() = wrap(place.coordinate.x(), own->size.x());
            t.y() = wrap(place.coordinate.y(), own->size.y());
            voxel = sample_voxel(*own, t);
            difference.add(own->material(voxel), paper_sample->material(paper), own != paper_sample || voxel != paper,
                           place.coherent);
          }
          const MaterialSample& sample = *samples[place.sample];
          shell.texture_coordinate.leaf_values(leaf)[n] = t;
          shell.extinction.leaf_values(leaf)[n] = sample.extinction[voxel];
          shell.albedo.leaf_values(leaf)[n] = sample.albedo[voxel];
          shell.anisotropy.leaf_values(leaf)[n] = sample.anisotropy[voxel];
          shell.kind.leaf_values(leaf)[n] = static_cast<std::int32_t>(sample.kind[voxel]);
          if (sample.kind[voxel] == VoxelKind::surface) {
            const Vec3 local = sample.normal[voxel].cast<double>();
            // The sample's z runs inwards.
            const Vec3 normal = local.x() * place.u + local.y() * place.v - local.z() * place.normal;
            shell.normal.leaf_values(leaf)[n] = normal.normalized().cast<float>();
          }
          if (own_indices && sample.kind[voxel] == VoxelKind::surface)
            shell.surface_ior.leaf_values(leaf)[n] =
                sample.surface_ior.empty() ? static_cast<float>(sample.ior) : sample.surface_ior[voxel];
        }
        progress.advance();
      },
      4);
  progress.end();
  if (std::find(foreign.begin(), foreign.end(), 1) != foreign.end())
    throw InputError("the distance field names vertices that the mesh does not have; make both from the same surface");

  if (statistics) {
    ShellStatistics s;
    s.leaves = shell.extinction.leaf_count();
    s.possible_leaves = static_cast<long>(field.leaf_counts().cast<long>().prod());
    s.voxels = static_cast<long>(shell.extinction.active_count());
    shell.kind.for_each_active([&](int, int, int, std::int32_t kind) { s.free_voxels += kind == 0; });
    for (const TwoLevelGrid<Vec3f>* grid : colors) s.bytes += grid->bytes();
    s.bytes += shell.kind.bytes() + shell.surface_ior.bytes();
    Difference sum;
    for (const Difference& difference : differences) sum = sum + difference;
    sum.tell(s);
    const double band = static_cast<double>(field.active_count());
    s.skipped_share = band > 0 ? 1 - static_cast<double>(s.voxels) / band : 0;
    *statistics = s;
  }
  return shell;
}

}  // namespace shellgrid
