// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/spread_light.h"

#ifdef __AVX512F__
#include <immintrin.h>
#endif

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"

namespace shellgrid {

namespace {

using Lanes = BandKernels::Lanes;

constexpr double counted_share = 0.97;  // of a kernel's light
constexpr int cells_a_radius = 4;
constexpr int reach = cells_a_radius + 1;
constexpr std::size_t looked_at = 500;  // texels, for means of the sample
constexpr double apart = 0.8;           // buckets farther off than so many cells count as wholes
constexpr double sudden = 0.1;          // of the brightest: a difference within a cell that may be a shadow's

// Kernels of light that enters evenly on a square of that edge, about as on a disc: by the distance to its middle.
IrradianceKernels spread_out(const IrradianceKernels& kernel, double edge) {
  constexpr int across = 8;
  IrradianceKernels result = kernel;
  for (int row = 0; row < kernel.count() * kernel.bands(); ++row)
    for (int ring = 0; ring < kernel.rings; ++ring) {
      const double distance = (ring + 0.5) * kernel.ring;
      Vec3f sum = Vec3f::Zero();
      for (int x = 0; x < across; ++x)
        for (int y = 0; y < across; ++y)
          sum +=
              kernel.value(row / kernel.bands(), row % kernel.bands(),
                           std::hypot(distance + ((x + 0.5) / across - 0.5) * edge, ((y + 0.5) / across - 0.5) * edge));
      result.values[static_cast<std::size_t>(row) * kernel.rings + ring] = sum / (across * across);
    }
  return result;
}

}  // namespace

IrradianceKernels corrected_by(const IrradianceKernels& kernels, IrradianceCorrection correction) {
  if (correction == IrradianceCorrection::none) return {};
  return correction == IrradianceCorrection::one_kernel ? kernels.merged() : kernels;
}

std::vector<Vec3f> band_responses(const ShellTextureLookup& texture, bool bottom_alone) {
  const IrradianceKernels& kernels = texture.kernels();
  if (kernels.empty()) return {};
  const int directions = texture.directions().count();
  const Vec3i& size = texture.size();
  const auto texels = static_cast<std::size_t>(size.x()) * size.y();
  std::vector<Vec3f> result(static_cast<std::size_t>(kernels.bands()) * directions, Vec3f::Zero());
  std::vector<int> band_of_layer;
  for (int z = 0; z < size.z(); ++z) band_of_layer.push_back(kernels.band_of(z));
  parallel_for(
      static_cast<std::size_t>(directions),
      [&](std::size_t d) {
        const auto to = [&](int band) -> Vec3f& { return result[static_cast<std::size_t>(band) * directions + d]; };
        const auto direction = static_cast<int>(d);
        const Vec3f* const below = texture.below().data() + d * texels;
        for (std::size_t t = 0; t < texels; ++t) to(kernels.bottom()) += below[t] / static_cast<float>(texels);
        if (bottom_alone) {
          for (int band = 0; band < kernels.bottom(); ++band)
            to(band).setConstant(static_cast<float>(texture.directions().direction(direction).z()));
          return;
        }
        const auto reader = texture.reader();
        const PreparedLight light = texture.prepare({{direction, Vec3f::Ones()}});
        std::vector<float> matter(static_cast<std::size_t>(kernels.bands()), 0.0f);
        const std::size_t step = std::max<std::size_t>(1, texels / looked_at) | 1;
        for (int z = 0; z < size.z(); ++z)
          for (std::size_t t = static_cast<std::size_t>(z) % step; t < texels; t += step) {
            const std::size_t voxel = z * texels + t;
            const float share = texture.matter()[voxel];
            if (!(share > 0) || band_of_layer[z] >= kernels.bottom()) continue;
            to(band_of_layer[z]) += share * reader->voxel_light(voxel, light).multiple.cwiseMax(0);
            matter[band_of_layer[z]] += share;
          }
        for (int band = 0; band < kernels.bottom(); ++band)
          if (matter[band] > 0) to(band) /= matter[band];
      },
      1);
  return result;
}

SpreadLight::SpreadLight(const IncidentLight& incident, const IrradianceKernels& kernels, const Vec3i& sample,
                         const std::vector<Vec2f>& coordinates, const std::vector<Vec3f>& responses)
    : incident_(incident), kernels_(kernels), sample_(sample), coordinates_(coordinates) {
  const TriangleMesh& mesh = incident.frames().mesh;
  const auto n = static_cast<std::size_t>(mesh.vertex_count());
  entries_.resize(n);
  if (kernels.empty()) return;
  if (coordinates.size() != n) throw InputError("the surface's texture coordinates do not have its size");
  if (!kernels.is_sound(sample)) throw InputError("the irradiance kernels do not fit the sample");
  radius_ = kernels.radius(counted_share);
  edge_ = radius_ / cells_a_radius;
  areas_ = vertex_areas(mesh);
  const IrradianceKernels whole = spread_out(kernels, edge_);
  const int directions = incident.directions().count();
  if (!responses.empty() && responses.size() != static_cast<std::size_t>(kernels.bands()) * directions)
    throw InputError("the bands' responses do not fit the irradiance kernels");
  const auto prepare = [&](Reach& reach, int first, int end) {
    reach.point = BandKernels(kernels, first, end);
    reach.whole = BandKernels(whole, first, end);
    const int wide = reach.point.wide();
    reach.response.assign(static_cast<std::size_t>(directions) * wide, Lanes{});
    for (int d = 0; d < directions; ++d)
      for (int band = first; band < end; ++band)
        for (int c = 0; c < 3; ++c)
          reach.response[static_cast<std::size_t>(d) * wide + (band - first) / 4][4 * ((band - first) % 4) + c] =
              responses.empty() ? static_cast<float>(incident.directions().direction(d).z())
                                : responses[static_cast<std::size_t>(band) * directions + d][c];
  };
  prepare(within_, 0, kernels.bottom());
  prepare(bottom_, kernels.bottom(), kernels.bands());
  buckets_ = VertexBuckets(incident.frames(), areas_, edge_);
  const auto count = static_cast<std::size_t>(buckets_.count());
  kernel_areas_.resize(count);
  parallel_for(count, [&](std::size_t b) {
    std::vector<float> areas(kernels.count(), 0.0f);
    for (const int v : buckets_[static_cast<int>(b)].members) areas[kernel_of(v)] += areas_[v];
    for (int k = 0; k < kernels.count(); ++k)
      if (areas[k] > 0) kernel_areas_[b].emplace_back(k, areas[k]);
  });
  lit_.resize(count);
  for (Reach* reach : {&within_, &bottom_}) {
    reach->lit.resize(count);
    reach->even = std::vector<std::atomic<std::uint8_t>>(count);
    reach->even_about = std::vector<std::atomic<std::uint8_t>>(count);
  }
  about_.resize(count);
}

const SpreadLight::Entry& SpreadLight::entry(int vertex) const {
  return entries_.get(vertex, [&] {
    Entry made{incident_.at(vertex), Vec3f::Zero()};
    for (const DirectionWeight& one : made.light)
      made.irradiance += one.weight * static_cast<float>(incident_.directions().direction(one.direction).z());
    return made;
  });
}

const std::vector<DirectionWeight>& SpreadLight::at(int vertex) const { return entry(vertex).light; }

namespace {

// A colour four times.
Lanes four_times(const Float4& colour) {
#ifdef __AVX512F__
  return reinterpret_cast<Lanes>(_mm512_broadcast_f32x4(reinterpret_cast<__m128>(colour)));
#else
  const float r = colour[0], g = colour[1], b = colour[2];
  const Lanes wide = {r, g, b, 0, r, g, b, 0, r, g, b, 0, r, g, b, 0};
  return wide;
#endif
}
Lanes four_times(const Vec3f& v) { return four_times(to_lanes(v.array())); }
Lanes four_times(const DirectionWeight& one) {
  static_assert(sizeof(DirectionWeight) == sizeof(Float4) && offsetof(DirectionWeight, weight) == sizeof(float));
  Float4 number_and_colour;
  std::memcpy(&number_and_colour, &one, sizeof one);
  return four_times(__builtin_shufflevector(number_and_colour, Float4{}, 1, 2, 3, 4));
}
// Of one of the four.
Vec3f colour(const Lanes& wide, int k) { return {wide[4 * k], wide[4 * k + 1], wide[4 * k + 2]}; }

// Lists of light summed by direction, each by so many weights, four in a register.
class LightSums {
 public:
  // Afresh, in the memory of those before.
  void begin(int directions, int sums) {
    wide_ = (sums + 3) / 4;
    weights_.assign(wide_, Lanes{});
    sums_.assign(static_cast<std::size_t>(directions) * wide_, Lanes{});
  }
  void add(const Lanes* weights, const std::vector<DirectionWeight>& light) {
    for (int w = 0; w < wide_; ++w) weights_[w] += weights[w];
    for (const DirectionWeight& one : light) {
      const Lanes all = four_times(one);
      Lanes* sum = sums_.data() + static_cast<std::size_t>(one.direction) * wide_;
      for (int w = 0; w < wide_; ++w) sum[w] += weights[w] * all;
    }
  }
  // Whether anything was added with a weight.
  bool any(int sum) const { return (weight(sum).array() > 0).any(); }
  std::vector<DirectionWeight> mean(int sum) const {
    const Vec3f over = weight(sum);
    const auto at = [&](int d) { return colour(sums_[static_cast<std::size_t>(d) * wide_ + sum / 4], sum % 4); };
    const auto directions = static_cast<int>(sums_.size()) / wide_;
    int lit = 0;
    for (int d = 0; d < directions; ++d) lit += (at(d).array() > 0).any();
    std::vector<DirectionWeight> list;
    list.reserve(static_cast<std::size_t>(lit));
    for (int d = 0; d < directions; ++d)
      if ((at(d).array() > 0).any())
        list.push_back({d, (over.array() > 0).select(at(d).array() / over.array().max(1e-30f), 0.0f)});
    return list;
  }

