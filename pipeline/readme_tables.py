#!/usr/bin/python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Writes the README's tables between their marks: stages and options from `sg-* --help-json`, scene keys from
`sg-plan --scene-keys`. With --check only says whether the README is current.

    readme_tables.py README.md [--check]        executables in SG_BIN, or build/bin
"""
import glob
import json
import os
import subprocess
import sys

BIN = os.environ.get("SG_BIN", "build/bin")
# In the order in which a scene needs them; others follow by name.
ORDER = ["prepare", "distance", "sample", "textons", "synthesize", "shell", "irradiance", "tetrahedralize", "polycube",
         "polygrid", "diffuse", "render", "compare", "describe", "plan", "report"]
COMMON = {"--quiet", "--verbose", "--threads", "--seed", "--progress"}


def programs():
    names = [os.path.basename(path)[3:] for path in glob.glob(os.path.join(BIN, "sg-*"))]
    names.sort(key=lambda name: (ORDER.index(name) if name in ORDER else len(ORDER), name))
    return [json.loads(output(name, "--help-json")) for name in names]


def output(name, *arguments):
    return subprocess.run([os.path.join(BIN, "sg-" + name), *arguments], check=True, capture_output=True, text=True).stdout


def cell(text):
    return str(text).replace("|", "\\|").replace("\n", " ")


def number(value):
    text = "%.6g" % value
    if "e" in text:
        mantissa, exponent = text.split("e")
        text = "%se%d" % (mantissa, int(exponent))
    return text


def sentence(text):
    """A summary as a table shows it: no capital, no full stop."""
    text = text.rstrip(".")
    return text if text[1:2].isupper() else text[:1].lower() + text[1:]


def default(option):
    value = option.get("default")
    if value is None:
        return ""
    if isinstance(value, list):
        return "`%s`" % ",".join(number(x) for x in value)
    return "`%s`" % (value if isinstance(value, str) else number(value))


def values(option):
    if "choices" in option:
        return ", ".join(option["choices"])
    least, most = option.get("least"), option.get("most")
    if least is not None and most is not None:
        return "%s … %s" % (number(least), number(most))
    if least is not None:
        return "≥ " + number(least)
    return "≤ " + number(most) if most is not None else ""


def option_row(option):
    return "| `%s` | %s | %s | %s | %s |" % (", ".join(option["flags"]), cell(option.get("unit", "")), default(option),
                                              cell(values(option)), cell(option["help"]))


HEAD = "| option | unit | default | values | meaning |\n|---|---|---|---|---|"


def stages_table():
    rows = ["| program | reads | writes | what it does |", "|---|---|---|---|"]
    for program in programs():
        reads = "; ".join("%s: %s%s" % (i["name"], i["help"], " (optional)" if i["optional"] else "") for i in program["inputs"])
        out = program.get("output")
        rows.append("| `%s` | %s | %s | %s |" % (program["name"], cell(reads), cell(out["help"]) if out else "standard output",
                                                  cell(sentence(program["summary"]))))
    return "\n".join(rows)


def options_tables():
    parts, common = [], {}
    for program in programs():
        own = [o for o in program["options"] if o["flags"][-1] not in COMMON]
        common.update({o["flags"][-1]: o for o in program["options"] if o["flags"][-1] in COMMON})
        usage = "**`%s`**" % program["usage"]
        parts.append(usage + ("\n\n" + HEAD + "\n" + "\n".join(map(option_row, own)) if own else ""))
    every = "**Every program**, beside `-o`, `--help`, `--help-json` and `--version`\n\n" + HEAD + "\n" + "\n".join(
        option_row(o) for o in common.values())
    return "\n\n".join([every] + parts)


TABLES = {"stage-options": lambda: stages_table() + "\n\n" + options_tables(),
          "scene-keys": lambda: output("plan", "--scene-keys").strip()}


def renewed(text):
    for name, make in TABLES.items():
        start, end = "<!-- %s:begin -->" % name, "<!-- %s:end -->" % name
        if start not in text or end not in text:
            raise SystemExit("the README has no marks %s … %s" % (start, end))
        head, rest = text.split(start, 1)
        text = head + start + "\n" + make() + "\n" + end + rest.split(end, 1)[1]
    return text


def main():
    path = sys.argv[1]
    with open(path) as file:
        present = file.read()
    wanted = renewed(present)
    if "--check" in sys.argv:
        if wanted != present:
            raise SystemExit(path + ": its tables differ from the programs' help; run `make docs`")
    elif wanted != present:
        with open(path, "w") as file:
            file.write(wanted)


if __name__ == "__main__":
    main()
