// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/shell/voxel_boundary.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>

#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

// Steps towards the mean of the neighbours and back out, so that the volume stays. Source: [Taubin1995].
constexpr int relaxations = 30;
constexpr float inwards = 0.6f, outwards = -0.6f;
constexpr float farthest = 0.49f;  // from a cell's middle, voxels

constexpr int edge = 8, block_size = edge * edge * edge;

Vec3i block_of(const Vec3i& place) { return {place.x() >> 3, place.y() >> 3, place.z() >> 3}; }
int offset_in_block(const Vec3i& place) {
  return (place.x() & 7) * edge * edge + (place.y() & 7) * edge + (place.z() & 7);
}
Vec3i place_at(const Vec3i& block, int offset) {
  return edge * block + Vec3i(offset / (edge * edge), offset / edge % edge, offset % edge);
}

// Blocks of 8³ places, those that are asked for.
class Blocks {
 public:
  Blocks(const Vec3i& lower, const Vec3i& upper)
      : lower_(lower), size_(upper - lower + Vec3i::Ones()), top_(size_.cast<std::size_t>().prod(), -1) {}

  // -1: there is none.
  int find(const Vec3i& block) const {
    const Vec3i at = block - lower_;
    return (at.array() < 0 || at.array() >= size_.array()).any() ? -1 : top_[index(at)];
  }
  int find_or_add(const Vec3i& block) {
    std::int32_t& number = top_[index(block - lower_)];
    if (number < 0) {
      number = static_cast<std::int32_t>(places_.size());
      places_.push_back(block);
    }
    return number;
  }
  int count() const { return static_cast<int>(places_.size()); }
  const Vec3i& place(int number) const { return places_[number]; }

 private:
  std::size_t index(const Vec3i& at) const {
    return (static_cast<std::size_t>(at.x()) * size_.y() + at.y()) * size_.z() + at.z();
  }
  Vec3i lower_, size_;
  std::vector<std::int32_t> top_;
  std::vector<Vec3i> places_;
};

// Cell (i, j, k) has the voxels (i, j, k) … (i + 1, j + 1, k + 1) at its corners; corner number x + 2 y + 4 z.
using CornerMask = std::uint8_t;

// The surface's edges leave a cell along the axes, each through the four voxels that two cells share: as many quads
// lie at it as pairs of neighbours among the four of which one belongs. By direction 2 axis + (1: upwards).
std::array<std::uint8_t, 6> quads_by_direction(CornerMask mask) {
  std::array<std::uint8_t, 6> quads{};
  for (int direction = 0; direction < 6; ++direction) {
    const int axis = direction / 2, side = direction % 2, u = (axis + 1) % 3, v = (axis + 2) % 3;
    bool ring[4];
    for (int k = 0; k < 4; ++k) ring[k] = mask >> (side << axis | (k == 1 || k == 2) << u | (k >= 2) << v) & 1;
    for (int k = 0; k < 4; ++k) quads[direction] += ring[k] != ring[(k + 1) & 3];
  }
  return quads;
}

struct Cell {
  Vec3i place;
  CornerMask mask;
  std::array<std::int32_t, 6> next;  // cells, by direction; where no quad lies between: any
};

// Those with voxels of both kinds.
std::vector<Cell> boundary_cells(const std::vector<Vec3i>& voxels) {
  Vec3i lower = Vec3i::Constant(std::numeric_limits<int>::max()), upper = -lower;
  for (const Vec3i& voxel : voxels) {
    lower = lower.cwiseMin(voxel);
    upper = upper.cwiseMax(voxel);
  }
  // A voxel is at the corners of cells down to one less.
  Blocks blocks(block_of(lower - Vec3i::Ones()), block_of(upper));
  for (const Vec3i& voxel : voxels)
    for (int corner = 0; corner < 8; ++corner)
      blocks.find_or_add(block_of(voxel - Vec3i(corner & 1, corner >> 1 & 1, corner >> 2)));
  const auto count = static_cast<std::size_t>(blocks.count());
  std::vector<std::array<std::uint8_t, block_size>> members(count);
  for (auto& one : members) one.fill(0);
  for (const Vec3i& voxel : voxels) members[blocks.find(block_of(voxel))][offset_in_block(voxel)] = 1;

  std::vector<std::array<CornerMask, block_size>> masks(count);
  std::vector<std::int32_t> first(count + 1, 0);
  constexpr int wide = edge + 1;
  const auto is_boundary = [](CornerMask mask) { return mask != 0 && mask != 255; };
  parallel_for(
      count,
      [&](std::size_t b) {
        // The block with the next layer on each axis.
        std::array<std::uint8_t, wide * wide * wide> around{};
        for (int step = 0; step < 8; ++step) {
          const Vec3i by(step & 1, step >> 1 & 1, step >> 2);
          const int from = blocks.find(blocks.place(static_cast<int>(b)) + by);
          if (from < 0) continue;
          const Vec3i size = edge * (Vec3i::Ones() - by) + by;
          for (int x = 0; x < size.x(); ++x)
            for (int y = 0; y < size.y(); ++y)
              for (int z = 0; z < size.z(); ++z)
                around[((x + edge * by.x()) * wide + y + edge * by.y()) * wide + z + edge * by.z()] =
                    members[from][(x * edge + y) * edge + z];
        }
        std::int32_t cells = 0;
        for (int offset = 0; offset < block_size; ++offset) {
          const Vec3i at = place_at(Vec3i::Zero(), offset);
          const std::uint8_t* const low = around.data() + (at.x() * wide + at.y()) * wide + at.z();
          CornerMask mask = 0;
          for (int corner = 0; corner < 8; ++corner)
            mask |= static_cast<CornerMask>(low[((corner & 1) * wide + (corner >> 1 & 1)) * wide + (corner >> 2)]
                                            << corner);
          masks[b][offset] = mask;
          cells += is_boundary(mask);
        }
        first[b + 1] = cells;
      },
      16);
  for (std::size_t b = 0; b < count; ++b) first[b + 1] += first[b];

  std::vector<Cell> cells(static_cast<std::size_t>(first[count]));
  std::vector<std::array<std::int32_t, block_size>> numbers(count);
  parallel_for(
      count,
      [&](std::size_t b) {
        std::int32_t next = first[b];
        for (int offset = 0; offset < block_size; ++offset) {
          if (!is_boundary(masks[b][offset])) continue;
          numbers[b][offset] = next;
          cells[next++] = {place_at(blocks.place(static_cast<int>(b)), offset), masks[b][offset], {}};
        }
      },
      16);
  parallel_for(
      count,
      [&](std::size_t b) {
        for (std::int32_t c = first[b]; c < first[b + 1]; ++c) {
          Cell& cell = cells[c];
          const auto quads = quads_by_direction(cell.mask);
          for (int direction = 0; direction < 6; ++direction) {
            cell.next[direction] = c;
            if (quads[direction] == 0) continue;
            Vec3i other = cell.place;
            other[direction / 2] += direction % 2 == 1 ? 1 : -1;
            const Vec3i block = block_of(other);
            const std::size_t at =
                block == blocks.place(static_cast<int>(b)) ? b : static_cast<std::size_t>(blocks.find(block));
            cell.next[direction] = numbers[at][offset_in_block(other)];
          }
        }
      },
      16);
  return cells;
}

