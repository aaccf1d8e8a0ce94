"""Checks that the default intersector costs no instruction: compares the machine code of kernels
compiled with hooks with that of the same source without hook calls, function by function.

usage: compare_code.py HOOKS.o NO_HOOKS.o CONTROL.o

Functions are matched by their mangled names and compared instruction by instruction, with addresses
normalised. CONTROL holds the same kernels with a trivial intersector and must differ, so that a
test that compares nothing fails.
"""

import re
import subprocess
import sys


def functions(path):
    """Returns {mangled name: [instruction, ...]} of one object file."""
    text = subprocess.run(
        ["objdump", "-d", "-r", "--no-show-raw-insn", path], check=True, capture_output=True, text=True
    ).stdout
    bodies, body, start = {}, None, 0
    for line in text.splitlines():
        header = re.match(r"^([0-9a-f]+) <(.+)>:$", line)
        if header:
            start = int(header.group(1), 16)
            body = bodies.setdefault(header.group(2), [])
            continue
        relocation = re.match(r"^\s+[0-9a-f]+: (R_\S+)\s+(\S+)", line)
        if relocation and body is not None:
            # Sections of constants are numbered per file; the linker compares their contents.
            body.append(relocation.group(1) + " " + re.sub(r"\.LC\d+|\.rodata\S*|\.text\S*", "DATA", relocation.group(2)))
            continue
        instruction = re.match(r"^\s+([0-9a-f]+):\s+(.*)$", line)
        if instruction and body is not None:
            # Make jump targets relative to the function instead of the section.
            code = re.sub(
                r"\b([0-9a-f]+) <([^>+]+)(\+0x[0-9a-f]+)?>",
                lambda m: m.group(2) + (m.group(3) or ""),
                instruction.group(2).split("#")[0].strip(),
            )
            body.append(code)
    return {name: code for name, code in bodies.items() if "raynest" in name}


def main():
    hooks, bare, control = (functions(path) for path in sys.argv[1:4])
    kernels = [name for name in hooks if "trace" in name]
    if len(kernels) < 3:
        print(f"FAILED: found {len(kernels)} kernels in {sys.argv[1]}, expected at least 3")
        return 1
    failed = 0
    if set(hooks) != set(bare):
        print("FAILED: different sets of functions:", sorted(set(hooks) ^ set(bare)))
        failed = 1
    for name in sorted(set(hooks) & set(bare)):
        same = hooks[name] == bare[name]
        failed |= not same
        print(f"{'identical' if same else 'DIFFERENT'} {len(hooks[name]):5} = {len(bare[name]):5} instructions  {name[:100]}")
    if all(control.get(name) == hooks[name] for name in kernels):
        print("FAILED: the control does not differ: this test compares nothing")
        failed = 1
    return failed


if __name__ == "__main__":
    sys.exit(main())
