// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/volume_classification.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "meshing/core/error.h"
#include "synthesis/sample_builder.h"

namespace shellgrid {
namespace {

// Two classes and the second one's share.
struct Mixture {
  std::size_t first, second;
  double second_share;
};

// By the value alone. Source: [Levoy1988 eq. 4], without the gradient.
Mixture classify(const std::vector<VoxelClass>& classes, double value) {
  for (std::size_t i = 0; i + 1 < classes.size(); ++i) {
    if (value <= classes[i].to) return {i, i, 0};
    if (value < classes[i + 1].from) return {i, i + 1, (value - classes[i].to) / (classes[i + 1].from - classes[i].to)};
  }
  return {classes.size() - 1, classes.size() - 1, 0};
}

void check_classes(const std::vector<VoxelClass>& classes) {
  if (classes.empty()) throw InputError("expected at least one class of voxels");
  for (std::size_t i = 0; i < classes.size(); ++i) {
    if (!(classes[i].from <= classes[i].to))
      throw InputError(
          fmt::format("class {} ends at {:.6g}, before it begins at {:.6g}", i, classes[i].to, classes[i].from));
    if (i > 0 && !(classes[i - 1].to < classes[i].from))
      throw InputError(
          fmt::format("class {} begins at {:.6g}, not above the end {:.6g} of the class before; give classes "
                      "by rising value",
                      i, classes[i].from, classes[i - 1].to));
  }
}

// The volume in the sample's axes: depth last and downwards.
ScalarVolume turned(const ScalarVolume& volume, int down, bool descend, bool mirror) {
  const int first = down == 0 ? 1 : 0, second = down == 2 ? 1 : 2;
  ScalarVolume result;
  result.size = Vec3i(volume.size[first], volume.size[second], volume.size[down]);
  result.spacing = Vec3(volume.spacing[first], volume.spacing[second], volume.spacing[down]);
  const int nx = result.size.x(), ny = result.size.y();
  if (mirror) result.size.x() *= 2, result.size.y() *= 2;
  if (result.size.cast<double>().prod() > 2e8) throw InputError("the volume is too large; expected at most 2e8 values");
  result.values.resize(result.count());
  parallel_for(result.count(), [&](std::size_t i) {
    const int x = static_cast<int>(i % result.size.x()), y = static_cast<int>(i / result.size.x() % result.size.y());
    const int z = static_cast<int>(i / result.size.x() / result.size.y());
    Vec3i at;
    at[first] = x < nx ? x : 2 * nx - 1 - x, at[second] = y < ny ? y : 2 * ny - 1 - y,
    at[down] = descend ? z : result.size.z() - 1 - z;
    result.values[i] = volume.at(at.x(), at.y(), at.z());
  });
  return result;
}

// Trilinear; outside the grid points the nearest counts. place: in grid intervals from the first point.
double interpolate(const ScalarVolume& volume, const Vec3& place) {
  int low[3], high[3];
  double share[3];
  for (int axis = 0; axis < 3; ++axis) {
    const double at = std::clamp(place[axis], 0.0, static_cast<double>(volume.size[axis] - 1));
    low[axis] = static_cast<int>(at);
    high[axis] = std::min(low[axis] + 1, volume.size[axis] - 1);
    share[axis] = at - low[axis];
  }
  double sum = 0;
  for (int corner = 0; corner < 8; ++corner) {
    double weight = 1;
    int at[3];
    for (int axis = 0; axis < 3; ++axis) {
      const bool upper = corner >> axis & 1;
      at[axis] = upper ? high[axis] : low[axis];
      weight *= upper ? share[axis] : 1 - share[axis];
    }
    if (weight > 0) sum += weight * volume.at(at[0], at[1], at[2]);
  }
  return sum;
}

// Where a place lies on a border, by the values at the border's two ends, else by its own value.
Mixture classify_place(const ScalarVolume& volume, const std::vector<VoxelClass>& classes, const Vec3& place) {
  const double value = interpolate(volume, place);
  const Mixture by_value = classify(classes, value);
  if (classes.size() < 3) return by_value;
  Vec3 gradient;
  for (int axis = 0; axis < 3; ++axis)
    gradient[axis] =
        0.5 * (interpolate(volume, place + Vec3::Unit(axis)) - interpolate(volume, place - Vec3::Unit(axis)));
  if (gradient.norm() < 1e-12) return by_value;
  const Vec3 uphill = gradient.normalized();
  const auto end = [&](double direction) {
    double reached = value;
    for (double step = 0.5; step <= 3; step += 0.5) {
      const double next = interpolate(volume, place + direction * step * uphill);
      if ((next - reached) * direction <= 0) break;
      reached = next;
    }
    return reached;
  };
  const auto nearest = [&](double at) {
    const Mixture mixture = classify(classes, at);
    return mixture.second_share < 0.5 ? mixture.first : mixture.second;
  };
  const std::size_t low = nearest(end(-1)), high = nearest(end(1));
  if (high <= low) return by_value.first == by_value.second ? by_value : Mixture{low, low, 0};
  return {low, high, std::clamp((value - classes[low].to) / (classes[high].from - classes[low].to), 0.0, 1.0)};
}

// Marks as free space what has too little material and is reached from the top, or from another such voxel; x and y
// wrap around. Returns how many voxels with too little material are not reached.
std::size_t open_free_space(MaterialSample& sample, const std::vector<float>& material, double surface) {
  const Vec3i n = sample.size;
  const auto sparse = [&](std::size_t i) { return material[i] < surface; };
  std::vector<std::size_t> stack;
  const auto reach = [&](std::size_t i) {
    if (sample.kind[i] == VoxelKind::free_space || !sparse(i)) return;
    sample.kind[i] = VoxelKind::free_space;
    stack.push_back(i);
  };
  for (std::size_t i = 0; i < static_cast<std::size_t>(n.x()) * n.y(); ++i) reach(i);
  while (!stack.empty()) {
    const std::size_t i = stack.back();
    stack.pop_back();
    const int x = static_cast<int>(i % n.x()), y = static_cast<int>(i / n.x() % n.y());
    const int z = static_cast<int>(i / n.x() / n.y());
    reach(sample.index((x + 1) % n.x(), y, z));
    reach(sample.index((x + n.x() - 1) % n.x(), y, z));
    reach(sample.index(x, (y + 1) % n.y(), z));
    reach(sample.index(x, (y + n.y() - 1) % n.y(), z));
    if (z + 1 < n.z()) reach(sample.index(x, y, z + 1));
    if (z > 0) reach(sample.index(x, y, z - 1));
  }
  std::size_t enclosed = 0;
  for (std::size_t i = 0; i < sample.voxel_count(); ++i)
    enclosed += sample.kind[i] != VoxelKind::free_space && sparse(i);
  return enclosed;
}

}  // namespace

ClassificationResult classify_volume(const ScalarVolume& measured, const ClassificationOptions& options) {
  check_classes(options.classes);
  const ScalarVolume volume = turned(measured, options.down, options.descend, options.mirror);
  const double voxel = options.voxel > 0 ? options.voxel : volume.spacing.minCoeff();
  Vec3 count;
  for (int axis = 0; axis < 3; ++axis)
    count[axis] = std::max(1.0, std::floor(volume.size[axis] * volume.spacing[axis] / voxel + 1e-6));
  if (!(count.x() >= 4 && count.y() >= 4 && count.x() <= 4096 && count.y() <= 4096 && count.z() <= 4096) ||
      count.prod() > 2e8)
    throw InputError(
        fmt::format("{} x {} x {} values, {:.4g} x {:.4g} x {:.4g} mm apart, make {:.6g} x {:.6g} x {:.6g} voxels of "
                    "{:.4g} mm; a sample "
                    "has 4 at least in x and y, 4096 along an axis and 2e8 at most in all",
                    volume.size.x(), volume.size.y(), volume.size.z(), volume.spacing.x(), volume.spacing.y(),
                    volume.spacing.z(), count.x(), count.y(), count.z(), voxel));
  ClassificationResult result;
  MaterialSample& sample = result.sample;
  sample = allocate_sample(count.cast<int>(), voxel, options.ior);

  // Places a voxel is asked at: as many along each axis as it covers measured ones.
  Vec3i places;
  for (int axis = 0; axis < 3; ++axis)
    places[axis] = std::clamp(static_cast<int>(std::lround(voxel / volume.spacing[axis])), 1, 16);
  const std::size_t classes = options.classes.size();
  std::vector<float> shares(sample.voxel_count() * classes, 0.0f);
  std::vector<float> material(sample.voxel_count(), 0.0f);
  for_each_voxel(sample, [&](std::size_t index, const Vec3& centre) {
    float* own = shares.data() + index * classes;
    const float weight = 1.0f / static_cast<float>(places.prod());
    for (int k = 0; k < places.z(); ++k)
      for (int j = 0; j < places.y(); ++j)
        for (int i = 0; i < places.x(); ++i) {
          const Vec3 offset((i + 0.5) / places.x() - 0.5, (j + 0.5) / places.y() - 0.5, (k + 0.5) / places.z() - 0.5);
          // A measured value stands in the middle of its cell.
          const Vec3 place = ((centre + offset) * voxel).cwiseQuotient(volume.spacing) - Vec3::Constant(0.5);
          const Mixture mixture = options.trace_borders ? classify_place(volume, options.classes, place)
                                                        : classify(options.classes, interpolate(volume, place));
          own[mixture.first] += weight * static_cast<float>(1 - mixture.second_share);
          own[mixture.second] += weight * static_cast<float>(mixture.second_share);
        }
    for (std::size_t c = 0; c < classes; ++c)
      if (!options.classes[c].free) material[index] += own[c];
  });
  result.shares.assign(classes, 0.0);
  for (std::size_t c = 0; c < classes; ++c)
    result.shares[c] =
        parallel_sum(sample.voxel_count(), 0.0, [&](std::size_t i) { return double{shares[i * classes + c]}; }) /
        static_cast<double>(sample.voxel_count());

  const std::size_t enclosed = open_free_space(sample, material, options.surface);
  const std::size_t open =
      static_cast<std::size_t>(std::count(sample.kind.begin(), sample.kind.end(), VoxelKind::free_space));
  if (open == sample.voxel_count()) throw InputError("no voxel holds material; check the values of the classes");
  result.enclosed_free = enclosed > 0 ? static_cast<double>(enclosed) / static_cast<double>(enclosed + open) : 0;

  const Vec3i n = sample.size;
  std::vector<Vec3f> outward(sample.voxel_count());
  for_each_voxel(sample, [&](std::size_t index, const Vec3& centre) {
    if (sample.kind[index] == VoxelKind::free_space) return;
    const int x = static_cast<int>(centre.x()), y = static_cast<int>(centre.y()), z = static_cast<int>(centre.z());
    // Where the surface runs through a voxel, what is matter there is whole; bubbles thin their surroundings.
    bool at_surface = z == 0;
    Vec3f gradient = Vec3f::Zero();
    for (int dz = -1; dz <= 1; ++dz)
      for (int dy = -1; dy <= 1; ++dy)
        for (int dx = -1; dx <= 1; ++dx) {
          const int below = std::min(z + dz, n.z() - 1);
          const std::size_t at =
              below < 0 ? 0 : sample.index((x + dx + n.x()) % n.x(), (y + dy + n.y()) % n.y(), below);
          // Above the top nothing is known where the surface itself is cut off: as it is below.
          const float there = below < 0 ? (material[index] > 0.999f ? 0.0f : material[index]) : material[at];
          at_surface |= below >= 0 && sample.kind[at] == VoxelKind::free_space;
          const float weight = static_cast<float>((2 - std::abs(dx)) * (2 - std::abs(dy)) * (2 - std::abs(dz)));
          gradient += weight * there * Vec3f(static_cast<float>(dx), static_cast<float>(dy), static_cast<float>(dz));
        }
    outward[index] = gradient.norm() > 1e-4f ? Vec3f(-gradient.normalized()) : Vec3f(0, 0, -1);
    Composition composition;
    for (std::size_t c = 0; c < classes; ++c) {
      const float share = shares[index * classes + c];
      if (share > 0 && !(options.classes[c].free && at_surface)) composition.add(options.classes[c].material, share);
    }
    store_material(sample, index, composition.material());
  });
  mark_surface(sample, &outward);
  return result;
}

}  // namespace shellgrid
