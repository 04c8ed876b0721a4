// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/scene/run_report.h"

#include <fmt/format.h>
#include <png.h>

#include <algorithm>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>

#include "meshing/core/error.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/formats/output_file.h"
#include "pipeline/cli/option_table.h"
#include "pipeline/cli/record.h"
#include "solvers/render/mesh_preview.h"

namespace shellgrid {
namespace {

namespace fs = std::filesystem;
using json = nlohmann::ordered_json;

const char* const style = R"(
body { font: 15px/1.5 system-ui, sans-serif; max-width: 62em; margin: 2em auto; padding: 0 1em; color: #222; }
h1 { font-size: 1.5em; } h2 { font-size: 1.2em; margin: 2em 0 .3em; border-top: 1px solid #ccc; padding-top: 1em; }
table { border-collapse: collapse; margin: .5em 0; } td, th { padding: .1em .9em .1em 0; text-align: left; vertical-align: top; }
td.n, th.n { text-align: right; } code, pre { font: 13px/1.4 ui-monospace, monospace; }
pre { background: #f4f4f4; padding: .5em; white-space: pre-wrap; overflow-wrap: anywhere; }
img { max-width: 100%; display: block; margin: .5em 0; } .left { color: #777; } .warning { color: #a50; }
section { display: flow-root; } section img { float: right; margin: 0 0 1em 1em; width: 400px; }
)";

std::string escaped(const std::string& text) {
  std::string out;
  for (const char character : text) switch (character) {
      case '&':
        out += "&amp;";
        break;
      case '<':
        out += "&lt;";
        break;
      case '>':
        out += "&gt;";
        break;
      case '"':
        out += "&quot;";
        break;
      default:
        out += character;
    }
  return out;
}

std::string base64(const std::string& bytes) {
  static const char* const digits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  out.reserve((bytes.size() + 2) / 3 * 4);
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const std::size_t left = std::min<std::size_t>(3, bytes.size() - i);
    unsigned word = 0;
    for (std::size_t k = 0; k < 3; ++k) word = word << 8 | (k < left ? static_cast<unsigned char>(bytes[i + k]) : 0u);
    for (std::size_t k = 0; k < 4; ++k) out += k <= left ? digits[word >> (18 - 6 * k) & 63] : '=';
  }
  return out;
}

std::string encode_png(const MeshPreview& preview) {
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  image.width = static_cast<png_uint_32>(preview.width);
  image.height = static_cast<png_uint_32>(preview.height);
  image.format = PNG_FORMAT_RGB;
  png_alloc_size_t size = 0;
  if (!png_image_write_to_memory(&image, nullptr, &size, 0, preview.rgb.data(), 0, nullptr))
    throw InternalError(std::string("a picture cannot be encoded: ") + image.message);
  std::string bytes(size, '\0');
  if (!png_image_write_to_memory(&image, bytes.data(), &size, 0, preview.rgb.data(), 0, nullptr))
    throw InternalError(std::string("a picture cannot be encoded: ") + image.message);
  bytes.resize(size);
  return bytes;
}

std::string image_tag(const std::string& png, const std::string& caption) {
  return "<img alt=\"" + escaped(caption) + "\" title=\"" + escaped(caption) + "\" src=\"data:image/png;base64," +
         base64(png) + "\">\n";
}

std::string value_text(const json& value) {
  if (value.is_number_integer()) return value.dump();
  if (value.is_number()) return fmt::format("{:.5g}", value.get<double>());
  if (value.is_string()) return value.get<std::string>();
  if (value.is_array()) {
    std::vector<std::string> parts;
    for (const json& part : value) parts.push_back(value_text(part));
    return fmt::format("{}", fmt::join(parts, ", "));
  }
  return value.dump();
}

void append_figures(std::string& rows, const json& values, const std::string& prefix) {
  for (const auto& [name, value] : values.items()) {
    std::string shown = prefix + name;
    std::replace(shown.begin(), shown.end(), '_', ' ');
    if (value.is_object())
      append_figures(rows, value, prefix + name + ", ");
    else
      rows += "<tr><td>" + escaped(shown) + "</td><td>" + escaped(value_text(value)) + "</td></tr>\n";
  }
}

std::string size_text(double bytes) {
  return bytes < 1e6 ? fmt::format("{:.1f} kB", bytes / 1e3) : fmt::format("{:.1f} MB", bytes / 1e6);
}

class Page {
 public:
  explicit Page(const std::string& folder) : root_(folder) {
    const fs::path plan = root_ / "plan" / "plan.json";
    std::error_code error;
    if (!fs::is_regular_file(plan, error))
      throw InputError(folder + ": holds no plan; make one with sg-plan SCENE -o " + folder);
    plan_ = parse(plan);
  }

  RunReport make() {
    std::string summary, sections, pictures;
    for (const json& stage : plan_.at("stages")) append_stage(stage, summary, sections);
    const std::string scene = fs::path(plan_.value("scene_shown", "")).filename().string();
    std::string& html = report_.html;
    html = "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>" + escaped(scene) +
           "</title><style>" + style + "</style></head><body>\n<h1>" + escaped(scene) +
           "</h1>\n<p>Material: " + escaped(plan_.value("material", "")) +
           fmt::format(". {} of {} stages made, {:.1f} s in all, at most {:.0f} MiB of memory.</p>\n",
                       report_.stages_made, report_.stages, report_.seconds, report_.peak_memory_mib);
    html += embedded("image.png", "the picture");
    html +=
        "<table><tr><th>stage</th><th></th><th class=\"n\">seconds</th><th class=\"n\">memory, MiB</th>"
        "<th class=\"n\">output</th></tr>\n" +
        summary + "</table>\n" + sections + "</body></html>\n";
    return std::move(report_);
  }

 private:
  json parse(const fs::path& path) const {
    const json value = json::parse(read_text(path.string()), nullptr, false);
    if (!value.is_object()) throw InputError(path.string() + ": is not a JSON record");
    return value;
  }

  bool has(const std::string& file) const {
    std::error_code error;
    return fs::is_regular_file(root_ / file, error);
  }

  std::string embedded(const std::string& png, const std::string& caption) {
    if (!has(png)) return "";
    ++report_.pictures;
    return image_tag(read_text((root_ / png).string()), caption);
  }

  // A stage's own picture: its view for a mesh viewer, or the mesh it wrote.
  std::string stage_picture(const json& stage) {
    std::vector<std::string> candidates = stage.at("views");
    for (const std::string output : stage.at("outputs")) {
      if (output.ends_with(".ply")) candidates.push_back(output);
      if (output.ends_with(".png")) return "";  // stands on top
    }
    for (const std::string& file : candidates) {
      if (!has(file)) continue;
      const MeshPreview preview = draw_mesh(read_mesh((root_ / file).string()), 640, 480);
      ++report_.pictures;
      std::string caption = file;
      if (preview.coloured_by_quality)
        caption +=
            fmt::format(", quality {:.4g} (dark) to {:.4g} (yellow)", preview.least_quality, preview.most_quality);
      return image_tag(encode_png(preview), caption);
    }
    return "";
  }

  // A page is for passing on: files from outside go by their names, not by where they lie on this machine.
  std::string portable(std::string command) const {
    for (const json& stage : plan_.at("stages"))
      for (const json& file : stage.at("files")) {
        std::string path;
        for (const json& byte : file.at("path")) path += static_cast<char>(byte.get<int>());
        const std::string whole = shell_command({path}), name = shell_command({fs::path(path).filename().string()});
        for (std::size_t at = command.find(whole); at != std::string::npos; at = command.find(whole, at + name.size()))
          command.replace(at, whole.size(), name);
      }
    return command;
  }

  void append_stage(const json& stage, std::string& summary, std::string& sections) {
    const std::string name = stage.at("name"), reason = stage.at("reason");
    if (!stage.at("needed").get<bool>()) {
      summary +=
          "<tr class=\"left\"><td>" + name + "</td><td colspan=\"4\">left out: " + escaped(reason) + "</td></tr>\n";
      return;
    }
    const std::string output = stage.at("outputs").front();
    if (stage.value("on_demand", false) && !has(output)) return;
    ++report_.stages;
    const std::string link = "<td><a href=\"#" + name + "\">" + name + "</a></td>";
    if (!has(output + ".json") || !has(output)) {
      summary += "<tr><td>" + name + "</td><td colspan=\"4\">not made yet</td></tr>\n";
      return;
    }
    ++report_.stages_made;
    const json record = parse(root_ / (output + ".json"));
    const json seconds = record.value("seconds", json::object());
    const double total = seconds.value("total", 0.0), memory = record.value("peak_memory_mib", 0.0);
    report_.seconds += total;
    report_.peak_memory_mib = std::max(report_.peak_memory_mib, memory);
    double bytes = 0;
    std::string files;
    for (const json& file : record.value("outputs", json::array())) {
      bytes += file.value("bytes", 0.0);
      files += (files.empty() ? "" : ", ") + escaped(file.value("path", "")) + " (" +
               size_text(file.value("bytes", 0.0)) + ")";
    }
    summary += "<tr>" + link + "<td>" + escaped(stage.at("purpose")) +
               fmt::format("</td><td class=\"n\">{:.2f}</td><td class=\"n\">{:.0f}</td><td class=\"n\">{}</td></tr>\n",
                           total, memory, size_text(bytes));

    sections += "<section id=\"" + name + "\"><h2>" + name + ": " + escaped(stage.at("purpose")) + "</h2>\n" +
                stage_picture(stage) + "<p>It runs because " + escaped(reason) + ". Writes " + files +
                ".</p>\n<table>\n";
    append_figures(sections, record.value("results", json::object()), "");
    append_figures(sections, seconds, "seconds, ");
    sections += fmt::format("<tr><td>peak memory</td><td>{:.0f} MiB</td></tr>\n<tr><td>threads</td><td>{}</td></tr>\n",
                            memory, record.value("threads", 1));
    sections += "</table>\n";
    for (const json& warning : record.value("warnings", json::array()))
      sections += "<p class=\"warning\">Warning: " + escaped(portable(value_text(warning))) + "</p>\n";
    sections += "<p>Remake it in this run's folder:</p><pre>rm " + escaped(shell_command({output})) + "; make " +
                escaped(shell_command({output})) + "\n" + escaped(portable(record.value("command", ""))) +
                "</pre></section>\n";
  }

  fs::path root_;
  json plan_;
  RunReport report_;
};

}  // namespace

RunReport report_run(const std::string& folder) { return Page(folder).make(); }

}  // namespace shellgrid
