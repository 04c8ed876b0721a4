// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/cli/stage_program.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <oneapi/tbb/global_control.h>
#include <oneapi/tbb/info.h>
#include <sys/stat.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <deque>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>

#include "meshing/core/error.h"
#include "meshing/formats/output_file.h"
#include "meshing/formats/output_set.h"
#include "pipeline/cli/console_progress.h"
#include "pipeline/cli/failure.h"
#include "pipeline/cli/nearest_name.h"
#include "pipeline/cli/option_table.h"
#include "pipeline/cli/record.h"
#include "pipeline/cli/termination.h"

namespace shellgrid {
namespace {

namespace fs = std::filesystem;
using json = nlohmann::ordered_json;

bool is_set(const std::string& path) { return !path.empty(); }

// Where the file lies, or what a link of this name stands for.
fs::path folder_of(const std::string& path) {
  std::error_code error;
  const fs::path parent =
      (fs::is_symlink(path, error) ? fs::weakly_canonical(path, error) : fs::path(path)).parent_path();
  return parent.empty() ? fs::path(".") : parent;
}

class Run : public StageRun {
 public:
  Run(const std::string& program, ConsoleProgress::Display display) : progress_(program, display) {}

  Progress& progress() override { return progress_; }
  nlohmann::json& results() override { return results_; }
  void note_output(const std::string& path) override { further_outputs.push_back(path); }
  void start_timer(const std::string& part) override { timer.start(part); }
  void print(const std::string& line) override {
    if (quiet) return;
    progress_.clear();
    std::fputs((line + "\n").c_str(), stdout);
  }
  bool verbose() const override { return is_verbose; }
  int threads() const override { return thread_count; }
  std::uint64_t seed() const override { return seed_value; }
  const std::string& output() const override { return output_path; }
  void exit_with(int code) override { exit_code = code; }
  std::function<bool()> hold_interrupts() override {
    hold_termination();
    return termination_asked;
  }

  const std::vector<std::string>& warnings() const { return progress_.warnings(); }
  void clear_progress() { progress_.clear(); }

  PartTimer timer;
  std::vector<std::string> further_outputs;
  bool quiet = false, is_verbose = false;
  int thread_count = 1, exit_code = 0;
  std::uint64_t seed_value = 0;
  std::string output_path;

