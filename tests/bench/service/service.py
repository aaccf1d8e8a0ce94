#!/usr/bin/env python3
"""The cost of a daemon compared with tracing in process: rows of raynest-bench-service.

  service.py BIN_DIR [--json] [--rounds N]      e.g. service.py build/bin

The daemon has one worker, as the side in process has one thread; all else (sockets, encoding, the
client) is what the service adds. CPU is that of both processes. Each row of `service` is set against
the row in process that traced the same rays, `null` (canonical misses, nothing traced) against bare
sockets that move the same bytes in the same pieces; `short` rays travel without their ranges, a
`fan` of them as directions of one origin.
"""
import argparse
import json
import pathlib
import subprocess
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "integration"))
from daemon import Daemon  # noqa: E402

# Cheap, middling and expensive rays.
CASES = [("builtin:terrain", "primary"), ("builtin:terrain", "diffuse"), ("builtin:forest", "diffuse")]


def rows(folder, unix, rounds, count):
    arguments = ["--threads", "1", "--listen", f"unix:{unix}"] if unix else ["--threads", "1"]
    daemon = Daemon(folder / "raynestd", *arguments)
    try:
        server = f"unix:{unix}" if unix else daemon.uri
        for source, rays in CASES:
            name = source.removeprefix("builtin:")
            subprocess.run([folder / "raynest", "--server", server, "--quiet", "load", source,
                            "--name", name, "--replace"], check=True, stdout=subprocess.DEVNULL)
            bench = subprocess.run(
                [folder / "raynest-bench-service", "--server", server,
                 "--daemon-pid", str(daemon.process.pid), "--scene", source, "--name", name,
                 "--rays", rays, "--rounds", str(rounds), "--count", str(count)],
                check=True, stdout=subprocess.PIPE, text=True)
            for line in bench.stdout.splitlines():
                yield {"transport": server.partition(":")[0], **json.loads(line)}
    finally:
        daemon.stop()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bin_dir", type=pathlib.Path, help="of the build: where raynestd lies")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--count", type=int, default=1 << 20, help="rays of each lap")
    parser.add_argument("--unix", help="path of a Unix socket to use instead of TCP")
    parser.add_argument("--json", action="store_true", help="rows as JSON lines")
    options = parser.parse_args()
    layout = "{:9} {:8} {:8} {:17} {:>10} {:>10}  {:17} {:>6} {:>6} {:>9} {:>10} {:>6}"
    if not options.json:
        print(layout.format("transport", "scene", "rays", "side", "CPU ns/ray", "wall", "against", "CPU", "wall",
                            "laps", "CPU of all", "from"))
    for row in rows(options.bin_dir, options.unix, options.rounds, options.count):
        if options.json:
            print(json.dumps(row), flush=True)
            continue
        ratios = [f"{row[key]:.3f}" if key in row else "" for key in ("cpu_ratio", "wall_ratio")]
        print(layout.format(row["transport"], row["scene"], row["rays"], row["side"],
                            f"{row['cpu_ns_per_ray']:.1f}", f"{row['wall_ns_per_ray']:.1f}",
                            row["against"], *ratios or ("", ""), f"{row['uncrowded']}/{row['rounds']}",
                            f"{row['cpu_ns_per_ray_all']:.1f}", f"{row['crowded_from']:.3f}"), flush=True)


if __name__ == "__main__":
    main()
