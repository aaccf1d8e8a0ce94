#!/usr/bin/env python3
"""The format of the C++ sources is that of .clang-format, as clang-format 14 (Debian 12) writes it.

  check_format.py [ROOT]     prints one line per file that differs, exit code 1 when there is any

`clang-format-14 -i FILE` mends a file. Exit code 77 (skipped) where there is no clang-format 14, for
other versions break lines elsewhere, or no git work tree to list.
"""
import pathlib
import re
import shutil
import subprocess
import sys

from check_house import tracked

CLANG_FORMAT = "clang-format-14"
SOURCES = {".h", ".cpp", ".cu"}


def unformatted(root, files):
    """The files that clang-format would change, sorted."""
    answer = subprocess.run([CLANG_FORMAT, "--dry-run", *files], cwd=root, capture_output=True, text=True)
    if answer.returncode:
        sys.exit(answer.stderr)
    return sorted(set(re.findall(r"^(.+?):\d+:\d+: warning: code should be clang-formatted", answer.stderr, re.M)))


def main():
    root = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else pathlib.Path(__file__).parent.parent)
    if shutil.which(CLANG_FORMAT) is None:
        print(f"skipped: no {CLANG_FORMAT} here")
        return 77
    listed = tracked(root)
    if listed is None:
        print("skipped: no git work tree here")
        return 77
    files = [file for file in listed if pathlib.Path(file).suffix in SOURCES]
    if not files:
        print("no sources found")
        return 1
    wrong = unformatted(root, files)
    for file in wrong:
        print(f"{file}: {CLANG_FORMAT} -i {file}")
    print(f"{len(files)} files, {len(wrong)} are not formatted")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
