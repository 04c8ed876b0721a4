// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/distance/distance_field.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <array>
#include <cmath>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/distance/winding_columns.h"
#include "meshing/surface/closest_point.h"
#include "meshing/surface/repair.h"

namespace shellgrid {
namespace {

constexpr int leaf_edge = TwoLevelGrid<float>::leaf_edge;
constexpr int leaf_size = TwoLevelGrid<float>::leaf_size;

// The samples of one leaf.
struct LeafSamples {
  TwoLevelGrid<float>::Mask active;
  std::array<float, leaf_size> distance;
  std::array<std::int32_t, leaf_size> nearest_vertex;
  std::array<Vec3f, leaf_size> nearest_point;
  int visited;
  bool any;
};

class DistanceSampling {
 public:
  DistanceSampling(const TriangleMesh& mesh, const GridFrame& frame, const DistanceOptions& options, const Vec3i& lower,
                   const Vec3i& upper)
      : mesh_(mesh),
        frame_(frame),
        options_(options),
        surface_(mesh),
        vertices_(mesh.vertices),
        columns_(mesh, frame, lower, upper) {
    find_plain_faces();
  }

  // Adds, in a fixed order, the leaves of a block of 2^level leaves an edge that may hold a sample of the band.
  void collect_leaves(const Vec3i& block, int level, const Vec3i& leaf_lower, const Vec3i& leaf_upper,
                      std::vector<Vec3i>& leaves) const {
    const Vec3i first = block * (1 << level);
    if ((first.array() >= leaf_upper.array()).any() || ((first.array() + (1 << level)) <= leaf_lower.array()).any())
      return;
    // Every sample lies within `radius` of the middle one.
    const int half = leaf_edge / 2 << level;
    const Vec3i middle = first * leaf_edge + Vec3i::Constant(half);
    const double radius = std::sqrt(3.0) * half * frame_.voxel * (1 + 1e-9);
    const double reach = std::max(options_.inside_band, options_.outside_band) + radius;
    const SurfacePoint found = surface_.nearest(frame_.to_world(middle), reach);
    if (found.face_index < 0) return;
    const double distance = std::sqrt(found.squared_distance);
    if (distance > radius) {  // all samples lie on one side
      const bool inside = columns_.inside(middle.x(), middle.y(), middle.z());
      if (distance - radius > (inside ? options_.inside_band : options_.outside_band)) return;
    }
    if (level == 0) {
      leaves.push_back(block);
      return;
    }
    for (int child = 0; child < 8; ++child)
      collect_leaves(2 * block + Vec3i(child >> 2, child >> 1 & 1, child & 1), level - 1, leaf_lower, leaf_upper,
                     leaves);
  }

  void sample_leaf(const Vec3i& leaf, LeafSamples& samples) const {
    samples.active = {};
    samples.visited = 0;
    samples.any = false;
    const Vec3i base = leaf * leaf_edge;
    for (int x = 0; x < leaf_edge; ++x)
      for (int y = 0; y < leaf_edge; ++y) {
        bool inside[leaf_edge];
        columns_.inside(base.x() + x, base.y() + y, base.z(), leaf_edge, inside);
        for (int z = 0; z < leaf_edge; ++z) {
          const int offset = TwoLevelGrid<float>::offset_of(x, y, z);
          samples.distance[offset] = static_cast<float>(inside[z] ? -options_.inside_band : options_.outside_band);
          samples.nearest_vertex[offset] = -1;
          samples.nearest_point[offset] = Vec3f::Zero();
        }
      }
    for (int part = 0; part < 8; ++part)
      sample_part(base, Vec3i(part >> 2, part >> 1 & 1, part & 1) * part_edge, samples);
  }

 private:
  static constexpr int part_edge = 4;  // half a leaf

