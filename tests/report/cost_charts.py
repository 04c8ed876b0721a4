#!/usr/bin/python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Time and memory of the geometry stages against nodes and against voxels, with the slopes of both in logarithms over the
three greatest counts.

    cost_charts.py MESH -o OUT      writes OUT/geometry.csv and OUT/geometry.png; executables in SG_BIN, or build/bin

The short form takes up to 1e5 nodes and 128 voxels along the object, SG_LONG=1 3e6 and 512. A stage that ends badly is
named, and the exit code is 1.
"""
import argparse
import csv
import math
import os
import signal
import subprocess
import sys
import tempfile

from limited_process import run_limited

HERE = os.path.dirname(os.path.abspath(__file__))
BIN = os.environ.get("SG_BIN", "build/bin")
LONG = "SG_LONG" in os.environ
NODES = [1e4, 3e4, 1e5, 3e5, 1e6, 3e6] if LONG else [1e4, 3e4, 1e5]
VOXELS = [64, 128, 256, 512] if LONG else [64, 128]
SIZE = 80.0  # mm
COLUMNS = ["against", "stage", "count", "wall_s", "processor_s", "peak_mib"]


def slope(rows, column):
    """Of the logarithm of a column over that of the count, by least squares."""
    x = [math.log(row["count"]) for row in rows]
    y = [math.log(max(row[column], 1e-3)) for row in rows]
    mean_x, mean_y = sum(x) / len(x), sum(y) / len(y)
    return sum((a - mean_x) * (b - mean_y) for a, b in zip(x, y)) / sum((a - mean_x) ** 2 for a in x)


def measure(mesh, folder, say):
    """Rows of the table, and what went wrong."""
    at = lambda name: os.path.join(folder, name)
    rows, faults = [], []

    def stage(name, against, asked, *arguments):
        ended = run_limited([os.path.join(BIN, "sg-" + name), "-q", *arguments], 900, 12)
        if ended.fate != "ok":
            faults.append("sg-%s at %g %s: %s %s" % (name, asked, against, ended.fate, ended.line))
            return False
        rows.append({"against": against, "stage": name, "count": asked, "wall_s": round(ended.wall, 3),
                     "processor_s": round(ended.processor, 3), "peak_mib": round(ended.peak_mib, 1)})
        say("%-8s %8g  sg-%-15s %8.2f s  %8.2f s of processor  %6.0f MiB" % (against, asked, name, ended.wall,
                                                                           ended.processor, ended.peak_mib))
        return True

    for voxels in VOXELS:
        spacing = "%.6g" % (SIZE / voxels)
        if not stage("prepare", "voxels", voxels, mesh, "-o", at("voxels.ply"), "--size", SIZE, "--spacing", spacing):
            break
        stage("distance", "voxels", voxels, at("voxels.ply"), "-o", at("distance.vdb"), "--voxel", spacing, "--inside",
              10 * float(spacing), "--outside", 3 * float(spacing))
    for nodes in NODES:
        # A surface half as coarse as the grid, as for a homogeneous object.
        spacing = "%.6g" % (0.55 * (1e5 / nodes) ** (1 / 3))
        done = (stage("prepare", "nodes", nodes, mesh, "-o", at("surface.ply"), "--size", SIZE, "--spacing", spacing) and
                stage("tetrahedralize", "nodes", nodes, at("surface.ply"), "-o", at("tets.hdf")) and
                stage("polycube", "nodes", nodes, at("tets.hdf"), "-o", at("polycube.hdf"), "--nodes", "%g" % nodes) and
                stage("polygrid", "nodes", nodes, at("polycube.hdf"), at("surface.ply"), "-o", at("polygrid.hdf")))
        if not done:
            break
    return rows, faults


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mesh")
    parser.add_argument("-o", "--output", required=True, help="folder of table and chart")
    options = parser.parse_args()
    os.makedirs(options.output, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="sg-cost-", dir=options.output) as folder:
        rows, faults = measure(options.mesh, folder, lambda line: print(line, flush=True))
    # A curve's rows one after another, as gnuplot joins them.
    rows.sort(key=lambda row: (row["against"], row["stage"], row["count"]))
    table = os.path.join(options.output, "geometry.csv")
    with open(table, "w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)
    # Each curve's name with its slopes, for the chart.
    names = {}
    for against in ["nodes", "voxels"]:
        for stage in dict.fromkeys(row["stage"] for row in rows if row["against"] == against):
            curve = [row for row in rows if (row["against"], row["stage"]) == (against, stage)]
            if len(curve) > 1:
                # Of the three greatest counts: small ones mostly pay for starting.
                slopes = [slope(curve[-3:], "processor_s"), slope(curve[-3:], "peak_mib")]
                names[against, stage] = slopes
                print("against %-7s sg-%-15s time grows as count^%.2f, memory as count^%.2f" % (against, stage, *slopes))
    for fault in faults:
        print("FAILED: " + fault)
    commands = ["csv = '%s'" % table, "set terminal pngcairo size 1200,900", "set output '%s'" %
                os.path.join(options.output, "geometry.png")]
    for against in ["nodes", "voxels"]:
        for k, what in enumerate(["time", "memory"]):
            curves = ["'%s %s %.2f'" % (stage, what, slopes[k]) for (of, stage), slopes in names.items() if of == against]
            commands.append("%s_%s = \"%s\"" % (against, what, " ".join(curves)))
    with open(os.path.join(HERE, "cost_charts.gnuplot")) as file:
        commands.append(file.read())
    subprocess.run(["gnuplot"], input="\n".join(commands), text=True, check=True)
    print(os.path.join(options.output, "geometry.png"))
    return 1 if faults else 0


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    sys.exit(main())
