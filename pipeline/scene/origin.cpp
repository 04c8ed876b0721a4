// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/scene/origin.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <sstream>

#include "meshing/core/error.h"
#include "meshing/core/random.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/formats/output_file.h"
#include "meshing/formats/vdb_file.h"

namespace shellgrid {
namespace {

class Hash {
 public:
  void add(std::uint64_t bits) { value_ = hash64(value_, bits); }
  void add(double number) { add(std::bit_cast<std::uint64_t>(number + 0.0)); }  // −0 as 0
  void add(const Vec3& v) { add(v.x()), add(v.y()), add(v.z()); }
  void add(const Rgb& c) {
    for (int k = 0; k < 3; ++k) add(static_cast<double>(c[k]));
  }
  void add(const DirectionalLight& light) { add(std::uint64_t{1}), add(light.direction), add(light.irradiance); }
  void add(const PointLight& light) { add(std::uint64_t{2}), add(light.position), add(light.intensity); }
  void add(const AreaLight& light) {
    add(std::uint64_t{3}), add(light.position), add(light.direction), add(light.up);
    add(light.width), add(light.height), add(light.radiance);
  }
  void add(const EnvironmentLight& light) {
    add(std::uint64_t{4}), add(light.up), add(light.zenith), add(light.horizon), add(light.ground), add(light.scale);
    for (const EnvironmentLight::Lamp& lamp : light.lamps)
      add(lamp.direction), add(lamp.half_angle), add(lamp.softness), add(lamp.radiance);
    if (!light.image) return;
    for (const Image::Channel& channel : light.image->channels)
      for (const float value : channel.values) add(std::uint64_t{std::bit_cast<std::uint32_t>(value)});
  }
  std::string text() const { return fmt::format("{:016x}", value_); }

 private:
  std::uint64_t value_ = 0;
};

std::vector<std::string> words(const std::string& text) {
  std::istringstream in(text);
  std::vector<std::string> list;
  for (std::string word; in >> word;) list.push_back(word);
  return list;
}

}  // namespace

std::string note_of(const std::map<std::string, std::string>& notes, const std::string& key) {
  const auto note = notes.find(key);
  return note == notes.end() ? std::string() : note->second;
}

std::string hash_files(const std::vector<std::string>& paths) {
  std::vector<std::string> hashes;
  for (const std::string& path : paths) hashes.push_back(hash_file(path));
  return fmt::format("{}", fmt::join(hashes, " "));
}

std::string hash_lights(const std::vector<Light>& lights) {
  Hash hash;
  for (const Light& light : lights) std::visit([&](const auto& of_its_kind) { hash.add(of_its_kind); }, light);
  return hash.text();
}

void require_same_samples(const std::string& a, const std::string& a_path, const std::string& b,
                          const std::string& b_path) {
  if (!a.empty() && !b.empty() && a != b)
    throw InputError(fmt::format("{}: was made from another sample than {}; make both from one", a_path, b_path));
}

void require_made_from(const std::string& note, const std::string& path, const std::vector<std::string>& sample_paths) {
  if (note.empty()) return;
  const std::vector<std::string> told = words(note), given = words(hash_files(sample_paths));
  if (told == given) return;
  if (told.size() == given.size())
    for (std::size_t k = 0; k < given.size(); ++k)
      if (std::find(told.begin(), told.end(), given[k]) == told.end() && !is_as_written(sample_paths[k])) return;
  if (std::is_permutation(told.begin(), told.end(), given.begin(), given.end())) {
    std::vector<std::string> order;
    for (const std::string& hash : told)
      order.push_back(sample_paths[std::find(given.begin(), given.end(), hash) - given.begin()]);
    throw InputError(fmt::format("{}: was made from these samples in another order: {}", path, fmt::join(order, " ")));
  }
  for (std::size_t k = 0; k < given.size(); ++k)
    if (std::find(told.begin(), told.end(), given[k]) == told.end())
      throw InputError(fmt::format("{}: was made from {}, not from {}; make both from one", path,
                                   told.size() == 1 ? "another sample" : "other samples", sample_paths[k]));
  throw InputError(told.size() == given.size()
                       ? fmt::format("{}: was made from {} samples, not these", path, told.size())
                       : fmt::format("{}: was made from {} samples; {} given", path, told.size(), given.size()));
}

void require_shell_and_lights_of(const std::map<std::string, std::string>& notes, const std::string& path,
                                 const std::string& writer, const std::string& shell_path, const Scene& scene) {
  if (const std::string shell = note_of(notes, shell_note);
      !shell.empty() && shell != hash_files({shell_path}) && is_as_written(shell_path))
    throw InputError(
        fmt::format("{}: was made for another shell than {}; make it anew by {}", path, shell_path, writer));
  if (const std::string lights = note_of(notes, lights_note); !lights.empty() && lights != hash_lights(scene.lights))
    throw InputError(
        fmt::format("{}: was made under other lights than those of {}; make it anew by {}", path, scene.path, writer));
}

void require_core_of(const std::string& core_path, const std::string& sample, const std::string& texture_path,
                     const std::string& shell_path, const Scene& scene) {
  const std::map<std::string, std::string> notes = read_notes(core_path);
  require_same_samples(note_of(notes, samples_note), core_path, sample, texture_path);
  require_shell_and_lights_of(notes, core_path, "sg-core", shell_path, scene);
}

}  // namespace shellgrid
