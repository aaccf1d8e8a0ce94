#!/usr/bin/env python3
"""Which file may include what: the layers of the house, checked.

  check_includes.py [ROOT]      prints one line per violation, exit code 1 when there is any

A file may include its own row and what ALLOWED names for it: a row that is named stands for the
files that belong to it, not for those of a row within it. Folders do not know each other in a circle,
those of one row neither. A heavy third-party header may be included only where HEAVY says, by at most
so many files. Modules of Python and of the page have tables of their own. The layers are what lets kernels, engine, server and client be understood,
tested and rebuilt one at a time.
"""
import ast
import graphlib
import pathlib
import posixpath
import re
import sys

# The kernel side is a chain: each link sees those before it.
KERNEL = ["engine/result.h", "engine/system", "engine/math", "engine/geometry", "engine/shading/material_layers.def",
          "engine/shading/records.h", "engine/bvh", "engine/intersectors", "engine/queries", "engine/packs"]


def up_to(folder):
    return KERNEL[:KERNEL.index(folder) + 1]


def rooms(names, *engine):
    """An entry of ALLOWED: rooms of the server, the protocol, and these folders of the engine."""
    return [*("server/" + room for room in names.split()), "protocol", *engine]


ENGINE = ["engine"]
SYSTEM = ["engine/result.h", "engine/system"]
BUILT = up_to("engine/packs") + ["engine/scene", "engine/scene/selection"]
CLIENT = ["client/" + room for room in ("ground", "net", "files", "requests", "output", "arguments", "commands")]

