// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/polygrid_hierarchy.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <string>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/polycube/laplacian_weights.h"
#include "meshing/polycube/polygrid.h"

namespace shellgrid {
namespace {

// Corners in lattice order (bit k of the number: towards + axis k) as VTK_HEXAHEDRON numbers them.
constexpr int vtk_corner[8] = {0, 1, 3, 2, 4, 5, 7, 6};
constexpr std::int32_t farthest = 1 << 20;  // lattice coordinate: three fit into 64 bits
constexpr std::size_t smallest_level = 8;

// Disjoint sets whose representative is the least member.
class DisjointSets {
 public:
  explicit DisjointSets(std::size_t count) : parent_(count) { std::iota(parent_.begin(), parent_.end(), 0); }
  std::int32_t find(std::int32_t i) {
    while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
    return i;
  }
  void unite(std::int32_t a, std::int32_t b) {
    a = find(a), b = find(b);
    if (a < b)
      parent_[b] = a;
    else
      parent_[a] = b;
  }

 private:
  std::vector<std::int32_t> parent_;
};

Vec3i half(const Vec3i& place) { return {place.x() >> 1, place.y() >> 1, place.z() >> 1}; }

Vec3i corner_place(const Vec3i& cell, int corner) { return cell + Vec3i(corner & 1, corner >> 1 & 1, corner >> 2); }

// Ascends in (z, y, x).
std::uint64_t place_key(const Vec3i& place) {
  const auto part = [](int x) { return static_cast<std::uint64_t>(x + farthest) & ((std::uint64_t{1} << 21) - 1); };
  return part(place.z()) << 42 | part(place.y()) << 21 | part(place.x());
}

// Numbers the sets by their places, then their representatives. Returns each member's number.
template <class Place>
std::vector<std::int32_t> number_sets(DisjointSets& sets, std::size_t count, const Place& place_of,
                                      std::vector<Vec3i>& places) {
  std::vector<std::pair<std::uint64_t, std::int32_t>> order;
  for (std::size_t i = 0; i < count; ++i)
    if (sets.find(static_cast<std::int32_t>(i)) == static_cast<std::int32_t>(i))
      order.emplace_back(place_key(place_of(i)), static_cast<std::int32_t>(i));
  std::sort(order.begin(), order.end());
  std::vector<std::int32_t> number(count);
  places.resize(order.size());
  for (std::size_t n = 0; n < order.size(); ++n) {
    number[order[n].second] = static_cast<std::int32_t>(n);
    places[n] = place_of(order[n].second);
  }
  // Representatives come before their members.
  for (std::size_t i = 0; i < count; ++i) number[i] = number[sets.find(static_cast<std::int32_t>(i))];
  return number;
}

// The contacts between the parents of a level's cells, by lower cell, axis and upper cell.
void coarsen_contacts(const CellLevel& fine, const std::vector<std::int32_t>& parent, CellLevel& coarse) {
  std::vector<std::int64_t> start(coarse.lattice.size() + 1, 0);
  for (const CellLevel::Contact& c : fine.contacts)
    if (parent[c.lower] != parent[c.upper]) ++start[parent[c.lower] + 1];
  std::partial_sum(start.begin(), start.end(), start.begin());
  std::vector<CellLevel::Contact> all(start.back());
  std::vector<std::int64_t> next(start.begin(), start.end() - 1);
  for (const CellLevel::Contact& c : fine.contacts)
    if (parent[c.lower] != parent[c.upper])
      all[next[parent[c.lower]]++] = {parent[c.lower], parent[c.upper], c.axis, c.faces};
  coarse.contacts.clear();
  for (std::size_t cell = 0; cell < coarse.lattice.size(); ++cell) {
    const auto first = all.begin() + start[cell], last = all.begin() + start[cell + 1];
    std::sort(first, last, [](const CellLevel::Contact& a, const CellLevel::Contact& b) {
      return a.axis != b.axis ? a.axis < b.axis : a.upper < b.upper;
    });
    for (auto at = first; at != last; ++at)
      if (at != first && (at - 1)->axis == at->axis && (at - 1)->upper == at->upper)
        coarse.contacts.back().faces += at->faces;
      else
        coarse.contacts.push_back(*at);
  }
}

bool goes_on(std::size_t fine, std::size_t coarse) { return coarse > 0 && coarse * 10 <= fine * 9; }

// The corners of a coarse level's cells as points: 8 a cell. Returns the points' number and places.
std::vector<std::int32_t> corner_points(const CellLevel& cells, std::vector<Vec3i>& places) {
  const std::size_t count = 8 * cells.lattice.size();
  DisjointSets sets(count);
  for (const CellLevel::Contact& c : cells.contacts)
    for (int k = 0; k < 8; ++k)
      if ((k >> c.axis & 1) == 0) sets.unite(8 * c.lower + (k | 1 << c.axis), 8 * c.upper + k);
  return number_sets(
      sets, count, [&](std::size_t i) { return corner_place(cells.lattice[i / 8], static_cast<int>(i % 8)); }, places);
}

PointTransfer transfer_points(const CellLevel& fine, const std::vector<std::int32_t>& fine_corners,
                              std::size_t fine_points, const CellLevel& coarse,
                              const std::vector<std::int32_t>& coarse_corners,
                              const std::vector<std::int32_t>& parent) {
  // One of the cells around each point, and which of its corners the point is.
  std::vector<std::int32_t> corner_of(fine_points, -1);
  for (std::size_t i = fine_corners.size(); i-- > 0;) corner_of[fine_corners[i]] = static_cast<std::int32_t>(i);
  // Place in the parent in halves of its edge.
  const auto local_place = [&](std::int32_t corner) -> Vec3i {
    const std::int32_t cell = corner / 8;
    return corner_place(fine.lattice[cell], corner % 8) - 2 * coarse.lattice[parent[cell]];
  };
  PointTransfer transfer;
  transfer.start.assign(fine_points + 1, 0);
  for (std::size_t p = 0; p < fine_points; ++p) {
    int count = 0;
    if (corner_of[p] >= 0) {
      const Vec3i local = local_place(corner_of[p]);
      count = 1 << ((local.x() & 1) + (local.y() & 1) + (local.z() & 1));
    }
    transfer.start[p + 1] = transfer.start[p] + count;
  }
  transfer.parent.resize(transfer.start.back());
  parallel_for(
      fine_points,
      [&](std::size_t p) {
        if (corner_of[p] < 0) return;
        const Vec3i local = local_place(corner_of[p]);
        std::int64_t at = transfer.start[p];
        for (int k = 0; k < 8; ++k) {
          bool takes = true;
          for (int axis = 0; axis < 3; ++axis)
            takes = takes && (local[axis] == 1 || local[axis] == 2 * (k >> axis & 1));
          if (takes) transfer.parent[at++] = coarse_corners[8 * parent[corner_of[p] / 8] + k];
        }
      },
      2048);
  return transfer;
}

void check_parents(const CellLevel& fine, const PolygridLevel& level) {
  const auto fail = [] {
    throw InputError("polygrid: its hierarchy does not match its cells; build the polygrid anew");
  };
  if (level.parent.size() != fine.lattice.size()) fail();
  for (std::size_t i = 0; i < level.parent.size(); ++i) {
    if (level.parent[i] < 0 || level.parent[i] >= level.lattice.rows()) fail();
    if (level.lattice.row(level.parent[i]).transpose() != half(fine.lattice[i])) fail();
  }
}

PolygridLevel coarsen_graph(const PolygridGraph& fine, const CellLevel& coarse, std::vector<std::int32_t> parent,
                            double spacing, double condition_limit) {
  PolygridLevel level;
  PolygridGraph& graph = level.graph;
  const std::size_t nodes = coarse.lattice.size();
  level.parent = std::move(parent);
  level.lattice.resize(static_cast<Eigen::Index>(nodes), 3);
  for (std::size_t i = 0; i < nodes; ++i) level.lattice.row(i) = coarse.lattice[i].transpose();

  const auto average_rows = [](const std::vector<std::int32_t>& of, std::size_t count, const VertexMatrix& rows) {
    VertexMatrix sum = VertexMatrix::Zero(static_cast<Eigen::Index>(count), 3);
    std::vector<int> children(count, 0);
    for (std::size_t i = 0; i < of.size(); ++i)
      if (of[i] >= 0) sum.row(of[i]) += rows.row(i), ++children[of[i]];
    for (std::size_t i = 0; i < count; ++i) sum.row(i) /= std::max(1, children[i]);
    return sum;
  };
  graph.interior = average_rows(level.parent, nodes, fine.interior);

  constexpr std::int32_t none = -2147483647;
  graph.links.setConstant(static_cast<Eigen::Index>(nodes), 6, none);
  std::vector<std::array<std::int32_t, 6>> most(nodes, std::array<std::int32_t, 6>{});
  for (const CellLevel::Contact& c : coarse.contacts) {
    const auto link = [&](std::int32_t from, std::int32_t to, int side) {
      if (c.faces <= most[from][side]) return;
      most[from][side] = c.faces;
      graph.links(from, side) = to;
    };
    link(c.lower, c.upper, 2 * c.axis + 1);
    link(c.upper, c.lower, 2 * c.axis);
  }
  level.boundary_parent.assign(fine.boundary_owner.size(), -1);
  std::int32_t boundary = 0;
  for (Eigen::Index i = 0; i < fine.links.rows(); ++i)
    for (int side = 0; side < 6; ++side) {
      if (fine.links(i, side) >= 0) continue;
      std::int32_t& link = graph.links(level.parent[i], side);
      if (link >= 0) continue;
      if (link == none) {
        link = -1 - boundary++;
        graph.boundary_owner.push_back(level.parent[i]);
      }
      level.boundary_parent[-1 - fine.links(i, side)] = -1 - link;
    }
  if ((graph.links.array() == none).any()) throw InternalError("polygrid: a coarse node has a side without a link");
  graph.boundary = average_rows(level.boundary_parent, boundary, fine.boundary);
  graph.boundary_normal = average_rows(level.boundary_parent, boundary, fine.boundary_normal);
  for (std::int32_t b = 0; b < boundary; ++b) {
    graph.boundary_normal.row(b) = graph.boundary_normal.row(b).stableNormalized().eval();
    graph.boundary_distance.push_back((graph.boundary.row(b) - graph.interior.row(graph.boundary_owner[b])).norm());
  }

  weigh_links(graph, spacing, condition_limit);
  return level;
}

}  // namespace

CellLevel finest_cells(const Polygrid& polygrid) {
  CellLevel level;
  std::vector<Eigen::Index> cells;
  for (Eigen::Index c = 0; c < polygrid.cells.rows(); ++c)
    if (polygrid.cell_layer[c] == 0) cells.push_back(c);
  if (polygrid.cell_lattice.rows() != polygrid.cells.rows())
    throw InputError("polygrid: its cells' lattice places are missing");
  if (!cells.empty() &&
      (polygrid.cell_lattice.minCoeff() < -farthest / 2 || polygrid.cell_lattice.maxCoeff() > farthest / 2))
    throw InputError("polygrid: a lattice coordinate is out of range");
  level.lattice.resize(cells.size());
  // The cell whose lower corner a point is.
  std::vector<std::int32_t> cell_above(polygrid.points.rows(), -1);
  for (std::size_t i = 0; i < cells.size(); ++i) {
    level.lattice[i] = polygrid.cell_lattice.row(cells[i]).transpose();
    cell_above[polygrid.cells(cells[i], 0)] = static_cast<std::int32_t>(i);
  }
  level.contacts.reserve(3 * cells.size());
  for (std::size_t i = 0; i < cells.size(); ++i)
    for (int axis = 0; axis < 3; ++axis) {
      const std::int32_t j = cell_above[polygrid.cells(cells[i], vtk_corner[1 << axis])];
      if (j < 0) continue;
      bool shared = level.lattice[j] == level.lattice[i] + Vec3i::Unit(axis);
      for (int k = 0; k < 8; ++k)
        if ((k >> axis & 1) == 0)
          shared =
              shared && polygrid.cells(cells[i], vtk_corner[k | 1 << axis]) == polygrid.cells(cells[j], vtk_corner[k]);
      if (!shared) throw InputError("polygrid: its cells do not fit together on the lattice");
      level.contacts.push_back({static_cast<std::int32_t>(i), j, axis, 1});
    }
  return level;
}

std::vector<std::int32_t> coarsen_cells(const CellLevel& fine, CellLevel& coarse) {
  DisjointSets sets(fine.lattice.size());
  for (const CellLevel::Contact& c : fine.contacts)
    // Neighbours along an axis are in one window where the lower one is even.
    if ((fine.lattice[c.lower][c.axis] & 1) == 0) sets.unite(c.lower, c.upper);
  const std::vector<std::int32_t> parent = number_sets(
      sets, fine.lattice.size(), [&](std::size_t i) { return half(fine.lattice[i]); }, coarse.lattice);
  coarsen_contacts(fine, parent, coarse);
  return parent;
}

std::vector<PolygridLevel> build_hierarchy(const Polygrid& polygrid, double condition_limit) {
  CellLevel cells = finest_cells(polygrid);
  if (static_cast<std::size_t>(polygrid.graph.interior.rows()) != cells.lattice.size())
    throw InputError("polygrid: its graph does not match its cells");
  std::vector<PolygridLevel> levels;
  double spacing = polygrid.spacing;
  while (cells.lattice.size() > smallest_level) {
    CellLevel coarse;
    std::vector<std::int32_t> parent = coarsen_cells(cells, coarse);
    if (!goes_on(cells.lattice.size(), coarse.lattice.size())) break;
    spacing *= 2;
    levels.push_back(coarsen_graph(levels.empty() ? polygrid.graph : levels.back().graph, coarse, std::move(parent),
                                   spacing, condition_limit));
    cells = std::move(coarse);
  }
  return levels;
}

std::vector<PointTransfer> point_transfers(const Polygrid& polygrid) {
  CellLevel fine = finest_cells(polygrid);
  std::vector<std::int32_t> fine_corners;
  fine_corners.reserve(8 * fine.lattice.size());
  for (Eigen::Index c = 0; c < polygrid.cells.rows(); ++c)
    if (polygrid.cell_layer[c] == 0)
      for (int k = 0; k < 8; ++k) fine_corners.push_back(polygrid.cells(c, vtk_corner[k]));
  std::size_t fine_points = static_cast<std::size_t>(polygrid.points.rows());
  std::vector<PointTransfer> transfers;
  for (std::size_t l = 0; polygrid.hierarchy.empty() || l < polygrid.hierarchy.size(); ++l) {
    CellLevel coarse;
    std::vector<std::int32_t> parent;
    if (polygrid.hierarchy.empty()) {
      if (fine.lattice.size() <= smallest_level) break;
      parent = coarsen_cells(fine, coarse);
      if (!goes_on(fine.lattice.size(), coarse.lattice.size())) break;
    } else {
      const PolygridLevel& level = polygrid.hierarchy[l];
      check_parents(fine, level);
      parent = level.parent;
      coarse.lattice.resize(level.lattice.rows());
      for (std::size_t i = 0; i < coarse.lattice.size(); ++i) coarse.lattice[i] = level.lattice.row(i).transpose();
      coarsen_contacts(fine, parent, coarse);
    }
    std::vector<Vec3i> places;
    std::vector<std::int32_t> coarse_corners = corner_points(coarse, places);
    transfers.push_back(transfer_points(fine, fine_corners, fine_points, coarse, coarse_corners, parent));
    transfers.back().coarse_lattice = places;
    transfers.back().cell_parent = std::move(parent);
    transfers.back().coarse_cell_lattice = coarse.lattice;
    transfers.back().coarse_corners = coarse_corners;
    fine = std::move(coarse);
    fine_corners = std::move(coarse_corners);
    fine_points = places.size();
  }
  return transfers;
}

AttributedMesh level_view(const Polygrid& polygrid, int level) {
  if (level < 1 || level > static_cast<int>(polygrid.hierarchy.size()))
    throw InputError("polygrid: there is no level " + std::to_string(level) + "; it has 1 to " +
                     std::to_string(polygrid.hierarchy.size()));
  const PolygridLevel& shown = polygrid.hierarchy[level - 1];
  const Eigen::Index nodes = shown.graph.interior.rows();
  std::vector<float> count(nodes, 0.0f);
  for (std::int32_t parent : shown.parent) count[parent] += 1;
  const double radius = 0.3 * polygrid.spacing * std::exp2(level);
  AttributedMesh view;
  view.mesh.vertices.resize(6 * nodes, 3);
  view.mesh.faces.resize(8 * nodes, 3);
  std::vector<float> quality(6 * nodes), red(6 * nodes), green(6 * nodes), blue(6 * nodes);
  for (Eigen::Index i = 0; i < nodes; ++i) {
    for (int side = 0; side < 6; ++side) {
      const Vec3 step = (side & 1 ? radius : -radius) * Vec3::Unit(side / 2);
      view.mesh.vertices.row(6 * i + side) = shown.graph.interior.row(i) + step.transpose();
      const float share = std::min(1.0f, count[i] / 8);
      quality[6 * i + side] = count[i];
      red[6 * i + side] = 255 * std::min(1.0f, 2 - 2 * share);
      green[6 * i + side] = 255 * std::min(1.0f, 2 * share);
      blue[6 * i + side] = 40;
    }
    for (int k = 0; k < 8; ++k) {
      const int x = 6 * static_cast<int>(i) + (k & 1), y = 6 * static_cast<int>(i) + 2 + (k >> 1 & 1);
      const int z = 6 * static_cast<int>(i) + 4 + (k >> 2);
      const bool turned = ((k & 1) + (k >> 1 & 1) + (k >> 2)) % 2 == 0;
      view.mesh.faces.row(8 * i + k) << x, (turned ? z : y), (turned ? y : z);
    }
  }
  view.properties = {
      {"quality", std::move(quality)}, {"red", std::move(red)}, {"green", std::move(green)}, {"blue", std::move(blue)}};
  return view;
}

}  // namespace shellgrid
