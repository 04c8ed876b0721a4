# SPDX-License-Identifier: AGPL-3.0-or-later
"""Pictures of a mesh on its way to a polygrid, drawn by a small rasteriser, and the sheets that gather them.

    contact_sheet.py FOLDER PICTURE     draws the row of pictures of what the stages left in FOLDER
    contact_sheet.py SHEET NAME VERDICT PICTURE …   gathers rows
"""
import os
import struct
import subprocess
import sys
import zlib

import h5py
import numpy

import grid_check

WIDTH, HEIGHT = 300, 240  # pixels of one picture
FINER = 2  # samples a pixel and direction
LABEL = 22  # pixels above a row
QUAD_TRIANGLES = [(0, 1, 2), (0, 2, 3)]
# Faces of a VTK hexahedron, outward.
HEX_FACES = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]


def read_ply(path):
    """Vertices and triangles of a binary PLY file as the stages write them."""
    types = {"double": "<f8", "float": "<f4", "uchar": "u1", "int": "<i4"}
    with open(path, "rb") as file:
        data = file.read()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    fields, vertices, faces = [], 0, 0
    for line in data[:end].decode().splitlines():
        words = line.split()
        if words[0] == "element":
            vertices, faces = (int(words[2]), faces) if words[1] == "vertex" else (vertices, int(words[2]))
        elif words[0] == "property" and words[1] != "list":
            fields.append((words[2], types[words[1]]))
    vertex = numpy.dtype(fields)
    table = numpy.frombuffer(data, vertex, vertices, end)
    face = numpy.dtype([("count", "u1"), ("corners", "<i4", 3)])
    corners = numpy.frombuffer(data, face, faces, end + vertices * vertex.itemsize)["corners"]
    return numpy.stack([table["x"], table["y"], table["z"]], axis=1).astype(float), corners


class Camera:
    """A parallel view of points, along the shortest edge of their box and somewhat from the side and above."""

    def __init__(self, points):
        lower, upper = points.min(axis=0), points.max(axis=0)
        self.axis = int(numpy.argmin(upper - lower))
        up_axis = 1 if self.axis != 1 else 2
        towards, up = numpy.eye(3)[self.axis], numpy.eye(3)[up_axis]
        side = numpy.cross(up, towards)
        towards = towards + 0.45 * side + 0.35 * up
        self.towards = towards / numpy.linalg.norm(towards)
        self.side = numpy.cross(up, self.towards)
        self.side /= numpy.linalg.norm(self.side)
        self.up = numpy.cross(self.towards, self.side)
        seen = points @ numpy.stack([self.side, self.up, self.towards], axis=1)
        self.centre = numpy.stack([self.side, self.up, self.towards], axis=1) @ (seen.min(axis=0) + seen.max(axis=0)) / 2
        reach = seen.max(axis=0) - seen.min(axis=0)
        self.scale = 0.94 * FINER * min(WIDTH / reach[0], HEIGHT / reach[1])

    def see(self, points):
        """Pixels right and down, and the depth, smaller where nearer."""
        away = points - self.centre
        return numpy.stack([FINER * WIDTH / 2 + self.scale * away @ self.side, FINER * HEIGHT / 2 - self.scale * away @ self.up,
                            -self.scale * away @ self.towards], axis=1)


def rasterise(corners):
    """The nearest triangle at each pixel, −1 for none, and the pixel's barycentric coordinates. corners: n×3×3 as seen."""
    width, height = FINER * WIDTH, FINER * HEIGHT
    nearest = numpy.full(width * height, numpy.inf)
    triangle = numpy.full(width * height, -1)
    weights = numpy.zeros((width * height, 3))
    low = numpy.floor(corners[:, :, :2].min(axis=1)).astype(int)
    extent = (numpy.ceil(corners[:, :, :2].max(axis=1)).astype(int) - low).max(axis=1) + 1
    bins = numpy.ceil(numpy.log2(numpy.maximum(extent, 2))).astype(int)
    for size in numpy.unique(bins):
        members = numpy.flatnonzero(bins == size)
        edge = 1 << int(size)
        step = max(1, (1 << 20) // edge**2)
        y, x = (grid.ravel() for grid in numpy.mgrid[0:edge, 0:edge])
        for part in (members[at:at + step] for at in range(0, len(members), step)):
            px, py = low[part, :1] + x, low[part, 1:] + y
            a, b, c = (corners[part, k] for k in range(3))
            cross = lambda p, q: (q[:, :1] - p[:, :1]) * (py + 0.5 - p[:, 1:2]) - (q[:, 1:2] - p[:, 1:2]) * (px + 0.5 - p[:, :1])
            area = cross_of(a, b, c)[:, None]
            with numpy.errstate(divide="ignore", invalid="ignore"):
                share = numpy.stack([cross(b, c), cross(c, a), cross(a, b)], axis=2) / area[:, :, None]
            inside = (share >= 0).all(axis=2) & (px >= 0) & (px < width) & (py >= 0) & (py < height)
            which, pixel = numpy.nonzero(inside)
            if not len(which):
                continue
            share = share[which, pixel]
            place = (py * width + px)[which, pixel]
            depth = (share * corners[part][which, :, 2]).sum(axis=1)
            order = numpy.lexsort((depth, place))
            place, first = numpy.unique(place[order], return_index=True)
            chosen = order[first]
            better = depth[chosen] < nearest[place]
            place, chosen = place[better], chosen[better]
            nearest[place], triangle[place], weights[place] = depth[chosen], part[which[chosen]], share[chosen]
    return triangle, weights, nearest


def cross_of(a, b, c):
    return (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])


