// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/surface/rewrap.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstring>
#include <numeric>
#include <optional>
#include <vector>

#include "meshing/core/error.h"
#include "meshing/core/guarded_child.h"
#include "meshing/surface/repair.h"
#include "meshing/surface/surface_quality.h"

namespace shellgrid {
namespace {

constexpr int limit_seconds = 50;                // of processor time, over all attempts
constexpr rlim_t limit_bytes = rlim_t{5} << 30;  // of data
constexpr double least_share = 1.0 / 2000;       // of the object's length that a resolution may be
constexpr double offset_share =
    0.1;  // of the resolution; half as much doubles the time, and halves the thickness of sheets

// In the child: wraps and sends the surface through the pipe.
[[noreturn]] void run_child(const TriangleMesh& mesh, double alpha, double offset, double seconds, int pipe) {
  enter_guarded_child();
  const auto limit = [](auto resource, rlim_t amount) {
    const rlimit bound{amount, amount};
    setrlimit(resource, &bound);
  };
  limit(RLIMIT_CORE, 0);
  limit(RLIMIT_CPU, static_cast<rlim_t>(std::ceil(seconds)));
#ifndef __SANITIZE_ADDRESS__  // whose shadow counts as data
  limit(RLIMIT_DATA, limit_bytes);
  for (const int number : {SIGSEGV, SIGABRT, SIGBUS, SIGFPE, SIGILL, SIGXCPU}) ::signal(number, SIG_DFL);
#endif
  const int null = ::open("/dev/null", O_WRONLY);
  if (null >= 0) ::dup2(null, 1), ::dup2(null, 2);
  try {
    TriangleMesh wrap;
    {
      const ForeignCode foreign;
      wrap = wrap_triangles(mesh, alpha, offset);
    }
    const std::int64_t counts[2] = {wrap.vertices.rows(), wrap.faces.rows()};
    const bool sent =
        write_all(pipe, counts, sizeof counts) &&
        write_all(pipe, wrap.vertices.data(), sizeof(double) * static_cast<std::size_t>(wrap.vertices.size())) &&
        write_all(pipe, wrap.faces.data(), sizeof(std::int32_t) * static_cast<std::size_t>(wrap.faces.size()));
    ::_exit(sent ? 0 : 1);
  } catch (...) {
    ::_exit(1);
  }
}

// Reads until the child closes the pipe; empty where it took too long.
std::optional<std::vector<char>> read_all(int pipe, double seconds) {
  std::vector<char> bytes, buffer(1 << 16);
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::duration<double>(4 * seconds);
  for (;;) {
    pollfd ready{pipe, POLLIN, 0};
    const int result = ::poll(&ready, 1, 1000);
    if (result < 0 && errno != EINTR) return std::nullopt;
    if (result <= 0) {
      if (std::chrono::steady_clock::now() > deadline) return std::nullopt;
      continue;
    }
    const ssize_t count = ::read(pipe, buffer.data(), buffer.size());
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) return std::nullopt;
    if (count == 0) return bytes;
    bytes.insert(bytes.end(), buffer.begin(), buffer.begin() + count);
  }
}

[[noreturn]] void fail(const char* what) {
  throw InputError(fmt::format("rewrapping {}; try a coarser resolution", what));
}

// Lowers the seconds by what the child used.
TriangleMesh wrap_guarded(const TriangleMesh& mesh, double alpha, double offset, double& seconds) {
  int ends[2];
  if (::pipe2(ends, O_CLOEXEC) != 0) throw InternalError(fmt::format("pipe: {}", std::strerror(errno)));
  const pid_t child = ::fork();
  if (child < 0) {
    ::close(ends[0]), ::close(ends[1]);
    throw InternalError(fmt::format("fork: {}", std::strerror(errno)));
  }
  if (child == 0) run_child(mesh, alpha, offset, seconds, ends[1]);
  ::close(ends[1]);
  const std::optional<std::vector<char>> bytes = read_all(ends[0], seconds);
  ::close(ends[0]);
  if (!bytes) ::kill(child, SIGKILL);
  int status = 0;
  rusage usage{};
  while (::wait4(child, &status, 0, &usage) < 0 && errno == EINTR) {
  }
  seconds -= static_cast<double>(usage.ru_utime.tv_sec + usage.ru_stime.tv_sec) + 1;
  if (!bytes || (WIFSIGNALED(status) && (WTERMSIG(status) == SIGXCPU || WTERMSIG(status) == SIGKILL)))
    fail("takes too long");
  if (!WIFEXITED(status) || WEXITSTATUS(status) != 0) fail("failed or needs too much memory");
  std::int64_t counts[2] = {0, 0};
  if (bytes->size() >= sizeof counts) std::memcpy(counts, bytes->data(), sizeof counts);
  TriangleMesh wrap;
  wrap.vertices.resize(counts[0], 3);
  wrap.faces.resize(counts[1], 3);
  const std::size_t vertex_bytes = sizeof(double) * static_cast<std::size_t>(wrap.vertices.size());
  const std::size_t face_bytes = sizeof(std::int32_t) * static_cast<std::size_t>(wrap.faces.size());
  if (bytes->size() != sizeof counts + vertex_bytes + face_bytes) fail("failed");
  if (counts[1] == 0) fail("leaves nothing");
  std::memcpy(wrap.vertices.data(), bytes->data() + sizeof counts, vertex_bytes);
  std::memcpy(wrap.faces.data(), bytes->data() + sizeof counts + vertex_bytes, face_bytes);
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
