// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "meshing/core/material.h"
#include "meshing/core/vec.h"

namespace shellgrid {

// One section of a sample description. Every key must be asked for before `finish`, which refuses the rest with the
// nearest known one. All members throw InputError "FILE: PLACE: what is wrong".
class DescriptionSection {
 public:
  // Keeps a reference to the values.
  DescriptionSection(const std::string& file, const std::string& place, const nlohmann::json& values);

  bool has(const std::string& key);
  double number(const std::string& key, double otherwise, double least, double most);
  int integer(const std::string& key, int otherwise, int least, int most);
  bool boolean(const std::string& key, bool otherwise);
  Rgb color(const std::string& key, const Rgb& otherwise, double least, double most);
  std::string text(const std::string& key, const std::string& otherwise);
  // One of `choices`.
  std::string word(const std::string& key, const std::string& otherwise, const std::vector<std::string>& choices);
  // Whole numbers, exactly as many as `otherwise` holds. `form` says which: "[n_x, n_y]".
  std::vector<int> integers(const std::string& key, const std::vector<int>& otherwise, int least, int most,
                            const std::string& form);
  // Numbers, exactly `count` of them; empty where the key is missing.
  std::vector<double> numbers(const std::string& key, std::size_t count, double least, double most,
                              const std::string& form);
  std::vector<std::string> texts(const std::string& key);
  DescriptionSection section(const std::string& key);
  // The elements of a list of sections; none where the key is missing.
  std::vector<DescriptionSection> list(const std::string& key);
  void finish() const;
  [[noreturn]] void fail(const std::string& key, const std::string& what) const;
  // The same of the description as a whole: "FILE: what is wrong".
  [[noreturn]] void refuse(const std::string& what) const;
  // The index that materials given by their reflectance are looked at with; sections below take it over.
  void set_ior(double ior) { ior_ = ior; }
  double ior() const { return ior_; }
  // A path of the description, relative to its folder; where it is reached by a link, that of the file itself.
  std::string file(const std::string& name) const;

 private:
  std::string place_of(const std::string& key) const { return place_.empty() ? key : place_ + "." + key; }
  double check(const std::string& key, const nlohmann::json& value, double least, double most) const;

  std::string file_, place_;
  const nlohmann::json& values_;
  std::vector<std::string> known_;
  double ior_ = 1.5;
};

// A material: {"named": …}, {"absorption", "scattering", "anisotropy"}, or {"reflectance", "extinction", "anisotropy",
// "conversion"}: what a half-space of it shows, linear.
Material read_material(DescriptionSection section);

}  // namespace shellgrid
