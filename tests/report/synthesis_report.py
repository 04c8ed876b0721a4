#!/usr/bin/python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Grows samples of every source over several shapes, the default way and the paper's, and shows both beside each other:
pictures, time, memory and figures of quality.

    synthesis_report.py [FOLDER_OR_MESH…] -o OUT [--samples NAME…] [--meshes NAME…] [--size 80] [--voxel 0.5]

A bunny, an armadillo and a spot are looked for among the meshes by name; where there is none a shape made here stands
for it. One of genus 3 is always made here. Executables in SG_BIN, or build/bin. OUT gets report.html, report.md,
report.csv and a sheet of pictures for each sample. What is done is kept in OUT/work and not done again for the same
programs, mesh, sample and options. The exit code is 1 where a stage failed.
"""
import argparse
import csv
import glob
import hashlib
import html
import json
import os
import re
import shutil
import signal
import struct
import subprocess
import sys
import zlib

import numpy

import contact_sheet
import shape_samples
from limited_process import run_limited

BIN = os.environ.get("SG_BIN", "build/bin")
HERE = os.path.dirname(os.path.abspath(__file__))
SOURCES = {"marble": "procedural", "wood": "procedural", "cells": "procedural", "bumps": "procedural, with relief",
           "weave": "procedural, with relief", "grass": "procedural, with relief", "spots": "procedural",
           "layers": "procedural", "strawberry": "scan conversion", "mushrooms": "scan conversion",
           "wax": "measured volume", "terrazzo": "solid from one picture", "sandstone": "solid from two pictures"}
SAMPLES = ["marble", "wood", "cells", "weave", "bumps", "strawberry", "mushrooms", "wax", "terrazzo", "sandstone"]
# The shape's name, names of files that are it, and what is made where there is none.
SHAPES = {"bunny": (["bunny00", "stanford-bunny", "bunny"], shape_samples.pear),
          "armadillo": (["armadillo"], shape_samples.star),
          "spot": (["spot", "spot_triangulated", "cow"], shape_samples.pillow),
          "genus3": ([], shape_samples.three_holes)}
WAYS = ["default", "paper"]
COLUMNS = ["sample", "source", "mesh", "way", "vertices", "E 5", "E 5 random", "E 5 tiling", "E 7", "E 7 random", "E 7 tiling",
           "E wide", "E wide random", "E wide tiling", "wide step", "E at singularities", "E elsewhere", "singularities",
           "texton chi2", "coherence", "patch entropy", "median patch", "texel entropy", "autocorrelation error",
           "textons s", "textons cpu s", "textons MiB", "synthesize s", "synthesize cpu s", "synthesize MiB", "judge s", "shell s",
           "shell MiB", "shell changed", "shell incoherent", "failure"]


def fingerprint(path):
    with open(path, "rb") as file:
        return hashlib.sha256(file.read()).hexdigest()[:16]


class Study:
    def __init__(self, options):
        self.options = options
        self.key = [fingerprint(os.path.join(BIN, "sg-" + name)) for name in
                    ("prepare", "distance", "sample", "textons", "synthesize", "shell")]
        self.key += [fingerprint(os.path.join(HERE, name)) for name in ("synthesis_report.py", "contact_sheet.py")]
        self.key += [options.size, options.voxel]
        self.ways = {way: {"textons": [], "synthesize": [], "shell": []} for way in WAYS}
        self.ways["paper"] = {"textons": self.choice("textons", "textons"), "synthesize": self.choice("synthesize", "textons"),
                              "shell": self.choice("shell", "nearest", "--coordinates")}

    def choice(self, program, wanted, flag="--method"):
        """The option that asks for the paper's way, where the program has it."""
        told = json.loads(run_limited([os.path.join(BIN, "sg-" + program), "--help-json"]).output)
        for option in told["options"]:
            if flag in option["flags"] and wanted in str(option):
                return [flag, wanted]
        return []

    def at(self, *names):
        return os.path.join(self.options.output, "work", *names)

    def run(self, stage, output, *arguments):
        """Runs a stage; its record's results, seconds and cost. Raises RuntimeError where it fails."""
        ended = run_limited([os.path.join(BIN, "sg-" + stage), "-q", *arguments, "-o", output], self.options.seconds,
                            self.options.gibibytes)
        if ended.fate != "ok":
            raise RuntimeError("sg-%s: %s: %s" % (stage, ended.fate, ended.line))
        with open(output + ".json") as file:
            written = json.load(file)
        return {"results": written["results"], "seconds": written["seconds"], "wall": ended.wall, "cpu": ended.processor,
                "peak_mib": ended.peak_mib}

    def kept(self, name, key, make):
        """What `make` finds, from its file where it is still true."""
        path = self.at(name + ".findings.json")
        if os.path.exists(path):
            with open(path) as file:
                found = json.load(file)
            if found["key"] == key:
                return found
        found = make()
        found["key"] = key
        with open(path + ".partial", "w") as file:
            json.dump(found, file, indent=1)
        os.replace(path + ".partial", path)
        return found

    def prepare(self, name, path):
        def make():
            how = [self.at(name + ".ply"), path, "--size", self.options.size, "--spacing", self.options.voxel]
            try:
                surface = self.run("prepare", *how)
            except RuntimeError as error:
                print("%-11s is wrapped anew at 1 %%: %s" % (name, error), flush=True)
                surface = self.run("prepare", *how, "--rewrap", "1%")
            self.run("distance", self.at(name + ".distance.vdb"), self.at(name + ".ply"), "--voxel", self.options.voxel,
                     "--inside", 6, "--outside", 2 * self.options.voxel)
            return {"surface": surface}
        return self.kept(name, [*self.key, fingerprint(path)], make)

    def make_sample(self, name, path):
        def make():
            sample = self.at(name + ".vdb")
            found = {"sample": self.run("sample", sample, path, "--voxel", self.options.voxel)}
            subprocess.run([os.path.join(BIN, "sg-describe"), "-q", sample, "-o", self.at(name + ".png")], check=True)
            for way in WAYS:
                found[way] = self.run("textons", self.at("%s.%s.textons.vdb" % (name, way)), sample, *self.ways[way]["textons"])
            return found
        beside = sorted(file for folder in ("meshes", "views", "volumes")
                        for file in glob.glob(os.path.join(glob.escape(os.path.dirname(path)), folder, "*")))
        return self.kept(name, [*self.key, *map(fingerprint, [path, *beside])], make)

    def grow(self, sample, mesh, prepared, made):
        """Both ways of one sample on one mesh, with a picture each."""
        name = "%s.%s" % (sample, mesh)

        def make():
            found = {}
            for way in WAYS:
                try:
                    synthesized, shell = self.at(name + ".ply"), self.at(name + ".shell.vdb")
                    found[way] = {"synthesize": self.run(
                        "synthesize", synthesized, self.at(mesh + ".ply"), self.at("%s.%s.textons.vdb" % (sample, way)),
                        "--voxel", self.options.voxel, *self.ways[way]["synthesize"])}
                    size = made["sample"]["results"]["size"]
                    thickness = min(4, size[2] * self.options.voxel)
                    found[way]["shell"] = self.run("shell", shell, synthesized, self.at(mesh + ".distance.vdb"),
                                                   self.at(sample + ".vdb"), "--thickness", "%g" % thickness,
                                                   *self.ways[way]["shell"])
                    draw(self.at(name + ".shell.view.ply"), self.at("%s.%s.png" % (name, way)))
                except RuntimeError as error:
                    found[way] = {"failure": str(error)}
            for made_file in glob.glob(glob.escape(self.at(name)) + ".*"):
                if not made_file.endswith((".png", ".findings.json")) and not self.options.keep:
                    os.remove(made_file)
            return found
        return self.kept(name, [prepared["key"], made["key"], self.ways], make)


