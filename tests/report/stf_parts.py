# SPDX-License-Identifier: AGPL-3.0-or-later
"""The parts of the report on shell texture functions: each makes its scenes and pictures and returns what is to be told.

A part is a scene, a list of variants (flags of its stages), for most the picture by light paths, and figures of each.
"""
import math
import os
import shutil

import numpy

import contact_sheet
import stf_scenes as scenes
from exr_file import read_exr
from stf_study import colours, difference, encode, save
import programs


class Part:
    """What a part tells: a table, pictures with captions, and what was expected of its figures."""

    def __init__(self, name, title, text, columns):
        self.name, self.title, self.text, self.columns = name, title, text, columns
        self.rows, self.figures, self.expectations, self.values = [], [], [], {}

    def row(self, *cells):
        self.rows.append(list(cells))

    def figure(self, path, caption):
        self.figures.append((os.path.basename(path), caption))

    def expect(self, what, true):
        self.expectations.append((what, bool(true)))


class Sizes:
    """How large pictures are, how many light paths are followed, and of what."""

    def __init__(self, options):
        self.width, self.height = options.width, round(options.width * 2 / 3)
        self.factor, self.size, self.bunny, self.layers = options.paths, options.size, options.bunny, options.layers

    def paths(self, a_pixel):
        return max(2, round(a_pixel * self.factor))

    def camera(self, position, fov):
        """One that sees the object as large whatever the factor on its size."""
        return scenes.camera([self.size * x for x in position], fov, self.width, self.height)


def percent(x):
    return "%.3g %%" % (100 * x)


def error_cells(found):
    return ["%.2f ± %.2f %%" % (100 * found["error"], 100 * found["uncertainty"]), "%+.1f %%" % (100 * found["bias"]),
            percent(found["noise"])]


def exposure_of(seen, inside):
    """The radiance shown white: what one pixel of the object in a hundred exceeds."""
    return max(float(numpy.percentile(seen[inside].max(axis=1), 99)), 1e-12)


def sheet(study, part, name, pictures, exposure, caption):
    path = os.path.join(study.output, name + ".png")
    save(path, *(encode(p, exposure) for p in pictures))
    part.figure(path, caption)


def lights_apart(study, sizes):
    """[STF, figure 8]"""
    part = Part("parts", "Light from outside, light out of the core", "What the picture is made of: the light that came "
                "from outside and was scattered in the shell, and the light that the core gives back through the shell "
                "[STF, figure 8]. Without mirror light the two add up to the whole.",
                ["light", "share of all", "sg-render, processor s"])
    mesh = study.at("torus.off")
    programs.write_off(mesh, scenes.torus())
    sample = study.write("parts", "sample.json", scenes.description("spots", size=[48, 48], count=22))
    scene = study.make("parts", scenes.scene(mesh, 50 * sizes.size, sample, 2.4, 0.4, sizes.camera((30, 60, 150), 20),
                                             [scenes.STUDIO], 1.5), "core.ply")
    found = {light: scene.picture(light, "--light", light, "--contrast", 0) for light in ("core", "outside", "all")}
    inside = found["all"][0]["A"] >= 1
    scattered = lambda light: numpy.stack([found[light][0]["exitance." + c] for c in "RGB"], 2)[inside].astype(float)
    whole = scattered("all")
    for light, (picture, told) in found.items():
        part.row({"core": "out of the core", "outside": "from outside", "all": "both"}[light],
                 percent(scattered(light).sum() / whole.sum()), "%.1f" % told["processor"])
    rest = scattered("core") + scattered("outside") - whole
    off = numpy.sqrt((rest**2).mean() / (whole**2).mean())
    part.expect("the two parts are the whole: they differ by %s" % percent(off), off < 0.01)
    sheet(study, part, "parts", [colours(found[light][0]) for light in ("core", "outside", "all")],
          exposure_of(colours(found["all"][0]), inside), "Out of the core, from outside, both.")
    return part


