# SPDX-License-Identifier: AGPL-3.0-or-later
"""sg-sample, sg-textons, sg-synthesize and sg-shell as programs: good runs, bad inputs, same bytes."""
import math
import os
import re
import shutil
import unittest

import numpy

from ply_file import read_ply
from programs import SOURCE, icosphere, record, run, torus, workplace, write_json, write_off

BODY = {"absorption": [0.02, 0.03, 0.04], "scattering": [2, 2.2, 2.4]}
VEIN = {"absorption": [0.4, 0.5, 0.5], "scattering": [1.5, 1.5, 1.5], "anisotropy": 0.1}


def description(**changes):
    content = {"type": "marble", "size": [32, 32], "voxel": 0.5, "thickness": 3, "ior": 1.4,
               "materials": {"body": BODY, "vein": VEIN}, "warp": 3,
               "veins": [{"cells": 2, "width": 1.2, "waves_x": 1, "waves_y": 1}]}
    content.update(changes)
    return {key: value for key, value in content.items() if value is not None}


def read_bytes(path):
    with open(path, "rb") as file:
        return file.read()


def ply_properties(path):
    header = read_bytes(path).split(b"end_header")[0].decode()
    return [line.split()[2] for line in header.splitlines() if line.startswith("property") and "list" not in line]


