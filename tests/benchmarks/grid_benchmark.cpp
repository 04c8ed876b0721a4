// SPDX-License-Identifier: AGPL-3.0-or-later
// Look-ups in the two-level grid beside OpenVDB's and NanoVDB's accessors: the same distance field, the same places,
// one thread, medians in one run, taken in turn.
//   grid_benchmark [mesh.off]     default assets/meshes/bunny00.off
// Prints CSV. Places: `random` anywhere in the box; `band` at random in the band; `rays` steps of one interval along
// rays that cross the box. `bytes_over_leaves` is a grid's memory over that of its samples in leaves; `ratio` is the
// time over this project's; `differing` counts look-ups whose value is not the same to rounding.
// `two-level runs` is the two-level grid read by read_samples, many places in one call, which the others do not offer.
// `walk`: the nearest samples along rays, from their origin and step: read_samples_along beside working out each place
// for an accessor.
// `march`: the same rays as a whole, for the nearest samples in leaves: empty leaves are skipped by this project's
// LeafMarch, OpenVDB's VolumeRayIntersector, NanoVDB's TreeMarcher, or not at all (`look-ups`: the two-level grid's
// accessor at every step). Nanoseconds a step of the ray; `differing` is the difference in samples met, in samples.
#include <fmt/format.h>
#include <nanovdb/util/HDDA.h>
#include <nanovdb/util/OpenToNanoVDB.h>
#include <nanovdb/util/Ray.h>
#include <nanovdb/util/SampleFromVoxels.h>
#include <openvdb/openvdb.h>
#include <openvdb/tools/Interpolation.h>
#include <openvdb/tools/RayIntersector.h>

#include <cmath>

#include "meshing/core/error.h"
#include "meshing/core/random.h"
#include "meshing/distance/distance_field.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/shell/leaf_march.h"
#include "meshing/shell/sample_runs.h"
#include "tests/support/timing.h"

using namespace shellgrid;

namespace {

struct Places {
  const char* name;
  std::vector<Vec3f> points;   // continuous indices
  std::vector<Vec3i> nearest;  // the grid points nearest to them
};

Vec3 draw_in(RandomStream& random, const Vec3& lower, const Vec3& upper) {
  const double x = random.next(), y = random.next(), z = random.next();
  return lower.array() + Vec3(x, y, z).array() * (upper - lower).array();
}

std::vector<Places> make_places(const TwoLevelGrid<float>& grid, std::size_t count) {
  const Vec3 lower = 8.0 * grid.lower_leaf().cast<double>();
  const Vec3 upper = lower + 8.0 * grid.leaf_counts().cast<double>();
  std::vector<Vec3i> active;
  grid.for_each_active([&](int i, int j, int k, float) { active.emplace_back(i, j, k); });
  std::vector<Places> all{{"random", {}, {}}, {"band", {}, {}}, {"rays", {}, {}}};
  RandomStream random(72);
  while (all[0].points.size() < count) all[0].points.push_back(draw_in(random, lower, upper).cast<float>());
  while (all[1].points.size() < count) {
    const Vec3i& sample = active[static_cast<std::size_t>(random.next() * static_cast<double>(active.size()))];
    all[1].points.push_back((sample.cast<double>() + draw_in(random, Vec3::Zero(), Vec3::Ones())).cast<float>());
  }
  while (all[2].points.size() < count) {
    const Vec3 from = draw_in(random, lower, upper);
    const Vec3 step = (draw_in(random, lower, upper) - from).normalized();
    for (int n = 0; all[2].points.size() < count; ++n) {
      const Vec3 p = from + n * step;
      if ((p.array() < lower.array()).any() || (p.array() > upper.array()).any()) break;
      all[2].points.push_back(p.cast<float>());
    }
  }
  for (Places& places : all)
    for (const Vec3f& p : places.points) places.nearest.push_back((p.array() + 0.5f).floor().cast<int>());
  return all;
}

struct Ray {
  Vec3 origin, step;
  int count;
};

// Straight across the box.
std::vector<Ray> make_rays(const TwoLevelGrid<float>& grid, std::size_t count) {
  const Vec3 lower = 8.0 * grid.lower_leaf().cast<double>();
  const Vec3 upper = lower + 8.0 * grid.leaf_counts().cast<double>();
  RandomStream random(73);
  std::vector<Ray> rays;
  while (rays.size() < count) {
    const Vec3 a = draw_in(random, lower, upper), b = draw_in(random, lower, upper);
    const int steps = static_cast<int>((b - a).norm());
    if (steps > 8) rays.push_back({a, (b - a).normalized(), steps});
  }
  return rays;
}

constexpr int grids = 4;
const char* const names[grids] = {"two-level", "OpenVDB", "NanoVDB", "two-level runs"};

// What one grid takes for one kind of look-up.
struct Measurement {
  std::vector<double> seconds;
  std::vector<float> values;
};

template <class Place, class Look>
void measure(const std::vector<Place>& places, const Look& look, Measurement& result) {
  result.values.resize(places.size());
  result.seconds.push_back(test::seconds_of([&] {
    for (std::size_t n = 0; n < places.size(); ++n) result.values[n] = look(places[n]);
  }));
}

}  // namespace

