#!/usr/bin/env python3
"""Checks and times a GPU, in the folder that gather.sh made. Prints JSON objects, the verdict last.

  driver.py [OPTION...] [STAGE...]      default: all stages, in this order

  check        compares every variant and query with the CPU's bytes: rays from files, random rays
               and camera rays, which the GPU makes
  sanitize     runs compute-sanitizer over small checks, if the machine has it
  conformance  the matrix of tests/conformance on the GPU: every variant, question and depth
  daemon       the same through raynestd and its worker process, camera rays made on the GPU included; bytes of files
  killed       kill -9 of the worker in the middle of a job: same bytes, a note, and the GPU again
  time         kernels alone, and from pinned memory to pinned memory: medians of interleaved rounds

Needs only Python's standard library and a driver. Leaves the device's settings as they are.
Exit codes: 0; 1 an answer differs, a program fails or compute-sanitizer finds something; 2 there is
no GPU. The verdict lists missed time goals; they are not failures, because they depend on the
device.
"""
import argparse
import itertools
import json
import os
import pathlib
import platform
import shutil
import statistics
import subprocess
import sys

import served

HERE = pathlib.Path(__file__).resolve().parent
DIFFERS, SKIPPED, FOUND = 9, 77, 99  # exit codes of the programs
SECONDS_MAX = 500  # per program
MADE_RAYS = 1 << 18  # per kind and scene of check: 3 * 10^7 answers with files
SERVED_RAYS = 1 << 17  # per request of daemon's 90: 1.1 * 10^7
TIMED_RAYS = 1 << 20  # enough to fill a GPU several times
SMALL_SCENES, SMALL_COUNT = ("trees", "flake"), 2048  # triangles with masks; spheres

MASKS = "procedural_mask", "alpha_mask", "alpha_blend"
# The goals for the rows of time: variants, field, bound, and whether values must be below or above
# it.
GOALS = [(MASKS[:1], "kernel_over_opaque", "at most", 1.1), (MASKS[1:], "kernel_over_opaque", "at most", 1.3),
         (("opaque", *MASKS), "pinned_over_limit", "at least", 0.8),
         (("opaque", *MASKS), "frames_over_limit", "at least", 0.8)]
NOT_MEASURED = ["opaque over a kernel without intersectors: their machine code is the same (ctest cuda_zero_cost)",
                "over Visionaray's CUDA traversal: it is not part of this tree. To compare, a program must read "
                "scenes/NAME.arena (engine/scene/FORMAT.md) and scenes/NAME-KIND.rays (tests/bench/files.h) and "
                "prints kernel_mrays as the rows of `time` have it, on the same device"]


class Failed(Exception):
    """A program failed."""


class NoGpu(Failed):
    """There is no GPU."""


def emit(row):
    print(json.dumps(row), flush=True)


def run(command):
    try:
        return subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False,
                              timeout=SECONDS_MAX)
    except subprocess.TimeoutExpired as error:
        raise Failed(f"{command[0]} takes longer than {SECONDS_MAX} s") from error
    except OSError as error:
        raise Failed(f"{command[0]}: {error.strerror}") from error


def last_line(*texts):
    return next((text.strip().splitlines()[-1] for text in texts if text.strip()), "no output")


def bench(options, what, scene, rays, count, *more, under=()):
    """Returns the rows of raynest-bench-cuda."""
    command = [*under, HERE / "bin/raynest-bench-cuda", what, "--pack", options.pack, "--rays", rays,
               "--arena", HERE / "scenes" / f"{scene}.arena", "--count", count, *more]
    if what == "check":
        command += ["--cpu-pack", HERE / "lib/raynest/raynest-pack-v3.so"]
    done = run(command)
    if done.returncode == SKIPPED:
        raise NoGpu(last_line(done.stderr))
    if done.returncode not in (0, DIFFERS):
        raise Failed(f"exit code {done.returncode}: {last_line(done.stderr, done.stdout)}")
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]


def inputs(made_count, file_count, *made):
    """Yields (scene, rays, count): every scene with its files of rays (a flat scene uses those
    of its instanced form), and with `made` rays. A count of 0 means all rays of the file."""
    for arena in sorted((HERE / "scenes").glob("*.arena")):
        for rays in sorted((HERE / "scenes").glob(f"{arena.stem.removesuffix('-flat')}-*.rays")):
            yield arena.stem, rays, file_count
        for rays in made:
            yield arena.stem, rays, made_count


def check(options):
    for scene, rays, count in inputs(options.count or MADE_RAYS, options.count or 0, "random", "camera"):
        yield from bench(options, "check", scene, rays, count)


