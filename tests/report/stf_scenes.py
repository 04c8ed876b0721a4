# SPDX-License-Identifier: AGPL-3.0-or-later
"""The scenes of the report on shell texture functions: shapes, samples and lights, from one table."""
import json
import os
import re
import sys

import numpy

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path.append(os.path.join(HERE, "..", "support"))
import programs
import shape_samples
from phantom import wax, write_nrrd
from ply_file import read_ply, write_ply

SAMPLES = os.path.join(HERE, "..", "..", "assets", "samples")
# Soft light that paths can hit: a sky and two broad lamps, one behind.
STUDIO = {"type": "environment", "zenith": [0.5, 0.55, 0.62], "horizon": [0.3, 0.3, 0.3], "ground": [0.12, 0.11, 0.1],
          "lamps": [{"direction": [-0.7, 0.8, 0.5], "half_angle": 22, "softness": 0.2, "radiance": [5, 4.9, 4.7]},
                    {"direction": [0.9, 0.3, -0.7], "half_angle": 20, "softness": 0.2, "radiance": [5, 4.6, 4.0]}]}
GALLERY_LIGHTS = [
    {"type": "environment", "zenith": [0.17, 0.20, 0.26], "horizon": [0.05, 0.052, 0.06], "ground": [0.06, 0.047, 0.037],
     "lamps": [{"direction": [-0.85, 0.75, 0.45], "half_angle": 18, "softness": 0.08, "radiance": [6.2, 5.9, 5.5]},
               {"direction": [0.95, 0.3, 0.4], "half_angle": 7, "softness": 0.1, "radiance": [3, 2.8, 2.6]}]},
    {"type": "directional", "direction": [-0.62, -0.38, 0.7], "irradiance": [5.5, 4.3, 3.0]}]
FLOOR = {"reflectance": [0.09, 0.078, 0.07], "ior": 1.35, "radius": 7}
# All sides lit, from above the most.
SKY = {"type": "environment", "zenith": [1, 1, 1], "horizon": [0.7, 0.7, 0.7], "ground": [0.35, 0.35, 0.35]}
BODY = {"absorption": [0.05, 0.055, 0.06], "scattering": [1.5, 1.5, 1.5]}
BLOCKS = {60: {"absorption": [0.05, 0.7, 0.8], "scattering": [1.5, 1.2, 1.2]},    # red, on top
          100: {"absorption": [0.7, 0.06, 0.6], "scattering": [1.2, 1.5, 1.2]},   # green
          140: {"absorption": [0.7, 0.5, 0.05], "scattering": [1.2, 1.2, 1.5]},   # blue
          180: {"absorption": [0.8, 0.8, 0.8], "scattering": [1.2, 1.2, 1.2]}}    # black, deepest


def description(name, **changes):
    """A sample of assets/samples, other where `changes` say so, its files by their whole paths."""
    path = os.path.join(SAMPLES, name + ".json")
    with open(path) as file:
        content = json.loads(re.sub(r"^\s*//.*$", "", file.read(), flags=re.M))
    content.update(changes)
    whole = lambda file: os.path.abspath(os.path.join(SAMPLES, file))
    if "file" in content:
        content["file"] = whole(content["file"])
    for part in content.get("parts", []):
        if "mesh" in part:
            part["mesh"] = whole(part["mesh"])
    return content


def blocks_volume(path, side=24, layers=16):
    """Blocks of four colours, one deeper than the other, the first on top, the last above the twelfth layer; values by
    BLOCKS, the rest wax. It tiles."""
    values = numpy.full((side, side, layers), 20, numpy.uint8)
    half = side // 2
    for k, (value, (top, bottom)) in enumerate(zip(BLOCKS, ((0, 2), (2, 5), (5, 8), (8, 11)))):
        x, y, across = half * (k % 2) + side // 12, half * (k // 2) + side // 12, side // 3
        values[x:x + across, y:y + across, top:bottom] = value
    write_nrrd(path, values)