 private:
  ConsoleProgress progress_;
  nlohmann::json results_ = nlohmann::json::object();
};

void check_input(const InputSpec& input, const std::string& path) {
  struct stat status {};
  if (path.empty()) throw UsageError(input.name + ": an empty name is no file");
  if (::stat(path.c_str(), &status) != 0) throw InputError(path + ": " + std::strerror(errno));
  if (input.folder && !S_ISDIR(status.st_mode)) throw InputError(path + ": is not a folder");
  if (!input.folder && S_ISDIR(status.st_mode)) throw InputError(path + ": is a folder; expected a file");
  if (::access(path.c_str(), input.folder ? R_OK | X_OK : R_OK) != 0)
    throw InputError(path + ": " + std::strerror(errno));
}

// Whether the system lets a file be made there. What it says of permissions is no promise: some folders are none to it.
void try_to_write(const std::string& path, const fs::path& folder) {
  const std::string probe = (folder / fmt::format(".probe.partial-{}-0", ::getpid())).string();
  const int file = ::open(probe.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0600);
  if (file < 0) throw InputError(path + ": cannot be written: " + folder.string() + ": " + std::strerror(errno));
  ::close(file);
  ::unlink(probe.c_str());
}

// Before any work: can this be written at all? `flag` is the option that names it, or what it stands beside.
void check_written_file(const std::string& flag, const std::string& path, const std::vector<std::string>& inputs) {
  std::error_code error;
  const fs::file_status status = fs::status(path, error);
  if (fs::is_directory(status)) throw InputError(path + ": cannot be written: it is a folder");
  if (fs::exists(status) && !fs::is_regular_file(status))
    throw InputError(path + ": cannot be written: it is not a regular file");
  if (error && status.type() != fs::file_type::not_found)
    throw InputError(path + ": cannot be written: " + error.message());
  const fs::path folder = folder_of(path);
  if (!fs::is_directory(folder, error))
    throw InputError(path + ": cannot be written: there is no folder " + folder.string());
  try_to_write(path, folder);
  const long longest = ::pathconf(folder.c_str(), _PC_NAME_MAX);
  if (longest > 0 && fs::path(path).filename().string().size() > static_cast<std::size_t>(longest))
    throw InputError(path + ": cannot be written: " + std::strerror(ENAMETOOLONG));
  for (const std::string& input : inputs)
    if (fs::exists(path, error) && fs::equivalent(path, input, error))
      throw UsageError(fmt::format("{}: would overwrite the input {}", flag, input));
}

std::string lower_case(std::string text) {
  for (char& c : text) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return text;
}

void check_extension(const std::string& flag, const std::string& path, const std::vector<std::string>& expected) {
  if (expected.empty()) return;
  const std::string extension = lower_case(fs::path(path).extension().string());
  if (std::find(expected.begin(), expected.end(), extension) == expected.end())
    throw UsageError(fmt::format("{} {}: expected a name that ends in {}", flag, path, fmt::join(expected, " or ")));
}

// A folder is made only when there is something to put into it.
void check_output_folder(const std::string& path) {
  std::error_code error;
  if (fs::exists(path, error) && !fs::is_directory(path, error))
    throw InputError(path + ": exists and is not a folder");
  fs::path present = fs::absolute(path, error).lexically_normal();
  while (!fs::exists(present, error) && present.has_relative_path()) present = present.parent_path();
  if (!fs::is_directory(present, error))
    throw InputError(path + ": cannot be made: " + present.string() + " is not a folder");
  try_to_write(path, present);
}

void check_outputs(const ProgramTable& table, const std::string& path, const std::vector<std::string>& inputs) {
  if (table.output_folder) return check_output_folder(path);
  check_written_file("-o " + path, path, inputs);
  check_extension("-o", path, table.output_extensions);
  std::vector<std::pair<std::string, std::string>> all = {{"-o " + path, path}};  // said of it, path
  for (const auto& [ending, only_for] : table.beside_output) {
    if (!only_for.empty() && lower_case(fs::path(path).extension().string()) != only_for) continue;
    const std::string beside = fs::path(path).replace_extension(ending).string();
    all.emplace_back(fmt::format("-o {} with {} beside it", path, beside), beside);
  }
  all.emplace_back(fmt::format("-o {} with its record", path), record_path(path));
  for (const OutputOptionSpec& option : table.output_options) {
    if (option.otherwise.empty() && option.path->empty()) continue;
    if (option.path->empty()) *option.path = (fs::path(path).parent_path() / option.otherwise).string();
    if (!option.otherwise.empty())
      check_extension(option.flag, *option.path, {fs::path(option.otherwise).extension().string()});
    all.emplace_back(option.flag + " " + *option.path, *option.path);
  }
  for (std::size_t i = 0; i < all.size(); ++i) {
    check_written_file(all[i].first, all[i].second, inputs);
    std::error_code error;
    for (std::size_t k = 0; k < i; ++k)
      if (fs::weakly_canonical(all[k].second, error) == fs::weakly_canonical(all[i].second, error))
        throw UsageError(fmt::format("{}: is the name of another output, too", all[i].first));
  }
}

}  // namespace

struct StageProgram::Impl {
  ProgramTable table;
  // Values of the common options.
  std::string output_path, progress = "auto";
  bool quiet = false, verbose = false;
  int threads = 0;
  std::uint64_t seed = 0;
  bool common_declared = false;