# Row -> what its files may include besides each other: rows that stand above it, or single headers of
# such rows, so no circle of folders can arise. A file belongs to the longest row that matches it.
ALLOWED = {
    "engine/result.h": [],
    **{folder: up_to(folder) for folder in KERNEL[1:KERNEL.index("engine/queries")]},
    "engine/scene/motion": up_to("engine/bvh"),
    "engine/queries": up_to("engine/queries") + ["engine/scene/motion/velocities.h"],
    "engine/packs": up_to("engine/packs"),
    "engine/shading": up_to("engine/intersectors"),
    "engine/scene": up_to("engine/bvh") + ["engine/scene/motion", "engine/shading/types.h"],
    "engine/scene/edits": up_to("engine/bvh") + ["engine/scene", "engine/scene/motion"],
    "engine/scene/selection": up_to("engine/bvh") + ["engine/scene", "engine/scene/edits"],
    "engine/assets/input": up_to("engine/bvh") + ["engine/scene"],
    "engine/assets/images": ["engine/result.h", "engine/system", "engine/scene"],
    "engine/assets/builtin": up_to("engine/geometry") + ["engine/scene", "engine/scene/motion"],
    "engine/assets/gltf/file": up_to("engine/bvh") + ["engine/scene", "engine/scene/motion", "engine/shading/types.h",
                                                      "engine/assets/input"],
    "engine/assets/formats": up_to("engine/bvh") + ["engine/scene", "engine/packs/registry.h",
                                                    "engine/assets/input", "engine/assets/images",
                                                    "engine/assets/gltf/file/uri.h"],
    "engine/assets/composition": up_to("engine/bvh") + ["engine/scene", "engine/scene/edits", "engine/scene/motion",
                                                        "engine/shading/types.h",
                                                        "engine/assets/input", "engine/assets/formats"],
    "engine/assets/gltf/write": up_to("engine/bvh") + ["engine/scene", "engine/scene/motion", "engine/shading/types.h",
                                                       "engine/shading/records.h", "engine/shading/texture_lookup.h",
                                                       "engine/assets/input", "engine/assets/images"],
    "engine/assets/gltf": up_to("engine/bvh") + ["engine/scene", "engine/scene/motion", "engine/assets/input",
                                                 "engine/assets/images", "engine/assets/gltf/file"],
    "engine/assets": ["engine/result.h", "engine/scene", "engine/packs/registry.h",
                      "engine/assets/input", "engine/assets/composition", "engine/assets/formats",
                      "engine/assets/gltf"],
    "engine/assets/sandbox": ["engine/result.h", "engine/system", "engine/scene",
                              "engine/packs/registry.h", "engine/assets/input",
                              "engine/assets/images", "engine/assets"],
    "engine/integrators": up_to("engine/packs") + ["engine/scene", "engine/shading",
                                                   "engine/shading/records.h"],
    "engine/inspection": up_to("engine/packs") + ["engine/scene", "engine/shading/records.h",
                                                  "engine/integrators"],
    "engine/cuda": up_to("engine/packs"),
    "protocol": [],
    "server/ground": rooms("", "engine/result.h"),
    "server/security": rooms("ground", *SYSTEM),
    "server/net": rooms("security ground", *SYSTEM),
    "server/http": rooms("net security ground"),
    "server/options": rooms("net/address_set.h security ground", *SYSTEM, "engine/packs",
                                   "engine/assets/sandbox/sandbox.h"),
    "server/scheduling": rooms("security ground"),
    "server/store": rooms("security ground", *SYSTEM, "engine/scene", "engine/scene/motion/velocities.h",
                                 "engine/assets/gltf/file", "engine/assets/input",
                                 "engine/assets/formats/obj_names.h", "engine/assets/formats/part_file.h",
                                 "engine/assets/composition/compose.h"),
    "server/execution": rooms("scheduling store ground", *BUILT, "engine/integrators/ray_caster.h"),
    "server/backends/cuda": rooms("execution ground", *ENGINE),
    "server/backends": rooms("backends/cuda execution scheduling ground", *ENGINE),
    "server/documents": rooms("execution scheduling store ground", *ENGINE),
    "server/jobs": rooms("documents execution scheduling store security ground", *ENGINE),
    "server/jobs/films": rooms("jobs documents execution scheduling store security ground", *ENGINE),
    "server/requests/words": rooms("jobs/films jobs documents execution scheduling store security ground",
                                          *ENGINE),
    "server/requests": rooms(
        "requests/words jobs/films jobs documents execution scheduling store security ground", *ENGINE),
    "server/sessions": rooms("requests jobs scheduling net store security ground",
                                    "engine/geometry/ray.h"),
    "server/daemon": ["server", "protocol", *ENGINE],
    # Of the engine it knows lists (.def files), which hold rows and no code.
    "client/ground": ["protocol", "engine/queries/fields.def", "engine/geometry/counters.def", "engine/packs/words.def",
                      *("engine/integrators/" + name for name in
                        ("integrators.def", "integrator_settings.def", "measures.def", "palettes.def", "tonemaps.def"))],
    "client/net": ["client/ground", "protocol"],
    "client/files": ["client/ground", "protocol", "engine/assets/images/exr_attributes.h"],
    "client/requests": ["client/net", "client/files", "client/ground", "protocol"],
    "client/output": ["client/requests", "client/files", "client/ground", "protocol"],
    "client/arguments": ["client/requests", "client/files", "client/net", "client/ground", "protocol"],
    "client/commands": ["client/arguments", "client/output", "client/requests", "client/net",
                        "client/files", "client/ground", "protocol"],
    "client": [*CLIENT, "protocol"],
    "tests": ["client", *CLIENT, "server", "protocol", *ENGINE],
}

# Header prefix -> (folder or file -> how many files of it may include that). Tests are free.
HEAVY = {
    "OpenImageIO/": {"engine/assets/images": 1},
    "tiny_gltf.h": {"engine/assets/gltf/file": 1},
    "draco/": {"engine/assets/gltf/file": 1},
    "tiffio.h": {"engine/assets/formats": 1},
    "meshoptimizer.h": {"engine/assets/gltf/file": 1},
    "hwy/": {"engine/math": 1},
    "glm/": {"engine/math": 1},
    "boost/asio": {"server/net": 2, "client/net": 1},
    "boost/beast": {"server/http": 1},
    "flatbuffers/": {"protocol": 1, "server/http": 1},
    # the daemon, and its commands for TLS and tokens
    "CLI/": {"server/options": 1, "server/daemon": 1, "client/arguments": 1},
    "toml++/": {"server/options": 1, "client/net": 1},
    "openssl/": {"protocol": 1, "engine/scene": 1, "engine/assets/gltf/file": 1, "server/security": 6, "server/net": 1,
                 "client/net": 1},
    "sqlite3.h": {"server/store": 1},
    "seccomp.h": {"engine/assets/sandbox": 1},
    "spdlog/": {"server/ground": 1},
    "embree3/": {},
    "doctest/": {},
}

