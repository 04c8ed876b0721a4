# SPDX-License-Identifier: AGPL-3.0-or-later
"""What tests of whole programs share: running them, small meshes, small scenes."""
import json
import math
import os
import subprocess
import tempfile
import unittest

BIN = os.environ.get("SG_BIN", os.path.join(os.getcwd(), "build", "bin"))
# How many times longer everything takes than in a release build.
SLOWNESS = float(os.environ.get("SG_SLOWNESS", "1"))
SOURCE = os.environ.get("SG_SOURCE", os.getcwd())


def run(program, *arguments, cwd=None, timeout=300, env=None, preexec=None):
    """Runs sg-PROGRAM and returns the finished process, with its output as text."""
    return subprocess.run([os.path.join(BIN, "sg-" + program), *map(str, arguments)], cwd=cwd, text=True, errors="replace",
                          stdin=subprocess.DEVNULL, capture_output=True, timeout=timeout * SLOWNESS,
                          env={**os.environ, **(env or {})}, preexec_fn=preexec)


def workplace():
    """A temporary folder that goes away with the returned object."""
    return tempfile.TemporaryDirectory(prefix="sg-test-")


class WorkplaceTest(unittest.TestCase):
    """A test that works in a temporary folder of its own."""

    def setUp(self):
        holder = workplace()
        self.addCleanup(holder.cleanup)
        self.folder = holder.name

    def at(self, *names):
        return os.path.join(self.folder, *names)

    def ok(self, program, *arguments):
        process = run(program, *arguments)
        self.assertEqual(process.returncode, 0, process.stderr)
        return process


def record(path):
    with open(str(path) + ".json") as file:
        return json.load(file)


def icosphere(subdivisions=3, radius=1.0, centre=(0.0, 0.0, 0.0)):
    """Vertices and triangles of a sphere, counter-clockwise from outside."""
    golden = (1 + math.sqrt(5)) / 2
    vertices = [(-1, golden, 0), (1, golden, 0), (-1, -golden, 0), (1, -golden, 0), (0, -1, golden), (0, 1, golden),
                (0, -1, -golden), (0, 1, -golden), (golden, 0, -1), (golden, 0, 1), (-golden, 0, -1), (-golden, 0, 1)]
    faces = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6),
             (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7),
             (9, 8, 1)]

    def unit(p):
        length = math.sqrt(sum(x * x for x in p))
        return tuple(x / length for x in p)

    vertices = [unit(p) for p in vertices]
    for _ in range(subdivisions):
        middle, finer = {}, []

        def split(a, b):
            key = (min(a, b), max(a, b))
            if key not in middle:
                middle[key] = len(vertices)
                vertices.append(unit(tuple((x + y) / 2 for x, y in zip(vertices[a], vertices[b]))))
            return middle[key]

        for a, b, c in faces:
            ab, bc, ca = split(a, b), split(b, c), split(c, a)
            finer += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        faces = finer
    return [tuple(radius * x + c for x, c in zip(p, centre)) for p in vertices], faces


def torus(major=2.0, minor=0.8, around=48, across=24):
    vertices, faces = [], []
    for i in range(around):
        u = 2 * math.pi * i / around
        for j in range(across):
            v = 2 * math.pi * j / across
            r = major + minor * math.cos(v)
            vertices.append((r * math.cos(u), r * math.sin(u), minor * math.sin(v)))
    for i in range(around):
        for j in range(across):
            a, b = i * across + j, ((i + 1) % around) * across + j
            c, d = ((i + 1) % around) * across + (j + 1) % across, i * across + (j + 1) % across
            faces += [(a, b, c), (a, c, d)]
    return vertices, faces


def box(size=(1.0, 1.0, 1.0)):
    x, y, z = size
    vertices = [(0, 0, 0), (x, 0, 0), (x, y, 0), (0, y, 0), (0, 0, z), (x, 0, z), (x, y, z), (0, y, z)]
    faces = [(0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7), (0, 1, 5), (0, 5, 4), (1, 2, 6), (1, 6, 5), (2, 3, 7), (2, 7, 6),
             (3, 0, 4), (3, 4, 7)]
    return vertices, faces


def write_off(path, mesh):
    vertices, faces = mesh
    with open(path, "w") as file:
        file.write("OFF\n%d %d 0\n" % (len(vertices), len(faces)))
        for p in vertices:
            file.write("%s %s %s\n" % tuple(p))
        for f in faces:
            file.write("3 %d %d %d\n" % tuple(f))


def write_ply(path, mesh, vertex_count=None, face_count=None):
    """ASCII PLY; the counts in the header may be made to lie."""
    vertices, faces = mesh
    with open(path, "w") as file:
        file.write("ply\nformat ascii 1.0\nelement vertex %d\nproperty float x\nproperty float y\nproperty float z\n"
                   "element face %d\nproperty list uchar int vertex_indices\nend_header\n"
                   % (vertex_count or len(vertices), face_count or len(faces)))
        for p in vertices:
            file.write("%s %s %s\n" % tuple(p))
        for f in faces:
            file.write("3 %d %d %d\n" % tuple(f))


def scene(mesh="ball.off", **changes):
    """A scene small enough that every stage of it takes a second or so; sections may be replaced."""
    content = {
        "object": {"mesh": mesh, "size": 20, "ior": 1.4},
        "material": {"core": {"absorption": [0.01, 0.02, 0.03], "scattering": [2, 2, 2], "anisotropy": 0}},
        "lights": [{"type": "directional", "direction": [0, 0, -1], "irradiance": [1, 1, 1]}],
        "camera": {"position": [0, 0, 90], "look_at": [0, 0, 0], "up": [0, 1, 0], "fov": 20, "resolution": [48, 32]},
        "method": {"type": "polygrid-diffusion", "nodes": 4000, "tolerance": 0.01},
    }
    content.update(changes)
    return {key: value for key, value in content.items() if value is not None}


def write_json(path, content):
    with open(path, "w") as file:
        json.dump(content, file)
