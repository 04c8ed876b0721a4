# SPDX-License-Identifier: AGPL-3.0-or-later
"""sg-irradiance as a program: its files, its record, what it refuses."""
import os
import signal
import subprocess
import time
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
            self.assertAlmostEqual(sum(balance.values()), 1, delta=0.15)
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

    def test_goes_on_from_its_state_to_the_same_bytes(self):
        sample = self.sample("sample.vdb")
        few = ["--rings", 1, "--turns", 3]
        state = self.at("paths.state")
        contents = []
        for arguments in (["--target-error", 0.3, "--state", state], ["--target-error", 0.1, "--state", state],
                          ["--target-error", 0.1]):
            out = self.at("stf%d.vdb" % len(contents))
            done = run("irradiance", sample, "-o", out, *few, *arguments)
            self.assertEqual(done.returncode, 0, done.stderr)
            with open(out, "rb") as file:
                contents.append(file.read())
        self.assertGreater(record(self.at("stf1.vdb"))["results"]["batches_of_earlier_runs"], 7)
        self.assertNotEqual(contents[0], contents[1])
        self.assertEqual(contents[1], contents[2])
        done = run("irradiance", sample, "-o", self.at("other.vdb"), *few, "--seed", 3, "--state", state)
        self.assertEqual(done.returncode, 3, done.stderr)
        self.assertIn("other inputs or options", done.stderr)

    def test_interrupted_it_writes_what_it_has_and_goes_on(self):
        sample = self.sample("sample.vdb")
        out, state = self.at("stf.vdb"), self.at("paths.state")
        command = [os.path.join(os.environ["SG_BIN"], "sg-irradiance"), sample, "-o", out, "--rings", "1", "--turns", "2", "--target-error", "1e-6",
                   "--state", state]
        running = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        time.sleep(2)
        running.send_signal(signal.SIGINT)
        _, said = running.communicate(timeout=60)
        self.assertEqual(running.returncode, 0, said)
        self.assertIn("interrupted", said)
        first = record(out)["results"]["paths"]
        done = run("irradiance", sample, "-o", out, "--rings", 1, "--turns", 2, "--target-error", 0.5, "--state", state)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertGreaterEqual(record(out)["results"]["paths"], first)

    def test_compresses_as_asked_for(self):
        sample = self.sample("sample.vdb")
        few = ["--rings", 2, "--turns", 4, "--paths", 100]
        for codec, least in (("principal-components", 34), ("vector-quantisation", 25)):
            out = self.at("stf.stf")
            done = run("irradiance", sample, "-o", out, *few, "--codec", codec, "--psnr", 35 if least == 34 else 26)
            self.assertEqual(done.returncode, 0, done.stderr)
            compression = record(out)["results"]["compression"]
            self.assertGreater(compression["psnr"], least)
            self.assertGreater(compression["ratio"], 1)
            said = run("describe", out)
            self.assertEqual(said.returncode, 0, said.stderr)
            self.assertIn("shell texture function, " + codec.replace("-", " "), said.stdout)
        done = run("irradiance", sample, "-o", self.at("stf.vdb"), *few, "--codec", "vector-quantisation")
        self.assertEqual(done.returncode, 2, done.stderr)
        done = run("irradiance", sample, "-o", self.at("stf.vdb"), *few, "--ratio", 48)
        self.assertEqual(done.returncode, 2, done.stderr)

    def test_refuses_what_is_no_sample(self):
        write_json(self.at("no.json"), {})
        os.rename(self.at("no.json"), self.at("no.vdb"))
        done = run("irradiance", self.at("no.vdb"), "-o", self.at("stf.vdb"))
        self.assertEqual(done.returncode, 3, done.stderr)
        self.assertEqual(len(done.stderr.strip().splitlines()), 1)
        self.assertFalse(os.path.exists(self.at("stf.vdb")))
        done = run("irradiance", self.sample("sample.vdb"), "-o", self.at("stf.vdb"), "--paths", 0)
        self.assertEqual(done.returncode, 2, done.stderr)
        done = run("irradiance", self.at("sample.vdb"), "-o", self.at("stf.vdb"), "--paths", 10, "--most-paths", 1)
        self.assertEqual(done.returncode, 2, done.stderr)
        self.assertIn("--most-paths 1 is below --paths 10", done.stderr)


if __name__ == "__main__":
    unittest.main()