def read_colours(path):
    """Points, triangles and colours 0 … 1 of a view."""
    with open(path, "rb") as file:
        data = file.read()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    header = data[:end].decode()
    types = {"double": "<f8", "float": "<f4", "uchar": "u1", "int": "<i4"}
    vertices, faces = (int(re.search("element %s (\\d+)" % kind, header).group(1)) for kind in ("vertex", "face"))
    fields = [(words[2], types[words[1]]) for words in map(str.split, header.splitlines())
              if words[0] == "property" and words[1] != "list"]
    table = numpy.frombuffer(data, numpy.dtype(fields), vertices, end)
    triangle = numpy.dtype([("count", "u1"), ("corners", "<i4", 3)])
    corners = numpy.frombuffer(data, triangle, faces, end + table.nbytes)["corners"]
    stack = lambda *names: numpy.stack([table[name] for name in names], axis=1).astype(float)
    return stack("x", "y", "z"), corners, stack("red", "green", "blue") / 255


def draw(view, picture):
    points, triangles, colours = read_colours(view)
    drawn = contact_sheet.draw(contact_sheet.Camera(points), points, triangles, colours[triangles].mean(axis=1))
    contact_sheet.write_png(picture, drawn)


def row_of(sample, mesh, way, made, grown):
    found = grown[way]
    row = {"sample": sample, "source": SOURCES.get(sample, "own"), "mesh": mesh, "way": way, "failure": found.get("failure", "")}
    if row["failure"]:
        return row
    cost = lambda stage, of: {stage + " s": "%.2f" % of["wall"], stage + " cpu s": "%.2f" % of["cpu"],
                              stage + " MiB": "%.0f" % of["peak_mib"]}
    row.update(cost("textons", made[way]))
    row.update(cost("synthesize", found["synthesize"]))
    row.update({key: value for key, value in cost("shell", found["shell"]).items() if key in COLUMNS})
    seconds = found["synthesize"]["seconds"]
    row["judge s"] = "%.2f" % seconds.get("judge", 0)
    results = found["synthesize"]["results"]
    shown = lambda x: "%.4f" % x
    row.update({"vertices": results["vertices"], "E 5": shown(results["window_distance_over_variance"]),
                "E 5 random": shown(results["window_distance_random"]), "E 5 tiling": shown(results["window_distance_tiling"]),
                "E at singularities": shown(results["window_distance_at_singularities"]),
                "E elsewhere": shown(results["window_distance_elsewhere"]),
                "singularities": results["singularities_positive"] + results["singularities_negative"],
                "texton chi2": shown(results["texton_chi_squared"]), "coherence": shown(results["coherence"]),
                "patch entropy": shown(results["patch_entropy"]), "median patch": "%.0f" % results["median_patch_vertices"],
                "texel entropy": shown(results["texel_entropy"]), "autocorrelation error": shown(results["autocorrelation_error"])})
    for name, wider in zip(("E 7", "E wide"), results["wider_windows"]):
        row.update({name: shown(wider["distance_over_variance"]), name + " random": shown(wider["random"]),
                    name + " tiling": shown(wider["tiling"])})
        if name == "E wide":
            row["wide step"] = wider["step"]
    coordinates = found["shell"]["results"].get("coordinates", {})
    row.update({"shell changed": shown(coordinates.get("changed_share", 0)),
                "shell incoherent": shown(coordinates.get("incoherent_share", 0))})
    return row


