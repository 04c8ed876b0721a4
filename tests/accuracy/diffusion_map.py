#!/usr/bin/python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Where diffusion may be used: the exitance of sg-diffuse held against sg-reference.

    diffusion_map.py -o OUT [--bunny MESH]      writes map.csv, map.md and map.png; executables in SG_BIN, or build/bin

A sphere, a plate lit on its face and its edge, and a bunny, under parallel light from the side, by reduced albedo, by the
object's optical thickness (its mean chord 4 V / A in reduced mean free paths) and for both sources. The material scatters
isotropically (so that its coefficients are the reduced ones; --anisotropy 0.8: others of the same reduced ones) at index 1.5
(--ior); light that leaves does not come back. For each:

  error           relative root mean square of the difference of exitances, weighted by area, less the reference's noise
  smooth          the same without the vertices on creases (45° and more) and next to them, which are means over two faces
                  of different light: an error of the surface's tiling, that falls with the root of its edges' length
  uncertainty     of the error: what the noise leaves
  discretisation  the share of the grid in it, estimated from a grid twice as coarse
  bias            relative error of all the light that leaves
  noise           relative standard error of the reference's exitance, of which the square has been subtracted
  expected        the error that sg-diffuse itself expects of diffusion

The short form takes two thicknesses of the sphere and small grids, SG_LONG=1 the whole map; of shapes that are not done
again (--shapes) the rows in OUT/map.csv stay. A stage that ends badly is named,
and the exit code is 1.
"""
import argparse
import csv
import json
import math
import os
import subprocess
import sys
import tempfile

import numpy

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path.append(os.path.join(HERE, "..", "support"))
import programs
from ply_file import read_ply

programs.BIN = os.path.abspath(programs.BIN)
LONG = "SG_LONG" in os.environ
# Three a scene, one a channel: paths are shared.
ALBEDOS = [(0.5, 0.8, 0.95), (0.99, 0.999, 0.9999)]
THICKNESSES = [1, 3, 10, 30, 100] if LONG else [3, 30]
SOURCES = ["boundary", "first-collision"]
# Of the coarse and the fine grid, from this thickness on: a mean free path takes more of them in thicker objects.
NODES = {1: (2.5e4, 2e5), 30: (1e5, 8e5)} if LONG else {1: (2e3, 1.6e4)}
VERTICES = 2500 if LONG else 600
PATHS = 2e6 if LONG else 6e4
SIZE = 10.0  # mm, of the longest edge
# From the side, on which the plate shows a broad face and two edges.
LIGHT = [-0.8, -0.25, -0.55]
COLUMNS = ["shape", "thickness", "albedo", "source", "error", "smooth", "uncertainty", "discretisation", "bias", "noise",
           "expected", "unscattered", "negative", "cells_per_reach", "longest_edge", "paths"]


class Failed(Exception):
    pass


def stage(name, *arguments, cwd, accepted=(0,)):
    done = programs.run(name, "-q", *arguments, cwd=cwd, timeout=3600)
    if done.returncode not in accepted:
        raise Failed(done.stderr.strip() or "sg-%s ended with %d" % (name, done.returncode))
    return done.returncode


def scene_of(albedos, extinction, anisotropy, ior):
    """Three channels of one reduced extinction; a single albedo is that of all."""
    three = albedos if len(albedos) == 3 else 3 * list(albedos)
    return {"object": {"ior": ior},
            "material": {"core": {"absorption": [extinction * (1 - a) for a in three],
                                  "scattering": [extinction * a / (1 - anisotropy) for a in three],
                                  "anisotropy": anisotropy}},
            "lights": [{"type": "directional", "direction": LIGHT, "irradiance": 1}]}


class Shape:
    """A mesh of a shape with its polygrids."""

    def __init__(self, name, folder, bunny=None, anisotropy=0, ior=1.5):
        self.name, self.folder, self.light_model = name, os.path.join(folder, name), (anisotropy, ior)
        os.makedirs(self.folder)
        if name == "bunny":
            mesh = os.path.abspath(bunny)
        else:
            mesh = "mesh.off"
            programs.write_off(os.path.join(self.folder, mesh),
                               programs.icosphere(5) if name == "sphere" else programs.box((3, 3, 1)))
        # So that there are about so many vertices: triangles of .43 spacing² each, two a vertex.
        self.prepare(mesh, 0.05 * SIZE)
        area = self.measure()[1]
        self.prepare(mesh, math.sqrt(area / (0.86 * VERTICES)))
        self.volume, self.area, self.hats, self.smooth = self.measure()
        self.chord = 4 * self.volume / self.area
        stage("tetrahedralize", "surface.ply", "-o", "tets.hdf", cwd=self.folder)
        self.spacing = {}
        for nodes in sorted({nodes for pair in NODES.values() for nodes in pair}):
            grid = "polygrid%g.hdf" % nodes
            stage("polycube", "tets.hdf", "-o", "polycube.hdf", "--nodes", "%g" % nodes, cwd=self.folder)
            stage("polygrid", "polycube.hdf", "surface.ply", "-o", grid, cwd=self.folder)
            self.spacing[nodes] = programs.record(os.path.join(self.folder, grid))["results"]["spacing"]

    def prepare(self, mesh, spacing):
        stage("prepare", mesh, "-o", "surface.ply", "--size", SIZE, "--spacing", "%.3g" % spacing, cwd=self.folder)

    def measure(self):
        """Volume, area, the integral of each vertex's hat function, and whether it is off creases by two edges."""
        vertices, faces = read_ply(os.path.join(self.folder, "surface.ply"))
        points = numpy.stack([vertices[axis] for axis in "xyz"], 1).astype(float)
        a, b, c = (points[faces[:, k]] for k in range(3))
        cross = numpy.cross(b - a, c - a)
        areas = numpy.linalg.norm(cross, axis=1) / 2
        hats = numpy.zeros(len(points))
        for k in range(3):
            numpy.add.at(hats, faces[:, k], areas / 3)
        sides = {}
        for face, corners in enumerate(faces):
            for k in range(3):
                sides.setdefault(tuple(sorted((corners[k], corners[(k + 1) % 3]))), []).append(face)
        normals = cross / (2 * areas[:, None])
        creased = numpy.zeros(len(points), bool)
        for ends, (one, other) in sides.items():
            creased[list(ends)] |= normals[one] @ normals[other] < math.sqrt(0.5)
        near = creased[faces].any(1)
        creased[faces[near].ravel()] = True
        return (a * cross).sum() / 6, areas.sum(), hats, ~creased

    def compare(self, thickness, albedos, say):
        """Rows of the table: for each source and albedo."""
        extinction = thickness / self.chord
        scene = scene_of(albedos, extinction, *self.light_model)
        programs.write_json(os.path.join(self.folder, "scene.json"), scene)
        at = lambda name: os.path.join(self.folder, name)
        stage("reference", "scene.json", "surface.ply", "-o", "reference.ply", "--paths", "%g" % PATHS, "--no-interreflection",
              cwd=self.folder)
        reference = read_ply(at("reference.ply"))[0]
        results = programs.record(at("reference.ply"))["results"]
        grids = NODES[max(least for least in NODES if least <= thickness)]
        coarse, fine = (self.spacing[nodes] for nodes in grids)
        rows = []
        for source in SOURCES:
            exitances = [self.solve(nodes, scene, albedos, extinction, source) for nodes in grids]
            for c, albedo in enumerate(albedos):
                colour = "_" + "rgb"[c]
                truth, noise = (reference[name + colour].astype(float) for name in ("exitance", "exitance_error"))
                reach = 1 / (extinction * math.sqrt(3 * (1 - albedo)))
                row = {"shape": self.name, "thickness": thickness, "albedo": albedo, "source": source,
                       "paths": results["paths"], "cells_per_reach": reach / fine,
                       "longest_edge": SIZE * extinction}
                rows.append(row)
                say("%-7s %4g  %-7g %-16s " % (self.name, thickness, albedo, source), end="")
                if exitances[1][c] is None:
                    say("refused")
                    continue
                # Only the coarse grid may have been refused: its share is not known then.
                known, smooth = exitances[0][c] is not None, self.smooth
                coarser, finer = exitances[0 if known else 1][c][0], exitances[1][c][0]
                row["smooth"] = judge(self.hats[smooth], truth[smooth], noise[smooth], coarser[smooth], finer[smooth],
                                      4)["error"]
                row.update(judge(self.hats, truth, noise, coarser, finer, (coarse / fine) ** 2), **exitances[1][c][1])
                if not known:
                    row["discretisation"] = ""
                say("error %6.1f %% ± %.1f  smooth %6.1f %%  bias %+6.1f %%  noise %4.1f %%  grid %s" % (*(
                    100 * row[key] for key in ("error", "uncertainty", "smooth", "bias", "noise")),
                    "%5.1f %%" % (100 * row["discretisation"]) if known else "?"))
        return rows

    def solve(self, nodes, scene, albedos, extinction, source):
        """Of each albedo the exitance on a grid, and what the record knows; None: refused."""
        exitance, fluence = os.path.join(self.folder, "exitance.ply"), os.path.join(self.folder, "fluence.hdf")
        diffuse = ["scene.json", "polygrid%g.hdf" % nodes, "surface.ply", "-o", fluence, "--exitance", exitance, "--source",
                   source, "--tolerance", "1e-3"]
        programs.write_json(os.path.join(self.folder, "scene.json"), scene)
        code = stage("diffuse", *diffuse, cwd=self.folder, accepted=(0, 4))
        if code == 4 and len(albedos) > 1:
            # One channel that is refused must not take the others with it.
            grey = lambda albedo: scene_of([albedo], extinction, *self.light_model)
            return [self.solve(nodes, grey(albedo), [albedo], extinction, source)[0] for albedo in albedos]
        if code == 4:
            return [None]
        vertices, results = read_ply(exitance)[0], programs.record(fluence)["results"]
        beams = results.get("beams")
        return [(vertices["exitance_" + "rgb"[c]].astype(float),
                 {"expected": results["expected_error_of_diffusion"][c],
                  "unscattered": beams["leaving_unscattered"][c] / beams["entering"][c] if beams else ""})
                for c in range(len(albedos))]


