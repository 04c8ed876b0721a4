# SPDX-License-Identifier: AGPL-3.0-or-later
"""Which stages run again after which change. Real sg-plan and Make; the stages are stand-ins that note that they ran and
write a digest of all they were given, so that each of these many runs takes a moment. skip_test.py does it for real."""
import json
import os
import shutil
import signal
import subprocess
import time
import unittest

from programs import BIN, SOURCE, icosphere, scene, workplace

STAND_IN = """#!/usr/bin/python3
import hashlib, json, os, sys, time
name = os.path.basename(sys.argv[0])
words, files, outputs, options = sys.argv[1:], [], [], []
while words:
    word = words.pop(0)
    if word in ("-o", "--exitance"):
        outputs.append(words.pop(0))
    elif word == "--core-sample":
        files.append(words.pop(0))
    elif word.startswith("-"):
        options.append(word)
        if word not in ("-q", "--close-holes", "--no-retile"):
            options.append(words.pop(0))
    else:
        files.append(word)
open(os.environ["RAN"], "a").write(name[3:] + "\\n")
if os.environ.get("FAIL") == name:
    sys.exit(4)
digest = hashlib.sha1(repr(options).encode())
for path in files:
    data = open(path, "rb").read()
    digest.update(data.replace(b"same to prepare", b"") if name == "sg-prepare" else data)
if name == "sg-render":
    outputs.append("image.png")
views = [o.replace(".vdb", ".view.ply").replace(".hdf", ".view.ply") for o in outputs
         if o.endswith(".vdb") or o in ("polycube.hdf", "polygrid.hdf")]
if os.environ.get("SLEEP") == name:
    open(outputs[0], "w").write("half")
    open(os.environ["RAN"] + ".asleep", "w").close()
    time.sleep(60)
for output in outputs + views:
    open(output, "w").write(output + digest.hexdigest())
json.dump({"outputs": [{"path": o} for o in outputs + views]}, open(outputs[0] + ".json", "w"))
"""
STAGES = ["prepare", "distance", "sample", "textons", "synthesize", "shell", "tetrahedralize", "polycube", "polygrid",
          "diffuse", "irradiance", "core", "reference", "render"]
MADE = [stage for stage in STAGES if stage not in ("irradiance", "core", "reference")]  # on the way to the picture
SHELL = {"shell": {"sample": "marble.json", "thickness": 2, "voxel": 0.5}, "core": "bottom-layer"}


