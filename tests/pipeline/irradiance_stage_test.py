# SPDX-License-Identifier: AGPL-3.0-or-later
"""sg-irradiance as a program: its files, its record, what it refuses."""
import os
import unittest

from ply_file import read_ply
from programs import WorkplaceTest, record, run, write_json


class Irradiance(WorkplaceTest):
    def sample(self, name, albedo=0.9):
        scattering = [albedo * 2] * 3
        absorption = [(1 - albedo) * 2] * 3
        write_json(self.at("d.json"), {
            "type": "bumps", "size": [12, 12], "voxel": 0.5, "thickness": 4, "ior": 1.4,
            "materials": {"body": {"absorption": absorption, "scattering": scattering},
                          "bump": {"absorption": absorption, "scattering": scattering}},
            "count": 2, "radius": 1.2, "lift": 0.6})
        done = run("sample", self.at("d.json"), "-o", self.at(name))
        self.assertEqual(done.returncode, 0, done.stderr)
        return self.at(name)

    def test_writes_function_view_and_record_that_balance(self):
        sample = self.sample("sample.vdb")
        out = self.at("stf.vdb")
        done = run("irradiance", sample, "-o", out, "--rings", 2, "--turns", 4, "--paths", 20)
        self.assertEqual(done.returncode, 0, done.stderr)
        results = record(out)["results"]
        self.assertEqual(results["directions"], 8)
        self.assertEqual(len(results["balance"]), 9)
        for balance in results["balance"]:
            self.assertAlmostEqual(sum(balance.values()), 1, delta=0.06)
        self.assertGreater(results["median_error"], 0)
        vertices, _ = read_ply(self.at("stf.view.ply"))
        self.assertTrue({"red", "green", "blue", "quality"} <= set(vertices.dtype.names))
        said = run("describe", out)
        self.assertEqual(said.returncode, 0, said.stderr)
        self.assertIn("shell texture function", said.stdout)
        self.assertIn("multiple_back", said.stdout)

    def test_the_same_bytes_with_one_thread_and_another_seed_others(self):
        sample = self.sample("sample.vdb")
        contents = []
        for arguments in (["--threads", 1], ["--threads", 2], ["--seed", 5]):
            out = self.at("stf%d.vdb" % len(contents))
            done = run("irradiance", sample, "-o", out, "--rings", 1, "--turns", 2, "--paths", 2, *arguments)
            self.assertEqual(done.returncode, 0, done.stderr)
            with open(out, "rb") as file:
                contents.append(file.read())
        self.assertEqual(contents[0], contents[1])
        self.assertNotEqual(contents[0], contents[2])

    def test_refuses_what_is_no_sample(self):
        write_json(self.at("no.json"), {})
        os.rename(self.at("no.json"), self.at("no.vdb"))
        done = run("irradiance", self.at("no.vdb"), "-o", self.at("stf.vdb"))
        self.assertEqual(done.returncode, 3, done.stderr)
        self.assertEqual(len(done.stderr.strip().splitlines()), 1)
        self.assertFalse(os.path.exists(self.at("stf.vdb")))
        done = run("irradiance", self.sample("sample.vdb"), "-o", self.at("stf.vdb"), "--paths", 0)
        self.assertEqual(done.returncode, 2, done.stderr)


if __name__ == "__main__":
    unittest.main()
