#!/usr/bin/env python3
"""Plain words: how comments may begin, and by which words nothing may be named.

  check_words.py [ROOT]      prints one line per violation, exit code 1 when there is any

A comment begins with its subject: at most BEGINNINGS_MAX begin with "Of" or a clause ("What ...", "Who ...").
Types, traversals, command-line options, files and folders have the words of engine/GLOSSARY.md; WORDS
lists the words that were dropped, with their replacements. Exit code 77 (skipped) where there is no
git work tree to list.
"""
import pathlib
import re
import sys

from check_house import tracked

# A dropped word, in the singular, and its replacement. Names are compared word by word: "BakeOptions"
# has the word "bake".
WORDS = {
    "aggregation": "reducer",
    "bake": "build",
    "baked": "built",
    "blas": "object",
    "door": "entry point",
    "errand": "task",
    "feed": "input",
    "isa": "target",
    "mount": "sensor pose",
    "nonsense": "protocol violation",
    "piece": "chunk",
    "reorder": "reorderer",
    "seat": "worker thread",
    "tally": "statistics",
    "tenant": "principal",
    "tlas": "object",
}
# Words for the ways to traverse only: a latency is measured elsewhere, and a batch of writes is one.
TRAVERSAL_WORDS = {"latency": "single", "batch": "stream", "coherent": "packet"}

BEGINNINGS_MAX = 25  # in the whole tree
BEGINNING = re.compile(r'(?:(?<!:)//[/!]*<?|(?<![\w"&])#|"""|/\*+)[ \t]*(Of|Who|What|Whoever|Whatever)\b')
CPP = {".h", ".cpp", ".cu", ".def", ".fbs"}
COMMENTED = CPP | {".py", ".sh", ".cmake", ".txt", ".in", ""}
TYPE = re.compile(r"\b(?:class|struct|union|enum(?:[ ]+class)?|concept)[ ]+(?:alignas\([^)]*\)[ ]*)?([A-Za-z_]\w*)"
                  r"|\busing[ ]+([A-Za-z_]\w*)[ ]*=")
PYTHON_TYPE = re.compile(r"^[ ]*class[ ]+([A-Za-z_]\w*)|^([A-Z]\w*)[ ]*=[ ]*Type", re.MULTILINE)
OPTION = re.compile(r'add_(?:option|flag|parsed|each|all|words|number|whole|output|point)\w*(?:<[^()]*>)?\((?:\*?\w+,\s*)?\s*"([^"]+)"'
                    r'|add_argument\("([^"]+)"')
TRAVERSAL = re.compile(r'^RAYNEST_TRAVERSAL\((\w+), "(\w+)"', re.MULTILINE)


def words_of(name):
    """The words of a name in small letters: "BakeOptions", "bake-options" and "bake_options" have two."""
    return [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", name)]


def dropped(name, words):
    for word in words_of(name):
        for singular in (word, word.removesuffix("s")):
            if singular in words:
                yield f"'{word}' is called {words[singular]}"
                break


def named_things(name, text):
    """(kind, name, words that it may not have) of all that a file names."""
    suffix = pathlib.PurePath(name).suffix
    for part in pathlib.PurePath(name).parts:
        yield "a file or folder", part, WORDS
    patterns = []
    if suffix in CPP:
        patterns = [("a type", TYPE), ("an option", OPTION)]
    if suffix == ".py":
        patterns = [("a type", PYTHON_TYPE), ("an option", OPTION)]
    for kind, pattern in patterns:
        for match in pattern.finditer(text):
            yield kind, next(group for group in match.groups() if group), WORDS
    for match in TRAVERSAL.finditer(text):
        for word in match.groups():
            yield "a traversal", word, WORDS | TRAVERSAL_WORDS
    if suffix in CPP:
        for match in re.finditer(r"\b(?:struct|class)[ ]+(\w*Traversal\w*)", text):
            yield "a traversal", match.group(1), TRAVERSAL_WORDS


def beginnings_of(name, text):
    if pathlib.PurePath(name).suffix in COMMENTED:
        for number, line in enumerate(text.splitlines(), 1):
            for match in BEGINNING.finditer(line):
                yield f"{name}:{number}: a comment begins with '{match.group(1)}': begin with its subject"


def names_of(name, text):
    seen = set()
    for kind, thing, words in named_things(name, text):
        for reason in dropped(thing, words):
            if (thing, reason) not in seen:
                seen.add((thing, reason))
                yield f"{name}: {kind} is named {thing}: {reason}"


def main():
    root = pathlib.Path(sys.argv[1] if len(sys.argv) > 1
                        else pathlib.Path(__file__).parent.parent).resolve()
    names = tracked(root)
    if names is None:
        print("skipped: no git work tree, so no list of tracked files")
        return 77
    names = [name for name in names if (root / name).is_file() and name != "LICENSE"]
    found, beginnings = [], []
    for name in names:
        data = (root / name).read_bytes()
        text = "" if b"\0" in data else data.decode("utf-8", errors="replace")
        found += names_of(name, text)
        beginnings += beginnings_of(name, text)
    if len(beginnings) > BEGINNINGS_MAX:
        found += beginnings
    print(*found, sep="\n", end="\n" if found else "")
    print(f"{len(names)} tracked files, {len(found)} violations")
    return 1 if found or not names else 0


if __name__ == "__main__":
    sys.exit(main())