def mean(rows, column):
    values = [float(row[column]) for row in rows if row.get(column, "") not in ("", None)]
    return sum(values) / len(values) if values else float("nan")


def summary(rows):
    """Means by way: the whole in a few lines."""
    lines = []
    for way in WAYS:
        own = [row for row in rows if row["way"] == way and not row["failure"]]
        if own:
            lines.append([way, len(own), *("%.3f" % mean(own, column) for column in SUMMARY)])
    return lines


SUMMARY = ["E 5", "E 7", "E wide", "texton chi2", "coherence", "patch entropy", "texel entropy", "autocorrelation error",
           "E at singularities", "E elsewhere", "textons cpu s", "synthesize cpu s", "synthesize MiB"]
SHOWN = ["mesh", "way", "vertices", "E 5", "E 7", "E wide", "E at singularities", "E elsewhere", "texton chi2", "coherence",
         "patch entropy", "median patch", "texel entropy", "autocorrelation error", "textons s", "synthesize s",
         "synthesize MiB", "shell changed"]
LEGEND = ("E: mean distance of windows of the surface to the sample's nearest, over the variance of the sample's windows; 5 and 7 "
          "neighbouring texels a side, and 7 over about half the sample; beside it, small, a copy of the sample on that mesh and "
          "texels drawn at random. Texton chi²: 0 alike, 2 disjoint. Coherence: share of neighbours that continue a vertex's patch. "
          "Entropies over their greatest values: of the vertices' patches (0: one patch) and of the texels' use (1: all alike). "
          "Singularities: windows within three texels of where the direction field turns, against all others. Seconds of wall time "
          "on all processors, reading and writing and, with sg-synthesize, judging included; processor seconds are in report.csv. "
          "Shell changed: share of the shell's voxels that interpolated coordinates make another voxel of the sample than "
          "nearest ones.")