def blocks_sample(volume, ior=1.3):
    return {"type": "volume", "file": volume, "ior": ior, "down": "z", "thickness": 4, "spacing": 0.25,
            "classes": [{"value": 20, "material": BODY}] +
                       [{"value": value, "material": material} for value, material in BLOCKS.items()]}


def shaded_sample():
    """Spots that let light as far as the paper's irradiance correction has to follow it."""
    return description("spots", size=[48, 48], voxel=0.5, thickness=4, ior=1.4, count=22, radius=1.4, variation=0.6, softness=0.8,
                       materials={"body": {"absorption": [0.01, 0.02, 0.05], "scattering": [1.6, 2.0, 2.4]},
                                  "spot": {"absorption": [0.4, 0.5, 0.2], "scattering": [3, 2, 2]}})


def lay_on_faces(synthesized, path, voxel, side):
    """Lays the sample on each face of a cube as it is, side by side, instead of what was synthesised there."""
    vertices, triangles = read_ply(synthesized)
    vertices = vertices.copy()
    points = numpy.stack([vertices[axis] for axis in "xyz"], axis=1).astype(float)
    axis = numpy.abs(points).argmax(axis=1)
    outward = numpy.sign(points[numpy.arange(len(points)), axis])
    u, v = numpy.eye(3)[(axis + 1) % 3], numpy.eye(3)[(axis + 2) % 3] * outward[:, None]
    for name, share, along in (("texture_u", "s", u), ("texture_v", "t", v)):
        vertices[name] = ((points * along).sum(axis=1) / voxel) % side
        vertices[share] = vertices[name] / side
    for k, name in enumerate("xyz"):
        vertices["direction_" + name] = u[:, k]
    write_ply(path, vertices, triangles)
    return path


def revolved(profile, around=96):
    """A closed shape about the y axis: radii and heights from bottom to top, both ends on the axis."""
    profile = numpy.asarray(profile, float)
    inner = profile[1:-1]
    points = [(0, profile[0][1], 0)]
    for radius, height in inner:
        turns = 2 * numpy.pi * numpy.arange(around) / around
        points += list(zip(radius * numpy.cos(turns), numpy.full(around, height), -radius * numpy.sin(turns)))
    points.append((0, profile[-1][1], 0))
    faces = []
    ring = lambda r, j: 1 + r * around + j % around
    for j in range(around):
        faces.append((0, ring(0, j + 1), ring(0, j)))
        faces.append((len(points) - 1, ring(len(inner) - 1, j), ring(len(inner) - 1, j + 1)))
        for r in range(len(inner) - 1):
            faces += [(ring(r, j), ring(r, j + 1), ring(r + 1, j + 1)), (ring(r, j), ring(r + 1, j + 1), ring(r + 1, j))]
    return points, faces


def torus():
    """Fine enough for smooth highlights."""
    return programs.torus(around=144, across=72)


def strawberry():
    """Broad shoulders round a hollow, a blunt tip."""
    t = numpy.linspace(0, 1, 80)
    radii = 0.5 * numpy.sin(numpy.pi * t) ** 0.75 * (0.42 + 0.75 * t)
    heights = 1.2 * (1 - numpy.cos(numpy.pi * t)) / 2 - 0.14 * (t > 0.5) * numpy.exp(-(radii / 0.16) ** 2)
    return revolved(numpy.stack([radii, heights], axis=1))


def lumpy_wax(path):
    """A tomogram of wax with balls of one density, so that no rim of theirs passes for another, below a lumpy surface."""
    write_nrrd(path, wax((36, 36, 16), 3, (1.8, 0.8, 2.5, 2), 11, (2.8, 4.4), 4.8, (220.0,)), (0.4, 0.4, 0.4))


def overhang():
    """An arm over a plate, one piece, 16 × 24 × 30 cubes."""
    y, z = numpy.mgrid[0:24, 0:30]
    profile = (y < 8) | (z < 6) | ((y >= 18) & (z < 14))
    points, faces = shape_samples.blocks(numpy.broadcast_to(profile, (16, *profile.shape)), smooth=False)
    return points.tolist(), faces.tolist()