int main(int argc, char** argv) {
  try {
    const std::size_t count = test::long_form() ? 8000000 : 2000000;
    const int runs = test::long_form() ? 9 : 5;
    openvdb::initialize();
    const TriangleMesh mesh = read_mesh(argc > 1 ? argv[1] : "assets/meshes/bunny00.off").mesh;
    const double length = (mesh.vertices.colwise().maxCoeff() - mesh.vertices.colwise().minCoeff()).maxCoeff();
    const double voxel = length / 256;
    DistanceStatistics statistics;
    const DistanceField field = compute_distance_field(mesh, {voxel, 10 * voxel, 3 * voxel}, statistics);
    const TwoLevelGrid<float>& ours = field.distance;
    const openvdb::FloatGrid::Ptr open = openvdb::FloatGrid::create(ours.background());
    {
      openvdb::FloatGrid::Accessor write = open->getAccessor();
      for (int leaf = 0; leaf < ours.leaf_count(); ++leaf) {
        const Vec3i base = ours.leaf_coordinate(leaf) * 8;
        openvdb::FloatTree::LeafNodeType* node = write.touchLeaf({base.x(), base.y(), base.z()});
        for (int offset = 0; offset < 512; ++offset) node->setValueOnly(offset, ours.leaf_values(leaf)[offset]);
      }
      ours.for_each_active([&](int i, int j, int k, float) { write.setValueOn({i, j, k}); });
    }
    const nanovdb::GridHandle<> handle = nanovdb::openToNanoVDB(*open);
    const nanovdb::FloatGrid& nano = *handle.grid<float>();
    const std::size_t leaf_bytes = static_cast<std::size_t>(ours.leaf_count()) * 512 * sizeof(float);
    const std::size_t bytes[grids] = {ours.bytes(), static_cast<std::size_t>(open->memUsage()),
                                      static_cast<std::size_t>(handle.size()), ours.bytes()};

    fmt::print("places,look_up,grid,mebibytes,bytes_over_leaves,nanoseconds,ratio,differing\n");
    const auto print_rows = [&](const char* places, const char* look_up, int rows, const Measurement* measurements) {
      const std::vector<float>& expected = measurements[0].values;
      for (int grid = 0; grid < rows; ++grid) {
        std::size_t differing = 0;
        for (std::size_t n = 0; n < expected.size(); ++n)
          differing += std::abs(measurements[grid].values[n] - expected[n]) > 1e-5 * voxel;
        const double time = test::median(measurements[grid].seconds);
        fmt::print("{},{},{},{:.1f},{:.3f},{:.2f},{:.2f},{}\n", places, look_up, names[grid],
                   static_cast<double>(bytes[grid]) / (1 << 20),
                   static_cast<double>(bytes[grid]) / static_cast<double>(leaf_bytes),
                   1e9 * time / static_cast<double>(expected.size()), time / test::median(measurements[0].seconds),
                   differing);
      }
      std::fflush(stdout);
    };
    const std::vector<Places> all = make_places(ours, count);
    for (const Places& places : all) {
      const openvdb::FloatGrid::ConstAccessor open_accessor = open->getConstAccessor();
      const nanovdb::FloatGrid::AccessorType nano_accessor = nano.getAccessor();
      using NanoSampler = nanovdb::SampleFromVoxels<nanovdb::FloatGrid::AccessorType, 1, false>;
      const NanoSampler nano_sampler(nano_accessor);
      // A memory of the last leaf helps along rays only.
      TwoLevelGrid<float>::Accessor accessor(ours);
      const bool along_rays = &places == &all.back();
      for (const bool nearest : {true, false}) {
        Measurement measurements[grids];
        for (int run = 0; run < runs; ++run) {
          if (nearest) {
            if (along_rays)
              measure(
                  places.nearest, [&](const Vec3i& s) { return accessor.value(s.x(), s.y(), s.z()); }, measurements[0]);
            else
              measure(
                  places.nearest, [&](const Vec3i& s) { return ours.value(s.x(), s.y(), s.z()); }, measurements[0]);
            measure(
                places.nearest,
                [&](const Vec3i& s) {
                  return open_accessor.getValue({s.x(), s.y(), s.z()});
                },
                measurements[1]);
            measure(
                places.nearest,
                [&](const Vec3i& s) {
                  return nano_accessor.getValue({s.x(), s.y(), s.z()});
                },
                measurements[2]);
            Measurement& runs_of = measurements[3];
            runs_of.values.resize(count);
            runs_of.seconds.push_back(
                test::seconds_of([&] { read_samples(ours, places.nearest.data(), count, runs_of.values.data()); }));
          } else {
            if (along_rays)
              measure(
                  places.points, [&](const Vec3f& p) { return accessor.interpolate(p); }, measurements[0]);
            else
              measure(
                  places.points, [&](const Vec3f& p) { return ours.interpolate(p); }, measurements[0]);
            measure(
                places.points,
                [&](const Vec3f& p) {
                  return openvdb::tools::BoxSampler::sample(open_accessor, openvdb::Vec3R(p.x(), p.y(), p.z()));
                },
                measurements[1]);
            measure(
                places.points, [&](const Vec3f& p) { return nano_sampler(nanovdb::Vec3f(p.x(), p.y(), p.z())); },
                measurements[2]);
          }
        }
        print_rows(places.name, nearest ? "nearest" : "trilinear", nearest ? grids : grids - 1, measurements);
      }
    }

    const std::vector<Ray> rays = make_rays(ours, count / 100);
    double steps = 0;
    for (const Ray& ray : rays) steps += ray.count;
    const auto nearest = [](const Ray& ray, int n) -> Vec3i {
      return (ray.origin + n * ray.step).array().unaryExpr([](double x) { return std::floor(x + 0.5); }).cast<int>();
    };
    {
      Measurement measurements[grids];
      const openvdb::FloatGrid::ConstAccessor open_accessor = open->getConstAccessor();
      const nanovdb::FloatGrid::AccessorType nano_accessor = nano.getAccessor();
      TwoLevelGrid<float>::Accessor accessor(ours);
      const auto walk = [&](Measurement& result, const auto& read) {
        result.values.resize(static_cast<std::size_t>(steps));
        result.seconds.push_back(test::seconds_of([&] {
          float* to = result.values.data();
          for (const Ray& ray : rays) read(ray, to), to += ray.count;
        }));
      };
      const auto one_by_one = [&](const auto& look) {
        return [&nearest, look](const Ray& ray, float* to) {
          for (int n = 0; n < ray.count; ++n) to[n] = look(nearest(ray, n));
        };
      };
      for (int run = 0; run < runs; ++run) {
        walk(measurements[0], one_by_one([&](const Vec3i& s) { return accessor.value(s.x(), s.y(), s.z()); }));
        walk(measurements[1], one_by_one([&](const Vec3i& s) {
               return open_accessor.getValue({s.x(), s.y(), s.z()});
             }));
        walk(measurements[2], one_by_one([&](const Vec3i& s) {
               return nano_accessor.getValue({s.x(), s.y(), s.z()});
             }));
        walk(measurements[3],
             [&](const Ray& ray, float* to) { read_samples_along(ours, ray.origin, ray.step, ray.count, to); });
      }
      print_rows("rays", "walk", grids, measurements);
    }
    const char* const methods[4] = {"two-level", "OpenVDB", "NanoVDB", "look-ups"};
    std::vector<double> seconds[4];
    double met[4];
    openvdb::tools::VolumeRayIntersector<openvdb::FloatGrid> intersector(*open);
    for (int run = 0; run < runs; ++run)
      for (int method = 0; method < 4; ++method) {
        double sum = 0;
        std::int64_t samples = 0;
        seconds[method].push_back(test::seconds_of([&] {
          const openvdb::FloatGrid::ConstAccessor open_accessor = open->getConstAccessor();
          nanovdb::FloatGrid::AccessorType nano_accessor = nano.getAccessor();
          TwoLevelGrid<float>::Accessor accessor(ours);
          for (const Ray& ray : rays) {
            const double last = ray.count - 1;
            if (method == 0) {
              for_each_sample_along(ours, ray.origin, ray.step, ray.count, [&](int, float value) {
                sum += value;
                ++samples;
              });
            } else if (method == 1) {
              // Its voxels reach from their index to the next.
              const openvdb::math::Ray<double> line(
                  openvdb::Vec3d(ray.origin.x() + 0.5, ray.origin.y() + 0.5, ray.origin.z() + 0.5),
                  openvdb::Vec3d(ray.step.x(), ray.step.y(), ray.step.z()), 1e-9, last);
              if (!intersector.setIndexRay(line)) continue;
              double begin = 0, end = 0;
              int next = 0;
              while (intersector.march(begin, end)) {
                next = std::max(next, static_cast<int>(std::ceil(begin)));
                for (; next <= end && next < ray.count; ++next) {
                  const Vec3i at = nearest(ray, next);
                  sum += open_accessor.getValue({at.x(), at.y(), at.z()});
                  ++samples;
                }
              }
            } else if (method == 2) {
              using NanoRay = nanovdb::Ray<float>;
              using Leaf = nanovdb::NanoLeaf<float>;
              const NanoRay line(
                  nanovdb::Vec3f(static_cast<float>(ray.origin.x() + 0.5), static_cast<float>(ray.origin.y() + 0.5),
                                 static_cast<float>(ray.origin.z() + 0.5)),
                  nanovdb::Vec3f(static_cast<float>(ray.step.x()), static_cast<float>(ray.step.y()),
                                 static_cast<float>(ray.step.z())),
                  0.0f, static_cast<float>(last));
              nanovdb::TreeMarcher<Leaf, NanoRay, nanovdb::FloatGrid::AccessorType> marcher(nano_accessor);
              if (!marcher.init(line)) continue;
              const Leaf* leaf = nullptr;
              float begin = 0, end = 0;
              int next = 0;
              while (marcher.step(&leaf, begin, end)) {
                next = std::max(next, static_cast<int>(std::ceil(begin)));
                for (; static_cast<float>(next) <= end && next < ray.count; ++next) {
                  const Vec3i at = nearest(ray, next);
                  sum += leaf->getValue(nanovdb::Coord(at.x(), at.y(), at.z()));
                  ++samples;
                }
              }
            } else {
              for (int n = 0; n < ray.count; ++n) {
                const Vec3i at = nearest(ray, n);
                const float value = accessor.value(at.x(), at.y(), at.z());
                sum += value;
                samples += ours.find_leaf(TwoLevelGrid<float>::leaf_of(at.x(), at.y(), at.z())) >= 0;
              }
            }
          }
        }));
        [[maybe_unused]] volatile double kept = sum;  // or the reads may be left out
        met[method] = static_cast<double>(samples);
      }
    for (int method = 0; method < 4; ++method)
      fmt::print("rays,march,{},{:.1f},{:.3f},{:.2f},{:.2f},{:.0f}\n", methods[method],
                 static_cast<double>(bytes[method % 3]) / (1 << 20),
                 static_cast<double>(bytes[method % 3]) / static_cast<double>(leaf_bytes),
                 1e9 * test::median(seconds[method]) / steps, test::median(seconds[method]) / test::median(seconds[0]),
                 met[method] - met[0]);
    return 0;
  } catch (const InputError& error) {
    fmt::print(stderr, "grid_benchmark: error: {}\n", error.what());
    return 3;
  }
}