def draw(camera, points, polygons, colours, lines=0.0):
    """A picture of polygons (n×3 or n×4) in their colours (n×3), lit from the camera's side; lines: how dark edges are."""
    width, height = FINER * WIDTH, FINER * HEIGHT
    picture = numpy.ones((width * height, 3))
    if len(polygons):
        triangles = [(0, 1, 2)] if polygons.shape[1] == 3 else QUAD_TRIANGLES
        corners = numpy.concatenate([polygons[:, list(t)] for t in triangles])
        owner = numpy.tile(numpy.arange(len(polygons)), len(triangles))
        second = numpy.repeat(numpy.arange(len(triangles)), len(polygons))
        seen = camera.see(points)[corners]
        triangle, weights, _ = rasterise(seen)
        hit = triangle >= 0
        found = triangle[hit]
        a, b, c = (points[corners[found, k]] for k in range(3))
        normal = numpy.cross(b - a, c - a)
        normal /= numpy.maximum(numpy.linalg.norm(normal, axis=1), 1e-300)[:, None]
        light = camera.towards + 0.5 * camera.up - 0.4 * camera.side
        shade = 0.35 + 0.65 * numpy.abs(normal @ (light / numpy.linalg.norm(light)))
        colour = colours[owner[found]] * shade[:, None]
        if lines:
            # Distance to each edge in pixels; a quadrilateral's diagonal is none.
            p = seen[found, :, :2]
            area = numpy.abs(cross_of(p[:, 0], p[:, 1], p[:, 2]))
            away = numpy.full(len(found), numpy.inf)
            for k in range(3):
                opposite = numpy.linalg.norm(p[:, (k + 2) % 3] - p[:, (k + 1) % 3], axis=1)
                distance = weights[hit][:, k] * area / numpy.maximum(opposite, 1e-9)
                if polygons.shape[1] == 4:
                    distance = numpy.where(k == numpy.where(second[found] == 0, 1, 2), numpy.inf, distance)
                away = numpy.minimum(away, distance)
            colour *= (1 - lines * numpy.clip(1.2 - away, 0, 1))[:, None]
        picture[hit] = colour
    return picture.reshape(HEIGHT, FINER, WIDTH, FINER, 3).mean(axis=(1, 3))


def quality_colours(scaled):
    """Scaled Jacobians as colours: 0 red, 0.5 yellow, 1 blue-green."""
    stops = numpy.array([[0.80, 0.05, 0.10], [0.98, 0.55, 0.20], [0.99, 0.90, 0.55], [0.45, 0.78, 0.72], [0.20, 0.55, 0.70]])
    return numpy.stack([numpy.interp(scaled, numpy.linspace(0, 1, len(stops)), stops[:, k]) for k in range(3)], axis=1)


def outer_faces(cells):
    """Faces that only one of the cells has, and that cell of each."""
    faces = cells[:, HEX_FACES].reshape(-1, 4)
    owner = numpy.repeat(numpy.arange(len(cells)), 6)
    ordered = numpy.sort(faces, axis=1)
    _, first, count = numpy.unique(ordered, axis=0, return_index=True, return_counts=True)
    single = first[count == 1]
    return faces[single], owner[single]


