// SPDX-License-Identifier: AGPL-3.0-or-later
// Outputs appear whole or not at all.
#pragma once
#include <cstdint>
#include <functional>
#include <string>
#include <string_view>

namespace shellgrid {

// Calls write(temporary path) for a file beside `path`, with the same extension, then syncs it to disk and renames it
// to `path`. If anything fails, the temporary is removed and `path` is left as it was. Where the new bytes equal those
// of `path`, `path` keeps its time, so that Make re-runs nothing after it. Throws: InputError with the system's reason
// (folder missing, not writable, disk full); whatever `write` throws.
void write_atomically(const std::string& path, const std::function<void(const std::string&)>& write);

// The same for a whole text.
void write_text_atomically(const std::string& path, const std::string& text);

// The whole file. Throws: InputError naming the path and the reason.
std::string read_text(const std::string& path);
// At most so many bytes from its begin.
std::string read_head(const std::string& path, std::size_t bytes);
// The whole file, block by block.
void read_blocks(const std::string& path, const std::function<void(std::string_view)>& take);

// XXH64 of a file's bytes, as 16 hexadecimal digits. Throws: InputError.
std::string hash_file(const std::string& path);
std::uint64_t file_size(const std::string& path);

}  // namespace shellgrid
