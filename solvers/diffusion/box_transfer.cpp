// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/box_transfer.h"

#include <algorithm>
#include <bit>

#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

// Axes as bits. Of a child in `octant` of its parent, corner k stands between coarse points along the axes octant ^ k;
// it takes from the parent's corners that agree with it along the others.
// The number of parent's corner p among those that a point between coarse points along `between` takes from.
constexpr int parent_number(int between, int p) {
  int number = 0, bit = 0;
  for (int axis = 0; axis < 3; ++axis)
    if (between >> axis & 1) number |= (p >> axis & 1) << bit++;
  return number;
}

// Where the weights of an inner point stand.
class WeightPlace {
 public:
  WeightPlace(RunLevel& level) : layout_(level.layout), transfer_(level.transfer) {}

  // Red; the other channels follow at `stride`.
  float* at(std::int32_t unknown, int number, std::ptrdiff_t& stride) const {
    const std::int32_t r = layout_.run_of[unknown];
    const LatticeRun& run = layout_.runs[r];
    const LevelTransfer::FineRun& fine = transfer_.fine_runs[r];
    if (fine.lines == 0) {
      stride = 1;
      const std::size_t row = static_cast<std::size_t>(fine.half_start + unknown - run.start);
      return reinterpret_cast<float*>(&transfer_.weights.inner_up[transfer_.inner_up.start[row] + number]);
    }
    const std::int32_t place = unknown - run.start + (run.x & 1);
    const bool odd = place & 1;
    stride = fine.coarse_length;
    return transfer_.weights.line(r, fine.coarse_length, odd ? number >> 1 : number, odd ? 1 + (number & 1) : 0) +
           (place >> 1);
  }
  Float4 get(std::int32_t unknown, int number) const {
    std::ptrdiff_t stride = 0;
    const float* w = at(unknown, number, stride);
    return Float4{w[0], w[stride], w[2 * stride], 0};
  }
  void set(std::int32_t unknown, int number, const Float4& value) const {
    std::ptrdiff_t stride = 0;
    float* w = at(unknown, number, stride);
    for (int c = 0; c < 3; ++c) w[c * stride] = value[c];
  }

 private:
  const RunLayout& layout_;
  LevelTransfer& transfer_;
};

// Neighbours of one run's points, by direction (dz + 1)·9 + (dy + 1)·3 + dx + 1.
struct RunRows {
  std::size_t length = 0;
  std::vector<std::int32_t> neighbour;  // 27 lines; −1 where there is none
  std::vector<Float4> coupling;         // 27 lines
  std::vector<Float4> reaction;

  std::size_t at(int direction, std::int32_t p) const { return static_cast<std::size_t>(direction) * length + p; }
};

constexpr int direction_number(int dx, int dy, int dz) { return (dz + 1) * 9 + (dy + 1) * 3 + dx + 1; }

