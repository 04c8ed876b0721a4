// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/block_grid.h"
#include "meshing/core/error.h"

#include <algorithm>
#include <array>

namespace shellgrid {
namespace {

const std::array<Vec3i, 6> face_directions = {Vec3i(-1, 0, 0), Vec3i(1, 0, 0),  Vec3i(0, -1, 0),
                                              Vec3i(0, 1, 0),  Vec3i(0, 0, -1), Vec3i(0, 0, 1)};

bool connected_through_faces(int window) {
  if (window == 0) return true;
  int reached = window & -window;
  for (int round = 0; round < 8; ++round)
    for (int k = 0; k < 8; ++k)
      if (reached >> k & 1)
        for (int axis = 0; axis < 3; ++axis) reached |= window & (1 << (k ^ (1 << axis)));
  return reached == window;
}

// From a block of the interior to the six that share a face with it.
std::array<std::ptrdiff_t, 6> index_steps(const BlockGrid& grid) {
  const std::ptrdiff_t row = grid.size.x(), layer = row * grid.size.y();
  return {-1, 1, -row, row, -layer, layer};
}

struct WindowFacts {
  std::array<bool, 256> well_composed, visible;
  std::array<std::uint8_t, 256> valence;
  WindowFacts() {
    for (int window = 0; window < 256; ++window) {
      well_composed[window] = connected_through_faces(window) && connected_through_faces(~window & 255);
      // The twelve quarter faces around the point: pairs of blocks that differ in one axis' bit.
      constexpr int lower_half[3] = {0x55, 0x33, 0x0f};
      int faces = 0;
      visible[window] = true;
      for (int axis = 0; axis < 3; ++axis) {
        const int low = window & lower_half[axis], high = window >> (1 << axis) & lower_half[axis];
        faces += __builtin_popcount(static_cast<unsigned>(low ^ high));
        if ((low & ~high) && (high & ~low)) visible[window] = false;
      }
      valence[window] = static_cast<std::uint8_t>(faces);
    }
  }
};

const WindowFacts& facts() {
  static const WindowFacts table;
  return table;
}

// The surface of one block as a complex: places in {−1, 0, 1}³ without the centre, bit x + 3y + 9z. A face
// has one odd coordinate, an edge two, a vertex three.
struct SurfaceCells {
  std::array<unsigned, 27> touching{};    // blocks around, the own one left out, whose closure holds the cell
  std::array<unsigned, 27> neighbours{};  // cells of which one lies in the other's closure
  unsigned edges = 0;

