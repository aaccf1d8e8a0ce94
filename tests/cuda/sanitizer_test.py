#!/usr/bin/env python3
"""Checks that compute-sanitizer finds nothing in tests/cuda/slots_test.cpp on a GPU.

  sanitizer_test.py SLOTS_TEST          RAYNEST_DEVICE_PACK names the pack

Exit code 77 (skipped) if there is no CUDA in the build, no GPU or no compute-sanitizer.
"""
import os
import shutil
import subprocess
import sys

TOOLS = "memcheck", "initcheck", "racecheck", "synccheck"
FOUND = 99  # exit code for a finding


def run(*command):
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=500,
                          check=False)
    return done.returncode, done.stdout


def main():
    program = sys.argv[1]
    if not os.environ.get("RAYNEST_DEVICE_PACK"):
        print("skipped: this build has no CUDA")
        return 77
    code, said = run(program)
    if "skipped: " in said:
        print(next(line.strip() for line in said.splitlines() if "skipped: " in line))
        return 77
    if code:
        print(said, "FAILED: without compute-sanitizer, too", sep="\n")
        return 1
    sanitizer = shutil.which("compute-sanitizer", path=f"{os.environ.get('PATH', '')}:/usr/local/cuda/bin")
    if sanitizer is None:
        print("skipped: no compute-sanitizer here")
        return 77
    failures = 0
    for tool in TOOLS:
        code, said = run(sanitizer, "--tool", tool, "--error-exitcode", str(FOUND), program)
        if code:
            failures += 1
            print(said[-5000:], f"FAILED: {tool}: exit code {code}", sep="\n")
        elif "ERROR SUMMARY" not in said and "RACECHECK SUMMARY" not in said:
            failures += 1
            print(said[-5000:], f"FAILED: {tool} did not check the program", sep="\n")
    print(f"{len(TOOLS)} tools, {failures} failures")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
