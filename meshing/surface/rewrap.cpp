// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/surface/rewrap.h"

#include <fmt/format.h>
#include <sys/resource.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <numeric>
#include <string>
#include <vector>

#include "meshing/core/error.h"
#include "meshing/core/guarded_child.h"
#include "meshing/surface/repair.h"
#include "meshing/surface/surface_quality.h"

namespace shellgrid {
namespace {

constexpr int limit_seconds = 50;                          // of processor time, over all attempts
constexpr std::size_t limit_bytes = std::size_t{5} << 30;  // of data
constexpr double least_share = 1.0 / 2000;                 // of the object's length that a resolution may be
constexpr double offset_share =
    0.1;  // of the resolution; half as much doubles the time, and halves the thickness of sheets

// In the child: wraps and sends the surface through the pipe.
bool send_wrap(const TriangleMesh& mesh, double alpha, double offset, int pipe) {
#ifndef __SANITIZE_ADDRESS__  // whose shadow counts as data
  lower_limit(RLIMIT_DATA, limit_bytes);
#endif
  TriangleMesh wrap;
  {
    const ForeignCode foreign;
    wrap = wrap_triangles(mesh, alpha, offset);
  }
  const std::int64_t counts[2] = {wrap.vertices.rows(), wrap.faces.rows()};
  return write_all(pipe, counts, sizeof counts) &&
         write_all(pipe, wrap.vertices.data(), sizeof(double) * static_cast<std::size_t>(wrap.vertices.size())) &&
         write_all(pipe, wrap.faces.data(), sizeof(std::int32_t) * static_cast<std::size_t>(wrap.faces.size()));
}

[[noreturn]] void fail(const char* what) {
  throw InputError(fmt::format("rewrapping {}; try a coarser resolution", what));
}

// Lowers the seconds by what the child used.
TriangleMesh wrap_guarded(const TriangleMesh& mesh, double alpha, double offset, double& seconds) {
  const GuardedAnswer answer =
      run_guarded(seconds, 4 * seconds, [&](int pipe) { return send_wrap(mesh, alpha, offset, pipe); });
  const std::string& bytes = answer.bytes;
  seconds -= answer.seconds + 1;
  if (answer.out_of_time) fail("takes too long");
  if (!answer.finished) fail("failed or needs too much memory");
  std::int64_t counts[2] = {0, 0};
  if (bytes.size() >= sizeof counts) std::memcpy(counts, bytes.data(), sizeof counts);
  TriangleMesh wrap;
  wrap.vertices.resize(counts[0], 3);
  wrap.faces.resize(counts[1], 3);
  const std::size_t vertex_bytes = sizeof(double) * static_cast<std::size_t>(wrap.vertices.size());
  const std::size_t face_bytes = sizeof(std::int32_t) * static_cast<std::size_t>(wrap.faces.size());
  if (bytes.size() != sizeof counts + vertex_bytes + face_bytes) fail("failed");
  if (counts[1] == 0) fail("leaves nothing");
  std::memcpy(wrap.vertices.data(), bytes.data() + sizeof counts, vertex_bytes);
  std::memcpy(wrap.faces.data(), bytes.data() + sizeof counts + vertex_bytes, face_bytes);
  return wrap;
}

// Leaves the component that encloses most.
TriangleMesh largest_component(const TriangleMesh& mesh, RewrapReport& report) {
  std::vector<int> root(static_cast<std::size_t>(mesh.vertex_count()));
  std::iota(root.begin(), root.end(), 0);
  const auto find = [&](int v) {
    while (root[v] != v) v = root[v] = root[root[v]];
    return v;
  };
  for (int f = 0; f < mesh.face_count(); ++f)
    for (int k = 1; k < 3; ++k) {
      const int a = find(mesh.faces(f, 0)), b = find(mesh.faces(f, k));
      root[std::max(a, b)] = std::min(a, b);
    }
  std::vector<double> volume(root.size(), 0);
  for (int f = 0; f < mesh.face_count(); ++f)
    volume[find(mesh.faces(f, 0))] += mesh.corner(f, 0).dot(mesh.corner(f, 1).cross(mesh.corner(f, 2))) / 6;
  const int largest = static_cast<int>(std::max_element(volume.begin(), volume.end()) - volume.begin());
  double all = 0;
  report.dropped_components = -1;
  for (int v = 0; v < mesh.vertex_count(); ++v)
    if (find(v) == v) all += std::abs(volume[v]), ++report.dropped_components;
  report.dropped_volume = 1 - volume[largest] / all;
  if (report.dropped_components == 0) return mesh;
  TriangleMesh result;
  std::vector<int> place(root.size(), -1);
  result.vertices.resize(mesh.vertices.rows(), 3);
  int vertices = 0;
  for (int v = 0; v < mesh.vertex_count(); ++v)
    if (find(v) == largest) {
      result.vertices.row(vertices) = mesh.vertices.row(v);
      place[v] = vertices++;
    }
  result.vertices.conservativeResize(vertices, 3);
  result.faces.resize(mesh.faces.rows(), 3);
  Eigen::Index faces = 0;
  for (int f = 0; f < mesh.face_count(); ++f)
    if (find(mesh.faces(f, 0)) == largest) {
      for (int k = 0; k < 3; ++k) result.faces(faces, k) = place[mesh.faces(f, k)];
      ++faces;
    }
  result.faces.conservativeResize(faces, 3);
  return result;
}

}  // namespace

TriangleMesh rewrap_surface(const TriangleMesh& mesh, double resolution, RewrapReport& report, Progress& progress) {
  if (mesh.face_count() == 0 || mesh.vertex_count() == 0) throw InputError("the mesh has no faces");
  if (!mesh.vertices.allFinite()) throw InputError("the mesh has coordinates that are not finite numbers");
  if (mesh.faces.minCoeff() < 0 || mesh.faces.maxCoeff() >= mesh.vertex_count())
    throw InputError("the mesh has a face index out of range");
  // Wrapped at unit size about the origin, in which it is the same for every unit of length.
  TriangleMesh soup;
  soup.faces = mesh.faces;
  std::vector<char> used(static_cast<std::size_t>(mesh.vertex_count()), 0);
  for (Eigen::Index i = 0; i < mesh.faces.size(); ++i) used[mesh.faces.data()[i]] = 1;
  Eigen::RowVector3d lower = Eigen::RowVector3d::Constant(std::numeric_limits<double>::infinity()), upper = -lower;
  for (int v = 0; v < mesh.vertex_count(); ++v)
    if (used[v]) lower = lower.cwiseMin(mesh.vertices.row(v)), upper = upper.cwiseMax(mesh.vertices.row(v));
  const double length = (upper - lower).maxCoeff();
  const Eigen::RowVector3d centre = 0.5 * (lower + upper);
  if (!(length > 0)) throw InputError("every face of the mesh is degenerate");
  if (!(resolution >= least_share * length && resolution <= 0.5 * length))
    throw InputError(fmt::format("a resolution of {:.6g} for an object {:.6g} long; expected {:.6g} to {:.6g}",
                                 resolution, length, least_share * length, 0.5 * length));
  soup.vertices = (mesh.vertices.rowwise() - centre) / length;
  report.resolution = resolution;
  progress.begin("rewrapping", 0);
  double seconds = limit_seconds;
  for (int attempt = 0;; ++attempt) {
    // A wrap is free of crossings but for the rounding of its points; another radius rounds otherwise.
    const double alpha = resolution / length * (1 + 0.03 * attempt);
    TriangleMesh wrap = largest_component(wrap_guarded(soup, alpha, offset_share * alpha, seconds), report);
    RepairReport repair;
    try {
      wrap = repair_surface(wrap, false, repair);
    } catch (const InputError& error) {
      if (attempt < 2 && seconds > 1) continue;
      throw InputError(fmt::format("rewrapping left {}; try another resolution", error.what()));
    }
    report.to_input = length * sampled_distance(wrap, soup, alpha);
    report.from_input = length * sampled_distance(soup, wrap, alpha);
    wrap.vertices = ((wrap.vertices * length).rowwise() + centre).eval();
    progress.end();
    return wrap;
  }
}

}  // namespace shellgrid