class Chain(unittest.TestCase):
    """One small chain, from a ball and a description to a shell; every test works on copies of its files."""

    @classmethod
    def setUpClass(cls):
        cls.keep = workplace()
        cls.folder = cls.keep.name
        at = cls.at
        write_json(at("sample.json"), description())
        write_off(at("ball.off"), icosphere(3, 6.0))
        for arguments in (("prepare", at("ball.off"), "-o", at("surface.ply"), "--size", 0, "--spacing", 0.5),
                          ("distance", at("surface.ply"), "-o", at("distance.vdb"), "--voxel", 0.5, "--inside", 3.5,
                           "--outside", 1),
                          ("sample", at("sample.json"), "-o", at("sample.vdb")),
                          ("textons", at("sample.vdb"), "-o", at("textons.vdb"), "--textons", 30),
                          ("synthesize", at("surface.ply"), at("textons.vdb"), "-o", at("synthesized.ply")),
                          ("shell", at("synthesized.ply"), at("distance.vdb"), at("sample.vdb"), "-o", at("shell.vdb"),
                           "--thickness", 2)):
            done = run(*arguments)
            assert done.returncode == 0, done.stderr

    @classmethod
    def tearDownClass(cls):
        cls.keep.cleanup()

    @classmethod
    def at(cls, name):
        return os.path.join(cls.folder, name)

    def without_notes(self, path):
        """synthesized.ply as it would be from elsewhere."""
        whole = read_bytes(self.at("synthesized.ply"))
        with open(path, "wb") as file:
            file.write(re.sub(b"comment shellgrid sample[^\n]*\n", b"", whole))
        self.assertLess(os.path.getsize(path), len(whole))
        return path

    def refused(self, done, code, *parts):
        self.assertEqual(done.returncode, code, done.stderr)
        lines = done.stderr.strip().splitlines()
        self.assertEqual(len(lines), 1, done.stderr)
        for part in parts:
            self.assertIn(part, lines[0])

    def test_every_stage_writes_its_output_record_and_view(self):
        for name in ("sample.vdb", "textons.vdb", "synthesized.ply", "shell.vdb"):
            self.assertGreater(os.path.getsize(self.at(name)), 1000)
            self.assertEqual(record(self.at(name))["warnings"], [])
        for view in ("sample.view.ply", "textons.view.ply", "shell.view.ply"):
            self.assertTrue({"red", "green", "blue", "quality"} <= set(ply_properties(self.at(view))))
        self.assertTrue({"texture_u", "texture_v", "direction_x", "direction_y", "direction_z", "quality", "red", "green",
                         "blue", "s", "t"} <= set(ply_properties(self.at("synthesized.ply"))))

    def test_figures_in_the_records(self):
        synthesized = record(self.at("synthesized.ply"))["results"]
        self.assertEqual(synthesized["singularities_positive"] - synthesized["singularities_negative"], 2)
        self.assertEqual(sum(s["index"] for s in synthesized["singularities"]), 2)
        for singularity in synthesized["singularities"]:
            self.assertAlmostEqual(sum(x * x for x in singularity["point"]) ** 0.5, 6, delta=0.2)
        self.assertLess(synthesized["window_distance_over_variance"], synthesized["window_distance_random"] / 2)
        shell = record(self.at("shell.vdb"))["results"]
        self.assertLess(shell["leaves"], shell["possible_leaves"])
        # Grid points of a ball between radii 4 and 6 mm, 0.5 mm apart.
        expected = 4 / 3 * 3.14159 * (6 ** 3 - 4 ** 3) / 0.5 ** 3
        self.assertAlmostEqual(shell["voxels"] / expected, 1, delta=0.05)

    def test_the_direction_is_the_users_where_he_wants(self):
        with workplace() as folder:
            out = os.path.join(folder, "synthesized.ply")
            done = run("synthesize", self.at("surface.ply"), self.at("textons.vdb"), "-o", out, "--orient",
                       "0,0,6,1,1,0,0,0,-6,1,0,0", "--passes", 0, "--final-passes", 0)
            self.assertEqual(done.returncode, 0, done.stderr)
            vertices, _ = read_ply(out)
            for point, wanted in ((numpy.array([0, 0, 6.0]), numpy.array([1, 1, 0]) / 2 ** 0.5),
                                  (numpy.array([0, 0, -6.0]), numpy.array([1.0, 0, 0]))):
                places = numpy.stack([vertices[k] for k in "xyz"], axis=1)
                nearest = numpy.argmin(((places - point) ** 2).sum(axis=1))
                own = numpy.array([vertices["direction_" + k][nearest] for k in "xyz"])
                # Up to the turns after which this sample, a marble with one vein, looks alike.
                turn = 2 * math.pi / record(out)["results"]["symmetry"]
                angle = math.acos(max(-1, min(1, float(own @ wanted))))
                self.assertLess(abs(angle - turn * round(angle / turn)), 0.14)
            self.refused(run("synthesize", self.at("surface.ply"), self.at("textons.vdb"), "-o", out, "--orient",
                             "0,0,6,1,1"), 2, "six numbers")
            self.refused(run("synthesize", self.at("surface.ply"), self.at("textons.vdb"), "-o", out, "--orient",
                             "0,0,6,0,0,1"), 3, "across the surface")

    def test_an_object_thinner_than_the_relief_is_told(self):
        with workplace() as folder:
            def out(name):
                return os.path.join(folder, name)
            write_json(out("bumps.json"), {"type": "bumps", "size": [32, 32], "voxel": 0.5, "thickness": 4, "radius": 1.2,
                                           "lift": 0.5, "count": 8, "materials": {"body": BODY, "bump": VEIN}})
            write_off(out("ball.off"), icosphere(3, 1.0))
            self.assertEqual(run("sample", out("bumps.json"), "-o", out("bumps.vdb")).returncode, 0)
            self.assertEqual(run("textons", out("bumps.vdb"), "-o", out("t.vdb")).returncode, 0)
            for radius, told in ((1.8, True), (6, False)):
                for arguments in (("prepare", out("ball.off"), "-o", out("s.ply"), "--size", 2 * radius, "--spacing", 0.5),
                                  ("distance", out("s.ply"), "-o", out("d.vdb"), "--voxel", 0.5, "--inside", 5),
                                  ("synthesize", out("s.ply"), out("t.vdb"), "-o", out("y.ply"))):
                    self.assertEqual(run(*arguments).returncode, 0)
                done = run("shell", out("y.ply"), out("d.vdb"), out("bumps.vdb"), "-o", out("shell.vdb"), "--thickness", 4)
                self.assertEqual(done.returncode, 0, done.stderr)
                (self.assertIn if told else self.assertNotIn)("% of the surface the shell holds no matter", done.stderr)
                self.assertEqual(record(out("shell.vdb"))["results"]["share_without_matter"] > 0.3, told)

    def test_triangles_that_do_not_hang_together_are_told(self):
        with workplace() as folder:
            points, faces = icosphere(3, 3.3)
            write_off(os.path.join(folder, "soup.off"), ([points[i] for f in faces for i in f],
                                                         [(3 * k, 3 * k + 1, 3 * k + 2) for k in range(len(faces))]))
            done = run("synthesize", os.path.join(folder, "soup.off"), self.at("textons.vdb"), "-o",
                       os.path.join(folder, "s.ply"))
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertIn("share hardly any vertices", done.stderr)

    def test_a_distance_field_of_another_mesh_is_refused(self):
        with workplace() as folder:
            mesh, field = os.path.join(folder, "torus.ply"), os.path.join(folder, "torus.vdb")
            write_off(os.path.join(folder, "torus.off"), torus(4.0, 1.5))
            for arguments in (("prepare", os.path.join(folder, "torus.off"), "-o", mesh, "--size", 0, "--spacing", 0.5),
                              ("distance", mesh, "-o", field, "--voxel", 0.5, "--inside", 3.5, "--outside", 1)):
                self.assertEqual(run(*arguments).returncode, 0)
            self.refused(run("shell", self.at("synthesized.ply"), field, self.at("sample.vdb"), "-o",
                             os.path.join(folder, "shell.vdb"), "--thickness", 2), 3, "is of another mesh")

    def test_two_samples_share_a_surface_as_it_is_painted(self):
        with workplace() as folder:
            def out(name):
                return os.path.join(folder, name)
            write_json(out("plain.json"), description(veins=None, warp=0, cloudiness=0.5))
            self.assertEqual(run("sample", out("plain.json"), "-o", out("plain.vdb")).returncode, 0)
            done = run("textons", self.at("sample.vdb"), out("plain.vdb"), "-o", out("two.vdb"), "--textons", 30)
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertEqual(len(record(out("two.vdb"))["results"]["sizes"]), 2)
            self.refused(run("synthesize", self.at("surface.ply"), out("two.vdb"), "-o", out("s.ply")), 3, "2 samples")
            # The mesh as it was before sg-prepare made it twice as large and moved it, painted red above.
            points, faces = icosphere(3, 3.0)
            with open(out("painted.ply"), "w") as file:
                file.write("ply\nformat ascii 1.0\nelement vertex %d\nproperty float x\nproperty float y\n"
                           "property float z\nproperty uchar red\nelement face %d\n"
                           "property list uchar int vertex_indices\nend_header\n" % (len(points), len(faces)))
                for p in points:
                    file.write("%g %g %g %d\n" % (p[0] + 40, p[1], p[2], 255 if p[2] > 0 else 0))
                for f in faces:
                    file.write("3 %d %d %d\n" % tuple(f))
            done = run("synthesize", self.at("surface.ply"), out("two.vdb"), out("painted.ply"), "-o", out("s.ply"))
            self.assertEqual(done.returncode, 0, done.stderr)
            vertices, _ = read_ply(out("s.ply"))
            far = numpy.abs(vertices["z"]) > 4.5
            self.assertTrue(((vertices["sample"] == 1) == (vertices["z"] > 0))[far].all())
            self.assertAlmostEqual(sum(record(out("s.ply"))["results"]["sample_shares"]), 1, delta=1e-6)
            inputs = ["shell", out("s.ply"), self.at("distance.vdb"), self.at("sample.vdb")]
            self.refused(run(*inputs, "-o", out("shell.vdb"), "--thickness", 2), 3, "s.ply: was made from 2 samples; 1 given")
            done = run(*inputs, out("plain.vdb"), "-o", out("shell.vdb"), "--thickness", 2)
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertEqual(record(out("shell.vdb"))["results"]["voxels"], record(self.at("shell.vdb"))["results"]["voxels"])
            self.refused(run(*inputs, out("plain.vdb"), "-o", out("shell.vdb"), "--core", "solid"), 2, "--core-sample")
            # Samples of one size tell themselves apart, also where the files have gone elsewhere since.
            os.rename(out("s.ply"), out("moved.ply"))
            inputs[1] = out("moved.ply")
            shutil.copy(self.at("sample.vdb"), out("copy.vdb"))
            wrong = [*inputs[:3], out("plain.vdb"), out("copy.vdb"), "-o", out("wrong.vdb"), "--thickness", 2]
            self.refused(run(*wrong), 3, "moved.ply: was made from these samples in another order: %s %s" %
                         (out("copy.vdb"), out("plain.vdb")))
            self.refused(run(*wrong[:3], out("plain.vdb"), out("plain.vdb"), *wrong[5:]), 3, "from 2 samples, not these")
            write_json(out("other.json"), description(seed=9))
            self.assertEqual(run("sample", out("other.json"), "-o", out("other.vdb")).returncode, 0)
            self.refused(run(*inputs, out("other.vdb"), "-o", out("wrong.vdb"), "--thickness", 2), 3, "not from", "other.vdb")
            self.assertFalse(os.path.exists(out("wrong.vdb")))
            done = run(*wrong[:3], out("copy.vdb"), out("plain.vdb"), "-o", out("again.vdb"), "--thickness", 2)
            self.assertEqual(done.returncode, 0, done.stderr)
            inputs[1] = self.at("synthesized.ply")
            self.refused(run(*inputs, out("plain.vdb"), "-o", out("shell.vdb"), "--thickness", 2), 3, "another sample")
            # A sample that another program saved anew, with an id of its own, is not taken for another.
            with open(out("copy.vdb"), "rb") as a, open(out("resaved.vdb"), "wb") as b:
                whole = a.read()
                b.write(whole[:21] + b"01234567-89ab-4cde-8f01-23456789abcd" + whole[57:])
            done = run(*wrong[:3], out("resaved.vdb"), out("plain.vdb"), "-o", out("again.vdb"), "--thickness", 2)
            self.assertEqual(done.returncode, 0, done.stderr)
            # As of a file that tells nothing, from elsewhere.
            inputs[1] = self.without_notes(out("silent.ply"))
            self.refused(run(*inputs, out("plain.vdb"), "-o", out("shell.vdb"), "--thickness", 2), 3, "carries one sample")
            done = run(*inputs[:3], out("other.vdb"), "-o", out("silent.vdb"), "--thickness", 2)
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertEqual(run("sample", out("plain.vdb"), "-o", out("dense.vdb"), "--ior", 1.6).returncode, 0)
            self.assertEqual(run("textons", self.at("sample.vdb"), out("dense.vdb"), "-o", out("dense.textons.vdb"),
                                 "--textons", 30).returncode, 0)
            self.assertEqual(run("synthesize", self.at("surface.ply"), out("dense.textons.vdb"), out("painted.ply"), "-o",
                                 out("dense.ply")).returncode, 0)
            inputs[1] = out("dense.ply")
            done = run(*inputs, out("dense.vdb"), "-o", out("shell.vdb"), "--thickness", 2)
            self.assertIn("dense.vdb was made for the refractive index 1.6; that of ", done.stderr)
            # Painted on another shape, or where there is no room.
            def paint(name, mesh, wants):
                points, faces = mesh
                with open(out(name), "w") as file:
                    file.write("ply\nformat ascii 1.0\nelement vertex %d\nproperty float x\nproperty float y\nproperty "
                               "float z\nproperty float sample\nelement face %d\nproperty list uchar int vertex_indices\n"
                               "end_header\n" % (len(points), len(faces)))
                    file.writelines("%g %g %g %d\n" % (*p, wants(p)) for p in points)
                    file.writelines("3 %d %d %d\n" % tuple(f) for f in faces)
            grow = ["synthesize", self.at("surface.ply"), out("two.vdb"), out("wrong.ply"), "-o", out("s2.ply")]
            paint("wrong.ply", torus(4.0, 1.5), lambda p: p[2] > 0)
            self.refused(run(*grow), 3, "wrong.ply: is not painted on this surface", "mm off")
            paint("wrong.ply", icosphere(3, 6.0), lambda p: p[2] > 5.9)
            done = run(*grow)
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertRegex(done.stderr, r"1 painted area is, [\d.]+ mm² in all, narrower than 8 texels \(4 mm\): \d+ % of its")
            paint("wrong.ply", icosphere(3, 6.0), lambda p: 1)
            self.assertIn("sample 0 is painted nowhere", run(*grow).stderr)
            done = run("shell", out("s2.ply"), self.at("distance.vdb"), self.at("sample.vdb"), out("plain.vdb"), "-o",
                       out("shell.vdb"), "--thickness", 2)
            self.assertIn("no vertex carries sample 0, ", done.stderr)
            # A tenth larger and off the middle: laid onto the surface, not taken as it lies.
            paint("wrong.ply", icosphere(3, 6.6, (0.5, 0, 0.5)), lambda p: p[2] > 0.5)
            self.assertEqual(run(*grow).stderr, "")
            laid = record(out("s2.ply"))["results"]["paint"]
            self.assertTrue(laid["moved"])
            self.assertLess(laid["most_distance_mm"], 0.1)
            with open(out("bad.ply"), "w") as file, open(out("painted.ply")) as good:
                file.write(good.read().replace("property uchar red", "property uchar green"))
            self.refused(run("synthesize", self.at("surface.ply"), out("two.vdb"), out("bad.ply"), "-o", out("s.ply")), 3,
                         "'sample'", "2 samples")

    def test_same_bytes_at_any_number_of_threads_and_other_bytes_for_another_seed(self):
        with workplace() as folder:
            def out(name):
                return os.path.join(folder, name)
            for threads in (1, 2):
                run("sample", self.at("sample.json"), "-o", out("sample.vdb"), "--threads", threads)
                run("textons", self.at("sample.vdb"), "-o", out("textons.vdb"), "--textons", 30, "--threads", threads)
                run("synthesize", self.at("surface.ply"), self.at("textons.vdb"), "-o", out("synthesized.ply"), "--threads",
                    threads)
                run("shell", self.at("synthesized.ply"), self.at("distance.vdb"), self.at("sample.vdb"), "-o",
                    out("shell.vdb"), "--thickness", 2, "--threads", threads)
                for name in ("sample.vdb", "textons.vdb", "synthesized.ply", "shell.vdb", "shell.view.ply"):
                    self.assertEqual(read_bytes(self.at(name)), read_bytes(out(name)), name)
            run("synthesize", self.at("surface.ply"), self.at("textons.vdb"), "-o", out("other.ply"), "--seed", 7)
            self.assertNotEqual(read_bytes(self.at("synthesized.ply")), read_bytes(out("other.ply")))

    def test_a_sample_goes_through_its_own_volume_unchanged(self):
        with workplace() as folder:
            again = os.path.join(folder, "again.vdb")
            self.assertEqual(run("sample", self.at("sample.vdb"), "-o", again).returncode, 0)
            self.assertEqual(read_bytes(self.at("sample.vdb")), read_bytes(again))
            thin = run("sample", self.at("sample.vdb"), "-o", again, "--thickness", 1.5)
            self.assertEqual(thin.returncode, 0, thin.stderr)
            self.assertEqual(record(again)["results"]["size"], [32, 32, 3])
            self.refused(run("sample", self.at("sample.vdb"), "-o", again, "--thickness", 9), 3, "9 mm")

    def test_options_override_the_description(self):
        with workplace() as folder:
            out = os.path.join(folder, "sample.vdb")
            run("sample", self.at("sample.json"), "-o", out, "--voxel", 0.25, "--thickness", 2, "--ior", 1.3)
            results = record(out)["results"]
            self.assertEqual(results["size"], [32, 32, 8])
            self.assertEqual((results["voxel_mm"], results["ior"]), (0.25, 1.3))
            tiny = run("sample", self.at("sample.vdb"), "-o", out, "--voxel", 1e-6)
            self.assertEqual(tiny.returncode, 3)
            self.assertIn("a voxel of 1e-06 mm is too small for an OpenVDB file", tiny.stderr)

    def test_checks_warn_and_strict_fails(self):
        with workplace() as folder:
            small, out = os.path.join(folder, "small.json"), os.path.join(folder, "small.vdb")
            write_json(small, description(size=[16, 16]))
            clear = {"absorption": [0.0001, 0.0001, 0.0001], "scattering": [1, 1, 1]}
            write_json(small, description(materials={"body": clear, "vein": clear}, thickness=1))
            self.assertEqual(run("sample", small, "-o", out).returncode, 0)
            warnings = record(out)["warnings"]
            self.assertEqual(len(warnings), 3)
            self.assertIn("n_x = 32 voxels", warnings[0])
            self.assertIn("n_z = 2 voxels", warnings[2])
            os.remove(out)
            self.refused(run("sample", small, "-o", out, "--strict"), 3, "n_x = 32 voxels")
            self.assertFalse(os.path.exists(out))

    def test_what_a_description_leaves_unused_is_told(self):
        with workplace() as folder:
            path, out = os.path.join(folder, "odd.json"), os.path.join(folder, "odd.vdb")
            with open(os.path.join(folder, "long.raw"), "wb") as file:
                file.write(bytes(24 * 24 * 4 + 100))
            write_json(path, {"type": "volume", "file": "long.raw", "raw": {"size": [24, 24, 4]}, "spacing": 1,
                              "classes": [{"value": 0, "material": BODY}]})
            self.assertEqual(run("sample", path, "-o", out).returncode, 0)
            self.assertIn("100 more than", record(out)["warnings"][0])
            write_off(os.path.join(folder, "ball.off"), icosphere(1, 2.0))
            write_json(path, {"type": "meshes", "size": [32, 32], "voxel": 0.5, "thickness": 4, "top": 0, "parts": [
                {"ground": 0, "material": BODY}, {"mesh": "ball.off", "material": VEIN, "position": [8, 8, -100]}]})
            self.assertEqual(run("sample", path, "-o", out).returncode, 0)
            self.assertIn("parts[1] fills no place", record(out)["warnings"][0])

    def test_enlarging_makes_samples_pass(self):
        with workplace() as folder:
            path, out = os.path.join(folder, "small.json"), os.path.join(folder, "small.vdb")
            clear = {"absorption": [0.004, 0.01, 0.02], "scattering": [1, 1, 1]}
            write_json(path, description(materials={"body": clear, "vein": clear}, thickness=1))
            self.refused(run("sample", path, "-o", out, "--strict"), 3, "n_x = 32 voxels")
            done = run("sample", path, "-o", out, "--strict", "--enlarge")
            self.assertEqual(done.returncode, 0, done.stderr)
            results = record(out)["results"]
            # 2 l_d = 2 / sqrt(3 * .004 * 1.004) = 18.2 mm: two periods of 16 mm; 3 / 1.004 mm deep: 6 layers.
            self.assertEqual(results["size"], [64, 64, 6])
            self.assertEqual(len(results["enlarged"]), 2)
            # What is large enough stays as it is, and a volume that does not tile is mirrored.
            self.assertEqual(run("sample", self.at("sample.json"), "-o", out, "--enlarge").returncode, 0)
            self.assertEqual(read_bytes(out), read_bytes(self.at("sample.vdb")))
            with open(os.path.join(folder, "ramp.raw"), "wb") as file:
                file.write(bytes(10 * x for z in range(4) for y in range(24) for x in range(24)))
            write_json(path, {"type": "volume", "file": "ramp.raw", "raw": {"size": [24, 24, 4]}, "spacing": 1,
                              "classes": [{"value": 0, "material": BODY}, {"value": 230, "material": VEIN}]})
            self.refused(run("sample", path, "-o", out, "--strict"), 3, "not tilable in x", "mirror")
            done = run("sample", path, "-o", out, "--strict", "--enlarge")
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertEqual(record(out)["results"]["size"], [48, 48, 4])

    def test_bad_descriptions(self):
        cases = [
            (description(vains=[]), "vains", "veins"),
            (description(type="marbel"), "marbel", "marble"),
            (description(materials={"body": BODY, "vein": dict(VEIN, absorbtion=1)}), "materials.vein.absorbtion",
             "absorption"),
            (description(materials={"body": BODY}), "materials.vein", "missing"),
            (description(materials={"body": {"named": "marbl"}, "vein": VEIN}), "marbl", "marble"),
            (description(materials={"body": {"absorption": -1, "scattering": 1}, "vein": VEIN}), "absorption",
             "out of range"),
            (description(size=[32]), "size", "n_y"),
            (description(size=[2, 2]), "size", "4"),
            (description(size=[2048, 2048], voxel=0.01, thickness=5), "2048 x 2048 x 500", "1e8"),
            (description(voxel="big"), "voxel", "number"),
            (description(voxel=0), "voxel", "out of range"),
            (description(thickness=1e4), "thickness", "voxels"),
            (description(veins=[{"cells": 1.5}]), "veins[0].cells", "whole"),
            (description(seed=-1), "seed", "out of range"),
            ([1, 2], "description", "section"),
            ({"type": "volume", "file": "nowhere.vdb"}, "nowhere.vdb", "No such file"),
            ({"type": "meshes", "parts": [{"mesh": "nowhere.ply", "material": BODY}]}, "nowhere.ply", "No such file"),
            ({"type": "meshes", "parts": [{"mesh": "nowhere.ply"}]}, "parts[0].material", "missing"),
            ({"type": "meshes", "parts": []}, "parts", "at least one"),
            ({"type": "solid", "views": {"z": "nowhere.png"}, "extinction": 2}, "nowhere.png", "No such file"),
            ({"type": "solid", "views": {"z": "nowhere.png"}}, "extinction", "missing"),
            ({"type": "solid", "views": {}, "extinction": 2}, "views", "at least one"),
            ({"type": "solid"}, "views", "smaller"),
            (description(materials={"body": {"reflectance": 0.5}, "vein": VEIN}), "materials.body.extinction", "missing"),
            ({"type": "volume", "file": "ct.raw", "classes": [{"value": 1, "material": BODY}]}, "raw", "is missing"),
            ({"type": "volume", "file": "ct.nrrd"}, "classes", "is missing"),
            ({"type": "volume", "file": "ct.nrrd", "classes": [{"value": 1}]}, "classes[0].material", "missing"),
            ({"type": "volume", "file": "ct.nrrd", "classes": [{"value": 1, "material": BODY}]}, "ct.nrrd", "No such file"),
            ({"type": "volume", "images": [], "classes": [{"value": 1, "material": BODY}]}, "file", "list of images"),
            (description(type="bumps", materials={"body": BODY, "bump": VEIN}, thickness=1, veins=None, warp=None),
             "thickness", "4 mm"),
        ]
        with workplace() as folder:
            bad, out = os.path.join(folder, "bad.json"), os.path.join(folder, "bad.vdb")
            for content, *parts in cases:
                with self.subTest(content):
                    write_json(bad, content)
                    self.refused(run("sample", bad, "-o", out), 3, *parts)
                    self.assertFalse(os.path.exists(out))
            for text in ("", "{", "{\"type\": \"marble\"", "\0\1\2", "nonsense"):
                with open(bad, "w") as file:
                    file.write(text)
                self.refused(run("sample", bad, "-o", out), 3, "bad.json")
            self.refused(run("sample", os.path.join(folder, "none.json"), "-o", out), 3, "none.json")

    def test_volumes_of_the_wrong_kind_are_refused(self):
        with workplace() as folder:
            out = os.path.join(folder, "out")
            self.refused(run("textons", self.at("distance.vdb"), "-o", out + ".vdb"), 3, "distance.vdb", "material sample")
            self.refused(run("synthesize", self.at("surface.ply"), self.at("sample.vdb"), "-o", out + ".ply"), 3, "sample.vdb",
                         "texton set")
            self.refused(run("sample", self.at("distance.vdb"), "-o", out + ".vdb"), 3, "distance.vdb", "density")
            self.refused(run("shell", self.at("surface.ply"), self.at("distance.vdb"), self.at("sample.vdb"), "-o",
                             out + ".vdb"), 3, "surface.ply", "texture_u")
            self.refused(run("shell", self.at("synthesized.ply"), self.at("sample.vdb"), self.at("sample.vdb"), "-o",
                             out + ".vdb"), 3, "sample.vdb")
            self.assertEqual(os.listdir(folder), [])

    def test_truncated_volumes_are_refused(self):
        whole = read_bytes(self.at("textons.vdb"))
        with workplace() as folder:
            cut, out = os.path.join(folder, "cut.vdb"), os.path.join(folder, "out.ply")
            for length in (0, 5, 100, len(whole) // 2, len(whole) - 1):
                with open(cut, "wb") as file:
                    file.write(whole[:length])
                self.refused(run("synthesize", self.at("surface.ply"), cut, "-o", out), 3, "cut.vdb")

    def test_inputs_that_do_not_belong_together_are_refused(self):
        with workplace() as folder:
            out = os.path.join(folder, "out")
            write_off(out + ".off", icosphere(3, 20.0))
            self.refused(run("synthesize", out + ".off", self.at("textons.vdb"), "-o", out + ".ply"), 3, "edge length",
                         "sg-prepare --spacing 0.5")
            self.refused(run("shell", self.at("synthesized.ply"), self.at("distance.vdb"), self.at("sample.vdb"), "-o",
                             out + ".vdb", "--thickness", 5), 3, "sg-distance --inside")
            self.refused(run("shell", self.at("synthesized.ply"), self.at("distance.vdb"), self.at("sample.vdb"), "-o",
                             out + ".vdb", "--thickness", 1e-5), 3, "no grid point")
            write_json(out + ".json", description(size=[32, 40]))
            self.assertEqual(run("sample", out + ".json", "-o", out + ".vdb").returncode, 0)
            silent = self.without_notes(out + ".silent.ply")
            self.refused(run("shell", self.at("synthesized.ply"), self.at("distance.vdb"), out + ".vdb", "-o",
                             out + ".shell.vdb", "--thickness", 2), 3, "was made from another sample, not from " + out + ".vdb")
            self.refused(run("shell", silent, self.at("distance.vdb"), out + ".vdb", "-o",
                             out + ".shell.vdb", "--thickness", 2), 3, "32 x 40", "32 x 32")
            run("sample", self.at("sample.json"), "-o", out + ".vdb", "--voxel", 0.4)
            self.refused(run("shell", silent, self.at("distance.vdb"), out + ".vdb", "-o",
                             out + ".shell.vdb", "--thickness", 2), 3, "sg-distance --voxel 0.4")
            self.refused(run("shell", self.at("synthesized.ply"), self.at("distance.vdb"), self.at("sample.vdb"), "-o",
                             out + ".shell.vdb", "--thickness", 2, "--core-absorption", "0.1,0.1,0.1"), 2,
                         "--core-scattering")

    def test_coordinates_may_be_the_nearest_vertices(self):
        with workplace() as folder:
            out = os.path.join(folder, "shell.vdb")
            done = run("shell", self.at("synthesized.ply"), self.at("distance.vdb"), self.at("sample.vdb"), "-o", out,
                       "--thickness", 2, "--coordinates", "nearest")
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertEqual(record(out)["results"]["coordinates"], {"kind": "nearest"})
            own = record(self.at("shell.vdb"))["results"]
            self.assertEqual(own["voxels"], record(out)["results"]["voxels"])
            figures = own["coordinates"]
            self.assertEqual(figures["kind"], "interpolated")
            # Two of three voxels lie more than half a texel from the nearest vertex in some direction.
            self.assertGreater(figures["changed_share"], 0.3)
            self.assertLess(figures["changed_share"], 0.9)
            self.assertLess(figures["incoherent_share"], 0.5)
            self.assertGreater(figures["reduced_extinction_rms"], 0)
            # The means of coefficients agree.
            compared = run("compare", out, self.at("shell.vdb"))
            self.assertEqual(compared.returncode, 0, compared.stderr)

    def test_indices_of_a_samples_own_reach_the_shell(self):
        with workplace() as folder:
            at = lambda name: os.path.join(folder, name)
            write_off(at("ball.off"), icosphere(2, 2.0))
            write_json(at("sample.json"), {
                "type": "meshes", "size": [32, 32], "voxel": 0.5, "thickness": 4, "ior": 1.3, "parts": [
                    {"ground": 0, "material": BODY},
                    {"mesh": "ball.off", "material": VEIN, "priority": 1, "ior": 1.45, "position": [8, 8, 0]}]})
            self.assertEqual(run("sample", at("sample.json"), "-o", at("sample.vdb")).returncode, 0)
            self.assertEqual(run("textons", at("sample.vdb"), "-o", at("textons.vdb"), "--textons", 30).returncode, 0)
            self.assertEqual(run("synthesize", self.at("surface.ply"), at("textons.vdb"), "-o", at("s.ply")).returncode, 0)
            done = run("shell", at("s.ply"), self.at("distance.vdb"), at("sample.vdb"), "-o", at("shell.vdb"), "--thickness",
                       3)
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertIn("indices of its own", record(at("shell.vdb"))["warnings"][0])
            self.assertIn("surface_ior", run("describe", at("shell.vdb")).stdout)

    def test_a_shell_deeper_than_its_sample_is_told_and_no_sample_itself(self):
        with workplace() as folder:
            out = os.path.join(folder, "shell.vdb")
            done = run("shell", self.at("synthesized.ply"), self.at("distance.vdb"), self.at("sample.vdb"), "-o", out,
                       "--thickness", 3.4)
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertIn("3 mm deep", record(out)["warnings"][0])
            self.refused(run("sample", out, "-o", os.path.join(folder, "sample.vdb")), 3, "shell volume")

    def test_the_core_may_be_given(self):
        with workplace() as folder:
            out = os.path.join(folder, "shell.vdb")
            done = run("shell", self.at("synthesized.ply"), self.at("distance.vdb"), self.at("sample.vdb"), "-o", out,
                       "--thickness", 2, "--core-absorption", "0.1,0.2,0.3", "--core-scattering", "1,1,1")
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertNotEqual(read_bytes(out), read_bytes(self.at("shell.vdb")))

    def test_the_core_may_be_interpolated_but_not_with_coefficients(self):
        with workplace() as folder:
            out = os.path.join(folder, "shell.vdb")
            inputs = ["shell", self.at("synthesized.ply"), self.at("distance.vdb"), self.at("sample.vdb"), "-o", out,
                      "--thickness", 2, "--core", "interpolated"]
            done = run(*inputs)
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertEqual(record(out)["results"]["core"], {"kind": "interpolated"})
            self.assertIn("interpolated", run("describe", out).stdout)
            self.refused(run(*inputs, "--core-absorption", "0.1,0.2,0.3", "--core-scattering", "1,1,1"), 2,
                         "--core interpolated")

    def test_the_core_may_be_voxels_of_the_shells_file(self):
        with workplace() as folder:
            out, cut = os.path.join(folder, "shell.vdb"), os.path.join(folder, "cut.png")
            inputs = ["shell", self.at("synthesized.ply"), self.at("distance.vdb"), self.at("sample.vdb")]
            interior = 4 / 3 * 3.14159 * 4 ** 3 / 0.5 ** 3
            for kind in ("mean-value", "solid"):
                done = run(*inputs, "-o", out, "--thickness", 2, "--core", kind)
                self.assertEqual(done.returncode, 0, done.stderr)
                core = record(out)["results"]["core"]
                self.assertEqual(core["kind"], kind)
                self.assertAlmostEqual(core["voxels"] / interior, 1, delta=0.1)
                first = read_bytes(out)
                run(*inputs, "-o", out, "--thickness", 2, "--core", kind, "--threads", 1)
                self.assertEqual(read_bytes(out), first)
                self.assertEqual(run("describe", out, "-o", cut).returncode, 0)
                self.assertEqual(read_bytes(cut)[:4], b"\x89PNG")
            self.assertLess(core["step_to_shell_over_samples"], 0.7 * core["tilings_step_over_samples"])
            given = ["--core", "solid", "--core-sample", self.at("sample.vdb")]
            self.assertEqual(run(*inputs, "-o", out, "--thickness", 2, *given).returncode, 0)
            self.assertEqual(read_bytes(out), first)
            self.refused(run(*inputs, "-o", out, "--core-sample", self.at("sample.vdb")), 2, "--core solid")
            self.refused(run(*inputs, "-o", out, "--core-reach", 4), 2, "--core-reach")

    def test_the_papers_textons_work_too(self):
        with workplace() as folder:
            textons, out = os.path.join(folder, "textons.vdb"), os.path.join(folder, "synthesized.ply")
            self.assertEqual(run("textons", self.at("sample.vdb"), "-o", textons, "--method", "textons", "--textons",
                                 60).returncode, 0)
            for method in ("coherence", "textons"):
                done = run("synthesize", self.at("surface.ply"), textons, "-o", out, "--method", method)
                self.assertEqual(done.returncode, 0, done.stderr)
                results = record(out)["results"]
                self.assertLess(results["window_distance_over_variance"], 0.7 * results["window_distance_random"], method)
            self.refused(run("synthesize", self.at("surface.ply"), self.at("textons.vdb"), "-o", out, "--method", "textons"),
                         3, "--symmetry 1")
            self.refused(run("synthesize", self.at("surface.ply"), textons, "-o", out, "--method", "textons", "--passes", 3),
                         2, "--passes")

    def test_an_unwritable_output_leaves_nothing(self):
        with workplace() as folder:
            shutil.copy(self.at("sample.json"), folder)
            done = run("sample", os.path.join(folder, "sample.json"), "-o", os.path.join(folder, "none", "sample.vdb"))
            self.refused(done, 3, "none")
            self.assertEqual(os.listdir(folder), ["sample.json"])


if __name__ == "__main__":
    unittest.main()
