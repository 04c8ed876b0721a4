// SPDX-License-Identifier: AGPL-3.0-or-later
// What artefacts tell of what they were made from, so that what does not belong together is refused wherever the files
// have gone since. Hashes are those of the records, XXH64 of a file's bytes.
#pragma once
#include <map>
#include <string>
#include <vector>

#include "pipeline/scene/scene.h"

namespace shellgrid {

// Keys of an OpenVDB file's metadata and a PLY file's notes.
inline constexpr const char* samples_note = "sample_xxh64";  // of the samples' files, in their order
inline constexpr const char* shell_note = "shell_xxh64";     // of shell.vdb
inline constexpr const char* lights_note = "lights";         // see hash_lights
inline constexpr const char* shape_note = "shape";  // body, bends or flat: of body the core's ratios count bends, too
inline constexpr const char* flat_note = "flat";    // yes or no: whether the core was taken as flat

// What a file tells under a key; empty where it tells nothing.
std::string note_of(const std::map<std::string, std::string>& notes, const std::string& key);

// Hashes of files in their order, separated by blanks. Throws: InputError.
std::string hash_files(const std::vector<std::string>& paths);

// Of all lights of a scene with their pictures, 16 hexadecimal digits.
std::string hash_lights(const std::vector<Light>& lights);

// Whether two files were made from the same samples, `a` and `b` as their notes say; one that tells nothing is
// believed. Throws: InputError naming both.
void require_same_samples(const std::string& a, const std::string& a_path, const std::string& b,
                          const std::string& b_path);
// Whether a file with that note was made from these samples' files, in this order; a sample that another program saved
// since is believed. Throws: InputError.
void require_made_from(const std::string& note, const std::string& path, const std::vector<std::string>& sample_paths);
// Whether a stage's output with these notes was made under a scene's lights and for that shell, as far as they tell; a
// shell that another program saved since is believed. Throws: InputError.
void require_shell_and_lights_of(const std::map<std::string, std::string>& notes, const std::string& path,
                                 const std::string& writer, const std::string& shell_path, const Scene& scene);
// Whether core.ply was made under a scene's lights, of that shell and that texture function's sample, as far as it
// tells; a shell that another program saved since is believed. Throws: InputError.
void require_core_of(const std::string& core_path, const std::string& sample, const std::string& texture_path,
                     const std::string& shell_path, const Scene& scene);

}  // namespace shellgrid
