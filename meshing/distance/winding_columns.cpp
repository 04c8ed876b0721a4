// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/distance/winding_columns.h"

#include <algorithm>
#include <cmath>

#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

constexpr int fraction_bits = 20;
using Wide = __int128;

struct Corner {
  std::int64_t x, y;  // 2⁻²⁰ voxel
  double z;           // voxel
};

// Twice the signed area of (a, b, p).
Wide edge_function(const Corner& a, const Corner& b, std::int64_t x, std::int64_t y) {
  return static_cast<Wide>(b.x - a.x) * (y - a.y) - static_cast<Wide>(b.y - a.y) * (x - a.x);
}

// The sign of the edge function at (x + ε, y + ε²), which is never 0 unless a and b coincide.
int edge_sign(const Corner& a, const Corner& b, Wide value) {
  if (value != 0) return value > 0 ? 1 : -1;
  if (a.y != b.y) return b.y < a.y ? 1 : -1;
  return b.x > a.x ? 1 : (b.x < a.x ? -1 : 0);
}

struct Hit {
  std::int64_t line;
  double z;
  std::int32_t turn;
};

}  // namespace

WindingColumns::WindingColumns(const TriangleMesh& mesh, const GridFrame& frame, const Vec3i& lower, const Vec3i& upper)
    : lower_i_(lower.x()),
      lower_j_(lower.y()),
      count_i_(upper.x() - lower.x() + 1),
      count_j_(upper.y() - lower.y() + 1) {
  std::vector<Corner> corners(mesh.vertex_count());
  parallel_for(corners.size(), [&](std::size_t v) {
    const Vec3 p = frame.to_index(mesh.vertex(static_cast<int>(v)));
    corners[v] = {std::llround(std::ldexp(p.x(), fraction_bits)), std::llround(std::ldexp(p.y(), fraction_bits)),
                  p.z()};
  });

  constexpr std::size_t chunk = 4096;
  const std::size_t faces = static_cast<std::size_t>(mesh.face_count());
  std::vector<std::vector<Hit>> parts((faces + chunk - 1) / chunk);
  parallel_chunks(faces, chunk, [&](std::size_t begin, std::size_t end) {
    std::vector<Hit>& hits = parts[begin / chunk];
    for (std::size_t f = begin; f < end; ++f) {
      const Corner& a = corners[mesh.faces(static_cast<Eigen::Index>(f), 0)];
      const Corner& b = corners[mesh.faces(static_cast<Eigen::Index>(f), 1)];
      const Corner& c = corners[mesh.faces(static_cast<Eigen::Index>(f), 2)];
      const Wide area = edge_function(a, b, c.x, c.y);
      if (area == 0) continue;
      const int facing = area > 0 ? 1 : -1;
      constexpr std::int64_t one = std::int64_t{1} << fraction_bits;
      const auto first_line = [&](std::int64_t value, int least) {
        return std::max<std::int64_t>((value + one - 1) >> fraction_bits, least);
      };
      const auto last_line = [&](std::int64_t value, int most) {
        return std::min<std::int64_t>(value >> fraction_bits, most);
      };
      const std::int64_t i0 = first_line(std::min({a.x, b.x, c.x}), lower.x());
      const std::int64_t i1 = last_line(std::max({a.x, b.x, c.x}), upper.x());
      const std::int64_t j0 = first_line(std::min({a.y, b.y, c.y}), lower.y());
      const std::int64_t j1 = last_line(std::max({a.y, b.y, c.y}), upper.y());
      for (std::int64_t i = i0; i <= i1; ++i)
        for (std::int64_t j = j0; j <= j1; ++j) {
          const std::int64_t x = i * one, y = j * one;
          const Wide wa = edge_function(b, c, x, y), wb = edge_function(c, a, x, y), wc = edge_function(a, b, x, y);
          if (edge_sign(b, c, wa) != facing || edge_sign(c, a, wb) != facing || edge_sign(a, b, wc) != facing) continue;
          const double z =
              (static_cast<double>(wa) * a.z + static_cast<double>(wb) * b.z + static_cast<double>(wc) * c.z) /
              static_cast<double>(area);
          hits.push_back({(i - lower.x()) * count_j_ + (j - lower.y()), z, -facing});
        }
    }
  });

  // Gather by line, in the order of faces, then sort each line upwards.
  const std::size_t lines = static_cast<std::size_t>(count_i_) * count_j_;
  first_.assign(lines + 1, 0);
  for (const auto& hits : parts)
    for (const Hit& hit : hits) ++first_[hit.line + 1];
  for (std::size_t line = 0; line < lines; ++line) first_[line + 1] += first_[line];
  crossings_.resize(static_cast<std::size_t>(first_[lines]));
  std::vector<std::int64_t> next(first_.begin(), first_.end() - 1);
  for (const auto& hits : parts)
    for (const Hit& hit : hits) crossings_[next[hit.line]++] = {hit.z, hit.turn};
  parallel_for(lines, [&](std::size_t line) {
    std::sort(crossings_.begin() + first_[line], crossings_.begin() + first_[line + 1],
              [](const Crossing& u, const Crossing& v) { return u.z < v.z || (u.z == v.z && u.turn < v.turn); });
  });
}

void WindingColumns::inside(int i, int j, int k, int count, bool* result) const {
  i -= lower_i_, j -= lower_j_;
  if (i < 0 || j < 0 || i >= count_i_ || j >= count_j_) {
    std::fill_n(result, count, false);
    return;
  }
  const std::size_t line = static_cast<std::size_t>(i) * count_j_ + j;
  std::int64_t at = first_[line];
  const std::int64_t end = first_[line + 1];
  int winding = 0;
  for (int step = 0; step < count; ++step) {
    while (at < end && crossings_[at].z < k + step) winding += crossings_[at++].turn;
    result[step] = winding > 0;
  }
}

}  // namespace shellgrid
