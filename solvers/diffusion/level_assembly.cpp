// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/level_assembly.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "solvers/diffusion/box_transfer.h"
#include "solvers/diffusion/element_lanes.h"
#include "solvers/diffusion/polygrid_system.h"
#include "solvers/diffusion/trilinear_cell.h"

namespace shellgrid {
namespace {

// Bytes of single-precision couplings that are kept for the next material though nothing else needs them.
constexpr std::size_t largest_kept = std::size_t{1} << 30;

// Calls body(begin, end) for each slab's items: even slabs at once, then odd ones, so that neighbours never meet.
template <class Body>
void for_slabs(const std::vector<std::int32_t>& start, const Body& body) {
  const std::size_t slabs = start.empty() ? 0 : start.size() - 1;
  for (std::size_t parity = 0; parity < 2; ++parity)
    parallel_for((slabs + 1 - parity) / 2,
                 [&](std::size_t k) {
                   const std::size_t slab = 2 * k + parity;
                   if (start[slab] < start[slab + 1]) body(start[slab], start[slab + 1]);
                 },
                 1);
}

// Couplings of the cells of one level while their parents' add up: 84 planes, 28 of each channel.
struct CellElements {
  std::size_t cells = 0;
  StreamBuffer<float> planes;
  std::vector<BoundaryElement> boundary;

