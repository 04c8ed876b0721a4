// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/scan_conversion.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <numeric>

#include "meshing/core/error.h"
#include "meshing/distance/winding_columns.h"
#include "meshing/distance/winding_number.h"
#include "meshing/surface/closest_point.h"
#include "meshing/surface/repair.h"
#include "synthesis/sample_builder.h"

namespace shellgrid {
namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();

// A part's mesh where it stands.
struct Body {
  int part = 0;
  TriangleMesh mesh;  // mm; empty: z ≤ level
  double level = 0;   // mm
  Vec3 lower, upper;  // mm
  Vec3i first, last;  // places of the fine grid that it may hold, in x and y beyond the sample
  std::unique_ptr<WindingColumns> columns;
  std::unique_ptr<ClosestPointQuery> nearest;
  std::unique_ptr<WindingNumber> winding;
  bool is_half_space() const { return mesh.face_count() == 0; }
};

// A body moved by whole periods so that it reaches into the sample.
struct Copy {
  int body;
  int shift_x, shift_y;  // periods
};

TriangleMesh place(const ScanPart& part, const PartPlacement& placement) {
  TriangleMesh mesh = part.mesh;
  for (int v = 0; v < mesh.vertex_count(); ++v)
    mesh.vertices.row(v) =
        (placement.turn * part.scale.cwiseProduct(part.mesh.vertex(v)) + placement.position).transpose();
  return mesh;
}

// The composed bodies.
class Model {
 public:
  Model(const std::vector<ScanPart>& parts, const ScanOptions& options, const Vec3i& size)
      : parts_(parts), options_(options), fine_(options.samples_per_edge), count_(size * fine_) {
    // A place of the fine grid (i, j, k) is the centre of its cell; k points up from the bottom.
    frame_.voxel = options.voxel / fine_;
    frame_.origin =
        Vec3(0.5 * frame_.voxel, 0.5 * frame_.voxel, options.top - size.z() * options.voxel + 0.5 * frame_.voxel);
    std::vector<int> order(parts.size());
    std::iota(order.begin(), order.end(), 0);
    std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return parts[a].priority < parts[b].priority; });
    for (int part : order) add(part);
  }

  // Which part each place of a row of voxels lies in: owner[((j·n_x·s) + i)·n_z·s + k] for the s lines j of the row;
  // −1 where none.
  void row(int y, std::vector<std::int16_t>& owner) const {
    const int nx = count_.x(), nz = count_.z();
    owner.assign(static_cast<std::size_t>(fine_) * nx * nz, -1);
    const std::unique_ptr<bool[]> inside(new bool[nz]);
    for (const Copy& copy : copies_) {
      const Body& body = bodies_[copy.body];
      const std::int16_t value = parts_[body.part].free ? -1 : static_cast<std::int16_t>(body.part);
      const int first_k = std::max(0, body.first.z()), last_k = std::min(nz - 1, body.last.z());
      if (first_k > last_k) continue;
      for (int line = 0; line < fine_; ++line) {
        const int j = y * fine_ + line - copy.shift_y * count_.y();
        if (j < body.first.y() || j > body.last.y()) continue;
        const int first_i = std::max(0, body.first.x() + copy.shift_x * nx);
        const int last_i = std::min(nx - 1, body.last.x() + copy.shift_x * nx);
        for (int i = first_i; i <= last_i; ++i) {
          std::int16_t* stack = owner.data() + (static_cast<std::size_t>(line) * nx + i) * nz;
          if (body.is_half_space()) {
            std::fill(stack + first_k, stack + last_k + 1, value);
            continue;
          }
          body.columns->inside(i - copy.shift_x * nx, j, first_k, last_k - first_k + 1, inside.get());
          for (int k = first_k; k <= last_k; ++k)
            if (inside[k - first_k]) stack[k] = value;
        }
      }
    }
  }

  // Signed distance of the composed bodies, negative inside, mm; at least `reach` where nothing is within that.
  double distance(const Vec3& point, double reach) const {
    double composed = infinity;
    for (const Copy& copy : copies_) {
      const Body& body = bodies_[copy.body];
      const Vec3 p = point - Vec3(copy.shift_x * options_.width, copy.shift_y * options_.height, 0) * options_.voxel;
      double own = infinity;
      if (body.is_half_space()) {
        own = p.z() - body.level;
      } else if (((p - body.lower).array() >= -reach).all() && ((body.upper - p).array() >= -reach).all()) {
        // Deep inside a body its depth does not matter, but that it is inside does.
        const double unsigned_distance = std::sqrt(body.nearest->nearest(p).squared_distance);
        own = body.winding->inside(p) ? -unsigned_distance : unsigned_distance;
      } else {
        own = reach;
      }
      composed = parts_[body.part].free ? std::max(composed, -own) : std::min(composed, own);
    }
    return composed;
  }

  double level_of_place(int k) const { return frame_.origin.z() + k * frame_.voxel; }
  int fine() const { return fine_; }
  const Vec3i& count() const { return count_; }

  // To be called when all bodies are in place: winding numbers keep a reference to their mesh.
  void prepare_distances() {
    for (Body& body : bodies_)
      if (!body.is_half_space()) body.winding = std::make_unique<WindingNumber>(body.mesh);
  }

 private:
  void add(int part_index) {
    const ScanPart& part = parts_[part_index];
    for (const PartPlacement& placement : part.placements) {
      Body body;
      body.part = part_index;
      const int index = static_cast<int>(bodies_.size());
      if (part.mesh.face_count() == 0) {
        body.level = placement.position.z();
        const double top = (body.level - frame_.origin.z()) / frame_.voxel;
        body.first = Vec3i::Zero();
        body.last = Vec3i(count_.x() - 1, count_.y() - 1,
                          static_cast<int>(std::floor(std::clamp(top, -1.0, static_cast<double>(count_.z())))));
        copies_.push_back({index, 0, 0});
        bodies_.push_back(std::move(body));
        continue;
      }
      body.mesh = place(part, placement);
      body.lower = body.mesh.vertices.colwise().minCoeff().transpose();
      body.upper = body.mesh.vertices.colwise().maxCoeff().transpose();
      const Vec3 period(options_.width * options_.voxel, options_.height * options_.voxel, 0);
      if (!((body.upper - body.lower).head<2>().array() <= 64 * period.head<2>().array()).all() ||
          !(body.lower.array().abs() < 1e6 * period.x()).all() || !(body.upper.array().abs() < 1e6 * period.x()).all())
        throw InputError(
            fmt::format("part {} reaches from ({:.4g}, {:.4g}, {:.4g}) to ({:.4g}, {:.4g}, {:.4g}) mm, far beyond a "
                        "sample of {:.4g} by "
                        "{:.4g} mm; give it a scale",
                        part_index, body.lower.x(), body.lower.y(), body.lower.z(), body.upper.x(), body.upper.y(),
                        body.upper.z(), period.x(), period.y()));
      // Bodies stand in the first period in x and y, by whole periods.
      Vec3 home = Vec3::Zero();
      for (int axis = 0; axis < 2; ++axis) home[axis] = -period[axis] * std::floor(body.lower[axis] / period[axis]);
      for (int v = 0; v < body.mesh.vertex_count(); ++v) body.mesh.vertices.row(v) += home.transpose();
      body.lower += home, body.upper += home;
      // Far above and below the sample it does not matter where.
      Vec3 first = frame_.to_index(body.lower).array().ceil(), last = frame_.to_index(body.upper).array().floor();
      first.z() = std::clamp(first.z(), -1.0, static_cast<double>(count_.z()));
      last.z() = std::clamp(last.z(), -1.0, static_cast<double>(count_.z()));
      body.first = first.cast<int>();
      // At least one line, so that bodies between lines are no exception.
      body.last = last.cwiseMax(first).cast<int>();
      const Vec3 lines = (body.last - body.first).cast<double>();
      if (lines.x() * lines.y() > 5e7)
        throw InputError(fmt::format("part {} is {:.4g} by {:.4g} voxels wide, too large for a sample", part_index,
                                     lines.x() / fine_, lines.y() / fine_));
      body.columns = std::make_unique<WindingColumns>(body.mesh, frame_, body.first, body.last);
      body.nearest = std::make_unique<ClosestPointQuery>(body.mesh);
      bodies_.push_back(std::move(body));
      const Body& kept = bodies_.back();
      // It may touch the sample's border from beyond: distances look two voxels far.
      const Vec3 margin = Vec3::Constant(2 * options_.voxel);
      for (int sy = -static_cast<int>(std::ceil((kept.upper + margin).y() / period.y())); sy <= 1; ++sy)
        for (int sx = -static_cast<int>(std::ceil((kept.upper + margin).x() / period.x())); sx <= 1; ++sx) {
          const Vec3 shift(sx * period.x(), sy * period.y(), 0);
          const Vec3 lower = kept.lower + shift - margin, upper = kept.upper + shift + margin;
          if (lower.x() < period.x() && lower.y() < period.y() && upper.x() > 0 && upper.y() > 0)
            copies_.push_back({index, sx, sy});
        }
    }
  }

  const std::vector<ScanPart>& parts_;
  const ScanOptions& options_;
  int fine_;
  Vec3i count_;  // of places
  GridFrame frame_;
  std::vector<Body> bodies_;
  std::vector<Copy> copies_;  // by priority
};

}  // namespace