def shell_layers(study, sizes):
    """[STF, figure 13]"""
    counts = sizes.layers
    part = Part("layers", "Thickness of the shell", "A cube of wax with blocks of four colours at different depths, by shell "
                "texture functions of fewer and fewer layers of the same voxels, by the paper's dipole under a single one, "
                "and by light paths through all sixteen layers and the core [STF, figure 13]. Faces: pixels that show a face "
                "4 mm and farther from an edge.",
                ["layers", "error", "of all light", "noise", "error on faces", "sg-core + sg-render, processor s"])
    mesh = study.at("cube.off")
    programs.write_off(mesh, programs.box((1, 1, 1)))
    os.makedirs(study.at("layers"), exist_ok=True)
    volume = study.at("layers", "blocks.nrrd")
    scenes.blocks_volume(volume)
    sample = study.write("layers", "sample.json", scenes.blocks_sample(volume))
    voxel, ior = 0.25, 1.3
    scene = study.make("layers", scenes.scene(mesh, 24 * sizes.size, sample, 16 * voxel, voxel,
                                              sizes.camera((60, 70, 100), 18), [scenes.SKY], ior),
                       "synthesized.ply", "distance.vdb", "sample.vdb")
    scene.surface = scenes.lay_on_faces(scene.made("synthesized.ply"), scene.at("laid.ply"), voxel, 24)
    own = lambda kind, layers: scene.at("%s.%d.vdb" % (kind, layers))
    for layers in [16, *counts, 1]:
        study.stage("sample", own("sample", layers), sample, "--voxel", voxel, "--thickness", layers * voxel, "--ior", ior,
                    beside=[volume])
        study.stage("shell", own("shell", layers), scene.surface, scene.made("distance.vdb"), own("sample", layers),
                    "--thickness", layers * voxel)
    truth = scene.truth(sizes.paths(128), shell=own("shell", 16))
    errors, shown = [], [truth.mean]
    for name, layers, flags in [(str(n), n, []) for n in counts] + [("dipole", 1, ["--dipole", "paper", "--bounces", 0, "--flat"])]:
        shell, texture = own("shell", layers), own("stf", layers)
        study.stage("irradiance", texture, own("sample", layers), "--target-error", 0.03)
        core, core_told = scene.core(name, *flags, shell=shell, texture=texture)
        picture, told = scene.picture(name, *[flag for flag in flags if flag == "--flat"], core=core, shell=shell, texture=texture)
        found, faces = truth.judge(picture), truth.judge(picture, faces_of(picture, scene.content, 12 * sizes.size, min(4, 8 * sizes.size)))
        part.row(name, *error_cells(found), error_cells(faces)[0], "%.1f" % (core_told["processor"] + told["processor"]))
        errors.append((found["error"], found["uncertainty"]))
        shown.append(colours(picture))
    part.values["errors"] = [error for error, _ in errors]
    falls = all(more[0] < less[0] + more[1] for more, less in zip(errors, errors[1:]))
    part.expect("fewer layers err more, the dipole most", falls)
    sheet(study, part, "layers", shown, 1.25 * exposure_of(shown[1], truth.inside), "By light paths; %s layers; the dipole." % ", ".join(map(str, counts)))
    path = os.path.join(study.output, "layers-difference.png")
    save(path, *(difference(smoothed(p, 1), smoothed(truth.mean, 1), truth.mean[truth.inside].mean()) for p in shown[1:]))
    part.figure(path, "Brighter (red) and darker (blue) than by light paths, full colour at its mean.")
    return part


