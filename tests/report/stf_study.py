# SPDX-License-Identifier: AGPL-3.0-or-later
"""Scenes of the report on shell texture functions, made by the stages, and their pictures held against light paths."""
import hashlib
import json
import math
import os
import shutil
import subprocess
import sys

import numpy

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path.append(os.path.join(HERE, "..", "support"))
import contact_sheet
from exr_file import read_exr
from limited_process import run_limited

BIN = os.path.abspath(os.environ.get("SG_BIN", "build/bin"))


class Failed(Exception):
    pass


def fingerprint(path):
    with open(path, "rb") as file:
        return hashlib.sha256(file.read()).hexdigest()[:16]


def colours(picture, layer=""):
    """Radiance, or another layer of a picture's channels."""
    return numpy.stack([picture[layer + c] for c in "RGB"], axis=2).astype(float)


def encode(linear, exposure):
    """sRGB of radiances, exposure 1 being white."""
    shown = numpy.clip(linear / exposure, 0, 1)
    return numpy.where(shown <= 0.0031308, 12.92 * shown, 1.055 * shown ** (1 / 2.4) - 0.055)


def difference(one, other, white):
    """Red where brighter, blue where darker than the other; at `white` all of it."""
    off = numpy.clip((one - other).mean(axis=2, keepdims=True) / white, -1, 1)
    return numpy.where(off > 0, 1 - off * numpy.array([0, 1, 1]), 1 + off * numpy.array([1, 1, 0]))


class Truth:
    """Two independent pictures by light paths: what is common to both has no noise."""

    def __init__(self, first, second, results, layer=""):
        self.layer = layer
        self.halves = [colours(first, layer), colours(second, layer)]
        self.inside = (first["A"] >= 1) & (second["A"] >= 1)
        self.mean = (self.halves[0] + self.halves[1]) / 2
        self.processor = sum(r["processor"] for r in results)
        self.paths = sum(r["paths"] for r in results)

    def scale(self, where=None):
        """Mean square of the true picture over the object's pixels."""
        where = self.inside if where is None else where
        return max((self.halves[0] * self.halves[1])[where].mean(), 1e-300)

    def noise(self, where=None):
        """Relative root mean square error of the mean of both pictures."""
        where = self.inside if where is None else where
        return math.sqrt((((self.halves[0] - self.halves[1])[where] / 2) ** 2).mean() / self.scale(where))

    def judge(self, picture, where=None):
        """Relative root mean square error of a picture over the object's pixels, less the truth's noise; its standard
        error; and the relative error of all light."""
        where = (self.inside if where is None else where) & (picture["A"] >= 1)
        seen = colours(picture, self.layer)
        square = ((seen - self.halves[0]) * (seen - self.halves[1]))[where].mean(axis=1)
        scale = self.scale(where)
        mean, deviation = square.mean() / scale, square.std() / math.sqrt(len(square)) / scale
        error = math.sqrt(max(mean, 0))
        return {"error": error, "uncertainty": deviation / (2 * error) if mean > deviation else math.sqrt(deviation),
                "bias": seen[where].mean() / self.mean[where].mean() - 1, "noise": self.noise(where),
                "pixels": int(where.sum())}