def judge(weights, truth, noise, coarse, fine, finer):
    """Error of `fine` against the noisy truth; `finer`: by how much its discretisation error is less than that of `coarse`."""
    size = (weights * (truth**2 - noise**2)).sum()
    square = (weights * ((fine - truth) ** 2 - noise**2)).sum() / size
    # Normal noise e on a true difference m: the square's variance is 2 e⁴ + 4 m² e².
    model = numpy.maximum((fine - truth) ** 2 - noise**2, 0)
    deviation = math.sqrt((weights**2 * (2 * noise**4 + 4 * model * noise**2)).sum()) / size
    error = math.sqrt(max(square, 0))
    return {"error": error, "uncertainty": deviation / (2 * error) if square > deviation else math.sqrt(deviation),
            "discretisation": math.sqrt((weights * (fine - coarse) ** 2).sum() / size) / (finer - 1),
            "bias": (weights * (fine - truth)).sum() / (weights * truth).sum(),
            "noise": math.sqrt((weights * noise**2).sum() / size),
            "negative": float((fine < 0).mean())}


def write_summary(rows, path):
    """Percent off creases, as Markdown: by albedo and thickness for each shape and source."""
    with open(path, "w") as file:
        for source in dict.fromkeys(row["source"] for row in rows):
            file.write("\n**%s**\n\n| reduced albedo | " % source)
            shapes = list(dict.fromkeys(row["shape"] for row in rows))
            thicknesses = list(dict.fromkeys(row["thickness"] for row in rows))
            file.write(" | ".join("%s %g" % (shape, t) for shape in shapes for t in thicknesses) + " |\n|---|")
            file.write("---|" * len(shapes) * len(thicknesses) + "\n")
            for albedo in sorted({row["albedo"] for row in rows}):
                cells = []
                for shape in shapes:
                    for t in thicknesses:
                        found = [row for row in rows if (row["shape"], row["thickness"], row["albedo"], row["source"]) ==
                                 (shape, t, albedo, source)]
                        cells.append("%.2g" % (100 * found[0]["smooth"]) if found and "error" in found[0] else "–")
                file.write("| %g | %s |\n" % (albedo, " | ".join(cells)))


