# SPDX-License-Identifier: AGPL-3.0-or-later
"""sg-render from outside: its files, its record, the same bytes at any thread count, its refusals."""
import os
import struct
import sys
import unittest
import zlib

import programs


def write_exitance(path, mesh, value=(0.6, 0.5, 0.4), names=("exitance_r", "exitance_g", "exitance_b")):
    vertices, faces = mesh
    with open(path, "w") as file:
        file.write("ply\nformat ascii 1.0\nelement vertex %d\nproperty double x\nproperty double y\nproperty double z\n"
                   % len(vertices))
        for name in names:
            file.write("property float %s\n" % name)
        file.write("element face %d\nproperty list uchar int vertex_indices\nend_header\n" % len(faces))
        for p in vertices:
            file.write(" ".join(map(str, (*p, *value[:len(names)]))) + "\n")
        for f in faces:
            file.write("3 %d %d %d\n" % tuple(f))


def read_png_size(path):
    """Width and height, after the checksums of all chunks have been checked."""
    with open(path, "rb") as file:
        content = file.read()
    assert content[:8] == b"\x89PNG\r\n\x1a\n"
    at, size = 8, None
    while at < len(content):
        length, kind = struct.unpack(">I4s", content[at:at + 8])
        data = content[at + 8:at + 8 + length]
        assert zlib.crc32(kind + data) == struct.unpack(">I", content[at + 8 + length:at + 12 + length])[0]
        if kind == b"IHDR":
            size = struct.unpack(">II", data[:8])
        at += 12 + length
    return size


class Render(unittest.TestCase):
    def setUp(self):
        self.workplace = programs.workplace()
        self.addCleanup(self.workplace.cleanup)
        self.exitance = self.path("exitance.ply")
        write_exitance(self.exitance, programs.icosphere(3, 10.0))

    def path(self, name):
        return os.path.join(self.workplace.name, name)

    def scene(self, name="scene.json", **changes):
        content = programs.scene(object={"size": 20, "ior": 1.4}, material=None, **changes)
        programs.write_json(self.path(name), content)
        return self.path(name)

    def render(self, *arguments):
        return programs.run("render", *arguments)

    def bytes_of(self, name):
        with open(self.path(name), "rb") as file:
            return file.read()

    def refuses(self, code, what, *arguments):
        done = self.render(*arguments, "-o", self.path("refused.exr"))
        self.assertEqual(done.returncode, code, done.stderr)
        self.assertRegex(done.stderr, what)
        self.assertEqual(len(done.stderr.strip().splitlines()), 1, done.stderr)
        self.assertFalse(os.path.exists(self.path("refused.exr")))
        self.assertFalse(os.path.exists(self.path("refused.png")))

    def test_writes_picture_and_record(self):
        done = self.render(self.scene(), self.exitance, "-o", self.path("image.exr"))
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(read_png_size(self.path("image.png")), (48, 32))
        header = self.bytes_of("image.exr")[:4000]
        for layer in ("R", "G", "B", "A", "exitance.R", "exitance.G", "exitance.B", "specular.R", "specular.G", "specular.B",
                      "depth.Z", "normal.X", "normal.Y", "normal.Z"):
            self.assertIn(b"\0" + layer.encode() + b"\0", b"\0" + header, layer)
        results = programs.record(self.path("image.exr"))["results"]
        self.assertEqual(results["camera_rays"] + results["camera_rays_skipped"], 48 * 32 * 16)
        self.assertGreater(results["camera_rays_skipped"], 48 * 32 * 4)

    def test_same_bytes_twice_and_at_any_thread_count(self):
        scene = self.scene(lights=[{"type": "environment", "zenith": 1, "horizon": 0.3,
                                    "lamps": [{"direction": [1, 1, 1], "half_angle": 20, "radiance": [3, 2, 1]}]}],
                           floor={"ior": 1.3})
        for name, threads in (("a", 1), ("b", 2), ("c", 2)):
            done = self.render(scene, self.exitance, "-o", self.path(name + ".exr"), "--threads", threads)
            self.assertEqual(done.returncode, 0, done.stderr)
        for kind in (".exr", ".png"):
            self.assertEqual(self.bytes_of("a" + kind), self.bytes_of("b" + kind))
            self.assertEqual(self.bytes_of("b" + kind), self.bytes_of("c" + kind))

    def test_opaque_objects_need_no_exitance(self):
        programs.write_ply(self.path("surface.ply"), programs.icosphere(2, 10.0))
        scene = self.scene("opaque.json")
        content = programs.scene(material={"opaque": {"reflectance": [0.8, 0.5, 0.2]}}, object=None)
        programs.write_json(scene, content)
        done = self.render(scene, self.path("surface.ply"), "-o", self.path("image.exr"))
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(read_png_size(self.path("image.png")), (48, 32))

    def test_exposure_is_set_by_option_before_scene_before_measure(self):
        camera = {"position": [0, 0, 90], "fov": 20, "resolution": [24, 16], "exposure": 1.5}
        scene = self.scene(camera=camera)
        for option, expected in (([], 1.5), (["--exposure", "-2"], -2), (["--exposure", "auto"], None)):
            done = self.render(scene, self.exitance, "-o", self.path("image.exr"), *option)
            self.assertEqual(done.returncode, 0, done.stderr)
            found = programs.record(self.path("image.exr"))["results"]["exposure_stops"]
            if expected is None:
                self.assertNotIn(found, (1.5, -2))
            else:
                self.assertEqual(found, expected)

    def test_refusals(self):
        good = self.scene()
        inside = self.scene("inside.json", camera={"position": [1, 2, 3], "look_at": [0, 0, 0]})
        self.refuses(3, "camera at .* is inside the object", inside, self.exitance)
        self.refuses(3, "no camera", self.scene("blind.json", camera=None), self.exitance)
        write_exitance(self.path("two.ply"), programs.icosphere(1, 10.0), names=("exitance_r", "exitance_g"))
        self.refuses(3, "no vertex property exitance_b", good, self.path("two.ply"))
        write_exitance(self.path("nan.ply"), programs.icosphere(1, 10.0), value=("nan", 1, 1))
        self.refuses(3, "exitance is not finite", good, self.path("nan.ply"))
        self.refuses(3, "missing.ply", good, self.path("missing.ply"))
        self.refuses(2, "--tone", good, self.exitance, "--tone", "sepia")
        self.refuses(3, "--exposure", good, self.exitance, "--exposure", "bright")
        done = self.render(good, self.exitance, "-o", self.path("no/such/folder/image.exr"))
        self.assertEqual(done.returncode, 3, done.stderr)
        self.assertEqual(len(done.stderr.strip().splitlines()), 1, done.stderr)


if __name__ == "__main__":
    unittest.main(argv=sys.argv)
