// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/cli/option_table.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>

#include "pipeline/cli/nearest_name.h"

namespace shellgrid {
namespace {

constexpr double no_bound = 1e300, no_int_bound = 2147483647;

std::vector<std::string> split(const std::string& text, char separator) {
  std::vector<std::string> parts(1);
  for (const char character : text)
    if (character == separator)
      parts.emplace_back();
    else
      parts.back() += character;
  return parts;
}

bool bounded(const OptionSpec& option, double bound) {
  const double none = std::holds_alternative<int*>(option.value) ? no_int_bound : no_bound;
  return std::abs(bound) < none;
}

std::string range_text(const OptionSpec& option) {
  const bool low = bounded(option, option.least), high = bounded(option, option.most);
  if (low && high) return number_text(option.least) + " … " + number_text(option.most);
  if (low) return "≥ " + number_text(option.least);
  if (high) return "≤ " + number_text(option.most);
  return "";
}

double checked(const OptionSpec& option, const std::string& text) {
  const double value = parse_number(text);
  if (value < option.least || value > option.most)
    throw UsageError(fmt::format("{} is out of range; expected {}", one_line(text), range_text(option)));
  return value;
}

std::string placeholder(const OptionSpec& option) {
  const std::string type = option.type();
  if (type == "number") return "NUMBER";
  if (type == "integer") return "INTEGER";
  if (type == "numbers") return option.any_count ? "NUMBER,…" : "R,G,B";
  if (type == "flag") return "";
  return option.choices.empty() ? (option.placeholder.empty() ? "TEXT" : option.placeholder)
                                : fmt::format("{}", fmt::join(option.choices, "|"));
}

// Width on a terminal: the help texts' few characters beyond ASCII are two or three bytes wide.
std::size_t display_width(const std::string& text) {
  return static_cast<std::size_t>(
      std::count_if(text.begin(), text.end(), [](char c) { return (static_cast<unsigned char>(c) & 0xc0) != 0x80; }));
}

void append_entry(std::string& out, const std::string& left, const std::string& right) {
  constexpr std::size_t column = 34, width = 110;
  std::string line = "  " + left;
  if (display_width(line) + 2 > column) {
    out += line + "\n";
    line.clear();
  }
  line += std::string(column - display_width(line), ' ');
  for (const std::string& word : split(right, ' ')) {
    if (display_width(line) + display_width(word) > width && display_width(line) > column) {
      while (!line.empty() && line.back() == ' ') line.pop_back();
      out += line + "\n";
      line = std::string(column, ' ');
    }
    line += word + " ";
  }
  while (!line.empty() && line.back() == ' ') line.pop_back();
  out += line + "\n";
}

std::string default_text(const OptionSpec& option) {
  const nlohmann::ordered_json value = option.present();
  if (value.is_null() || option.type() == "flag") return "";
  if (value.is_string()) return value.get<std::string>();
  if (value.is_array()) {
    std::vector<std::string> parts;
    for (const auto& part : value) parts.push_back(number_text(part.get<double>()));
    return fmt::format("{}", fmt::join(parts, ","));
  }
  return number_text(value.get<double>());
}

std::string described(const OptionSpec& option) {
  std::string text = option.help;
  std::vector<std::string> notes;
  if (!option.unit.empty()) notes.push_back("unit " + option.unit);
  if (option.type() != "text" && option.type() != "flag")
    if (const std::string range = range_text(option); !range.empty()) notes.push_back(range);
  if (const std::string value = default_text(option); !value.empty()) notes.push_back("default " + value);
  if (!notes.empty()) text += fmt::format(" [{}]", fmt::join(notes, "; "));
  return text;
}

}  // namespace

double parse_number(const std::string& text) {
  const char* begin = text.data();
  const char* end = begin + text.size();
  if (begin != end && *begin == '+') ++begin;
  double value = 0;
  const auto [stop, fault] = std::from_chars(begin, end, value);
  if (fault != std::errc() || stop != end || !std::isfinite(value) || begin == end)
    throw UsageError(fmt::format("'{}' is not a number", one_line(text)));
  return value;
}

std::string number_text(double value) {
  // Shortest of the plain and the scientific form that reads back as the same number.
  std::string plain = fmt::format("{}", value), scientific = fmt::format("{:e}", value);
  for (int digits = 0; digits <= 17; ++digits) {
    scientific = fmt::format("{:.{}e}", value, digits);
    if (std::strtod(scientific.c_str(), nullptr) == value) break;
  }
  const std::size_t mark = scientific.find('e');
  if (mark != std::string::npos)
    scientific = scientific.substr(0, mark) + "e" + std::to_string(std::atoi(scientific.c_str() + mark + 1));
  if (plain.size() > 2 && plain.ends_with(".0")) plain.resize(plain.size() - 2);
  if (plain.find('e') != std::string::npos) return scientific;
  return plain.size() <= std::max<std::size_t>(scientific.size(), 5) ? plain : scientific;
}

std::string OptionSpec::long_name() const {
  const std::vector<std::string> names = split(flags, ',');
  return names.back();
}

std::string OptionSpec::type() const {
  if (std::holds_alternative<double*>(value)) return "number";
  if (std::holds_alternative<int*>(value) || std::holds_alternative<std::uint64_t*>(value)) return "integer";
  if (std::holds_alternative<std::vector<double>*>(value)) return "numbers";
  return std::holds_alternative<bool*>(value) ? "flag" : "text";
}

nlohmann::ordered_json OptionSpec::present() const {
  return std::visit(
      [](auto* target) -> nlohmann::ordered_json {
        if constexpr (std::is_same_v<decltype(target), std::string*> ||
                      std::is_same_v<decltype(target), std::vector<double>*>) {
          if (target->empty()) return nullptr;
        }
        return *target;
      },
      value);
}

void OptionSpec::assign(const std::string& text) {
  try {
    if (auto* number = std::get_if<double*>(&value)) {
      **number = checked(*this, text);
    } else if (auto* integer = std::get_if<int*>(&value)) {
      const double whole = checked(*this, text);
      if (whole != std::floor(whole) || std::abs(whole) > no_int_bound)
        throw UsageError(fmt::format("{} is not a whole number", one_line(text)));
      **integer = static_cast<int>(whole);
    } else if (auto* wide = std::get_if<std::uint64_t*>(&value)) {
      const auto [stop, fault] = std::from_chars(text.data(), text.data() + text.size(), **wide);
      if (fault != std::errc() || stop != text.data() + text.size()) {
        const double whole = checked(*this, text);
        if (whole != std::floor(whole) || whole < 0 || whole >= 0x1p63)
          throw UsageError(fmt::format("{} is not a whole number from 0 to 2^63", one_line(text)));
        **wide = static_cast<std::uint64_t>(whole);
      }
    } else if (auto* numbers = std::get_if<std::vector<double>*>(&value)) {
      const std::vector<std::string> parts = split(text, ',');
      const std::size_t wanted = any_count ? parts.size() : (*numbers)->empty() ? 3 : (*numbers)->size();
      if (parts.size() != wanted && parts.size() != 1)
        throw UsageError(fmt::format("'{}' is not {} numbers with commas between", one_line(text), wanted));
      std::vector<double> parsed;
      for (std::size_t i = 0; i < wanted; ++i) parsed.push_back(checked(*this, parts[parts.size() == 1 ? 0 : i]));
      **numbers = parsed;
    } else if (auto* word = std::get_if<std::string*>(&value)) {
      if (!choices.empty() && std::find(choices.begin(), choices.end(), text) == choices.end())
        throw UsageError(
            fmt::format("'{}' is none of {}{}", one_line(text), fmt::join(choices, ", "), did_you_mean(text, choices)));
      if (text.empty()) throw UsageError("must not be empty");
      **word = text;
    }
  } catch (const UsageError& error) {
    throw UsageError(long_name() + ": " + error.what());
  }
  given = true;
}

std::string ProgramTable::usage() const {
  std::string line = name;
  for (const InputSpec& input : inputs)
    line += input.optional ? " [" + input.name + "]" : " " + input.name + (input.paths ? "…" : "");
  if (has_output) line += output_optional ? " [-o " + output_example + "]" : " -o " + output_example;
  return line + " [options]";
}

std::string ProgramTable::help() const {
  std::string text = name + " — " + summary + "\n\nUsage: " + usage() + "\n";
  if (!inputs.empty()) text += "\nInputs:\n";
  for (const InputSpec& input : inputs) append_entry(text, input.name, input.help);
  text += "\nOptions:\n";
  if (has_output) append_entry(text, "-o, --output " + std::string(output_folder ? "FOLDER" : "FILE"), output_help);
  for (const OptionSpec& option : options) {
    std::string left = fmt::format("{}", fmt::join(split(option.flags, ','), ", "));
    if (const std::string value = placeholder(option); !value.empty()) left += " " + value;
    append_entry(text, left, described(option));
  }
  append_entry(text, "--help", "print this text");
  append_entry(text, "--help-json", "print inputs and options as JSON");
  append_entry(text, "--version", "print the version");
  if (!examples.empty()) text += "\nExamples:\n";
  for (const auto& [command, what] : examples) text += "  " + command + "\n      " + what + "\n";
  text += "\nLengths are millimetres. Numbers may be written 1e5.\n";
  if (has_output && !output_folder)
    text += "Beside its output each stage writes a record, OUTPUT.json: inputs, options, times, memory, results.\n";
  return text + "Exit codes: 0 done, 1 internal fault, 2 usage, 3 bad or missing input, 4 numerical failure.\n";
}

nlohmann::ordered_json ProgramTable::help_json() const {
  using json = nlohmann::ordered_json;
  json description = {{"name", name}, {"summary", summary}, {"usage", usage()}};
  description["inputs"] = json::array();
  for (const InputSpec& input : inputs)
    description["inputs"].push_back({{"name", input.name},
                                     {"help", input.help},
                                     {"optional", input.optional},
                                     {"several", input.paths != nullptr},
                                     {"folder", input.folder}});
  if (has_output)
    description["output"] = {
        {"example", output_example}, {"help", output_help}, {"optional", output_optional}, {"folder", output_folder}};
  description["options"] = json::array();
  for (const OptionSpec& option : options) {
    json entry = {{"flags", split(option.flags, ',')}, {"type", option.type()}, {"help", option.help}};
    if (!option.unit.empty()) entry["unit"] = option.unit;
    if (option.type() != "flag") entry["default"] = option.present();
    if (option.type() != "text" && option.type() != "flag") {
      if (bounded(option, option.least)) entry["least"] = option.least;
      if (bounded(option, option.most)) entry["most"] = option.most;
    }
    if (!option.choices.empty()) entry["choices"] = option.choices;
    description["options"].push_back(entry);
  }
  description["examples"] = json::array();
  for (const auto& [command, what] : examples)
    description["examples"].push_back({{"command", command}, {"what", what}});
  return description;
}

std::vector<std::string> ProgramTable::option_names() const {
  std::vector<std::string> names = {"--help", "--help-json", "--version"};
  if (has_output) names.insert(names.end(), {"--output", "-o"});
  for (const OptionSpec& option : options)
    for (const std::string& flag : split(option.flags, ',')) names.push_back(flag);
  return names;
}

}  // namespace shellgrid
