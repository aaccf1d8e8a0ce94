#!/usr/bin/env python3
"""Writes what follows from the lists of the tree: Python's tables and the tables of the documents.

  lists.py [--check] [ROOT]      --check writes nothing; prints what is stale, exit code 1 when anything is
                                 Names what a row needs elsewhere and does not have, exit code 1, too

A list is a .def file: rows of a macro, which C++ includes wherever it needs them. This script reads the
same rows. Where a document says `lists: NAME`, the lines up to `lists: end` are written here.
"""
import ast
import json
import pathlib
import re
import sys
import textwrap

TOKEN = re.compile(r'"(?:[^"\\]|\\.)*"|[(),]|[^"(),]+')
MARK = re.compile(r"^(.*\blists: (?!end)(\w+).*\n)(?:.*\n)*?(.*\blists: end\b.*\n)", re.MULTILINE)
TYPES = {"u8": ("u8", 1), "u32": ("u32", 1), "u64": ("u64", 1), "f32": ("f32", 1),
         "vec2": ("f32", 2), "vec3": ("f32", 3), "point": ("f32", 3), "truth": ("u8", 1)}


class Lists:
    """The rows of every list: tuples of their arguments."""

    def __init__(self, root):
        self.root = root
        self.exits = self.rows("protocol/lists/errors.def", "EXIT")
        self.errors = self.rows("protocol/lists/errors.def", "ERROR")
        self.limits = self.rows("protocol/lists/limits.def", "LIMIT")
        self.requests = self.rows("protocol/lists/requests.def", "REQUEST")
        self.roles = self.rows("protocol/lists/roles.def", "ROLE")
        self.parts = self.rows("protocol/lists/requests.def", "PART")
        self.answers = self.rows("protocol/lists/requests.def", "ANSWER")
        self.generators = self.rows("protocol/lists/generators.def", "GENERATOR")
        # Python makes images by their row.
        self.sensors = [row for row in self.generators if "size" not in row[1].split(", ")]
        self.settings = self.rows("protocol/lists/generators.def", "SETTING")
        self.reducers = self.rows("protocol/lists/reducers.def", "REDUCER")
        self.workers = self.rows("protocol/lists/workers.def", "AUTO|WORKER")
        self.fields = self.rows("engine/queries/fields.def", "FIELD")
        self.counted = self.rows("engine/geometry/counters.def", "COUNTER")
        # A sum has its value before its title.
        self.counters = [(name, title) for name, *_, title in
                         self.rows("engine/geometry/counters.def", "COUNTER|SUM")]
        self.measures = self.rows("engine/integrators/measures.def", "MEASURE")
        self.kinds = self.rows("engine/packs/words.def", "KIND")
        self.untraced = self.rows("engine/packs/words.def", "UNTRACED")
        self.traversals = self.rows("engine/packs/words.def", "TRAVERSAL")
        self.targets = self.rows("engine/packs/targets.def", "CPU_TARGET")
        self.intersectors = self.rows("engine/intersectors/intersectors.def", "INTERSECTOR")
        self.layers = self.rows("engine/integrators/layers.def", "LAYER")
        self.integrators = self.rows("engine/integrators/integrators.def", "INTEGRATOR")
        self.numbers = self.rows("engine/integrators/integrator_settings.def", "INTEGRATOR_SETTING")
        self.tonemaps = self.rows("engine/integrators/tonemaps.def", "TONEMAP")
        self.palettes = self.rows("engine/integrators/palettes.def", "PALETTE")
        self.words = self.rows("client/ground/wording.def", "WORD")
        self.other_files = self.rows("client/requests/other_files.def", "OTHER_FILES")
        self.metrics = self.rows("server/ground/metrics.def", "METRIC|SPLIT|GAUGE")

    def rows(self, file, macro):
        text = (self.root / file).read_text(encoding="utf-8")
        text = re.sub(r"^\s*(?://|#).*$", "", text, flags=re.MULTILINE)
        rows = [arguments(text, match.end())
                for match in re.finditer(rf"\bRAYNEST_(?:{macro})\(", text)]
        if not rows:
            raise SystemExit(f"{file}: there is no row RAYNEST_{macro}(...)")
        return rows


def arguments(text, at):
    """The arguments of a macro from behind its bracket on; strings without their quotes."""
    found, depth = [""], 1
    for match in TOKEN.finditer(text, at):
        token = match.group()
        depth += {"(": 1, ")": -1}.get(token, 0)
        if depth == 0:
            return tuple(part.strip() for part in found)
        if token == "," and depth == 1:
            found.append("")
        else:
            found[-1] += ast.literal_eval(token) if token.startswith('"') else token
    raise SystemExit(f"a row does not end: {text[at:at + 60]}")


