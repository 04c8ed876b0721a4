# SPDX-License-Identifier: AGPL-3.0-or-later
"""A scene rendered by the shell texture function, by the real stages: white objects disappear in even light, parts of
the light add up, another light or view recomputes no more than it must."""
import json
import os
import re
import shutil
import subprocess
import unittest

from ply_file import read_ply
from programs import WorkplaceTest, icosphere, record, run, scene, write_json, write_off

WHITE = {"absorption": [0, 0.01, 0.2], "scattering": [1.6, 1.6, 1.6]}
EVEN = {"type": "environment", "up": [0, 1, 0], "zenith": [1, 1, 1], "horizon": [1, 1, 1], "ground": [1, 1, 1]}
SUN = {"type": "directional", "direction": [0.3, -0.2, -1], "irradiance": [2, 2, 2]}


class ShellTextureSceneTest(WorkplaceTest):
    def setUp(self):
        super().setUp()
        write_off(self.at("ball.off"), icosphere(4, 10.0))
        write_json(self.at("white.json"), {"type": "layers", "size": [8, 8], "voxel": 0.5, "thickness": 3, "ior": 1.3,
                                           "layers": [{"material": WHITE, "thickness": 3}]})
        self.content = scene(
            object={"mesh": "ball.off", "size": 20, "ior": 1.3},
            material={"shell": {"sample": "white.json", "thickness": 3, "voxel": 0.5}, "core": "bottom-layer"},
            lights=[EVEN], method={"type": "shell-texture-function", "irradiance_error": 0.02, "samples_per_pixel": 4})

    def make(self, target="image.exr"):
        write_json(self.at("scene.json"), self.content)
        done = run("plan", self.at("scene.json"), "-o", self.at("out"))
        self.assertEqual(done.returncode, 0, done.stderr)
        made = subprocess.run(["make", "-C", self.at("out"), target], capture_output=True, text=True,
                              env={**os.environ, "MAKEFLAGS": ""})
        self.assertEqual(made.returncode, 0, made.stdout + made.stderr)
        return re.findall(r"sg-(\w+) (?!--stamp)\S+ .*?-o (\S+)", made.stdout)

    def pixels(self, *arguments):
        """Per channel, the mean over the object of what the picture by more options shows."""
        out = self.at("picture.exr")
        if arguments:
            self.ok("render", self.at("out", "plan", "render.json"), self.at("out", "synthesized.ply"), "-o", out,
                    "--stf", self.at("out", "stf.vdb"), "--shell", self.at("out", "shell.vdb"), *arguments)
        else:
            out = self.at("out", "image.exr")
        channels = {name: values["mean"] for name, values in
                    json.loads(self.ok("describe", "--json", out).stdout)["channels"].items()}
        covered = channels["A"]
        return [(channels[c] - (1 - covered) * self.behind) / covered for c in "RGB"]

    behind = 1  # radiance beside the object

    def test_white_objects_disappear_and_only_what_changed_is_made(self):
        ran = [output for _, output in self.make()]
        self.assertEqual(ran[-1], "image.exr")
        for artefact in ("stf.vdb", "core.ply", "shell.vdb", "synthesized.ply"):
            self.assertIn(artefact, ran)
        red, green, blue = self.pixels()
        self.assertAlmostEqual(red, 1, delta=0.03)
        self.assertTrue(0.3 < blue < green < red)
        results = record(self.at("out", "core.ply"))["results"]
        self.assertGreater(results["bounces"], 1)
        self.assertGreater(results["leaving_power"][0], results["leaving_power"][2])
        vertices, faces = read_ply(self.at("out", "core.ply"))
        self.assertAlmostEqual(max(abs(vertices["x"])), 7, delta=0.1)
        # Another camera: the picture alone. Another light: the core's, too; what is traced for the sample stays.
        self.content["camera"]["position"] = [0, 60, 60]
        self.assertEqual([output for _, output in self.make()], ["image.exr"])
        self.content["lights"] = [SUN]
        self.assertEqual([output for _, output in self.make()], ["core.ply", "image.exr"])
        self.behind = 0
        whole = self.pixels("--core", self.at("out", "core.ply"))
        outside = self.pixels("--core", self.at("out", "core.ply"), "--light", "outside")
        core = self.pixels("--core", self.at("out", "core.ply"), "--light", "core")
        for c in range(3):
            self.assertAlmostEqual((outside[c] + core[c]) / whole[c], 1, delta=0.005)
        self.assertGreater(core[0], 3 * core[2])
        # Without bounces, as the paper has it, less comes back.
        self.content["method"]["core"] = "paper"
        self.make("core.ply")
        self.assertEqual(record(self.at("out", "core.ply"))["results"]["bounces"], 0)
        # One thread or several: the same bytes.
        files = [self.at("out", name) for name in ("synthesized.ply", "shell.vdb", "stf.vdb")]
        pictures = []
        for threads in (1, 3):
            core_path, out = self.at("core%d.ply" % threads), self.at("threads%d.exr" % threads)
            self.ok("core", self.at("out", "plan", "core.json"), *files, "-o", core_path, "--threads", threads)
            self.ok("render", self.at("out", "plan", "render.json"), files[0], "-o", out, "--stf", files[2], "--shell",
                    files[1], "--core", core_path, "--threads", threads)
            with open(core_path, "rb") as a, open(out, "rb") as b:
                pictures.append((a.read(), b.read()))
        self.assertEqual(*pictures)
        told = self.ok("render", self.at("out", "plan", "render.json"), files[0], "-o", self.at("flat.exr"), "--stf",
                       files[2], "--shell", files[1], "--core", core_path, "--flat")
        self.assertIn("was made without --flat", told.stderr)
        self.refuses_files_that_do_not_fit(files, core_path)
        self.refuses_files_of_another_making(files, core_path)

    def test_the_core_may_be_a_polygrid_s_and_uneven_light_is_corrected(self):
        self.content["method"].update(core="polygrid", nodes=2e4)
        ran = [output for _, output in self.make()]
        self.assertLess(ran.index("fluence.hdf"), ran.index("core.ply"))
        results = record(self.at("out", "core.ply"))["results"]
        self.assertEqual(results["model"], "polygrid")
        for scale in results["scale"]:
            self.assertAlmostEqual(scale, 1, delta=0.25)
        red, green, blue = self.pixels()
        self.assertAlmostEqual(red, 1, delta=0.03)
        self.assertTrue(0.3 < blue < green < red)
        # Even light has nothing to correct; a sun's does, where the ball turns away from it.
        self.assertEqual(results["vertices_corrected"], 0)
        shutil.copyfile(self.at("out", "fluence.hdf"), self.at("even.hdf"))
        self.content["lights"] = [SUN]
        self.make()
        self.assertGreater(record(self.at("out", "image.exr"))["results"]["vertices_corrected"], 0)
        self.behind = 0
        core = ["--core", self.at("out", "core.ply")]
        shown = {how: self.pixels(*core, "--correction", how)[1] for how in ("kernels", "one", "none")}
        self.assertAlmostEqual(shown["kernels"], self.pixels(*core)[1], delta=1e-6)
        self.assertNotEqual(shown["kernels"], shown["none"])
        self.assertAlmostEqual(shown["kernels"] / shown["one"], 1, delta=0.01)  # one material: kernels differ by chance
        files = [self.at("out", name) for name in ("synthesized.ply", "shell.vdb", "stf.vdb")]
        for code, complaint, arguments in (
                (3, "fluence", ["--fluence", self.at("out", "polygrid.hdf")]),
                (3, "fluence", ["--fluence", self.at("out", "tets.hdf")]),
                (3, "under other lights", ["--fluence", self.at("even.hdf")]),
                (2, "--fluence", ["--fluence", self.at("out", "fluence.hdf"), "--bounces", 3])):
            done = run("core", self.at("out", "plan", "core.json"), *files, "-o", self.at("refused.ply"), *arguments)
            self.assertEqual(done.returncode, code, (arguments, done.stderr))
            self.assertIn(complaint, done.stderr)
            self.assertFalse(os.path.exists(self.at("refused.ply")))

    def refuses_files_that_do_not_fit(self, files, core):
        synthesized, shell, stf = files
        slice_path = self.at("out", "plan", "render.json")
        surface = self.at("out", "surface.ply")
        for code, complaint, arguments in (
                (2, "--stf", ["render", slice_path, synthesized, "--shell", shell]),
                (2, "--shell", ["render", slice_path, synthesized, "--stf", stf]),
                (2, "--core", ["render", slice_path, synthesized, "--stf", stf, "--shell", shell, "--light", "core"]),
                (3, "texture_u", ["render", slice_path, surface, "--stf", stf, "--shell", shell]),
                (3, "shell texture function", ["render", slice_path, synthesized, "--stf", shell, "--shell", shell]),
                (3, "texture_coordinate", ["render", slice_path, synthesized, "--stf", stf, "--shell", stf]),
                (3, "exitance_r", ["render", slice_path, synthesized, "--stf", stf, "--shell", shell, "--core", surface]),
                (3, "texture_u", ["core", self.at("out", "plan", "core.json"), surface, shell, stf])):
            out = self.at("refused.exr" if arguments[0] == "render" else "refused.ply")
            done = run(*arguments, "-o", out)
            self.assertEqual(done.returncode, code, (arguments, done.stderr))
            self.assertIn(complaint, done.stderr)
            self.assertEqual(len(done.stderr.strip().split("\n")), 1, done.stderr)
            self.assertNotRegex(done.stderr, r"(\S+): \1: ")
            self.assertFalse(os.path.exists(out))

    def refuses_files_of_another_making(self, files, core):
        """A sample of the same voxels, its function, plain and compressed; a core of other lights or another shell."""
        synthesized, shell, stf = files
        scene_path, core_scene = self.at("out", "plan", "render.json"), self.at("out", "plan", "core.json")
        with open(self.at("white.json")) as file:
            other = json.load(file)
        other["layers"][0]["material"]["scattering"] = [1.7, 1.6, 1.6]
        write_json(self.at("other.json"), other)
        self.ok("sample", self.at("other.json"), "-o", self.at("other.vdb"))
        for name in ("other.stf.vdb", "other.stf"):
            self.ok("irradiance", self.at("other.vdb"), "-o", self.at(name), "--paths", 1)
        self.ok("shell", synthesized, self.at("out", "distance.vdb"), self.at("out", "sample.vdb"), "-o",
                self.at("thin.vdb"), "--thickness", 2.5)
        with open(scene_path) as file:
            lit = json.load(file)
        lit["lights"] = [dict(SUN, irradiance=[2, 2, 2.5])]
        write_json(self.at("lit.json"), lit)
        render = ["render", scene_path, synthesized]
        for complaint, arguments in (
                ("another sample", ["core", core_scene, synthesized, shell, self.at("other.stf")]),
                ("another sample", [*render, "--stf", self.at("other.stf.vdb"), "--shell", shell]),
                ("another sample", [*render, "--stf", self.at("other.stf"), "--shell", shell]),
                ("another shell", [*render, "--stf", stf, "--shell", self.at("thin.vdb"), "--core", core]),
                ("other lights", ["render", self.at("lit.json"), *render[2:], "--stf", stf, "--shell", shell, "--core",
                                  core])):
            out = self.at("refused.exr" if arguments[0] == "render" else "refused.ply")
            done = run(*arguments, "-o", out)
            self.assertEqual(done.returncode, 3, (arguments, done.stderr))
            self.assertIn(complaint, done.stderr)
            self.assertEqual(len(done.stderr.strip().split("\n")), 1, done.stderr)
            self.assertFalse(os.path.exists(out))
        self.ok("render", self.at("lit.json"), *render[2:], "-o", self.at("lit.exr"), "--stf", stf, "--shell", shell)
        # Taken: the sample under another name, compressed; a shell and a core that other programs saved.
        shutil.copy(self.at("out", "sample.vdb"), self.at("elsewhere.vdb"))
        self.ok("irradiance", self.at("elsewhere.vdb"), "-o", self.at("same.stf"), "--paths", 1)
        with open(shell, "rb") as file:
            whole = file.read()
        with open(self.at("resaved.vdb"), "wb") as file:
            file.write(whole[:21] + b"01234567-89ab-4cde-8f01-23456789abcd" + whole[57:])
        with open(core, "rb") as file:
            whole = file.read()
        with open(self.at("silent.ply"), "wb") as file:
            file.write(re.sub(b"comment shellgrid [^\n]*\n", b"", whole))
        self.assertEqual(len(re.findall(b"comment shellgrid \\w+ [^\n]*\n", whole)), 5)
        taken = ["--stf", self.at("same.stf"), "-o", self.at("taken.exr")]
        self.ok(*render, *taken, "--shell", shell, "--core", core)
        self.ok(*render, *taken, "--shell", self.at("resaved.vdb"), "--core", core)
        self.ok("render", self.at("lit.json"), *render[2:], *taken, "--shell", shell, "--core", self.at("silent.ply"))

    def test_scenes_that_the_method_cannot_do_are_refused_and_doubtful_ones_told(self):
        def planned(**changes):
            write_json(self.at("scene.json"), dict(self.content, **changes))
            return run("plan", self.at("scene.json"), "-o", self.at("out"))

        shell = self.content["material"]["shell"]
        for complaint, material in (("needs a material.shell", {"core": dict(WHITE, anisotropy=0)}),
                                    ("opaque", {"opaque": {"reflectance": 0.5}}),
                                    ("own scale", {"shell": dict(shell, scale=2)}),
                                    ("homogeneous core", {"shell": shell, "core": "solid"})):
            done = planned(material=material)
            self.assertEqual(done.returncode, 3, complaint)
            self.assertIn(complaint, done.stderr)
        self.assertNotIn("warning", planned().stderr)
        self.assertIn("little core is left", planned(material={"shell": dict(shell, thickness=6)}).stderr)
        write_json(self.at("white.json"), {"type": "layers", "size": [8, 8], "voxel": 0.5, "thickness": 3, "ior": 1.3,
                                           "layers": [{"material": {"absorption": 0, "scattering": 0.2}, "thickness": 3}]})
        self.assertIn("mean free paths", planned().stderr)


if __name__ == "__main__":
    unittest.main()