# The Python package: its rooms from the ground up, each with its modules or folders.
PACKAGE = "client/python/raynest"
PYTHON = [{"errors", "_lists", "_limits", "_wording", "_version", "_handles", "_told"}, {"_net"}, {"images"},
          {"_requests"}, {"_session"}, {"job"}, {"generators", "sweeps", "points", "_heat"}, {"_paths", "_pictures"}, {"edits"},
          {"_shutter"}, {"_render", "_export"}, {"_timed"}, {"scene"}, {"client", "returns"},
          {"compat", "merge", "_travel", "_query", "_notes"}, {"_own_daemon"}, {"_roster"},
          {"_workers"}, {"_prepared", "_copies", "_beside"}, {"_deal"}, {"__init__"}, {"dask", "_command"}]

# The page: its modules from the ground up; "*" are those that no other floor names. The first are the client that other
# programs load, the last the entry points.
PAGE = "server/web"
PAGE_FLOORS = [{"raynest.js", "frames.js", "lists.js"}, {"*"}, {"panels"}, {"main.js", "login.js"}]

# Folders that know each other nevertheless, and why.
CIRCLES = {
    ("engine/scene", "engine/scene/checks"): "a description and an arena are checked where a snapshot is made of them",
}

SOURCES = {".h", ".cpp", ".cu", ".inc", ".in"}
INCLUDE = re.compile(r'^\s*#\s*include\s*([<"])([^>"]+)[>"]', re.MULTILINE)
IMPORT = re.compile(r"""^\s*(?:import|export)\s+(?:[\w*{}$,\s]+\sfrom\s+)?["']([^"']+)["']"""
                    r"""|\bimport\(\s*["']([^"']+)["']""", re.MULTILINE)


def within(path, folder):
    return path == folder or path.startswith(folder + "/")


def owner(path, table):
    """The longest entry of the table that the path lies in."""
    return max((entry for entry in table if within(path, entry)), key=len, default=None)


def may_include(row, header):
    name = owner(header, [row, *ALLOWED[row]])
    return name is not None and (name not in ALLOWED or owner(header, ALLOWED) == name)


def includes(root):
    """(file, header, whether in angle brackets) for every include of the tree's own sources."""
    for top in ("protocol", "engine", "server", "client", "tests"):
        for file in sorted((root / top).rglob("*")):
            if file.suffix in SOURCES and file.is_file():
                text = file.read_text(encoding="utf-8", errors="replace")
                for bracket, header in INCLUDE.findall(text):
                    yield file.relative_to(root).as_posix(), header, bracket == "<"


def imports(tree, name, modules):
    """Yields the modules of the package that a module imports; names are tuples of their parts, and a folder's
    own module is __init__. Imports within functions and for types alone count too."""
    def found(parts, attributes):
        for attribute in attributes:
            inner = (*parts, attribute)
            yield next((known for known in (inner, (*inner, "__init__"), parts) if known in modules),
                       (*parts, "__init__"))

    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                top, *parts = alias.name.split(".")
                if top == "raynest":
                    yield from found(tuple(parts[:-1]), parts[-1:] or ["__init__"])
        elif isinstance(node, ast.ImportFrom):
            parts = tuple(node.module.split(".")) if node.module else ()
            if node.level:
                yield from found((*name[:len(name) - node.level], *parts), [alias.name for alias in node.names])
            elif parts[:1] == ("raynest",):
                yield from found(parts[1:], [alias.name for alias in node.names])