// Where the cells' vertices come to lie, from the cells' middles, voxels.
std::vector<Eigen::Array4f> relaxed(const std::vector<Cell>& cells) {
  std::array<std::array<float, 6>, 256> shares;
  std::array<Eigen::Array4f, 256> steps;  // mean of the directions
  for (int mask = 0; mask < 256; ++mask) {
    const auto quads = quads_by_direction(static_cast<CornerMask>(mask));
    float all = 0;
    for (const std::uint8_t one : quads) all += one;
    steps[mask].setZero();
    for (int direction = 0; direction < 6; ++direction) {
      shares[mask][direction] = all > 0 ? static_cast<float>(quads[direction]) / all : 0.0f;
      steps[mask][direction / 2] += (direction % 2 == 1 ? 1.0f : -1.0f) * shares[mask][direction];
    }
  }
  std::vector<Eigen::Array4f> place(cells.size(), Eigen::Array4f::Zero()), moved(cells.size());
  for (int round = 0; round < relaxations; ++round) {
    const float share = round % 2 == 0 ? inwards : outwards;
    parallel_for(
        cells.size(),
        [&](std::size_t c) {
          const Cell& cell = cells[c];
          Eigen::Array4f mean = steps[cell.mask];
          for (int direction = 0; direction < 6; ++direction)
            mean += shares[cell.mask][direction] * place[cell.next[direction]];
          moved[c] = (place[c] + share * (mean - place[c])).max(-farthest).min(farthest);
        },
        4096);
    place.swap(moved);
  }
  return place;
}

}  // namespace

TriangleMesh voxel_boundary(const GridFrame& frame, const std::vector<Vec3i>& voxels) {
  TriangleMesh mesh;
  if (voxels.empty()) return mesh;
  const std::vector<Cell> cells = boundary_cells(voxels);
  const std::vector<Eigen::Array4f> place = relaxed(cells);
  mesh.vertices.resize(static_cast<Eigen::Index>(cells.size()), 3);
  parallel_for(
      cells.size(),
      [&](std::size_t c) {
        const Vec3 at =
            cells[c].place.cast<double>() + Vec3::Constant(0.5) + place[c].head<3>().matrix().cast<double>();
        mesh.vertices.row(static_cast<Eigen::Index>(c)) = (frame.origin + frame.voxel * at).transpose();
      },
      4096);

  // Quads between a cell's lowest voxel and its three upper neighbours; each has four cells around it, of which that
  // one is the uppermost.
  const auto differs = [](CornerMask mask, int axis) { return ((mask & 1) != 0) != ((mask >> (1 << axis) & 1) != 0); };
  std::vector<std::int32_t> first(cells.size() + 1, 0);
  for (std::size_t c = 0; c < cells.size(); ++c) {
    first[c + 1] = first[c];
    for (int axis = 0; axis < 3; ++axis) first[c + 1] += differs(cells[c].mask, axis);
  }
  mesh.faces.resize(2 * static_cast<Eigen::Index>(first.back()), 3);
  parallel_for(
      cells.size(),
      [&](std::size_t c) {
        const Cell& cell = cells[c];
        Eigen::Index face = 2 * static_cast<Eigen::Index>(first[c]);
        for (int axis = 0; axis < 3; ++axis) {
          if (!differs(cell.mask, axis)) continue;
          const int u = (axis + 1) % 3, v = (axis + 2) % 3;
          const std::int32_t below_u = cell.next[2 * u];
          std::array<int, 4> quad = {cells[below_u].next[2 * v], cell.next[2 * v], static_cast<int>(c), below_u};
          if ((cell.mask & 1) == 0) std::swap(quad[1], quad[3]);  // counter-clockwise seen from outside
          mesh.faces.row(face++) << quad[0], quad[1], quad[2];
          mesh.faces.row(face++) << quad[0], quad[2], quad[3];
        }
      },
      4096);
  return mesh;
}

}  // namespace shellgrid