def cell(row, column):
    text = str(row.get(column, ""))
    if column in ("E 5", "E 7", "E wide") and text:
        return "%s (%s – %s)" % (text, row.get(column + " tiling", ""), row.get(column + " random", ""))
    return text


def sheet(study, sample, meshes):
    """One picture of a sample: itself, and below the shapes, the default way above the paper's."""
    pictures = []
    for way in WAYS:
        row = [study.at("%s.%s.%s.png" % (sample, mesh, way)) for mesh in meshes]
        pictures.append([path if os.path.exists(path) else None for path in row])
    blank = numpy.full((contact_sheet.HEIGHT, contact_sheet.WIDTH, 3), 0.94)
    drawn = numpy.concatenate([numpy.concatenate([read_png(path) if path else blank for path in row], axis=1)
                               for row in pictures])
    name = "sheet-%s.png" % sample
    contact_sheet.write_png(os.path.join(study.options.output, name), drawn)
    shutil.copy(study.at(sample + ".png"), os.path.join(study.options.output, "sample-%s.png" % sample))
    return name


def read_png(path):
    """A picture that contact_sheet wrote: rows without filters."""
    with open(path, "rb") as file:
        data = file.read()
    at, parts, size = 8, [], None
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at:at + 8])
        body = data[at + 8:at + 8 + length]
        if kind == b"IHDR":
            size = struct.unpack(">II", body[:8])
        elif kind == b"IDAT":
            parts.append(body)
        at += 12 + length
    rows = numpy.frombuffer(zlib.decompress(b"".join(parts)), numpy.uint8).reshape(size[1], 1 + 3 * size[0])
    return rows[:, 1:].reshape(size[1], size[0], 3) / 255.0


