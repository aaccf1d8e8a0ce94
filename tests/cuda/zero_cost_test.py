#!/usr/bin/env python3
"""Checks that the default intersector costs a GPU nothing: the machine code of its kernels is the
same with hooks and with every hook call compiled out (RAYNEST_NO_HOOKS), to the byte.

  zero_cost_test.py BUILD_DIR

Compiles `opaque` both ways for sm_90, and `procedural_mask` as the control, whose code must differ.
Exit code 77 (skipped) if the build has no CUDA.
"""
import pathlib
import sys
import tempfile

from registers_test import compile_for_report, sources


def main():
    different = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, command, directory in sources(pathlib.Path(sys.argv[1])):
            if name not in ("opaque", "procedural_mask"):
                continue
            code = []
            for hooks in ("", " -DRAYNEST_NO_HOOKS"):
                output = pathlib.Path(folder) / f"{name}.cubin"
                compile_for_report(command + hooks, directory, output)
                code.append(output.read_bytes())
            different[name] = code[0] != code[1]
            print(f"{name:16} {len(code[0])} bytes, without hooks {'different' if different[name] else 'the same'}")
    if not different:
        print("skipped: this build has no CUDA")
        return 77
    return 0 if different == {"opaque": False, "procedural_mask": True} else 1


if __name__ == "__main__":
    sys.exit(main())
