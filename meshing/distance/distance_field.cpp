// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/distance/distance_field.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <optional>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/distance/characteristic_scan.h"
#include "meshing/distance/winding_columns.h"
#include "meshing/distance/winding_number.h"
#include "meshing/surface/closest_point.h"
#include "meshing/surface/repair.h"

namespace shellgrid {
namespace {

constexpr int leaf_edge = TwoLevelGrid<float>::leaf_edge;
constexpr int leaf_size = TwoLevelGrid<float>::leaf_size;

using Mask = TwoLevelGrid<float>::Mask;

// What the scan says of one leaf's samples.
struct LeafFeatures {
  Vec3i leaf;
  Mask active{}, inside{};
  std::array<std::int32_t, leaf_size> feature;  // -1: beyond the band
};

// What tells inside from outside: one of the two.
struct Sides {
  std::optional<WindingColumns> columns;
  std::optional<WindingNumber> number;
};

// Finds the leaves of one block that hold samples of the band, within the grid's bounds.
std::vector<LeafFeatures> scan_block(const CharacteristicScan& scan, const Sides& sides, const GridFrame& frame,
                                     const TwoLevelGrid<float>& grid, const CharacteristicScan::Block& block,
                                     const double (&band2)[2], std::int64_t& compared) {
  constexpr int edge = CharacteristicScan::block_edge, leaves = edge / leaf_edge;
  const Vec3i corner = block.coordinate * edge;
  std::vector<double> squared_distance(CharacteristicScan::block_size);
  std::vector<std::int32_t> feature(CharacteristicScan::block_size, -1);
  std::vector<std::uint32_t> inside(edge * edge);  // a bit for each sample of a line along z
  if (!sides.columns) std::fill(squared_distance.begin(), squared_distance.end(), std::max(band2[0], band2[1]));
  for (int line = 0; sides.columns && line < edge * edge; ++line) {
    bool result[edge];
    sides.columns->inside(corner.x() + line / edge, corner.y() + line % edge, corner.z(), edge, result);
    for (int z = 0; z < edge; ++z) {
      squared_distance[line * edge + z] = band2[result[z]];
      inside[line] |= static_cast<std::uint32_t>(result[z]) << z;
    }
  }
  compared = scan.scan(block, squared_distance.data(), feature.data());

  std::vector<LeafFeatures> found;
  for (int n = 0; n < leaves * leaves * leaves; ++n) {
    const Vec3i local(n / (leaves * leaves), n / leaves % leaves, n % leaves);
    LeafFeatures leaf;
    leaf.leaf = block.coordinate * leaves + local;
    if (!grid.contains_leaf(leaf.leaf)) continue;
    const auto line_start = [&](int line) {
      return ((local.x() * leaf_edge + line / leaf_edge) * edge + local.y() * leaf_edge + line % leaf_edge) * edge +
             local.z() * leaf_edge;
    };
    if (sides.number) {
      bool reached = false;
      for (int line = 0; line < leaf_edge * leaf_edge; ++line)
        for (int z = 0; z < leaf_edge; ++z) reached |= feature[line_start(line) + z] >= 0;
      if (!reached) continue;
      for (int line = 0; line < leaf_edge * leaf_edge; ++line) {
        const int from = line_start(line);
        for (int z = 0; z < leaf_edge; ++z) {
          const Vec3i at = leaf.leaf * leaf_edge + Vec3i(line / leaf_edge, line % leaf_edge, z);
          const bool within = sides.number->inside(frame.to_world(at));
          inside[from / edge] |= static_cast<std::uint32_t>(within) << (local.z() * leaf_edge + z);
          if (!(squared_distance[from + z] < band2[within])) feature[from + z] = -1;
        }
      }
    }
    bool any = false;
    for (int line = 0; line < leaf_edge * leaf_edge; ++line) {
      const int from = line_start(line);
      std::uint64_t active = 0;
      for (int z = 0; z < leaf_edge; ++z) {
        leaf.feature[line * leaf_edge + z] = feature[from + z];
        active |= static_cast<std::uint64_t>(feature[from + z] >= 0) << z;
      }
      const std::uint64_t within = inside[from / edge] >> (local.z() * leaf_edge) & 255u;
      leaf.active[line / leaf_edge] |= active << line % leaf_edge * leaf_edge;
      leaf.inside[line / leaf_edge] |= within << line % leaf_edge * leaf_edge;
      any |= active != 0;
    }
    if (any) found.push_back(leaf);
  }
  return found;
}

// Finds the mesh vertex nearest to a point of the surface.
class VertexSearch {
 public:
  // Marks the faces for whose every point the nearest vertex is one of the three corners: no other vertex lies within
  // √2 circumradii of the circumcentre. (A point q of the face is nearer than √(R² − |q − m|²) to a corner.)
  explicit VertexSearch(const TriangleMesh& mesh) : mesh_(mesh), vertices_(mesh.vertices) {
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

  int nearest(const Vec3& point, int face) const {
    int best = -1;
    double least = std::numeric_limits<double>::infinity();
    for (int k = 0; k < 3; ++k) {
      const int v = mesh_.faces(face, k);
      const double distance = (mesh_.vertex(v) - point).squaredNorm();
      if (distance < least || (distance == least && v < best)) best = v, least = distance;
    }
    return plain_[face] ? best : vertices_.nearest(point, best);
  }

 private:
  const TriangleMesh& mesh_;
  NearestVertexQuery vertices_;
  std::vector<char> plain_;
};

}  // namespace

DistanceField compute_distance_field(const TriangleMesh& mesh, const DistanceOptions& options,
                                     DistanceStatistics& statistics, Progress& progress) {
  const bool closed = options.sign == SignRule::closed;
  if (closed)
    require_closed_surface(mesh, true);
  else
    require_outward_triangles(mesh);
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

  Sides sides_of;
  if (closed)
    sides_of.columns.emplace(mesh, field.frame, leaf_lower * leaf_edge, leaf_upper * leaf_edge - Vec3i::Ones());
  else
    sides_of.number.emplace(mesh);
  constexpr int block_bits = CharacteristicScan::block_bits - 3;
  const CharacteristicScan scan(mesh, field.frame, std::max(options.inside_band, options.outside_band),
                                leaf_lower.unaryExpr([](int i) { return i >> block_bits; }),
                                (leaf_upper - Vec3i::Ones()).unaryExpr([](int i) { return (i >> block_bits) + 1; }));
  const auto squared_band = [&](double band) {
    return std::nextafter(std::pow(band / options.voxel, 2), std::numeric_limits<double>::infinity());
  };
  const double band2[2] = {squared_band(options.outside_band), squared_band(options.inside_band)};

  // Blocks keep their order whatever thread scans them.
  const std::vector<CharacteristicScan::Block>& blocks = scan.blocks();
  progress.begin("distances", 2 * static_cast<long>(blocks.size()));
  std::vector<std::vector<LeafFeatures>> parts(blocks.size());
  std::vector<std::int64_t> compared(blocks.size(), 0);
  parallel_for(
      blocks.size(),
      [&](std::size_t b) {
        parts[b] = scan_block(scan, sides_of, field.frame, field.distance, blocks[b], band2, compared[b]);
        progress.advance();
      },
      1);
  std::vector<int> first_leaf;
  std::vector<Vec3i> leaves;
  for (const auto& part : parts) {
    first_leaf.push_back(static_cast<int>(leaves.size()));
    for (const LeafFeatures& found : part) leaves.push_back(found.leaf);
  }
  field.distance.allocate_leaves(leaves);
  field.nearest_vertex.allocate_leaves(leaves);
  field.nearest_point.allocate_leaves(leaves);

  const VertexSearch vertices(mesh);
  const float sides[2] = {static_cast<float>(options.outside_band), static_cast<float>(-options.inside_band)};
  parallel_for(
      blocks.size(),
      [&](std::size_t b) {
        for (std::size_t i = 0; i < parts[b].size(); ++i) {
          const LeafFeatures& found = parts[b][i];
          const int leaf = first_leaf[b] + static_cast<int>(i);
          float* const distance = field.distance.leaf_values(leaf);
          const Vec3i base = found.leaf * leaf_edge;
          for (int n = 0; n < leaf_size; ++n) {
            const bool inside = TwoLevelGrid<float>::mask_test(found.inside, n);
            distance[n] = sides[inside];
            if (found.feature[n] < 0) continue;
            const Vec3 p = field.frame.to_world(base + Vec3i(n >> 6, n >> 3 & 7, n & 7));
            const Vec3 nearest = scan.nearest_point(found.feature[n], p);
            const double length = (nearest - p).norm();
            distance[n] = static_cast<float>(inside ? -length : length);
            field.nearest_point.leaf_values(leaf)[n] = nearest.cast<float>();
            field.nearest_vertex.leaf_values(leaf)[n] = vertices.nearest(nearest, scan.face_of(found.feature[n]));
          }
          field.distance.leaf_mask(leaf) = field.nearest_vertex.leaf_mask(leaf) = field.nearest_point.leaf_mask(leaf) =
              found.active;
        }
        progress.advance();
      },
      1);
  statistics.possible_leaves = static_cast<std::int64_t>(leaf_counts.x()) * leaf_counts.y() * leaf_counts.z();
  statistics.possible_samples = statistics.possible_leaves * leaf_size;
  for (const std::int64_t count : compared) statistics.compared_pairs += count;
  progress.end();
  statistics.allocated_leaves = field.distance.leaf_count();
  statistics.active_samples = static_cast<std::int64_t>(field.distance.active_count());
  statistics.visited_samples = statistics.active_samples;
  return field;
}

}  // namespace shellgrid
