#!/usr/bin/env python3
"""Compares the registers, frame and spills of every GPU kernel (intersector x query, and make_rays)
with a table.

  registers_test.py BUILD_DIR TABLE [--update]

Compiles each source once more for sm_90, with the build's other options, and reads ptxas's report.
Fails on any spill, on a kernel that only one of build and table has, and on one that needs more
than the table allows: a GPU allocates registers in steps of 8. On the other architectures spills
are warnings of the build, errors with RAYNEST_WERROR; this test checks that they are requested.
--update rewrites the table. Exit code 77 (skipped) if the build has no CUDA.
"""
import json
import pathlib
import re
import subprocess
import sys
import tempfile

ARCHITECTURE = "sm_90"
QUERIES = ["closest", "any", "multi"]
REGISTERS_MORE = 8
FRAME_MORE = 64  # bytes


def sources(build):
    """Yields (intersector or file name, command, folder) for each source that is compiled for
    GPUs."""
    for entry in json.loads((build / "compile_commands.json").read_text()):
        if entry["file"].endswith(".cu"):
            variant = re.search(r"RAYNEST_INTERSECTOR_FUNCTION=raynest_variant_(\w+)", entry["command"])
            yield variant[1] if variant else pathlib.Path(entry["file"]).stem, entry["command"], entry["directory"]


def compile_for_report(command, folder, output):
    """Returns ptxas's report on one source."""
    command = re.sub(r'"?--generate-code=\S+', "", command)
    command = re.sub(r" -o \S+", "", command)
    command = re.sub(r" -M\S* | -MF \S+| -MT \S+", " ", command)
    command += f" -arch={ARCHITECTURE} -cubin -Xptxas -v -o {output}"
    done = subprocess.run(command.replace(" -c ", " "), shell=True, cwd=folder, capture_output=True, text=True,
                          check=False)
    if done.returncode:
        sys.exit(f"FAILED: {command}\n{done.stdout}{done.stderr}")
    return done.stdout + done.stderr


def needs(report):
    """Returns {query, or - for a kernel without one: (registers, frame bytes, spilt bytes)}."""
    found = {}
    for kernel in re.split(r"Compiling entry function", report)[1:]:
        query = re.search(r"trace_kernel\w*QueryE(\d)", kernel)
        frame, stores, loads = map(int, re.search(
            r"(\d+) bytes stack frame, (\d+) bytes spill stores, (\d+) bytes spill loads", kernel).groups())
        registers = int(re.search(r"Used (\d+) registers", kernel)[1])
        found[QUERIES[int(query[1])] if query else "-"] = (registers, frame, stores + loads)
    return found


def read_table(path):
    rows = (line.split() for line in path.read_text().splitlines() if line and line[0] != "#")
    return {(row[0], row[1]): (int(row[2]), int(row[3])) for row in rows}


def main():
    build, path = map(pathlib.Path, sys.argv[1:3])
    measured, failures = {}, []
    with tempfile.TemporaryDirectory() as folder:
        for name, command, directory in sources(build):
            if "-Xptxas=-warn-spills" not in command:
                failures.append(f"{name} is compiled without a warning of spills")
            report = compile_for_report(command, directory, pathlib.Path(folder) / f"{name}.cubin")
            for query, need in needs(report).items():
                measured[name, query] = need
    if not measured:
        print("skipped: this build has no CUDA")
        return 77
    rows = [f"{name:16} {query:8} {registers:9} {frame:6}" for (name, query), (registers, frame, _) in measured.items()]
    print(f"{ARCHITECTURE:16} query    registers  frame", *rows, sep="\n")
    if "--update" in sys.argv:
        head = [line for line in path.read_text().splitlines() if line.startswith("#")]
        path.write_text("\n".join(head + rows) + "\n")
    table = read_table(path)
    failures += [f"{key} is in the table but not compiled" for key in table.keys() - measured.keys()]
    for key, (registers, frame, spilt) in measured.items():
        if spilt:
            failures.append(f"{key} spills {spilt} bytes")
        if key not in table:
            failures.append(f"{key} is not in the table: --update")
        elif registers > table[key][0] + REGISTERS_MORE or frame > table[key][1] + FRAME_MORE:
            failures.append(f"{key} needs {registers} registers and a frame of {frame} bytes, the table has {table[key]}")
    print(*("FAILED: " + failure for failure in failures), sep="\n", end="\n" if failures else "")
    print(f"{len(measured)} kernels, {len(failures)} failures")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
