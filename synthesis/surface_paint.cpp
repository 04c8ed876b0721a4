// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/surface_paint.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/surface/closest_point.h"

namespace shellgrid {
namespace {

struct Bounds {
  Vec3 lower, upper;

  explicit Bounds(const TriangleMesh& mesh)
      : lower(mesh.vertices.colwise().minCoeff().transpose()), upper(mesh.vertices.colwise().maxCoeff().transpose()) {}
  Vec3 size() const { return upper - lower; }
  Vec3 middle() const { return (lower + upper) / 2; }
};

const std::vector<float>* finite(const AttributedMesh& mesh, const std::string& key, const std::string& name) {
  const std::vector<float>* values = mesh.find(key);
  if (!values) return nullptr;
  for (std::size_t i = 0; i < values->size(); ++i)
    if (!std::isfinite((*values)[i]))
      throw InputError(fmt::format("{}: '{}' of vertex {} is not finite", name, key, i));
  return values;
}

// The vertex properties of a painted mesh that count, each checked; null where there is none.
struct PaintedValues {
  const std::vector<float>*direction[3] = {}, *scale = nullptr, *sample = nullptr;
  double per_unit = 1;  // samples for each unit of `sample`

  PaintedValues(const AttributedMesh& painted, int sample_count, const std::string& name) {
    const auto fail = [&](const std::string& what) { throw InputError(name + ": " + what); };
    if (painted.mesh.face_count() == 0) fail("a painted mesh needs faces");
    static const char* const directions[3] = {"direction_x", "direction_y", "direction_z"};
    for (int k = 0; k < 3; ++k) direction[k] = finite(painted, directions[k], name);
    for (int k = 0; k < 3; ++k)
      if (!direction[k] && (direction[0] || direction[1] || direction[2]))
        fail(fmt::format("the vertices have no '{}'; a direction is three numbers", directions[k]));
    scale = finite(painted, "scale", name);
    sample = finite(painted, "sample", name);
    if (sample_count > 1)
      for (const char* key : {"quality", "red"})
        if (!sample) {
          sample = finite(painted, key, name);
          if (sample && std::string(key) == "red") per_unit = sample_count / 256.0;
        }
    if (sample_count > 1 && !sample)
      fail(
          fmt::format("the vertices have none of 'sample', 'quality' and 'red'; one must say which of the {} samples "
                      "they take",
                      sample_count));
    if (!direction[0] && !scale && !sample)
      fail(
          "nothing is painted: expected vertex properties 'direction_x direction_y direction_z', 'scale' or, for "
          "several samples, 'sample'");
    for (int v = 0; sample && v < painted.mesh.vertex_count(); ++v)
      if (sample_of(v) < 0 || sample_of(v) >= sample_count)
        fail(sample_count == 1 ? fmt::format("vertex {} wants sample {}, but there is one, numbered 0", v, (*sample)[v])
                               : fmt::format("vertex {} wants sample {}, but there are {}, counted from 0", v,
                                             (*sample)[v], sample_count));
    for (int v = 0; scale && v < painted.mesh.vertex_count(); ++v)
      if (!((*scale)[v] >= 0.25f && (*scale)[v] <= 4))
        fail(fmt::format("the scale {} of vertex {} is out of range; expected 0.25 to 4", (*scale)[v], v));
    if (sample_count == 1) sample = nullptr;
  }

  long sample_of(int vertex) const {
    const double value = (*sample)[vertex];
    return per_unit == 1 ? std::lround(std::clamp(value, -1e6, 1e6))
                         : std::lround(std::floor(std::clamp(value * per_unit, -1e6, 1e6)));
  }
};

// From the surface's frame to the painted mesh's.
struct Placement {
  Vec3 from_middle = Vec3::Zero(), to_middle = Vec3::Zero();
  double ratio = 1;

  Vec3 operator()(const Vec3& own) const { return to_middle + ratio * (own - from_middle); }
};

double quantile(std::vector<double> values, double share) {
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

// Mean distance of about a thousand of the surface's vertices, in the surface's lengths.
double mean_distance(const ClosestPointQuery& query, const TriangleMesh& surface, const Placement& placement) {
  const int step = std::max(1, surface.vertex_count() / 1000);
  double sum = 0;
  int count = 0;
  for (int v = 0; v < surface.vertex_count(); v += step, ++count)
    sum += std::sqrt(query.nearest(placement(surface.vertex(v))).squared_distance) / placement.ratio;
  return sum / std::max(1, count);
}

}  // namespace

void require_paint(const AttributedMesh& painted, int sample_count, const std::string& name, double scale) {
  const PaintedValues values(painted, sample_count, name);
  for (std::size_t v = 0; values.scale && v < values.scale->size(); ++v)
    if (const double product = scale * static_cast<double>((*values.scale)[v]); !(product >= 0.25 && product <= 4))
      throw InputError(fmt::format("{}: the scale {} of vertex {} times {:.4g} is out of range; expected 0.25 to 4",
                                   name, (*values.scale)[v], v, scale));
}

SurfacePaint transfer_paint(const AttributedMesh& painted, const TriangleMesh& surface, int sample_count,
                            const std::string& name, PaintFit* fit) {
  const PaintedValues values(painted, sample_count, name);
  if (surface.vertex_count() == 0) throw InputError("a mesh without vertices cannot be painted");
  SurfacePaint paint;
  const ClosestPointQuery query(painted.mesh);
  const Bounds from(painted.mesh), to(surface);
  const double size = to.size().maxCoeff();
  Placement placement;
  const Placement fitted{to.middle(), from.middle(), from.size().maxCoeff() / std::max(size, 1e-300)};
  const bool moved = fitted.ratio > 0 && std::isfinite(fitted.ratio) &&
                     mean_distance(query, surface, fitted) < 0.5 * mean_distance(query, surface, placement);
  if (moved) placement = fitted;

  const bool directed = values.direction[0] != nullptr;
  const std::size_t n = surface.vertex_count();
  if (directed) paint.direction.resize(n);
  if (values.scale) paint.scale.resize(n);
  if (values.sample) paint.sample.resize(n);
  std::vector<double> distance(n);
  parallel_for(n, [&](std::size_t v) {
    const SurfacePoint at = query.nearest(placement(surface.vertex(static_cast<int>(v))));
    distance[v] = std::sqrt(at.squared_distance) / placement.ratio;
    const auto mean = [&](const std::vector<float>& of) {
      double sum = 0;
      for (int k = 0; k < 3; ++k) sum += at.barycentric[k] * of[painted.mesh.faces(at.face_index, k)];
      return static_cast<float>(sum);
    };
    if (directed)
      paint.direction[v] = Vec3f(mean(*values.direction[0]), mean(*values.direction[1]), mean(*values.direction[2]));
    if (values.scale) paint.scale[v] = mean(*values.scale);
    Eigen::Index nearest = 0;
    at.barycentric.maxCoeff(&nearest);
    if (values.sample)
      paint.sample[v] = static_cast<std::int32_t>(values.sample_of(painted.mesh.faces(at.face_index, nearest)));
  });
  const double median = quantile(distance, 0.5);
  if (!(median <= 0.03 * size))
    throw InputError(
        fmt::format("{}: is not painted on this surface: half of it is more than {:.3g} mm off", name, median));
  if (fit) *fit = {moved, median, *std::max_element(distance.begin(), distance.end())};
  return paint;
}

}  // namespace shellgrid