def write_report(study, rows, samples, meshes, made):
    output = study.options.output
    with open(os.path.join(output, "report.csv"), "w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, restval="")
        writer.writeheader()
        writer.writerows(rows)
    told = "%d samples on %d shapes, %g mm long, voxels of %g mm." % (len(samples), len(meshes), study.options.size,
                                                                 study.options.voxel)
    asked = "The paper's way: sg-textons %s, sg-synthesize %s, sg-shell %s." % tuple(
        " ".join(study.ways["paper"][stage]) or "as by default" for stage in ("textons", "synthesize", "shell"))
    table = lambda head, body: "| %s |\n|%s\n%s\n" % (" | ".join(head), "---|" * len(head), "".join(
        "| %s |\n" % " | ".join(map(str, line)) for line in body))
    parts = ["# Synthesis report\n\n%s %s\n\n%s\n\n%s" % (told, asked, LEGEND, table(["way", "surfaces", *SUMMARY], summary(rows)))]
    markup = lambda tag, text, attributes="": "<%s%s>%s</%s>" % (tag, attributes, text, tag)
    grid = lambda head, body: markup("table", markup("tr", "".join(markup("th", html.escape(str(x))) for x in head)) + "".join(
        markup("tr", "".join(markup("td", html.escape(str(x))) for x in line)) for line in body))
    page = [markup("h1", "Synthesis report"), markup("p", html.escape(told + " " + asked)), markup("p", html.escape(LEGEND)),
            grid(["way", "surfaces", *SUMMARY], summary(rows))]
    for sample in samples:
        own = [row for row in rows if row["sample"] == sample]
        if not own:
            continue
        size = made[sample]["sample"]["results"]["size"]
        head = "%s: %s, %d×%d×%d voxels" % (sample, SOURCES.get(sample, "own"), *size)
        body = [[cell(row, column) if not row["failure"] else (row.get(column, "") or row["failure"]) for column in SHOWN]
                for row in own]
        captions = ["Shapes: %s; above the default way, below the paper's." % ", ".join(meshes)]
        name = sheet(study, sample, meshes)
        parts.append("## %s\n\n![](sample-%s.png)\n\n![](%s)\n\n%s\n\n%s" % (head, sample, name, captions[0], table(SHOWN, body)))
        page += [markup("h2", html.escape(head)), '<img src="sample-%s.png" class="sample" alt="the sample">' % sample,
                 '<img src="%s" alt="the shapes">' % name, markup("p", html.escape(captions[0])), grid(SHOWN, body)]
    with open(os.path.join(output, "report.md"), "w") as file:
        file.write("\n".join(parts))
    style = ("body{font:14px sans-serif;margin:2em;max-width:1900px}table{border-collapse:collapse;font-size:12px}"
             "td,th{border:1px solid #ccc;padding:2px 6px;text-align:right}img{max-width:100%;display:block;margin:8px 0}"
             ".sample{max-height:260px}")
    with open(os.path.join(output, "report.html"), "w") as file:
        file.write("<!DOCTYPE html><html lang=en><meta charset=utf-8><title>Synthesis report</title><style>%s</style>%s</html>\n" %
                   (style, "\n".join(page)))


def find_shapes(places, wanted, folder):
    """Path of each shape: a mesh of one of its names, or one made here."""
    found = {}
    for place in places:
        inside = sorted(glob.glob(os.path.join(glob.escape(place), "*"))) if os.path.isdir(place) else [place]
        for path in inside:
            stem, extension = os.path.splitext(os.path.basename(path))
            if extension.lower() in (".off", ".ply", ".obj", ".stl"):
                found.setdefault(stem, path)
    shapes = {}
    for name in wanted:
        names, made = SHAPES.get(name, ([name], None))
        path = next((found[known] for known in names if known in found), None)
        if path:
            shapes[name] = path
        elif made is None:
            raise SystemExit("synthesis_report.py: no mesh is named " + name)
        else:
            label = name if not names else made.__name__.replace("_", "-")
            shapes[label] = os.path.join(folder, label + ".off")
            shape_samples.write_off(shapes[label], *made())
    return shapes


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("places", nargs="*", help="folders of meshes, or meshes")
    parser.add_argument("-o", "--output", required=True, help="folder of the report")
    parser.add_argument("--samples", nargs="*", default=SAMPLES, help="names in assets/samples, or descriptions")
    parser.add_argument("--meshes", nargs="*", default=list(SHAPES), help="shapes: %s, or names of meshes" % ", ".join(SHAPES))
    parser.add_argument("--size", type=float, default=80, help="longest edge of each shape's box, mm")
    parser.add_argument("--voxel", type=float, default=0.5, help="edge of a voxel and of the surface's triangles, mm")
    parser.add_argument("--seconds", type=float, default=300, help="wall time that a stage may take")
    parser.add_argument("--gibibytes", type=float, default=6, help="memory that a stage may take")
    parser.add_argument("--keep", action="store_true", help="keep the surfaces and shells")
    options = parser.parse_args()
    contact_sheet.WIDTH, contact_sheet.HEIGHT = 440, 360
    os.makedirs(os.path.join(options.output, "work"), exist_ok=True)
    study = Study(options)
    shapes = find_shapes(options.places, options.meshes, study.at())
    folder = os.path.join(HERE, "..", "..", "assets", "samples")
    descriptions = {os.path.splitext(os.path.basename(name))[0]: name if name.endswith((".json", ".vdb")) else
                    os.path.join(folder, name + ".json") for name in options.samples}
    rows, made, failed = [], {}, False
    prepared = {}
    for mesh, path in shapes.items():
        try:
            prepared[mesh] = study.prepare(mesh, path)
        except RuntimeError as error:
            print("%-11s %s" % (mesh, error), flush=True)
            failed = True
    if not prepared:
        return 1
    for sample, path in descriptions.items():
        try:
            made[sample] = study.make_sample(sample, path)
        except RuntimeError as error:
            rows.append({"sample": sample, "source": SOURCES.get(sample, "own"), "way": "", "failure": str(error)})
            print("%-11s %s" % (sample, error), flush=True)
            failed = True
            write_report(study, rows, list(made), list(prepared), made)
            continue
        for mesh in prepared:
            grown = study.grow(sample, mesh, prepared[mesh], made[sample])
            for way in WAYS:
                rows.append(row_of(sample, mesh, way, made[sample], grown))
                row = rows[-1]
                failed = failed or bool(row["failure"])
                print("%-11s %-10s %-8s %s" % (sample, mesh, way, row["failure"] or "E %s (%s – %s), %s s" % (
                    row["E 5"], row["E 5 tiling"], row["E 5 random"], row["synthesize s"])), flush=True)
        write_report(study, rows, list(made), list(prepared), made)
    for line in summary(rows):
        print("%s, mean of %d: %s" % (line[0], line[1], ", ".join("%s %s" % pair for pair in zip(SUMMARY, line[2:]))))
    for name in ("report.html", "report.md", "report.csv"):
        print(os.path.join(options.output, name))
    return 1 if failed else 0


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    sys.exit(main())