def python_violations(root):
    files = {file.relative_to(root / PACKAGE).with_suffix("").parts: file
             for file in sorted((root / PACKAGE).rglob("*.py"))}
    floors = {room: floor for floor, rooms_there in enumerate(PYTHON) for room in rooms_there}
    graph = {}
    for name, file in files.items():
        where = file.relative_to(root).as_posix()
        if name[0] not in floors:
            yield f"{where}: lies in no known room; name it in PYTHON of tests/check_includes.py"
            continue
        graph[name] = set(imports(ast.parse(file.read_text(encoding="utf-8")), name, files))
        for imported in sorted(graph[name]):
            if floors.get(imported[0], 0) > floors[name[0]]:
                yield f"{where}: {name[0]} may not import {'.'.join(imported)}"
    if circle := circle_of(graph):
        yield f"{PACKAGE}: a circle of imports: {' -> '.join('.'.join(name) for name in circle)}"


def circle_of(graph):
    """A circle in {name: the names that it knows}; none: empty."""
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        return error.args[1][::-1]
    return []


def page_violations(root):
    files = {file.relative_to(root / PAGE).as_posix(): file for file in sorted((root / PAGE).rglob("*.js"))}
    floors = {name: floor for floor, names in enumerate(PAGE_FLOORS) for name in names}

    def floor_of(name):
        return floors.get(name.split("/")[0], floors["*"])

    graph = {}
    for name, file in files.items():
        graph[name] = set()
        for words in IMPORT.findall(file.read_text(encoding="utf-8")):
            imported = next(filter(None, words))
            known = posixpath.normpath(posixpath.join(posixpath.dirname(name), imported))
            if not imported.startswith(".") or known not in files:
                yield f"{PAGE}/{name}: {imported} is no module of the page"
                continue
            graph[name].add(known)
            if floor_of(known) > floor_of(name) or floor_of(known) == len(PAGE_FLOORS) - 1:
                yield f"{PAGE}/{name}: may not import {known}"
    if circle := circle_of(graph):
        yield f"{PAGE}: a circle of imports: {' -> '.join(circle)}"


def folder_circles(root):
    graph, unused = {}, {pair for pair in CIRCLES if all((root / folder).is_dir() for folder in pair)}
    for file, header, _ in includes(root):
        pair = posixpath.dirname(file), posixpath.dirname(header)
        unused.discard(pair)
        if pair[0] != pair[1] and pair not in CIRCLES and (root / header).is_file():
            graph.setdefault(pair[0], set()).add(pair[1])
    for pair in sorted(unused):
        yield f"check_includes.py: CIRCLES allows what is gone: {' -> '.join(pair)}"
    if circle := circle_of(graph):
        yield f"a circle of folders: {' -> '.join(circle)}"


def upward_rows(table):
    """Rows that name a row which does not stand above them."""
    above = []
    for row, allowed in table.items():
        for name in set(allowed) - {row}:
            if owner(name, above) is None and not any(within(known, name) for known in above):
                yield f"check_includes.py: {row} names {name}, which stands below it"
        above.append(row)


def violations(root):
    yield from upward_rows(ALLOWED)
    yield from python_violations(root)
    yield from page_violations(root)
    yield from folder_circles(root)
    users = {}  # (heavy header, folder) -> files that include it
    for file, header, angled in includes(root):
        if owner(header, ["protocol", "engine", "server", "client", "tests"]):
            layer = owner(file, ALLOWED)
            if layer is None:
                yield f"{file}: lies in no known layer; name its folder in tests/check_includes.py"
            elif not may_include(layer, header):
                yield f"{file}: {layer} may not include {header}"
            if angled:
                yield f"{file}: our own header {header} is included in quotes, not brackets"
        for heavy, homes in HEAVY.items():
            if header.startswith(heavy) and not within(file, "tests"):
                home = owner(file, homes)
                if home is None:
                    yield f"{file}: {header} may not be included here"
                else:
                    users.setdefault((heavy, home), set()).add(file)
    for (heavy, home), files in sorted(users.items()):
        if len(files) > HEAVY[heavy][home]:
            yield (f"{home}: {heavy} is included by {len(files)} files, "
                   f"{HEAVY[heavy][home]} allowed: {', '.join(sorted(files))}")


def main():
    root = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else pathlib.Path(__file__).parent.parent)
    seen = sum(1 for _ in includes(root))
    found = list(violations(root))
    print(*found, sep="\n", end="\n" if found else "")
    print(f"{seen} includes, {len(found)} violations")
    return 1 if found or not seen else 0


if __name__ == "__main__":
    sys.exit(main())
