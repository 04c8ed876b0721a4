// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/scene/shell_texture_file.h"

#include <filesystem>

#include "meshing/formats/number_archive.h"
#include "meshing/formats/vdb_file.h"
#include "pipeline/scene/origin.h"
#include "solvers/shell_texture/shell_texture_archive.h"
#include "solvers/shell_texture/shell_texture_codec.h"

namespace shellgrid {

std::unique_ptr<ShellTextureLookup> open_shell_texture(const std::string& path, ShellTextureParts parts,
                                                       std::string* sample) {
  if (std::filesystem::path(path).extension() == ".stf") {
    const NumberArchive archive = read_number_archive(path);
    if (sample) *sample = archive.fingerprint;
    return restore_compressed(archive, path);
  }
  const VdbArchive archive = read_vdb(path, shell_texture_grids(parts));
  if (sample) *sample = note_of(archive.metadata, samples_note);
  if (parts == ShellTextureParts::all) return look_up_archive(archive);
  return look_up_bottom(restore_shell_texture(archive, parts));
}

IrradianceCorrection irradiance_correction(const std::string& name) {
  if (name == "none") return IrradianceCorrection::none;
  return name == "one" ? IrradianceCorrection::one_kernel : IrradianceCorrection::kernels;
}

}  // namespace shellgrid