  // Samples the 4³ points from `base + corner` on.
  void sample_part(const Vec3i& base, const Vec3i& corner, LeafSamples& samples) const {
    const Vec3i middle = base + corner + Vec3i::Constant(part_edge / 2);
    const double radius = std::sqrt(3.0) * (part_edge / 2) * frame_.voxel * (1 + 1e-9);
    const double reach = std::max(options_.inside_band, options_.outside_band) + radius;
    const SurfacePoint nearest_to_middle = surface_.nearest(frame_.to_world(middle), reach);
    ++samples.visited;
    if (nearest_to_middle.face_index < 0) return;
    const double middle_distance = std::sqrt(nearest_to_middle.squared_distance);
    double previous = std::numeric_limits<double>::infinity();  // distance of the sample before, one interval away
    for (int x = 0; x < part_edge; ++x)
      for (int row = 0; row < part_edge; ++row)
        for (int step = 0; step < part_edge; ++step) {
          const int y = x % 2 == 0 ? row : part_edge - 1 - row;
          const int z = (x * part_edge + row) % 2 == 0 ? step : part_edge - 1 - step;
          const Vec3i at = corner + Vec3i(x, y, z);
          const int offset = TwoLevelGrid<float>::offset_of(at.x(), at.y(), at.z());
          const bool inside = samples.distance[offset] < 0;
          const double band = inside ? options_.inside_band : options_.outside_band;
          // From point to point the distance changes by no more than the step.
          const double from_middle = (base + at - middle).cast<double>().norm() * frame_.voxel;
          if (middle_distance - from_middle > band * (1 + 1e-9)) {
            previous = std::numeric_limits<double>::infinity();
            continue;
          }
          const double bound = std::min(middle_distance + from_middle, previous + frame_.voxel) * (1 + 1e-9);
          const SurfacePoint found = surface_.nearest(frame_.to_world(base + at), std::min(band, bound));
          ++samples.visited;
          if (found.face_index < 0) {
            previous = std::numeric_limits<double>::infinity();
            continue;
          }
          previous = std::sqrt(found.squared_distance);
          samples.distance[offset] = static_cast<float>(inside ? -previous : previous);
          samples.nearest_point[offset] = found.point.cast<float>();
          samples.nearest_vertex[offset] = nearest_vertex(found);
          TwoLevelGrid<float>::mask_set(samples.active, offset);
          samples.any = true;
        }
  }

  // Marks the faces for whose every point the nearest vertex is one of the three corners: no other vertex lies within
  // √2 circumradii of the circumcentre. (A point q of the face is nearer than √(R² − |q − m|²) to a corner.)
  void find_plain_faces() {
    plain_.resize(mesh_.face_count());
    parallel_for(plain_.size(), [&](std::size_t f) {
      const int face = static_cast<int>(f);
      const Vec3 a = mesh_.corner(face, 0), ab = mesh_.corner(face, 1) - a, ac = mesh_.corner(face, 2) - a;
      const Vec3 normal = ab.cross(ac);
      const Vec3 to_centre =
          (ac.squaredNorm() * normal.cross(ab) + ab.squaredNorm() * ac.cross(normal)) / (2 * normal.squaredNorm());
      const double reach = 1.4143 * to_centre.norm();
      plain_[f] = to_centre.allFinite() && vertices_.count_within(a + to_centre, reach, 4) <= 3;
    });
  }

  int nearest_vertex(const SurfacePoint& found) const {
    int best = -1;
    double least = std::numeric_limits<double>::infinity();
    for (int k = 0; k < 3; ++k) {
      const int v = mesh_.faces(found.face_index, k);
      const double distance = (mesh_.vertex(v) - found.point).squaredNorm();
      if (distance < least || (distance == least && v < best)) best = v, least = distance;
    }
    return plain_[found.face_index] ? best : vertices_.nearest(found.point, best);
  }

