// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/surface/surface_fit.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/surface/closest_point.h"

namespace shellgrid {
namespace {

// The mesh's faces that may lie as near to a place as it should be and `slack` more; a few others may be among them.
TriangleMesh faces_about(const std::vector<PlaceAtDistance>& places, const TriangleMesh& mesh, double slack) {
  constexpr int most_cells = 128;      // along an axis
  constexpr double cells_a_reach = 4;  // at most
  double greatest = 0;
  for (const PlaceAtDistance& place : places) greatest = std::max(greatest, place.distance + slack);
  const Vec3 lower = mesh.vertices.colwise().minCoeff().transpose(),
             extent = mesh.vertices.colwise().maxCoeff().transpose() - lower;
  const double edge = std::max({extent.maxCoeff() / most_cells, greatest / cells_a_reach, 1e-300});
  const Vec3i cells = (extent / edge).cast<int>() + Vec3i::Ones();
  const auto cell_of = [&](const Vec3& point) -> Vec3i {
    const Vec3 at = (point - lower) / edge;
    return at.cwiseMax(0).cwiseMin((cells - Vec3i::Ones()).cast<double>()).cast<int>();
  };
  const auto visit = [&](const Vec3& from, const Vec3& to, const auto& take) {
    const Vec3i first = cell_of(from), last = cell_of(to);
    for (int x = first.x(); x <= last.x(); ++x)
      for (int y = first.y(); y <= last.y(); ++y)
        for (int z = first.z(); z <= last.z(); ++z)
          take(Vec3i(x, y, z), (static_cast<std::size_t>(x) * cells.y() + y) * cells.z() + z);
  };
  std::vector<char> is_near(cells.cast<std::size_t>().prod(), 0);
  const double half_diagonal = edge * std::sqrt(3.0) / 2;
  for (const PlaceAtDistance& place : places) {
    const double reach = place.distance + slack;
    const Vec3 around = Vec3::Constant(reach);
    visit(place.point - around, place.point + around, [&](const Vec3i& cell, std::size_t index) {
      const Vec3 middle = lower + edge * (cell.cast<double>() + Vec3::Constant(0.5));
      if ((middle - place.point).norm() <= reach + half_diagonal) is_near[index] = 1;
    });
  }
  std::vector<char> kept(static_cast<std::size_t>(mesh.face_count()), 0);
  parallel_for(kept.size(), [&](std::size_t f) {
    const int face = static_cast<int>(f);
    const Vec3 a = mesh.corner(face, 0), b = mesh.corner(face, 1), c = mesh.corner(face, 2);
    visit(a.cwiseMin(b).cwiseMin(c), a.cwiseMax(b).cwiseMax(c),
          [&](const Vec3i&, std::size_t index) { kept[f] = kept[f] || is_near[index]; });
  });
  TriangleMesh about;
  about.vertices.resize(3 * std::count(kept.begin(), kept.end(), 1), 3);
  about.faces.resize(about.vertices.rows() / 3, 3);
  Eigen::Index next = 0;
  for (int f = 0; f < mesh.face_count(); ++f) {
    if (!kept[f]) continue;
    for (int k = 0; k < 3; ++k) {
      about.faces(next / 3, k) = static_cast<std::int32_t>(next + k);
      about.vertices.row(next + k) = mesh.vertices.row(mesh.faces(f, k));
    }
    next += 3;
  }
  return about;
}

// That value; infinite where it is more than `slack`.
double deviation_within(const std::vector<PlaceAtDistance>& places, const TriangleMesh& mesh, double share,
                        double slack) {
  const bool all = std::isinf(slack);
  const TriangleMesh about = all ? TriangleMesh() : faces_about(places, mesh, slack);
  if (!all && about.face_count() == 0) return std::numeric_limits<double>::infinity();
  const ClosestPointQuery query(all ? mesh : about);
  std::vector<double> deviation(places.size());
  parallel_for(
      places.size(),
      [&](std::size_t k) {
        deviation[k] = std::abs(std::sqrt(query.nearest(places[k].point).squared_distance) - places[k].distance);
      },
      64);
  const auto rank = static_cast<std::ptrdiff_t>(std::clamp(share, 0.0, 1.0) * static_cast<double>(places.size() - 1));
  std::nth_element(deviation.begin(), deviation.begin() + rank, deviation.end());
  const double found = deviation[static_cast<std::size_t>(rank)];
  return found <= slack ? found : std::numeric_limits<double>::infinity();
}

}  // namespace

double distance_deviation(const std::vector<PlaceAtDistance>& places, const TriangleMesh& mesh, double share) {
  if (mesh.face_count() == 0) throw InputError("the surface has no faces");
  if (places.empty()) return 0;
  // Little of a mesh that fits needs to be searched.
  const double slack = (mesh.vertices.colwise().maxCoeff() - mesh.vertices.colwise().minCoeff()).norm() / 200;
  const double within = deviation_within(places, mesh, share, slack);
  constexpr double everywhere = std::numeric_limits<double>::infinity();
  return within <= slack ? within : deviation_within(places, mesh, share, everywhere);
}

}  // namespace shellgrid