def draw(rows, table, picture):
    """One panel a shape and source, by albedo and thickness."""
    shapes = list(dict.fromkeys(row["shape"] for row in rows))
    thicknesses = sorted({row["thickness"] for row in rows})
    albedos = sorted({row["albedo"] for row in rows})
    commands = ["set terminal pngcairo size %d,800 font ',11'" % max(460 * len(shapes), 860), "set output '%s'" % picture,
                "set multiplot layout %d,%d title 'Error of the exitance of sg-diffuse against sg-reference off creases, "
                "percent; in brackets the share of the grid'" % (len(SOURCES), len(shapes)),
                "set palette defined (0 '#1a9850', 0.35 '#a6d96a', 0.55 '#ffffbf', 0.75 '#fdae61', 1 '#d73027')",
                "set cbrange [-2.3:0]", "unset colorbox", "unset key",
                "set xrange [-.5:%g]" % (len(thicknesses) - .5), "set yrange [-.5:%g]" % (len(albedos) - .5),
                "set xtics (%s)" % ", ".join("'%g' %d" % (t, i) for i, t in enumerate(thicknesses)),
                "set ytics (%s)" % ", ".join("'%g' %d" % (a, i) for i, a in enumerate(albedos)),
                "set xlabel 'mean chord in reduced mean free paths'", "set ylabel 'reduced albedo'"]
    blocks = []
    for source in SOURCES:
        for shape in shapes:
            name = "$panel%d" % len(blocks)
            lines = []
            for row in rows:
                if (row["shape"], row["source"]) != (shape, source):
                    continue
                place = "%d %d" % (thicknesses.index(row["thickness"]), albedos.index(row["albedo"]))
                if "error" in row:
                    grid = "(?)" if row["discretisation"] == "" else "(%.2g)" % (100 * row["discretisation"])
                    lines.append('%s %g "%.2g" "%s"' % (place, math.log10(min(max(row["smooth"], 1e-4), 1)),
                                                        100 * row["smooth"], grid))
                else:
                    lines.append('%s 0.1 "refused" ""' % place)
            blocks.append("%s << EOD\n%s\nEOD" % (name, "\n".join(lines)))
            commands += ["set title '%s, %s'" % (shape, source),
                         "plot %s using 1:2:3 with image, %s using 1:($2+.12):4 with labels, "
                         "%s using 1:($2-.2):5 with labels font ',8'" % (name, name, name)]
    subprocess.run(["gnuplot"], input="\n".join(blocks + commands), text=True, check=True)