def draw_row(folder, path):
    """Four pictures side by side: surface, polycube, polygrid cut open, worst cells; blank where a stage made nothing."""
    at = lambda name: os.path.join(folder, name)
    pictures = [numpy.full((HEIGHT, WIDTH, 3), 0.94) for _ in range(4)]
    points, faces = read_ply(at("surface.ply"))
    camera = Camera(points)
    plain = lambda polygons, colour: numpy.tile(numpy.array(colour), (len(polygons), 1))
    pictures[0] = draw(camera, points, faces, plain(faces, (0.86, 0.84, 0.80)))
    if os.path.exists(at("polycube.view.ply")):
        corners, blocks = read_ply(at("polycube.view.ply"))
        pictures[1] = draw(camera, corners, blocks, plain(blocks, (0.62, 0.74, 0.88)))
    if os.path.exists(at("polygrid.hdf")):
        with h5py.File(at("polygrid.hdf")) as file:
            points = file["VTKHDF/Points"][:]
            cells = file["VTKHDF/Connectivity"][:].reshape(-1, 8)
        scaled = grid_check.scaled_jacobians(points, cells)
        middle = points[cells].mean(axis=1)[:, camera.axis]
        kept = numpy.flatnonzero(middle < numpy.median(middle))
        quads, owner = outer_faces(cells[kept])
        pictures[2] = draw(camera, points, quads, quality_colours(scaled[kept][owner]), lines=0.45)
        # The twenty worst stand before a pale object.
        quads, _ = outer_faces(cells)
        pale = 0.75 + 0.25 * draw(camera, points, quads, plain(quads, (0.8, 0.8, 0.8)))
        worst = numpy.argsort(scaled, kind="stable")[:20]
        centres = camera.see(points[cells[worst]].mean(axis=1)) / FINER
        y, x = numpy.mgrid[0:HEIGHT, 0:WIDTH] + 0.5
        for (right, down, _), colour in list(zip(centres, quality_colours(scaled[worst])))[::-1]:
            away = numpy.hypot(x - right, y - down)
            spot = numpy.clip(4.5 - away, 0, 1)[..., None]
            ring = (numpy.clip(5.5 - away, 0, 1) - numpy.clip(4.5 - away, 0, 1))[..., None]
            pale = pale * (1 - spot - ring) + spot * colour + ring * 0.15
        pictures[3] = pale
    write_png(path, numpy.concatenate(pictures, axis=1))


def write_png(path, picture):
    pixels = (numpy.clip(picture, 0, 1) * 255 + 0.5).astype(numpy.uint8)
    rows = numpy.concatenate([numpy.zeros((len(pixels), 1), numpy.uint8), pixels.reshape(len(pixels), -1)], axis=1)
    chunk = lambda kind, data: struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    with open(path, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", pixels.shape[1], pixels.shape[0], 8, 2, 0, 0, 0)) +
                   chunk(b"IDAT", zlib.compress(rows.tobytes(), 6)) + chunk(b"IEND", b""))


def gather(rows, sheet):
    """One sheet of labelled rows, by gnuplot; rows: name, verdict and picture of each mesh."""
    quoted = lambda text: '"' + text.replace("\\", "\\\\").replace('"', "'") + '"'
    width, step = 4 * WIDTH, HEIGHT + LABEL
    commands = ["set terminal pngcairo size %d,%d font 'Sans,11'" % (width, step * len(rows)), "set output " + quoted(sheet),
                "set lmargin 0; set rmargin 0; set tmargin 0; set bmargin 0; unset border; unset tics; unset key",
                "set xrange [0:%d]; set yrange [0:%d]" % (width, step * len(rows))]
    pictures = []
    for k, (name, verdict, path) in enumerate(rows):
        top = step * (len(rows) - k)
        for column, text in enumerate(["%s: %s" % (name, verdict), "", "cut open; scaled Jacobian: red 0, blue 1",
                                       "the twenty worst cells"]):
            if text:
                commands.append("set label %s at %d,%d noenhanced" % (quoted(text), column * WIDTH + 6, top - LABEL // 2))
        pictures.append("%s binary filetype=png origin=(0.5,%g) with rgbimage" % (quoted(path), top - step + 0.5))
    commands.append("plot " + ", ".join(pictures))
    subprocess.run(["gnuplot"], input="\n".join(commands), text=True, check=True)


def tile(pictures, sheet, columns, width, height):
    """PNG files of one size in pixels, row by row, by gnuplot."""
    rows = -(-len(pictures) // columns)
    placed = ['"%s" binary filetype=png origin=(%g,%g) with rgbimage'
              % (path, k % columns * width + 0.5, (rows - 1 - k // columns) * height + 0.5) for k, path in enumerate(pictures)]
    commands = ["set terminal pngcairo size %d,%d" % (columns * width, rows * height), 'set output "%s"' % sheet,
                "set lmargin 0; set rmargin 0; set tmargin 0; set bmargin 0; unset border; unset tics; unset key",
                "set xrange [0:%d]; set yrange [0:%d]" % (columns * width, rows * height), "plot " + ", ".join(placed)]
    subprocess.run(["gnuplot"], input="\n".join(commands), text=True, check=True)


if __name__ == "__main__":
    if len(sys.argv) == 3:
        draw_row(*sys.argv[1:])
    else:
        gather([sys.argv[k:k + 3] for k in range(2, len(sys.argv), 3)], sys.argv[1])
