// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/scene/strict_json.h"

#include <fmt/format.h>

#include <set>
#include <vector>

#include "meshing/core/error.h"
#include "meshing/formats/output_file.h"
#include "pipeline/cli/nearest_name.h"

namespace shellgrid {

using nlohmann::json;

json read_strict_json(const std::string& path) {
  // A key written twice would silently lose its first value.
  std::vector<std::set<std::string>> keys;
  std::string twice;
  const auto watch = [&](int, json::parse_event_t event, json& parsed) {
    if (event == json::parse_event_t::object_start) keys.emplace_back();
    if (event == json::parse_event_t::object_end && !keys.empty()) keys.pop_back();
    if (event == json::parse_event_t::key && !keys.empty() && !keys.back().insert(parsed.get<std::string>()).second)
      twice = parsed.get<std::string>();
    return true;
  };
  try {
    json root = json::parse(read_text(path), watch, true, true);
    if (!twice.empty()) throw InputError(fmt::format("{}: the key '{}' stands twice in one section", path, twice));
    return root;
  } catch (const json::exception& error) {
    std::string reason = error.what();
    // "[json.exception.parse_error.101] parse error at line 3, column 5: …"
    if (const std::size_t end = reason.find("] "); end != std::string::npos) reason = reason.substr(end + 2);
    throw InputError(path + ": is not JSON: " + one_line(reason));
  }
}

}  // namespace shellgrid
