# SPDX-License-Identifier: AGPL-3.0-or-later
"""Bad input: its exit code, one clear line on stderr, and nothing left that Make would trust."""
import glob
import os
import pathlib
import shutil
import struct
import subprocess
import unittest

import programs


def put(path, content):
    pathlib.Path(path).write_bytes(content.encode() if isinstance(content, str) else content)


class BadInput(unittest.TestCase):
    def setUp(self):
        self.folder = programs.workplace()
        self.addCleanup(self.folder.cleanup)
        self.old = os.getcwd()
        os.chdir(self.folder.name)
        self.addCleanup(os.chdir, self.old)

    def refused(self, code, *command, words=(), output=None):
        """Runs a program that must end with `code` and one line holding `words`, leaving nothing."""
        before = set(glob.glob("**", recursive=True, include_hidden=True))
        done = programs.run(*command)
        lines = done.stderr.strip().splitlines()
        self.assertEqual(done.returncode, code, (command, done.stderr))
        self.assertEqual(len(lines), 1, (command, done.stderr))
        self.assertTrue(lines[0].startswith("sg-%s: error: " % command[0]), lines[0])
        for word in words:
            self.assertIn(word.lower(), lines[0].lower(), command)
        left = set(glob.glob("**", recursive=True, include_hidden=True)) - before
        self.assertEqual(left, set(), command)
        return lines[0]

    def prepare_refuses(self, path, *words, code=3):
        return self.refused(code, "prepare", path, "-o", "surface.ply", "--size", "20", "--spacing", "1", words=words)

    # Meshes.
    def test_missing_file(self):
        self.prepare_refuses("nowhere.off", "nowhere.off")

    def test_empty_file(self):
        for name in ("empty.ply", "empty.obj", "empty.off", "empty.stl"):
            put(name, "")
            self.prepare_refuses(name, name, "empty")

    def test_truncated_ply(self):
        programs.write_ply("whole.ply", programs.icosphere(2))
        text = pathlib.Path("whole.ply").read_text()
        for share in (0.1, 0.5, 0.97):
            put("cut.ply", text[: int(len(text) * share)])
            self.prepare_refuses("cut.ply", "cut.ply")

    def test_truncated_binary_ply(self):
        header = ("ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
                  "property float z\nelement face 4\nproperty list uchar int vertex_indices\nend_header\n").encode()
        body = struct.pack("<12f", 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1)
        for f in ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)):
            body += struct.pack("<B3i", 3, *f)
        for length in range(0, len(body), 7):
            put("cut.ply", header + body[:length])
            self.prepare_refuses("cut.ply", "cut.ply")

    def test_header_that_promises_too_much(self):
        programs.write_ply("vertices.ply", programs.icosphere(1), vertex_count=4000000000)
        self.prepare_refuses("vertices.ply", "vertices.ply")
        programs.write_ply("faces.ply", programs.icosphere(1), face_count=4000000000)
        self.prepare_refuses("faces.ply", "faces.ply")
        put("promise.off", "OFF\n4000000000 4000000000 0\n0 0 0\n")
        self.prepare_refuses("promise.off", "promise.off")
        put("promise.stl", b"\0" * 80 + struct.pack("<I", 4000000000) + b"\0" * 100)
        self.prepare_refuses("promise.stl", "promise.stl")

    def test_coordinates_that_are_not_finite(self):
        for value in ("nan", "inf", "1e999"):
            vertices, faces = programs.icosphere(1)
            vertices[5] = (0, value, 0)
            programs.write_off("bad.off", (vertices, faces))
            self.prepare_refuses("bad.off", "bad.off")

    def test_face_index_out_of_range(self):
        for index in (42, -1, 2147483647):
            vertices, faces = programs.icosphere(1)
            faces[7] = (0, 1, index)
            programs.write_off("bad.off", (vertices, faces))
            self.prepare_refuses("bad.off", "bad.off")
            programs.write_ply("bad.ply", (vertices, faces))
            self.prepare_refuses("bad.ply", "bad.ply")

    def test_open_mesh(self):
        vertices, faces = programs.icosphere(2)
        programs.write_off("open.off", (vertices, faces[:-3]))
        self.prepare_refuses("open.off", "open.off", "boundary", "(", "--close-holes")

    def test_closing_holes_on_request(self):
        vertices, faces = programs.icosphere(2)
        programs.write_off("open.off", (vertices, faces[:-3]))
        done = programs.run("prepare", "open.off", "-o", "surface.ply", "--size", "20", "--spacing", "1", "--close-holes")
        self.assertEqual(done.returncode, 0, done.stderr)

    def test_self_intersecting_mesh(self):
        va, fa = programs.box((2, 2, 2))
        vb = [(x + 1, y + 0.5, z + 0.3) for x, y, z in va]
        crossing = (va + vb, fa + [tuple(i + len(va) for i in f) for f in fa])
        programs.write_off("crossing.off", crossing)
        self.prepare_refuses("crossing.off", "crossing.off", "(")

    def test_two_components(self):
        va, fa = programs.icosphere(2)
        vb, fb = programs.icosphere(2, centre=(5, 0, 0))
        programs.write_off("two.off", (va + vb, fa + [tuple(i + len(va) for i in f) for f in fb]))
        self.prepare_refuses("two.off", "two.off", "component", "2")

    def test_flat_mesh(self):
        vertices, faces = programs.icosphere(2)
        programs.write_off("flat.off", ([(x, y, 0) for x, y, z in vertices], faces))
        self.prepare_refuses("flat.off", "flat.off")
        programs.write_off("leaf.off", ([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2), (0, 2, 1)]))
        self.prepare_refuses("leaf.off", "leaf.off")

    def test_unknown_extension(self):
        put("mesh.xyz", "0 0 0\n")
        self.prepare_refuses("mesh.xyz", "mesh.xyz")

    # Options and outputs.
    def test_usage(self):
        programs.write_off("ball.off", programs.icosphere(1))
        self.refused(2, "prepare", "ball.off", "-o", "surface.ply", "--spacign", "1", words=("--spacing",))
        self.refused(2, "prepare", "ball.off", "-o", "surface.ply", "--spacing", "-1")
        self.refused(2, "prepare", "ball.off", "-o", "surface.ply", "--spacing", "x")
        self.refused(2, "prepare", "ball.off")

    def test_output_that_cannot_be_written(self):
        programs.write_off("ball.off", programs.icosphere(1))
        os.mkdir("taken.ply")
        for output in ("nowhere/surface.ply", "taken.ply"):
            self.refused(3, "prepare", "ball.off", "-o", output, "--size", "20", "--spacing", "2", words=(output,))
        self.refused(2, "prepare", "ball.off", "-o", "ball.off", "--size", "20", "--spacing", "2")

    # Volumes.
    def make_distance(self):
        programs.write_off("ball.off", programs.icosphere(2))
        done = programs.run("prepare", "ball.off", "-o", "surface.ply", "--size", "20", "--spacing", "1")
        self.assertEqual(done.returncode, 0, done.stderr)
        done = programs.run("distance", "surface.ply", "-o", "distance.vdb", "--voxel", "1", "--inside", "4", "--outside", "2")
        self.assertEqual(done.returncode, 0, done.stderr)

    def test_truncated_and_foreign_vdb(self):
        self.make_distance()
        whole = pathlib.Path("distance.vdb").read_bytes()
        for length in (0, 10, 60, len(whole) // 3, len(whole) // 2, len(whole) - 1):
            put("cut.vdb", whole[:length])
            self.refused(3, "textons", "cut.vdb", "-o", "textons.vdb", words=("cut.vdb",))
            self.refused(3, "describe", "cut.vdb", words=("cut.vdb",))
        for at in range(100, len(whole), max(1, len(whole) // 12)):
            broken = bytearray(whole)
            broken[at] ^= 0xFF
            put("broken.vdb", broken)
            done = programs.run("describe", "broken.vdb")
            self.assertIn(done.returncode, (0, 3), (at, done.stderr))

    def test_vdb_of_the_wrong_kind(self):
        self.make_distance()
        self.refused(3, "textons", "distance.vdb", "-o", "textons.vdb", words=("distance.vdb",))
        self.refused(3, "synthesize", "surface.ply", "distance.vdb", "-o", "synthesized.ply", words=("distance.vdb",))
        shutil.copy("surface.ply", "surface.vdb")
        self.refused(3, "textons", "surface.vdb", "-o", "textons.vdb", words=("surface.vdb",))

    # Scenes.
    def scene_refused(self, content, *words):
        programs.write_off("ball.off", programs.icosphere(2))
        if isinstance(content, str):
            put("scene.json", content)
        else:
            programs.write_json("scene.json", content)
        return self.refused(3, "plan", "scene.json", "-o", "out", words=("scene.json",) + words)

    def test_scene_that_is_no_json(self):
        self.scene_refused("")
        self.scene_refused("{ \"object\": ")
        self.scene_refused("[1, 2]")

    def test_misspelled_keys(self):
        self.scene_refused(programs.scene(camrea={}), "camrea", "camera")
        scene = programs.scene()
        scene["object"]["sise"] = 3
        self.scene_refused(scene, "sise", "size")
        scene = programs.scene()
        scene["lights"][0]["iradiance"] = [1, 1, 1]
        self.scene_refused(scene, "iradiance", "irradiance")

    def test_values_out_of_range(self):
        for absorption in ([-0.01, 0, 0], ["a", 0, 0], [1, 2], [1e999, 0, 0]):
            scene = programs.scene()
            scene["material"]["core"]["absorption"] = absorption
            self.scene_refused(scene, "absorption")
        for ior in (0.5, -1, "glass"):
            scene = programs.scene()
            scene["object"]["ior"] = ior
            self.scene_refused(scene, "ior")
        scene = programs.scene()
        scene["camera"]["look_at"] = scene["camera"]["position"]
        self.scene_refused(scene, "camera")

    def test_missing_mesh(self):
        self.scene_refused(programs.scene(mesh="nowhere.off"), "nowhere.off")

    def test_camera_inside_the_object(self):
        programs.write_off("ball.off", programs.icosphere(2))
        self.assertEqual(programs.run("prepare", "ball.off", "-o", "surface.ply", "--size", "20", "--spacing", "1").returncode, 0)
        scene = programs.scene(material={"opaque": {"reflectance": [0.5, 0.5, 0.5]}})
        scene["camera"]["position"] = [0, 0, 5]
        programs.write_json("inside.json", scene)
        self.refused(3, "render", "inside.json", "surface.ply", "-o", "image.exr", words=("camera", "inside"))

    # Disks.
    def test_full_disk(self):
        """Each kind of output on a file system of 24 KiB, mounted in a user namespace."""
        self.make_distance()
        os.mkdir("disk")
        can = subprocess.run(["unshare", "-Urm", "mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", "disk"], capture_output=True)
        # Where namespaces are not to be had, the size of files is limited instead: writes end the same way.
        mount = ["unshare", "-Urm", "sh", "-c"] if can.returncode == 0 else None
        cases = {"surface.ply": ["prepare", "ball.off", "--size", "20", "--spacing", "0.3"],
                 "distance.vdb": ["distance", "surface.ply", "--voxel", "0.5", "--inside", "4", "--outside", "2"],
                 "tets.hdf": ["tetrahedralize", "surface.ply"]}
        for output, (program, *arguments) in cases.items():
            command = [os.path.join(programs.BIN, "sg-" + program), *arguments, "-o", "disk/" + output]
            if mount:
                script = 'mount -t tmpfs -o size=24k tmpfs disk && "$@"; code=$?; ls -A disk >&2; exit $code'
                done = subprocess.run([*mount, script, "sh", *command], capture_output=True, text=True)
            else:
                done = subprocess.run(["sh", "-c", 'ulimit -f 24; trap "" XFSZ; "$@"; code=$?; ls -A disk >&2; exit $code', "sh",
                                       *command], capture_output=True, text=True)
            self.assertEqual(done.returncode, 3, (program, done.stderr))
            lines = done.stderr.strip().splitlines()
            self.assertEqual(len(lines), 1, "one line, and an empty disk after it: %s" % done.stderr)
            self.assertIn("disk/" + output.split(".")[0], lines[0])


if __name__ == "__main__":
    unittest.main()
