# SPDX-License-Identifier: AGPL-3.0-or-later
"""Samples and meshes at the ends of what they may be, through sg-sample, sg-textons, sg-synthesize and sg-shell: a right
result or one line that says why not. SG_LONG=1: a mesh of a million vertices instead of a hundred thousand."""
import json
import math
import os
import re
import unittest

import numpy

from programs import WorkplaceTest, icosphere, record, run, torus, write_json, write_off

LONG = "SG_LONG" in os.environ
BODY = {"absorption": [0.02, 0.03, 0.04], "scattering": [2, 2.2, 2.4]}
VEIN = {"absorption": [0.4, 0.5, 0.5], "scattering": [1.5, 1.5, 1.5]}


def spots(size=32, **changes):
    return {"type": "spots", "size": [size, size], "voxel": 0.5, "thickness": 3, "count": max(1, size * size // 100), "radius": 2,
            "materials": {"body": BODY, "spot": VEIN}, **changes}


def volume(**changes):
    return {"type": "volume", "file": "values.raw", "raw": {"size": [24, 24, 4]}, "spacing": 0.5,
            "classes": [{"value": 0, "material": BODY}, {"value": 230, "material": VEIN}], **changes}


class SynthesisChain(WorkplaceTest):
    def sample(self, description, *options):
        write_json(self.at("sample.json"), description)
        return run("sample", self.at("sample.json"), "-o", self.at("sample.vdb"), *options)

    def refused(self, done, *parts):
        self.assertEqual(done.returncode, 3, done.stderr)
        self.assertEqual(len(done.stderr.strip().splitlines()), 1, done.stderr)
        for part in parts:
            self.assertIn(part, done.stderr)

    def grow(self, mesh, voxel=0.5, thickness=2, core="bottom-layer"):
        """The stages after sg-sample; results of sg-synthesize and sg-shell."""
        write_off(self.at("mesh.off"), mesh)
        self.ok("distance", self.at("mesh.off"), "-o", self.at("distance.vdb"), "--voxel", voxel, "--inside", thickness + 2 * voxel,
                "--outside", voxel)
        self.ok("textons", self.at("sample.vdb"), "-o", self.at("textons.vdb"), "--textons", 30)
        self.ok("synthesize", self.at("mesh.off"), self.at("textons.vdb"), "-o", self.at("synthesized.ply"))
        self.ok("shell", self.at("synthesized.ply"), self.at("distance.vdb"), self.at("sample.vdb"), "-o", self.at("shell.vdb"),
                "--thickness", thickness, "--core", core)
        results = [record(self.at(name))["results"] for name in ("synthesized.ply", "shell.vdb")]
        # JSON has no number that is none: such would stand as null.
        for name in ("synthesized.ply", "shell.vdb"):
            with open(self.at(name) + ".json") as file:
                self.assertNotRegex(re.sub(r'"options": \{[^}]*\}', "", file.read()), "null|NaN|[Ii]nf")
        self.assertGreater(results[1]["voxels"], 0)
        return results

    def range_of(self, name, grid):
        """Least and greatest value of a grid's green component."""
        described = self.ok("describe", self.at(name), "--json").stdout
        values = json.loads(described)["grids"][grid]["values"]["y"]
        return values["least"], values["greatest"]

    def test_a_constant_sample_makes_a_constant_shell(self):
        self.assertEqual(self.sample({"type": "layers", "size": [16, 16], "voxel": 0.5, "thickness": 2,
                                      "layers": [{"material": BODY, "thickness": 1}]}).returncode, 0)
        for core in ("bottom-layer", "mean-value", "solid"):
            synthesized, shell = self.grow(icosphere(4, 5.0), core=core)
            self.assertEqual(synthesized["window_distance_over_variance"], 0)
            self.assertEqual(shell["coordinates"]["reduced_extinction_rms"], 0)
            least, most = self.range_of("shell.vdb", "extinction")
            self.assertAlmostEqual(least, 2.23, delta=1e-5)
            self.assertAlmostEqual(most, 2.23, delta=1e-5)

    def test_a_single_voxel_is_too_small(self):
        with open(self.at("values.raw"), "wb") as file:
            file.write(bytes([7]))
        self.refused(self.sample(volume(raw={"size": [1, 1, 1]})), "4 at least in x and y")
        self.refused(self.sample(spots(1)), "4")

    def test_two_colours_at_a_contrast_of_a_million(self):
        thin, thick = ({"absorption": a, "scattering": s} for a, s in ((1e-6, 1e-3), (1, 1e3)))
        self.assertEqual(self.sample(spots(materials={"body": thin, "spot": thick}, softness=0)).returncode, 0)
        for core in ("mean-value", "solid"):
            synthesized, _ = self.grow(icosphere(4, 5.0), core=core)
            self.assertLess(synthesized["window_distance_over_variance"], 0.7 * synthesized["window_distance_random"])
            least, most = self.range_of("shell.vdb", "extinction")
            self.assertGreaterEqual(least, 0.99 * (1e-3 + 1e-6))
            self.assertLessEqual(most, 1.01 * 1001)
            self.assertGreater(most / least, 1e5)

    def test_a_sample_larger_than_the_object(self):
        self.assertEqual(self.sample(spots(96, thickness=12)).returncode, 0)
        synthesized, shell = self.grow(icosphere(3, 3.0), thickness=6)
        self.assertLess(synthesized["window_distance_over_variance"], 0.7 * synthesized["window_distance_random"])
        # The shell reaches the middle: the ball's 4/3 π 3³ mm³.
        self.assertAlmostEqual(shell["voxels"] / (36 * math.pi / 0.125), 1, delta=0.1)

    def test_a_sample_that_does_not_tile_is_told_and_grown_all_the_same(self):
        numpy.fromfunction(lambda z, y, x: 10 * x + 0 * y + 0 * z, (4, 24, 24)).astype("u1").tofile(self.at("values.raw"))
        done = self.sample(volume())
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("not tilable in x", done.stderr)
        self.grow(icosphere(4, 5.0))
        self.refused(self.sample(volume(), "--strict"), "not tilable in x", "mirror")
        self.assertEqual(self.sample(volume(mirror=True), "--strict").returncode, 0)
        self.grow(icosphere(4, 5.0))

    def test_values_that_are_no_numbers_are_refused_with_their_place(self):
        values = numpy.random.RandomState(1).uniform(0, 230, (4, 24, 24)).astype("<f4")
        for bad in (numpy.nan, numpy.inf, -numpy.inf):
            values[2, 5, 7] = bad
            values.tofile(self.at("values.raw"))
            self.refused(self.sample(volume(raw={"size": [24, 24, 4], "type": "float"})), "values.raw", "(7, 5, 2)", "not finite")
        self.assertFalse(os.path.exists(self.at("sample.vdb")))

    def test_a_mesh_of_a_hundred_vertices(self):
        voxel = 3.0
        self.assertEqual(self.sample(spots(16, voxel=voxel, thickness=6, radius=6)).returncode, 0)
        mesh = torus(6.5, 3.5, 14, 8)
        self.assertEqual(len(mesh[0]), 112)
        synthesized, _ = self.grow(mesh, voxel=voxel, thickness=4)
        self.assertEqual(synthesized["vertices"], 112)
        # The field turns nowhere on a torus, or as often one way as the other.
        self.assertAlmostEqual(synthesized["singularities_positive"], synthesized["singularities_negative"])

    def test_a_mesh_of_very_many_vertices(self):
        around, across = (1500, 700) if LONG else (470, 215)
        voxel = 0.5
        minor = across * voxel / (2 * math.pi)
        self.assertEqual(self.sample(spots()).returncode, 0)
        synthesized, shell = self.grow(torus(around * voxel / (2 * math.pi), minor, around, across), voxel=voxel)
        self.assertEqual(synthesized["vertices"], around * across)
        self.assertLess(synthesized["window_distance_over_variance"], 0.4 * synthesized["window_distance_random"])
        self.assertLess(shell["leaves"], 0.5 * shell["possible_leaves"])


if __name__ == "__main__":
    unittest.main()