  CellElements() = default;
  explicit CellElements(const LevelCells& level)
      : cells(level.size()), planes(84 * (level.size() + 16)), boundary(level.boundary.size()) {}
  float* plane(int k) { return planes.data() + static_cast<std::size_t>(k) * (cells + 16); }
  const float* plane(int k) const { return planes.data() + static_cast<std::size_t>(k) * (cells + 16); }
};

// Where the extras of irregular cells stand; −1 for a coupling that has its slot.
std::int32_t extra_of(const RunLayout& layout, std::int32_t a, std::int32_t b) {
  const auto at = std::lower_bound(layout.extras.begin(), layout.extras.end(), ExtraCoupling{a, b},
                                   [](const ExtraCoupling& x, const ExtraCoupling& y) {
                                     return x.first != y.first ? x.first < y.first : x.second < y.second;
                                   });
  if (at == layout.extras.end() || at->first != a || at->second != b) return -1;
  return static_cast<std::int32_t>(at - layout.extras.begin());
}

// Adds one coupling of a cell's corners a < b.
template <class Value>
void add_coupling(RunLevel& level, std::size_t cell, int a, int b, const Value& value) {
  const std::int32_t* corners = level.cells.corners.data() + 8 * cell;
  if (level.layout.irregular[cell]) {
    const std::int32_t extra = extra_of(level.layout, corners[a], corners[b]);
    if (extra >= 0) {
      for (int c = 0; c < 3; ++c) level.extra[extra][c] += value[c];
      return;
    }
  }
  const LatticeRun& run = level.layout.runs[level.layout.run_of[corners[a]]];
  float* at = level.single.values.data() + static_cast<std::int64_t>(coupling_slots) * 3 * run.start +
              (corners[a] - run.start) + static_cast<std::int64_t>(3 * slot_of_pair(a, b)) * run.length;
  for (int c = 0; c < 3; ++c) at[c * run.length] += value[c];
}

// Lanes of one batch, `count` of them, at 16 consecutive cells of the parents or one by one.
void add_to_parents(const ElementLanes& parents, const std::int32_t* parent, int count, CellElements& coarse) {
  for (int k = 0; k < 84; ++k) {
    float* plane = coarse.plane(k);
    const Float16Lanes& value = parents.coupling[k / 28][k % 28];
    for (int i = 0; i < count; ++i) plane[parent[i]] += value[i];
  }
}

// The same where the parents follow each other: lanes 2 i − odd and 2 i + 1 − odd have parent first + i.
void add_to_line_of_parents(const ElementLanes& parents, std::int32_t first, int odd, int count, CellElements& coarse) {
  using Eight = float __attribute__((vector_size(32)));
  const int touched = (count + odd + 1) / 2;
  for (int k = 0; k < 84; ++k) {
    float padded[18] = {};
    Float16Lanes value = parents.coupling[k / 28][k % 28];
    if (count < 16)
      for (int i = count; i < 16; ++i) value[i] = 0;
    store_lanes(padded + odd, value);
    float* to = coarse.plane(k) + first;
    if (touched >= 8) {
      const Float16Lanes both = load_lanes<Float16Lanes>(padded);
      const Eight even = __builtin_shufflevector(both, both, 0, 2, 4, 6, 8, 10, 12, 14);
      const Eight uneven = __builtin_shufflevector(both, both, 1, 3, 5, 7, 9, 11, 13, 15);
      store_lanes(to, load_lanes<Eight>(to) + (even + uneven));
      if (touched > 8) to[8] += padded[16];
    } else {
      for (int i = 0; i < touched; ++i) to[i] += padded[2 * i] + padded[2 * i + 1];
    }
  }
}

// Sixteen fine core cells' geometry and material.
void load_cells(const FineGrid& fine, const CellCoefficients& coefficients, const std::int32_t (&corner)[8],
                const float* const (&plane)[3], std::int32_t first_cell, int count, CellLanes& lanes) {
  for (int a = 0; a < 8; ++a)
    for (int axis = 0; axis < 3; ++axis) lanes.corner[a][axis] = load_lanes<Float16Lanes>(plane[axis] + corner[a]);
  constexpr int vtk_of_corner[8] = {0, 1, 3, 2, 4, 5, 7, 6};
  for (int i = 0; i < 16; ++i) {
    const std::size_t cell = static_cast<std::size_t>(fine.cell[first_cell + std::min(i, count - 1)]);
    for (int q = 0; q < 8; ++q) {
      const Rgb& absorption = coefficients.absorption[8 * cell + vtk_of_corner[q]];
      const Rgb& extinction = coefficients.reduced_extinction[8 * cell + vtk_of_corner[q]];
      for (int c = 0; c < 3; ++c) {
        reinterpret_cast<float*>(&lanes.absorption[c][q])[i] = absorption[c];
        reinterpret_cast<float*>(&lanes.diffusion[c][q])[i] = extinction[c];
      }
    }
  }
  for (int c = 0; c < 3; ++c)
    for (int q = 0; q < 8; ++q) lanes.diffusion[c][q] = 1.0f / (3.0f * lanes.diffusion[c][q]);
}

// The children's part in their parents' elements.
void coarsen(const RunLevel& level, const ElementLanes& element, std::int32_t first, int count, ElementLanes& parent,
             RunLevel* parents) {
  if (!level.transfer.weights) {
    coarsen_elements(element, level.cells.octant.data() + first, count, parent);
    return;
  }
  ParentWeights weights;
  load_parent_weights(level, first, count, weights);
  coarsen_elements(element, weights, parent);
  for (int i = 0; i < count; ++i) {
    const std::int32_t* corner =
        parents->cells.corners.data() + 8 * static_cast<std::size_t>(level.cells.parent[first + i]);
    for (int c = 0; c < 3; ++c)
      for (int p = 0; p < 8; ++p) parents->reaction.inner[c][corner[p]] += parent.absorption[c][p][i];
  }
}

void coarsen_boundary(const RunLevel& level, const BoundaryElement& element, std::int32_t place,
                      std::vector<BoundaryElement>& coarse, RunLevel* parents) {
  const std::int32_t cell = level.cells.boundary[place];
  const std::size_t parent_place = static_cast<std::size_t>(level.cells.boundary_parent[place]);
  BoundaryElement& parent = coarse[parent_place];
  if (!level.transfer.weights) {
    add_coarse_boundary(element, level.cells.octant[cell], parent);
    return;
  }
  std::array<Float4, 16> lost;
  add_coarse_boundary(element, level, cell, parent, lost);
  for (int p = 0; p < 8; ++p) {
    const std::int32_t inner = parents->cells.corners[8 * static_cast<std::size_t>(level.cells.parent[cell]) + p];
    for (int c = 0; c < 3; ++c) parents->reaction.inner[c][inner] += lost[p][c];
    const std::int32_t outer = parents->cells.outer[8 * parent_place + p];
    if (outer >= 0) parents->reaction.outer[outer] += lost[p + 8];
  }
}

void add_line(float* to, const Float16Lanes& value, int count) {
  if (count == 16) {
    store_lanes(to, load_lanes<Float16Lanes>(to) + value);
    return;
  }
  for (int i = 0; i < count; ++i) to[i] += value[i];
}

// Adds the elements to the rows, and to the parents' elements; `rows` false: to the parents' alone.
void assemble_fine_core(const CellCoefficients& coefficients, const FineGrid& fine, RunLevel& level, bool rows,
                        CellElements* coarse, RunLevel* parents) {
  const RunLayout& layout = level.layout;
  const float* const plane[3] = {fine.position[0], fine.position[1], fine.position[2]};
  for_slabs(fine.slab_start, [&](std::int32_t first_run, std::int32_t last_run) {
    CellLanes lanes;
    ElementLanes element, parent;
    for (std::int32_t r = first_run; r < last_run; ++r) {
      const FineCellRun& run = fine.runs[r];
      for (std::int32_t at = 0; at < run.length; at += 16) {
        const int count = std::min(16, run.length - at);
        const std::int32_t first_cell = run.first + at;
        std::int32_t corner[8];
        for (int k = 0; k < 8; ++k)
          corner[k] = run.regular ? run.unknown[k / 2] + at + (k & 1) : level.cells.corners[8 * first_cell + k];
        load_cells(fine, coefficients, corner, plane, first_cell, count, lanes);
        core_elements(lanes, element);
        for (int a = 0; a < 8 && rows; ++a)
          for (int c = 0; c < 3; ++c) add_line(level.reaction.inner[c] + corner[a], element.absorption[c][a], count);
        if (!rows) {
        } else if (run.regular) {
          for (int a = 0; a < 8; ++a) {
            const LatticeRun& points = layout.runs[layout.run_of[corner[a]]];
            float* base = level.single.values.data() + static_cast<std::int64_t>(coupling_slots) * 3 * points.start +
                          (corner[a] - points.start);
            for (int b = a + 1; b < 8; ++b)
              for (int c = 0; c < 3; ++c)
                add_line(base + static_cast<std::int64_t>(3 * slot_of_pair(a, b) + c) * points.length,
                         element.coupling[c][pair_number(a, b)], count);
          }
        } else {
          for (int a = 0; a < 8; ++a)
            for (int b = a + 1; b < 8; ++b) {
              const int k = pair_number(a, b);
              const Float4 value = {element.coupling[0][k][0], element.coupling[1][k][0], element.coupling[2][k][0], 0};
              add_coupling(level, first_cell, a, b, value);
            }
        }
        if (!coarse) continue;
        coarsen(level, element, first_cell, count, parent, parents);
        if (run.regular)
          add_to_line_of_parents(parent, level.cells.parent[first_cell], (run.x + at) & 1, count, *coarse);
        else
          add_to_parents(parent, level.cells.parent.data() + first_cell, count, *coarse);
      }
    }
  });
}

void assemble_coarse_core(const CellElements& elements, RunLevel& level, bool rows, CellElements* coarse,
                          RunLevel* parents) {
  for_slabs(level.cells.slab_start, [&](std::int32_t first, std::int32_t last) {
    ElementLanes element, parent;
    for (std::int32_t cell = first; cell < last; cell += 16) {
      const int count = std::min(16, last - cell);
      for (int k = 0; k < 84; ++k)
        element.coupling[k / 28][k % 28] = load_lanes<Float16Lanes>(elements.plane(k) + cell);
      for (int i = 0; i < count && rows; ++i)
        for (int a = 0; a < 8; ++a)
          for (int b = a + 1; b < 8; ++b) {
            const int k = pair_number(a, b);
            const Float4 value = {element.coupling[0][k][i], element.coupling[1][k][i], element.coupling[2][k][i], 0};
            add_coupling(level, cell + i, a, b, value);
          }
      if (!coarse) continue;
      coarsen(level, element, cell, count, parent, parents);
      add_to_parents(parent, level.cells.parent.data() + cell, count, *coarse);
    }
  });
}

// Memory of the last material's, where it fits.
void clear_couplings(RunLevel& level) {
  const std::size_t size = static_cast<std::size_t>(coupling_slots) * 3 * level.inner_size();
  StreamBuffer<float>& values = level.single.values;
  if (values.size() != size || !values) {
    values = StreamBuffer<float>(size);
  } else {
    parallel_chunks(size, 1 << 18, [&](std::size_t begin, std::size_t end) {
      std::fill(values.data() + begin, values.data() + end, 0.0f);
    });
  }
  level.single.surface.assign(level.surface.neighbour.size(), {});
}

// Means over a deep cell's octants, and what all of its children's 1/D have for a mean.
struct DeepCoefficients {
  std::array<Rgb, 8> diffusion, absorption;
  Rgb resistance;
};

// Of each deep cell of a level, from the polygrid's cells or from the finer level's deep cells.
std::vector<DeepCoefficients> mean_coefficients(const DeepPart& deep, const CellCoefficients& coefficients,
                                                const std::vector<DeepCoefficients>& finer) {
  std::vector<DeepCoefficients> result(deep.child.size());
  parallel_for(
      result.size(),
      [&](std::size_t k) {
        result[k].resistance = Rgb::Zero();
        for (int octant = 0; octant < 8; ++octant) {
          const auto child = static_cast<std::size_t>(deep.child[k][octant]);
          Rgb diffusion = Rgb::Zero(), absorption = Rgb::Zero();
          for (int q = 0; q < 8; ++q)
            if (finer.empty()) {
              const Rgb resistance = 3.0f * coefficients.reduced_extinction[8 * child + q];
              result[k].resistance += resistance / 64.0f;
              diffusion += 1.0f / resistance;
              absorption += coefficients.absorption[8 * child + q];
            } else {
              diffusion += finer[child].diffusion[q];
              absorption += finer[child].absorption[q];
            }
          if (!finer.empty()) result[k].resistance += 0.125f * finer[child].resistance;
          result[k].diffusion[octant] = 0.125f * diffusion;
          result[k].absorption[octant] = 0.125f * absorption;
        }
      },
      256);
  return result;
}

// The elements of the leaves: into those of the level's cells, into the leaves' own couplings, and what they absorb
// into both.
void assemble_deep(const std::vector<DeepCoefficients>& coefficients, DeepPart& deep, RunLevel& level,
                   CellElements& elements) {
  RunLevel& part = deep.part;
  clear_couplings(part);
  part.extra.assign(part.layout.extras.size(), Float4{});
  for (int c = 0; c < 3; ++c) std::fill(part.reaction.inner[c], part.reaction.inner[c] + part.inner_size(), 0.0f);
  for_slabs(part.cells.slab_start, [&](std::int32_t first, std::int32_t last) {
    CellLanes lanes;
    ElementLanes element;
    for (std::int32_t cell = first; cell < last; cell += 16) {
      const int count = std::min(16, last - cell);
      for (int i = 0; i < 16; ++i) {
        const std::int32_t own = cell + std::min(i, count - 1);
        const DeepCoefficients& means = coefficients[deep.deep_cell[own]];
        for (int a = 0; a < 8; ++a) {
          for (int axis = 0; axis < 3; ++axis)
            lanes.corner[a][axis][i] = deep.position[axis][part.cells.corners[8 * own + a]];
          for (int c = 0; c < 3; ++c) {
            lanes.diffusion[c][a][i] = means.diffusion[a][c];
            lanes.absorption[c][a][i] = means.absorption[a][c];
          }
        }
      }
      core_elements(lanes, element);
      for (int i = 0; i < count; ++i) {
        for (int a = 0; a < 8; ++a) {
          const std::int32_t unknown = part.cells.corners[8 * (cell + i) + a];
          for (int c = 0; c < 3; ++c) part.reaction.inner[c][unknown] += element.absorption[c][a][i];
          for (int b = a + 1; b < 8; ++b) {
            const int k = pair_number(a, b);
            add_coupling(part, static_cast<std::size_t>(cell + i), a, b,
                         Float4{element.coupling[0][k][i], element.coupling[1][k][i], element.coupling[2][k][i], 0});
          }
        }
        for (int k = 0; k < 84; ++k) elements.plane(k)[deep.level_cell[cell + i]] = element.coupling[k / 28][k % 28][i];
      }
    }
  });
  deep.spread.assign(deep.deep_cell.size(), Float4{});
  std::vector<float> largest(deep.deep_cell.size(), 0.0f);
  parallel_for(
      deep.spread.size(),
      [&](std::size_t leaf) {
        const DeepCoefficients& means = coefficients[deep.deep_cell[leaf]];
        Rgb diffusion = Rgb::Zero();
        for (const Rgb& octant : means.diffusion) diffusion += 0.125f * octant;
        const Rgb share = (1 - 1 / (diffusion * means.resistance)).max(0.0f);
        float square = 0;
        for (int axis = 0; axis < 3; ++axis) {
          const float* x = deep.position[axis];
          const float diagonal = x[part.cells.corners[8 * leaf + 7]] - x[part.cells.corners[8 * leaf]];
          square += diagonal * diagonal;
        }
        deep.spread[leaf] = to_lanes(Rgb(0.25f * std::sqrt(square / 3) * diffusion * share));
        largest[leaf] = share.maxCoeff();
      },
      1024);
  if (std::none_of(largest.begin(), largest.end(), [](float share) { return share > 1e-4f; })) deep.spread.clear();
  for (std::size_t u = 0; u < deep.unknown.size(); ++u)
    for (int c = 0; c < 3; ++c) level.reaction.inner[c][deep.unknown[u]] += part.reaction.inner[c][u];
}

// Adds a boundary element to the level's rows.
void add_boundary_element(const BoundaryElement& element, std::size_t place, RunLevel& level) {
  const std::int32_t cell = level.cells.boundary[place];
  const std::int32_t* outer = level.cells.outer.data() + 8 * place;
  const int mask = level.cells.outer_mask[place];
  for (int a = 0; a < 8; ++a) {
    if (!(mask >> a & 1)) continue;
    for (int b = a + 1; b < 8; ++b)
      if (mask >> b & 1) add_coupling(level, cell, a, b, element.coupling(a, b));
    const std::int32_t s = outer[a];
    level.link[s] += element.through[a];
    for (int b = 0; b < 8; ++b) {
      if (b == a || !(mask >> b & 1)) continue;
      const auto first = level.surface.neighbour.begin() + level.surface.start[s];
      const auto last = level.surface.neighbour.begin() + level.surface.start[s + 1];
      const auto at = std::lower_bound(first, last, outer[b]) - level.surface.neighbour.begin();
      SurfaceCoupling<float>& pair = level.single.surface[at];
      const Float4 outer_outer = element.coupling(a + 8, b + 8), twin_outer = element.coupling(a, b + 8),
                   outer_twin = element.coupling(a + 8, b);
      for (int c = 0; c < 3; ++c) {
        pair.outer_outer[c] += outer_outer[c];
        pair.twin_outer[c] += twin_outer[c];
        pair.outer_twin[c] += outer_twin[c];
      }
    }
  }
}

// The thin layer's elements, one core cell's at a time.
void assemble_layer(const Polygrid& polygrid, const CellCoefficients& coefficients, const FineGrid& fine,
                    RunLevel& level, bool rows, SurfaceTerms& terms, std::vector<BoundaryElement>* coarse,
                    RunLevel* parents) {
  std::vector<std::int32_t> first(level.cells.boundary.size() + 1, 0);
  for (std::int32_t place : fine.layer_boundary) ++first[place + 1];
  for (std::size_t k = 1; k < first.size(); ++k) first[k] += first[k - 1];
  for_slabs(level.cells.boundary_slab_start, [&](std::int32_t begin, std::int32_t end) {
    for (std::int32_t place = begin; place < end; ++place) {
      BoundaryElement element;
      std::array<Float4, 16> absorption{};
      for (std::int32_t k = first[place]; k < first[place + 1]; ++k) {
        const std::size_t samples = 8 * static_cast<std::size_t>(fine.layer_cell[k]);
        add_layer_cell(cell_corners(polygrid, fine.layer_cell[k]), coefficients.absorption.data() + samples,
                       coefficients.reduced_extinction.data() + samples, fine.layer_node[k], element, absorption);
      }
      const std::int32_t* corners = level.cells.corners.data() + 8 * level.cells.boundary[place];
      for (int a = 0; a < 8 && rows; ++a) {
        if (!(level.cells.outer_mask[place] >> a & 1)) continue;
        for (int c = 0; c < 3; ++c) level.reaction.inner[c][corners[a]] += absorption[a][c];
        terms.absorption[level.cells.outer[8 * place + a]] += absorption[a + 8];
      }
      if (rows) add_boundary_element(element, place, level);
      if (coarse) coarsen_boundary(level, element, place, *coarse, parents);
    }
  });
}

void add_boundary(const std::vector<BoundaryElement>& elements, RunLevel& level, bool rows,
                  std::vector<BoundaryElement>* coarse, RunLevel* parents) {
  for_slabs(level.cells.boundary_slab_start, [&](std::int32_t begin, std::int32_t end) {
    for (std::int32_t place = begin; place < end; ++place) {
      if (rows) add_boundary_element(elements[place], place, level);
      if (coarse) coarsen_boundary(level, elements[place], place, *coarse, parents);
    }
  });
}

void add_areas(const Polygrid& polygrid, const FineGrid& fine, SurfaceTerms& terms) {
  std::vector<std::int32_t> outer_of(polygrid.points.rows(), -1);
  for (std::size_t s = 0; s < fine.outer_point.size(); ++s)
    outer_of[fine.outer_point[s]] = static_cast<std::int32_t>(s);
  for (Eigen::Index quad = 0; quad < polygrid.boundary_quads.rows(); ++quad) {
    const std::array<double, 4> area = quad_areas(polygrid, quad);
    for (int a = 0; a < 4; ++a) {
      const std::int32_t outer = outer_of[polygrid.boundary_quads(quad, a)];
      if (outer < 0) throw InputError("polygrid: a boundary quad's point is no outer point");
      terms.area[outer] += area[a];
      terms.total_area += area[a];
    }
  }
}

struct Greatest {
  float value = 0;
  Greatest operator+(const Greatest& other) const { return {std::max(value, other.value)}; }
};

void halve_numbers(const float* from, float scale, std::size_t begin, std::size_t end, Half* to) {
  std::size_t i = begin;
#if defined(__AVX512F__)
  for (; i + 16 <= end; i += 16)
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(to + i),
                        _mm512_maskz_cvtps_ph(0xffff, _mm512_mul_ps(_mm512_loadu_ps(from + i), _mm512_set1_ps(scale)),
                                              _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC));
#elif defined(__F16C__)
  for (; i + 8 <= end; i += 8)
    _mm_storeu_si128(reinterpret_cast<__m128i*>(to + i),
                     _mm256_cvtps_ph(_mm256_mul_ps(_mm256_loadu_ps(from + i), _mm256_set1_ps(scale)),
                                     _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC));
#endif
  for (; i < end; ++i) to[i] = to_half(scale * from[i]);
}

// Whether the channels' diffusion coefficients are everywhere the same multiples of the first's; which, if so.
bool proportional_channels(const CellCoefficients& coefficients, Float4& ratio) {
  const std::vector<Rgb>& extinction = coefficients.reduced_extinction;
  if (extinction.empty()) return false;
  const Rgb wanted = extinction[0][0] / extinction[0];
  const std::size_t chunk = 4096;
  struct Count {
    std::int64_t different = 0;
    Count operator+(const Count& o) const { return {different + o.different}; }
  };
  const Count count = parallel_sum(
      (extinction.size() + chunk - 1) / chunk, Count{},
      [&](std::size_t k) {
        Count own;
        for (std::size_t i = k * chunk; i < std::min(extinction.size(), (k + 1) * chunk); ++i)
          own.different += ((wanted * extinction[i] - extinction[i][0]).abs() > 1e-6f * extinction[i][0]).any();
        return own;
      },
      1);
  ratio = to_lanes(wanted);
  return count.different == 0;
}

// The half-precision copy, scaled so that its greatest coupling is far from overflow.
void store_half(RunLevel& level, const Float4* ratio) {
  const std::size_t n = level.single.values.size();
  const float* from = level.single.values.data();
  const float greatest = parallel_sum((n + 65535) / 65536, Greatest{},
                                      [&](std::size_t chunk) {
                                        Float16Lanes most = {};
                                        const std::size_t end = std::min(n, (chunk + 1) * 65536);
                                        std::size_t i = chunk * 65536;
                                        for (; i + 16 <= end; i += 16) {
                                          const Float16Lanes v = load_lanes<Float16Lanes>(from + i);
                                          const Float16Lanes size = v < 0 ? -v : v;
                                          most = most > size ? most : size;
                                        }
                                        Greatest own;
                                        for (int k = 0; k < 16; ++k) own.value = std::max(own.value, most[k]);
                                        for (; i < end; ++i) own.value = std::max(own.value, std::abs(from[i]));
                                        return own;
                                      },
                                      1)
                             .value;
  float surface_greatest = 0;
  surface_greatest = parallel_sum(level.single.surface.size(), Greatest{}, [&](std::size_t k) {
                       const auto& pair = level.single.surface[k];
                       Greatest own;
                       for (int c = 0; c < 3; ++c)
                         own.value = std::max({own.value, std::abs(pair.outer_outer[c]), std::abs(pair.twin_outer[c]),
                                               std::abs(pair.outer_twin[c])});
                       return own;
                     }).value;
  const auto scale_of = [](float size) {
    return size > 0 && std::isfinite(size) ? std::exp2(14 - std::ilogb(size)) : 1.0;
  };
  const auto scale = static_cast<float>(scale_of(greatest));
  level.half.copies = ratio ? 1 : 3;
  const std::size_t stored = ratio ? n / 3 : n;
  if (level.half.values.size() != stored || !level.half) level.half.values = StreamBuffer<Half>(stored);
  Half* to = level.half.values.data();
  level.half.factor = Float4{1, 1, 1, 1} / scale;
  if (ratio) {
    level.half.factor = *ratio / scale;
    parallel_for(
        level.layout.runs.size(),
        [&](std::size_t r) {
          const LatticeRun& run = level.layout.runs[r];
          const std::int64_t first = static_cast<std::int64_t>(coupling_slots) * run.start;
          for (int slot = 0; slot < coupling_slots; ++slot) {
            const float* own = from + 3 * first + static_cast<std::int64_t>(3 * slot) * run.length;
            halve_numbers(own, scale, 0, run.length, to + first + static_cast<std::int64_t>(slot) * run.length);
          }
        },
        64);
  } else {
    parallel_chunks(n, 1 << 16,
                    [&](std::size_t begin, std::size_t end) { halve_numbers(from, scale, begin, end, to); });
  }
  const auto surface_scale = static_cast<float>(scale_of(surface_greatest));
  level.half.surface.resize(level.single.surface.size());
  parallel_for(
      level.half.surface.size(),
      [&](std::size_t k) {
        for (int c = 0; c < 3; ++c) {
          level.half.surface[k].outer_outer[c] = to_half(surface_scale * level.single.surface[k].outer_outer[c]);
          level.half.surface[k].twin_outer[c] = to_half(surface_scale * level.single.surface[k].twin_outer[c]);
          level.half.surface[k].outer_twin[c] = to_half(surface_scale * level.single.surface[k].outer_twin[c]);
        }
      },
      4096);
  level.half.surface_factor = Float4{1, 1, 1, 1} / surface_scale;
}

// Where weights do not add up to one, couplings lose light, too. What would gain some is left out: the operator grows,
// and stays positive definite.
void drop_gains(LevelVector<float>& reaction, std::size_t inner) {
  for (int c = 0; c < 3; ++c)
    for (std::size_t u = 0; u < inner; ++u) reaction.inner[c][u] = std::max(0.0f, reaction.inner[c][u]);
  for (Float4& value : reaction.outer) value = value > 0 ? value : Float4{};
}

// The coarse level's reaction and links: the sums of the Galerkin products' rows.
void restrict_terms(RunLevel& level, RunLevel& coarse) {
  coarse.link.resize(coarse.surface.size());
  if (!level.transfer.weights) {
    restrict_vector(level, level.reaction, coarse.layout, coarse.reaction);
    restrict_outer_vector(level, level.link, coarse.link);
    return;
  }
  LevelVector<float>&ones = coarse.before, &sums = level.before, &image = level.right_side;
  for (int c = 0; c < 3; ++c) std::fill(ones.inner[c], ones.inner[c] + coarse.inner_size(), 1.0f);
  std::fill(ones.outer.begin(), ones.outer.end(), Float4{1, 1, 1, 1});
  prolong_vector(level, ones, sums, false);
  for (int c = 0; c < 3; ++c)
    for (std::size_t u = 0; u < level.inner_size(); ++u)
      image.inner[c][u] = level.reaction.inner[c][u] * sums.inner[c][u];
  for (std::size_t s = 0; s < image.outer.size(); ++s) image.outer[s] = level.reaction.outer[s] * sums.outer[s];
  restrict_vector(level, image, coarse.layout, coarse.reaction);
  for (std::size_t s = 0; s < image.outer.size(); ++s) image.outer[s] = level.link[s] * sums.outer[s];
  restrict_outer_vector(level, image.outer, coarse.link);
}

}  // namespace