  const TriangleMesh& mesh_;
  GridFrame frame_;
  DistanceOptions options_;
  ClosestPointQuery surface_;
  NearestVertexQuery vertices_;
  WindingColumns columns_;
  std::vector<char> plain_;
};

}  // namespace

DistanceField compute_distance_field(const TriangleMesh& mesh, const DistanceOptions& options,
                                     DistanceStatistics& statistics, Progress& progress) {
  require_closed_surface(mesh, true);
  if (!(options.voxel > 0 && options.inside_band > 0 && options.outside_band > 0))
    throw InputError("voxel and both bands must be positive");
  DistanceField field;
  field.frame.voxel = options.voxel;
  field.inside_band = options.inside_band;
  field.outside_band = options.outside_band;

  const Vec3 mesh_lower = mesh.vertices.colwise().minCoeff().transpose();
  const Vec3 mesh_upper = mesh.vertices.colwise().maxCoeff().transpose();
  const Vec3 reach = Vec3::Constant(options.outside_band);
  const Vec3 extent = (mesh_upper - mesh_lower + 2 * reach) / options.voxel;
  if (!(extent.prod() < 8e9) || extent.maxCoeff() > 1e6)
    throw InputError(fmt::format("a voxel of {:.6g} mm gives a grid of {:.3g} samples; expected fewer than 8e9",
                                 options.voxel, extent.prod()));
  const Vec3i lower = field.frame.to_index(mesh_lower - reach).array().floor().cast<int>();
  const Vec3i upper = field.frame.to_index(mesh_upper + reach).array().ceil().cast<int>();
  const Vec3i leaf_lower = lower.unaryExpr([](int i) { return i >> 3; });
  const Vec3i leaf_upper = upper.unaryExpr([](int i) { return (i >> 3) + 1; });
  const Vec3i leaf_counts = leaf_upper - leaf_lower;
  field.distance = TwoLevelGrid<float>(leaf_lower, leaf_counts, static_cast<float>(options.outside_band));
  field.nearest_vertex = TwoLevelGrid<std::int32_t>(leaf_lower, leaf_counts, -1);
  field.nearest_point = TwoLevelGrid<Vec3f>(leaf_lower, leaf_counts, Vec3f::Zero());

  const DistanceSampling sampling(mesh, field.frame, options, leaf_lower * leaf_edge,
                                  leaf_upper * leaf_edge - Vec3i::Ones());

  // Blocks of 8³ leaves, then leaves, keep their order whatever thread looks at them.
  const Vec3i block_lower = leaf_lower.unaryExpr([](int i) { return i >> 3; });
  const Vec3i blocks = (leaf_upper - Vec3i::Ones()).unaryExpr([](int i) { return (i >> 3) + 1; }) - block_lower;
  std::vector<std::vector<Vec3i>> parts(static_cast<std::size_t>(blocks.prod()));
  parallel_for(
      parts.size(),
      [&](std::size_t b) {
        const int block = static_cast<int>(b);
        const Vec3i at(block / (blocks.y() * blocks.z()), block / blocks.z() % blocks.y(), block % blocks.z());
        sampling.collect_leaves(block_lower + at, 3, leaf_lower, leaf_upper, parts[b]);
      },
      1);
  std::vector<Vec3i> leaves;
  for (const auto& part : parts) leaves.insert(leaves.end(), part.begin(), part.end());

  statistics.possible_leaves = static_cast<std::int64_t>(leaf_counts.x()) * leaf_counts.y() * leaf_counts.z();
  statistics.possible_samples = statistics.possible_leaves * leaf_size;
  progress.begin("distances", static_cast<long>(leaves.size()));
  constexpr std::size_t batch = 1024;
  std::vector<LeafSamples> samples(std::min(batch, leaves.size()));
  for (std::size_t begin = 0; begin < leaves.size(); begin += batch) {
    const std::size_t count = std::min(batch, leaves.size() - begin);
    parallel_for(
        count,
        [&](std::size_t i) {
          sampling.sample_leaf(leaves[begin + i], samples[i]);
          progress.advance();
        },
        4);
    for (std::size_t i = 0; i < count; ++i) {
      statistics.visited_samples += samples[i].visited;
      if (!samples[i].any) continue;
      const int leaf = field.distance.allocate_leaf(leaves[begin + i]);
      field.nearest_vertex.allocate_leaf(leaves[begin + i]);
      field.nearest_point.allocate_leaf(leaves[begin + i]);
      std::copy(samples[i].distance.begin(), samples[i].distance.end(), field.distance.leaf_values(leaf));
      std::copy(samples[i].nearest_vertex.begin(), samples[i].nearest_vertex.end(),
                field.nearest_vertex.leaf_values(leaf));
      std::copy(samples[i].nearest_point.begin(), samples[i].nearest_point.end(),
                field.nearest_point.leaf_values(leaf));
      field.distance.leaf_mask(leaf) = field.nearest_vertex.leaf_mask(leaf) = field.nearest_point.leaf_mask(leaf) =
          samples[i].active;
    }
  }
  progress.end();
  statistics.allocated_leaves = field.distance.leaf_count();
  statistics.active_samples = static_cast<std::int64_t>(field.distance.active_count());
  return field;
}

}  // namespace shellgrid
