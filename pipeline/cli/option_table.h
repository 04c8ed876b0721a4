// SPDX-License-Identifier: AGPL-3.0-or-later
// The declared inputs and options of one program: their values, checks, help text.
#pragma once
#include <cstdint>
#include <string>
#include <variant>
#include <vector>

#include <nlohmann/json.hpp>

namespace shellgrid {

// Wrong use of a program (exit code 2).
struct UsageError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

struct InputSpec {
  std::string name, help;
  std::string* path = nullptr;                // one file
  std::vector<std::string>* paths = nullptr;  // or all the rest
  bool optional = false, folder = false;
};

struct OptionSpec {
  using Target = std::variant<double*, int*, std::uint64_t*, std::string*, std::vector<double>*, bool*>;
  std::string flags;  // "-q,--quiet" or "--size"
  Target value;
  std::string unit, help;
  double least = -1e300, most = 1e300;
  std::vector<std::string> choices = {};
  std::string placeholder = {};  // for texts: FILE, NAME
  bool any_count = false;        // numbers: as many as one likes
  bool given = false;

  std::string long_name() const;           // "--size"
  std::string type() const;                // number, integer, numbers, text, flag
  nlohmann::ordered_json present() const;  // its value now; null where there is none
  // Sets the value from text. Throws: UsageError that names the option.
  void assign(const std::string& text);
};

// An output that an option names; without it, it stands beside the primary one.
struct OutputOptionSpec {
  std::string flag;
  std::string* path;
  std::string otherwise;  // "exitance.ply"; empty: it is written only where the option is given, and has any ending
};

// A further output whose name is the primary one's with this ending in place of its extension.
struct BesideOutputSpec {
  std::string ending;
  std::string only_for;  // an extension of the primary output; empty: any
};

struct ProgramTable {
  std::string name, summary;
  std::vector<InputSpec> inputs;
  std::vector<OptionSpec> options;  // in the order of declaration, common ones last
  std::string output_example, output_help;
  bool has_output = false, output_optional = false, output_folder = false;
  std::vector<std::string> output_extensions;                 // with the dot; empty: any
  std::vector<BesideOutputSpec> beside_output;                // further outputs
  std::vector<OutputOptionSpec> output_options;               // further outputs with an option for their name
  std::vector<std::pair<std::string, std::string>> examples;  // command, what it does

  std::string usage() const;                      // one line
  std::string help() const;                       // the text of --help
  nlohmann::ordered_json help_json() const;       // the same for machines
  std::vector<std::string> option_names() const;  // every long and short name
};

// A finite number, "80" or "1e5", the whole text. Throws: UsageError.
double parse_number(const std::string& text);
// A number as short as it can be written, 1e+05 as 1e5.
std::string number_text(double value);

}  // namespace shellgrid
