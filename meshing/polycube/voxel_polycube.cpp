// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/voxel_polycube.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/core/random.h"
#include "meshing/polycube/block_cover.h"
#include "meshing/polycube/block_parts.h"
#include "meshing/polycube/genus_repair.h"
#include "meshing/polycube/sample_raster.h"
#include "meshing/polycube/stair_annealing.h"
#include "meshing/polycube/surface_handles.h"
#include "meshing/polycube/target_surface.h"
#include "meshing/surface/repair.h"

namespace shellgrid {
namespace {

constexpr int samples_per_block = BlockParts::samples_per_block;
constexpr double most_blocks_tried_again = 5e5;  // where smaller blocks than asked for are tried
constexpr double lost_distance = 2.5;            // blocks: parts that far from the polycube are lost
constexpr int most_handles = 50;                 // looked for on the surface where the polycube lacks some
constexpr double most_blocks = 1.5e7;            // in the window of the grid, some 200 bytes each

// Empties blocks until none joins parts of the object that are apart, the emptier one of two.
void part_blocks(BlockGrid& grid, const BlockParts& parts) {
  for (std::size_t b = 0; b < grid.filled.size(); ++b) {
    const Vec3i block = grid.place(b);
    for (int axis = 0; axis < 3; ++axis) {
      const Vec3i next = block + Vec3i::Unit(axis);
      if (!grid.filled[b] || !grid.at(next) || !parts.are_parted(block, axis)) continue;
      const std::size_t n = grid.index(next);
      grid.filled[parts.fractions()[b] < parts.fractions()[n] ? b : n] = 0;
    }
  }
}

std::size_t count_joints(const BlockGrid& grid, const BlockParts& parts) {
  std::size_t count = 0;
  for (std::size_t b = 0; b < grid.filled.size(); ++b)
    count += grid.filled[b] && parts.joins_parts(grid, grid.place(b));
  return count;
}

// Fills blocks until the boundary is a manifold: monotone, so it ends.
void fill_to_manifold(BlockGrid& grid, const BlockParts& parts) {
  for (;;) {
    fill_cavities(grid);
    bool changed = false;
    for (int k = 1; k < grid.size.z(); ++k)
      for (int j = 1; j < grid.size.y(); ++j)
        for (int i = 1; i < grid.size.x(); ++i) {
          const Vec3i corner(i, j, k);
          while (!is_well_composed(window_at(grid, corner))) {
            double best_score = -1;
            Vec3i best = Vec3i::Zero();
            for (int n = 0; n < 8; ++n) {
              const Vec3i block = corner - Vec3i::Ones() + Vec3i(n & 1, n >> 1 & 1, n >> 2);
              if (grid.at(block) || !grid.may_fill(block)) continue;
              int faces = 0;
              for (int axis = 0; axis < 3; ++axis)
                for (int side : {-1, 1}) faces += grid.at(block + side * Vec3i::Unit(axis));
              const double score = (faces > 0 ? 4 : 0) + (is_simple_flip(grid, block) ? 2 : 0) +
                                   parts.fractions()[grid.index(block)] + (parts.joins_parts(grid, block) ? 0 : 8);
              if (score > best_score) best_score = score, best = block;
            }
            if (best_score < 0) throw InternalError("voxel polycube: a window cannot be mended");
            grid.filled[grid.index(best)] = 1;
            changed = true;
          }
        }
    if (!changed) return;
  }
}

// Distance of a place (in blocks, block (i, j, k) being the unit cube at (i, j, k)) to the nearest filled
// block, looking no farther than `limit`.
double distance_to_filled(const BlockGrid& grid, const Vec3& place, double limit) {
  const Vec3i home = place.array().floor().cast<int>().matrix();
  double best2 = limit * limit;
  for (int ring = 0; (ring == 0 || (ring - 1) * (ring - 1) < best2) && ring <= limit + 1; ++ring)
    for (int dk = -ring; dk <= ring; ++dk)
      for (int dj = -ring; dj <= ring; ++dj)
        for (int di = -ring; di <= ring;
             di += (std::abs(dk) == ring || std::abs(dj) == ring || ring == 0) ? 1 : 2 * ring) {
          const Vec3i block = home + Vec3i(di, dj, dk);
          if (!grid.at(block)) continue;
          const Vec3 low = block.cast<double>();
          const double d2 = (low - place).cwiseMax(place - low - Vec3::Ones()).cwiseMax(Vec3::Zero()).squaredNorm();
          best2 = std::min(best2, d2);
        }
  return std::sqrt(best2);
}

struct Coverage {
  double p99 = 0, most = 0;  // in blocks
};

// Distances beyond `near` blocks are sought among all blocks of the boundary, or, where not `exact`, taken as `near`.
Coverage coverage(const BlockGrid& grid, const std::vector<Vec3>& places, bool exact) {
  constexpr double near = 6;
  std::vector<double> distance(places.size());
  parallel_for(places.size(), [&](std::size_t i) { distance[i] = distance_to_filled(grid, places[i], near); });
  std::vector<std::size_t> far;
  for (std::size_t i = 0; i < distance.size() && exact; ++i)
    if (distance[i] >= near) far.push_back(i);
  if (!far.empty()) {
    std::vector<Vec3> boundary;
    for (std::size_t b = 0; b < grid.filled.size(); ++b) {
      if (!grid.filled[b]) continue;
      const Vec3i block = grid.place(b);
      bool exposed = false;
      for (int axis = 0; axis < 3; ++axis)
        for (int side : {-1, 1}) exposed = exposed || !grid.at(block + side * Vec3i::Unit(axis));
      if (exposed) boundary.push_back(block.cast<double>());
    }
    parallel_for(far.size(), [&](std::size_t n) {
      const Vec3& place = places[far[n]];
      double least = std::numeric_limits<double>::infinity();
      for (const Vec3& low : boundary)
        least =
            std::min(least, (low - place).cwiseMax(place - low - Vec3::Ones()).cwiseMax(Vec3::Zero()).squaredNorm());
      distance[far[n]] = std::sqrt(least);
    });
  }
  std::sort(distance.begin(), distance.end());
  if (distance.empty()) return {};
  return {distance[static_cast<std::size_t>(0.99 * static_cast<double>(distance.size() - 1))], distance.back()};
}

// Fills simple blocks where the object sticks out.
void grow_into_extremities(BlockGrid& grid, const BlockParts& parts, BlockCover& cover, float least_fraction) {
  const std::vector<float>& fraction = parts.fractions();
  for (bool grew = true; grew;) {
    grew = false;
    std::vector<std::size_t> candidates = cover.helpful_blocks();
    std::stable_sort(candidates.begin(), candidates.end(),
                     [&](std::size_t a, std::size_t b) { return fraction[a] > fraction[b]; });
    for (std::size_t b : candidates) {
      const Vec3i block = grid.place(b);
      if (grid.filled[b] || fraction[b] < least_fraction || !grid.may_fill(block) || !cover.would_help(b)) continue;
      if (!is_simple_flip(grid, block) || parts.joins_parts(grid, block)) continue;
      grid.filled[b] = 1;
      cover.add(b);
      grew = true;
    }
  }
}

// Blocks near the boundary, ascending.
std::vector<std::size_t> blocks_to_anneal(const BlockGrid& grid, const std::vector<float>& fraction) {
  std::vector<std::size_t> blocks;
  const auto is_mixed = [&](std::size_t b) { return fraction[b] > 0 && fraction[b] < 1; };
  for (std::size_t b = 0; b < grid.filled.size(); ++b) {
    const Vec3i block = grid.place(b);
    if (!grid.may_fill(block)) continue;
    bool wanted = is_mixed(b);
    for (int axis = 0; axis < 3 && !wanted; ++axis)
      for (int side : {-1, 1}) {
        const std::size_t next = grid.index(block + side * Vec3i::Unit(axis));
        wanted = wanted || is_mixed(next) || grid.filled[next] != grid.filled[b];
      }
    if (wanted) blocks.push_back(b);
  }
  return blocks;
}

// What filling a block costs: its volume outside the object less that inside, and the square of its centre's distance
// to the surface, in blocks.
std::vector<double> fill_costs(const BlockGrid& grid, const std::vector<std::size_t>& blocks,
                               const std::vector<float>& fraction, const TargetSurface& surface, const Vec3& origin,
                               double block_edge) {
  std::vector<double> costs(grid.filled.size(), 0);
  parallel_for(
      blocks.size(),
      [&](std::size_t n) {
        const std::size_t b = blocks[n];
        const Vec3 centre = origin + block_edge * (grid.place(b).cast<double>() + Vec3::Constant(0.5));
        const double distance = surface.nearest(centre).distance / block_edge;
        costs[b] = 2.5 * (1 - 2 * fraction[b]) + (fraction[b] >= 0.5f ? -1 : 1) * distance * distance;
      },
      64);
  return costs;
}

std::vector<Vec3> to_block_places(const std::vector<TargetSurface::Sample>& samples, const Vec3& origin,
                                  double block_edge) {
  std::vector<Vec3> places(samples.size());
  for (std::size_t i = 0; i < samples.size(); ++i) places[i] = (samples[i].point - origin) / block_edge;
  return places;
}

struct Candidate {
  BlockGrid grid;
  const BlockParts* parts = nullptr;
  Vec3 origin = Vec3::Zero();
  double score = std::numeric_limits<double>::infinity();
};

int genus_of(const BlockGrid& grid) { return static_cast<int>((2 - boundary_euler_characteristic(grid)) / 2); }

double score_of(const Candidate& candidate, int object_genus, int cells_per_block,
                const std::vector<TargetSurface::Sample>& samples, double block_edge) {
  const int wrong = std::abs(genus_of(candidate.grid) - object_genus);
  const Coverage cover = coverage(candidate.grid, to_block_places(samples, candidate.origin, block_edge), false);
  const SingularityCounts singular = count_singularities(candidate.grid);
  const double blocks = static_cast<double>(candidate.grid.count());
  const double joints = static_cast<double>(count_joints(candidate.grid, *candidate.parts));
  return (wrong > 0 ? 1e4 * (1 + wrong) : 0) + 50 * joints + 20 * std::max(0.0, cover.p99 * cells_per_block - 0.3) +
         4 * std::max(0.0, cover.most * cells_per_block - 0.8) +
         (20.0 * static_cast<double>(singular.corners) + 3.0 * static_cast<double>(singular.edges)) /
             std::pow(blocks, 2.0 / 3);
}

}  // namespace

namespace {

// The spacing whose grid has about so many nodes: cell centres, of which a voxel polycube holds a few more than the
// volume, and boundary nodes on stairs a third larger than the surface.
double spacing_for(double nodes, double volume, const TriangleMesh& surface) {
  double area = 0;
  for (int f = 0; f < surface.face_count(); ++f)
    area +=
        0.5 * (surface.corner(f, 1) - surface.corner(f, 0)).cross(surface.corner(f, 2) - surface.corner(f, 0)).norm();
  double low = 0, high = std::cbrt(volume) + std::sqrt(area);
  for (int step = 0; step < 100; ++step) {
    const double h = 0.5 * (low + high);
    (volume / (h * h * h) + 1.35 * area / (h * h) > nodes ? low : high) = h;
  }
  return high;
}

// Of the surface's box, in blocks.
Vec3 window_extent(const TriangleMesh& surface, double block_edge) {
  return (surface.vertices.colwise().maxCoeff() - surface.vertices.colwise().minCoeff()).transpose() / block_edge;
}

bool spacing_is_too_small(const TriangleMesh& surface, double block_edge, double most) {
  return !((window_extent(surface, block_edge).array() + 5).prod() < most);
}

VoxelPolycube build_with_spacing(const TriangleMesh& surface, const PolycubeOptions& options, double spacing,
                                 int cells_per_block, Progress& progress) {
  VoxelPolycube result;
  result.spacing = spacing;
  result.cells_per_block = cells_per_block;
  result.object_genus = genus(surface);
  const double block_edge = result.spacing * result.cells_per_block;

  const Vec3 low = surface.vertices.colwise().minCoeff().transpose();
  const Vec3 extent = window_extent(surface, block_edge);
  if (spacing_is_too_small(surface, block_edge, most_blocks))
    throw InputError(
        fmt::format("the object is too thin for its extent: its grid would be {:.0f}×{:.0f}×{:.0f} blocks; "
                    "expected fewer than {:.0e}; try fewer nodes or larger --grid",
                    extent.x(), extent.y(), extent.z(), most_blocks));
  const Vec3i counts = extent.array().ceil().cast<int>() + 5;
  const double sample_spacing = block_edge / samples_per_block;
  // Off the round numbers that meshes like to lie on.
  const Vec3 lower = low - block_edge * Vec3(2.5137, 2.5171, 2.5113);
  progress.begin("voxel fractions", 0);
  const SampleRaster raster = rasterize(surface, lower, sample_spacing, samples_per_block * (counts + Vec3i::Ones()));
  const BlockMasks masks(raster);
  const auto shift_of = [](std::size_t c) {
    return Vec3i(samples_per_block / 2 * Vec3i(c & 1, c >> 1 & 1, c >> 2 & 1));
  };
  std::vector<BlockParts> parts;
  for (std::size_t o = 0; o < 8; ++o) parts.emplace_back(raster, masks, shift_of(o), counts);
  progress.end();

  const TargetSurface target(surface);
  const std::vector<TargetSurface::Sample> few_samples = target.samples(4000);
  constexpr std::array<double, 4> thresholds = {0.5, 0.3, 0.15, 0.04};
  std::vector<Candidate> candidates(8 * thresholds.size());
  progress.begin("polycube search", static_cast<long>(candidates.size()));
  parallel_for(
      candidates.size(),
      [&](std::size_t c) {
        Candidate& candidate = candidates[c];
        candidate.parts = &parts[c % 8];
        candidate.origin = lower + sample_spacing * shift_of(c).cast<double>();
        candidate.grid = BlockGrid(counts);
        for (std::size_t b = 0; b < candidate.grid.filled.size(); ++b)
          candidate.grid.filled[b] =
              candidate.parts->fractions()[b] >= thresholds[c / 8] && candidate.grid.may_fill(candidate.grid.place(b));
        part_blocks(candidate.grid, *candidate.parts);
        keep_largest_component(candidate.grid);
        if (candidate.grid.count() == 0) return;
        fill_to_manifold(candidate.grid, *candidate.parts);
        // The lowest threshold is for objects that the others miss.
        candidate.score = score_of(candidate, result.object_genus, result.cells_per_block, few_samples, block_edge) +
                          (c / 8 == 3 ? 50 : 0);
        progress.advance();
      },
      1);
  progress.end();
  std::size_t best = 0;
  for (std::size_t c = 1; c < candidates.size(); ++c)
    if (candidates[c].score < candidates[best].score) best = c;
  Candidate chosen = std::move(candidates[best]);
  if (!std::isfinite(chosen.score))
    throw InputError("the object is thinner than the grid's samples everywhere; try more --nodes");

  progress.begin("polycube shape", 0);
  const BlockParts& chosen_parts = *chosen.parts;
  const Vec3i shift = shift_of(best);
  const std::vector<TargetSurface::Sample> samples = target.samples(15000);
  const auto cover_of = [&](BlockCover::Side side, double radius) {
    BlockCover cover(raster, masks, shift, counts, samples, radius, side);
    cover.take(chosen.grid);
    return cover;
  };
  {
    BlockCover cover = cover_of(BlockCover::Side::inside, 0.5);
    grow_into_extremities(chosen.grid, chosen_parts, cover, 0.06f);
    BlockCover wide_cover = cover_of(BlockCover::Side::inside, 1.0);
    grow_into_extremities(chosen.grid, chosen_parts, wide_cover, 0.01f);
  }
  if (options.anneal_sweeps > 0) {
    BlockCover inner = cover_of(BlockCover::Side::inside, 1.0), outer = cover_of(BlockCover::Side::outside, 1.0);
    const std::vector<std::size_t> blocks = blocks_to_anneal(chosen.grid, chosen_parts.fractions());
    anneal_stairs(chosen.grid,
                  fill_costs(chosen.grid, blocks, chosen_parts.fractions(), target, chosen.origin, block_edge), blocks,
                  chosen_parts, inner, outer, options.anneal_sweeps);
  }
  const int found_genus = genus_of(chosen.grid);
  if (found_genus != result.object_genus) {
    std::vector<Vec3> places;
    if (found_genus < result.object_genus)
      for (const SurfaceHandle& handle : find_handles(surface, std::min(result.object_genus, most_handles)))
        places.push_back((handle.centre - chosen.origin) / block_edge);
    repair_genus(chosen.grid, result.object_genus, places, chosen_parts);
  }
  progress.end();
  if (count_ill_composed(chosen.grid) != 0) throw InternalError("voxel polycube: the boundary is not a manifold");

  result.genus = genus_of(chosen.grid);
  const SingularityCounts singular = count_singularities(chosen.grid);
  result.singular_edges = singular.edges;
  result.singular_corners = singular.corners;
  const Coverage cover = coverage(chosen.grid, to_block_places(target.samples(20000), chosen.origin, block_edge), true);
  result.coverage_p99 = cover.p99 * result.cells_per_block;
  result.coverage_max = cover.most * result.cells_per_block;
  Vec3i least = counts;
  for (std::size_t b = 0; b < chosen.grid.filled.size(); ++b)
    if (chosen.grid.filled[b]) least = least.cwiseMin(chosen.grid.place(b));
  for (std::size_t b = 0; b < chosen.grid.filled.size(); ++b)
    if (chosen.grid.filled[b]) result.blocks.push_back(chosen.grid.place(b) - least);
  result.origin = chosen.origin + block_edge * least.cast<double>();
  return result;
}

}  // namespace

VoxelPolycube build_voxel_polycube(const TriangleMesh& surface, const PolycubeOptions& options, Progress& progress) {
  const double volume = enclosed_volume(surface);
  if (!(volume > 0)) throw InputError("the surface encloses no volume; expected a closed surface with outward faces");
  double spacing = spacing_for(options.nodes, volume, surface);
  int cells_per_block = options.grid > 0 ? options.grid
                                         : static_cast<int>(std::exp2(std::max(
                                               0.0, std::round(std::log2(std::cbrt(options.nodes / options.blocks))))));
  // An object thinner than the samples of its blocks takes smaller ones, first at the same spacing.
  constexpr int most_tries = 16;
  VoxelPolycube best;
  std::string refusal;
  for (int tries = 0; tries < most_tries; ++tries) {
    try {
      VoxelPolycube polycube = build_with_spacing(surface, options, spacing, cells_per_block, progress);
      if (best.blocks.empty() || polycube.coverage_p99 * polycube.spacing < best.coverage_p99 * best.spacing)
        best = std::move(polycube);
      if (best.coverage_p99 <= lost_distance * best.cells_per_block) return best;
    } catch (const InputError& error) {
      if (refusal.empty()) refusal = error.what();
    }
    if (options.grid == 0 && cells_per_block > 1)
      cells_per_block /= 2;
    else
      spacing /= 1.5;
    if (spacing_is_too_small(surface, spacing * cells_per_block, most_blocks_tried_again)) break;
  }
  if (best.blocks.empty()) throw InputError(refusal);
  return best;
}

}  // namespace shellgrid
