# SPDX-License-Identifier: AGPL-3.0-or-later
"""The README says what the programs say of themselves."""
import glob
import json
import os
import subprocess
import sys
import unittest

from programs import BIN, SOURCE, icosphere, run, workplace

PROGRAMS = sorted(os.path.basename(path)[3:] for path in glob.glob(os.path.join(BIN, "sg-*")))


class ReadmeTest(unittest.TestCase):
    def test_its_scene_is_a_scene(self):
        """As printed, for a mesh of one's own in a folder my/ of the repository."""
        with open(os.path.join(SOURCE, "README.md")) as file:
            text = file.read().split("## Your own mesh")[1].split("```json\n")[1].split("```")[0]
        place = workplace()
        self.addCleanup(place.cleanup)
        os.symlink(os.path.join(SOURCE, "assets"), os.path.join(place.name, "assets"))
        os.mkdir(os.path.join(place.name, "my"))
        with open(os.path.join(place.name, "my", "teapot.json"), "w") as file:
            file.write(text)
        with open(os.path.join(place.name, "my", "teapot.obj"), "w") as file:
            vertices, faces = icosphere(1)
            file.writelines("v %g %g %g\n" % vertex for vertex in vertices)
            file.writelines("f %d %d %d\n" % tuple(i + 1 for i in face) for face in faces)
        done = run("plan", "my/teapot.json", "-o", "out/teapot", "--why", cwd=place.name)
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        made = subprocess.run(["make", "-C", "out/teapot", "surface.ply", "sample.vdb", "FLAGS=-q"], cwd=place.name,
                              capture_output=True, text=True, env={**os.environ, "MAKEFLAGS": ""})
        self.assertEqual(made.returncode, 0, made.stdout + made.stderr)

    def test_its_tables_are_the_programs_own_help(self):
        done = subprocess.run([sys.executable, "-B", os.path.join(SOURCE, "pipeline", "readme_tables.py"),
                               os.path.join(SOURCE, "README.md"), "--check"], capture_output=True, text=True,
                              env={**os.environ, "SG_BIN": BIN})
        self.assertEqual(done.returncode, 0, done.stderr)

    def test_every_program_explains_itself(self):
        self.assertGreater(len(PROGRAMS), 5)
        for name in PROGRAMS:
            with self.subTest(name):
                shown = run(name, "--help")
                self.assertEqual((shown.returncode, shown.stderr), (0, ""))
                self.assertIn("Examples:", shown.stdout)
                table = json.loads(run(name, "--help-json").stdout)
                for option in table["options"]:
                    self.assertIn(option["flags"][-1], shown.stdout)
                    self.assertTrue(option["help"], option)
                for example in table["examples"]:
                    self.assertIn("sg-" + name, example["command"])
                version = run(name, "--version").stdout
                self.assertRegex(version, r"^sg-%s \(shellgrid\) \d+\.\d+\.\d+$" % name)

    def test_common_options_are_the_same_everywhere(self):
        common = ["--quiet", "--verbose", "--threads", "--seed", "--progress"]
        first = None
        for name in PROGRAMS:
            options = json.loads(run(name, "--help-json").stdout)["options"]
            mine = [o for o in options if o["flags"][-1] in common]
            self.assertEqual([o["flags"][-1] for o in mine], common, name)
            first = first or mine
            self.assertEqual(mine, first, name)


if __name__ == "__main__":
    unittest.main()
