// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/scene/plan_folder.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <ctime>
#include <filesystem>

#include "meshing/core/error.h"
#include "meshing/formats/output_file.h"
#include "pipeline/cli/nearest_name.h"
#include "pipeline/scene/plan_makefile.h"

namespace shellgrid {
namespace {

namespace fs = std::filesystem;
using json = nlohmann::ordered_json;

std::string dump(const json& value) { return value.dump(2, ' ', false, json::error_handler_t::replace) + "\n"; }

// Texts as JSON keeps them, bytes that are no UTF-8 included.
std::string bytes_of(const json& list) {
  std::string bytes;
  for (const json& byte : list) bytes += static_cast<char>(byte.get<int>());
  return bytes;
}
json bytes_to_json(const std::string& text) {
  json list = json::array();
  for (const char byte : text) list.push_back(static_cast<unsigned char>(byte));
  return list;
}

void make_folder(const fs::path& folder) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) throw InputError(folder.string() + ": cannot be made: " + error.message());
}

// Content hashes, remembered by size and time of the file so that a large file is read once.
class HashCache {
 public:
  explicit HashCache(const fs::path& path) : path_(path) {
    std::error_code error;
    if (!fs::is_regular_file(path_, error)) return;
    known_ = json::parse(read_text(path_.string()), nullptr, false);
    if (!known_.is_object()) known_ = json::object();
  }
  ~HashCache() {
    try {
      if (changed_) write_text_atomically(path_.string(), dump(known_));
    } catch (const std::exception&) {
      // Without it the next look reads the files again.
    }
  }
  HashCache(const HashCache&) = delete;
  HashCache& operator=(const HashCache&) = delete;

  // Empty where the file is missing.
  std::string hash(const std::string& path) {
    struct stat status {};
    if (::stat(path.c_str(), &status) != 0) return "";
    const std::int64_t time = static_cast<std::int64_t>(status.st_mtim.tv_sec) * 1000000000 + status.st_mtim.tv_nsec;
    const json identity = {status.st_size, time, status.st_ino, status.st_ctim.tv_sec, status.st_ctim.tv_nsec};
    const std::string name = json(path).dump(-1, ' ', true, json::error_handler_t::replace);
    if (known_.contains(name) && known_[name]["file"] == identity) return known_[name]["xxh64"];
    const std::string hash = hash_file(path);
    // A file that is only just written may change again without a change of its time.
    if (std::time(nullptr) - status.st_ctim.tv_sec > 2) {
      known_[name] = {{"file", identity}, {"xxh64", hash}};
      changed_ = true;
    }
    return hash;
  }

 private:
  fs::path path_;
  json known_ = json::object();
  bool changed_ = false;
};

json read_json(const fs::path& path) {
  const json value = json::parse(read_text(path.string()), nullptr, false);
  if (value.is_discarded()) throw InputError(path.string() + ": is damaged; run sg-plan again");
  return value;
}

class Folder {
 public:
  explicit Folder(const std::string& folder) : root_(folder), hashes_(root_ / ".done" / "hashes.json") {
    std::error_code error;
    if (!fs::is_regular_file(root_ / "plan" / "plan.json", error))
      throw InputError(folder + ": holds no plan; make one with sg-plan SCENE -o FOLDER");
    plan_ = read_json(root_ / "plan" / "plan.json");
    make_folder(root_ / ".done");
  }

  const json& stages() const { return plan_.at("stages"); }

  fs::path stamp(const json& stage) const { return root_ / ".done" / stage.at("name").get<std::string>(); }
  fs::path content_stamp(const std::string& artefact) const { return root_ / ".done" / (artefact + ".xxh64"); }

  // What the stage's result depends on, each by its content.
  json dependencies(const json& stage) {
    json all;
    const std::string program = stage.value("program", "sg-" + stage.at("name").get<std::string>());
    all[program] = hashes_.hash((fs::path(bytes_of(plan_.at("executables"))) / program).string());
    all["options"] = stage.at("arguments");
    for (const json& file : stage.at("files")) {
      const std::string path = bytes_of(file.at("path"));
      all["the " + file.at("name").get<std::string>()] = hashes_.hash(path) + fs::path(path).extension().string();
    }
    if (stage.at("slice").get<bool>()) {
      const std::string slice = "plan/" + stage.at("name").get<std::string>() + ".json";
      all["the scene"] = hashes_.hash((root_ / slice).string());
    }
    for (const json& artefact : stage.at("artefacts")) all[artefact.get<std::string>()] = recorded_content(artefact);
    return all;
  }