void gather_rows(const RunLevel& level, std::int32_t r, RunRows& rows) {
  const RunLayout& layout = level.layout;
  const LatticeRun& run = layout.runs[r];
  rows.length = run.length;
  rows.neighbour.assign(27 * rows.length, -1);
  rows.coupling.assign(27 * rows.length, Float4{});
  rows.reaction.resize(rows.length);
  const float* values = level.single.values.data();
  const auto put = [&](int direction, std::int32_t p, std::int32_t other, const float* at, std::int64_t stride) {
    rows.neighbour[rows.at(direction, p)] = other;
    rows.coupling[rows.at(direction, p)] = Float4{at[0], at[stride], at[2 * stride], 0};
  };
  const float* own = values + static_cast<std::int64_t>(coupling_slots) * 3 * run.start;
  for (std::int32_t p = 0; p < run.length; ++p) {
    const std::int32_t u = run.start + p;
    if (p + 1 < run.length) put(direction_number(1, 0, 0), p, u + 1, own + p, run.length);
    if (p > 0) put(direction_number(-1, 0, 0), p, u - 1, own + p - 1, run.length);
    rows.reaction[p] = Float4{level.reaction.inner[0][u], level.reaction.inner[1][u], level.reaction.inner[2][u], 0};
  }
  for (std::int64_t k = layout.link_start[r]; k < layout.link_start[r + 1]; ++k) {
    const RunLink& link = layout.links[k];
    const LatticeRun& holder = link.follows ? run : layout.runs[link.run];
    const FollowingLine& line = following_lines[link.line];
    const int sign = link.follows ? 1 : -1;
    for (int dx = 0; dx < 3; ++dx) {
      const int step = sign * (dx - 1);
      const float* slot = values + static_cast<std::int64_t>(coupling_slots) * 3 * holder.start +
                          static_cast<std::int64_t>(3 * (1 + 3 * link.line + dx)) * holder.length;
      for (std::int32_t p = link.begin[dx]; p < link.end[dx]; ++p) {
        const std::int32_t other = run.start + p + link.shift + step;
        put(direction_number(step, sign * line.dy, sign * line.dz), p, other,
            slot + (link.follows ? p : other - holder.start), holder.length);
      }
    }
  }
  // An outer point's row adds to its twin's.
  for (std::int32_t s = level.surface.first_of_run[r]; s < level.surface.first_of_run[r + 1]; ++s) {
    const std::int32_t p = level.surface.twin[s] - run.start;
    for (std::int32_t k = level.surface.start[s]; k < level.surface.start[s + 1]; ++k) {
      const std::int32_t twin = level.surface.twin[level.surface.neighbour[k]];
      const LatticeRun& there = layout.runs[layout.run_of[twin]];
      const int dx = there.x + (twin - there.start) - run.x - p, dy = there.y - run.y, dz = there.z - run.z;
      if (std::max({std::abs(dx), std::abs(dy), std::abs(dz)}) > 1) continue;
      const std::size_t at = rows.at(direction_number(dx, dy, dz), p);
      if (rows.neighbour[at] != twin) continue;
      const SurfaceCoupling<float>& pair = level.single.surface[k];
      for (int c = 0; c < 3; ++c) rows.coupling[at][c] += pair.outer_outer[c] + pair.twin_outer[c] + pair.outer_twin[c];
    }
  }
}

// The weights of one point between coarse points along `between`.
void set_point(const RunRows& rows, std::int32_t unknown, std::int32_t p, int between, const WeightPlace& place) {
  Float4 weight[8] = {}, total = {};
  const int count = 1 << std::popcount(static_cast<unsigned>(between));
  for (int direction = 0; direction < 27; ++direction) {
    const std::size_t at = rows.at(direction, p);
    if (rows.neighbour[at] < 0) continue;
    const int step[3] = {direction % 3 - 1, direction / 3 % 3 - 1, direction / 9 - 1};
    int moved = 0, high = 0, flat[3] = {};
    for (int axis = 0; axis < 3; ++axis)
      if ((between >> axis & 1) && step[axis] != 0) {
        moved |= 1 << axis;
        high |= (step[axis] > 0) << axis;
        flat[axis] = step[axis];
      }
    if (moved == 0) continue;
    const Float4 coupling = rows.coupling[at];
    const std::int32_t from = rows.neighbour[rows.at(direction_number(flat[0], flat[1], flat[2]), p)];
    if (from < 0) continue;
    total += coupling;
    // What that neighbour takes from the coarse points is between them along the axes left.
    const int left = between & ~moved;
    for (int corner = 0; corner < 8; ++corner) {
      if ((corner & ~left) != high) continue;
      const Float4 share = left == 0 ? Float4{1, 1, 1, 0} : place.get(from, parent_number(left, corner));
      weight[parent_number(between, corner)] += coupling * share;
    }
  }
  // Couplings of the wrong sign can leave no sound weight: then equal shares.
  const Float4 reaction = rows.reaction[p] > 0 ? rows.reaction[p] : Float4{};
  Float4 result[8] = {};
  for (int c = 0; c < 3; ++c) {
    float sum = 0, positive = 0, greatest = 0;
    for (int k = 0; k < count; ++k) {
      greatest = std::max(greatest, std::abs(weight[k][c]));
      sum += weight[k][c];
      positive += std::max(0.0f, weight[k][c]);
    }
    const bool sound = total[c] > 0 && greatest <= 1.5f * total[c] && sum >= 0;
    // Where light is absorbed on the way less arrives.
    // Where most light is absorbed on the way less arrives; elsewhere constants stay constant.
    const float arriving = sound && positive > 0 ? sum / (total[c] + reaction[c]) : 0.0f;
    const float kept = positive > 0 ? (arriving < 0.5f ? arriving : 1.0f) / positive : 0.0f;
    for (int k = 0; k < count; ++k)
      result[k][c] = sound ? kept * std::max(0.0f, weight[k][c]) : 1.0f / static_cast<float>(count);
  }
  for (int k = 0; k < count; ++k) place.set(unknown, k, result[k]);
}

}  // namespace