def value(text):
    """A number as C++ writes it."""
    digits = re.sub(r"U?LL\b", "", text.replace("'", ""))
    if not re.fullmatch(r"[\d <]+", digits):
        raise SystemExit(f"'{text}' is no number that this script reads")
    return eval(digits)


def table(head, rows):
    lines = [head, ["---"] * len(head), *rows]
    return [f"| {' | '.join(map(str, line))} |".replace("|  |", "| |") for line in lines]


def code(names):
    return " ".join(f"`{name}`" for name in names)


def type_text(kind):
    dtype, width = TYPES[kind]
    return dtype if width == 1 else f"{width} x {dtype}"


def column_table(lists):
    return table(("column", "type", ""),
                 [(f"`{name}`", type_text(kind), text) for name, kind, *_, text in lists.fields] +
                 [(f"`{name}`", "u32", text) for name, text in lists.counters])


def layer_table(lists):
    """Channels that share a text stand in one row."""
    rows = []
    for _, name, kind, text in lists.layers:
        if text:
            rows.append(([], kind, text))
        rows[-1][0].append(name)
    return table(("channels of the EXR", "type", ""),
                 [(code(names), kind, text) for names, kind, text in rows])


def message_table(lists):
    rows = [(int(number), name, f"-> {answer}") for number, name, *_, answer in lists.requests]
    rows += [(int(number), name, text) for number, name, _, text in lists.parts]
    answers = ", ".join(f"{name}~{number}" for number, name, _ in sorted(lists.answers, key=number_of))
    return [*table(("the client sends", "type", ""),
                   [(name, number, text) for number, name, text in sorted(rows)]), "",
            *(line.replace("~", " ") for line in textwrap.wrap(f"The daemon sends {answers}.", 120))]


def side_by_side(rows):
    """Rows of two columns as half as many rows of four: the first half beside the second."""
    half = (len(rows) + 1) // 2
    right = [*rows[half:], ("", "")][:half]
    return [left + beside for left, beside in zip(rows, right)]


def number_of(row):
    return int(row[0])


# The text between the marks of a document, by the name of the mark.
TABLES = {
    "errors": lambda lists: table(("code", "name", "exit", "what to do"), [
        (number, name, dict((n, e) for e, n, _ in lists.exits)[exit_name], remedy)
        for number, name, _, exit_name, remedy in lists.errors]),
    "exits": lambda lists: textwrap.wrap("Exit codes: " + "; ".join(
        f"{number} {text}" for number, _, text in lists.exits) + ".", 120),
    "limits": lambda lists: table(("limit", "value", "of"), [
        (f"`{name}`", value(number), text) for name, number, _, text in lists.limits]),
    "messages": message_table,
    "union": lambda lists: ["union Message {", *(
        f"  {name} = {number}," for number, name in sorted(
            (int(row[0]), row[1]) for row in lists.requests + lists.parts + lists.answers)), "}"],
    "columns": column_table,
    "layers": layer_table,
    "integrators": lambda lists: table(("integrator", "settings", ""), [
        (f"`{name}`", code(settings), text) for name, _, _, text, *settings in lists.integrators]),
    "integrator_settings": lambda lists: table(("setting", "from", "to", "0 stands for", ""), [
        (f"`{name}`", least, most, otherwise, text)
        for name, _, _, _, least, most, _, otherwise, text in lists.numbers]),
    "tonemaps": lambda lists: table(("tonemap", ""), [(f"`{name}`", text) for name, text in lists.tonemaps]),
    "kinds": lambda lists: table(("kind", "answer per ray"), [
        (f"`{name}`", text) for name, *_, text in lists.kinds + lists.untraced]),
    "traversals": lambda lists: table(("traversal", ""), [
        (f"`{word}`", text) for _, word, text in lists.traversals]),
    "targets": lambda lists: table(("target", "compiled with", "runs where the CPU has"), [
        (f"`{name}`", code(flags.split()), code(features)) for name, _, flags, *features in lists.targets]),
    "roles": lambda lists: table(("role", "may", "requests that need it"), [
        (f"`{role}`", text, code(row[1] for row in lists.requests if row[4] == role))
        for role, text in lists.roles]),
    "workers": lambda lists: table(("worker", ""), [(f"`{name}`", text) for name, text in lists.workers]),
    "reducers": lambda lists: table(("reduce", "columns", ""), [
        (f"`{name}`", columns, text) for name, _, _, columns, text in lists.reducers]),
    "generators": lambda lists: table(("kind", "settings", "t", "rays"), [
        (f"`{name}`", code(settings.split(", ")), t, rays)
        for name, settings, t, rays in lists.generators]),
    "settings": lambda lists: table(("setting", ""), [
        (f"`{name}`", text) for name, _, text in lists.settings]),
    "metrics": lambda lists: table(("name", "", "name", ""), side_by_side([
        (f"`{row[0]}`", row[-1]) for row in lists.metrics])),
    "words": lambda lists: table(("field", "words"), [
        ("`metric`", code(name for name, _ in lists.counters + lists.measures)),
        ("`palette`", code(row[0] for row in lists.palettes))]),
}