def camera(position, fov, width, height, look_at=(0, 0, 0)):
    return {"position": list(position), "look_at": list(look_at), "up": [0, 1, 0], "fov": fov, "resolution": [width, height]}


def scene(mesh, size, sample, thickness, voxel, view, lights, ior, error=0.1, samples=16, **others):
    return {"object": {"mesh": mesh, "size": size, "ior": ior},
            "material": {"shell": {"sample": sample, "thickness": thickness, "voxel": voxel}, "core": "bottom-layer"},
            "lights": lights, "camera": view,
            "method": {"type": "shell-texture-function", "irradiance_error": error, "samples_per_pixel": samples}, **others}


def gallery(study, sizes):
    """Name, scene and views of each picture."""
    width, height = 2 * sizes.width, 2 * sizes.height
    view = lambda position, fov, look_at=(0, 0, 0): camera(position, fov, width, height, look_at)
    mesh = lambda name, shape: (programs.write_off(study.at(name + ".off"), shape), study.at(name + ".off"))[1]
    bunny = os.path.abspath(sizes.bunny) if sizes.bunny else mesh("pear", shape_samples.pear())
    write = lambda name, content: study.write("gallery-samples", name + ".json", content)
    of = lambda name, **changes: write(name, description(name, **changes))
    lit = {"floor": FLOOR}

    whole = view((36, 72, 140), 25)
    jade = of("spots", size=[64, 64], count=90, radius=1.1, variation=0.9, softness=1.6,
              materials={"body": {"absorption": [0.022, 0.004, 0.014], "scattering": [0.75, 0.85, 0.75]},
                         "spot": {"absorption": [0.30, 0.05, 0.20], "scattering": [1.0, 1.1, 1.0]}})
    yield ("jade-torus", scene(mesh("torus", torus()), 60, jade, 4, 0.4, whole, GALLERY_LIGHTS, 1.5, **lit), [("jade-torus", whole)])

    near = view((-61, 61, 334), 26)
    bumps = of("bumps", size=[56, 56], voxel=0.45, thickness=4.5, count=60, radius=1.0, lift=0.3)
    yield ("bumpy-bunny", scene(bunny, 130, bumps, 4.5, 0.45, near, GALLERY_LIGHTS, 1.4, **lit), [("bumpy-bunny", near)])

    front, back = view((-38, 38, 206), 26), view((70, 30, -190), 26)
    yield ("marble-bunny", scene(bunny, 80, of("marble"), 4, 0.4, front, GALLERY_LIGHTS, 1.5, **lit),
           [("marble-bunny", front), ("marble-bunny-from-behind", back)])

    tomogram = study.at("gallery-samples", "wax.nrrd")
    balls = description("wax", thickness=6.4, file=tomogram)
    balls["classes"] = [{"from": 0, "to": 20, "free": True},
                        {"from": 80, "to": 100, "material": {"absorption": [0.003, 0.006, 0.018], "scattering": [0.5, 0.5, 0.55]}},
                        {"from": 205, "to": 255, "material": {"absorption": [0.30, 0.9, 0.06], "scattering": [1.5, 1.2, 1.6]}}]
    wax_sample = write("wax", balls)
    lumpy_wax(tomogram)
    ring = view((43, 86, 168), 25)
    yield ("wax-torus", scene(mesh("torus", torus()), 72, wax_sample, 6.4, 0.4, ring, GALLERY_LIGHTS, 1.43, **lit), [("wax-torus", ring)])

    skin = description("strawberry")
    skin["parts"][0]["material"] = {"absorption": [0.05, 2.2, 2.4], "scattering": [1.9, 1.3, 1.2]}
    above = view((18, 30, 74), 28)
    yield ("strawberry", scene(mesh("strawberry", strawberry()), 32, write("strawberry", skin), 3.6, 0.2, above, GALLERY_LIGHTS, 1.35,
                               **lit), [("strawberry", above)])