  void declare_common();
  bool parse(int argc, char** argv);  // false: help or version was asked for and printed
  std::vector<std::string> input_paths() const;
  void write_record(const Run& run, const std::vector<std::string>& arguments, std::vector<json> inputs) const;
  int execute(const std::vector<std::string>& arguments, const std::function<void(StageRun&)>& body, Run& run);
};

StageProgram::StageProgram(const std::string& name, const std::string& summary) : impl_(std::make_unique<Impl>()) {
  impl_->table.name = name.starts_with("sg-") ? name : "sg-" + name;
  impl_->table.summary = summary;
}

StageProgram::~StageProgram() = default;

void StageProgram::input(const std::string& name, std::string& path, const std::string& help, bool optional) {
  impl_->table.inputs.push_back({name, help, &path, nullptr, optional, false});
}
void StageProgram::inputs(const std::string& name, std::vector<std::string>& paths, const std::string& help) {
  impl_->table.inputs.push_back({name, help, nullptr, &paths, false, false});
}
void StageProgram::input_folder(const std::string& name, std::string& path, const std::string& help, bool optional) {
  impl_->table.inputs.push_back({name, help, &path, nullptr, optional, true});
}
void StageProgram::output(const std::string& example, const std::string& help, bool optional,
                          const std::vector<std::string>& further_extensions) {
  if (const std::string extension = fs::path(example).extension().string(); !extension.empty()) {
    impl_->table.output_extensions = further_extensions;
    impl_->table.output_extensions.insert(impl_->table.output_extensions.begin(), extension);
  }
  impl_->table.output_example = example;
  impl_->table.output_help = help;
  impl_->table.has_output = true;
  impl_->table.output_optional = optional;
}
void StageProgram::output_folder(const std::string& example, const std::string& help, bool optional) {
  output(example, help, optional);
  impl_->table.output_folder = true;
}
void StageProgram::output_beside(const std::string& ending, const std::string& only_for) {
  impl_->table.beside_output.push_back({ending, only_for});
}
void StageProgram::output_option(const std::string& flag, std::string& path, const std::string& otherwise,
                                 const std::string& help) {
  OptionSpec spec{flag, &path, "", otherwise.empty() ? help : help + "; default " + otherwise + " beside the output"};
  spec.placeholder = "FILE";
  impl_->table.options.push_back(spec);
  impl_->table.output_options.push_back({flag, &path, otherwise});
}
void StageProgram::option(const std::string& flag, double& value, const std::string& unit, const std::string& help,
                          double least, double most) {
  impl_->table.options.push_back({flag, &value, unit, help, least, most});
}
void StageProgram::option(const std::string& flag, int& value, const std::string& unit, const std::string& help,
                          int least, int most) {
  impl_->table.options.push_back({flag, &value, unit, help, static_cast<double>(least), static_cast<double>(most)});
}
void StageProgram::option(const std::string& flag, std::string& value, const std::string& help,
                          const std::vector<std::string>& choices) {
  impl_->table.options.push_back({flag, &value, "", help, -1e300, 1e300, choices});
}
void StageProgram::option(const std::string& flag, std::vector<double>& values, const std::string& unit,
                          const std::string& help, double least, double most) {
  impl_->table.options.push_back({flag, &values, unit, help, least, most});
}
void StageProgram::list_option(const std::string& flag, std::vector<double>& values, const std::string& unit,
                               const std::string& help, double least, double most) {
  option(flag, values, unit, help, least, most);
  impl_->table.options.back().any_count = true;
}
void StageProgram::flag(const std::string& flag, bool& value, const std::string& help) {
  impl_->table.options.push_back({flag, &value, "", help});
}
void StageProgram::example(const std::string& command, const std::string& what) {
  impl_->table.examples.emplace_back(command, what);
}

bool StageProgram::given(const std::string& flag) const {
  for (const OptionSpec& option : impl_->table.options)
    if (option.long_name() == flag || option.flags == flag) return option.given;
  throw InternalError(impl_->table.name + " declares no option " + flag);
}

void StageProgram::refuse_unless(bool fits, const std::string& what, const std::vector<std::string>& flags) const {
  for (const std::string& flag : flags)
    if (given(flag) && !fits) throw UsageError(fmt::format("{}: only {} takes it", flag, what));
}

void StageProgram::Impl::declare_common() {
  if (common_declared) return;
  common_declared = true;
  table.options.push_back({"-q,--quiet", &quiet, "", "print nothing but errors and warnings"});
  table.options.push_back({"-v,--verbose", &verbose, "", "print more"});
  table.options.push_back({"--threads", &threads, "", "threads to use; 0: one per processor", 0, 1024});
  table.options.push_back({"--seed", &seed, "", "seed of everything random", 0, 1e300});
  table.options.push_back({"--progress",
                           &progress,
                           "",
                           "show progress; auto: only on a terminal",
                           -1e300,
                           1e300,
                           {"auto", "always", "never", "json"}});
}

bool StageProgram::Impl::parse(int argc, char** argv) {
  // CLI11 splits the command line; values, checks and texts are the table's.
  CLI::App app;
  app.set_help_flag("");
  app.allow_extras();
  bool help = false, help_json = false, version = false;
  app.add_flag("--help,-h", help);
  app.add_flag("--help-json", help_json);
  app.add_flag("--version", version);
  std::deque<std::string> texts;
  std::deque<std::vector<std::string>> lists;
  std::vector<CLI::Option*> positionals, named;
  for (std::size_t i = 0; i < table.inputs.size(); ++i) {
    const std::string internal_name = fmt::format("input_{}", i);
    if (table.inputs[i].paths) {
      positionals.push_back(app.add_option(internal_name, lists.emplace_back())->expected(1, 1 << 20));
    } else {
      positionals.push_back(app.add_option(internal_name, texts.emplace_back()));
    }
  }
  for (OptionSpec& option : table.options) {
    if (option.type() == "flag")
      named.push_back(app.add_flag(option.flags, *std::get<bool*>(option.value)));
    else
      named.push_back(app.add_option(option.flags, texts.emplace_back())->take_last());
  }
  std::string output_text;
  CLI::Option* output_option = table.has_output ? app.add_option("-o,--output", output_text)->take_last() : nullptr;
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    const std::string reason = one_line(error.what());
    if (const std::size_t end = reason.find(": 1 required TEXT missing"); end != std::string::npos)
      throw UsageError(reason.substr(0, end) + ": its value is missing");
    throw UsageError(reason);
  }
  if (help) return std::fputs(table.help().c_str(), stdout), false;
  if (help_json) return std::fputs((table.help_json().dump(2) + "\n").c_str(), stdout), false;
  if (version) return std::fputs((table.name + " (shellgrid) " + SHELLGRID_VERSION + "\n").c_str(), stdout), false;

