# SPDX-License-Identifier: AGPL-3.0-or-later
"""sg-reference from outside: shapes that tables know, files, determinism, exit codes, nothing left behind."""
import json
import os
import unittest

import programs


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
                        ["slab", "--paths", "-1"], ["slab", "--ior", "0.5"], ["slab", "--anisotropy", "1"]):
            self.refused(2, "--tally", *options, "-o", "refused.json")
        self.refused(2, "--tally", "slab", "-o", "refused.ply")
        self.refused(3, "--tally", "sphere", "--radius", "2,1", "-o", "refused.json", words="inside out")


if __name__ == "__main__":
    unittest.main()