def faces_of(picture, content, half, margin):
    """Pixels whose point lies on a face of a cube of edge 2·half, farther than `margin` from its edges."""
    view = content["camera"]
    eye, to, up = (numpy.array(view[key], float) for key in ("position", "look_at", "up"))
    forward = (to - eye) / numpy.linalg.norm(to - eye)
    right = numpy.cross(forward, up)
    right /= numpy.linalg.norm(right)
    above = numpy.cross(right, forward)
    width, height = view["resolution"]
    scale = numpy.tan(numpy.radians(view["fov"]) / 2)
    y, x = numpy.mgrid[0:height, 0:width]
    rays = (forward + ((2 * (x + 0.5) / width - 1) * scale * width / height)[..., None] * right
            + ((1 - 2 * (y + 0.5) / height) * scale)[..., None] * above)
    rays /= numpy.linalg.norm(rays, axis=2, keepdims=True)
    near = numpy.full((height, width), -numpy.inf)
    far = numpy.full((height, width), numpy.inf)
    for axis in range(3):
        one, other = (-half - eye[axis]) / rays[..., axis], (half - eye[axis]) / rays[..., axis]
        near, far = numpy.maximum(near, numpy.minimum(one, other)), numpy.minimum(far, numpy.maximum(one, other))
    points = numpy.abs(eye + numpy.where(near < far, near, 0)[..., None] * rays)
    inner = numpy.sort(points, axis=2)
    return (near < far) & (inner[..., 1] < half - margin)


def shadow_border(study, sizes):
    """[STF, figure 12]"""
    part = Part("shadow", "Borders of shadows", "The border of a shadow that an arm throws on a spotted plate in the sun, seen "
                "from above, as sg-core and sg-render correct for uneven light, by eight kernels, by one, or not at all, "
                "beside light paths from the sun [STF, figure 12]. Bands: pixels in the sun and in the shadow within 4 mm of "
                "the border. Light paths tell exitance into all directions, the pictures π times the radiance upwards, "
                "which in matter that absorbs is a little less.",
                ["--correction", "error", "of all light", "noise", "in the sun", "in the shadow", "sg-core + sg-render, processor s"])
    mesh = study.at("overhang.off")
    programs.write_off(mesh, scenes.overhang())
    sample = study.write("shadow", "sample.json", scenes.shaded_sample())
    half, height = 8, 200  # of what is seen, and from where, mm
    border = 14  # along z: the arm's upper edge lies 32 mm above the plate's top, at -2
    view = scenes.camera((0, height, border), 2 * math.degrees(math.atan(half / (height + 8))), sizes.width, sizes.height, (0, 0, border))
    view["up"] = [0, 0, -1]
    sun = {"type": "directional", "direction": [0, -1, 0.5], "irradiance": [3, 3, 3]}
    scene = study.make("shadow", scenes.scene(mesh, 60, sample, 4, 0.5, view, [sun], 1.4), "shell.vdb", "stf.vdb")
    truth = scene.true_exitance(4e6 * sizes.factor)
    rows = border + half * (2 * (numpy.arange(sizes.height) + 0.5) / sizes.height - 1)
    band = lambda side: (side * (rows - border) > 0)[:, None] & (abs(rows - border) < 4)[:, None] & truth.inside
    errors, shown = {}, [truth.mean]
    for how in ("none", "one", "kernels"):
        core, core_told = scene.core(how, "--correction", how, "--no-interreflection")
        picture, told = scene.picture(how, "--correction", how, core=core)
        found, lit, dark = truth.judge(picture), truth.judge(picture, band(1)), truth.judge(picture, band(-1))
        errors[how] = found, lit, dark
        part.row(how, *error_cells(found), error_cells(lit)[0], error_cells(dark)[0],
                 "%.1f" % (core_told["processor"] + told["processor"]))
        shown.append(colours(picture, "exitance."))
    part.values["errors"] = {how: [band["error"] for band in found] for how, found in errors.items()}
    share = lambda band: errors["kernels"][band]["error"] / errors["none"][band]["error"]
    part.expect("kernels leave %.2f of the error, %.2f in the sun and %.2f in the shadow, at most 0.75, 0.7 and 0.3" %
                (share(0), share(1), share(2)), share(0) < 0.75 and share(1) < 0.7 and share(2) < 0.3)
    part.expect("eight kernels err no more than one", errors["kernels"][0]["error"] <
                errors["one"][0]["error"] + errors["one"][0]["uncertainty"])
    sheet(study, part, "shadow", shown, exposure_of(truth.mean, truth.inside),
          "Exitance: by light paths; no correction; one kernel; eight kernels.")
    return part


