"""Reports the cost of the kernel packs (kernels, compile seconds and bytes per pack), and checks
that each holds only instructions of its own target.

usage: pack_report.py BUILD_DIR KERNELS_MAX PACK...

Fails if a pack has more kernels than the committed count, exports more than one symbol, or holds
instructions that its target lacks (VEX in v2, EVEX registers in v3). Fails, too, if an
intersector's header is compiled into more than its own objects (changing it would rebuild others).
Seconds come from ninja's log of the last build of each object; with ccache they are those of the
cache.
"""

import pathlib
import re
import subprocess
import sys

SOURCE = pathlib.Path(__file__).parents[2]
sys.path.insert(0, str(SOURCE / ".ci"))
from lists import Lists  # noqa: E402


def compile_seconds(build, pack):
    """Returns the sum of ninja's (end - start) over the pack's objects; the log has it in ms."""
    log = build / ".ninja_log"
    if not log.exists():
        return None
    spans = {}
    for line in log.read_text().splitlines()[1:]:
        start, end, _, output, _ = line.split("\t")
        if f"/{pack}_" in output or f"/{pack}.dir/" in output:
            spans[output] = (int(end) - int(start)) / 1000
    return sum(spans.values())


def foreign_dependents(build):
    """Returns objects that an intersector's header would rebuild but that are not its own."""
    names = [row[0] for row in Lists(SOURCE).intersectors]
    told = subprocess.run(["ninja", "-C", build, "-t", "deps"], capture_output=True, text=True).stdout
    wrong, seen, output = [], set(), ""
    for line in told.splitlines():
        if line and not line.startswith(" "):
            output = line.split(":")[0]
        header = pathlib.Path(line.strip())
        if "engine/packs" not in output or header.parent.name != "intersectors" or header.stem not in names:
            continue
        own = re.search(r"pack_v\d_(\w+)\.dir", output)
        seen.add(header.stem)
        if own is None or own.group(1) != header.stem:
            wrong.append(f"{header.name} -> {output}")
    return wrong, sorted(set(names) - seen)


def main():
    build, kernels_max = pathlib.Path(sys.argv[1]), int(sys.argv[2])
    conformance = build / "bin/conformance"
    kernels = dict(
        re.findall(r"^(v\d) (\d+) kernels$", subprocess.run([conformance, "--kernels", "all"], capture_output=True, text=True).stdout, re.M)
    )
    failed = 0
    for path in map(pathlib.Path, sys.argv[3:]):
        target = path.stem.split("-")[-1]
        code = subprocess.run(["objdump", "-d", "--no-show-raw-insn", path], check=True, capture_output=True, text=True).stdout
        exported = subprocess.run(["nm", "-D", "--defined-only", path], check=True, capture_output=True, text=True).stdout.split()[2::3]
        vex = len(re.findall(r"\tv[a-z0-9]+ ", code))
        evex = len(re.findall(r"%zmm|%[xy]mm(?:1[6-9]|2\d|3[01])|%k[1-7]", code))
        seconds = compile_seconds(build, f"pack_{target}")
        print(f"{target}: {kernels.get(target, 'not runnable here, ?')} kernels, "
              f"{'no ninja log' if seconds is None else f'{seconds:.1f} s to compile'}, {path.stat().st_size >> 10} KiB, "
              f"{vex} VEX and {evex} EVEX instructions")
        if exported != ["raynest_pack"]:
            print(f"FAILED: {path.name} exports {exported}")
            failed = 1
        if int(kernels.get(target, 0)) > kernels_max:
            print(f"FAILED: more than the committed {kernels_max} kernels: raise the number in "
                  "tests/conformance/CMakeLists.txt if that is intended")
            failed = 1
        if (target == "v2" and vex + evex) or (target == "v3" and evex):
            print(f"FAILED: {path.name} holds instructions that its target lacks")
            failed = 1
    wrong, unseen = foreign_dependents(build)
    if (build / ".ninja_log").exists() and (wrong or unseen):
        print("FAILED: an intersector's header is compiled into other objects, or into none:", wrong, unseen)
        failed = 1
    if not kernels:
        print("FAILED: no pack listed its kernels")
        failed = 1
    return failed


if __name__ == "__main__":
    sys.exit(main())
