"""The stages of driver.py that go through a daemon, whose worker process uses the GPU.

Scenes are built-in ones: a daemon does not load arenas. Standard library only.
"""
import array
import contextlib
import json
import math
import os
import pathlib
import random
import signal
import subprocess
import tempfile

from daemon import Client, Daemon, device_workers, until
from npy import npy

FAILURES = AssertionError, RuntimeError, OSError, subprocess.SubprocessError  # failures of a stage
SECONDS_MAX = 500  # per command
START_SECONDS_MAX = 300  # the first start translates PTX
# Masks in four levels, one large tree, spheres in six levels.
SCENES = {"forest": "builtin:forest", "terrain": "builtin:terrain", "flake": "builtin:flake?depth=6"}
COLUMNS = "hit,flags,t,prim,geom,path,inst,uid,uv,ng,front,position,material,origin,direction"
KINDS = {"closest": ("--fields", COLUMNS), "any": (), "multi": ("--max-hits", "8")}
# The job that loses its worker reduces to a sum, so that it does not wait for its client.
KILLED_SIDES = 256, 1024, 4096, 16384


def rays_file(count, seed):
    """Writes a .npy of rays from near and far towards the middle of a scene."""
    chance = random.Random(seed)
    values = array.array("f")
    for _ in range(count):
        far = chance.choice((3, 20))
        origin = [chance.uniform(low * far, far) for low in (-1, 0, -1)]
        values.extend(origin)
        values.extend(chance.gauss(0, far / 6) - start for start in origin)
    return npy((count, 6), values.tobytes())


def difference(ours, theirs):
    """Returns the number of bytes that differ."""
    if ours == theirs:
        return 0
    return abs(len(ours) - len(theirs)) + sum(map(int.__ne__, ours, theirs))


class Served:
    """A daemon of this folder's programs with `pack` as its CUDA pack, and a client."""

    def __init__(self, programs, pack, folder):
        self.folder = pathlib.Path(folder)
        # The tests' fake GPU is slow: a call may take seconds.
        self.daemon = Daemon(programs / "raynestd", "--cuda", pack, "--cuda-call-ms-max", "60000")
        self.client = Client(programs / "raynest", self.daemon.uri)

    def wait_until_up(self):
        """Returns the intersectors that the GPU has."""
        def found():
            if "cuda_down" in self.daemon.log():
                raise AssertionError("the worker does not start: " + self.daemon.log().splitlines()[-1])
            return self.intersectors()
        return until(found, self.daemon.log, START_SECONDS_MAX)

    def intersectors(self):
        variants = self.client.json("variants")["variants"]
        return [variant["name"] for variant in variants if "cuda" in variant["targets"]]

    def stat(self, name):
        return self.client.json("stats")[name]

    def start(self, ending, worker, command, *words):
        """Returns (process, the file that it writes)."""
        file = self.folder / f"{worker}.{ending}"
        return self.client.start("--quiet", "--json", command, *words, "-o", file, "--worker", worker), file

    @staticmethod
    def finish(process, file):
        """Returns (the reply's JSON, the file's bytes)."""
        output, errors = process.communicate(timeout=SECONDS_MAX)
        if process.returncode:
            raise AssertionError(f"raynest: exit code {process.returncode}: {errors.strip()}")
        return json.loads(output), file.read_bytes()

    def ask(self, *words):
        return self.finish(*self.start(*words))

    def compare(self, ending, *words):
        """Returns the counts of a row: the same request to the CPU and to the GPU."""
        told, ours = self.ask(ending, "cpu", *words)
        on_gpu, theirs = self.ask(ending, "cuda", *words)
        if (told["worker"], on_gpu["worker"]) != ("cpu", "cuda"):
            raise AssertionError(f"{words}: cpu ran on {told['worker']}, cuda on {on_gpu['worker']}")
        return {"count": told["rays"], "hitting": told["rays"] - told["misses"], "bytes": len(ours),
                "differing": difference(ours, theirs)}


@contextlib.contextmanager
def served(programs, pack):
    with tempfile.TemporaryDirectory(prefix="raynest-served-") as folder:
        one = Served(programs, pack, folder)
        try:
            yield one
        finally:
            one.daemon.stop()


def daemon(programs, pack, count):
    """Yields rows: each scene by every intersector and kind, with about `count` rays each from a
    client, from the device and from the daemon; and pictures."""
    side = max(1, math.isqrt(count))
    size = f"{side}x{side}"
    with served(programs, pack) as one:
        rays = one.folder / "rays.npy"
        rays.write_bytes(rays_file(side * side, 1))
        sources = {"sent": ("--rays", rays), "camera": ("--generate", "camera", f"size={size}"),
                   "panorama": ("--generate", "equirectangular", f"size={size}")}
        intersectors = one.wait_until_up()
        for scene, source in SCENES.items():
            one.client.json("load", source, "--name", scene)
            for intersector in intersectors:
                job = (scene, "--intersector", intersector)
                for kind, more in KINDS.items():
                    for name, words in sources.items():
                        counts = one.compare("npz", "query", *job, "--kind", kind, *more, *words)
                        yield {"what": "daemon", "scene": scene, "rays": name, "query": kind,
                               "variant": intersector, **counts}
                counts = one.compare("npy", "render", *job, "--size", size)
                yield {"what": "daemon", "scene": scene, "rays": "picture", "query": "closest",
                       "variant": intersector, **counts}


def killed(programs, pack):
    """Yields one row: a job loses its worker half way, and a later job uses the GPU again."""
    with served(programs, pack) as one:
        one.wait_until_up()
        one.client.json("load", SCENES["forest"], "--name", "forest")
        for side in KILLED_SIDES:
            words = ("query", "forest", "--generate", "camera", f"size={side}x{side}", "--reduce", "visible_pixels")
            _, expected = one.ask("npz", "cpu", *words)
            calls, starts = one.stat("cuda_calls"), one.stat("cuda_starts")
            job, file = one.start("npz", "auto", *words)
            until(lambda: one.stat("cuda_calls") > calls or job.poll() is not None)
            for worker in device_workers(one.daemon.process.pid):
                os.kill(worker, signal.SIGKILL)
            told, answer = one.finish(job, file)
            until(lambda: one.stat("cuda_starts") > starts, one.daemon.log, START_SECONDS_MAX)
            if told["worker"] != "cuda":
                break  # otherwise the job ended too early
        else:
            raise AssertionError("no job lasted until its worker was killed")
        if not any("was ended by a signal" in note for note in told["notes"]):
            raise AssertionError(f"the reply does not say that the worker was killed: {told['notes']}")
        again, later = one.ask("npz", "cuda", *words)
        yield {"what": "killed", "count": told["rays"], "worker": told["worker"], "note": told["notes"][0],
               "later": again["worker"], "differing": difference(expected, answer) + difference(expected, later)}