class PlanTest(unittest.TestCase):
    def setUp(self):
        place = workplace()
        self.addCleanup(place.cleanup)
        self.root = place.name
        self.bin = os.path.join(self.root, "bin")
        os.mkdir(self.bin)
        shutil.copy(os.path.join(BIN, "sg-plan"), self.bin)
        for stage in STAGES:
            self.write_program(stage)
        self.scenes = os.path.join(self.root, "scenes")
        os.mkdir(self.scenes)
        self.out = os.path.join(self.root, "out")
        self.put("ball.off", "a mesh")
        self.put_sample(1)
        self.content = scene("ball.off", material=dict(SHELL))
        self.put_scene()

    def write_program(self, stage, text=STAND_IN):
        path = os.path.join(self.bin, "sg-" + stage)
        with open(path, "w") as file:
            file.write(text)
        os.chmod(path, 0o755)

    def put(self, name, text):
        with open(os.path.join(self.scenes, name), "w") as file:
            file.write(text)

    def put_sample(self, seed):
        jade = {"absorption": 0.01, "scattering": 1}
        self.put("marble.json", json.dumps({"type": "spots", "seed": seed, "materials": {"body": jade, "spot": jade}}))

    def put_scene(self):
        self.put("scene.json", json.dumps(self.content, indent=1))

    def plan(self, *options, name="scene.json"):
        return subprocess.run([os.path.join(self.bin, "sg-plan"), "-o", self.out, *options, "--",
                               os.path.join(self.scenes, name)], capture_output=True, text=True, cwd=self.root)

    def make(self, *targets, expect=0, **env):
        """Runs Make and returns the stages that ran."""
        log = os.path.join(self.root, "ran")
        if os.path.exists(log):
            os.remove(log)
        done = subprocess.run(["make", "-C", self.out, *targets], capture_output=True, text=True,
                              env={**os.environ, "RAN": log, "MAKEFLAGS": "", **env})
        self.assertEqual(done.returncode, expect, done.stdout + done.stderr)
        return sorted(self.ran(), key=STAGES.index)

    def remake(self, *targets):
        planned = self.plan()
        self.assertEqual(planned.returncode, 0, planned.stderr)
        return self.make(*targets)

    def artefact(self, name):
        return os.path.join(self.out, name)

    def text(self, name):
        with open(self.artefact(name)) as file:
            return file.read()

    def test_a_heterogeneous_shell_needs_every_stage(self):
        self.assertEqual(self.remake(), MADE)
        self.assertTrue(os.path.exists(self.artefact("image.png")))

    def test_nothing_changed_runs_nothing(self):
        self.remake()
        self.assertEqual(self.make(), [])
        self.assertEqual(self.remake(), [])
        self.assertEqual(self.remake("all", "views"), [])

    def test_a_homogeneous_object_needs_no_shell(self):
        self.content["material"] = {"core": {"named": "skin1"}}
        self.put_scene()
        why = self.plan("--why").stdout
        self.assertRegex(why, r"synthesize +left out +the material is the same everywhere")
        self.assertEqual(self.make(), ["prepare", "tetrahedralize", "polycube", "polygrid", "diffuse", "render"])
        makefile = self.text("Makefile")
        for stage in ["distance", "sample", "textons", "synthesize", "shell"]:
            self.assertRegex(makefile, "# %s is left out, because " % stage)

    def test_an_interpolated_core_is_asked_of_the_shell(self):
        self.content["material"]["core"] = "interpolated"
        self.put_scene()
        self.remake()
        self.assertIn("--core interpolated", self.text("Makefile"))
        self.content["material"]["core"] = "bottom-layer"
        self.put_scene()
        self.assertEqual(self.remake()[:1], ["shell"])
        self.assertNotIn("--core interpolated", self.text("Makefile"))
        self.content["material"]["core"] = "mean-value"
        self.content["material"]["shell"]["coordinates"] = "nearest"
        self.put_scene()
        self.assertEqual(self.remake()[:1], ["shell"])
        self.assertRegex(self.text("Makefile"), "--core mean-value.* --coordinates nearest")

    def put_paint(self, lines, properties="property float sample"):
        self.put("paint.ply", "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
                 "property float z\n%s\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n%s\n3 0 1 2\n"
                 % (properties, "\n".join(lines)))

    def test_several_samples_a_paint_and_a_core_of_its_own(self):
        self.put("moss.json", '{"type": "spots", "materials": {"body": {"named": "skin1"}, "spot": {"named": "apple"}}}')
        self.put("core.json", '{"type": "spots", "materials": {"body": {"named": "skin2"}, "spot": {"named": "cream"}}}')
        self.put_paint(["0 0 0 0", "1 0 0 1", "0 1 0 1"])
        self.content["material"] = {"shell": {"sample": ["marble.json", "moss.json"], "paint": "paint.ply",
                                              "thickness": 2, "voxel": 0.5}, "core": {"sample": "core.json"}}
        self.put_scene()
        ran = self.remake()
        self.assertEqual(ran, sorted(MADE + ["sample", "sample"], key=STAGES.index))
        makefile = self.text("Makefile")
        self.assertRegex(makefile, "sg-sample \\S+moss.json -o sample-2.vdb --voxel 0.5 --thickness 2 --ior 1.4 ")
        self.assertRegex(makefile, "sg-sample \\S+core.json -o core-sample.vdb --voxel 0.5 --ior 1.4 ")
        self.assertIn("sg-textons sample.vdb sample-2.vdb -o textons.vdb ", makefile)
        self.assertRegex(makefile, "sg-synthesize surface.ply textons.vdb \\S+paint.ply -o synthesized.ply --voxel 0.5 ")
        self.assertIn("sg-shell synthesized.ply distance.vdb sample.vdb sample-2.vdb -o shell.vdb --thickness 2 "
                      "--core solid --core-sample core-sample.vdb ", makefile)
        # Of each change only what follows from it.
        growth = ["synthesize", "shell", "diffuse", "render"]
        self.put_paint(["0 0 0 0", "1 0 0 1", "0 1 0 0"])
        self.assertEqual(self.make(), growth)
        self.put("moss.json", '{"type": "spots", "materials": {"body": {"named": "skin1"}, "spot": {"named": "cream"}}}')
        self.assertEqual(self.make(), ["sample", "textons", *growth])
        self.put("core.json", '{"type": "spots", "materials": {"body": {"named": "skin1"}, "spot": {"named": "cream"}}}')
        self.assertEqual(self.make(), ["sample", "shell", "diffuse", "render"])
        shell = self.content["material"]["shell"]
        for key, value, option, first in [
                ("scale", 0.5, "--scale 0.5", growth), ("direction", [-1, 0, 0], "--direction -1,0,0", growth),
                ("orient", [{"point": [-1, 2, 3], "direction": [0, 0, -2]}], "--orient -1,2,3,0,0,-1", growth),
                ("symmetry", 4, "--symmetry 4", ["textons", *growth]),
                ("coordinates", "nearest", "--coordinates nearest", ["shell", "diffuse", "render"])]:
            shell[key] = value
            self.put_scene()
            self.assertEqual(self.make(), first, key)
            self.assertIn(option + " ", self.text("Makefile"))
        shell.update(sample=["moss.json", "marble.json"])
        self.put_scene()
        self.assertEqual(self.make(), ["sample", "sample", "textons", *growth])
        shell.update(sample="moss.json", symmetry="auto", synthesis="textons")
        self.put_paint(["0 0 0 1", "1 0 0 2", "0 1 0 1"], "property float scale")
        self.put_scene()
        self.assertEqual(self.make(), ["textons", *growth])
        self.assertIn("sg-textons sample.vdb -o textons.vdb --method textons ", self.text("Makefile"))
        self.assertEqual(self.make("all", "views"), [])

    def test_a_paint_that_does_not_fit_is_refused_at_planning(self):
        self.content["material"] = {"shell": {"sample": ["marble.json", "marble.json"], "paint": "paint.ply",
                                              "thickness": 2, "voxel": 0.5}}
        self.put_scene()
        for lines, properties, words in [
                (["0 0 0", "1 0 0", "0 1 0"], "", "none of 'sample', 'quality' and 'red'"),
                (["0 0 0 0", "1 0 0 2", "0 1 0 1"], "property float sample", "vertex 1 wants sample 2, but there are 2"),
                (["0 0 0 0", "1 0 0 nan", "0 1 0 1"], "property float sample", "'sample' of vertex 1 is not finite"),
                (["0 0 0 0 9", "1 0 0 1 1", "0 1 0 1 1"], "property float sample\nproperty float scale", "the scale 9"),
                (["0 0 0 0 9", "1 0 0 1 1", "0 1 0 1 1"], "property float sample\nproperty float direction_x",
                 "no 'direction_y'")]:
            self.put_paint(lines, properties)
            done = self.plan()
            self.assertEqual((done.returncode, done.stderr.count("\n")), (3, 1), done.stderr)
            self.assertIn("material.shell.paint: ", done.stderr)
            self.assertIn(words, done.stderr)
        self.content["material"]["shell"].update(sample="marble.json", scale=3)
        self.put_scene()
        for lines, properties, words in [
                (["0 0 0 1", "1 0 0 2", "0 1 0 1"], "property float scale", "the scale 2 of vertex 1 times 3 is out of range"),
                (["0 0 0", "1 0 0", "0 1 0"], "", "nothing is painted"),
                (["0 0 0 0", "1 0 0 1", "0 1 0 1"], "property float sample", "vertex 1 wants sample 1, but there is one")]:
            self.put_paint(lines, properties)
            self.assertIn(words, self.plan().stderr)

    def test_a_makefile_of_someone_elses_stays(self):
        os.mkdir(self.out)
        with open(self.artefact("Makefile"), "w") as file:
            file.write("all:\n")
        done = self.plan()
        self.assertEqual((done.returncode, done.stderr.count("\n")), (3, 1))
        self.assertIn("Makefile: is not sg-plan's; give the scene a folder of its own", done.stderr)
        self.assertEqual(self.text("Makefile"), "all:\n")
        self.assertEqual(os.listdir(self.out), ["Makefile"])

    def test_an_opaque_object_needs_no_diffusion(self):
        self.content["material"] = {"opaque": {"reflectance": 0.7}}
        self.put_scene()
        self.assertRegex(self.plan("--why").stdout, r"diffuse +left out +the material is opaque")
        self.assertEqual(self.make(), ["prepare", "render"])

    def test_the_reference_is_made_where_it_is_asked_for(self):
        self.assertRegex(self.plan("--why").stdout, r"reference +on demand +it judges")
        self.assertNotIn("reference", self.remake("all", "views"))
        self.assertEqual(self.make("reference.ply"), ["reference"])
        self.assertEqual(self.make("reference.ply"), [])
        # Only paths, lights and matter are its own.
        self.content["method"].update(paths=2e6, tolerance=0.02)
        self.put_scene()
        self.assertEqual(self.remake("all", "reference.ply"), ["diffuse", "reference", "render"])
        self.assertIn("-o reference.ply --paths 2e6 ", self.text("Makefile"))
        self.content["camera"]["fov"] = 25
        self.put_scene()
        self.assertEqual(self.remake("reference.ply"), [])
        self.content["lights"][0]["irradiance"] = [2, 1, 1]
        self.put_scene()
        self.assertEqual(self.remake("reference.ply"), ["reference"])

    def test_path_tracing_needs_no_grid(self):
        self.content["method"] = {"type": "path-tracing", "paths": 1e5}
        self.put_scene()
        why = self.plan("--why").stdout
        self.assertRegex(why, r"polygrid +left out +the method path-tracing")
        self.assertRegex(why, r"reference +run +the method path-tracing")
        self.assertEqual(self.make(), ["prepare", "distance", "sample", "textons", "synthesize", "shell", "reference", "render"])
        self.content["method"] = {}
        self.put_scene()
        self.assertEqual(self.remake(), ["tetrahedralize", "polycube", "polygrid", "diffuse", "render"])
        self.content["material"], self.content["method"] = {"opaque": {}}, {"type": "path-tracing"}
        self.put_scene()
        self.assertEqual(self.remake(), ["prepare", "render"])

    def test_warns_where_diffusion_is_out_of_its_range(self):
        with open(os.path.join(self.scenes, "ball.off"), "w") as file:
            vertices, faces = icosphere(2)
            file.write("OFF\n%d %d 0\n" % (len(vertices), len(faces)))
            for row in [*vertices, *([3, *face] for face in faces)]:
                file.write(" ".join(map(str, row)) + "\n")
        # A ball of 20 mm has a mean chord of 13.3 mm.
        bright, dark = {"absorption": 0.003, "scattering": 3}, {"absorption": 1, "scattering": [9, 1, 9]}
        for material, words in [
                ({"core": bright}, None),
                ({"core": dark}, "in green, where the reduced albedo is 0.5 and the object 26 mean free paths thick"),
                ({"core": {"absorption": 0, "scattering": 0.15}}, "the reduced albedo is 1 and the object 2 mean free paths thick"),
                ({"opaque": {}}, None),
                (dict(SHELL, core=dark), None),  # the shell is jade
                (dict(SHELL), None)]:
            self.content["material"] = material
            self.put_scene()
            for planned in (self.plan(), self.plan("-q")):
                self.assertEqual(planned.returncode, 0, planned.stderr)
                if not words:
                    self.assertEqual(planned.stderr, "")
                    continue
                self.assertEqual(planned.stderr.count("\n"), 1, planned.stderr)
                self.assertIn("sg-plan: warning: diffusion is outside its range", planned.stderr)
                self.assertIn(words, planned.stderr)
                self.assertIn("sg-reference", planned.stderr)
        self.content["material"] = {"core": dark}
        self.content["method"]["type"] = "path-tracing"
        self.put_scene()
        self.assertEqual(self.plan().stderr, "")
        # A shell whose materials are all dark.
        self.content["method"]["type"] = "polygrid-diffusion"
        self.content["material"] = dict(SHELL)
        self.put("marble.json", json.dumps({"type": "spots", "materials": {"body": dark, "spot": dark}}))
        self.put_scene()
        self.assertIn("sg-plan: warning: diffusion is outside its range", self.plan().stderr)

    def test_each_change_runs_what_depends_on_it(self):
        self.remake()
        self.content["camera"]["fov"] = 25
        self.put_scene()
        self.assertEqual(self.remake(), ["render"])
        self.content["method"]["samples_per_pixel"] = 4
        self.put_scene()
        self.assertEqual(self.remake(), ["render"])
        self.content["lights"][0]["irradiance"] = [2, 1, 1]
        self.put_scene()
        self.assertEqual(self.remake(), ["diffuse", "render"])
        self.content["method"]["tolerance"] = 0.02
        self.put_scene()
        self.assertEqual(self.remake(), ["diffuse", "render"])
        self.put_sample(2)
        self.assertEqual(self.remake(), ["sample", "textons", "synthesize", "shell", "diffuse", "render"])
        self.content["method"]["nodes"] = 5000
        self.put_scene()
        self.assertEqual(self.remake(), ["polycube", "polygrid", "diffuse", "render"])
        self.put("ball.off", "another mesh")
        self.assertEqual(self.remake(), [s for s in MADE if s not in ("sample", "textons")])

    def test_a_scene_written_otherwise_with_the_same_content_runs_nothing(self):
        self.remake()
        self.put("scene.json", "// a comment\n" + json.dumps(dict(reversed(list(self.content.items())))))
        self.assertEqual(self.remake(), [])

    def test_make_alone_notices_a_changed_scene_mesh_or_sample(self):
        self.remake()
        self.content["camera"]["fov"] = 26
        self.put_scene()
        self.assertEqual(self.make(), ["render"])
        self.put_sample(3)
        self.assertEqual(self.make(), ["sample", "textons", "synthesize", "shell", "diffuse", "render"])
        self.assertEqual(self.make(), [])
        self.content["material"] = {"opaque": {}}
        self.put_scene()
        self.assertEqual(self.make(), ["prepare", "render"])

    def test_new_times_on_old_bytes_run_nothing(self):
        self.remake()
        for folder in (self.scenes, self.out, self.bin):
            for name in os.listdir(folder):
                os.utime(os.path.join(folder, name))
        self.assertEqual(self.remake("all", "views"), [])
        past = time.time() - 1e6
        for name in os.listdir(self.out):
            os.utime(self.artefact(name), (past, past))
        self.assertEqual(self.remake("all", "views"), [])
        self.put("ball.off", "a mesh")
        self.put_scene()
        self.assertEqual(self.remake(), [])

    def test_a_stage_that_makes_the_same_again_is_the_last_one(self):
        self.remake()
        self.put("ball.off", "a mesh" + "same to prepare")
        self.assertEqual(self.remake(), ["prepare"])
        self.assertEqual(self.remake(), [])
        self.write_program("distance", STAND_IN + "# another program\n")
        self.assertEqual(self.remake(), ["distance"])
        self.assertEqual(self.make("-n"), [])
        dry = subprocess.run(["make", "-n", "-C", self.out], capture_output=True, text=True).stdout
        self.assertNotIn("sg-shell", dry)

    def test_a_deleted_or_edited_artefact_is_made_again_and_nothing_after_it(self):
        self.remake()
        for name, stage in [("shell.vdb", "shell"), ("shell.view.ply", "shell"), ("exitance.ply", "diffuse"),
                            ("image.png", "render"), ("surface.ply", "prepare")]:
            os.remove(self.artefact(name))
            self.assertEqual(self.remake(), [stage], name)
            self.assertTrue(os.path.exists(self.artefact(name)), name)
        with open(self.artefact("surface.ply"), "a") as file:
            file.write("edited")
        self.assertEqual(self.remake(), ["prepare"])
        self.assertNotIn("edited", self.text("surface.ply"))

    def test_a_target_makes_only_what_it_needs(self):
        self.assertEqual(self.remake("distance.vdb"), ["prepare", "distance"])
        self.assertEqual(self.remake("sample.view.ply"), ["sample"])

    def test_jobs_side_by_side_make_the_same(self):
        self.plan()
        self.assertEqual(self.make("-j4"), MADE)
        self.assertEqual(self.make("-j4"), [])

    def test_a_failed_stage_fails_the_run_and_is_not_trusted(self):
        self.plan()
        ran = self.make(expect=2, FAIL="sg-shell")
        self.assertIn("shell", ran)
        self.assertNotIn("diffuse", ran)
        self.assertFalse(os.path.exists(self.artefact("image.png")))
        again = self.make()
        self.assertIn("shell", again)
        self.assertNotIn("prepare", again)

    def ran(self):
        log = os.path.join(self.root, "ran")
        if not os.path.exists(log):
            return []
        with open(log) as file:
            return file.read().split()

    def test_a_killed_stage_is_not_trusted(self):
        for stage in MADE:
            with self.subTest(stage):
                shutil.rmtree(self.out, ignore_errors=True)
                self.plan()
                log = os.path.join(self.root, "ran")
                for stale in (log, log + ".asleep"):
                    if os.path.exists(stale):
                        os.remove(stale)
                make = subprocess.Popen(["make", "-C", self.out], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                                        env={**os.environ, "RAN": log, "SLEEP": "sg-" + stage, "MAKEFLAGS": ""},
                                        start_new_session=True)
                deadline = time.time() + 60
                while not os.path.exists(log + ".asleep") and time.time() < deadline:
                    time.sleep(0.01)
                os.killpg(make.pid, signal.SIGKILL)
                make.wait()
                before = self.ran()
                self.assertEqual(before[-1], stage)
                self.assertEqual(self.make(), [s for s in MADE if s not in before[:-1]])
                self.assertEqual(self.make(), [])

    def test_names_are_data(self):
        names = ["$(shell touch x)", "a b", "#", "..", "it's", '"q"', "`touch x`", "$$x", "new\nline", "-x", "%", "\\n",
                 "a:b", "~", "*", "ünï", "b;touch x", "&", "$(MAKE)"]
        for name in names:
            with self.subTest(name):
                mesh = name + ".ply"
                self.put(mesh, "a mesh")
                self.content["object"]["mesh"] = mesh
                self.put(name + ".json", json.dumps(self.content))
                self.out = os.path.join(self.root, "out", name + " out" if name != ".." else "dots")
                os.makedirs(os.path.join(self.root, "out"), exist_ok=True)
                planned = self.plan(name=name + ".json")
                self.assertEqual(planned.returncode, 0, planned.stderr)
                self.assertEqual(self.make("surface.ply"), ["prepare"])
                self.assertEqual(self.make("surface.ply"), [])
                for folder, _, files in os.walk(self.root):
                    self.assertNotIn("x", files, folder)

    def test_the_front_makefile_takes_names_as_data(self):
        log = os.path.join(self.root, "ran")
        for name in ["$(shell touch x)", "a b", "#", "it's", "`touch x`", "$$x;touch x", "-x"]:
            with self.subTest(name):
                self.put(name + ".json", json.dumps(self.content))
                out = os.path.join(self.root, "to " + name)
                done = subprocess.run(
                    ["make", "-C", SOURCE, "-o", "programs", "-o", "assets/meshes/bunny00.off", "BUILD=" + self.root,
                     "SCENE=" + os.path.join(self.scenes, name + ".json"), "OUT=" + out, "surface.ply"],
                    capture_output=True, text=True, env={**os.environ, "RAN": log, "MAKEFLAGS": ""})
                self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
                self.assertTrue(os.path.exists(os.path.join(out, "surface.ply")))
                for folder in (SOURCE, self.scenes, out, self.root):
                    self.assertNotIn("x", os.listdir(folder))

    def test_a_mesh_outside_by_dots_is_found(self):
        with open(os.path.join(self.root, "far.ply"), "w") as file:
            file.write("a mesh")
        self.content["object"]["mesh"] = "../far.ply"
        self.put_scene()
        self.assertEqual(self.remake("surface.ply"), ["prepare"])

    def test_why_prints_each_stage_and_its_state(self):
        self.plan()
        self.assertRegex(self.plan("--why").stdout, r"prepare +run .*\(to be made: not made yet\)")
        self.make()
        self.content["camera"]["fov"] = 31
        self.put_scene()
        why = self.plan("--why").stdout
        self.assertRegex(why, r"diffuse +run .*\(up to date\)")
        self.assertRegex(why, r"render +run .*\(to be made: the scene changed\)")
        lines = [line.split()[0] for line in why.splitlines()[1:]]
        self.assertEqual(lines, STAGES)
        bare = subprocess.run([os.path.join(self.bin, "sg-plan"), os.path.join(self.scenes, "scene.json"), "--why"],
                              capture_output=True, text=True)
        self.assertEqual(bare.returncode, 0)

    def test_what_scene_and_sample_alone_tell_is_told_at_planning(self):
        """Not after minutes of other stages."""
        with open(os.path.join(self.scenes, "ball.off"), "w") as file:
            file.write("OFF\n4 4 0\n1 1 1\n1 -1 -1\n-1 1 -1\n-1 -1 1\n3 0 1 2\n3 0 3 1\n3 0 2 3\n3 1 3 2\n")

        def refused(*parts):
            self.put_scene()
            done = self.plan()
            self.assertEqual((done.returncode, done.stderr.count("\n")), (3, 1), done.stderr)
            for part in parts:
                self.assertIn(part, done.stderr)
            self.assertFalse(os.path.exists(self.out))

        bump = {"absorption": 0.01, "scattering": 1}
        self.put("bumps.json", json.dumps({"type": "bumps", "radius": 2, "lift": 1,
                                           "materials": {"body": bump, "bump": bump}}))
        self.content["material"]["shell"]["sample"] = "bumps.json"
        refused("material.shell", "bumps.json: the surface's relief reaches 4.125 mm deep, the thickness is only 2 mm", "at least 5 mm")
        self.content["material"]["shell"]["thickness"] = 5
        self.put_scene()
        self.assertEqual(self.plan().returncode, 0)
        shutil.rmtree(self.out)
        self.content["material"]["shell"]["voxel"] = 0.005
        refused("material.shell", "1000 layers", "1 to 512")
        self.content["material"]["shell"].update(sample="marble.json", voxel=5.01, thickness=6)
        refused("material.shell.voxel", "at most a quarter")
        self.put("marble.json", '{"type": "spots", "cuont": 3}')
        self.content["material"]["shell"].update(voxel=1, thickness=4)
        refused("material.shell", "marble.json: materials: is missing")
        self.put("marble.json", '{"type": "volume", "file": "gone.vdb"}')
        refused("marble.json: file:", "gone.vdb")
        self.content["material"] = {"core": {"named": "skin1"}}
        for position, inside in [([0, 0, 0], True), ([1, 2, 1], True), ([-6, -6, -6], False), ([9, 9, -9], False)]:
            self.content["camera"]["position"] = position
            self.content["camera"]["look_at"] = [0, 0, 1]
            if inside:
                refused("camera.position", "is inside the object")
            else:
                self.put_scene()
                self.assertEqual(self.plan().returncode, 0, position)
                shutil.rmtree(self.out)
        self.content["lights"].append({"type": "point", "position": [0, 1, 0], "intensity": 1})
        refused("lights[1].position: (0, 1, 0) is inside the object")

    def test_the_surface_is_as_fine_as_the_method_needs(self):
        self.plan()
        self.assertIn("--size 20 --spacing 0.5 ", self.text("Makefile"))
        self.content["material"] = {"core": {"named": "skin1"}}
        # Half of the nodes' distance, and a hundredth of the object at least.
        for nodes, spacing in [(1e3, "0.2"), (1e5, "0.108"), (8e6, "0.025")]:
            self.content["method"]["nodes"] = nodes
            self.put_scene()
            self.assertIn("its vertices stand %s mm apart" % spacing, self.plan("--why").stdout)
            self.assertIn("--size 20 --spacing %s " % spacing, self.text("Makefile"))
        self.content["material"] = {"opaque": {}}
        self.put_scene()
        self.assertRegex(self.plan("--why").stdout, "prepare .* its triangles are kept, because")
        self.assertIn("--size 20 --no-retile --longest-edge 0.2 ", self.text("Makefile"))

    def put_volume(self, name, scattering):
        """A base volume of one matter in the scenes' folder."""
        matter = {"absorption": 0.01, "scattering": scattering}
        self.put("grown.json", json.dumps({"type": "spots", "materials": {"body": matter, "spot": matter}}))
        done = subprocess.run([os.path.join(BIN, "sg-sample"), os.path.join(self.scenes, "grown.json"), "-o",
                               os.path.join(self.scenes, name), "--voxel", "1"], capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)

    def test_a_volume_that_the_sample_names_is_watched(self):
        self.put_volume("grown.vdb", 1)
        self.put("marble.json", '{"type": "volume", "file": "grown.vdb"}')
        self.remake()
        self.put_volume("grown.vdb", 2)
        self.assertEqual(self.make()[:1], ["sample"])
        self.assertEqual(self.make(), [])

    def test_volumes_that_make_no_sample_are_refused_when_planning(self):
        self.put_volume("grown.vdb", 1)
        with open(os.path.join(self.scenes, "grown.vdb"), "rb") as file:
            whole = file.read()
        descriptions = ('{"type": "volume", "file": "grown.vdb"}', '{"type": "solid", "sample": "grown.vdb"}')
        for content, complaint in ((b"a volume", "not an OpenVDB file"), (whole[:len(whole) // 3], "OpenVDB"),
                                   (whole.replace(b"extinction", b"extonction"), "'extinction'"),
                                   (whole.replace(b"material sample", b"material simple").replace(
                                       b"extinction", b"extonction"), "neither a grid 'extinction'")):
            with open(os.path.join(self.scenes, "grown.vdb"), "wb") as file:
                file.write(content)
            for sample in ("grown.vdb", *descriptions):
                if sample != "grown.vdb":
                    self.put("marble.json", sample)
                self.content["material"]["shell"]["sample"] = sample if sample == "grown.vdb" else "marble.json"
                self.put_scene()
                done = self.plan()
                self.assertEqual(done.returncode, 3, (content[:20], sample, done.stderr))
                self.assertEqual(len(done.stderr.strip().splitlines()), 1, done.stderr)
                self.assertIn("grown.vdb", done.stderr)
                self.assertIn(complaint, done.stderr)
        # Of classes a float grid.
        with open(os.path.join(self.scenes, "grown.vdb"), "wb") as file:
            file.write(whole)
        self.put("marble.json", '{"type": "volume", "file": "grown.vdb", "classes": [{"value": 1, "material": {"named": "skin1"}}]}')
        done = self.plan()
        self.assertEqual(done.returncode, 3)
        self.assertIn("no grid 'density' of type float", done.stderr)

    def test_values_in_a_scene_key_s_range_are_in_the_stages_ranges(self):
        """What planning accepts is no usage error of a stage."""
        ranges = {name: {o["flags"][-1]: (o.get("least"), o.get("most")) for o in json.loads(subprocess.run(
            [os.path.join(BIN, "sg-" + name), "--help-json"], capture_output=True, text=True).stdout)["options"]}
            for name in STAGES}
        keys = subprocess.run([os.path.join(BIN, "sg-plan"), "--scene-keys"], capture_output=True, text=True).stdout
        seen = set()
        for key, options in {"object.size": ["prepare --size"], "object.ior": ["sample --ior"],
                             "material.shell.thickness": ["sample --thickness", "shell --thickness"],
                             "material.shell.voxel": ["prepare --spacing", "distance --voxel", "sample --voxel",
                                                      "synthesize --voxel"],
                             "material.shell.scale": ["synthesize --scale"],
                             "material.core.absorption": ["shell --core-absorption"],
                             "material.core.scattering": ["shell --core-scattering"],
                             "material.core.anisotropy": ["shell --core-anisotropy"],
                             "method.nodes": ["polycube --nodes"],
                             "method.paths": ["reference --paths"]}.items():
            row = next(line.split("|") for line in keys.splitlines() if "`%s`" % key in line)
            least, most = (float(x) for x in row[5].split("…"))
            for option in options:
                program, flag = option.split()
                self.assertLessEqual(ranges[program][flag][0], least, option)
                self.assertGreaterEqual(ranges[program][flag][1], most, option)
                seen.add(option)
        self.assertEqual(len(seen), 14)

    def test_a_scene_without_light_is_planned_with_one_warning(self):
        for lights in (None, [], [dict(self.content["lights"][0], irradiance=0)]):
            self.content["lights"] = lights
            self.put("dark.json", json.dumps({key: value for key, value in self.content.items() if value is not None}))
            planned = self.plan(name="dark.json")
            self.assertEqual(planned.returncode, 0, planned.stderr)
            self.assertEqual(planned.stderr, "sg-plan: warning: no light shines in this scene: the object is black\n")

    def test_matter_that_does_not_scatter_needs_path_tracing(self):
        self.content["material"] = {"core": {"absorption": 0.1, "scattering": [1, 1, 0]}}
        self.put_scene()
        planned = self.plan()
        self.assertEqual(planned.returncode, 3)
        self.assertIn("material.core.scattering is 0 in blue", planned.stderr)
        self.content["method"] = {"type": "path-tracing"}
        self.put_scene()
        self.assertEqual(self.plan().returncode, 0)

    def test_a_scene_without_what_a_picture_needs_is_refused(self):
        for missing in ("object", "material", "camera"):
            with self.subTest(missing):
                changed = {key: value for key, value in self.content.items() if key != missing}
                self.put("part.json", json.dumps(changed))
                planned = self.plan(name="part.json")
                self.assertEqual(planned.returncode, 3)
                self.assertIn(missing + ": is missing", planned.stderr)
                self.assertEqual(planned.stderr.count("\n"), 1)


if __name__ == "__main__":
    unittest.main()