void set_box_weights(RunLevel& level) {
  LevelTransfer& transfer = level.transfer;
  const RunLayout& layout = level.layout;
  TransferWeights& weights = transfer.weights;
  const std::size_t runs = layout.runs.size();
  if (weights.start.empty()) {
    weights.start.assign(runs + 1, 0);
    for (std::size_t r = 0; r < runs; ++r) {
      const LevelTransfer::FineRun& run = transfer.fine_runs[r];
      weights.start[r + 1] = weights.start[r] + static_cast<std::int64_t>(9) * run.lines * run.coarse_length;
    }
  }
  weights.values = StreamBuffer<float>(static_cast<std::size_t>(weights.start[runs]));
  weights.inner_up.assign(transfer.inner_up.index.size(), Float4{});
  const WeightPlace place(level);
  // Points on coarse ones, then between two, four and eight, each from those before.
  for (int between_count = 0; between_count <= 3; ++between_count)
    parallel_chunks(runs, 64, [&](std::size_t begin, std::size_t end) {
      thread_local RunRows rows;
      for (std::size_t r = begin; r < end; ++r) {
        const LatticeRun& run = layout.runs[r];
        const int lines = (run.y & 1) << 1 | (run.z & 1) << 2, odd_lines = (run.y & 1) + (run.z & 1);
        if (odd_lines != between_count && odd_lines + 1 != between_count) continue;
        if (between_count > 0) gather_rows(level, static_cast<std::int32_t>(r), rows);
        for (std::int32_t p = (odd_lines + 1 == between_count) != (run.x & 1); p < run.length; p += 2)
          if (between_count == 0)
            place.set(run.start + p, 0, Float4{1, 1, 1, 0});
          else
            set_point(rows, run.start + p, p, lines | ((run.x + p) & 1), place);
      }
    });

  const LevelTransfer::List& up = transfer.inner_up;
  weights.inner_down.assign(transfer.inner_down.index.size(), Float4{});
  if (!up.index.empty()) {
    std::vector<std::int64_t> next(*std::max_element(up.index.begin(), up.index.end()) + 1, 0);
    for (std::size_t k = 0; k < transfer.inner_down.row.size(); ++k)
      next[transfer.inner_down.row[k]] = transfer.inner_down.start[k];
    for (std::size_t e = 0; e < up.index.size(); ++e) weights.inner_down[next[up.index[e]]++] = weights.inner_up[e];
  }
  const LevelTransfer::List& outer = transfer.outer_up;
  weights.outer_up.resize(outer.index.size());
  weights.outer_down.resize(outer.index.size());
  for (std::size_t s = 0; s < level.surface.size(); ++s)
    for (std::int64_t e = outer.start[s]; e < outer.start[s + 1]; ++e)
      weights.outer_up[e] = place.get(level.surface.twin[s], static_cast<int>(e - outer.start[s]));
  std::vector<std::int64_t> next(transfer.outer_down.start.begin(), transfer.outer_down.start.end());
  for (std::size_t e = 0; e < outer.index.size(); ++e) weights.outer_down[next[outer.index[e]]++] = weights.outer_up[e];
}

