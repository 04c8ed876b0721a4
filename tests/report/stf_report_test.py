# SPDX-License-Identifier: AGPL-3.0-or-later
"""The report on shell texture functions in short: how it judges pictures, that it tells what is not as expected, and that
thinner shells err more."""
import contextlib
import io
import json
import os
import sys
import unittest

import numpy

sys.path.append(os.path.dirname(os.path.abspath(__file__)))
import stf_report
from exr_file import read_exr
from programs import WorkplaceTest, icosphere, run, scene, write_json, write_off
from stf_parts import Part
from stf_study import Failed, Truth, colours


def picture(values, alpha=1):
    return {**{c: values[..., k].astype(numpy.float32) for k, c in enumerate("RGB")},
            "A": numpy.full(values.shape[:2], alpha, numpy.float32)}


class Judgement(unittest.TestCase):
    def test_noise_of_the_truth_is_no_error_of_the_picture(self):
        random = numpy.random.default_rng(3)
        true = 1 + random.random((60, 80, 3))
        halves = [picture(true + 0.5 * random.standard_normal(true.shape)) for _ in range(2)]
        truth = Truth(*halves, [{"processor": 1, "paths": 10}] * 2)
        found = truth.judge(picture(1.1 * true))
        self.assertAlmostEqual(found["error"], 0.1, delta=4 * found["uncertainty"])
        self.assertLess(found["uncertainty"], 0.02)
        self.assertAlmostEqual(found["bias"], 0.1, delta=0.01)
        self.assertAlmostEqual(found["noise"], 0.5 / numpy.sqrt(2 * (true**2).mean()), delta=0.01)
        self.assertLess(truth.judge(picture(true))["error"], 0.05)

    def test_pixels_beside_the_object_do_not_count(self):
        true = numpy.ones((4, 4, 3))
        truth = Truth(picture(true), picture(true), [{"processor": 1, "paths": 10}] * 2)
        seen = picture(true)
        seen["R"][0, 0], seen["A"][0, 0] = 7, 0.5
        self.assertEqual(truth.judge(seen)["error"], 0)
        self.assertEqual(truth.judge(seen)["pixels"], 15)


class Report(WorkplaceTest):
    def report(self, *arguments, parts=None):
        """Exit code, and what report.json says."""
        given, known = sys.argv, dict(stf_report.PARTS)
        sys.argv = ["stf_report.py", "-o", self.at("out"), *map(str, arguments)]
        stf_report.PARTS.update(parts or {})
        try:
            with contextlib.redirect_stdout(io.StringIO()):
                code = stf_report.main()
        finally:
            sys.argv = given
            stf_report.PARTS.clear()
            stf_report.PARTS.update(known)
        if not os.path.exists(self.at("out", "report.json")):
            return code, None
        with open(self.at("out", "report.json")) as file:
            return code, json.load(file)

    def test_what_is_not_as_expected_and_what_fails_is_told(self):
        def unexpected(study, sizes):
            part = Part("parts", "Title", "Text <of> it.", ["a", "b"])
            part.row("x", 1)
            part.expect("it is so", False)
            return part

        def failing(study, sizes):
            raise Failed("sg-core: crash")

        code, found = self.report("--only", "parts", parts={"parts": unexpected})
        self.assertEqual(code, 1)
        self.assertEqual(found["parts"]["expected"], [["it is so", False]])
        with open(self.at("out", "report.html")) as file:
            page = file.read()
        self.assertIn("Not so: it is so", page)
        self.assertIn("Text &lt;of&gt; it.", page)
        self.assertEqual(self.report("--only", "parts", parts={"parts": failing})[0], 1)

    def test_pictures_are_read_as_the_stages_wrote_them(self):
        write_off(self.at("ball.off"), icosphere(3, 10.0))
        write_json(self.at("scene.json"), scene(material={"opaque": {"reflectance": [0.2, 0.5, 0.9]}}))
        self.ok("render", self.at("scene.json"), self.at("ball.off"), "-o", self.at("image.exr"))
        seen = read_exr(self.at("image.exr"))
        told = json.loads(run("describe", "--json", self.at("image.exr")).stdout)["channels"]
        self.assertEqual(set(seen), set(told))
        for name, channel in seen.items():
            self.assertEqual(channel.shape, (32, 48))
            self.assertAlmostEqual(float(channel.mean(dtype=float)), told[name]["mean"], delta=1e-4 * (1 + abs(told[name]["mean"])))
        self.assertGreater(colours(seen)[16, 24, 2], colours(seen)[16, 24, 0])

    def test_thinner_shells_err_more(self):
        code, found = self.report("--only", "layers", "--size", 0.5, "--width", 72, "--paths", 0.5, "--layers", 6, 2)
        layers = found["layers"]
        self.assertEqual(code, 0, layers)
        errors = layers["figures"]["errors"]
        self.assertEqual([row[0] for row in layers["rows"]], ["6", "2", "dipole"])
        self.assertGreater(errors[-2], 1.5 * errors[0])
        self.assertGreater(errors[-1], 1.6 * errors[-2])
        self.assertLess(errors[0], 0.08)
        for name in ("layers.png", "report.html", "report.md"):
            self.assertGreater(os.path.getsize(self.at("out", name)), 1000)


if __name__ == "__main__":
    unittest.main()