  std::string recorded_content(const std::string& artefact) const {
    std::error_code error;
    const fs::path path = content_stamp(artefact);
    return fs::is_regular_file(path, error) ? read_text(path.string()) : "";
  }

  // What the plan itself depends on.
  json plan_dependencies() {
    json all = json::array({hashes_.hash((fs::path(bytes_of(plan_.at("executables"))) / "sg-plan").string())});
    for (const json& file : plan_.at("read")) all.push_back(hashes_.hash(bytes_of(file)));
    return all;
  }
  std::string scene() const { return bytes_of(plan_.at("scene")); }

  // Empty where the stage is up to date, else why it is not.
  std::string reason_to_run(const json& stage) {
    std::error_code error;
    const fs::path path = stamp(stage);
    if (!fs::is_regular_file(path, error)) return "not made yet";
    const json done = json::parse(read_text(path.string()), nullptr, false);
    if (!done.is_object() || !done.contains("from") || !done.contains("outputs")) return "not made yet";
    const json now = dependencies(stage);
    for (const auto& [name, content] : now.items())
      if (!done["from"].contains(name) || done["from"][name] != content) return name + " changed";
    if (done["from"].size() != now.size()) return "options changed";
    for (const auto& [output, content] : done["outputs"].items()) {
      const std::string present = hashes_.hash((root_ / output).string());
      if (present.empty()) return output + " is missing";
      if (present != content) return output + " was changed";
    }
    return "";
  }

  // Times in the order of the plan, so that Make agrees with the contents: all long ago, so that what a run
  // writes is newer.
  void set_time(const fs::path& path, int order) const {
    constexpr std::time_t long_ago = 1000000000;
    const timespec times[2] = {{long_ago + order, 0}, {long_ago + order, 0}};
    if (::utimensat(AT_FDCWD, path.c_str(), times, 0) != 0 && errno != ENOENT)
      throw InputError(path.string() + ": its time cannot be set: " + std::strerror(errno));
  }

  std::string output_hash(const std::string& output) { return hashes_.hash((root_ / output).string()); }
  const fs::path& root() const { return root_; }

 private:
  fs::path root_;
  HashCache hashes_;
  json plan_;
};

// A stage's record names further outputs: its views.
std::vector<std::string> all_outputs(const Folder& folder, const json& stage) {
  std::vector<std::string> outputs = stage.at("outputs");
  for (const std::string view : stage.at("views")) outputs.push_back(view);
  const fs::path record = folder.root() / (outputs.front() + ".json");
  std::error_code error;
  if (!fs::is_regular_file(record, error)) return outputs;
  const json content = json::parse(read_text(record.string()), nullptr, false);
  if (!content.is_object() || !content.contains("outputs")) return outputs;
  for (const json& output : content["outputs"]) {
    const std::string path = output.value("path", "");
    const bool plain = !path.empty() && fs::path(path).is_relative() && path.find("..") == std::string::npos;
    if (plain && std::find(outputs.begin(), outputs.end(), path) == outputs.end()) outputs.push_back(path);
  }
  return outputs;
}

// The name under which Make and the shell may see a file: its own where every character is plain, else a link's.
std::string safe_name(const fs::path& file, const fs::path& folder, const std::string& link_name) {
  const std::string absolute = fs::absolute(file).lexically_normal().string();
  const bool plain = absolute.find_first_not_of(
                         "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789"
                         "_-+./") == std::string::npos;
  if (plain) return absolute;
  const fs::path link = folder / "plan" / link_name;
  std::error_code error;
  if (!fs::is_symlink(link, error) || fs::read_symlink(link, error) != absolute) {
    fs::remove(link, error);
    fs::create_symlink(absolute, link, error);
    if (error) throw InputError(link.string() + ": cannot be made: " + error.message());
  }
  return "plan/" + link_name;
}

}  // namespace

