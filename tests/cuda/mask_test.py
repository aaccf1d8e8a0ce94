#!/usr/bin/env python3
"""Checks that nvcc compiles lowest_bit() (engine/math/mask.h) to code that reads its mask.

  mask_test.py BUILD_DIR

nvcc 13.0 compiles libstdc++'s std::countr_zero to a constant: on a GPU every ray then read a child
that its node did not have. The control is a function that does ignore its mask. Exit code 77
(skipped) if the build has no CUDA.
"""
import pathlib
import re
import shlex
import subprocess
import sys
import tempfile

from registers_test import sources

KERNEL = """#include "engine/math/mask.h"
extern "C" __global__ void kernel(const std::uint32_t* mask, std::uint32_t* place) { *place = %s; }
"""


def reads_mask(nvcc, includes, folder, expression):
    source = folder / "kernel.cu"
    source.write_text(KERNEL % expression)
    subprocess.run([nvcc, *includes, "-std=c++20", "--expt-relaxed-constexpr", "-diag-suppress=20012", "-ptx", source,
                    "-o", folder / "kernel.ptx"], check=True)
    ptx = (folder / "kernel.ptx").read_text()
    return re.search(r"ld\.global\.u32\s+(%r\d+)", ptx) is not None


def main():
    command = next((shlex.split(command) for _, command, _ in sources(pathlib.Path(sys.argv[1]))), None)
    if command is None:
        print("skipped: this build has no CUDA")
        return 77
    includes = [word for word in command if word.startswith("-I")]
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        right = reads_mask(command[0], includes, folder, "raynest::lowest_bit(*mask)")
        control = reads_mask(command[0], includes, folder, "32U")
        library = reads_mask(command[0], includes, folder, "static_cast<std::uint32_t>(std::countr_zero(*mask))")
    print(f"reads its mask: lowest_bit() {right}, a constant {control}; std::countr_zero {library}")
    return 0 if right and not control else 1


if __name__ == "__main__":
    sys.exit(main())