class Study:
    def __init__(self, output, threads=0, say=print):
        self.output, self.threads, self.say = os.path.abspath(output), threads, say
        os.makedirs(self.at(), exist_ok=True)

    def at(self, *names):
        return os.path.join(self.output, "work", *names)

    def stage(self, name, output, *arguments, beside=()):
        """Runs a stage unless its output is of the same program, arguments and inputs, those too that its inputs name
        (`beside`). What its record says, and the seconds of all processors together."""
        program = os.path.join(BIN, "sg-" + name)
        arguments = [str(word) for word in arguments]
        key = [fingerprint(program), *(fingerprint(word) if os.path.isfile(word) else word for word in [*arguments, *beside])]
        kept = output + ".key"
        done = json.load(open(kept)) if os.path.exists(output) and os.path.exists(kept) else {}
        if done.get("of") != key:
            threads = ["--threads", str(self.threads)] if self.threads else []
            ended = run_limited([program, "-q", *arguments, "-o", output, *threads], 3600, 8)
            if ended.fate != "ok":
                raise Failed("sg-%s: %s: %s" % (name, ended.fate, ended.line))
            done = {"of": key, "processor": ended.processor}
            with open(kept, "w") as file:
                json.dump(done, file)
        return {**self.record(output), "processor": done["processor"]}

    @staticmethod
    def record(output):
        """The results that a stage wrote beside its output, with the seconds of wall time that it took."""
        with open(output + ".json") as file:
            written = json.load(file)
        return {**written["results"], "seconds": written["seconds"]["total"], "warnings": written["warnings"]}

    def write(self, folder, name, content):
        os.makedirs(self.at(folder), exist_ok=True)
        path = self.at(folder, name)
        text = json.dumps(content, indent=1)
        if not os.path.exists(path) or open(path).read() != text:
            with open(path, "w") as file:
                file.write(text)
        return path

    def make(self, folder, scene, *targets):
        """A scene's artefacts by its own Makefile; the folder is made anew where a program has changed."""
        programs = [fingerprint(os.path.join(BIN, name)) for name in sorted(os.listdir(BIN)) if name in PROGRAMS]
        out = self.at(folder, "out")
        kept = self.at(folder, "programs.key")
        if os.path.isdir(out) and not (os.path.exists(kept) and json.load(open(kept)) == programs):
            shutil.rmtree(out)
        path = self.write(folder, "scene.json", scene)
        with open(kept, "w") as file:
            json.dump(programs, file)
        for command in ([os.path.join(BIN, "sg-plan"), "-q", path, "-o", out],
                        ["make", "-s", "-C", out, *targets, "FLAGS=-q" + (" --threads %d" % self.threads if self.threads else "")]):
            ended = run_limited(command, 3600, 8)
            if ended.fate != "ok":
                raise Failed("%s: %s: %s" % (folder, ended.fate, ended.line))
        return Scene(self, folder)


PROGRAMS = ["sg-" + name for name in ("plan", "prepare", "distance", "sample", "textons", "synthesize", "shell", "irradiance",
                                      "core", "render")]


class Scene:
    """A scene whose shell, shell texture function and core are made."""

    def __init__(self, study, folder):
        self.study, self.folder = study, folder
        with open(study.at(folder, "scene.json")) as file:
            self.content = json.load(file)
        self.surface = self.made("synthesized.ply")

    def at(self, *names):
        return self.study.at(self.folder, *names)

    def made(self, name):
        return self.at("out", name)

    def core(self, name, *flags, shell=None, texture=None):
        """Another core's light: what sg-core says of it."""
        path = self.at(name + ".core.ply")
        return path, self.study.stage("core", path, self.made("plan/core.json"), self.surface,
                                      shell or self.made("shell.vdb"), texture or self.made("stf.vdb"), *flags)

    def picture(self, name, *flags, core=None, shell=None, texture=None):
        """Another picture: its channels, and what sg-render says of it."""
        path = self.at(name + ".exr")
        cores = ["--core", core or self.made("core.ply")]
        told = self.study.stage("render", path, self.made("plan/render.json"), self.surface, "--stf",
                                texture or self.made("stf.vdb"), "--shell", shell or self.made("shell.vdb"), *cores, *flags)
        return read_exr(path), told

    def truth(self, paths, name="truth", shell=None):
        """The picture by light paths, `paths` a pixel in all."""
        width, height = self.content["camera"]["resolution"]
        halves, told = [], []
        scene = self.study.write(self.folder, "truth.json", {key: self.content[key] for key in ("object", "lights", "camera")})
        for seed in (1, 2):
            path = self.at("%s-%d.exr" % (name, seed))
            told.append(self.study.stage("reference", path, scene, self.surface, shell or self.made("shell.vdb"),
                                         "--paths", "%d" % (paths * width * height / 2), "--seed", seed))
            halves.append(read_exr(path))
        return Truth(*halves, told)

    def true_exitance(self, paths):
        """The same from the lights on, `paths` in all: exitance as the picture shows it, of lights that no path meets."""
        halves, told = [], []
        for seed in (1, 2):
            exitance, picture = self.at("exitance-%d.ply" % seed), self.at("exitance-%d.exr" % seed)
            told.append(self.study.stage("reference", exitance, self.made("plan/render.json"), self.surface,
                                         self.made("shell.vdb"), "--paths", "%d" % (paths / 2), "--seed", seed, "--no-interreflection"))
            self.study.stage("render", picture, self.made("plan/render.json"), exitance)
            halves.append(read_exr(picture))
        return Truth(*halves, told, "exitance.")


def save(path, *pictures, gap=4):
    """Pictures side by side."""
    between = numpy.ones((pictures[0].shape[0], gap, 3))
    row = [part for picture in pictures for part in (between, picture)][1:]
    contact_sheet.write_png(path, numpy.concatenate(row, axis=1))
