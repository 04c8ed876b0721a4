// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/scene/shell_texture_file.h"

#include <filesystem>

#include "meshing/formats/number_archive.h"
#include "meshing/formats/vdb_file.h"
#include "solvers/shell_texture/shell_texture_archive.h"
#include "solvers/shell_texture/shell_texture_codec.h"

namespace shellgrid {

std::unique_ptr<ShellTextureLookup> open_shell_texture(const std::string& path) {
  if (std::filesystem::path(path).extension() == ".stf") return restore_compressed(read_number_archive(path), path);
  return look_up_as_it_is(restore_shell_texture(read_vdb(path)));
}

IrradianceCorrection irradiance_correction(const std::string& name) {
  if (name == "none") return IrradianceCorrection::none;
  return name == "one" ? IrradianceCorrection::one_kernel : IrradianceCorrection::kernels;
}

}  // namespace shellgrid