  SurfaceCells() {
    const auto coordinate = [](int cell, int axis) { return cell / (axis == 0 ? 1 : axis == 1 ? 3 : 9) % 3 - 1; };
    // Whether a's odd coordinates contain b's.
    const auto closes = [&](int a, int b) {
      for (int axis = 0; axis < 3; ++axis)
        if (coordinate(b, axis) != 0 && coordinate(a, axis) != coordinate(b, axis)) return false;
      return true;
    };
    for (int a = 0; a < 27; ++a) {
      if (a == 13) continue;
      int odd = 0;
      for (int axis = 0; axis < 3; ++axis) odd += coordinate(a, axis) != 0;
      if (odd == 2) edges |= 1u << a;
      for (int b = 0; b < 27; ++b) {
        if (b == 13) continue;
        if (closes(a, b)) touching[a] |= 1u << b;
        if (closes(a, b) || closes(b, a)) neighbours[a] |= 1u << b;
      }
    }
  }
};

const SurfaceCells& surface_cells() {
  static const SurfaceCells table;
  return table;
}

}  // namespace

std::size_t BlockGrid::count() const {
  std::size_t total = 0;
  for (std::uint8_t f : filled) total += f != 0;
  return total;
}

int window_at(const BlockGrid& grid, const Vec3i& corner) {
  int window = 0;
  if ((corner.array() >= 1).all() && (corner.array() < grid.size.array()).all()) {
    const std::size_t row = grid.size.x(), layer = row * grid.size.y();
    const std::uint8_t* first = &grid.filled[grid.index(corner - Vec3i::Ones())];
    for (int k = 0; k < 8; ++k) window |= (first[(k & 1) + (k >> 1 & 1) * row + (k >> 2) * layer] ? 1 : 0) << k;
    return window;
  }
  for (int k = 0; k < 8; ++k)
    if (grid.at(corner - Vec3i::Ones() + Vec3i(k & 1, k >> 1 & 1, k >> 2))) window |= 1 << k;
  return window;
}

bool is_well_composed(int window) { return facts().well_composed[window]; }
int boundary_valence(int window) { return facts().valence[window]; }
bool has_visible_normal(int window) { return facts().visible[window]; }

bool is_simple_flip(const BlockGrid& grid, const Vec3i& block) {
  // The 27 blocks around, bit x + 3y + 9z.
  unsigned around = 0;
  for (int k = 0; k < 27; ++k)
    if (grid.at(block + Vec3i(k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1))) around |= 1u << k;
  return is_simple_flip(around);
}

int window_of(unsigned around, int corner) {
  const unsigned from = around >> ((corner & 1) + 3 * (corner >> 1 & 1) + 9 * (corner >> 2));
  return static_cast<int>((from & 3u) | (from >> 3 & 3u) << 2 | (from >> 9 & 3u) << 4 | (from >> 12 & 3u) << 6);
}

bool is_simple_flip(unsigned around) {
  const SurfaceCells& cells = surface_cells();
  const unsigned flipped = around ^ (1u << 13);
  for (int corner = 0; corner < 8; ++corner)
    if (!is_well_composed(window_of(flipped, corner))) return false;
  around &= ~(1u << 13);
  unsigned touched = 0;
  for (int cell = 0; cell < 27; ++cell)
    if (around & cells.touching[cell]) touched |= 1u << cell;
  if (touched == 0) return false;
  const int euler = __builtin_popcount(touched) - 2 * __builtin_popcount(touched & cells.edges);
  if (euler != 1) return false;
  unsigned reached = touched & (~touched + 1);
  for (;;) {
    unsigned next = reached;
    for (unsigned rest = reached; rest; rest &= rest - 1) next |= cells.neighbours[__builtin_ctz(rest)] & touched;
    if (next == reached) break;
    reached = next;
  }
  return reached == touched;
}

long boundary_euler_characteristic(const BlockGrid& grid) {
  long vertices = 0, corners = 0;  // corners = 4 faces; edges = corners / 2
  for (int k = 0; k <= grid.size.z(); ++k)
    for (int j = 0; j <= grid.size.y(); ++j)
      for (int i = 0; i <= grid.size.x(); ++i) {
        const int valence = boundary_valence(window_at(grid, {i, j, k}));
        vertices += valence > 0;
        corners += valence;
      }
  return vertices - corners / 2 + corners / 4;
}

void keep_largest_component(BlockGrid& grid) {
  const std::array<std::ptrdiff_t, 6> steps = index_steps(grid);
  std::vector<int> label(grid.filled.size(), 0);
  std::vector<std::size_t> stack;
  int labels = 0, best = 0;
  std::size_t best_size = 0;
  for (std::size_t seed = 0; seed < label.size(); ++seed) {
    if (!grid.filled[seed] || label[seed]) continue;
    ++labels;
    std::size_t size = 0;
    label[seed] = labels;
    stack.push_back(seed);
    while (!stack.empty()) {
      const std::size_t b = stack.back();
      stack.pop_back();
      ++size;
      for (std::ptrdiff_t step : steps)
        if (grid.filled[b + step] && !label[b + step]) label[b + step] = labels, stack.push_back(b + step);
    }
    if (size > best_size) best_size = size, best = labels;
  }
  for (std::size_t b = 0; b < label.size(); ++b) grid.filled[b] = grid.filled[b] && label[b] == best;
}

void fill_cavities(BlockGrid& grid) {
  const std::array<std::ptrdiff_t, 6> steps = index_steps(grid);
  std::vector<std::uint8_t> outside(grid.filled.size(), 0);
  std::vector<std::size_t> stack;
  // The outermost layer is outside, so that steps from within never leave the window.
  for (int k = 0; k < grid.size.z(); ++k)
    for (int j = 0; j < grid.size.y(); ++j) {
      const bool inner_row = k > 0 && k < grid.size.z() - 1 && j > 0 && j < grid.size.y() - 1;
      for (int i = 0; i < grid.size.x(); i += inner_row && i == 0 ? std::max(1, grid.size.x() - 1) : 1)
        outside[grid.index(i, j, k)] = 1;
    }
  const auto visit = [&](std::size_t b) {
    if (!grid.filled[b] && !outside[b]) outside[b] = 1, stack.push_back(b);
  };
  for (std::size_t b = 0; b < outside.size(); ++b) {
    const Vec3i place = grid.place(b);
    if (!grid.may_fill(place)) continue;
    if ((place.array() == 1).any() || (place.array() == grid.size.array() - 2).any()) visit(b);
  }
  while (!stack.empty()) {
    const std::size_t b = stack.back();
    stack.pop_back();
    for (std::ptrdiff_t step : steps) visit(b + step);
  }
  for (std::size_t b = 0; b < outside.size(); ++b)
    if (!outside[b]) grid.filled[b] = 1;
}

std::vector<Vec3i> fill_to_visible(const std::vector<Vec3i>& blocks) {
  if (blocks.empty()) return {};
  Vec3i low = blocks.front(), high = blocks.front();
  for (const Vec3i& b : blocks) low = low.cwiseMin(b), high = high.cwiseMax(b);
  // Only blocks of the bounding box: full, it is such a polycube, so that the filling ends.
  BlockGrid grid(high - low + Vec3i::Constant(3));
  const Vec3i shift = Vec3i::Ones() - low;
  for (const Vec3i& b : blocks) grid.filled[grid.index(b + shift)] = 1;
  for (bool changed = true; changed;) {
    changed = false;
    fill_cavities(grid);
    for (int k = 1; k < grid.size.z(); ++k)
      for (int j = 1; j < grid.size.y(); ++j)
        for (int i = 1; i < grid.size.x(); ++i) {
          const Vec3i corner(i, j, k);
          for (;;) {
            const int window = window_at(grid, corner);
            if (window == 0 || window == 255 || (is_well_composed(window) && has_visible_normal(window))) break;
            // The empty block here with the most filled ones around it.
            int most = -1;
            Vec3i best = Vec3i::Zero();
            for (int n = 0; n < 8; ++n) {
              const Vec3i block = corner - Vec3i::Ones() + Vec3i(n & 1, n >> 1 & 1, n >> 2);
              if (grid.at(block) || !grid.may_fill(block)) continue;
              int around = 0;
              for (const Vec3i& d : face_directions) around += grid.at(block + d);
              if (around > most) most = around, best = block;
            }
            if (most < 0) throw InternalError("voxel polycube: a window cannot be mended");
            grid.filled[grid.index(best)] = 1;
            changed = true;
          }
        }
  }
  std::vector<Vec3i> result;
  for (std::size_t b = 0; b < grid.filled.size(); ++b)
    if (grid.filled[b]) result.push_back(grid.place(b) - shift);
  return result;
}

std::size_t count_ill_composed(const BlockGrid& grid) {
  std::size_t count = 0;
  for (int k = 0; k <= grid.size.z(); ++k)
    for (int j = 0; j <= grid.size.y(); ++j)
      for (int i = 0; i <= grid.size.x(); ++i) count += !is_well_composed(window_at(grid, {i, j, k}));
  return count;
}

SingularityCounts count_singularities(const BlockGrid& grid) {
  SingularityCounts counts;
  for (int k = 0; k <= grid.size.z(); ++k)
    for (int j = 0; j <= grid.size.y(); ++j)
      for (int i = 0; i <= grid.size.x(); ++i) {
        const int window = window_at(grid, {i, j, k});
        if (window == 0 || window == 255) continue;
        const int valence = boundary_valence(window);
        counts.corners += valence != 4;
        // The edges towards +x, +y, +z: the four blocks of the window's upper half.
        for (int mask : {0xaa, 0xcc, 0xf0}) {
          const int filled = __builtin_popcount(static_cast<unsigned>(window & mask));
          counts.edges += filled == 1 || filled == 3;
        }
      }
  return counts;
}

}  // namespace shellgrid
