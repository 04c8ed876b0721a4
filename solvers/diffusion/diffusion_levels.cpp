// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/diffusion_levels.h"

#include <algorithm>
#include <functional>
#include <numeric>
#include <unordered_map>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/polycube/polygrid_hierarchy.h"
#include "solvers/diffusion/composite_grid.h"

namespace shellgrid {
namespace {

constexpr int vtk_corner[8] = {0, 1, 3, 2, 4, 5, 7, 6};

std::uint64_t place_key(const Vec3i& place) {
  const auto part = [](int x) { return static_cast<std::uint64_t>(x + (1 << 20)) & ((std::uint64_t{1} << 21) - 1); };
  return part(place.z()) << 42 | part(place.y()) << 21 | part(place.x());
}

// Outer unknowns above inner points; `point_outer`: of each point whether there is one. Fills `outer_of`, per unknown.
void lay_out_outer(const std::vector<char>& point_outer, RunLevel& level, std::vector<std::int32_t>& outer_of) {
  const RunLayout& layout = level.layout;
  outer_of.assign(layout.size(), -1);
  level.surface.first_of_run.assign(layout.runs.size() + 1, 0);
  for (std::size_t u = 0; u < layout.size(); ++u) {
    if (!point_outer[layout.point_of[u]]) continue;
    outer_of[u] = static_cast<std::int32_t>(level.surface.twin.size());
    level.surface.twin.push_back(static_cast<std::int32_t>(u));
    ++level.surface.first_of_run[layout.run_of[u] + 1];
  }
  std::partial_sum(level.surface.first_of_run.begin(), level.surface.first_of_run.end(),
                   level.surface.first_of_run.begin());
}

// The outer points above cells with boundary elements, and which of them are neighbours.
void connect_surface(RunLevel& level, const std::vector<std::int32_t>& outer_of) {
  LevelCells& cells = level.cells;
  SurfaceLayout& surface = level.surface;
  const std::size_t count = cells.boundary.size();
  cells.outer.resize(8 * count);
  std::vector<std::array<std::int32_t, 26>> near(surface.size());
  std::vector<std::int32_t> near_count(surface.size(), 0);
  std::vector<std::pair<std::int32_t, std::int32_t>> further;
  for (std::size_t b = 0; b < count; ++b) {
    std::int32_t* outer = cells.outer.data() + 8 * b;
    for (int k = 0; k < 8; ++k)
      outer[k] = cells.outer_mask[b] >> k & 1 ? outer_of[cells.corners[8 * cells.boundary[b] + k]] : -1;
    for (int k = 0; k < 8; ++k)
      if ((cells.outer_mask[b] >> k & 1) && outer[k] < 0)
        throw InternalError("diffusion: a boundary element's corner has no outer point");
    for (int i = 0; i < 8; ++i)
      for (int j = 0; j < 8; ++j) {
        const std::int32_t s = outer[i], t = outer[j];
        if (i == j || s < 0 || t < 0) continue;
        const auto end = near[s].begin() + near_count[s];
        if (std::find(near[s].begin(), end, t) != end) continue;
        if (near_count[s] < 26)
          near[s][near_count[s]++] = t;
        else
          further.emplace_back(s, t);
      }
  }
  std::sort(further.begin(), further.end());
  further.erase(std::unique(further.begin(), further.end()), further.end());
  surface.start.assign(1, 0);
  std::size_t next = 0;
  for (std::size_t s = 0; s < surface.size(); ++s) {
    std::vector<std::int32_t> all(near[s].begin(), near[s].begin() + near_count[s]);
    for (; next < further.size() && further[next].first == static_cast<std::int32_t>(s); ++next)
      all.push_back(further[next].second);
    std::sort(all.begin(), all.end());
    surface.neighbour.insert(surface.neighbour.end(), all.begin(), all.end());
    surface.start.push_back(static_cast<std::int32_t>(surface.neighbour.size()));
  }
}

// Slabs of two layers of cells share no point with the next but one.
std::vector<std::int32_t> slabs(std::size_t count, const std::function<int(std::size_t)>& z_of) {
  std::vector<std::int32_t> start;
  int last = 0;
  for (std::size_t k = 0; k < count; ++k) {
    const int slab = z_of(k) >> 1;
    if (start.empty() || slab != last) {
      // An empty slab keeps the parity right.
      const int missing = start.empty() ? (slab & 1) : slab - last - 1;
      for (int m = 0; m < missing; ++m) start.push_back(static_cast<std::int32_t>(k));
      start.push_back(static_cast<std::int32_t>(k));
      last = slab;
    }
  }
  start.push_back(static_cast<std::int32_t>(count));
  return start;
}

// The transfer of one run where its points' parents follow each other, else nothing.
LevelTransfer::FineRun fine_run(const LatticeRun& run, const RunLayout& fine, const RunLayout& coarse,
                                const PointTransfer& points) {
  LevelTransfer::FineRun result;
  const int odd = run.x & 1, lines = (run.y & 1 ? 2 : 1) * (run.z & 1 ? 2 : 1);
  result.coarse_length = (run.length + odd) / 2 + 1;
  for (std::int32_t p = 0; p < run.length; ++p) {
    const std::int32_t point = fine.point_of[run.start + p];
    const std::int64_t first = points.start[point], count = points.start[point + 1] - first;
    const bool between = (p + odd) & 1;
    if (count != lines * (between ? 2 : 1)) return {};
    for (int line = 0; line < lines; ++line)
      for (int k = 0; k <= between; ++k) {
        // Parents come in the order of their corners: x fastest.
        const std::int32_t parent = coarse.unknown_of[points.parent[first + line * (between ? 2 : 1) + k]];
        const std::int32_t place = (p + odd) / 2 + k;
        if (p == 0 && k == 0) result.coarse[line] = parent - place;
        if (parent != result.coarse[line] + place) return {};
        if (coarse.run_of[parent] != coarse.run_of[result.coarse[line]]) return {};
      }
  }
  result.lines = lines;
  return result;
}

LevelTransfer::List transposed(const LevelTransfer::List& up, std::size_t coarse, bool keep_rows) {
  LevelTransfer::List down;
  std::vector<std::int64_t> start(coarse + 1, 0);
  for (std::int32_t index : up.index) ++start[index + 1];
  std::partial_sum(start.begin(), start.end(), start.begin());
  std::vector<std::int64_t> next(start.begin(), start.end() - 1);
  down.index.resize(up.index.size());
  down.weight.resize(up.index.size());
  for (std::size_t k = 0; k + 1 < up.start.size(); ++k)
    for (std::int64_t e = up.start[k]; e < up.start[k + 1]; ++e) {
      const std::int64_t at = next[up.index[e]]++;
      down.index[at] = up.row.empty() ? static_cast<std::int32_t>(k) : up.row[k];
      down.weight[at] = 1.0f / static_cast<float>(up.start[k + 1] - up.start[k]);
    }
  if (!keep_rows) {
    down.start = std::move(start);
    return down;
  }
  down.start.push_back(0);
  for (std::size_t c = 0; c < coarse; ++c)
    if (start[c + 1] > start[c]) {
      down.row.push_back(static_cast<std::int32_t>(c));
      down.start.push_back(start[c + 1]);
    }
  return down;
}

void build_transfer(RunLevel& fine, const RunLevel& coarse, const PointTransfer& points,
                    const std::vector<std::int32_t>& coarse_outer_of) {
  LevelTransfer& transfer = fine.transfer;
  const std::size_t runs = fine.layout.runs.size();
  transfer.fine_runs.resize(runs);
  parallel_for(runs, [&](std::size_t r) {
    transfer.fine_runs[r] = fine_run(fine.layout.runs[r], fine.layout, coarse.layout, points);
  });
  std::vector<std::vector<LevelTransfer::CoarsePart>> parts(coarse.layout.runs.size());
  transfer.inner_up.start.push_back(0);
  for (std::size_t r = 0; r < runs; ++r) {
    LevelTransfer::FineRun& run = transfer.fine_runs[r];
    if (run.lines == 0) {
      run.half_start = static_cast<std::int32_t>(transfer.inner_up.row.size());
      const LatticeRun& own = fine.layout.runs[r];
      for (std::int32_t u = own.start; u < own.start + own.length; ++u) {
        const std::int32_t point = fine.layout.point_of[u];
        transfer.inner_up.row.push_back(u);
        for (std::int64_t k = points.start[point]; k < points.start[point + 1]; ++k)
          transfer.inner_up.index.push_back(coarse.layout.unknown_of[points.parent[k]]);
        transfer.inner_up.start.push_back(static_cast<std::int64_t>(transfer.inner_up.index.size()));
      }
      continue;
    }
    run.half_start = static_cast<std::int32_t>(transfer.half_size);
    transfer.half_size += run.coarse_length;
    for (int line = 0; line < run.lines; ++line) {
      const std::int32_t target = coarse.layout.run_of[run.coarse[line]];
      parts[target].push_back({static_cast<std::int32_t>(r), run.coarse[line] - coarse.layout.runs[target].start,
                               1.0f / static_cast<float>(run.lines), line});
    }
  }
  transfer.part_start.push_back(0);
  for (const auto& list : parts) {
    transfer.parts.insert(transfer.parts.end(), list.begin(), list.end());
    transfer.part_start.push_back(static_cast<std::int32_t>(transfer.parts.size()));
  }
  transfer.inner_down = transposed(transfer.inner_up, coarse.layout.size(), true);
  if (transfer.inner_down.start.empty()) transfer.inner_down.start.push_back(0);

  transfer.outer_up.start.push_back(0);
  for (std::int32_t twin : fine.surface.twin) {
    const std::int32_t point = fine.layout.point_of[twin];
    for (std::int64_t k = points.start[point]; k < points.start[point + 1]; ++k)
      transfer.outer_up.index.push_back(coarse_outer_of[coarse.layout.unknown_of[points.parent[k]]]);
    transfer.outer_up.start.push_back(static_cast<std::int64_t>(transfer.outer_up.index.size()));
  }
  transfer.outer_down = transposed(transfer.outer_up, coarse.surface.size(), false);
}

// The corners of the parent that a child's corner takes its value from.
int parent_corners(int octant, int corner) {
  int mask = 0;
  for (int k = 0; k < 8; ++k) {
    bool takes = true;
    for (int axis = 0; axis < 3; ++axis) {
      const int local = (octant >> axis & 1) + (corner >> axis & 1);
      takes = takes && (local == 1 || local == 2 * (k >> axis & 1));
    }
    mask |= takes << k;
  }
  return mask;
}

// Which of the parents have boundary elements, from which of their children have.
void lift_boundary(LevelCells& fine, LevelCells& coarse) {
  std::vector<int> mask(coarse.size(), 0);
  for (std::size_t b = 0; b < fine.boundary.size(); ++b)
    for (int k = 0; k < 8; ++k)
      if (fine.outer_mask[b] >> k & 1)
        mask[fine.parent[fine.boundary[b]]] |= parent_corners(fine.octant[fine.boundary[b]], k);
  std::vector<std::int32_t> place(coarse.size(), -1);
  for (std::size_t c = 0; c < coarse.size(); ++c)
    if (mask[c]) {
      place[c] = static_cast<std::int32_t>(coarse.boundary.size());
      coarse.boundary.push_back(static_cast<std::int32_t>(c));
      coarse.outer_mask.push_back(static_cast<std::uint8_t>(mask[c]));
    }
  for (std::int32_t cell : fine.boundary) fine.boundary_parent.push_back(place[fine.parent[cell]]);
}

// Layer cells, the core cells they cover, and how their corners lie there.
void find_layer(const Polygrid& polygrid, const RunLevel& level, LevelCells& cells, const std::vector<Vec3i>& lattice,
                const std::vector<std::int32_t>& outer_point_twin_unknown, FineGrid& fine) {
  std::unordered_map<std::uint64_t, std::int32_t> cell_at;
  cell_at.reserve(cells.size());
  for (std::size_t c = 0; c < cells.size(); ++c) cell_at.emplace(place_key(lattice[c]), static_cast<std::int32_t>(c));
  struct Layer {
    std::int32_t core, cell;
    std::array<std::uint8_t, 8> node;
  };
  std::vector<Layer> layers;
  for (Eigen::Index c = 0; c < polygrid.cells.rows(); ++c) {
    if (polygrid.cell_layer[c] == 0) continue;
    const auto at = cell_at.find(place_key(polygrid.cell_lattice.row(c).transpose()));
    if (at == cell_at.end()) throw InputError("polygrid: a cell of the thin layer covers no core cell");
    Layer layer{at->second, static_cast<std::int32_t>(c), {}};
    for (int a = 0; a < 8; ++a) {
      const std::int32_t point = polygrid.cells(c, a), twin = polygrid.outer_twin[point];
      const std::int32_t unknown = twin >= 0 ? outer_point_twin_unknown[point] : level.layout.unknown_of[point];
      int corner = 0;
      while (corner < 8 && cells.corners[8 * layer.core + corner] != unknown) ++corner;
      if (corner == 8) throw InputError("polygrid: a cell of the thin layer does not fit the core cell it covers");
      layer.node[a] = static_cast<std::uint8_t>(corner + (twin >= 0 ? 8 : 0));
    }
    layers.push_back(layer);
  }
  std::sort(layers.begin(), layers.end(),
            [](const Layer& a, const Layer& b) { return a.core != b.core ? a.core < b.core : a.cell < b.cell; });
  for (const Layer& layer : layers) {
    if (cells.boundary.empty() || cells.boundary.back() != layer.core) {
      cells.boundary.push_back(layer.core);
      cells.outer_mask.push_back(0);
    }
    for (std::uint8_t node : layer.node)
      if (node >= 8) cells.outer_mask.back() |= static_cast<std::uint8_t>(1 << (node - 8));
    fine.layer_cell.push_back(layer.cell);
    fine.layer_boundary.push_back(static_cast<std::int32_t>(cells.boundary.size() - 1));
    fine.layer_node.push_back(layer.node);
  }
}

void find_cell_runs(const RunLevel& level, const LevelCells& cells, const std::vector<Vec3i>& lattice, FineGrid& fine) {
  std::vector<int> slab_of_run;
  for (std::size_t c = 0; c < cells.size(); ++c) {
    const std::int32_t* corner = cells.corners.data() + 8 * c;
    bool follows = false;
    const bool alone = level.layout.irregular[c] != 0;
    bool straight = !alone;
    for (int k = 0; k < 8; k += 2) straight = straight && corner[k + 1] == corner[k] + 1;
    if (!fine.runs.empty() && straight) {
      const FineCellRun& run = fine.runs.back();
      follows = run.regular && lattice[c] == lattice[c - 1] + Vec3i::UnitX() && run.length < (1 << 14);
      for (int k = 0; k < 4; ++k) follows = follows && corner[2 * k] == run.unknown[k] + run.length;
      if (follows && !cells.parent.empty())
        follows = cells.parent[c] == cells.parent[run.first] + (lattice[c].x() >> 1) - (run.x >> 1);
    }
    if (follows) {
      ++fine.runs.back().length;
      continue;
    }
    fine.runs.push_back(
        {static_cast<std::int32_t>(c), 1, {corner[0], corner[2], corner[4], corner[6]}, lattice[c].x(), straight});
    slab_of_run.push_back(lattice[c].z());
  }
  fine.slab_start = slabs(fine.runs.size(), [&](std::size_t r) { return slab_of_run[r]; });
}

void finish_cells(RunLevel& level, const std::vector<Vec3i>& lattice) {
  LevelCells& cells = level.cells;
  cells.slab_start = slabs(cells.size(), [&](std::size_t c) { return lattice[c].z(); });
  cells.boundary_slab_start =
      slabs(cells.boundary.size(), [&](std::size_t b) { return lattice[cells.boundary[b]].z(); });
}

void check_hierarchy_order(const std::vector<Vec3i>& lattice) {
  for (std::size_t c = 1; c < lattice.size(); ++c)
    if (place_key(lattice[c]) < place_key(lattice[c - 1]))
      throw InputError("polygrid: its hierarchy's cells are not in lattice order; build the polygrid anew");
}

// The polygrid's own cells and points and those of its coarser levels, which leave `transfers`.
std::vector<GridLevel> grid_levels(const Polygrid& polygrid, std::vector<PointTransfer>& transfers,
                                   std::vector<std::int32_t>& core_cell) {
  std::vector<GridLevel> levels(transfers.size() + 1);
  GridLevel& finest = levels[0];
  std::vector<std::pair<std::uint64_t, std::int32_t>> order;  // key, number among core cells
  std::vector<std::int32_t> core;
  for (Eigen::Index c = 0; c < polygrid.cells.rows(); ++c)
    if (polygrid.cell_layer[c] == 0) {
      order.emplace_back(place_key(polygrid.cell_lattice.row(c).transpose()), static_cast<std::int32_t>(core.size()));
      core.push_back(static_cast<std::int32_t>(c));
    }
  if (core.empty()) throw InputError("polygrid: it has no core cells");
  std::sort(order.begin(), order.end());
  for (const auto& [key, number] : order) {
    const std::int32_t cell = core[number];
    core_cell.push_back(cell);
    finest.cell_lattice.push_back(polygrid.cell_lattice.row(cell).transpose());
    for (int k = 0; k < 8; ++k) finest.corners.push_back(polygrid.cells(cell, vtk_corner[k]));
    if (!transfers.empty()) finest.parent.push_back(transfers[0].cell_parent[number]);
  }
  finest.lattice.resize(polygrid.points.rows());
  for (std::size_t p = 0; p < finest.lattice.size(); ++p) finest.lattice[p] = polygrid.point_lattice.row(p).transpose();
  std::vector<char> inner(finest.lattice.size()), in_core(finest.lattice.size(), 0);
  finest.at_surface.assign(finest.lattice.size(), 0);
  for (std::size_t p = 0; p < inner.size(); ++p) {
    const std::int32_t twin = polygrid.outer_twin[p];
    inner[p] = twin < 0;
    if (inner[p]) continue;
    if (polygrid.outer_twin[twin] >= 0 || finest.at_surface[twin])
      throw InputError("polygrid: an outer point's twin is outer itself, or has two outer points");
    finest.at_surface[twin] = 1;
  }
  for (std::int32_t p : finest.corners) {
    if (!inner[p]) throw InputError("polygrid: an outer point belongs to a core cell");
    in_core[p] = 1;
  }
  for (std::size_t p = 0; p < inner.size(); ++p)
    if (inner[p] && !in_core[p])
      throw InputError("polygrid: a point belongs to no core cell, or an outer point's twin is outer itself");

  for (std::size_t l = 0; l < transfers.size(); ++l) {
    PointTransfer& next = transfers[l];
    GridLevel& coarse = levels[l + 1];
    coarse.lattice = std::move(next.coarse_lattice);
    coarse.corners = std::move(next.coarse_corners);
    coarse.cell_lattice = std::move(next.coarse_cell_lattice);
    if (l + 1 < transfers.size()) coarse.parent = transfers[l + 1].cell_parent;
    check_hierarchy_order(coarse.cell_lattice);
    coarse.at_surface.assign(coarse.lattice.size(), 0);
    for (std::size_t p = 0; p < levels[l].lattice.size(); ++p)
      if (levels[l].at_surface[p])
        for (std::int64_t k = next.start[p]; k < next.start[p + 1]; ++k) coarse.at_surface[next.parent[k]] = 1;
  }
  return levels;
}

// The leaves of one level as a level of their own, and the deep cells that say what they are made of.
DeepPart lay_out_deep(const GridLevel& grid, const CompositeLevel& composite, const RunLevel& level,
                      const std::vector<std::int32_t>& kept_number, const std::vector<std::int32_t>& finer_number,
                      std::vector<std::int32_t>& deep_number) {
  DeepPart deep;
  deep_number.assign(grid.cells(), -1);
  std::vector<std::int32_t> corners;
  std::vector<Vec3i> cell_lattice;
  std::vector<char> takes_part(grid.lattice.size(), 0);
  for (std::size_t c = 0; c < grid.cells(); ++c) {
    if (composite.deep.empty() || !composite.deep[c]) continue;
    deep_number[c] = static_cast<std::int32_t>(deep.child.size());
    deep.child.push_back(composite.child[c]);
    for (std::int32_t& child : deep.child.back()) child = finer_number[child];
    if (composite.covered[c]) continue;
    deep.deep_cell.push_back(deep_number[c]);
    deep.level_cell.push_back(kept_number[c]);
    cell_lattice.push_back(grid.cell_lattice[c]);
    for (int k = 0; k < 8; ++k) {
      corners.push_back(grid.corners[8 * c + k]);
      takes_part[corners.back()] = 1;
    }
  }
  if (deep.empty()) return deep;
  RunLevel& part = deep.part;
  part.layout = lay_out_runs(grid.lattice, takes_part, corners);
  for (std::int32_t p : corners) part.cells.corners.push_back(part.layout.unknown_of[p]);
  part.cells.octant.resize(cell_lattice.size());
  part.surface.start.assign(1, 0);
  part.surface.first_of_run.assign(part.layout.runs.size() + 1, 0);
  finish_cells(part, cell_lattice);
  deep.beside.assign(part.layout.size(), {-1, -1, -1, -1});
  for (std::size_t r = 0; r < part.layout.runs.size(); ++r)
    for (std::int64_t k = part.layout.link_start[r]; k < part.layout.link_start[r + 1]; ++k) {
      const RunLink& link = part.layout.links[k];
      const FollowingLine line = following_lines[link.line];
      if (std::abs(line.dy) + std::abs(line.dz) != 1) continue;
      for (std::int32_t u = part.layout.runs[r].start + link.begin[1]; u < part.layout.runs[r].start + link.end[1]; ++u)
        deep.beside[u][2 * line.dz + link.follows] = u + link.shift;
    }
  deep.position = ChannelPlanes<float>(part.layout.size());
  for (std::size_t u = 0; u < part.layout.size(); ++u) {
    const std::int32_t point = part.layout.point_of[u];
    deep.unknown.push_back(level.layout.unknown_of[point]);
    for (int axis = 0; axis < 3; ++axis) deep.position[axis][u] = composite.position[point][axis];
  }
  for (LevelVector<float>* vector : {&part.x, &part.before, &part.right_side, &part.reaction})
    *vector = LevelVector<float>(part.layout.size(), 0);
  return deep;
}

// The points in covered cells that no leaf has; on the finest level all points there that are no unknowns.
InterpolatedPoints find_interpolated(const GridLevel& grid, const CompositeLevel& composite, const RunLevel& level,
                                     const DeepPart* deep, const PointTransfer& transfer,
                                     std::vector<std::pair<std::int32_t, std::int32_t>>& coincident) {
  InterpolatedPoints result;
  result.start.push_back(0);
  std::vector<char> covered(grid.lattice.size(), 0);
  for (std::size_t c = 0; c < grid.cells(); ++c)
    if (composite.covered[c])
      for (int k = 0; k < 8; ++k) covered[grid.corners[8 * c + k]] = 1;
  for (std::size_t p = 0; p < covered.size(); ++p) {
    if (!covered[p]) continue;
    if (transfer.start[p + 1] - transfer.start[p] == 1)
      coincident.emplace_back(static_cast<std::int32_t>(p), transfer.parent[transfer.start[p]]);
    if (deep ? !deep->empty() && deep->part.layout.unknown_of[p] >= 0 : level.layout.unknown_of[p] >= 0) continue;
    result.point.push_back(static_cast<std::int32_t>(p));
    result.parent.insert(result.parent.end(), transfer.parent.begin() + transfer.start[p],
                         transfer.parent.begin() + transfer.start[p + 1]);
    result.start.push_back(static_cast<std::int64_t>(result.parent.size()));
  }
  return result;
}

}  // namespace

LevelHierarchy build_levels(const Polygrid& polygrid, std::size_t coarsest, int depth) {
  std::vector<PointTransfer> transfers = point_transfers(polygrid);
  LevelHierarchy result;
  FineGrid& fine = result.fine;
  std::vector<RunLevel>& levels = result.levels;
  levels.reserve(transfers.size() + 1);
  std::vector<std::int32_t> core_cell;
  const std::vector<GridLevel> grids = grid_levels(polygrid, transfers, core_cell);
  fine.origin = 0.5 * (polygrid.points.colwise().minCoeff() + polygrid.points.colwise().maxCoeff()).transpose();
  std::vector<Eigen::Vector3f> position(polygrid.points.rows());
  for (std::size_t p = 0; p < position.size(); ++p)
    position[p] = (polygrid.points.row(static_cast<Eigen::Index>(p)).transpose() - fine.origin).cast<float>();
  const std::vector<CompositeLevel> composite =
      choose_deep_cells(grids, transfers, std::move(position), depth, coarsest);

  std::vector<std::int32_t> deep_number = core_cell, finer_number;
  std::vector<std::vector<std::int32_t>> kept_number(grids.size());
  for (std::size_t l = 0; l < grids.size(); ++l) {
    kept_number[l].assign(grids[l].cells(), -1);
    std::int32_t next = 0;
    for (std::size_t c = 0; c < grids[l].cells(); ++c)
      if (!composite[l].covered[c]) kept_number[l][c] = next++;
  }
  for (std::size_t l = 0;; ++l) {
    const GridLevel& grid = grids[l];
    levels.emplace_back();
    RunLevel& level = levels.back();
    LevelCells& cells = level.cells;
    std::vector<char> takes_part(grid.lattice.size(), 0), near_leaf(grid.lattice.size(), 0);
    std::vector<std::int32_t> corners;
    std::vector<Vec3i> cell_lattice;
    for (std::size_t c = 0; c < grid.cells(); ++c) {
      const std::int32_t* own = grid.corners.data() + 8 * c;
      if (composite[l].covered[c]) {
        for (int k = 0; k < 8; ++k) near_leaf[own[k]] = 1;
        continue;
      }
      for (int k = 0; k < 8; ++k) takes_part[own[k]] = 1;
      corners.insert(corners.end(), own, own + 8);
      const Vec3i& at = grid.cell_lattice[c];
      cell_lattice.push_back(at);
      if (!grid.parent.empty()) cells.parent.push_back(kept_number[l + 1][grid.parent[c]]);
      cells.octant.push_back(static_cast<std::uint8_t>((at.x() & 1) | (at.y() & 1) << 1 | (at.z() & 1) << 2));
      if (l == 0) fine.cell.push_back(core_cell[c]);
    }
    level.layout = lay_out_runs(grid.lattice, takes_part, corners);
    std::vector<std::int32_t> outer_of;
    lay_out_outer(grid.at_surface, level, outer_of);
    cells.corners.resize(corners.size());
    for (std::size_t k = 0; k < corners.size(); ++k) cells.corners[k] = level.layout.unknown_of[corners[k]];
    for (std::size_t u = 0; u < level.layout.size(); ++u)
      if (near_leaf[level.layout.point_of[u]]) level.frozen.push_back(static_cast<std::int32_t>(u));
    result.deep.emplace_back();
    result.points.push_back(grid.lattice.size());
    if (l == 0) {
      std::vector<std::int32_t> twin_unknown(grid.lattice.size(), -1);
      fine.outer_point.resize(level.surface.size());
      for (std::size_t p = 0; p < grid.lattice.size(); ++p)
        if (polygrid.outer_twin[p] >= 0) {
          twin_unknown[p] = level.layout.unknown_of[polygrid.outer_twin[p]];
          fine.outer_point[outer_of[twin_unknown[p]]] = static_cast<std::int32_t>(p);
        }
      find_layer(polygrid, level, cells, cell_lattice, twin_unknown, fine);
      find_cell_runs(level, cells, cell_lattice, fine);
      fine.position = ChannelPlanes<float>(level.layout.size());
      for (std::size_t u = 0; u < level.layout.size(); ++u)
        for (int axis = 0; axis < 3; ++axis)
          fine.position[axis][u] = composite[0].position[level.layout.point_of[u]][axis];
    } else {
      lift_boundary(levels[l - 1].cells, cells);
      build_transfer(levels[l - 1], level, transfers[l - 1], outer_of);
      finer_number = std::move(deep_number);
      result.deep[l] = lay_out_deep(grid, composite[l], level, kept_number[l], finer_number, deep_number);
    }
    connect_surface(level, outer_of);
    finish_cells(level, cell_lattice);
    result.interpolated.emplace_back();
    result.coincident.emplace_back();
    if (l < transfers.size())
      result.interpolated[l] = find_interpolated(grid, composite[l], level, l > 0 ? &result.deep[l] : nullptr,
                                                 transfers[l], result.coincident[l]);
    if (l == transfers.size() || level.size() + result.interpolated[l].point.size() <= coarsest) break;
    if (grids[l + 1].lattice.size() * 10 > grid.lattice.size() * 9) break;
  }
  result.skipped = result.interpolated[0].point.size();
  levels.back().cells.parent.clear();
  for (RunLevel& level : levels) {
    level.layout.point_of.shrink_to_fit();
    for (LevelVector<float>* vector : {&level.x, &level.before, &level.right_side, &level.reaction})
      *vector = LevelVector<float>(level.layout.size(), level.surface.size());
    level.halved = ChannelPlanes<float>(static_cast<std::size_t>(level.transfer.half_size));
    level.inverse = ChannelPlanes<UpperHalf>(level.layout.size());
  }
  return result;
}

}  // namespace shellgrid
