# SPDX-License-Identifier: AGPL-3.0-or-later
"""What all programs share: exit codes, one clear line, odd names, records, progress, no half-written files."""
import json
import os
import pty
import resource
import shutil
import signal
import subprocess
import time
import unittest

from programs import BIN, SLOWNESS, icosphere, run, scene, torus, workplace, write_json, write_off

ODD_NAMES = ["$(shell touch x).ply", "a b.ply", "#.ply", "it's.ply", '"q".ply', "`touch x`.ply", "new\nline.ply", "ünï.ply",
             "[1].ply", "a,b.ply", "{}.ply", "%s.ply"]


class CommandLineTest(unittest.TestCase):
    def setUp(self):
        place = workplace()
        self.addCleanup(place.cleanup)
        self.root = place.name
        write_off(self.path("ball.off"), icosphere(2))

    def path(self, name):
        return os.path.join(self.root, name)

    def prepare(self, *arguments, **options):
        return run("prepare", *arguments, cwd=self.root, **options)

    def assert_refused(self, done, code, *parts):
        self.assertEqual(done.returncode, code, done.stderr)
        self.assertEqual(done.stderr.count("\n"), 1, done.stderr)
        self.assertTrue(done.stderr.startswith("sg-prepare: error: "), done.stderr)
        for part in parts:
            self.assertIn(part, done.stderr)
        self.assertEqual([name for name in os.listdir(self.root) if "partial" in name], [])

    def test_usage_errors_are_2_and_suggest(self):
        self.assert_refused(self.prepare(), 2, "missing", "usage: sg-prepare")
        self.assert_refused(self.prepare("ball.off"), 2, "missing -o")
        self.assert_refused(self.prepare("ball.off", "-o", "s.ply", "--sise", "3"), 2, "--sise; did you mean --size?")
        self.assert_refused(self.prepare("ball.off", "-o", "s.ply", "--size", "big"), 2, "--size", "not a number")
        self.assert_refused(self.prepare("ball.off", "-o", "s.ply", "--size", "nan"), 2, "not a number")
        self.assert_refused(self.prepare("ball.off", "-o", "s.ply", "--size", "-3"), 2, "out of range")
        self.assert_refused(self.prepare("ball.off", "-o", "s.ply", "--threads", "1.5"), 2, "whole number")
        self.assert_refused(self.prepare("ball.off", "-o", "s.ply", "--progress", "alway"), 2, "did you mean always?")
        self.assert_refused(self.prepare("ball.off", "-o", "s.ply", "--size"), 2, "--size")
        self.assert_refused(self.prepare("ball.off", "ball.off", "-o", "s.ply"), 2, "unexpected argument")
        self.assert_refused(self.prepare("ball.off", "-o", "ball.off"), 2, "would overwrite the input")
        os.symlink("ball.off", self.path("link.off"))
        self.assert_refused(self.prepare("ball.off", "-o", "link.off"), 2, "would overwrite the input")

    def test_bad_input_and_output_are_3_before_any_work(self):
        self.assert_refused(self.prepare("gone.off", "-o", "s.ply"), 3, "gone.off: No such file")
        self.assert_refused(self.prepare(".", "-o", "s.ply"), 3, "is a folder")
        self.assert_refused(self.prepare("ball.off", "-o", "none/s.ply"), 3, "there is no folder none")
        self.assert_refused(self.prepare("ball.off", "-o", "."), 3, "is a folder")
        self.assert_refused(self.prepare("bad\n\x1b[1m.off", "-o", "s.ply"), 3, "bad \\x1b[1m.off")
        self.assertEqual(sorted(os.listdir(self.root)), ["ball.off"])

    def test_outputs_have_the_right_extension_and_take_no_other_files_place(self):
        """Nothing is written over an input or another output, not even by a view, a record or a picture beside it."""
        small = ("--size", "80", "--spacing", "15")
        self.assert_refused(self.prepare("ball.off", "-o", "s.obj", *small), 2, "-o s.obj", ".ply")
        self.assert_refused(self.prepare("ball.off", "-o", "s", *small), 2, "-o s:", ".ply")
        self.assert_refused(self.prepare("ball.off", "-o", "s" * 250 + ".ply", *small), 3, "File name too long")
        os.symlink("loop.ply", self.path("loop.ply"))
        self.assert_refused(self.prepare("ball.off", "-o", "loop.ply", *small), 3, "loop.ply", "symbolic links")
        for device in ("/dev/full", "/dev/null"):
            self.assert_refused(self.prepare("ball.off", "-o", device, *small), 3, device, "regular file")
        os.mkfifo(self.path("pipe.ply"))
        self.assert_refused(self.prepare("ball.off", "-o", "pipe.ply", *small), 3, "pipe.ply", "regular file")
        os.mkdir(self.path("r.ply.json"))
        self.assert_refused(self.prepare("ball.off", "-o", "r.ply", *small), 3, "r.ply.json", "folder")
        for name in ("loop.ply", "pipe.ply"):
            os.remove(self.path(name))
        os.rmdir(self.path("r.ply.json"))
        self.assertEqual(os.listdir(self.root), ["ball.off"])
        self.assertEqual(self.prepare("ball.off", "-o", "S.PLY", *small).returncode, 0)

        def refused(part, program, *arguments):
            for name in arguments:
                if not name.startswith("-") and name != "new.hdf":
                    shutil.copy(self.path("S.PLY"), self.path(name))
            before = {name: os.stat(self.path(name)).st_mtime_ns for name in os.listdir(self.root)}
            done = run(program, *arguments, cwd=self.root)
            self.assertEqual(done.returncode, 2, done.stderr)
            self.assertEqual(done.stderr.count("\n"), 1, done.stderr)
            self.assertIn(part, done.stderr)
            self.assertEqual({name: os.stat(self.path(name)).st_mtime_ns for name in os.listdir(self.root)}, before)

        refused("overwrite the input d.view.ply", "distance", "d.view.ply", "-o", "d.vdb")
        refused("overwrite the input a.ply", "diffuse", "s.json", "p.hdf", "a.ply", "-o", "new.hdf", "--exitance", "a.ply")
        refused("overwrite the input exitance.ply", "diffuse", "s.json", "p.hdf", "exitance.ply", "-o", "new.hdf")
        refused("ends in .ply", "diffuse", "s.json", "p.hdf", "a.ply", "-o", "new.hdf", "--exitance", "e.hdf")
        refused("ends in .exr", "render", "s.json", "e.ply", "-o", "image.png")
        refused("overwrite the input s.png", "render", "s.png", "e.ply", "-o", "s.exr")

    def test_options_without_their_companions_or_values(self):
        self.assert_refused(self.prepare("ball.off", "-o", "s.ply", "--spa", "3"), 2, "did you mean --spacing?")
        self.assert_refused(self.prepare("ball.off", "-o", "s.ply", "--size"), 2, "--size: its value is missing")
        self.assert_refused(self.prepare("ball.off", "-o", "s.ply", "--longest-edge", "3"), 2, "only --no-retile takes it")
        self.assert_refused(self.prepare("ball.off", "-o", "s.ply", "--no-retile", "--spacing", "3"), 2, "--spacing: only")
        for words in (["--measure", "rmse"], ["--white", "1"]):
            done = run("compare", "ball.off", "ball.off", *words, cwd=self.root)
            self.assertEqual((done.returncode, done.stderr.count("\n")), (2, 1), done.stderr)
            self.assertIn(words[0] + ": only", done.stderr)
        write_off(self.path("ball.vdb"), icosphere(1))
        for program, words, part in [("shell", ["--core-anisotropy", "0.2"], "--core-absorption"),
                                     ("shell", ["--core-scattering", "1"], "--core-absorption"),
                                     ("synthesize", ["--direction", "0,0,0"], "--direction")]:
            files = ["ball.off", "ball.vdb", "ball.vdb"] if program == "shell" else ["ball.off", "ball.vdb"]
            done = run(program, *files, "-o", "o.vdb" if program == "shell" else "o.ply", *words, cwd=self.root)
            self.assertEqual((done.returncode, done.stderr.count("\n")), (2, 1), done.stderr)
            self.assertIn(part, done.stderr)

    def test_where_not_even_root_may_write_shows_before_any_work(self):
        write_off(self.path("large.off"), torus(around=400, across=400))
        started = time.monotonic()
        self.assert_refused(self.prepare("large.off", "-o", "/proc/s.ply", "--spacing", "0.1"), 3, "/proc/s.ply: cannot be written")
        write_json(self.path("scene.json"), scene())
        done = run("plan", "scene.json", "-o", "/proc/out", cwd=self.root)
        self.assertEqual((done.returncode, done.stderr.count("\n")), (3, 1), done.stderr)
        self.assertIn("/proc/out: cannot be written", done.stderr)
        self.assertLess(time.monotonic() - started, 10 * SLOWNESS)

    @unittest.skipIf(os.geteuid() == 0, "root may write everywhere")
    def test_an_unwritable_folder_is_3(self):
        os.mkdir(self.path("locked"), 0o555)
        self.assert_refused(self.prepare("ball.off", "-o", "locked/s.ply"), 3, "locked")

    @unittest.skipIf(SLOWNESS > 1, "sanitizers take terabytes of addresses")
    def test_too_little_memory_is_3_in_one_line_at_every_stage(self):
        """From hardly enough to load the libraries up to enough: wherever memory runs out, the program says so."""
        write_off(self.path("ball.off"), icosphere(4))
        with open(self.path("sample.json"), "w") as file:
            json.dump({"type": "spots", "size": [64, 64], "voxel": 1, "thickness": 4,
                       "materials": {"body": {"named": "marble"}, "spot": {"named": "ketchup"}}}, file)
        write_json(self.path("scene.json"), scene())
        stages = [["prepare", "ball.off", "-o", "surface.ply", "--size", "20", "--spacing", "1"],
                  ["distance", "surface.ply", "-o", "distance.vdb", "--voxel", "1"],
                  ["sample", "sample.json", "-o", "sample.vdb"],
                  ["textons", "sample.vdb", "-o", "textons.vdb"],
                  ["synthesize", "surface.ply", "textons.vdb", "-o", "synthesized.ply"],
                  ["shell", "synthesized.ply", "distance.vdb", "sample.vdb", "-o", "shell.vdb"],
                  ["tetrahedralize", "surface.ply", "-o", "tets.hdf"],
                  ["polycube", "tets.hdf", "-o", "polycube.hdf", "--nodes", "4000"],
                  ["polygrid", "polycube.hdf", "surface.ply", "-o", "polygrid.hdf"],
                  ["diffuse", "scene.json", "polygrid.hdf", "surface.ply", "shell.vdb", "-o", "fluence.hdf"],
                  ["render", "scene.json", "exitance.ply", "-o", "image.exr"],
                  ["compare", "shell.vdb", "shell.vdb", "-o", "difference.ply"],
                  ["describe", "shell.vdb", "-o", "description.json"],
                  ["plan", "scene.json", "-o", "out"]]
        said = 0
        for name, *arguments in stages:
            for megabytes in [70, 100, 115, 130, 145, 160, 175, 190, 210, 230, 260, 300, 400, 0]:
                def little():
                    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
                    if megabytes:
                        resource.setrlimit(resource.RLIMIT_AS, (megabytes << 20, megabytes << 20))
                done = run(name, *arguments, "-q", "--threads", "3", cwd=self.root, preexec=little)
                if done.returncode == 0:
                    break
                if run(name, "--version", preexec=little).returncode != 0:
                    continue  # the libraries do not load, or some thread that they start before main
                with self.subTest(stage=name, megabytes=megabytes):
                    errors = [line for line in done.stderr.splitlines() if "warning:" not in line]
                    self.assertEqual((done.returncode, len(errors)), (3, 1), done.stderr)
                    self.assertTrue(errors[0].startswith("sg-%s: error: " % name), errors)
                    said += "memory" in errors[0]
                    output = arguments[arguments.index("-o") + 1]
                    self.assertFalse(os.path.exists(self.path(output + ".json")))
                    self.assertEqual([left for left in os.listdir(self.root) if "partial" in left], [])
            self.assertEqual(done.returncode, 0, (name, done.stderr))
        self.assertGreater(said, 10)

    @unittest.skipIf(SLOWNESS > 1, "sanitizers take terabytes of addresses")
    def test_a_picture_too_large_for_the_memory_is_refused_at_once(self):
        content = scene(material={"opaque": {}})
        content["camera"]["resolution"] = [16384, 16384]
        write_json(self.path("scene.json"), content)

        def little():
            resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))
        done = run("render", "scene.json", "ball.off", "-o", "image.exr", cwd=self.root, preexec=little)
        self.assertEqual((done.returncode, done.stderr.count("\n")), (3, 1), done.stderr)
        self.assertIn("camera.resolution: a picture of 16384 × 16384 pixels", done.stderr)
        self.assertFalse(os.path.exists(self.path("image.exr")))

    def test_odd_names_are_names(self):
        for name in ODD_NAMES:
            with self.subTest(name):
                shutil.copy(self.path("ball.off"), self.path(name[:-4] + ".off"))
                done = self.prepare(name[:-4] + ".off", "-o", name, "--size", "80", "--spacing", "15", "-q")
                self.assertEqual(done.returncode, 0, done.stderr)
                with open(self.path(name + ".json")) as file:
                    record = json.load(file)
                self.assertEqual(record["inputs"][0]["path"], name[:-4] + ".off")
                again = subprocess.run(["sh", "-c", record["command"]], cwd=self.root, capture_output=True, text=True,
                                       env={**os.environ, "PATH": BIN + ":" + os.environ["PATH"]})
                self.assertEqual(again.returncode, 0, again.stderr)
        self.assertFalse(os.path.exists(self.path("x")))
        shutil.copy(self.path("ball.off"), self.path("-x.off"))
        done = self.prepare("-o", "-y.ply", "--size", "80", "--spacing", "15", "--", "-x.off")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertTrue(os.path.exists(self.path("-y.ply")))

    def test_the_record_tells_how_the_output_came_about(self):
        done = self.prepare("ball.off", "-o", "s.ply", "--size", "1e2", "--spacing", "1.5e1", "--threads", "1", "--seed", "7")
        self.assertEqual(done.returncode, 0, done.stderr)
        with open(self.path("s.ply.json")) as file:
            record = json.load(file)
        for key in ("stage", "version", "command", "inputs", "options", "threads", "seconds", "peak_memory_mib", "results",
                    "warnings"):
            self.assertIn(key, record)
        self.assertEqual(record["stage"], "sg-prepare")
        self.assertEqual(record["options"]["size"], 100)
        self.assertEqual(record["options"]["seed"], 7)
        self.assertEqual(record["threads"], 1)
        self.assertEqual(record["inputs"][0]["bytes"], os.path.getsize(self.path("ball.off")))
        self.assertEqual(record["outputs"][0]["bytes"], os.path.getsize(self.path("s.ply")))
        self.assertRegex(record["inputs"][0]["xxh64"], "^[0-9a-f]{16}$")
        self.assertGreater(record["seconds"]["total"], 0)
        self.assertGreater(record["peak_memory_mib"], 1)
        self.assertGreaterEqual(os.stat(self.path("s.ply.json")).st_mtime_ns, os.stat(self.path("s.ply")).st_mtime_ns)

    def test_progress_shows_on_a_terminal_only(self):
        arguments = ["ball.off", "-o", "s.ply", "--size", "80", "--spacing", "5"]
        self.assertNotIn("\x1b", self.prepare(*arguments).stderr)
        lines = self.prepare(*arguments, "--progress", "json").stderr.splitlines()
        self.assertGreater(len(lines), 0)
        for line in lines:
            if not line.startswith("sg-prepare: warning"):
                self.assertIn("task", json.loads(line))
        self.assertIn("\x1b[K", self.prepare(*arguments, "--progress", "always").stderr)
        leader, follower = pty.openpty()
        done = subprocess.run([os.path.join(BIN, "sg-prepare"), *arguments], cwd=self.root, stderr=follower)
        os.close(follower)
        self.assertEqual(done.returncode, 0)
        self.assertIn(b"\r", os.read(leader, 1 << 16))
        os.close(leader)

    def test_a_terminated_run_leaves_nothing(self):
        write_off(self.path("fine.off"), torus(around=400, across=400))
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGKILL):
            for delay in (0.05, 0.3):
                with self.subTest((number, delay)):
                    process = subprocess.Popen(
                        [os.path.join(BIN, "sg-prepare"), "fine.off", "-o", "s.ply", "--size", "80", "--spacing", "0.3"],
                        cwd=self.root, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
                    time.sleep(delay)
                    process.send_signal(number)
                    self.assertEqual(process.wait(), -number)
                    self.assertFalse(os.path.exists(self.path("s.ply")))
                    self.assertFalse(os.path.exists(self.path("s.ply.json")))

    def test_a_full_standard_output_is_an_error(self):
        with open("/dev/full", "w") as full:
            done = subprocess.run([os.path.join(BIN, "sg-prepare"), "--help"], stdout=full, stderr=subprocess.PIPE, text=True)
        self.assertEqual(done.returncode, 3)
        self.assertIn("standard output", done.stderr)


if __name__ == "__main__":
    unittest.main()
