# SPDX-License-Identifier: AGPL-3.0-or-later
"""The real stages on the real bunny, coarsely: which run again after which change, and what a killed stage leaves."""
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import tarfile
import time
import unittest

from programs import BIN, SOURCE, run, workplace

MESHES = "/usr/share/doc/libcgal-dev/data.tar.gz"
STAGES = ["prepare", "distance", "sample", "textons", "synthesize", "shell", "tetrahedralize", "polycube", "polygrid",
          "diffuse", "render"]
GEOMETRY = {"prepare", "distance", "tetrahedralize", "polycube", "polygrid"}
SCENE = {
    "object": {"mesh": "bunny.off", "size": 40, "ior": 1.5},
    "material": {"shell": {"sample": "marble.json", "thickness": 4, "voxel": 1}, "core": "bottom-layer"},
    "lights": [{"type": "directional", "direction": [0, -1, -1], "irradiance": [3, 3, 3]}],
    "camera": {"position": [0, 10, 110], "look_at": [0, 0, 0], "up": [0, 1, 0], "fov": 26, "resolution": [48, 32]},
    "method": {"type": "polygrid-diffusion", "nodes": 4000, "tolerance": 0.01, "samples_per_pixel": 4},
}


class SkipTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        place = workplace()
        cls.addClassCleanup(place.cleanup)
        cls.root, cls.out = place.name, os.path.join(place.name, "out")
        with tarfile.open(MESHES) as archive, open(os.path.join(cls.root, "bunny.off"), "wb") as file:
            file.write(archive.extractfile("data/meshes/bunny00.off").read())
        shutil.copy(os.path.join(SOURCE, "assets", "samples", "marble.json"), cls.root)
        cls.scene = json.loads(json.dumps(SCENE))
        cls.first = cls.remake()

    @classmethod
    def make(cls, *targets):
        done = subprocess.run(["make", "-C", cls.out, *targets], capture_output=True, text=True,
                              env={**os.environ, "MAKEFLAGS": ""})
        assert done.returncode == 0, done.stdout + done.stderr
        ran = re.findall(r"^\S*/sg-(\w+) (?!--stamp)", done.stdout, re.MULTILINE)
        return sorted((stage for stage in ran if stage in STAGES), key=STAGES.index)

    @classmethod
    def remake(cls):
        path = os.path.join(cls.root, "scene.json")
        with open(path, "w") as file:
            json.dump(cls.scene, file)
        planned = run("plan", path, "-o", cls.out)
        assert planned.returncode == 0, planned.stderr
        return cls.make()

    def digests(self):
        found = {}
        for name in sorted(os.listdir(self.out)):
            # A killed process may leave its hidden partial file; nothing reads those.
            if name.endswith((".ply", ".vdb", ".hdf", ".exr", ".png")) and ".partial-" not in name:
                with open(os.path.join(self.out, name), "rb") as file:
                    found[name] = hashlib.sha256(file.read()).hexdigest()
        return found

    def test_each_change_runs_what_depends_on_it(self):
        self.assertEqual(self.first, STAGES)
        self.assertEqual(self.remake(), [])
        self.scene["camera"]["position"] = [20, 10, 105]
        self.assertEqual(self.remake(), ["render"])
        self.scene["lights"][0]["irradiance"] = [1, 2, 3]
        self.assertEqual(self.remake(), ["diffuse", "render"])
        path = os.path.join(self.root, "marble.json")
        with open(path) as file:
            text = file.read()
        with open(path, "w") as file:
            file.write(text.replace('"seed": 1', '"seed": 2'))
        ran = self.remake()
        self.assertIn("sample", ran)
        self.assertIn("render", ran)
        self.assertEqual(GEOMETRY & set(ran), set())
        self.assertEqual(self.remake(), [])

    def test_new_times_on_old_bytes_run_nothing(self):
        for folder in (self.root, self.out):
            for name in os.listdir(folder):
                os.utime(os.path.join(folder, name))
        self.assertEqual(self.remake(), [])

    def test_a_deleted_artefact_comes_back_with_the_same_bytes_and_runs_nothing_else(self):
        before = self.digests()
        for stage, name in [("prepare", "surface.ply"), ("shell", "shell.vdb"), ("polygrid", "polygrid.view.ply")]:
            os.remove(os.path.join(self.out, name))
            self.assertEqual(self.make("all", "views"), [stage])
        self.assertEqual(self.digests(), before)

    def test_a_stage_killed_in_the_middle_leaves_nothing_that_make_would_trust(self):
        with open(os.path.join(self.out, "plan", "plan.json")) as file:
            stages = [stage for stage in json.load(file)["stages"] if stage["needed"] and not stage["on_demand"]]
        before = self.digests()
        for stage in stages:
            with self.subTest(stage["name"]):
                outputs = stage["outputs"] + stage["views"]
                with open(os.path.join(self.out, outputs[0] + ".json")) as file:
                    seconds = json.load(file)["seconds"]["total"]
                for name in outputs:
                    os.remove(os.path.join(self.out, name))
                make = subprocess.Popen(["make", "-C", self.out, outputs[0]], stdout=subprocess.DEVNULL,
                                        stderr=subprocess.DEVNULL, start_new_session=True,
                                        env={**os.environ, "MAKEFLAGS": ""})
                time.sleep(0.1 + 0.5 * seconds)
                os.killpg(make.pid, signal.SIGKILL)
                make.wait()
                for name, digest in self.digests().items():
                    if not name.startswith("."):
                        self.assertEqual(digest, before[name], name)
                self.assertIn(self.make(), ([stage["name"]], []))
                self.assertEqual(self.digests(), before)
                left = [name for name in os.listdir(self.out) if name.startswith(".") and "partial" in name]
                self.assertEqual(left, [])

    def test_the_report_shows_every_stage_in_one_file_without_scripts(self):
        page = os.path.join(self.out, "report.html")
        done = run("report", self.out, "-o", page)
        self.assertEqual(done.returncode, 0, done.stderr)
        with open(page) as file:
            html = file.read()
        for stage in STAGES:
            self.assertIn('id="%s"' % stage, html)
        self.assertNotIn("<script", html)
        self.assertNotIn(self.root, html)
        self.assertNotIn("http", html.replace("http://www.w3.org", ""))
        self.assertEqual(re.findall(r'(?:src|href)="(?!data:|#)', html), [])
        self.assertGreaterEqual(html.count("data:image/png;base64,"), 8)


if __name__ == "__main__":
    unittest.main()
