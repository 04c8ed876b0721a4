#!/usr/bin/python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Diffuse reflectance of half-spaces under diffuse light by sg-reference, as a C++ list: what the conversion of colours to
albedos is held to.

    half_space_table.py [--paths 4e5] > tests/synthesis/half_space_table.inc        executables in SG_BIN, or build/bin
"""
import argparse
import json
import os
import subprocess
import tempfile

BIN = os.environ.get("SG_BIN", "build/bin")
ALBEDOS = (0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.995)
INDICES = (1.0, 1.3, 1.5)


def reflectance(albedo, ior, paths):
    """Of what entered: the estimate and its standard error."""
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "tally.json")
        subprocess.run([os.path.join(BIN, "sg-reference"), "-q", "--tally", "half-space", "--source", "diffuse",
                        "--absorption", repr(1 - albedo), "--scattering", repr(albedo), "--ior", repr(ior), "--paths",
                        str(paths), "-o", path], check=True)
        with open(path) as file:
            measured = json.load(file)
    # The tally's shares are of the light that was sent.
    entered = 1 - measured["specular_reflectance"]["value"]
    diffuse = measured["diffuse_reflectance"]
    return diffuse["value"] / entered, diffuse["standard_error"] / entered


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--paths", default="4e5")
    options = parser.parse_args()
    print("// SPDX-License-Identifier: AGPL-3.0-or-later\n"
          "// Printed by tests/synthesis/half_space_table.py: albedo, index, reflectance, standard error.")
    for ior in INDICES:
        for albedo in ALBEDOS:
            print("{%g, %g, %.6f, %.6f}," % ((albedo, ior) + reflectance(albedo, ior, options.paths)), flush=True)


if __name__ == "__main__":
    main()