def sanitize(options):
    tool = shutil.which("compute-sanitizer", path=f"{os.environ.get('PATH', '')}:/usr/local/cuda/bin")
    if tool is None:
        yield {"what": "sanitize", "skipped": "no compute-sanitizer here"}
        return
    for check_of in ("memcheck", "initcheck"):
        under = [tool, "--tool", check_of, "--error-exitcode", FOUND]
        for scene, rays in itertools.product(SMALL_SCENES, ("random", "camera")):
            rows = bench(options, "check", scene, rays, SMALL_COUNT, under=under)
            yield {"what": "sanitize", "tool": check_of, "scene": scene, "rays": rays, "kernels": len(rows),
                   "differing": sum(row["differing"] for row in rows)}


def conformance(options):
    done = run([HERE / "bin/conformance", "--target", "v3", "--target", "cuda", "--pack-dir", options.pack.parent])
    row = {"what": "conformance", "said": last_line(done.stdout, done.stderr)}
    if done.returncode == SKIPPED:
        row["skipped"] = "this machine does not run both targets"
    elif done.returncode:
        raise Failed(f"exit code {done.returncode}: {row['said']}")
    yield row


def daemon(options):
    return served.daemon(HERE / "bin", options.pack, options.count or SERVED_RAYS)


def killed(options):
    return served.killed(HERE / "bin", options.pack)


def time(options):
    count = options.count or TIMED_RAYS
    for scene, rays, _ in inputs(count, count, "random"):
        yield from bench(options, "time", scene, rays, count, "--rounds", options.rounds)


STAGES = {stage.__name__: stage for stage in (check, sanitize, conformance, daemon, killed, time)}


def machine(options):
    """Yields a row about the machine. Raises NoGpu if there is no GPU."""
    row = {"what": "machine", "device": bench(options, "check", SMALL_SCENES[0], "random", 64)[0]["device"],
           "cores": os.cpu_count(), "libc": " ".join(platform.libc_ver())}
    if shutil.which("nvidia-smi"):
        asked = run(["nvidia-smi", "--query-gpu=name,driver_version,memory.total,power.limit,pcie.link.gen.max",
                     "--format=csv,noheader"])
        row["nvidia_smi"] = last_line(asked.stdout, asked.stderr)
    return row


def judge(rows):
    """Yields the goals that the rows decide."""
    for variants, field, relation, bound in GOALS:
        values = {" ".join((row["scene"], row["rays"], row["query"], row["variant"])): row[field]
                  for row in rows if row["what"] == "time" and row["variant"] in variants and field in row}
        if not values:
            continue
        worst = (max if relation == "at most" else min)(values, key=values.get)
        met = values[worst] <= bound if relation == "at most" else values[worst] >= bound
        yield {"goal": f"{field} of {', '.join(variants)} {relation} {bound}", "met": met, "worst": values[worst],
               "at": worst, "median": statistics.median(values.values()), "of": len(values)}


def verdict(device, stages, rows, failures):
    compared = [row for row in rows if row["what"] in ("check", "daemon")]
    differing = sum(row.get("differing", 0) for row in rows)
    skipped = [row["what"] for row in rows if "skipped" in row]
    not_pinned = sorted({"from pinned memory: " + row["not_pinned"] for row in rows if "not_pinned" in row})
    return {"what": "verdict", "passed": not failures and differing == 0, "device": device, "stages": stages,
            "compared": sum(row["count"] for row in compared), "hitting": sum(row["hitting"] for row in compared),
            "differing": differing, "skipped": skipped,
            "failures": failures, "goals": list(judge(rows)), "not_measured": NOT_MEASURED + not_pinned}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stages", nargs="*", metavar="STAGE", help=", ".join(STAGES))
    parser.add_argument("--pack", type=pathlib.Path, default=HERE / "lib/raynest-cuda/raynest-pack-cuda.so")
    parser.add_argument("--count", type=int, help="rays of every check and timing")
    parser.add_argument("--rounds", type=int, default=11)
    options = parser.parse_args()
    unknown = set(options.stages) - STAGES.keys()
    if unknown:
        parser.error(f"there is no stage {', '.join(unknown)}; there are {', '.join(STAGES)}")
    # A bare machine may have only the C library of the libraries that programs need.
    os.environ["LD_LIBRARY_PATH"] = ":".join(filter(None, (str(HERE / "lib"), os.environ.get("LD_LIBRARY_PATH"))))
    stages, rows, failures = options.stages or list(STAGES), [], []
    try:
        first = machine(options)
    except Failed as error:
        print(f"driver.py: {error}", file=sys.stderr)
        return 2 if isinstance(error, NoGpu) else 1
    emit(first)
    for stage in stages:
        try:
            for row in STAGES[stage](options):
                emit(row)
                rows.append(row)
        except (Failed, *served.FAILURES) as error:
            failures.append(f"{stage}: {error}")
    row = verdict(first["device"], stages, rows, failures)
    emit(row)
    return 0 if row["passed"] else 1


if __name__ == "__main__":
    sys.exit(main())