void write_plan_folder(const Plan& plan, const std::string& folder, const std::string& executables) {
  const fs::path root(folder);
  std::error_code error;
  if (fs::exists(root / "Makefile", error) && !read_text((root / "Makefile").string()).starts_with(makefile_beginning))
    throw InputError((root / "Makefile").string() + ": is not sg-plan's; give the scene a folder of its own");
  make_folder(root / "plan");
  make_folder(root / ".done");
  std::map<std::string, std::string> names;  // of external files, as the Makefile writes them
  json stages = json::array();
  for (const PlannedStage& stage : plan.stages) {
    json files = json::array();
    for (const ExternalFile& file : stage.files) {
      const fs::path absolute = fs::absolute(file.path).lexically_normal();
      std::string extension = absolute.extension().string();
      if (extension.find_first_not_of(".abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789") !=
          std::string::npos)
        extension.clear();
      names["@" + file.name] = safe_name(file.path, root, file.name + extension);
      files.push_back({{"name", file.name}, {"path", bytes_to_json(absolute.string())}});
    }
    if (stage.needed && !stage.slice.is_null())
      write_text_atomically((root / "plan" / (stage.name + ".json")).string(), stage.slice.dump(2) + "\n");
    stages.push_back({{"name", stage.name},
                      {"program", stage.program()},
                      {"purpose", stage.purpose},
                      {"needed", stage.needed},
                      {"on_demand", stage.on_demand},
                      {"reason", stage.reason},
                      {"arguments", stage.arguments},
                      {"artefacts", stage.artefacts},
                      {"files", files},
                      {"outputs", stage.outputs},
                      {"views", stage.views},
                      {"slice", !stage.slice.is_null()}});
  }
  json reads = json::array();
  for (const std::string& file : plan.read)
    reads.push_back(bytes_to_json(fs::absolute(file).lexically_normal().string()));
  const json description = {{"scene", bytes_to_json(fs::absolute(plan.scene).lexically_normal().string())},
                            {"scene_shown", one_line(plan.scene)},
                            {"read", reads},
                            {"material", plan.material},
                            {"executables", bytes_to_json(executables)},
                            {"stages", stages}};
  write_text_atomically((root / "plan" / "plan.json").string(), dump(description));
  const std::string programs = safe_name(executables, root, "bin");
  write_text_atomically((root / "Makefile").string(), plan_makefile(plan, names, programs));
  write_text_atomically((root / ".done" / "plan").string(), dump(Folder(folder).plan_dependencies()));
}

std::vector<StageState> refresh_plan_folder(const std::string& path) {
  Folder folder(path);
  std::vector<StageState> states;
  int order = 0;
  const fs::path plan_stamp = folder.root() / ".done" / "plan";
  std::error_code ignored;
  if (!fs::is_regular_file(plan_stamp, ignored) || read_text(plan_stamp.string()) != dump(folder.plan_dependencies()))
    fs::remove(plan_stamp, ignored);
  for (const json& stage : folder.stages()) {
    if (!stage.at("needed").get<bool>()) continue;
    const std::string why = folder.reason_to_run(stage);
    std::error_code error;
    ++order;
    if (why.empty()) {
      folder.set_time(folder.stamp(stage), order);
    } else if (!fs::remove(folder.stamp(stage), error) && error) {
      throw InputError(folder.stamp(stage).string() + ": cannot be removed: " + error.message());
    }
    ++order;
    for (const json& output : stage.at("outputs")) folder.set_time(folder.content_stamp(output), order);
    states.push_back({stage.at("name"), why.empty(), why});
  }
  return states;
}

std::string scene_of_plan_folder(const std::string& path) { return Folder(path).scene(); }

void stamp_stage(const std::string& path, const std::string& name) {
  Folder folder(path);
  for (const json& stage : folder.stages()) {
    if (stage.at("name") != name) continue;
    json outputs = json::object();
    for (const std::string& output : all_outputs(folder, stage)) {
      const std::string hash = folder.output_hash(output);
      if (hash.empty()) throw InputError((folder.root() / output).string() + ": was not written by " + name);
      outputs[output] = hash;
    }
    for (const json& output : stage.at("outputs"))
      write_text_atomically(folder.content_stamp(output).string(), outputs.at(output.get<std::string>()));
    const json done = {{"from", folder.dependencies(stage)}, {"outputs", outputs}};
    // Removed first: the new stamp must be newer even where its text is the same.
    std::error_code ignored;
    fs::remove(folder.stamp(stage), ignored);
    write_text_atomically(folder.stamp(stage).string(), dump(done));
    return;
  }
  throw InputError(path + ": its plan has no stage '" + name + "'");
}

}  // namespace shellgrid
