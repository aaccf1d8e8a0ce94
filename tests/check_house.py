#!/usr/bin/env python3
"""Checks the house rules that a machine can check.

  check_house.py [ROOT]      prints one line per violation, exit code 1 when there is any

Top-level entries, folders and their lines in a README, file sizes and lengths, unfinished marks, paths of one developer's machine, shell
scripts that do not parse. Exit code 77 (skipped) where there is no git work tree to list.
"""
import collections
import pathlib
import re
import subprocess
import sys

TOP = {"CMakeLists.txt", "README.md", "LICENSE",
       "protocol", "engine", "server", "client", "tests"}  # hidden entries are free
FILE_BYTES_MAX = 1 << 20
SOURCE_LINES_MAX = 500  # the aim is 400
FOLDER_FILES_MAX = 40  # the aim is 30
SOURCES = {".h", ".cpp", ".cu", ".py", ".sh", ".js", ".mjs", ".cmake", ".inc"}
# Written in pieces so that this file does not find itself.
FORBIDDEN = {
    "an unfinished mark": re.compile(r"\b(?:TO" + r"DO|FIX" + r"ME|X" + r"XX)\b"),
    "the mark of a merge": re.compile(r"^(?:<{7}|>{7}|\|{7})(?: .*)?$", re.MULTILINE),
    "a path of somebody's machine": re.compile(r"(?<![\w.$}])/(?:wo" + r"rk|home/\w+|root|Users)/"),
}


# A line of the log that names who caused it has a limit, so that nobody fills the disk.
UNLIMITED_LINE = re.compile(r'(?<![\w:])log\((?:[^;"]|"(?!principal"|peer"|newcomer")[^"]*")*"(?:principal|peer|newcomer)"')

# What several requests have, and a picture's many words, are read once, into typed values; the handler
# of a request names its own message.
READ_ONCE = re.compile(r"wire::(?:Job|Camera)\b")
WORDS = "server/requests/words/"
READ_BY_REQUESTS = re.compile(r"wire::(?:Generator|Query|Render|Heatmap|Explain|Blame)\b")

# nvcc compiles libstdc++'s to a constant.
WRONG_ON_GPU = re.compile(r"std::countr_(?:zero|one)\(")
MASKS = "engine/math/mask.h"
COMPILED_BY_NVCC = re.compile(r"engine/(?:math|geometry|bvh|intersectors|queries|packs|cuda)/.*\.(?:h|cu)")


def tracked(root):
    listing = subprocess.run(["git", "-C", root, "-c", f"safe.directory={root}", "ls-files", "-z"],
                             capture_output=True, check=False)
    if listing.returncode:
        return None
    return [name for name in listing.stdout.decode().split("\0") if name]


def crowded_folders(names):
    """The rooms of the product that hold more than a reader can."""
    folders = collections.Counter(name.rpartition("/")[0] for name in names
                                  if "/" in name and not name.startswith((".", "tests/")))
    for folder, count in sorted(folders.items()):
        if count > FOLDER_FILES_MAX:
            yield f"{folder}: {count} files, at most {FOLDER_FILES_MAX}: it holds more than one idea"


def unnamed_folders(root, names):
    """The rooms of the product without a line in a README above them that says what belongs there."""
    folders = {name.rpartition("/")[0] for name in names
               if name.startswith(("engine/", "server/", "client/")) and pathlib.Path(name).suffix in SOURCES}
    for folder in sorted(each for each in folders if "/" in each):
        above = [*pathlib.PurePath(folder).parents][:-1]
        named = re.compile(rf"(?<![\w-]){re.escape(folder.rpartition('/')[2])}/[`\s]")
        pages = [root / each / "README.md" for each in above]
        if not any(page.is_file() and named.search(page.read_text(encoding="utf-8")) for page in pages):
            yield f"{folder}: no README above it has a line that says what belongs there"


def violations_of(root, name):
    file = root / name
    top = name.split("/")[0]
    if top not in TOP and not top.startswith("."):
        yield f"{name}: {top} is not one of the top-level entries"
    if file.stat().st_size > FILE_BYTES_MAX:
        yield f"{name}: {file.stat().st_size} bytes, at most {FILE_BYTES_MAX} are tracked"
        return
    data = file.read_bytes()
    if b"\0" in data:
        return
    text = data.decode("utf-8", errors="replace")
    for what, pattern in FORBIDDEN.items():
        match = pattern.search(text)
        if match:
            line = text.count("\n", 0, match.start()) + 1
            yield f"{name}:{line}: {what}: {match.group()}"
    if name.startswith("server/") and file.suffix == ".cpp":
        for match in UNLIMITED_LINE.finditer(text):
            line = text.count("\n", 0, match.start()) + 1
            yield f"{name}:{line}: log() of what a peer causes; call log_limited()"
    if name.startswith("server/") and file.suffix in SOURCES and not name.startswith(WORDS):
        for pattern in (READ_ONCE, *([] if name.startswith("server/requests/") else [READ_BY_REQUESTS])):
            if match := pattern.search(text):
                yield f"{name}: {match.group()} is read in {WORDS} alone: take its typed words"
    if COMPILED_BY_NVCC.fullmatch(name) and name != MASKS and WRONG_ON_GPU.search(text):
        yield f"{name}: nvcc compiles {WRONG_ON_GPU.search(text).group()}) wrongly; call lowest_bit() ({MASKS})"
    lines = text.count("\n")
    if file.suffix in SOURCES and lines > SOURCE_LINES_MAX:
        yield f"{name}: {lines} lines, at most {SOURCE_LINES_MAX}: it holds more than one idea"
    if file.suffix == ".sh" or re.match(r"#!.*\bbash\b", text):
        parsed = subprocess.run(["bash", "-n", file], capture_output=True, text=True, check=False)
        if parsed.returncode:
            yield f"{name}: does not parse: {parsed.stderr.strip()}"


def main():
    root = pathlib.Path(sys.argv[1] if len(sys.argv) > 1
                        else pathlib.Path(__file__).parent.parent).resolve()
    names = tracked(root)
    if names is None:
        print("skipped: no git work tree, so no list of tracked files")
        return 77
    names = [name for name in names if (root / name).is_file()]
    found = [*crowded_folders(names), *unnamed_folders(root, names), *(line for name in names for line in violations_of(root, name))]
    print(*found, sep="\n", end="\n" if found else "")
    print(f"{len(names)} tracked files, {len(found)} violations")
    return 1 if found or not names else 0


if __name__ == "__main__":
    sys.exit(main())
