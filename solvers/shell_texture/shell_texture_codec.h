// SPDX-License-Identifier: AGPL-3.0-or-later
// Shell texture functions made small, and looked up as they are.
#pragma once
#include <memory>
#include <string>

#include "meshing/core/progress.h"
#include "meshing/formats/number_archive.h"
#include "solvers/shell_texture/component_table.h"
#include "solvers/shell_texture/shell_texture_lookup.h"

namespace shellgrid {

enum class ShellTextureCodec {
  vector_quantisation,  // the paper's: I_s and I_m of a voxel and direction as one of some six-vectors, entropy coded
                        // [STF §5.2]; I_m(ω_b) by principal components
  principal_components  // all of a voxel's values at once; see component_table.h
};

struct CodecReport {
  std::size_t bytes = 0;       // of I_s, I_m and I_m(ω_b) of the voxels that hold matter
  double ratio = 0, psnr = 0;  // to single precision; dB, of the peaks of I_s, I_m, I_m(ω_b) by channel
  int words = 0;               // codewords or components
};

// What can be written and looked up. Blocks of 8×8×1 voxels are unpacked when they are asked for; a reader keeps the
// last ones.
class CompressedShellTexture : public ShellTextureLookup {
 public:
  virtual NumberArchive archive() const = 0;

 protected:
  using ShellTextureLookup::ShellTextureLookup;
};

// Voxels that hold no matter are left out. Where the ratio asked for cannot be reached the smallest comes back, and so
// the nearest where the PSNR cannot. Throws: InputError where the texture's arrays do not fit or it has no matter.
std::unique_ptr<CompressedShellTexture> compress_shell_texture(const ShellTexture& texture, ShellTextureCodec codec,
                                                               const CodecGoal& goal, CodecReport* report = nullptr);

// Throws: InputError for an archive that is none of these, or damaged. `path` for messages.
std::unique_ptr<CompressedShellTexture> restore_compressed(const NumberArchive& archive, const std::string& path);

// PSNR of a lookup's values against the texture, as in CodecReport, by unpacking it all.
double psnr_of(const ShellTexture& texture, const ShellTextureLookup& lookup);

}  // namespace shellgrid
