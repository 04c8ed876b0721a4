// SPDX-License-Identifier: AGPL-3.0-or-later
// What all programs share: options, records, exit codes.
#pragma once
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "meshing/core/progress.h"

namespace shellgrid {

// What a running stage sees.
class StageRun {
 public:
  virtual ~StageRun() = default;
  virtual Progress& progress() = 0;
  virtual nlohmann::json& results() = 0;                  // the record's `results`
  virtual void note_output(const std::string& path) = 0;  // a further output (a view), named in the record
  virtual void start_timer(const std::string& part) = 0;  // ends the running part; its seconds land in the record
  virtual void print(const std::string& line) = 0;        // one line on stdout unless --quiet
  virtual bool verbose() const = 0;
  virtual int threads() const = 0;
  virtual std::uint64_t seed() const = 0;
  virtual const std::string& output() const = 0;  // -o, or empty
  // Ends the program with this exit code after the record is written; for comparisons that fail.
  virtual void exit_with(int code) = 0;
  // From now on the first SIGINT or SIGTERM does not end the program: the function returned says that it has come. The
  // second ends it.
  virtual std::function<bool()> hold_interrupts() = 0;
};

// One program `sg-NAME INPUT… -o OUTPUT [options]`. Declare, then run. The record `OUTPUT.json` holds:
// stage version command inputs[{path bytes xxh64}] outputs[{path bytes xxh64}] options threads seconds{…}
// peak_memory_mib results{…} warnings[].
class StageProgram {
 public:
  // `name` with or without the sg- before it.
  StageProgram(const std::string& name, const std::string& summary);
  ~StageProgram();

  // A required input file, positional, in order. `optional` ones may be left out and stay empty.
  void input(const std::string& name, std::string& path, const std::string& help, bool optional = false);
  void inputs(const std::string& name, std::vector<std::string>& paths, const std::string& help);
  // An input that is a folder.
  void input_folder(const std::string& name, std::string& path, const std::string& help, bool optional = false);
  // The primary output; -o is required unless `optional`.
  // Its extension is the example's, or one of `further_extensions`.
  void output(const std::string& example, const std::string& help, bool optional = false,
              const std::vector<std::string>& further_extensions = {});
  // A further output beside the primary one, whose name ends so in place of its extension: ".view.ply"; `only_for`:
  // where that extension is this.
  void output_beside(const std::string& ending, const std::string& only_for = "");
  // A further output with an option for its name; `path` becomes `otherwise` beside the primary one without it. Where
  // `otherwise` is empty it is written only if the option is given.
  void output_option(const std::string& flag, std::string& path, const std::string& otherwise, const std::string& help);
  // The output is a folder, made where it is missing; no record is written beside it.
  void output_folder(const std::string& example, const std::string& help, bool optional = false);
  // An option with its present value as default. Numbers may be written 1e5. Ranges are inclusive.
  void option(const std::string& flag, double& value, const std::string& unit, const std::string& help,
              double least = -1e300, double most = 1e300);
  void option(const std::string& flag, int& value, const std::string& unit, const std::string& help,
              int least = -2147483647, int most = 2147483647);
  void option(const std::string& flag, std::string& value, const std::string& help,
              const std::vector<std::string>& choices = {});
  // Numbers `r,g,b`; as many as `values` holds, or three where it is empty and the option has no default.
  void option(const std::string& flag, std::vector<double>& values, const std::string& unit, const std::string& help,
              double least = -1e300, double most = 1e300);
  // Numbers with commas between, as many as one likes.
  void list_option(const std::string& flag, std::vector<double>& values, const std::string& unit,
                   const std::string& help, double least = -1e300, double most = 1e300);
  void flag(const std::string& flag, bool& value, const std::string& help);
  void example(const std::string& command, const std::string& what);
  // Whether an option was on the command line; to be asked inside `body`.
  bool given(const std::string& flag) const;
  // For options that have no meaning beside others: where one is on the command line and it does not `fit`, the
  // program ends with exit code 2 and "FLAG: only WHAT takes it".
  void refuse_unless(bool fits, const std::string& what, const std::vector<std::string>& flags) const;

  // Parses, runs `body`, writes the record, returns the exit code: 0 done, 1 internal fault, 2 usage,
  // 3 bad or missing input, 4 numerical failure; one line on stderr: `sg-NAME: error: …`.
  // Common options: -o/--output, -q/--quiet, -v/--verbose, --threads, --seed, --progress, --help, --version,
  // --help-json.
  int run(int argc, char** argv, const std::function<void(StageRun&)>& body);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace shellgrid