  bool options_ended = false;
  for (const std::string& extra : app.remaining()) {
    if (extra == "--" && !options_ended) {
      options_ended = true;
      continue;
    }
    if (extra.starts_with("-") && !options_ended) {
      const std::string unknown = extra.substr(0, extra.find('='));
      throw UsageError("unknown option " + unknown + did_you_mean(unknown, table.option_names()));
    }
    throw UsageError("unexpected argument '" + extra + "'; usage: " + table.usage());
  }
  for (std::size_t i = 0; i < table.options.size(); ++i) {
    OptionSpec& option = table.options[i];
    if (named[i]->count() == 0) continue;
    option.given = true;
    if (option.type() != "flag") option.assign(named[i]->results().back());
  }
  for (std::size_t i = 0; i < table.inputs.size(); ++i) {
    InputSpec& input = table.inputs[i];
    const std::vector<std::string> given = positionals[i]->results();
    if (given.empty() && !input.optional) throw UsageError("missing " + input.name + "; usage: " + table.usage());
    if (given.empty()) continue;
    if (input.paths)
      *input.paths = given;
    else
      *input.path = given.front();
  }
  if (output_option && output_option->count() > 0) {
    output_path = output_option->results().back();
    if (output_path.empty()) throw UsageError("-o: an empty name is no file");
  }
  if (table.has_output && !table.output_optional && output_path.empty())
    throw UsageError("missing -o " + table.output_example + "; usage: " + table.usage());
  return true;
}

std::vector<std::string> StageProgram::Impl::input_paths() const {
  std::vector<std::string> paths;
  for (const InputSpec& input : table.inputs) {
    if (input.folder) continue;
    if (input.paths) paths.insert(paths.end(), input.paths->begin(), input.paths->end());
    if (input.path && is_set(*input.path)) paths.push_back(*input.path);
  }
  return paths;
}

