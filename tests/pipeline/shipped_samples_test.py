# SPDX-License-Identifier: AGPL-3.0-or-later
"""Every sample of assets/samples is made and passes the checks of sg-sample --strict."""
import os
import unittest

from programs import SOURCE, run, workplace


class ShippedSamples(unittest.TestCase):
    def test_shipped_samples_pass_their_checks(self):
        with workplace() as folder:
            for name in sorted(os.listdir(os.path.join(SOURCE, "assets", "samples"))):
                if name.endswith(".json"):
                    done = run("sample", os.path.join(SOURCE, "assets", "samples", name), "-o",
                               os.path.join(folder, "sample.vdb"), "--strict")
                    self.assertEqual(done.returncode, 0, name + ": " + done.stderr)


if __name__ == "__main__":
    unittest.main()
