// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/transport/shell_medium.h"

#include <fmt/format.h>

#include <array>
#include <bit>
#include <map>
#include <unordered_map>
#include <unordered_set>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/core/random.h"
#include "solvers/transport/core_voxels.h"
#include "solvers/transport/homogeneous_medium.h"

namespace shellgrid {
namespace {

constexpr std::int32_t core_source = -1, space_source = -2;
constexpr int clearance_cells = 128;
// Delta tracking where a greater share of the majorant's collisions is real and a voxel has fewer of them: in a leaf,
// and with one majorant for all.
constexpr double mild = 0.5, leaf_collisions = 1, thin_collisions = 0.1;

// The 26 voxels about one, nearest first.
std::vector<Vec3i> neighbours() {
  std::vector<Vec3i> list;
  for (int distance = 1; distance <= 3; ++distance)
    for (int n = 0; n < 27; ++n) {
      const Vec3i offset(n / 9 - 1, n / 3 % 3 - 1, n % 3 - 1);
      if (offset.squaredNorm() == distance) list.push_back(offset);
    }
  return list;
}

// Where each voxel's matter comes from: a voxel of the shell (leaf · 512 + offset), the core, or it is free space.
class Sources {
 public:
  // space_alone: nobody asks for the matter.
  Sources(const ShellVolume& shell, const std::function<bool(const Vec3&)>& inside, bool space_alone = false)
      : shell_(shell),
        inside_(inside),
        grid_(shell.extinction.lower_leaf() - Vec3i::Ones(), shell.extinction.leaf_counts() + 2 * Vec3i::Ones(),
              core_source),
        around_(neighbours()) {
    take_shell();
    add_outer_layer();
    if (free_.empty()) return;
    add_space_above();
    if (!space_alone) give_space_matter();
  }

  const TwoLevelGrid<std::int32_t>& grid() const { return grid_; }
  // With those above the outer surface, that its surface may lie beyond the object's.
  const std::vector<Vec3i>& free_voxels() const { return free_; }

 private:
  bool in_shell(const Vec3i& v) const { return shell_.extinction.is_active(v.x(), v.y(), v.z()); }
  std::int32_t kind(const Vec3i& v) const { return shell_.kind.value(v.x(), v.y(), v.z()); }
  std::int32_t own_source(const Vec3i& v) const {
    const int leaf = shell_.extinction.find_leaf(shell_.extinction.leaf_of(v.x(), v.y(), v.z()));
    return leaf * 512 + shell_.extinction.offset_of(v.x(), v.y(), v.z());
  }
  void set(const Vec3i& v, std::int32_t source) { grid_.set(v.x(), v.y(), v.z(), source); }
  bool known(const Vec3i& v) const { return grid_.is_active(v.x(), v.y(), v.z()); }

  void take_shell() {
    shell_.extinction.for_each_active([&](int i, int j, int k, const Vec3f&) {
      const Vec3i v(i, j, k);
      const bool space = kind(v) == 0;
      set(v, space ? space_source : own_source(v));
      if (space) free_.push_back(v);
    });
  }

  // Voxels that reach into the object from outside are like their nearest neighbour within.
  void add_outer_layer() {
    const double reach = std::sqrt(3.0) + 1e-3, layers = shell_.thickness / shell_.frame.voxel;
    std::unordered_set<std::uint64_t> within;  // looked at and found to be core
    const auto key = [](const Vec3i& v) {
      return (static_cast<std::uint64_t>(v.x() & 0x1fffff) << 42) |
             (static_cast<std::uint64_t>(v.y() & 0x1fffff) << 21) | static_cast<std::uint64_t>(v.z() & 0x1fffff);
    };
    shell_.extinction.for_each_active([&](int i, int j, int k, const Vec3f&) {
      const Vec3i v(i, j, k);
      const double depth = shell_.texture_coordinate.value(i, j, k).z();
      if (depth > reach) return;
      for (const Vec3i& offset : around_) {
        const Vec3i n = v + offset;
        if (known(n) || in_shell(n) || within.count(key(n))) continue;
        // Too near to the surface to lie below the shell; else the surface has to say.
        if (depth + reach >= layers && inside_(shell_.frame.to_world(n))) {
          within.insert(key(n));
          continue;
        }
        for (const Vec3i& back : around_)
          if (in_shell(n + back)) {
            const bool space = kind(n + back) == 0;
            set(n, space ? space_source : own_source(n + back));
            if (space) outer_free_.push_back(n);
            break;
          }
      }
    });
    free_.insert(free_.end(), outer_free_.begin(), outer_free_.end());
  }