SurfaceTerms assemble_levels(const Polygrid& polygrid, const CellCoefficients& coefficients,
                             const AssemblyOptions& options, LevelHierarchy& hierarchy) {
  const FineGrid& fine = hierarchy.fine;
  std::vector<RunLevel>& levels = hierarchy.levels;
  const auto cells = static_cast<std::size_t>(polygrid.cells.rows());
  if (coefficients.absorption.size() != 8 * cells || coefficients.reduced_extinction.size() != 8 * cells)
    throw InputError("polygrid: the coefficients do not belong to its cells");
  SurfaceTerms terms;
  terms.absorption.assign(levels.front().surface.size(), Float4{});
  terms.area.assign(levels.front().surface.size(), 0.0);
  add_areas(polygrid, fine, terms);
  Float4 ratio = {};
  const bool one_copy = proportional_channels(coefficients, ratio);
  CellElements elements;
  std::vector<BoundaryElement> boundary;
  std::vector<DeepCoefficients> deep_coefficients;
  for (std::size_t l = 0; l < levels.size(); ++l) {
    RunLevel& level = levels[l];
    clear_couplings(level);
    if (l == 0) level.link.assign(level.surface.size(), Float4{});
    if (l > 0 && !hierarchy.deep[l].child.empty()) {
      deep_coefficients = mean_coefficients(hierarchy.deep[l], coefficients, deep_coefficients);
      if (!hierarchy.deep[l].empty()) {
        assemble_deep(deep_coefficients, hierarchy.deep[l], level, elements);
        store_half(hierarchy.deep[l].part, one_copy ? &ratio : nullptr);
        hierarchy.deep[l].part.single = {};
      }
    }
    level.extra.assign(level.layout.extras.size(), Float4{});
    CellElements coarse_elements;
    const bool has_coarse = l + 1 < levels.size();
    if (has_coarse) coarse_elements = CellElements(levels[l + 1].cells);
    CellElements* coarse = has_coarse ? &coarse_elements : nullptr;
    RunLevel* const parents = has_coarse ? &levels[l + 1] : nullptr;
    level.transfer.weights.values = {};
    const bool box = options.box_transfer && has_coarse;
    // Where the transfer follows the couplings these come first, and the coarse elements in a second pass.
    for (int pass = 0; pass <= box; ++pass) {
      const bool rows = pass == 0;
      CellElements* to = box && rows ? nullptr : coarse;
      if (l == 0) {
        for (int c = 0; c < 3 && rows; ++c)
          std::fill(level.reaction.inner[c], level.reaction.inner[c] + level.inner_size(), 0.0f);
        assemble_fine_core(coefficients, fine, level, rows, to, parents);
        assemble_layer(polygrid, coefficients, fine, level, rows, terms, to ? &to->boundary : nullptr, parents);
        for (std::size_t s = 0; s < terms.area.size() && rows; ++s)
          level.reaction.outer[s] =
              terms.absorption[s] +
              static_cast<float>(terms.area[s] / (2 * options.boundary_factor)) * Float4{1, 1, 1, 0};  // PHYSICS D2
      } else {
        assemble_coarse_core(elements, level, rows, to, parents);
        add_boundary(boundary, level, rows, to ? &to->boundary : nullptr, parents);
      }
      if (!box || !rows) continue;
      set_box_weights(level);
      restrict_terms(level, levels[l + 1]);
    }
    elements = std::move(coarse_elements);
    boundary = std::move(elements.boundary);
    // Coarse couplings of rough materials have both signs, and what is left of their sums does not stand rounding.
    if (options.box_transfer && l > 0)
      level.half = {};
    else
      store_half(level, one_copy ? &ratio : nullptr);
    if (box)
      drop_gains(levels[l + 1].reaction, levels[l + 1].inner_size());
    else if (has_coarse)
      restrict_terms(level, levels[l + 1]);
    prepare_smoother(level);
    if (level.half && !options.keep_single && level.single.values.size() * sizeof(float) > largest_kept)
      level.single = {};
  }
  return terms;
}

}  // namespace shellgrid