# Rows need more than themselves where no compiler misses it: the list and its file, another file, and how that says each name.
NEEDS = (
    ("counted", "engine/geometry/counters.def", "engine/intersectors/counts.h", "{}"),
    ("sensors", "protocol/lists/generators.def", "client/python/raynest/generators.py", "def {}"),
    ("reducers", "protocol/lists/reducers.def", "server/jobs/reduce_job.cpp", "{}"),
    ("tonemaps", "engine/integrators/tonemaps.def", "server/web/tonemap.js", "vec3 {}"),
    ("tonemaps", "engine/integrators/tonemaps.def", "client/python/raynest/_render.py", "{}"),
)


def missing(root, lists):
    for rows, listed, file, form in NEEDS:
        text = (root / file).read_text(encoding="utf-8")
        for name, *_ in getattr(lists, rows):
            said = form.format(name)
            if not re.search(rf"\b{said}\b", text):
                yield f"{file} has no `{said}`, which the row of {name} in {listed} needs: see server/README.md"


def python_module(lists):
    def dtypes(columns):
        return {name: TYPES[kind] for name, kind in columns}

    values = {
        "ERRORS": [(name, int(dict((n, e) for e, n, _ in lists.exits)[exit_name]))
                   for _, name, _, exit_name, _ in lists.errors],
        "OF_HITS": dtypes((row[0], row[1]) for row in lists.fields if row[2] == "hit"),
        "OF_RAYS": dtypes([(row[0], row[1]) for row in lists.fields if row[2] == "ray"] +
                          [(name, "u32") for name, _ in lists.counters]),
        "POINTS": [row[0] for row in lists.fields if row[1] == "point"],
        "TRUTHS": [row[0] for row in lists.fields if row[1] == "truth"],
        "SHOWN": {of: [row[0] for row in lists.fields if row[4] == of] for of in ("hits", "any")},
        "CSR": [name for name, hits, _ in lists.kinds if hits == "many"],
        "REDUCED": {name: dtypes(column.split() for column in columns.split(", "))
                    for name, _, _, columns, _ in lists.reducers},
        "REDUCED_KIND": {name: kind for name, kind, *_ in lists.reducers},
        "REDUCED_TO_POINTS": [row[0] for row in lists.reducers if row[2] == "points"],
        "GENERATORS": {name: settings.split(", ") for name, settings, _, _ in lists.generators},
        "ACTING": [row[1] for row in lists.requests if row[5] == "once"],
        "INTEGRATOR_SETTINGS": {row[0]: (int(row[5]) if is_whole(row) else None, setting_text(lists, row))
                                for row in lists.numbers},
        "WORDS": {**{name: (command, python) for name, command, python in lists.words},
                  **{row[0]: (row[2], row[0] + "=") for row in lists.numbers}},
        "OTHER_FILES": {ending: text for endings, text in lists.other_files for ending in endings.split()},
    }
    types = {"ERRORS": "list[tuple[str, int]]", "OF_HITS": "dict[str, tuple[str, int]]",
             "OF_RAYS": "dict[str, tuple[str, int]]", "POINTS": "list[str]", "TRUTHS": "list[str]", "CSR": "list[str]",
             "SHOWN": "dict[str, list[str]]", "REDUCED": "dict[str, dict[str, tuple[str, int]]]",
             "REDUCED_KIND": "dict[str, str]", "REDUCED_TO_POINTS": "list[str]",
             "GENERATORS": "dict[str, list[str]]", "ACTING": "list[str]",
             "INTEGRATOR_SETTINGS": "dict[str, tuple[Optional[int], str]]",
             "WORDS": "dict[str, tuple[str, str]]", "OTHER_FILES": "dict[str, str]"}
    lines = ['"""Lists that client and daemon share. Written by .ci/lists.py from the .def files of the '
             'tree."""', "from __future__ import annotations", "", "from typing import Literal, Optional, TypedDict", "",
             f"Worker = Literal[{', '.join(repr(name) for name, _ in lists.workers)}]", "", "",
             "class IntegratorSettings(TypedDict, total=False):",
             '    """Keyword arguments of pictures that an integrator makes. None and 0 mean the default."""', ""]
    lines += [f"    {row[0]}: Optional[{'int' if is_whole(row) else 'float'}]" for row in lists.numbers] + ["", ""]
    for name, listed in values.items():
        opening, closing = "{}" if isinstance(listed, dict) else "[]"
        items = listed.items() if isinstance(listed, dict) else listed
        lines += [f"{name}: {types[name]} = {opening}",
                  *(f"    {item[0]!r}: {item[1]!r}," if isinstance(listed, dict) else f"    {item!r},"
                    for item in items), closing, ""]
    return "\n".join(lines[:-1]) + "\n"


