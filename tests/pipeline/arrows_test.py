# SPDX-License-Identifier: AGPL-3.0-or-later
"""The rooms' arrows: pipeline → {solvers, synthesis} → meshing; inside meshing core is the ground, formats the roof."""
import os
import re
import unittest

from programs import SOURCE

ROOMS = ("meshing", "synthesis", "solvers", "pipeline")
INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"', re.MULTILINE)
SYSTEM = re.compile(r"^\s*#\s*include\s+<([^>]+)>", re.MULTILINE)
# Libraries that one place only may use.
HOMES = {"CLI/": r"^pipeline/cli/stage_program\.cpp$", "openvdb/": r"^meshing/formats/",
         "nlohmann/": r"^(pipeline|meshing/formats|synthesis)/", "hdf5": r"^meshing/formats/", "ImfI": r"^meshing/formats/",
         "CGAL/": r"_cgal\.(cpp|h)$"}


def may_include(source, target):
    """Why the arrow from one file to another is forbidden, or None."""
    a, b = source.split("/"), target.split("/")
    if b[0] not in ROOMS:
        return "includes start at the repository root, in one of the rooms"
    allowed = {"meshing": {"meshing"}, "synthesis": {"meshing", "synthesis"}, "solvers": {"meshing", "solvers"},
               "pipeline": set(ROOMS)}
    if b[0] not in allowed[a[0]]:
        return "%s must not know %s" % (a[0], b[0])
    if a[0] == b[0] == "meshing":
        if a[1] == "core" and b[1] != "core":
            return "meshing/core is the ground"
        if b[1] == "formats" and a[1] != "formats":
            return "algorithms never touch files"
    if a[0] == "pipeline" and b[:2] == ["pipeline", "stages"]:
        return "a stage is a program, not a library"
    if a[:2] == ["pipeline", "cli"] and b[:2] == ["pipeline", "scene"]:
        return "pipeline/cli serves pipeline/scene"
    return None


NAMESPACE = re.compile(r"^(?:inline )?namespace ?([\w:]*) ?\{")
DEFINITION = re.compile(r"^(?:struct|class|enum(?: class)?) (\w+)(?![\w:])[^;]*\{|^inline (?!constexpr |namespace ).*?(\w+)\(")


def shared_definitions(text):
    """Namespace and name of each type and inline function that more than one file may see."""
    namespaces = []
    for line in text.splitlines():
        opened = NAMESPACE.match(line)
        if opened:
            namespaces.append(opened.group(1))
        elif line.startswith("}  // namespace"):
            namespaces.pop()
        elif "" not in namespaces:
            found = DEFINITION.match(line)
            if found:
                yield "::".join(namespaces + [found.group(1) or found.group(2)])


def sources(rooms=ROOMS):
    for room in rooms:
        for folder, _, names in os.walk(os.path.join(SOURCE, room)):
            for name in names:
                if name.endswith((".h", ".cpp")):
                    yield os.path.relpath(os.path.join(folder, name), SOURCE)


class ArrowsTest(unittest.TestCase):
    def test_every_include_follows_the_arrows(self):
        count = 0
        for source in sources():
            with open(os.path.join(SOURCE, source)) as file:
                text = file.read()
            for target in INCLUDE.findall(text):
                count += 1
                fault = may_include(source, target)
                self.assertIsNone(fault, "%s includes %s: %s" % (source, target, fault))
                self.assertTrue(os.path.exists(os.path.join(SOURCE, target)), "%s includes %s" % (source, target))
            for header in SYSTEM.findall(text):
                for prefix, home in HOMES.items():
                    if header.startswith(prefix):
                        self.assertRegex(source, home, "%s includes <%s>" % (source, header))
        self.assertGreater(count, 50)

    def test_the_rule_itself_tells_right_from_wrong(self):
        for source, target in [("meshing/core/a.h", "meshing/surface/b.h"), ("meshing/surface/a.cpp", "meshing/formats/b.h"),
                               ("meshing/core/a.h", "solvers/render/b.h"), ("solvers/render/a.h", "synthesis/b.h"),
                               ("synthesis/a.h", "solvers/render/b.h"), ("solvers/render/a.h", "pipeline/cli/b.h"),
                               ("meshing/core/a.h", "b.h")]:
            self.assertIsNotNone(may_include(source, target), (source, target))
        for source, target in [("meshing/surface/a.cpp", "meshing/core/b.h"), ("meshing/formats/a.cpp", "meshing/shell/b.h"),
                               ("solvers/render/a.cpp", "meshing/core/b.h"), ("pipeline/stages/a.cpp", "synthesis/b.h")]:
            self.assertIsNone(may_include(source, target), (source, target))

    def test_no_name_is_defined_twice(self):
        """Two definitions of one name in one program: the linker takes either, which no compiler reports."""
        self.assertEqual(list(shared_definitions("namespace a {\nstruct B {\n};\nnamespace {\nclass C {\n}  // namespace\n"
                                                 "inline int d(int e) {\n}  // namespace a\ninline int f(")),
                         ["a::B", "a::d", "f"])
        homes = {}
        for source in sources(ROOMS + ("tests",)):
            # Each stage, benchmark and probe is a program of its own.
            if source.startswith(("pipeline/stages/", "tests/benchmarks/")):
                continue
            with open(os.path.join(SOURCE, source)) as file:
                for name in shared_definitions(file.read()):
                    self.assertEqual(homes.setdefault(name, source), source, name)
        self.assertGreater(len(homes), 150)

    def test_every_source_names_its_licence_first_and_stays_of_readable_length(self):
        for source in sources():
            with open(os.path.join(SOURCE, source)) as file:
                lines = file.read().splitlines()
            self.assertEqual(lines[0], "// SPDX-License-Identifier: AGPL-3.0-or-later", source)
            self.assertLess(len(lines), 800, source)


if __name__ == "__main__":
    unittest.main()