 private:
  Vec3f weight(int sum) const { return colour(weights_[sum / 4], sum % 4); }

  int wide_ = 0;
  std::vector<Lanes> weights_, sums_;
};

// Kept by each thread: allocated anew for every place, aligned memory among lists that stay leaves gaps.
LightSums& kept_sums(int directions, int sums) {
  thread_local LightSums kept;
  kept.begin(directions, sums);
  return kept;
}
std::vector<Lanes>& kept_weights() {
  thread_local std::vector<Lanes> kept;
  kept.clear();
  return kept;
}

}  // namespace

BandKernels::BandKernels(const IrradianceKernels& kernels, int first_band, int end_band)
    : bands_(end_band - first_band), rings_(kernels.rings), per_ring_(static_cast<float>(1 / kernels.ring)) {
  values_.assign(static_cast<std::size_t>(kernels.count()) * (rings_ + 1) * wide(), Lanes{});
  for (int kernel = 0; kernel < kernels.count(); ++kernel)
    for (int ring = 0; ring < rings_; ++ring)
      for (int band = 0; band < bands_; ++band) {
        const Vec3f& value =
            kernels.values[(static_cast<std::size_t>(kernel) * kernels.bands() + first_band + band) * rings_ + ring];
        Lanes& to = values_[(static_cast<std::size_t>(kernel) * (rings_ + 1) + ring) * wide() + band / 4];
        for (int c = 0; c < 3; ++c) to[4 * (band % 4) + c] = value[c];
      }
}

void BandKernels::at(int kernel, float distance, float area, Lanes* values) const {
  const float place = std::max(0.0f, distance * per_ring_ - 0.5f);
  const int ring = std::min(static_cast<int>(std::min(place, 1e9f)), rings_), count = wide();
  const float second = area * (place - static_cast<float>(ring)), first = area - second;
  const Lanes* row = values_.data() + (static_cast<std::size_t>(kernel) * (rings_ + 1) + ring) * count;
  // Beyond the last ring there is nothing.
  if (ring == rings_) return void(std::fill_n(values, count, Lanes{}));
  for (int w = 0; w < count; ++w) values[w] = first * row[w] + second * row[count + w];
}

BandKernels BandKernels::sum(const std::vector<std::pair<int, float>>& kernel_areas) const {
  BandKernels result;
  result.bands_ = bands_;
  result.rings_ = rings_;
  result.per_ring_ = per_ring_;
  const std::size_t size = static_cast<std::size_t>(rings_ + 1) * wide();
  result.values_.assign(size, Lanes{});
  for (const auto& [kernel, area] : kernel_areas)
    for (std::size_t k = 0; k < size; ++k) result.values_[k] += area * values_[kernel * size + k];
  return result;
}

const SpreadLight::LitBucket& SpreadLight::lit(int bucket) const {
  return lit_.get(bucket, [&] {
    for (const int v : buckets_[bucket].members) entry(v);
    LightSums& sum = kept_sums(incident_.directions().count(), 1);
    LitBucket made;
    made.sources.reserve(buckets_[bucket].members.size());
    for (const int v : buckets_[bucket].members) {
      const Entry& own = entry(v);
      const Lanes area = four_times(Vec3f::Constant(areas_[v]));
      sum.add(&area, own.light);
      if (buckets_[bucket].area > 0)
        made.mean.irradiance += areas_[v] / static_cast<float>(buckets_[bucket].area) * own.irradiance;
      made.sources.push_back(
          {incident_.frames().mesh.vertex(v).cast<float>(), areas_[v], to_lanes(own.irradiance.array()), kernel_of(v)});
    }
    made.mean.light = sum.mean(0);
    return made;
  });
}

const SpreadLight::LitReach& SpreadLight::lit(int bucket, const Reach& reach) const {
  return reach.lit.get(bucket, [&] {
    const int wide = reach.point.wide();
    const std::vector<int>& members = buckets_[bucket].members;
    LitReach made{std::vector<Lanes>(wide * (members.size() + 1), Lanes{}), reach.whole.sum(kernel_areas_[bucket])};
    const auto respond = [&](const std::vector<DirectionWeight>& light, Lanes* to) {
      for (const DirectionWeight& one : light) {
        const Lanes all = four_times(one);
        const Lanes* row = reach.response.data() + static_cast<std::size_t>(one.direction) * wide;
        for (int w = 0; w < wide; ++w) to[w] += row[w] * all;
      }
    };
    respond(lit(bucket).mean.light, made.responses.data());
    for (std::size_t k = 0; k < members.size(); ++k)
      respond(entry(members[k]).light, made.responses.data() + wide * (k + 1));
    return made;
  });
}

int SpreadLight::kernel_of(int vertex) const {
  const auto wrapped = [](float place, int n) {
    const int i = static_cast<int>(std::floor(place)) % n;
    return i < 0 ? i + n : i;
  };
  const Vec2f& at = coordinates_[vertex];
  return kernels_
      .of_texel[static_cast<std::size_t>(wrapped(at.y(), sample_.y())) * sample_.x() + wrapped(at.x(), sample_.x())];
}

const std::vector<int>& SpreadLight::about(int index) const {
  return about_.get(index, [&] {
    const VertexBuckets::Bucket& bucket = buckets_[index];
    std::vector<int> list;
    buckets_.visit_about(bucket.middle, reach, [&](int other) {
      if ((buckets_[other].middle - bucket.middle).norm() - buckets_[other].radius - bucket.radius <= radius_)
        list.push_back(other);
    });
    return list;
  });
}

bool SpreadLight::is_even(int index, const Reach& reach) const {
  if (const std::uint8_t known = reach.even[index].load(std::memory_order_relaxed)) return known == 2;
  const VertexBuckets::Bucket& bucket = buckets_[index];
  const Vec3f own = lit(index).mean.irradiance;
  Vec3f brightest = own;
  const int wide = reach.whole.wide();
  std::vector<Lanes> sums(wide, Lanes{}), lights(wide, Lanes{}), weights(wide);
  for (const int other : about(index)) {
    const VertexBuckets::Bucket& about = buckets_[other];
    if (!(about.facing.dot(bucket.facing) > 0)) continue;
    const double distance = (about.middle - bucket.middle).norm();
    if (distance - about.radius > radius_) continue;
    const Vec3f light = lit(other).mean.irradiance;
    brightest = brightest.cwiseMax(light);
    lit(other, reach).whole.at(0, static_cast<float>(distance), 1, weights.data());
    const Lanes all = four_times(light);
    for (int w = 0; w < wide; ++w) {
      sums[w] += weights[w];
      lights[w] += weights[w] * all;
    }
  }
  bool even = true;
  const auto differ = [&](const Vec3f& light, double share) {
    return ((light - own).array().abs() > static_cast<float>(share) * brightest.array()).any();
  };
  for (int k = 0; k < 4 * wide && even; ++k) {
    const Vec3f sum = colour(sums[k / 4], k % 4), light = colour(lights[k / 4], k % 4);
    even = !differ((sum.array() > 0).select(light.array() / sum.array().max(1e-30f), own.array()), 0.8 * unevenness);
  }
  for (std::size_t k = 0; k < bucket.members.size() && even; ++k)
    even = !differ(entry(bucket.members[k]).irradiance, sudden);
  reach.even[index].store(even ? 2 : 1, std::memory_order_relaxed);
  return even;
}

bool SpreadLight::is_even_about(int index, const Reach& reach) const {
  if (const std::uint8_t known = reach.even_about[index].load(std::memory_order_relaxed)) return known == 2;
  bool even = true;
  buckets_.visit_about(buckets_[index].middle, 1, [&](int other) {
    even = even && (!(buckets_[other].facing.dot(buckets_[index].facing) > 0) || is_even(other, reach));
  });
  reach.even_about[index].store(even ? 2 : 1, std::memory_order_relaxed);
  return even;
}

SpreadLight::Bands SpreadLight::spread(int vertex) const {
  if (kernels_.empty()) return {};
  return worked_out(vertex, within_);
}

std::vector<DirectionWeight> SpreadLight::at_bottom(int vertex) const {
  if (kernels_.empty()) return at(vertex);
  Bands spread = worked_out(vertex, bottom_);
  if (!spread.list.empty()) return std::move(spread.list.front());
  std::vector<DirectionWeight> list = at(vertex);
  if (!spread.strength.empty()) {
    const Vec3f &own = spread.own.front(), &to = spread.strength.front();
    const Vec3f strength = (own.array() > 0).select(to.array() / own.array().max(1e-30f), 1.0f);
    for (DirectionWeight& one : list) one.weight = one.weight.cwiseProduct(strength);
  }
  return list;
}

SpreadLight::Bands SpreadLight::worked_out(int vertex, const Reach& reach) const {
  const int bands = reach.point.bands(), wide = reach.point.wide(), home = buckets_.of_vertex(vertex);
  const std::vector<int>& members = buckets_[home].members;
  const auto place_at_home = std::lower_bound(members.begin(), members.end(), vertex) - members.begin();
  const Lanes* const own_response = lit(home, reach).responses.data() + wide * (1 + place_at_home);
  Bands result;
  result.own.reserve(static_cast<std::size_t>(bands));
  for (int k = 0; k < bands; ++k) result.own.push_back(colour(own_response[k / 4], k % 4));
  if (is_even_about(home, reach)) return result;
  const TexturedFrames& frames = incident_.frames();
  const Vec3 point = frames.mesh.vertex(vertex), normal = frames.normals.row(vertex).transpose();
  const Vec3f place = point.cast<float>();
  const Entry& own = entry(vertex);
  // The buckets that shine on it, as wholes or by members.
  struct Part {
    int bucket;
    const LitBucket* lit;
    const LitReach* reach;
    double distance;  // < 0: by members
  };
  thread_local std::vector<Part> parts;
  parts.clear();
  const Float4 own_irradiance = to_lanes(own.irradiance.array());
  Float4 brightest = own_irradiance, differ = {};
  const auto compare = [&](const Float4& irradiance) {
    const Float4 difference = irradiance - own_irradiance;
    brightest = irradiance > brightest ? irradiance : brightest;
    const Float4 size = difference < 0 ? -difference : difference;
    differ = size > differ ? size : differ;
  };
  for (const int index : about(home)) {
    const VertexBuckets::Bucket& bucket = buckets_[index];
    if (!(bucket.facing.dot(normal) > 0)) continue;
    const double distance = (bucket.middle - point).norm();
    if (distance - bucket.radius > radius_) continue;
    const LitBucket& light = lit(index);
    const bool is_far = distance > apart * edge_ + bucket.radius;
    parts.push_back({index, &light, &lit(index, reach), is_far ? distance : -1});
    if (is_far)
      compare(to_lanes(light.mean.irradiance.array()));
    else
      for (const Source& source : light.sources) compare(source.irradiance);
  }
  const Float4 bound = static_cast<float>(unevenness) * brightest;
  const auto any_above = [](const Float4& a, const Float4& b) { return a[0] > b[0] || a[1] > b[1] || a[2] > b[2]; };
  if (!any_above(brightest, Float4{}) || !any_above(differ, bound)) return result;
  // Calls take(part, member's number or −1) for all that shine, with their weights by bands.
  std::vector<Lanes>& weights = kept_weights();
  weights.resize(4 * wide, Lanes{});
  const auto visit = [&](const auto& take) {
    for (const Part& part : parts) {
      if (part.distance >= 0) {
        part.reach->whole.at(0, static_cast<float>(part.distance), 1, weights.data());
        take(part, -1);
        continue;
      }
      for (std::size_t n = 0; n < part.lit->sources.size(); ++n) {
        const Source& source = part.lit->sources[n];
        reach.point.at(source.kernel, (source.place - place).norm(), source.area, weights.data());
        take(part, static_cast<int>(n));
      }
    }
  };
  Lanes* const sum = weights.data() + wide;
  Lanes* const light = sum + wide;
  Lanes* const greatest = light + wide;
  std::copy_n(own_response, wide, greatest);
  visit([&](const Part& part, int member) {
    const Lanes* const response = part.reach->responses.data() + wide * (member + 1);
    for (int w = 0; w < wide; ++w) {
      sum[w] += weights[w];
      light[w] += weights[w] * response[w];
      greatest[w] = response[w] > greatest[w] ? response[w] : greatest[w];
    }
  });
  bool even = true, is_gentle = true;
  std::vector<Vec3f> strength;
  strength.reserve(static_cast<std::size_t>(bands));
  for (int k = 0; k < bands; ++k) {
    const Vec3f over = colour(sum[k / 4], k % 4);
    strength.emplace_back(
        (over.array() > 0)
            .select(colour(light[k / 4], k % 4).array() / over.array().max(1e-30f), result.own[k].array()));
    const auto difference = (strength[k] - result.own[k]).array().abs().eval();
    even = even && !(difference > static_cast<float>(unevenness) * colour(greatest[k / 4], k % 4).array()).any();
    is_gentle = is_gentle && !(difference > static_cast<float>(gentle) * result.own[k].array()).any();
  }
  if (even) return result;
  ++spread_vertices_;
  result.strength = std::move(strength);
  if (is_gentle) return result;
  LightSums& sums = kept_sums(incident_.directions().count(), bands);
  visit([&](const Part& part, int member) {
    sums.add(weights.data(), member < 0 ? part.lit->mean.light : entry(buckets_[part.bucket].members[member]).light);
  });
  result.list.reserve(static_cast<std::size_t>(bands));
  for (int k = 0; k < bands; ++k) result.list.push_back(sums.any(k) ? sums.mean(k) : own.light);
  return result;
}

}  // namespace shellgrid
