# SPDX-License-Identifier: AGPL-3.0-or-later
"""sg-reference from outside: shapes that tables know, files, determinism, exit codes, nothing left behind."""
import json
import os
import signal
import subprocess
import time
import unittest

import numpy

import programs
from ply_file import read_ply


class Reference(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.place = programs.workplace()
        cls.addClassCleanup(cls.place.cleanup)
        cls.at = lambda name: os.path.join(cls.place.name, name)

    def run_reference(self, *arguments, **more):
        return programs.run("reference", *arguments, cwd=self.place.name, **more)

    def refused(self, code, *arguments, words=""):
        done = self.run_reference(*arguments)
        self.assertEqual(done.returncode, code, done.stderr)
        self.assertEqual(len(done.stderr.strip().splitlines()), 1, done.stderr)
        self.assertIn(words, done.stderr)
        self.assertEqual([name for name in os.listdir(self.place.name) if "refused" in name], [])

    def near(self, estimate, expected, errors=3):
        self.assertLess(abs(estimate["value"] - expected), errors * estimate["standard_error"], estimate)


class LightTracing(Reference):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        programs.write_off(cls.at("ball.off"), programs.icosphere(3, 10.0))
        programs.write_json(cls.at("scene.json"), programs.scene(lights=[
            {"type": "directional", "direction": [0, 0, -1], "irradiance": [1, 1, 1]},
            {"type": "area", "position": [0, 30, 0], "direction": [0, -1, 0], "up": [0, 0, 1], "width": 10, "height": 20,
             "radiance": [1, 2, 3]},
            {"type": "point", "position": [30, 0, 0], "intensity": 100},
            {"type": "environment", "zenith": 0.1, "horizon": 0.1, "ground": 0.1}]))

    def trace(self, output, *options, scene="scene.json", surface="ball.off", shell=()):
        return self.run_reference(scene, surface, *shell, "-o", output + ".ply", *options)

    def bytes_of(self, name):
        with open(type(self).at(name), "rb") as file:
            return file.read()

    def test_balances_energy_and_renders(self):
        done = self.trace("good", "--paths", "2e4")
        self.assertEqual(done.returncode, 0, done.stderr)
        record = programs.record(type(self).at("good.ply"))
        energy = record["results"]["energy"]
        for c in range(3):
            self.assertLess(energy["relative_defect"][c], 1e-9)
            self.assertAlmostEqual(energy["incoming"][c], energy["entering"][c] + energy["mirrored"][c],
                                   delta=1e-9 * energy["incoming"][c])
            self.assertEqual(energy["lost"][c], 0)
        vertices = read_ply(type(self).at("good.ply"))[0]
        # Half of the lights' light comes from above; every vertex has some, and its error.
        self.assertGreater(vertices["exitance_g"].min(), 0)
        self.assertGreater(vertices["exitance_error_g"].min(), 0)
        self.assertLess((vertices["exitance_error_g"] / vertices["exitance_g"]).max(), 1.5)
        done = programs.run("render", "scene.json", "good.ply", "-o", "good.exr", cwd=self.place.name)
        self.assertEqual(done.returncode, 0, done.stderr)

    def test_same_bytes_at_one_and_two_threads_and_after_a_break(self):
        for name, options in (("one", ["--threads", 1]), ("two", ["--threads", 2])):
            self.assertEqual(self.trace(name, "--paths", "5000", *options).returncode, 0)
        for paths in ("1234", "5000"):
            done = self.trace("parts", "--paths", paths, "--state", "parts.state")
            self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(self.bytes_of("one.ply"), self.bytes_of("two.ply"))
        self.assertEqual(self.bytes_of("one.ply"), self.bytes_of("parts.ply"))
        self.assertEqual(programs.record(type(self).at("parts.ply"))["results"]["paths_of_earlier_runs"], 1234)

    def test_an_interrupt_leaves_a_result_to_go_on_from(self):
        for number in (signal.SIGINT, signal.SIGTERM):
            name = "cut-%d" % number
            run = subprocess.Popen([os.path.join(programs.BIN, "sg-reference"), "scene.json", "ball.off", "-o", name + ".ply",
                                    "--paths", "1e12", "--state", name + ".state"], cwd=self.place.name,
                                   stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
            time.sleep(2 * programs.SLOWNESS)
            run.send_signal(number)
            _, errors = run.communicate(timeout=60 * programs.SLOWNESS)
            self.assertEqual(run.returncode, 0, errors)
            self.assertIn("interrupted", errors)
            results = programs.record(type(self).at(name + ".ply"))["results"]
            self.assertEqual(results["ended_by"], "interrupted")
            paths = results["paths"]
            self.assertGreater(paths, 0)
            self.assertEqual(self.trace("whole", "--paths", paths).returncode, 0)
            self.assertEqual(self.bytes_of("whole.ply"), self.bytes_of(name + ".ply"))
        self.assertEqual([name for name in os.listdir(self.place.name) if ".partial" in name], [])

    def test_channels_apart_keep_a_white_objects_light_to_themselves(self):
        programs.write_json(type(self).at("white.json"), programs.scene(
            material={"core": {"absorption": 0, "scattering": [1, 2, 5]}}))
        for name, options in (("together", []), ("apart", ["--channels-apart"])):
            done = self.trace(name, "--paths", "2000", "--state", "white.state" if name == "together" else "apart.state", *options,
                              scene="white.json")
            self.assertEqual(done.returncode, 0, done.stderr)
            energy = programs.record(type(self).at(name + ".ply"))["results"]["energy"]
            off = max(abs(energy["leaving"][c] / energy["entering"][c] - 1) for c in range(3))
            (self.assertLess if options else self.assertGreater)(off, 1e-9)
        self.refused(3, "white.json", "ball.off", "-o", "refused.ply", "--state", "white.state", "--channels-apart",
                     words="other inputs or options")

    def test_stops_at_a_target_error(self):
        done = self.trace("target", "--target-error", "0.2")
        self.assertEqual(done.returncode, 0, done.stderr)
        results = programs.record(type(self).at("target.ply"))["results"]
        self.assertLess(results["relative_standard_error"], 0.2)
        self.assertGreater(results["relative_standard_error"], 0.15)
        self.assertEqual(done.stderr, "")
        early = self.trace("early", "--target-error", "1e-3", "--paths", "2000")
        self.assertEqual(early.returncode, 0, early.stderr)
        self.assertIn("--paths ended the run before --target-error 0.001 was met: the relative standard error is 0.", early.stderr)

    def test_a_target_error_without_light_ends(self):
        programs.write_json(type(self).at("away.json"), programs.scene(lights=[
            {"type": "area", "position": [0, 30, 0], "direction": [0, 1, 0], "width": 1, "height": 1, "radiance": 1}]))
        done = self.trace("away", "--target-error", "0.1", scene="away.json")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("no light has come back", done.stderr)

    def test_a_scene_without_light_is_black(self):
        for lights in (None, [], [{"type": "point", "position": [30, 0, 0], "intensity": 0}], [{"type": "environment"}]):
            programs.write_json(type(self).at("dark.json"), programs.scene(lights=lights))
            for output, options in (("dark.ply", ["--target-error", "0.1"]), ("dark.exr", [])):
                done = self.run_reference("dark.json", "ball.off", "-o", output, *options)
                self.assertEqual(done.returncode, 0, done.stderr)
                self.assertEqual(done.stderr.count("\n"), 1, done.stderr)
                self.assertIn("no light shines", done.stderr)
            self.assertEqual(read_ply(type(self).at("dark.ply"))[0]["exitance_g"].max(), 0)

    def test_matter_that_does_not_scatter(self):
        programs.write_json(type(self).at("ink.json"), programs.scene(
            object={"mesh": "ball.off", "ior": 1}, material={"core": {"absorption": [0.1, 0, 1], "scattering": 0}}))
        done = self.trace("ink", "--paths", "2e4", "--channels-apart", scene="ink.json")
        self.assertEqual(done.returncode, 0, done.stderr)
        energy = programs.record(type(self).at("ink.ply"))["results"]["energy"]
        for c, depth in enumerate((2, 0, 20)):  # the mean of exp(-2 σ √(R² − b²)) over a ball's disc
            passed = 2 * (1 - (1 + depth) * numpy.exp(-depth)) / depth ** 2 if depth else 1
            self.assertAlmostEqual(energy["leaving"][c] / energy["entering"][c], passed, delta=0.01)

    def test_an_error_that_nobody_knows_is_not_zero(self):
        black = programs.scene(material={"core": {"absorption": 1e4, "scattering": 0}})
        programs.write_json(type(self).at("black.json"), black)
        for name, options in (("single", ["--paths", "1"]), ("swallowed", ["--paths", "5e3"])):
            done = self.trace(name, *options, scene="black.json" if name == "swallowed" else "scene.json")
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertIn("± unknown", done.stdout)
            self.assertIsNone(programs.record(type(self).at(name + ".ply"))["results"]["relative_standard_error"])
        self.refused(2, "scene.json", "ball.off", "-o", "refused.ply", "--paths", "0.5", words="at least one path")

    def test_fewer_paths_than_the_state_holds_are_told(self):
        self.assertEqual(self.trace("many", "--paths", "600", "--state", "many.state").stderr, "")
        self.assertEqual(self.trace("many", "--paths", "600", "--state", "many.state").stderr, "")
        done = self.trace("many", "--paths", "400", "--state", "many.state")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("holds 600 paths already", done.stderr)

    def test_outputs_that_cannot_be_written_show_before_the_work(self):
        os.makedirs(type(self).at("folder.png"), exist_ok=True)
        for output, state in (("/proc/refused.ply", None), ("nowhere/refused.ply", None), ("refused.ply", "/proc/refused.state"),
                              ("refused.ply", "folder.png"), ("folder.exr", None)):
            started = time.monotonic()
            self.refused(3, "scene.json", "ball.off", "-o", output, "--paths", "1e12",
                         *(["--state", state] if state else []), words="cannot be written")
            self.assertLess(time.monotonic() - started, 20 * programs.SLOWNESS)

    def test_options_without_a_meaning_are_refused(self):
        for options in (["--thickness", "1"], ["--radius", "1"], ["--absorption", "1"], ["--bins", "9"], ["--source", "centre"],
                        ["--ior", "1.2"]):
            self.refused(2, "scene.json", "ball.off", "-o", "refused.ply", *options, words="only --tally takes it")
        self.refused(2, "scene.json", "ball.off", "-o", "refused.exr", "--no-interreflection", words="--no-interreflection")

    def test_bad_states_are_refused(self):
        for name in ("refused.ply", "refused.ply.json", "scene.json"):
            self.refused(2, "scene.json", "ball.off", "-o", "refused.ply", "--paths", "10", "--state", name, words=name)
        self.assertEqual(self.trace("kept", "--paths", "100", "--state", "kept.state").returncode, 0)
        state = self.bytes_of("kept.state")
        self.refused(3, "scene.json", "ball.off", "-o", "refused.ply", "--state", "kept.state", "--seed", "3",
                     words="other inputs or options")
        self.refused(3, "scene.json", "ball.off", "-o", "refused.ply", "--state", "nowhere/kept.state", words="nowhere")
        for name, content in (("short", state[:200]), ("flipped", state[:300] + bytes([state[300] ^ 1]) + state[301:]),
                              ("empty", b""), ("text", b"nothing of the kind")):
            with open(type(self).at(name + ".state"), "wb") as file:
                file.write(content)
            self.refused(3, "scene.json", "ball.off", "-o", "refused.ply", "--state", name + ".state",
                         words=name + ".state")

    def test_bad_input(self):
        def variant(name, **changes):
            programs.write_json(type(self).at(name), programs.scene(**changes))
            return name
        good = ["ball.off", "-o", "refused.ply"]
        self.refused(3, "missing.json", *good, words="missing.json")
        self.refused(3, "scene.json", "scene.json", "-o", "refused.ply", words="scene.json")
        self.refused(3, variant("within.json", lights=[{"type": "point", "position": [1, 0, 0], "intensity": 1}]), *good,
                     words="inside the object")
        self.refused(3, variant("opaque.json", material={"opaque": {}}), *good, words="opaque")
        self.refused(3, variant("flat.json", lights=[
            {"type": "area", "position": [0, 30, 0], "direction": [0, 0, 0], "width": 1, "height": 1, "radiance": 1}]), *good,
            words="zero vector")
        self.refused(3, variant("thin.json", lights=[
            {"type": "area", "position": [0, 30, 0], "direction": [0, 1, 0], "width": 0, "height": 1, "radiance": 1}]), *good,
            words="width")
        self.refused(2, "scene.json", "-o", "refused.ply", words="surface.ply")
        self.refused(2, "-o", "refused.ply", words="scene.json")
        self.refused(2, "scene.json", "ball.off", "-o", "refused.json", words=".ply")
        self.refused(2, "scene.json", "ball.off", "-o", "refused.exr", "--channels-apart", words="--channels-apart")
        self.refused(2, "scene.json", "ball.off", "-o", "refused.json", "--tally", "slab", words="no scene")


class Picture(Reference):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        programs.write_off(cls.at("ball.off"), programs.icosphere(3, 10.0))
        programs.write_json(cls.at("scene.json"), programs.scene(
            material={"core": {"absorption": 0, "scattering": 1}},
            lights=[{"type": "environment", "zenith": 1, "horizon": 1, "ground": 1}]))
        programs.write_json(cls.at("sun.json"), programs.scene())

    def shot(self, output, *options, scene="scene.json"):
        return self.run_reference(scene, "ball.off", "-o", output + ".exr", *options)

    def test_white_object_under_an_even_sky_is_invisible(self):
        done = self.shot("white", "--threads", 2)
        self.assertEqual(done.returncode, 0, done.stderr)
        record = programs.record(type(self).at("white.exr"))
        self.assertEqual(record["results"]["paths"], 48 * 32 * 16)
        self.assertLess(record["results"]["relative_standard_error"], 1e-6)
        self.assertTrue(os.path.exists(type(self).at("white.png")))
        with open(type(self).at("white.exr"), "rb") as file:
            whole = file.read()
        for paths in ("5000", "24576"):
            self.assertEqual(self.shot("parts", "--paths", paths, "--threads", 1, "--state", "parts.state").returncode, 0)
        with open(type(self).at("parts.exr"), "rb") as file:
            self.assertEqual(file.read(), whole)
        described = programs.run("describe", "white.exr", cwd=self.place.name)
        self.assertEqual(described.returncode, 0, described.stderr)
        self.assertIn("error.G", described.stdout)

    def test_bad_input(self):
        self.refused(3, "sun.json", "ball.off", "-o", "refused.exr", words="directional")
        programs.write_json(type(self).at("inside.json"), programs.scene(
            camera={"position": [1, 0, 0]}, lights=[{"type": "environment", "zenith": 1}]))
        self.refused(3, "inside.json", "ball.off", "-o", "refused.exr", words="inside the object")
        programs.write_json(type(self).at("blind.json"), programs.scene(camera=None))
        self.refused(3, "blind.json", "ball.off", "-o", "refused.exr", words="no camera")


class Shell(Reference):
    """A ball with bumps of wax: voxels, free space between, and the core below."""

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        programs.write_off(cls.at("ball.off"), programs.icosphere(3, 6.0))
        wax = {"absorption": [0.01, 0.02, 0.05], "scattering": 1.5, "anisotropy": [0, 0.3, 0.6]}
        programs.write_json(cls.at("bumps.json"), {
            "type": "bumps", "size": [24, 24], "voxel": 0.6, "thickness": 3, "radius": 1.2, "lift": 0.5, "count": 8,
            "materials": {"body": wax, "bump": wax}, "ior": 1.4})
        programs.write_json(cls.at("scene.json"), programs.scene(material={
            "shell": {"sample": "bumps.json", "thickness": 3, "voxel": 0.6}, "core": wax}))
        for arguments in (["prepare", "ball.off", "-o", "surface.ply", "--size", "12", "--spacing", "0.6"],
                          ["distance", "surface.ply", "-o", "distance.vdb", "--voxel", "0.6", "--inside", "4"],
                          ["sample", "bumps.json", "-o", "sample.vdb"], ["textons", "sample.vdb", "-o", "textons.vdb"],
                          ["synthesize", "surface.ply", "textons.vdb", "-o", "synthesized.ply"],
                          ["shell", "synthesized.ply", "distance.vdb", "sample.vdb", "-o", "shell.vdb", "--thickness", "3"]):
            done = programs.run(*arguments, cwd=cls.place.name)
            assert done.returncode == 0, done.stderr

    def test_light_meets_the_bumps_and_the_account_closes(self):
        done = self.run_reference("scene.json", "surface.ply", "shell.vdb", "-o", "reference.ply", "--paths", "4e4")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(done.stderr, "")
        results = programs.record(type(self).at("reference.ply"))["results"]
        self.assertGreater(results["free_space_faces"], 100)
        self.assertGreater(results["leaves"]["voxels"] + results["leaves"]["delta"], 10)
        energy = results["energy"]
        for c in range(3):
            self.assertLess(energy["relative_defect"][c], 1e-9)
            self.assertAlmostEqual(energy["incoming"][c], energy["entering"][c] + energy["mirrored"][c],
                                   delta=1e-4 * energy["incoming"][c])
            self.assertLess(energy["lost"][c], 1e-4 * energy["incoming"][c])
            self.assertGreater(energy["absorbed_shell"][c], 0)
            self.assertGreater(energy["absorbed_core"][c], 0)

    def test_a_shell_of_another_surface(self):
        for size, code in (("12.9", 3), ("12.06", 0)):
            done = programs.run("prepare", "ball.off", "-o", "other.ply", "--size", size, "--spacing", "0.6", cwd=self.place.name)
            self.assertEqual(done.returncode, 0, done.stderr)
            if code:
                self.refused(3, "scene.json", "other.ply", "shell.vdb", "-o", "refused.ply", words="shell.vdb: is not of the surface other.ply")
                continue
            done = self.run_reference("scene.json", "other.ply", "shell.vdb", "-o", "near.ply", "--paths", "100")
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertIn("shell.vdb may be of another surface than other.ply", done.stderr)

    def test_a_damaged_shell(self):
        with open(type(self).at("shell.vdb"), "rb") as file:
            data = file.read()
        with open(type(self).at("short.vdb"), "wb") as file:
            file.write(data[: len(data) // 2])
        self.refused(3, "scene.json", "surface.ply", "short.vdb", "-o", "refused.ply", words="short.vdb")
        self.refused(3, "scene.json", "surface.ply", "sample.vdb", "-o", "refused.ply", words="sample.vdb")
        done = programs.run("shell", "synthesized.ply", "distance.vdb", "sample.vdb", "-o", "continued.vdb", "--thickness", "3",
                            "--core", "interpolated", cwd=self.place.name)
        self.assertEqual(done.returncode, 0, done.stderr)
        done = self.run_reference("scene.json", "surface.ply", "continued.vdb", "-o", "continued.ply", "--paths", "2e3")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("material.core is of other coefficients; the core of continued.vdb counts", done.stderr)
        energy = programs.record(type(self).at("continued.ply"))["results"]["energy"]
        self.assertLess(max(energy["relative_defect"]), 1e-9)
        self.assertGreater(min(energy["absorbed_core"]), 0)


class Tally(Reference):
    def measured(self, *options, output="tally.json"):
        done = self.run_reference("--tally", *options, "-o", output)
        self.assertEqual(done.returncode, 0, done.stderr)
        with open(type(self).at(output)) as file:
            return json.load(file)

    def test_slab(self):
        slab = self.measured("slab", "--thickness", "0.2", "--absorption", "1", "--scattering", "9", "--anisotropy", "0.75",
                             "--ior", "1", "--paths", "2e5")
        self.near(slab["diffuse_reflectance"], 0.09739)
        self.near(slab["transmittance"], 0.66096)
        self.assertEqual(slab["specular_reflectance"]["value"], 0)
        self.assertEqual(slab["paths"], 200000)
        profile = slab["radial_profile"]
        self.assertEqual(len(profile["radius"]), len(profile["reflectance"]) + 1)
        self.assertGreater(profile["reflectance"][0]["value"], profile["reflectance"][9]["value"])
        record = programs.record(type(self).at("tally.json"))
        self.assertEqual(record["results"]["ended_by"], "paths")
        self.assertEqual(record["results"]["paths"], 200000)

    def test_layers_that_only_absorb(self):
        slab = self.measured("slab", "--thickness", "0.5", "--absorption", "2", "--scattering", "0", "--paths", "2e4")
        self.near(slab["transmittance"], 0.367879)
        self.assertEqual(slab["diffuse_reflectance"]["value"], 0)
        # A centre that scatters without loss and a shell of ink about it, which light leaves straight: 1 mm is not enough.
        sphere = self.measured("sphere", "--radius", "1,2", "--absorption", "0,0.5", "--scattering", "3,0", "--paths", "2e4")
        self.assertEqual(sphere["absorbed"][0]["value"], 0)
        self.assertAlmostEqual(sphere["absorbed"][1]["value"] + sphere["transmittance"]["value"], 1, delta=1e-9)
        self.assertLess(sphere["transmittance"]["value"], numpy.exp(-0.5))
        self.assertGreater(sphere["transmittance"]["value"], numpy.exp(-0.5 * 3 ** 0.5))

    def test_half_space(self):
        half_space = self.measured("half-space", "--absorption", "0.1", "--scattering", "0.9", "--paths", "1e5")
        self.near(half_space["diffuse_reflectance"], 0.414947)

    def test_sphere_of_shells(self):
        sphere = self.measured("sphere", "--radius", "6,10", "--absorption", "0.002,0.05", "--scattering", "1.5,0.5",
                               "--source", "centre", "--paths", "2e4")
        self.assertEqual(len(sphere["absorbed"]), 2)
        total = sphere["transmittance"]["value"] + sum(part["value"] for part in sphere["absorbed"])
        self.assertAlmostEqual(total, 1, delta=4 * sphere["transmittance"]["standard_error"])
        self.assertEqual(len(sphere["radial_profile"]["fluence"]), 50)

    def test_same_bytes_at_one_and_two_threads_and_another_seed_differs(self):
        texts = []
        for name, options in (("one", ["--threads", 1]), ("two", ["--threads", 2]), ("seed", ["--seed", 5])):
            self.measured("slab", "--paths", "3e4", *options, output=name + ".json")
            with open(type(self).at(name + ".json")) as file:
                texts.append(file.read())
        self.assertEqual(texts[0], texts[1])
        self.assertNotEqual(texts[0], texts[2])

    def test_few_heavy_paths_for_many_are_told(self):
        # So forward that no scattering forgets its direction: no leaps, and paths of millions of collisions.
        done = self.run_reference("--tally", "slab", "--thickness", "1e6", "--scattering", "1", "--anisotropy", "0.9999",
                                  "--paths", "64", "-o", "heavy.json")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("few heavy ones stand for them", done.stderr)

    def test_what_no_path_found_is_not_known_to_be_nothing(self):
        ink = self.measured("slab", "--thickness", "100", "--absorption", "1", "--scattering", "0.1", "--paths", "1000")
        self.assertEqual(ink["transmittance"]["value"], 0)
        self.assertIsNone(ink["transmittance"]["standard_error"])
        self.assertAlmostEqual(ink["transmittance"]["upper_bound"], 0.00299, delta=1e-5)
        self.assertEqual(ink["specular_reflectance"], {"value": 0, "standard_error": 0})
        single = self.measured("slab", "--paths", "1")
        self.assertIsNone(single["diffuse_reflectance"]["standard_error"])
        white = self.measured("half-space", "--paths", "1e4")
        self.assertEqual(white["diffuse_reflectance"], {"value": 1, "standard_error": 0})
        self.assertEqual(white["transmittance"], {"value": 0, "standard_error": 0})
        self.assertEqual(white["absorbed"], [{"value": 0, "standard_error": 0}])

    def test_stops_at_a_target_error_and_at_a_time(self):
        slab = self.measured("slab", "--target-error", "0.01")
        for name in ("diffuse_reflectance", "transmittance"):
            self.assertLess(slab[name]["standard_error"], 0.01 * slab[name]["value"])
        self.assertEqual(programs.record(type(self).at("tally.json"))["results"]["ended_by"], "target error")
        self.measured("slab", "--time", "0.2")
        self.assertEqual(programs.record(type(self).at("tally.json"))["results"]["ended_by"], "time")

    def test_usage(self):
        for options in (["pyramid"], ["slab", "--thickness", "0"], ["slab", "--absorption", "1,2"], ["sphere"],
                        ["slab", "--source", "centre"], ["sphere", "--radius", "1,2", "--scattering", "1,2,3"],
                        ["slab", "--radius", "2"], ["half-space", "--thickness", "2"], ["sphere", "--radius", "2", "--extent", "1"],
                        ["slab", "--paths", "-1"], ["slab", "--ior", "0.5"], ["slab", "--anisotropy", "1"]):
            self.refused(2, "--tally", *options, "-o", "refused.json")
        self.refused(2, "--tally", "slab", "-o", "refused.ply")
        self.refused(3, "--tally", "sphere", "--radius", "2,1", "-o", "refused.json", words="inside out")


if __name__ == "__main__":
    unittest.main()