def is_whole(number):
    return number[1] != "float"


def setting_text(lists, number):
    """Describes a setting: its integrators, its text and its default."""
    names = ", ".join(row[0] for row in lists.integrators if number[0] in row[4:])
    return f"for {names}: {number[-1]} ({number[-2]})"


def page_setting(lists, number):
    """The key of a setting in the state of the page, and what the page knows of it."""
    name, _, option, label, least, most, initial, otherwise, text = number
    read = int if is_whole(number) else float
    if read(initial) == 0:
        least, number = 0, (*number[:-2], f"0: {otherwise}", text)
    said = setting_text(lists, number)
    return re.sub("_(.)", lambda match: match[1].upper(), name), {
        "field": name, "option": option, "label": label, "least": read(least), "most": read(most), "initial": read(initial),
        "whole": is_whole(number), "text": said[0].upper() + said[1:]}


def page_module(lists):
    """Returns the lists that the page of server/web shares with the daemon, as a JavaScript module."""
    messages = sorted((int(row[0]), row[1]) for row in lists.requests + lists.parts + lists.answers)
    columns = [(row[0], *TYPES[row[1]]) for row in lists.fields]
    columns += [(name, "u32", 1) for name, _ in lists.counters]
    integrators = {name: {"lit": lit == "true", "settings": settings} for name, _, lit, _, *settings in lists.integrators}
    values = {
        "INTEGRATORS": {"primary": {"lit": False, "settings": []}, **integrators},
        "SETTINGS": dict(page_setting(lists, row) for row in lists.numbers),
        "MESSAGES": {name: number for number, name in messages},
        "COLUMNS": {name: [dtype, width] for name, dtype, width in columns},
        "COUNTERS": dict(lists.counters),
        "MEASURES": dict(lists.measures),
        "PALETTES": {name: [int(colour, 16) for colour in colours]
                     for name, *colours in lists.palettes},
        "TONEMAPS": dict(lists.tonemaps),
    }
    lines = ["// The lists that client and daemon share. Written by .ci/lists.py from the .def files of the tree."]
    for name, listed in values.items():
        lines += ["", f"export const {name} = {{",
                  *(f"  {key}: {json.dumps(item)}," for key, item in listed.items()), "};"]
    return "\n".join(lines) + "\n"


def python_limits(lists):
    lines = ['"""Limits that bytes from a daemon are checked against before they cost anything. Written '
             'by', '.ci/lists.py from protocol/lists/limits.def."""']
    lines += [f"{name} = {value(number)}"
              for name, number, kind, _ in lists.limits if kind == "fixed"]
    return "\n".join(lines) + "\n"


def filled(text, lists):
    return MARK.sub(lambda match: match.group(1) + "\n".join(TABLES[match.group(2)](lists)) + "\n" +
                    match.group(3), text)


def main():
    words = sys.argv[1:]
    check = "--check" in words
    words = [word for word in words if word != "--check"]
    root = pathlib.Path(words[0] if words else pathlib.Path(__file__).parent.parent)
    lists = Lists(root)
    package = root / "client/python/raynest"
    written = {package / "_lists.py": python_module(lists), package / "_limits.py": python_limits(lists),
               root / "server/web/lists.js": page_module(lists)}
    for name in ("protocol/PROTOCOL.md", "protocol/messages.fbs", "client/python/README.md", "engine/packs/TARGETS.md"):
        written[root / name] = filled((root / name).read_text(encoding="utf-8"), lists)
    stale = [file for file, text in written.items()
             if not file.exists() or file.read_text(encoding="utf-8") != text]
    for file in stale:
        if check:
            print(f"{file.relative_to(root)} is stale: run python3 .ci/lists.py")
        else:
            file.write_text(written[file], encoding="utf-8")
    lacks = list(missing(root, lists))
    print("\n".join(lacks), end="\n" * bool(lacks))
    return 1 if lacks or check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
