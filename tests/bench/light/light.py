#!/usr/bin/env python3
"""The cost of path-traced pictures: the figures of BENCH.md's section "Lit pictures".

  light.py BIN_DIR SCENE[@CAMERA]... [--json]      e.g. light.py build/bin temple.glb@track0 builtin:forest

For each scene three rows:
  share       shading's share of the CPU, and rays per CPU-second inside `path` over those of the bare
              stream traversal on the same rays (raynest-bench-light, on the best target of this CPU)
  threads     CPU of a daemon with two threads over that of one with one thread, for the same picture
  first       time until the first picture of a refined 1920x1080 frame is there, over the time of all samples
"""
import argparse
import json
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "integration"))
from daemon import Daemon  # noqa: E402


def cpu_seconds(pid):
    """CPU time of all threads of a process, those that have ended included."""
    return sum(int(x) for x in pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[11:13]) / 100


class Scene:
    def __init__(self, text):
        self.source, _, self.camera = text.partition("@")
        stem = pathlib.Path(self.source.partition("?")[0]).stem
        self.name = stem.removeprefix("builtin:")
        self.options = ["--camera", self.camera] if self.camera else []


def share(options, scene):
    command = [options.bin_dir / "raynest-bench-light", "--scene", scene.source, *scene.options, "--json",
               "--tiles", options.tiles, "--spp", "32", "--rounds", options.rounds, "--target", options.target]
    row = json.loads(subprocess.run([str(x) for x in command], check=True, stdout=subprocess.PIPE, text=True).stdout)
    return {"share": row["share"], "traversal_over_stream": row["traversal_over_stream"],
            "shading_ns": row["shading_ns"], "tracing_ns": row["tracing_ns"]}


def render(options, daemon, scene, output, *more):
    subprocess.run([options.bin_dir / "raynest", "--server", daemon.uri, "--quiet", "render", scene.name,
                    *scene.options, "--integrator", "path", "-o", output, *more], check=True,
                   stdout=subprocess.DEVNULL)


def load(options, daemon, scene):
    subprocess.run([options.bin_dir / "raynest", "--server", daemon.uri, "--quiet", "load", scene.source,
                    "--name", scene.name], check=True, stdout=subprocess.DEVNULL)


def threads(options, daemons, scene, folder):
    """The daemons take turns; each lap gives one ratio."""
    used = {1: [], 2: []}
    for lap in range(options.rounds):
        for count in (1, 2) if lap % 2 == 0 else (2, 1):
            before = cpu_seconds(daemons[count].process.pid)
            render(options, daemons[count], scene, folder / "threads.png", "--size", options.size, "--spp", "16")
            used[count].append(cpu_seconds(daemons[count].process.pid) - before)
    return {"cpu_of_two_over_one": statistics.median(b / a for a, b in zip(used[1], used[2])),
            "cpu_seconds": statistics.median(used[1])}


def first(options, daemon, scene, folder):
    output = folder / "first.png"
    output.unlink(missing_ok=True)
    command = [options.bin_dir / "raynest", "--server", daemon.uri, "--quiet", "render", scene.name, *scene.options,
               "--integrator", "path", "--size", options.frame, "--spp", str(options.spp), "--progressive", "-o", output]
    begin = time.monotonic()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        while not output.exists() and process.poll() is None:
            time.sleep(0.002)
        seen = time.monotonic() - begin
        if process.wait() != 0:
            raise SystemExit(f"light.py: {command} failed")
    whole = time.monotonic() - begin
    return {"first_over_whole": seen / whole, "first_seconds": seen, "whole_seconds": whole}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bin_dir", type=pathlib.Path, help="of the build: where raynestd lies")
    parser.add_argument("scenes", nargs="+", help="a file or builtin:..., and after @ a camera's name")
    parser.add_argument("--only", default="share,threads,first", help="rows to measure")
    parser.add_argument("--target", default="v4", help="of raynest-bench-light")
    parser.add_argument("--tiles", type=int, default=32)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--size", default="480x270", help="of the pictures for `threads`")
    parser.add_argument("--frame", default="1920x1080", help="of the picture for `first`")
    parser.add_argument("--spp", type=int, default=64, help="samples of the picture for `first`")
    parser.add_argument("--json", action="store_true", help="rows as JSON lines")
    options = parser.parse_args()
    rows = options.only.split(",")
    daemons = {}
    with tempfile.TemporaryDirectory(prefix="raynest-light-") as folder:
        folder = pathlib.Path(folder)
        try:
            if set(rows) & {"threads", "first"}:
                daemons = {n: Daemon(options.bin_dir / "raynestd", "--threads", str(n)) for n in (1, 2)}
            for scene in map(Scene, options.scenes):
                for daemon in daemons.values():
                    load(options, daemon, scene)
                measured = {"share": lambda: share(options, scene),
                            "threads": lambda: threads(options, daemons, scene, folder),
                            "first": lambda: first(options, daemons[2], scene, folder)}
                for row in rows:
                    result = {"scene": scene.name, "camera": scene.camera, "row": row, **measured[row]()}
                    print(json.dumps(result) if options.json else
                          "  ".join(f"{key} {value:.4g}" if isinstance(value, float) else f"{value}"
                                    for key, value in result.items() if value != ""), flush=True)
        finally:
            for daemon in daemons.values():
                daemon.stop()


if __name__ == "__main__":
    main()