def kept_rows(path, shapes):
    """Of a table that is there: the rows of other shapes."""
    if not os.path.exists(path):
        return []
    with open(path) as file:
        kept = [row for row in csv.DictReader(file) if row["shape"] not in shapes]
    for row in kept:
        for name, value in list(row.items()):
            if name not in ("shape", "source"):
                row[name] = float(value) if value else ""
        if row["error"] == "":
            del row["error"]
    return kept


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", required=True, help="folder of table and picture")
    parser.add_argument("--bunny", help="its mesh; the map is without it where not given")
    parser.add_argument("--shapes", nargs="+", choices=["sphere", "plate", "bunny"],
                        default=["sphere", "plate", "bunny"] if LONG else ["sphere"])
    parser.add_argument("--anisotropy", type=float, default=0, help="mean cosine of the phase function")
    parser.add_argument("--ior", type=float, default=1.5, help="refractive index inside over outside")
    options = parser.parse_args()
    os.makedirs(options.output, exist_ok=True)
    at = lambda name: os.path.join(options.output, name)
    say = lambda line, end="\n": print(line, end=end, flush=True)
    rows = kept_rows(at("map.csv"), options.shapes)
    try:
        with tempfile.TemporaryDirectory(prefix="sg-map-") as folder:
            for name in options.shapes:
                if name == "bunny" and not options.bunny:
                    continue
                shape = Shape(name, folder, options.bunny, options.anisotropy, options.ior)
                for thickness in THICKNESSES:
                    for albedos in ALBEDOS:
                        rows += shape.compare(thickness, albedos, say)
    except Failed as failure:
        print("FAILED: %s" % failure)
        return 1
    rows.sort(key=lambda row: ["sphere", "plate", "bunny"].index(row["shape"]))
    with open(at("map.csv"), "w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows({key: "%.6g" % value if isinstance(value, float) else value for key, value in row.items()}
                         for row in rows)
    write_summary(rows, at("map.md"))
    draw(rows, at("map.csv"), at("map.png"))
    print(at("map.png"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
