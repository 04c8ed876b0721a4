#!/usr/bin/python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Shell texture functions shown and judged: pictures, and their errors against light paths.

    stf_report.py -o OUT [--only PART…] [--width 240] [--paths 1] [--size 1] [--layers 12 8 4 2] [--bunny MESH]

Parts: parts, layers, shadow, reference, gallery. Executables in SG_BIN, or build/bin. OUT gets report.html, report.md, report.json and
the pictures. What is done is kept in OUT/work and not done again for the same programs and inputs. SG_LONG=1: larger
pictures, and eight times as many light paths. The exit code is 1 where a stage failed, or a figure is not what is expected of it.
"""
import argparse
import html
import json
import os
import signal
import sys

from stf_parts import PARTS, Sizes
from stf_study import Failed, Study

STYLE = ("body{font:14px sans-serif;margin:2em;max-width:1500px}table{border-collapse:collapse;margin:8px 0}"
         "td,th{border:1px solid #ccc;padding:2px 8px;text-align:right}td:first-child{text-align:left}"
         "img{max-width:100%;display:block;margin:8px 0 2px}figcaption{color:#444}.no{color:#b00}")


def markdown(part):
    lines = ["## " + part.title, "", part.text, "", "| %s |" % " | ".join(part.columns), "|" + "---|" * len(part.columns)]
    lines += ["| %s |" % " | ".join(map(str, row)) for row in part.rows] + [""]
    lines += ["- %s%s" % ("" if true else "**NOT:** ", what) for what, true in part.expectations] + [""]
    for name, caption in part.figures:
        lines += ["![%s](%s)" % (caption, name), "", caption, ""]
    return "\n".join(lines)


def page(part):
    cells = lambda tag, row: "<tr>%s</tr>" % "".join("<%s>%s</%s>" % (tag, html.escape(str(cell)), tag) for cell in row)
    lines = ["<h2>%s</h2><p>%s</p>" % (html.escape(part.title), html.escape(part.text)),
             "<table>%s%s</table>" % (cells("th", part.columns), "".join(cells("td", row) for row in part.rows)), "<ul>"]
    lines += ["<li%s</li>" % (">" + html.escape(what) if true else " class=no>Not so: " + html.escape(what))
              for what, true in part.expectations]
    lines.append("</ul>")
    lines += ['<figure><img src="%s" alt="%s"><figcaption>%s</figcaption></figure>' % (name, html.escape(caption), html.escape(caption))
              for name, caption in part.figures]
    return "\n".join(lines)


def write_report(output, parts):
    with open(os.path.join(output, "report.md"), "w") as file:
        file.write("# Shell texture functions\n\n" + "\n".join(map(markdown, parts)))
    with open(os.path.join(output, "report.html"), "w") as file:
        file.write("<!DOCTYPE html><html lang=en><meta charset=utf-8><title>Shell texture functions</title><style>%s</style>"
                   "<h1>Shell texture functions</h1>%s</html>\n" % (STYLE, "\n".join(map(page, parts))))
    with open(os.path.join(output, "report.json"), "w") as file:
        json.dump({part.name: {"columns": part.columns, "rows": part.rows, "expected": part.expectations, "figures": part.values}
                   for part in parts}, file, indent=1)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", required=True, help="folder of the report")
    parser.add_argument("--only", nargs="*", choices=list(PARTS), default=list(PARTS), help="parts")
    parser.add_argument("--width", type=int, default=480 if os.environ.get("SG_LONG") else 240, help="of the pictures, pixels")
    parser.add_argument("--bunny", help="its mesh; a shape made here where not given")
    parser.add_argument("--paths", type=float, default=8 if os.environ.get("SG_LONG") else 1,
                        help="factor on the number of light paths")
    parser.add_argument("--size", type=float, default=1, help="factor on the objects' size; their samples stay")
    parser.add_argument("--layers", type=int, nargs="+", default=[12, 8, 4, 2], help="of the shells compared, falling")
    parser.add_argument("--threads", type=int, default=0, help="0: all processors")
    options = parser.parse_args()
    study = Study(options.output, options.threads)
    sizes = Sizes(options)
    parts, failed = [], False
    for name in options.only:
        try:
            part = PARTS[name](study, sizes)
        except Failed as failure:
            print("%s: FAILED: %s" % (name, failure), flush=True)
            failed = True
            continue
        parts.append(part)
        print(markdown(part), flush=True)
        failed = failed or not all(true for _, true in part.expectations)
        write_report(options.output, parts)
    print(os.path.join(options.output, "report.html"))
    return 1 if failed else 0


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    sys.exit(main())
