#!/usr/bin/python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""What a picture by a shell texture function costs, at the sizes of [STF, table 1] and beside its times: the stages
that a new light or view runs, sg-core and sg-render; what is made once for an object comes before and is not counted.

    shell_texture_cost.py -o OUT [--bunny MESH] [--only NAME] [--work FOLDER] [--runs 3]

Writes OUT/shell_texture_cost.csv, medians of so many runs; executables in SG_BIN, or build/bin, samples in assets/ of
SG_SOURCE, or of this folder. Wall time means something on a quiet machine, processor time (of both threads) on any.
`irradiance` is what the paper has in parentheses: light that reaches the surface, for the core, and the dipole;
`exchange` is the dipole's part of it. Without MESH a bumpy ball stands for the bunny.
"""
import argparse
import csv
import json
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time

import numpy

from shape_samples import bulged

HERE = os.path.dirname(os.path.abspath(__file__))
SOURCE = os.environ.get("SG_SOURCE", os.path.join(HERE, "..", ".."))
sys.path.insert(0, os.path.join(SOURCE, "tests", "support"))
from programs import BIN, torus, write_off  # noqa: E402

SKY = {"type": "environment", "up": [0, 1, 0], "zenith": [0.9, 1.0, 1.2], "horizon": [0.5, 0.5, 0.55],
       "ground": [0.2, 0.18, 0.15]}
LIGHTS = ("sun", "sky")  # of the second the sun is a part


def strawberry():
    """Tapered, 240×240×272."""
    points, faces = bulged([(0, 0, 1), (0, 0, -1)], [0.05, 0.1], [0.2, 0.05])
    points = points * numpy.array([1, 1, 1.2])
    points[:, :2] *= (1 + 0.35 * points[:, 2:] / 1.2) ** 0.5
    low, high = points.min(axis=0), points.max(axis=0)
    return (points - (low + high) / 2) / (high - low) * numpy.array([240, 240, 272]), faces


def bumpy_ball():
    turns = numpy.arange(24) * 2.399963
    height = 1 - 2 * (numpy.arange(24) + 0.5) / 24
    across = numpy.sqrt(1 - height**2)
    directions = numpy.stack([across * numpy.cos(turns), height, across * numpy.sin(turns)], 1)
    return bulged(directions, [0.18] * 24, [0.02] * 24)


# Name, mesh or none for the bunny's, longest side in voxels, the sample and changes of it, layers, the camera's place
# in sizes; the paper's time and, of it, irradiance's.
OBJECTS = [
    ("torus", lambda: torus(96, 56, 192, 96), 304, "marble", {"size": [96, 96]}, 10, (0, -1.5, 1.5), 84, 38),
    ("bunny", None, 336, "bumps", {"thickness": 2.4, "radius": 0.8, "lift": 0.25, "count": 120}, 6, (-0.5, 0.5, 2.4),
     102, 52),
    ("strawberry", strawberry, 272, "strawberry", {}, 10, (0.2, -2.2, 0.6), 94, 54),
]


def sample_of(name):
    path = os.path.join(SOURCE, "assets", "samples", name + ".json")
    with open(path) as file:
        content = json.loads("\n".join(line for line in file.read().splitlines() if not line.startswith("//")))
    for part in content.get("parts", []):
        if "mesh" in part:
            part["mesh"] = os.path.abspath(os.path.join(os.path.dirname(path), part["mesh"]))
    return content


def sun_beside(camera, up):
    back = numpy.array(camera) / numpy.linalg.norm(camera)
    travels = -back + 0.7 * numpy.cross(up, back) - 0.4 * numpy.array(up)
    return {"type": "directional", "direction": list(travels / numpy.linalg.norm(travels)),
            "irradiance": [5.5, 4.3, 3.0]}


def prepared(folder, mesh, size, sample, layers, camera):
    """The folder of what sg-core and sg-render read; beside it, by light, their parts of the scene."""
    voxel = sample["voxel"]
    with open(os.path.join(folder, "sample.json"), "w") as file:
        json.dump(sample, file)
    out = os.path.join(folder, "out")
    length, up = size * voxel, [0, 1, 0] if abs(camera[1]) < 1 else [0, 0, 1]
    for light in LIGHTS:
        content = {
            "object": {"mesh": mesh, "size": length, "ior": sample["ior"]},
            "material": {"shell": {"sample": "sample.json", "thickness": layers * voxel, "voxel": voxel},
                         "core": "bottom-layer"},
            "lights": [sun_beside(camera, up)] + ([SKY] if light == "sky" else []),
            "camera": {"position": [c * length for c in camera], "look_at": [0, 0, 0],
                       "up": up, "fov": 26, "resolution": [720, 486]},
            "method": {"type": "shell-texture-function", "irradiance_error": 0.3, "samples_per_pixel": 4}}
        path = os.path.join(folder, light + ".json")
        with open(path, "w") as file:
            json.dump(content, file)
        ran(["plan", "-q", path, "-o", out])
        if light == LIGHTS[0]:
            make = subprocess.run(["make", "-C", out, "stf.vdb", "shell.vdb"], capture_output=True, text=True,
                                  env={**os.environ, "MAKEFLAGS": ""})
            if make.returncode:
                sys.exit(make.stdout + make.stderr)
        keep = os.path.join(folder, light)
        os.makedirs(keep, exist_ok=True)
        for name in ("core", "render"):
            shutil.copyfile(os.path.join(out, "plan", name + ".json"), os.path.join(keep, name + ".json"))
    return out


def ran(command):
    """Wall and processor time of a program."""
    before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    done = subprocess.run([os.path.join(BIN, "sg-" + command[0]), *command[1:]], capture_output=True, text=True)
    wall, after = time.monotonic() - started, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        sys.exit("sg-%s: %s" % (command[0], done.stderr))
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def record(path):
    with open(path + ".json") as file:
        return json.load(file)


def measure(out, light, runs, pictures):
    work = os.path.join(out, "..", light)
    at = lambda name: os.path.join(out, name)
    core, image = os.path.join(work, "core.ply"), pictures
    rows = []
    for _ in range(runs):
        walls = [ran(["core", "-q", os.path.join(work, "core.json"), at("synthesized.ply"), at("shell.vdb"),
                      at("stf.vdb"), "-o", core]),
                 ran(["render", "-q", os.path.join(work, "render.json"), at("synthesized.ply"), "-o", image,
                      "--stf", at("stf.vdb"), "--shell", at("shell.vdb"), "--core", core])]
        a, b = record(core)["seconds"], record(image)["seconds"]
        row = {"read": a["read"] + b["read"], "irradiance": a["light"] + a["exchange"], "exchange": a["exchange"],
               "picture": b["render"], "write": a["write"] + b["write"],
               "total": walls[0][0] + walls[1][0], "processor": walls[0][1] + walls[1][1]}
        rows.append(row)
    return {key: round(statistics.median(row[key] for row in rows), 3) for key in rows[0]}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", required=True)
    parser.add_argument("--bunny")
    parser.add_argument("--only", choices=[entry[0] for entry in OBJECTS])
    parser.add_argument("--work", help="keeps what is made there, and takes it where it is")
    parser.add_argument("--runs", type=int, default=3)
    options = parser.parse_args()
    os.makedirs(options.output, exist_ok=True)
    table = []
    with tempfile.TemporaryDirectory(prefix="sg-table-") as temporary:
        for name, shape, size, sample, changes, layers, camera, paper, paper_irradiance in OBJECTS:
            if options.only and name != options.only:
                continue
            folder = os.path.abspath(os.path.join(options.work or temporary, name))
            os.makedirs(folder, exist_ok=True)
            mesh = os.path.abspath(options.bunny) if not shape and options.bunny else os.path.join(folder, "mesh.off")
            if not os.path.exists(mesh):
                write_off(mesh, (shape or bumpy_ball)())
            out = prepared(folder, mesh, size, {**sample_of(sample), **changes}, layers, camera)
            grid = record(os.path.join(out, "shell.vdb"))["results"]
            for light in LIGHTS:
                row = measure(out, light, options.runs, os.path.join(options.output, "%s-%s.exr" % (name, light)))
                core = record(os.path.join(folder, light, "core.ply"))["results"]
                row = {"object": name, "light": light, "voxels": grid.get("voxels", grid.get("active_voxels", 0)),
                       "vertices": core["vertices"], **row, "paper_total": paper, "paper_irradiance": paper_irradiance}
                if not table:
                    print(",".join(row), flush=True)
                print(",".join(str(value) for value in row.values()), flush=True)
                table.append(row)
    with open(os.path.join(options.output, "shell_texture_cost.csv"), "w", newline="") as file:
        writer = csv.DictWriter(file, list(table[0]))
        writer.writeheader()
        writer.writerows(table)


if __name__ == "__main__":
    main()