def against_paths(study, sizes):
    """[STF, figure 11]"""
    part = Part("reference", "Time and error against light paths", "The same picture by the shell texture function and by "
                "sg-reference, three times as large as the others. Seconds of all processors together; those of the shell "
                "texture function are what a new light and view take, sg-core and sg-render with reading and writing; "
                "sg-irradiance is done once a sample, geometry and synthesis once an object. What sg-reference "
                "takes to come to the same error follows from its shorter run by its 1/√n law [STF, figure 11].",
                ["way", "error", "of all light", "noise of the truth", "processor s"])
    mesh = study.at("torus.off")
    programs.write_off(mesh, scenes.torus())
    sample = study.write("reference", "sample.json", scenes.description("marble", size=[64, 64], voxel=0.5))
    width, height = 3 * sizes.width, 3 * sizes.height
    content = scenes.scene(mesh, 80 * sizes.size, sample, 4, 0.5, scenes.camera([sizes.size * x for x in (48, 96, 240)], 20, width, height),
                           [scenes.STUDIO], 1.5)
    scene = study.make("reference", content, "shell.vdb", "stf.vdb")
    many, few = sizes.paths(32), sizes.paths(4)
    truth = scene.truth(many)
    grid = study.make("polygrid", {**content, "method": {**content["method"], "core": "polygrid", "nodes": 1e5}}, "fluence.hdf")
    diffusion = study.record(grid.made("fluence.hdf"))["seconds"]
    found, seconds = {}, {}
    for way, core_flags, flags, more in (("shell texture function", [], [], 0),
                                         ("uneven light not corrected", ["--correction", "none"], ["--correction", "none"], 0),
                                         ("shell and core taken as flat", ["--flat"], ["--flat"], 0),
                                         ("flat, its core as the paper has it", ["--dipole", "paper", "--bounces", 0, "--flat"], ["--flat"], 0),
                                         ("its core by a polygrid's diffusion", ["--fluence", grid.made("fluence.hdf")], [], diffusion)):
        name = way.split()[-1] + "".join(str(flag).strip("-") for flag in core_flags[:2] if not os.path.isabs(str(flag)))
        core, core_told = scene.core(name, *core_flags)
        seen, told = scene.picture(name, *flags, core=core)
        picture = picture if found else seen
        found[way], seconds[way] = truth.judge(seen), core_told["processor"] + told["processor"] + more
        part.row(way, *error_cells(found[way]), "%.2f" % seconds[way])
    short = scene.at("short.exr")
    short_told = study.stage("reference", short, study.at("reference", "truth.json"), scene.made("synthesized.ply"),
                             scene.made("shell.vdb"), "--paths", few * width * height, "--seed", 3)
    noisy = truth.judge(read_exr(short))
    part.row("sg-reference, %g paths a pixel" % few, *error_cells(noisy), "%.1f" % short_told["processor"])
    part.row("sg-reference, %g paths a pixel: the truth" % many, percent(truth.noise()), "", "", "%.1f" % truth.processor)
    law = noisy["error"] / truth.noise() / math.sqrt(many / few)
    times = {}
    for way in list(found)[:2]:
        needed = short_told["processor"] * (noisy["error"] / found[way]["error"]) ** 2
        times[way] = needed / seconds[way]
        part.row("sg-reference to the error of: " + way, percent(found[way]["error"]), "", "", "%.0f: %.0f times as long" % (needed, times[way]))
    traced = study.record(scene.made("stf.vdb"))["seconds"]
    part.row("once a sample: sg-irradiance, by the clock", "", "", "", "%.1f" % traced)
    part.values.update(error={way: f["error"] for way, f in found.items()}, times=times)
    part.expect("light paths' error falls with the root of their number, within a quarter: by %.2f times that" % law, 0.8 < law < 1.25)
    part.expect("at equal error the shell texture function takes at most a fortieth of the time: 1/%.0f, and corrected 1/%.0f"
                % (times["uneven light not corrected"], times["shell texture function"]),
                min(times.values()) >= 40)
    bent, flat = (found[way]["error"] for way in ("shell texture function", "shell and core taken as flat"))
    part.expect("bent shells err less than flat ones: %s, %s" % (percent(bent), percent(flat)), bent < flat)
    worst = max(f["error"] for f in found.values())
    part.expect("their errors are at most %s, below 15 %%" % percent(worst), worst < 0.15)
    path = os.path.join(study.output, "reference.png")
    exposure = exposure_of(colours(picture), truth.inside)
    calm = lambda seen: smoothed(seen, 3)  # of the noise, for the eye
    save(path, encode(colours(picture), exposure), encode(truth.mean, exposure),
         difference(calm(colours(picture)), calm(truth.mean), truth.mean[truth.inside].mean()))
    part.figure(path, "Shell texture function; light paths; their difference, full colour at the mean radiance.")
    return part