  // A second layer of free voxels above those beyond the surface: nobody's matter, but space.
  void add_space_above() {
    const bool thin = shell_.thickness / shell_.frame.voxel < 4;
    TwoLevelGrid<char> seen(grid_.lower_leaf() - Vec3i::Ones(), grid_.leaf_counts() + 2 * Vec3i::Ones(), 0);
    for (const Vec3i& v : outer_free_)
      for (const Vec3i& offset : around_) {
        const Vec3i n = v + offset;
        if (known(n) || in_shell(n) || seen.is_active(n.x(), n.y(), n.z())) continue;
        seen.set(n.x(), n.y(), n.z(), 1);
        bool touches_shell = thin;
        for (const Vec3i& back : around_) touches_shell = touches_shell || in_shell(n + back);
        if (touches_shell && inside_(shell_.frame.to_world(n))) continue;
        free_.push_back(n);
      }
  }

  // The surface of free space cuts through voxels: what lies on its other side in a free one is the neighbour's.
  void give_space_matter() {
    std::vector<std::pair<Vec3i, std::int32_t>> given;
    for (const Vec3i& v : free_) {
      const bool of_shell = in_shell(v);
      if (!of_shell && !known(v)) continue;
      for (const Vec3i& offset : around_) {
        const Vec3i n = v + offset;
        const std::int32_t source = grid_.value(n.x(), n.y(), n.z());
        if (source == space_source || (source == core_source && (!of_shell || !is_core(n)))) continue;
        given.emplace_back(v, source);
        break;
      }
    }
    for (const auto& [v, source] : given) set(v, source);
  }
  bool is_core(const Vec3i& v) const { return !known(v) && inside_(shell_.frame.to_world(v)); }

  const ShellVolume& shell_;
  const std::function<bool(const Vec3&)>& inside_;
  TwoLevelGrid<std::int32_t> grid_;
  std::vector<Vec3i> around_, free_, outer_free_;
};

// Gives equal matter one index.
class MatterList {
 public:
  using Key = std::array<std::uint32_t, 10>;
  std::uint32_t index_of(const Material& material, bool is_core) {
    Key key{};
    for (std::size_t c = 0; c < 3; ++c) {
      key[c] = std::bit_cast<std::uint32_t>(material.extinction[c]);
      key[3 + c] = std::bit_cast<std::uint32_t>(material.albedo[c]);
      key[6 + c] = std::bit_cast<std::uint32_t>(material.anisotropy[c]);
    }
    key[9] = is_core;
    const auto [at, added] = index_.try_emplace(key, static_cast<std::uint32_t>(materials_.size()));
    if (added) {
      naming("shell", [&] { check_transport_material(material); });
      materials_.emplace_back(material, is_core);
    }
    return at->second;
  }
  const std::vector<std::pair<Material, bool>>& materials() const { return materials_; }