double highest_point(const std::vector<ScanPart>& parts) {
  double bodies = -infinity, anything = -infinity;
  for (const ScanPart& part : parts)
    for (const PartPlacement& placement : part.placements) {
      double top = placement.position.z();
      if (part.mesh.face_count() > 0) top = place(part, placement).vertices.col(2).maxCoeff();
      anything = std::max(anything, top);
      if (!part.free) bodies = std::max(bodies, top);
    }
  return std::isfinite(bodies) ? bodies : anything;
}

ScanResult scan_convert(const std::vector<ScanPart>& parts, const ScanOptions& options) {
  const double layers = std::ceil(options.thickness / options.voxel - 1e-6);
  if (!(options.width >= 4 && options.height >= 4 && options.width <= 2048 && options.height <= 2048))
    throw InputError("sample size must lie between 4 and 2048 texels in x and y");
  if (!(options.voxel > 0) || !(layers >= 1) || !(layers <= 512))
    throw InputError(
        fmt::format("a thickness of {:.6g} mm and voxels of {:.6g} mm make {:.6g} layers; expected 1 to 512",
                    options.thickness, options.voxel, layers));
  if (options.samples_per_edge < 1 || options.samples_per_edge > 8)
    throw InputError("expected 1 to 8 samples along a voxel's edge");
  if (parts.empty() || parts.size() > 1000) throw InputError("expected 1 to 1000 parts");
  for (std::size_t i = 0; i < parts.size(); ++i) {
    if (!(parts[i].scale.array() > 0).all()) throw InputError(fmt::format("part {}: its scale is not positive", i));
    if (parts[i].mesh.face_count() > 0)
      naming(fmt::format("part {}", i), [&] { require_closed_surface(parts[i].mesh, true); });
  }
  const Vec3i size(options.width, options.height, static_cast<int>(layers));
  Model model(parts, options, size);
  model.prepare_distances();

  ScanResult result;
  MaterialSample& sample = result.sample;
  sample = allocate_sample(size, options.voxel, options.ior);
  const bool has_indices = std::any_of(parts.begin(), parts.end(), [](const ScanPart& part) { return part.ior > 0; });
  if (has_indices) sample.surface_ior.assign(sample.voxel_count(), 0.0f);
  const int fine = model.fine(), places = fine * fine * fine;
  std::vector<double> lost(size.y(), 0.0), filled(size.y(), 0.0);
  std::vector<std::vector<char>> used(size.y(), std::vector<char>(parts.size(), 0));
  parallel_for(
      static_cast<std::size_t>(size.y()),
      [&](std::size_t y) {
        std::vector<std::int16_t> owner;
        model.row(static_cast<int>(y), owner);
        const int nx = model.count().x(), nz = model.count().z();
        std::vector<int> shares(parts.size(), 0);
        std::vector<std::int16_t> present;
        for (int z = 0; z < size.z(); ++z)
          for (int x = 0; x < size.x(); ++x) {
            present.clear();
            for (int line = 0; line < fine; ++line)
              for (int i = x * fine; i < (x + 1) * fine; ++i)
                for (int k = nz - (z + 1) * fine; k < nz - z * fine; ++k) {
                  const std::int16_t part = owner[(static_cast<std::size_t>(line) * nx + i) * nz + k];
                  if (part < 0) continue;
                  if (shares[part]++ == 0) present.push_back(part);
                }
            std::sort(present.begin(), present.end());
            Composition composition;
            std::int16_t most = -1;
            for (std::int16_t part : present) {
              composition.add(parts[part].material, static_cast<double>(shares[part]) / places);
              if (most < 0 || shares[part] > shares[most]) most = part;
            }
            for (std::int16_t part : present) shares[part] = 0, used[y][part] = 1;
            const std::size_t index = sample.index(x, static_cast<int>(y), z);
            filled[y] += composition.share();
            if (composition.share() < 0.5) {
              sample.kind[index] = VoxelKind::free_space;
              lost[y] += composition.share();
              continue;
            }
            store_material(sample, index, composition.material());
            if (has_indices)
              sample.surface_ior[index] = static_cast<float>(parts[most].ior > 0 ? parts[most].ior : options.ior);
          }
      },
      1);
  const double all = std::accumulate(filled.begin(), filled.end(), 0.0);
  if (!(all > 0))
    throw InputError(
        fmt::format("no part lies in the sample, {:.4g} mm thick below z = {:.4g} mm", options.thickness, options.top));
  for (std::size_t part = 0; part < parts.size(); ++part)
    if (!parts[part].free &&
        std::none_of(used.begin(), used.end(), [&](const std::vector<char>& row) { return row[part] != 0; }))
      result.unused.push_back(static_cast<int>(part));
  result.lost_material = std::accumulate(lost.begin(), lost.end(), 0.0) / all;
  result.above_top = std::max(0.0, highest_point(parts) - options.top);

  mark_surface(sample);
  parallel_for(
      sample.voxel_count(),
      [&](std::size_t i) {
        if (sample.kind[i] != VoxelKind::surface) {
          if (has_indices) sample.surface_ior[i] = 0;
          return;
        }
        const int x = static_cast<int>(i % size.x()), y = static_cast<int>(i / size.x() % size.y());
        const int z = static_cast<int>(i / size.x() / size.y());
        const Vec3 centre(options.voxel * (x + 0.5), options.voxel * (y + 0.5),
                          options.top - options.voxel * (z + 0.5));
        const double step = 0.5 * options.voxel, reach = 2 * options.voxel;
        Vec3 gradient;
        for (int axis = 0; axis < 3; ++axis)
          gradient[axis] = model.distance(centre + step * Vec3::Unit(axis), reach) -
                           model.distance(centre - step * Vec3::Unit(axis), reach);
        // Where bodies were cut off by the top, or at needles' tips, the occupancy's normal stays.
        if (gradient.allFinite() && gradient.norm() > 0.3 * options.voxel)
          sample.normal[i] = Vec3(gradient.x(), gradient.y(), -gradient.z()).normalized().cast<float>();
      },
      64);
  return result;
}

}  // namespace shellgrid
