# SPDX-License-Identifier: AGPL-3.0-or-later
"""What the sanitizers find is a finding wherever it is ours: only a library's faults in guarded children are not."""
import os
import subprocess
import unittest

import programs

PROBE = os.path.join(programs.BIN, "sanitizer_probe")
FINDINGS = os.path.join(programs.SOURCE, "tests", "sanitizers", "findings.cmake")
# A child that ends by _exit, as guarded children do, looks for no leaks.
FAULTS = ["read-past-the-end", "overflow", "read-nowhere", "allocate-too-much", "fail-an-assertion"]


@unittest.skipUnless(os.path.exists(PROBE), "built without sanitizers")
class Findings(unittest.TestCase):
    def probe(self, fault, place):
        """Reports of a run of the probe, as the exit code of findings.cmake, what it printed, and its summary."""
        with programs.workplace() as folder:
            environment = dict(os.environ)
            for name in ("ASAN_OPTIONS", "UBSAN_OPTIONS"):
                kept = [option for option in os.environ[name].split(":") if not option.startswith("log_path=")]
                environment[name] = ":".join(kept + ["log_path=%s/report" % folder])
            done = subprocess.run([PROBE, fault, place], capture_output=True, text=True, env=environment)
            self.assertNotEqual(done.returncode, 2, "the probe does not know %s %s" % (fault, place))
            read = subprocess.run(["cmake", "-D", "FINDINGS=" + folder, "-P", FINDINGS], capture_output=True, text=True)
            with open(os.path.join(folder, "summary.txt")) as file:
                return read.returncode, read.stdout + read.stderr, file.read()

    def test_a_fault_of_ours_is_a_finding(self):
        for place in ("program", "library", "guarded-child", "after-library-in-guarded-child", "after-guarded-child"):
            for fault in FAULTS:
                with self.subTest(fault=fault, place=place):
                    code, printed, summary = self.probe(fault, place)
                    self.assertNotEqual(code, 0, printed)
                    self.assertIn("sanitizer_probe.cpp", printed)
                    self.assertIn("1 findings; 0 of", summary)

    def test_a_leak_of_a_program_is_a_finding(self):
        code, printed, summary = self.probe("leak", "program")
        self.assertNotEqual(code, 0, printed)
        self.assertIn("detected memory leaks", printed)
        self.assertIn("1 findings; 0 of", summary)

    def test_a_fault_of_a_library_in_a_guarded_child_is_counted_apart(self):
        for fault in FAULTS:
            with self.subTest(fault):
                code, printed, summary = self.probe(fault, "library-in-guarded-child")
                self.assertEqual(code, 0, printed)
                self.assertIn("0 findings; 1 of", summary)
                self.assertIn("  1 × ", summary)
                self.assertNotIn("killed", summary)


if __name__ == "__main__":
    unittest.main()
