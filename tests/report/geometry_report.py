#!/usr/bin/python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Takes meshes through sg-prepare, sg-distance, sg-tetrahedralize, sg-polycube and sg-polygrid, and shows in one table and
one contact sheet what became of each: accepted or why not, how good its polygrid is, and what each stage cost.

    geometry_report.py FOLDER_OR_MESH… -o OUT [--nodes 1e5] [--least N] [--only NAME…] [--jobs 1]

Executables in SG_BIN, or build/bin. OUT gets report.csv, report.md and contact-*.png. What is done for a mesh is kept in
OUT/meshes/NAME/ and not done again for the same mesh, programs and options. The exit code is 1 where a stage crashed, ran
out of its time or memory, failed, or refused what sg-prepare had accepted as it was, and where a polygrid is not valid.
"""
import argparse
import concurrent.futures
import csv
import glob
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys

from limited_process import run_limited

BIN = os.environ.get("SG_BIN", "build/bin")
STAGES = ["prepare", "distance", "tetrahedralize", "polycube", "polygrid"]
# What sg-prepare is asked for, until it accepts; an option that it does not have is left out.
REPAIRS = ["", "--close-holes", "--rewrap 1%"]
SIZE = 80.0  # mm
HERE = os.path.dirname(os.path.abspath(__file__))
ROWS = 10  # of a contact sheet
MESHES = (".off", ".ply", ".obj", ".stl")
COLUMNS = ["mesh", "faces", "closed", "accepted", "verdict", "genus", "nodes", "coverage p99", "coverage max", "jacobian min",
           "jacobian mean", "link cv", "angle mean", "angle max", "boundary max", "off surface", "inverted",
           *("%s %s" % (stage, what) for stage in STAGES for what in ("s", "cpu s", "MiB")), "message"]


def fingerprint(path):
    with open(path, "rb") as file:
        return hashlib.sha256(file.read()).hexdigest()[:16]


def helper(name, *arguments):
    """Runs one of the scripts beside this one: this process stays small, for the least memory that it can measure of
    another is its own."""
    return subprocess.run([sys.executable, "-B", os.path.join(HERE, name + ".py"), *arguments], check=True,
                          stdout=subprocess.PIPE, text=True).stdout


class Study:
    """One run of the report: its options, and what they do to a mesh."""

    def __init__(self, options):
        self.options = options
        # As fine as the demo's: 0.5 mm of 80 for 1e5 nodes.
        self.spacing = 0.5 * (1e5 / options.nodes) ** (1 / 3)
        programs = [self.program(stage) for stage in STAGES]
        known = run_limited([self.program("prepare"), "--help"], options.seconds, options.gibibytes).output
        self.repairs = [repair for repair in REPAIRS if repair.split(" ")[0] in known]
        self.key = [fingerprint(path) for path in programs + sorted(glob.glob(os.path.join(HERE, "*.py")))]
        self.key += [options.nodes, options.seconds, options.gibibytes]

    @staticmethod
    def program(stage):
        return os.path.join(BIN, "sg-" + stage)

    def run(self, stage, *arguments):
        return run_limited([self.program(stage), "-q", *arguments], self.options.seconds, self.options.gibibytes)

    def study(self, name, path):
        """The findings on a mesh, from its folder where they are still true."""
        folder = os.path.join(self.options.output, "meshes", name)
        found = os.path.join(folder, "findings.json")
        key = [*self.key, fingerprint(path)]
        if os.path.exists(found):
            with open(found) as file:
                findings = json.load(file)
            if findings["key"] == key:
                return findings
        shutil.rmtree(folder, ignore_errors=True)
        os.makedirs(folder)
        findings = self.take_through(name, path, folder)
        findings["key"] = key
        for heavy in glob.glob(os.path.join(folder, "*.hdf")) + glob.glob(os.path.join(folder, "*.vdb")):
            if not self.options.keep:
                os.remove(heavy)
        with open(found + ".partial", "w") as file:
            json.dump(findings, file, indent=1)
        os.replace(found + ".partial", found)
        return findings

    def take_through(self, name, path, folder):
        at = lambda file: os.path.join(folder, file)
        findings = {"name": name, "mesh": {}, "accepted": "no", "stages": {}, "grid": {}, "warnings": [], "message": "",
                    "failures": [], "flaws": []}
        failures, flaws = findings["failures"], findings["flaws"]

        def stage(stage, output, *arguments):
            ended = self.run(stage, *arguments, "-o", at(output))
            findings["stages"][stage] = {"fate": ended.fate, "wall": ended.wall, "cpu": ended.processor,
                                         "peak_mib": ended.peak_mib, "line": ended.line}
            findings["warnings"] += ["sg-%s: %s" % (stage, warning) for warning in ended.warnings]
            if ended.fate != "ok":
                findings["message"] = ended.line.replace(path, os.path.basename(path)).replace(folder + os.sep, "")
                if os.path.exists(at(output)):
                    failures.append("sg-%s left a file behind" % stage)
            if ended.fate in ("ok", "refused"):
                if ended.lines != (ended.fate == "refused"):
                    failures.append("sg-%s: %d lines of error" % (stage, ended.lines))
            else:
                failures.append("sg-%s: %s" % (stage, ended.fate))
            return ended.fate

        described = run_limited([self.program("describe"), path, "--json"], self.options.seconds, self.options.gibibytes)
        if described.fate == "ok":
            findings["mesh"] = json.loads(described.output)
        elif described.fate != "refused":
            failures.append("sg-describe: " + described.fate)

        for repair in self.repairs:
            fate = stage("prepare", "surface.ply", path, "--size", SIZE, "--spacing", "%.4g" % self.spacing,
                         *repair.split())
            if fate != "refused":
                break
        if fate != "ok":
            return findings
        findings["accepted"] = "yes" + repair.replace("--", ", ").replace("-", " ")
        findings["message"] = ""
        voxel = "%.4g" % max(self.spacing, SIZE / 400)
        for made, output, *arguments in [
                ("distance", "distance.vdb", at("surface.ply"), "--voxel", voxel, "--inside", 10 * float(voxel), "--outside",
                 3 * float(voxel)),
                ("tetrahedralize", "tets.hdf", at("surface.ply")),
                ("polycube", "polycube.hdf", at("tets.hdf"), "--nodes", "%g" % self.options.nodes),
                ("polygrid", "polygrid.hdf", at("polycube.hdf"), at("surface.ply"))]:
            fate = stage(made, output, *arguments)
            # A repair may leave what is too thin for any grid: then that is why the mesh is refused.
            if fate == "refused" and not repair:
                failures.append("sg-%s refuses what sg-prepare accepted" % made)
            if fate != "ok" and made != "distance":
                break
        else:
            with open(at("polygrid.hdf.json")) as file:
                findings["grid"] = json.load(file)["results"]
            with open(at("polycube.hdf.json")) as file:
                findings["grid"]["object_genus"] = json.load(file)["results"]["object_genus"]
            self.judge(findings["grid"], at("polygrid.hdf"), failures, flaws)
        helper("contact_sheet", folder, at("row.png"))
        return findings

    @staticmethod
    def judge(grid, path, failures, flaws):
        """What the record says, held against what the file alone shows."""
        seen = json.loads(helper("grid_check", path))
        grid["seen"] = seen
        if grid["inverted_cells"] or seen["inverted_corners"]:
            failures.append("%d inverted cells" % max(grid["inverted_cells"], seen["inverted_corners"]))
        if seen["open_edges"]:
            failures.append("the polygrid's boundary is not closed")
        if seen["genus"] != grid["genus"]:
            failures.append("genus %s in the file, %s in the record" % (seen["genus"], grid["genus"]))
        if abs(seen["scaled_jacobian_mean"] - grid["scaled_jacobian"]["mean"]) > 0.02:
            failures.append("mean scaled Jacobian %.3f in the file" % seen["scaled_jacobian_mean"])
        if grid["genus"] != grid["object_genus"]:
            flaws.append("genus")
        if grid["boundary_distance"]["points_off_surface"]:
            flaws.append("off surface")
        # The grid is sound, but not of the whole object.
        if grid["coverage"]["p99"] > 1:
            flaws.append("uncovered")


def row_of(findings):
    """The row of the table: text for every column."""
    grid, mesh = findings["grid"], findings["mesh"]
    row = {"mesh": findings["name"], "faces": mesh.get("faces", ""), "accepted": findings["accepted"],
           "closed": {True: "yes", False: "no"}.get(mesh.get("closed"), ""), "message": findings["message"]}
    row["verdict"] = verdict(findings)
    if grid:
        row.update({"genus": "%d/%d" % (grid["object_genus"], grid["genus"]), "nodes": grid["nodes"],
                    "coverage p99": "%.2f" % grid["coverage"]["p99"], "coverage max": "%.2f" % grid["coverage"]["max"],
                    "jacobian min": "%.3f" % grid["scaled_jacobian"]["min"],
                    "jacobian mean": "%.3f" % grid["scaled_jacobian"]["mean"], "link cv": "%.3f" % grid["link_length_cv"],
                    "angle mean": "%.1f" % grid["link_angle"]["mean"], "angle max": "%.0f" % grid["link_angle"]["max"],
                    "boundary max": "%.3f" % grid["boundary_distance"]["max"],
                    "off surface": grid["boundary_distance"]["points_off_surface"], "inverted": grid["inverted_cells"]})
    for stage, cost in findings["stages"].items():
        row[stage + " s"] = "%.2f" % cost["wall"]
        row[stage + " cpu s"] = "%.2f" % cost["cpu"]
        row[stage + " MiB"] = "%.0f" % cost["peak_mib"]
    return row


def verdict(findings):
    if findings["failures"]:
        return "FAILED: " + "; ".join(findings["failures"])
    if not findings["grid"]:
        return "refused"
    return "valid" + "".join(", " + flaw for flaw in findings["flaws"])


def write_tables(all_findings, options):
    rows = [row_of(findings) for findings in all_findings]
    with open(os.path.join(options.output, "report.csv"), "w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, restval="")
        writer.writeheader()
        writer.writerows(rows)
    shown = [column for column in COLUMNS if not column.endswith("cpu s") and not column.endswith(" MiB") and
             column not in ("inverted", "nodes")]
    peak = lambda findings: max((cost["peak_mib"] for cost in findings["stages"].values()), default=0)
    with open(os.path.join(options.output, "report.md"), "w") as file:
        file.write("# Geometry report\n\n%s\n\nLengths in cells, angles in degrees off the normal, genus of object/grid, seconds "
                   "of wall time a stage under limits of %g s and %g GiB; processor time and memory of each stage are in "
                   "report.csv.\n\n" % (summary(all_findings, options), options.seconds, options.gibibytes))
        file.write("| %s | MiB |\n|%s\n" % (" | ".join(shown), "---|" * (len(shown) + 1)))
        for row, findings in zip(rows, all_findings):
            cells = [str(row.get(column, "")).replace("|", "\\|") for column in shown]
            file.write("| %s | %.0f |\n" % (" | ".join(cells), peak(findings)))


def summary(all_findings, options):
    count = lambda test: sum(1 for findings in all_findings if test(findings))
    grids = [findings for findings in all_findings if findings["grid"]]
    slowest = max((cost["wall"] for findings in all_findings for cost in findings["stages"].values()), default=0)
    peak = max((cost["peak_mib"] for findings in all_findings for cost in findings["stages"].values()), default=0)
    return ("%d meshes at %g nodes: %d valid polygrids (%d of the wrong genus, %d with points off the surface, %d that leave more "
            "than 1 %% of the surface uncovered), %d refused, %d failed. Longest stage %.1f s, most memory %.0f MiB." %
            (len(all_findings), options.nodes, count(lambda f: f["grid"] and not f["failures"]),
             count(lambda f: "genus" in f["flaws"]), count(lambda f: "off surface" in f["flaws"]),
             count(lambda f: "uncovered" in f["flaws"]), count(lambda f: not f["grid"] and not f["failures"]),
             count(lambda f: f["failures"]), slowest, peak))


def find_meshes(places):
    """Name and path of each mesh; equal names of two folders are told apart by the folder's."""
    paths = []
    for place in places:
        inside = sorted(glob.glob(os.path.join(glob.escape(place), "*"))) if os.path.isdir(place) else [place]
        paths += [path for path in inside if path.lower().endswith(MESHES)]
    meshes, stems = {}, [os.path.splitext(os.path.basename(path))[0] for path in paths]
    for path, stem in zip(paths, stems):
        name = stem if stems.count(stem) == 1 else stem + os.path.splitext(path)[1].replace(".", "-")
        while name in meshes:
            name = os.path.basename(os.path.dirname(os.path.abspath(path))) + "-" + name
        meshes[name] = path
    return meshes


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("places", nargs="+", help="folders of meshes, or meshes")
    parser.add_argument("-o", "--output", required=True, help="folder of the report")
    parser.add_argument("--nodes", type=float, default=1e5, help="of each polygrid")
    parser.add_argument("--seconds", type=float, default=120, help="wall time that a stage may take")
    parser.add_argument("--gibibytes", type=float, default=6, help="memory that a stage may take")
    parser.add_argument("--least", type=int, default=0, help="only so many of the smallest files")
    parser.add_argument("--only", nargs="*", default=[], help="only the meshes of these names")
    parser.add_argument("--jobs", type=int, default=1, help="meshes at a time")
    parser.add_argument("--keep", action="store_true", help="keep the grids and fields of each mesh")
    options = parser.parse_args()
    meshes = find_meshes(options.places)
    if options.only:
        unknown = [name for name in options.only if name not in meshes]
        if unknown:
            parser.error("no mesh is named " + ", ".join(unknown))
        meshes = {name: meshes[name] for name in options.only}
    if options.least:
        smallest = sorted(meshes, key=lambda name: os.path.getsize(meshes[name]))[:options.least]
        meshes = {name: meshes[name] for name in sorted(smallest)}
    if not meshes:
        parser.error("no meshes in " + ", ".join(options.places))
    os.makedirs(options.output, exist_ok=True)

    study = Study(options)
    all_findings = []
    with concurrent.futures.ThreadPoolExecutor(options.jobs) as pool:
        for findings in pool.map(study.study, meshes.keys(), meshes.values()):
            all_findings.append(findings)
            cost = sum(stage["wall"] for stage in findings["stages"].values())
            print("%3d/%d %-28s %6.1f s  %s%s" % (len(all_findings), len(meshes), findings["name"], cost, verdict(findings),
                                                  findings["message"] and "  [%s]" % findings["message"]), flush=True)
            write_tables(all_findings, options)
    rows = [(findings["name"], verdict(findings), os.path.join(options.output, "meshes", findings["name"], "row.png"))
            for findings in all_findings]
    rows = [row for row in rows if os.path.exists(row[2])]
    sheets = []
    for start in range(0, len(rows), ROWS):
        sheets.append("contact-%d.png" % (len(sheets) + 1))
        helper("contact_sheet", os.path.join(options.output, sheets[-1]), *sum(rows[start:start + ROWS], ()))
    print(summary(all_findings, options))
    for made in ["report.md", "report.csv", *sheets]:
        print(os.path.join(options.output, made))
    return 1 if any(findings["failures"] for findings in all_findings) else 0


if __name__ == "__main__":
    # Ended by a signal, it still ends what it started.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    sys.exit(main())