def smoothed(picture, around):
    """The mean over 2 · around + 1 pixels both ways."""
    for axis in (0, 1):
        picture = sum(numpy.roll(picture, shift, axis) for shift in range(-around, around + 1)) / (2 * around + 1)
    return picture


def gallery(study, sizes):
    """[STF, figures 9, 14, 15 and 16]"""
    part = Part("gallery", "Gallery", "Pictures of the paper's kinds [STF, figures 9, 14 to 16]: jade, bumps that overhang, "
                "marble from two sides, wax with balls from a classified tomogram, a strawberry.",
                ["picture", "vertices", "sample", "sg-irradiance, s", "geometry and synthesis, s", "sg-core, s", "sg-render, s"])
    shown = []
    for name, content, views in scenes.gallery(study, sizes):
        scene = study.make("gallery-" + name, content, "core.ply")
        seconds = lambda file: study.record(scene.made(file))["seconds"]
        size = study.record(scene.made("stf.vdb"))["size"]
        once = sum(seconds(file) for file in ("surface.ply", "distance.vdb", "sample.vdb", "textons.vdb", "synthesized.ply", "shell.vdb"))
        for view, camera in views:
            path = study.write("gallery-" + name, view + ".json", {**{k: content[k] for k in content if k in ("object", "lights", "floor", "method")},
                                                                   "camera": camera})
            out = scene.at(view + ".exr")
            told = study.stage("render", out, path, scene.made("synthesized.ply"), "--stf", scene.made("stf.vdb"), "--shell",
                               scene.made("shell.vdb"), "--core", scene.made("core.ply"))
            shown.append(out[:-4] + ".png")
            shutil.copy(shown[-1], study.output)
            part.row(view, study.record(scene.made("synthesized.ply"))["vertices"], "%d×%d×%d" % tuple(size),
                     "%.1f" % seconds("stf.vdb"), "%.1f" % once, "%.2f" % seconds("core.ply"), "%.2f" % told["seconds"])
            picture = read_exr(out)
            part.expect("%s: every pixel finite, the object seen" % view,
                        numpy.isfinite(colours(picture)).all() and (picture["A"] >= 1).mean() > 0.05)
    path = os.path.join(study.output, "gallery.png")
    contact_sheet.tile(shown, path, 3, 2 * sizes.width, 2 * sizes.height)
    part.figure(path, "; ".join(row[0].replace("-", " ") for row in part.rows) + ".")
    return part


PARTS = {"parts": lights_apart, "layers": shell_layers, "shadow": shadow_border, "reference": against_paths, "gallery": gallery}