 private:
  struct Hash {
    std::size_t operator()(const Key& key) const {
      std::uint64_t hash = 0;
      for (std::size_t k = 0; k < key.size(); k += 2)
        hash = hash64(hash ^ (static_cast<std::uint64_t>(key[k]) << 32 | key[k + 1]));
      return hash;
    }
  };
  std::unordered_map<Key, std::uint32_t, Hash> index_;
  std::vector<std::pair<Material, bool>> materials_;  // and whether it is the core's
};

}  // namespace

void check_shell_materials(const ShellVolume& shell) {
  check_transport_material(shell.core);
  parallel_for(
      static_cast<std::size_t>(shell.extinction.leaf_count()),
      [&](std::size_t l) {
        const int leaf = static_cast<int>(l);
        for (int offset = 0; offset < 512; ++offset) {
          if (!shell.extinction.mask_test(shell.extinction.leaf_mask(leaf), offset)) continue;
          const Material material{shell.extinction.leaf_values(leaf)[offset].array(),
                                  shell.albedo.leaf_values(leaf)[offset].array(),
                                  shell.anisotropy.leaf_values(leaf)[offset].array()};
          naming("shell", [&] { check_transport_material(material); });
        }
      },
      16);
}

std::vector<Vec3i> free_voxels_of(const ShellVolume& shell, const std::function<bool(const Vec3&)>& inside) {
  bool any = false;
  shell.kind.for_each_active([&](int, int, int, std::int32_t kind) { any = any || kind == 0; });
  return any ? Sources(shell, inside, true).free_voxels() : std::vector<Vec3i>();
}

ShellMedium::ShellMedium(const ShellVolume& shell, const std::function<bool(const Vec3&)>& inside,
                         std::vector<Vec3i>* free_voxels, const LeafMethod* method)
    : voxel_(shell.frame.voxel), per_voxel_(1 / shell.frame.voxel) {
  check_transport_material(shell.core);
  const Sources sources(shell, inside);
  if (free_voxels) *free_voxels = sources.free_voxels();
  const TwoLevelGrid<std::int32_t>& grid = sources.grid();
  count_ = grid.leaf_counts();
  origin_ = shell.frame.origin + voxel_ * (8.0 * grid.lower_leaf().cast<double>() - Vec3::Constant(0.5));
  top_.assign(grid.top_cells(), grid.top_cells() + static_cast<std::size_t>(count_.x()) * count_.y() * count_.z());

  MatterList list;
  list.index_of(shell.core, true);
  const auto matter_of = [&](std::int32_t source) {
    if (source == core_source) return std::uint32_t{0};
    if (source == space_source) return list.index_of(Material(), false);
    const int leaf = source / 512, offset = source % 512;
    const Vec3i v = 8 * shell.extinction.leaf_coordinate(leaf) + Vec3i(offset >> 6, offset >> 3 & 7, offset & 7);
    return list.index_of(
        {shell.extinction.leaf_values(leaf)[offset].array(), shell.albedo.leaf_values(leaf)[offset].array(),
         shell.anisotropy.leaf_values(leaf)[offset].array()},
        shell.kind.value(v.x(), v.y(), v.z()) == core_voxel_kind);
  };

  ClearanceGrid clearance(origin_, origin_ + 8 * voxel_ * count_.cast<double>(),
                          std::clamp(4 * count_.maxCoeff(), 1, clearance_cells));
  majorant_ = shell.core.extinction.maxCoeff();
  double least_mean = shell.core.extinction.mean();
  for (int index = 0; index < grid.leaf_count(); ++index) {
    Leaf leaf;
    leaf.first = static_cast<std::uint32_t>(voxels_.size());
    const std::int32_t* const values = grid.leaf_values(index);
    // Uniform: without look-ups. Else from voxel to voxel, unless most collisions of the majorant are real.
    bool uniform = true;
    double sum = 0;
    for (int offset = 0; offset < 512; ++offset) {
      voxels_.push_back(matter_of(values[offset]));
      uniform = uniform && voxels_.back() == voxels_[leaf.first];
      const Rgb& extinction = list.materials()[voxels_.back()].first.extinction;
      leaf.majorant = std::max(leaf.majorant, extinction.maxCoeff());
      sum += extinction.sum();
    }
    const double mean = sum / (3 * 512);
    majorant_ = std::max<double>(majorant_, leaf.majorant);
    least_mean = std::min(least_mean, mean);
    leaf.method = uniform                                                                   ? LeafMethod::uniform
                  : leaf.majorant * voxel_ < leaf_collisions && mean > mild * leaf.majorant ? LeafMethod::delta
                                                                                            : LeafMethod::voxels;
    if (method && *method != LeafMethod::uniform && leaf.majorant > 0) leaf.method = *method;
    if (leaf.method == LeafMethod::uniform) {
      const std::uint32_t only = voxels_[leaf.first];
      voxels_.resize(leaf.first);
      leaf.first = only;
      ++methods_.uniform;
    } else {
      ++(leaf.method == LeafMethod::voxels ? methods_.voxels : methods_.delta);
    }
    leaves_.push_back(leaf);
    const Vec3 lower = origin_ + 8 * voxel_ * (grid.leaf_coordinate(index) - grid.lower_leaf()).cast<double>();
    clearance.add_box(lower, lower + Vec3::Constant(8 * voxel_));
  }
  std::map<std::array<float, 3>, std::size_t> places;
  for (const auto& [material, is_core] : list.materials()) {
    const ScatteringPlace place = scattering_place(material.albedo, material.anisotropy, 0);
    Float4 anisotropy = to_lanes(material.anisotropy);
    anisotropy[3] = place.one_anisotropy ? 1.0f : 0.0f;
    const auto [found, added] =
        places.try_emplace(std::array<float, 3>{anisotropy[0], anisotropy[1], anisotropy[2]}, anisotropy_.size());
    if (added) anisotropy_.push_back(anisotropy);
    const std::size_t at = found->second;
    if (at >= std::size_t{1} << 22) throw InputError("shell: more than 4 million different anisotropies");
    Matter matter;
    matter.extinction = to_lanes(material.extinction);
    matter.albedo = to_lanes(material.albedo);
    matter.albedo[3] = static_cast<float>((place.white ? 1 : 0) + (is_core ? 2 : 0) + 4 * at);
    matter_.push_back(matter);
  }
  clearance.finish();
  core_clearance_ = std::move(clearance);
  std::vector<Material> materials;
  for (const auto& [material, is_core] : list.materials()) materials.push_back(material);
  std::vector<Vec3i> leaf_corners;
  for (int index = 0; index < grid.leaf_count(); ++index)
    leaf_corners.push_back(8 * (grid.leaf_coordinate(index) - grid.lower_leaf()));
  leaps_of_matter_.assign(materials.size(), -1);
  prepare_leaps(materials, leaf_corners);
  thin_ = !method && methods_.delta > 0 && majorant_ * voxel_ < thin_collisions && least_mean > mild * majorant_;
  methods_.one_majorant = thin_;
  methods_.without_leaf = top_.size() - leaves_.size();
}

void ShellMedium::prepare_leaps(const std::vector<Material>& materials, const std::vector<Vec3i>& leaf_corners) {
  constexpr int most_alike = 8;
  bool any = false;
  leaps_of_matter_.assign(materials.size(), -1);
  for (std::size_t m = 0; m < materials.size(); ++m) {
    const ChannelLeaps leaps =
        channel_leaps(to_double(to_lanes(materials[m].extinction)), to_double(to_lanes(materials[m].albedo)),
                      to_double(to_lanes(materials[m].anisotropy)));
    bool in_voxels = false;
    for (const DiffuseLeap& leap : leaps.channel) in_voxels = in_voxels || leap.radius((most_alike + 0.5) * voxel_) > 0;
    if (!leaps.possible || (m > 0 && !in_voxels)) continue;
    leaps_of_matter_[m] = static_cast<std::int32_t>(leaps_.size());
    leaps_.push_back(leaps);
    any = any || in_voxels;
  }
  if (!any) return;
  // Step by step inwards: like its neighbours, which are like theirs so far.
  alike_.assign(512 * leaves_.size(), 0);
  for (int step = 1; step <= most_alike; ++step) {
    std::vector<std::uint8_t> next = alike_;
    parallel_for(
        leaves_.size(),
        [&](std::size_t l) {
          for (int offset = 0; offset < 512; ++offset) {
            const std::size_t at = 512 * l + static_cast<std::size_t>(offset);
            const std::uint32_t own = matter_at({static_cast<std::int32_t>(l), offset});
            if (leaps_of_matter_[own] < 0 || alike_[at] < step - 1) continue;
            const Vec3i voxel = leaf_corners[l] + Vec3i(offset >> 6, offset >> 3 & 7, offset & 7);
            bool alike = true;
            for (int n = 0; n < 27 && alike; ++n) {
              const VoxelPlace other = voxel_place(voxel + Vec3i(n / 9 - 1, n / 3 % 3 - 1, n % 3 - 1));
              alike = other.leaf >= 0 && matter_at(other) == own &&
                      alike_[512 * static_cast<std::size_t>(other.leaf) + static_cast<std::size_t>(other.offset)] >=
                          step - 1;
            }
            if (alike) next[at] = static_cast<std::uint8_t>(step);
          }
        },
        8);
    alike_ = std::move(next);
  }
}

double ShellMedium::reach(const LightPath& path) const {
  const Vec3 place = (path.point - origin_) * per_voxel_;
  if (!(place.cwiseAbs().maxCoeff() < 1e9)) return 0;
  const Vec3i voxel = place.array().floor().matrix().cast<int>();
  const VoxelPlace at = voxel_place(voxel);
  if (at.leaf < 0) return path.matter == 0 ? core_clearance_.at(path.point) : 0;
  if (alike_.empty() || matter_at(at) != path.matter) return 0;
  const Vec3 within = place - voxel.cast<double>();
  const double wall = std::min(within.minCoeff(), 1 - within.maxCoeff());
  return voxel_ * (wall + alike_[512 * static_cast<std::size_t>(at.leaf) + static_cast<std::size_t>(at.offset)]);
}

}  // namespace shellgrid
