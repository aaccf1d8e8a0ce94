#!/usr/bin/env python3
"""Every command of the README runs, as it stands there, against a real daemon; its C++ compiles.

  readme_test.py README.md BUILD_BIN_FOLDER COMPILER

A block fenced as `console` holds commands ("$ " begins one) and, below each, what it prints. What
runs is the command; of the printed lines the test compares the first word of the first, which is
enough to see a label or a key that was renamed and lets numbers be what they are on this machine,
and a scene's digest, which is the same on every machine.
`raynestd ... &` becomes a daemon of the test's own on a free port; the two commands that build are
run by ctest itself (tests/CMakeLists.txt) and only have to name a script that is there. A block
fenced as `pycon` is a Python session with that daemon, and must print what it shows. One fenced as
`cpp` is an intersector: it must compile and override primitives, as the list would say.
"""
import json
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import time

SECONDS_MAX = 120
BUILDING = re.compile(r"bash (client/demo\.sh|tests/run\.sh)")


def commands(text):
    """(command, first line that it prints or None) in the order of the README."""
    for block in re.findall(r"^```console\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
        lines = block.replace("\\\n", "").splitlines()
        for line, following in zip(lines, lines[1:] + ["$ "]):
            if line.startswith("$ "):
                yield line[2:], None if following.startswith("$ ") else following


INTERSECTOR = """
#include "engine/intersectors/interface.h"
#include "engine/intersectors/check.h"
namespace raynest {
%s
static_assert(check_intersector<%s, Declared{.primitives = true}>());
}
"""


def check_intersector(block, root, compiler):
    """Compiles an intersector of the README; returns the compiler's errors, or None."""
    source = INTERSECTOR % (block, re.search(r"struct (\w+)", block).group(1))
    run = subprocess.run([compiler, "-std=c++20", "-march=x86-64-v3", "-DHWY_DISABLE_PCLMUL_AES",
                          "-DHWY_COMPILE_ONLY_STATIC", "-fsyntax-only", "-I", root, "-xc++", "-"],
                         input=source, text=True, capture_output=True, check=False)
    return run.stderr.strip() if run.returncode else None


def start_daemon(command, folder, environment):
    """The README's daemon, on a free port; returns the process once it serves requests."""
    ready = folder / "ready.json"
    words = command.rstrip("& ").split() + ["--listen", "tcp://127.0.0.1:0",
                                            "--ready-file", str(ready)]
    daemon = subprocess.Popen(words, cwd=folder, env=environment)
    deadline = time.monotonic() + SECONDS_MAX
    while not ready.exists():
        if daemon.poll() is not None or time.monotonic() > deadline:
            daemon.kill()
            sys.exit(f"failed: {' '.join(words)}: serves nobody")
        time.sleep(0.05)
    environment["RAYNEST_SERVER"] = json.loads(ready.read_text())["listen"][0]
    return daemon


def check(command, printed, folder, environment):
    """Runs a command; returns what is wrong with it, or None."""
    run = subprocess.run(["bash", "-ec", command], cwd=folder, env=environment, text=True,
                         capture_output=True, timeout=SECONDS_MAX, check=False)
    if run.returncode:
        return f"exit code {run.returncode}: {run.stderr.strip()}"
    output = (run.stdout + run.stderr).split()
    for digest in re.findall(r"\b(?:[0-9a-f]{64}\b|[0-9a-f]{8,63}(?=\.\.\.))", printed or ""):    # or its beginning
        if not re.search(rf"\b{digest}", run.stdout):
            return f"the README shows the digest {digest}, it printed: {run.stdout.strip()}"
    word = printed.split()[0] if printed and printed.split() else None
    if word and not re.search(r"\d", word) and word not in output:
        return f"the README shows '{printed}', it printed: {run.stdout.strip() or run.stderr.strip()}"
    return None


def check_session(session, folder, environment):
    """Runs a Python session; returns what is wrong with it, or None."""
    file = folder / "session.txt"
    file.write_text(session, encoding="utf-8")
    run = subprocess.run([sys.executable, "-m", "doctest", file], cwd=folder, env=environment,
                         text=True, capture_output=True, timeout=SECONDS_MAX, check=False)
    return run.stdout + run.stderr if run.returncode else None


def main():
    readme, binaries = (pathlib.Path(argument).resolve() for argument in sys.argv[1:3])
    text = readme.read_text(encoding="utf-8")
    environment = dict(os.environ, PATH=f"{binaries}{os.pathsep}{os.environ['PATH']}",
                       PYTHONPATH=str(readme.parent / "client" / "python"),
                       PYTHONDONTWRITEBYTECODE="1")
    daemon, failures, count = None, 0, 0
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        try:
            for command, printed in commands(text):
                count += 1
                script = BUILDING.match(command)
                if script:
                    there = (readme.parent / script.group(1)).is_file()
                    problem = None if there else f"there is no {script.group(1)}"
                elif command.startswith("raynestd") and command.endswith("&"):
                    daemon, problem = start_daemon(command, folder, environment), None
                else:
                    problem = check(command, printed, folder, environment)
                print("failed:" if problem else "ok:", command, *([problem] if problem else []))
                failures += problem is not None
            for session in re.findall(r"^```pycon\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
                count += 1
                problem = check_session(session, folder, environment)
                print("failed:" if problem else "ok:", "Python", *([problem] if problem else []))
                failures += problem is not None
        finally:
            if daemon:
                daemon.terminate()
                daemon.wait(timeout=SECONDS_MAX)
    for block in re.findall(r"^```cpp\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
        count += 1
        problem = check_intersector(block, readme.parent, sys.argv[3])
        print("failed:" if problem else "ok:", block.splitlines()[0], *([problem] if problem else []))
        failures += problem is not None
    print(f"{count} commands and pieces of code, {failures} failed")
    return 1 if failures or count < 6 else 0


if __name__ == "__main__":
    sys.exit(main())