void load_parent_weights(const RunLevel& level, std::int32_t first, int count, ParentWeights& weights) {
  const WeightPlace place(const_cast<RunLevel&>(level));
  std::fill_n(&weights.weight[0][0][0], 3 * 64, Float16Lanes{});
  for (int i = 0; i < count; ++i) {
    const std::int32_t cell = first + i;
    const int octant = level.cells.octant[cell];
    for (int k = 0; k < 8; ++k) {
      const std::int32_t unknown = level.cells.corners[8 * static_cast<std::size_t>(cell) + k];
      const int between = octant ^ k;
      // Along the other axes the corner stands on the parent's own.
      for (int p = 0; p < 8; ++p) {
        if ((p ^ octant) & ~between & 7) continue;
        const Float4 value = place.get(unknown, parent_number(between, p));
        for (int c = 0; c < 3; ++c) reinterpret_cast<float*>(&weights.weight[c][k][p])[i] = value[c];
      }
    }
  }
}

void coarsen_elements(const ElementLanes& children, const ParentWeights& weights, ElementLanes& parents) {
  for (int c = 0; c < 3; ++c) {
    const auto& w = weights.weight[c];
    const auto& own = children.coupling[c];
    Float16Lanes sum[8];
    for (int a = 0; a < 8; ++a) {
      sum[a] = w[a][0];
      for (int p = 1; p < 8; ++p) sum[a] += w[a][p];
    }
    // What flows from the child's corners at a parent's corner's value 1, as differences: exact where nothing does.
    for (int p = 0; p < 8; ++p) {
      Float16Lanes flow[8] = {};
      for (int a = 0; a < 8; ++a)
        for (int b = a + 1; b < 8; ++b) {
          const Float16Lanes part = own[pair_number(a, b)] * (w[a][p] - w[b][p]);
          flow[a] += part;
          flow[b] -= part;
        }
      for (int q = p + 1; q < 8; ++q) {
        Float16Lanes coupling = w[0][q] * flow[0];
        for (int a = 1; a < 8; ++a) coupling += w[a][q] * flow[a];
        parents.coupling[c][pair_number(p, q)] = -coupling;
      }
      Float16Lanes lost = sum[0] * flow[0];
      for (int a = 1; a < 8; ++a) lost += sum[a] * flow[a];
      parents.absorption[c][p] = lost;
    }
  }
}

void add_coarse_boundary(const BoundaryElement& child, const RunLevel& level, std::int32_t cell,
                         BoundaryElement& parent, std::array<Float4, 16>& lost) {
  const WeightPlace place(const_cast<RunLevel&>(level));
  Float4 m[16][16], w[8][8] = {};
  const int octant = level.cells.octant[cell];
  for (int k = 0; k < 8; ++k)
    for (int p = 0; p < 8; ++p)
      if (((p ^ octant) & ~(octant ^ k) & 7) == 0)
        w[k][p] = place.get(level.cells.corners[8 * static_cast<std::size_t>(cell) + k], parent_number(octant ^ k, p));
  fill_from_couplings(m, [&](int a, int b) { return child.coupling(a, b); });
  Float4 right[16][16];
  for (int a = 0; a < 16; ++a)
    for (int q = 0; q < 16; ++q) {
      Float4 sum = {};
      for (int b = 0; b < 8; ++b) sum += m[a][(q & 8) + b] * w[b][q & 7];
      right[a][q] = sum;
    }
  for (int p = 0; p < 16; ++p)
    for (int q = p + 1; q < 16; ++q) {
      Float4 sum = {};
      for (int a = 0; a < 8; ++a) sum += w[a][p & 7] * right[(p & 8) + a][q];
      parent.coupling(p, q) += sum;
    }
  // As differences, which are zero where nothing is lost.
  Float4 sum[8], row[16] = {};
  for (int k = 0; k < 8; ++k) {
    sum[k] = Float4{};
    for (int p = 0; p < 8; ++p) sum[k] += w[k][p];
  }
  for (int a = 0; a < 16; ++a)
    for (int b = a + 1; b < 16; ++b) {
      const Float4 flow = child.coupling(a, b) * (sum[a & 7] - sum[b & 7]);
      row[a] += flow;
      row[b] -= flow;
    }
  for (int p = 0; p < 16; ++p) {
    lost[p] = Float4{};
    for (int a = 0; a < 8; ++a) lost[p] += w[a][p & 7] * row[(p & 8) + a];
  }
}

}  // namespace shellgrid
