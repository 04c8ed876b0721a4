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

// Length of what is common over length of all, the least of the three axes.
double common_share(const Bounds& a, const Bounds& b) {
  const Vec3 common = (a.upper.cwiseMin(b.upper) - a.lower.cwiseMax(b.lower)).cwiseMax(0.0);
  const Vec3 all = a.upper.cwiseMax(b.upper) - a.lower.cwiseMin(b.lower);
  double share = 1;
  for (int axis = 0; axis < 3; ++axis)
    if (all[axis] > 0) share *= common[axis] / all[axis];
  return share;
}

const std::vector<float>* finite(const AttributedMesh& mesh, const std::string& key, const std::string& name) {
  const std::vector<float>* values = mesh.find(key);
  if (!values) return nullptr;
  for (std::size_t i = 0; i < values->size(); ++i)
    if (!std::isfinite((*values)[i]))
      throw InputError(fmt::format("{}: '{}' of vertex {} is not finite", name, key, i));
  return values;
}

}  // namespace

SurfacePaint transfer_paint(const AttributedMesh& painted, const TriangleMesh& surface, int sample_count,
                            const std::string& name) {
  SurfacePaint paint;
  if (painted.mesh.face_count() == 0) throw InputError(name + ": a painted mesh needs faces");
  const std::vector<float>* direction[3] = {finite(painted, "direction_x", name), finite(painted, "direction_y", name),
                                            finite(painted, "direction_z", name)};
  const bool directed = direction[0] && direction[1] && direction[2];
  const std::vector<float>* scale = finite(painted, "scale", name);
  const std::vector<float>* sample = nullptr;
  double per_unit = 1;
  if (sample_count > 1) {
    for (const char* key : {"sample", "quality", "red"})
      if (!sample) {
        sample = finite(painted, key, name);
        if (sample && std::string(key) == "red") per_unit = sample_count / 256.0;
      }
    if (!sample)
      throw InputError(fmt::format(
          "{}: the vertices have none of 'sample', 'quality' and 'red'; one must say which of the {} samples they take",
          name, sample_count));
  }
  if (!directed && !scale && !sample)
    throw InputError(name +
                     ": nothing is painted: expected vertex properties 'direction_x direction_y direction_z', "
                     "'scale' or, for several samples, 'sample'");
  const auto sample_of = [&](int v) {
    const double value = (*sample)[v];
    return per_unit == 1 ? std::lround(std::clamp(value, -1e6, 1e6)) : std::lround(std::floor(value * per_unit));
  };
  for (int v = 0; sample && v < painted.mesh.vertex_count(); ++v)
    if (sample_of(v) < 0 || sample_of(v) >= sample_count)
      throw InputError(fmt::format("{}: vertex {} wants sample {}, but there are {}, counted from 0", name, v,
                                   (*sample)[v], sample_count));
  for (int v = 0; scale && v < painted.mesh.vertex_count(); ++v)
    if (!((*scale)[v] >= 0.25f && (*scale)[v] <= 4))
      throw InputError(
          fmt::format("{}: the scale {} of vertex {} is out of range; expected 0.25 to 4", name, (*scale)[v], v));

  const Bounds from(painted.mesh), to(surface);
  const bool fitted = common_share(from, to) < 0.5;
  const double ratio = fitted ? from.size().maxCoeff() / std::max(to.size().maxCoeff(), 1e-300) : 1.0;
  const ClosestPointQuery query(painted.mesh);
  const std::size_t n = surface.vertex_count();
  if (directed) paint.direction.resize(n);
  if (scale) paint.scale.resize(n);
  if (sample) paint.sample.resize(n);
  parallel_for(n, [&](std::size_t v) {
    const Vec3 own = surface.vertex(static_cast<int>(v));
    const SurfacePoint at = query.nearest(fitted ? Vec3(from.middle() + ratio * (own - to.middle())) : own);
    const auto mean = [&](const std::vector<float>& values) {
      double sum = 0;
      for (int k = 0; k < 3; ++k) sum += at.barycentric[k] * values[painted.mesh.faces(at.face_index, k)];
      return static_cast<float>(sum);
    };
    if (directed) paint.direction[v] = Vec3f(mean(*direction[0]), mean(*direction[1]), mean(*direction[2]));
    if (scale) paint.scale[v] = mean(*scale);
    Eigen::Index nearest = 0;
    at.barycentric.maxCoeff(&nearest);
    if (sample) paint.sample[v] = static_cast<std::int32_t>(sample_of(painted.mesh.faces(at.face_index, nearest)));
  });
  return paint;
}

}  // namespace shellgrid