void StageProgram::Impl::write_record(const Run& run, const std::vector<std::string>& arguments,
                                      std::vector<json> inputs) const {
  json record;
  record["stage"] = table.name;
  record["version"] = SHELLGRID_VERSION;
  record["command"] = shell_command(arguments);
  record["inputs"] = std::move(inputs);
  record["outputs"] = json::array({describe_file(output_path)});
  for (const std::string& path : run.further_outputs) record["outputs"].push_back(describe_file(path));
  record["options"] = json::object();
  for (const OptionSpec& option : table.options)
    if (option.long_name() != "--quiet" && option.long_name() != "--verbose" && option.long_name() != "--progress")
      record["options"][option.long_name().substr(2)] = option.present();
  record["threads"] = run.thread_count;
  record["seconds"] = run.timer.seconds();
  record["peak_memory_mib"] = peak_memory_mib();
  record["results"] = const_cast<Run&>(run).results();
  record["warnings"] = run.warnings();
  write_text_atomically(record_path(output_path), record.dump(2, ' ', false, json::error_handler_t::replace) + "\n");
}

int StageProgram::Impl::execute(const std::vector<std::string>& arguments, const std::function<void(StageRun&)>& body,
                                Run& run) {
  for (const InputSpec& input : table.inputs) {
    if (input.paths)
      for (const std::string& path : *input.paths) check_input(input, path);
    if (input.path && is_set(*input.path)) check_input(input, *input.path);
  }
  const bool records = is_set(output_path) && !table.output_folder;
  if (is_set(output_path)) check_outputs(table, output_path, input_paths());
  std::vector<std::string> written_folders;
  if (is_set(output_path)) {
    written_folders.push_back(table.output_folder ? output_path : folder_of(output_path).string());
    for (const OutputOptionSpec& option : table.output_options)
      if (is_set(*option.path)) written_folders.push_back(folder_of(*option.path).string());
  }
  end_cleanly_on_uncaught_exceptions(table.name, written_folders);
  if (is_set(output_path)) clean_up_on_termination(written_folders);

  run.quiet = quiet;
  run.is_verbose = verbose;
  run.seed_value = seed;
  run.output_path = output_path;
  run.thread_count = threads > 0 ? threads : oneapi::tbb::info::default_concurrency();
  const oneapi::tbb::global_control limit(oneapi::tbb::global_control::max_allowed_parallelism,
                                          static_cast<std::size_t>(run.thread_count));
  // A stage's outputs and its record appear together, or none of them. What goes into a folder is read there again.
  std::optional<OutputSet> outputs;
  if (records) outputs.emplace();
  body(run);
  run.timer.stop();
  run.clear_progress();
  if (records) {
    // What was read is hashed after the work: the time to a result matters more.
    std::vector<json> inputs;
    for (const std::string& path : input_paths()) inputs.push_back(describe_file(path));
    write_record(run, arguments, std::move(inputs));
  }
  if (outputs) {
    const UnbrokenPart to_the_end;
    outputs->publish();
  }
  if (std::fflush(stdout) != 0 || std::ferror(stdout)) throw InputError("standard output: cannot be written");
  return run.exit_code;
}

int StageProgram::run(int argc, char** argv, const std::function<void(StageRun&)>& body) {
  Impl& impl = *impl_;
  const std::string& name = impl.table.name;
  impl.declare_common();
  std::unique_ptr<Run> running;
  try {
    if (!impl.parse(argc, argv)) {
      if (std::fflush(stdout) != 0) throw InputError("standard output: cannot be written");
      return 0;
    }
    using Display = ConsoleProgress::Display;
    Display display = Display::none;
    if (impl.progress == "always" || (impl.progress == "auto" && !impl.quiet && isatty(STDERR_FILENO)))
      display = Display::bar;
    if (impl.progress == "json") display = Display::json;
    running = std::make_unique<Run>(name, display);
    std::vector<std::string> arguments(argv, argv + argc);
    arguments[0] = name;
    return impl.execute(arguments, body, *running);
  } catch (...) {
    const Failure failure = describe_failure(name, std::current_exception());
    if (running) running->clear_progress();
    std::fputs((failure.message + "\n").c_str(), stderr);
    return failure.code;
  }
}

}  // namespace shellgrid
