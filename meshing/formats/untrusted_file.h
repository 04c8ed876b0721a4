// SPDX-License-Identifier: AGPL-3.0-or-later
// How files are read whose library may crash on corrupt ones: what this project wrote carries a seal,
// a hash of its own bytes; a file without a valid seal is first read by a child process with limits.
#pragma once
#include <cstdint>
#include <functional>
#include <string>
#include <string_view>

namespace shellgrid {

// XXH3 of the bytes of both parts with 128 bits, as 32 hexadecimal digits.
std::string seal_of(std::string_view bytes, std::string_view more_bytes = {});
// The same of a file but for `size` bytes at `left_out`.
std::string seal_of_file(const std::string& path, std::uint64_t left_out, std::uint64_t size);

// A library's message on one line.
std::string one_line(std::string message);

// Calls read() in a child process of limited memory and time, a guarded child: read() marks the library's part of its
// work as ForeignCode (meshing/core/guarded_child.h). Throws: InputError with the message of what read()
// threw or its library printed on stderr, or "PATH: … is corrupt" if the child crashed, ran out of memory or took too
// long.
void rehearse_reading(const std::string& path, const std::string& kind, const std::function<void()>& read);

}  // namespace shellgrid
