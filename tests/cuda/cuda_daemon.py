"""A real daemon with a CUDA worker, for the tests in this folder."""
import array
import functools
import pathlib
import random
import sys
import tempfile
import time
import unittest

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "integration"))
from daemon import PATIENCE, Client, Daemon, device_workers, second_principal, until  # noqa: E402
from npy import npy  # noqa: E402

RAYS = 70_000  # rays of a query: more than the 65,536 from which auto uses a GPU
FRAME = 16384  # rays per frame
NO_GPU = "cudaErrorInsufficientDriver", "cudaErrorNoDevice"  # the log's reasons for no GPU
START_SECONDS_MAX = max(120, PATIENCE)  # a first start translates kernels
PROGRAMS = []  # raynestd, raynest, and the pack: set before a test runs


@functools.cache
def bytes_of_rays(count, seed, endless_every):
    chance = random.Random(seed)
    values = array.array("f")
    for number in range(count):
        if endless_every and number % endless_every == 0:
            values.extend((5, 5, 5, -1e-45, -1e-45, -1e-45))
            continue
        values.extend((chance.uniform(-20, 20), 30, chance.uniform(-20, 20),
                       chance.gauss(0, 0.4), -1, chance.gauss(0, 0.4)))
    return values.tobytes()


def write_rays(path, seed=1, endless_every=None, copies=1):
    """Writes rays from above the built-in forest, in all downward directions, as a .npy of RAYS
    x 6. The endless ones have directions too short to tell one box from another."""
    path.write_bytes(npy((copies * RAYS, 6), copies * bytes_of_rays(RAYS, seed, endless_every)))


def why_no_worker(daemon):
    """Returns None once the worker is up, 77 (skipped) if there is no GPU, else 1. Prints the
    log's reason."""
    end = time.monotonic() + START_SECONDS_MAX
    while not any(word in daemon.log() for word in ("cuda_up", "cuda_down")) and time.monotonic() < end:
        time.sleep(0.1)
    print(*(line for line in daemon.log().splitlines() if "cuda_" in line), sep="\n")
    if "cuda_up" in daemon.log():
        return None
    return 77 if any(reason in daemon.log() for reason in NO_GPU) else 1


class CudaTest(unittest.TestCase):
    """Starts a daemon with a fake GPU for each class."""
    environment = {}
    arguments = ("--cuda-retry-ms", "200", "--cuda-retry-ms-max", "1000",
                 "--cuda-call-ms-max", "60000")
    scenes = (("builtin:forest?trees=20", "woods"),)

    @classmethod
    def setUpClass(cls):
        cls.out = pathlib.Path(cls.enterClassContext(tempfile.TemporaryDirectory(prefix="raynest test ")))
        cls.fault = cls.out / "fault"
        raynestd, raynest, pack = PROGRAMS
        words = [f"{key}={value}" for key, value in cls.environment.items()]
        cls.daemon = Daemon(raynestd, "--threads", "2", "--cuda", pack, *cls.arguments,
                            under=("env", f"RAYNEST_FAKE_CUDA={cls.fault}", *words))
        cls.addClassCleanup(cls.daemon.stop)
        cls.client = Client(raynest, cls.daemon.uri)
        for source, name in cls.scenes:
            cls.client.json("load", source, "--name", name, "--share", "public")
        cls.rays = cls.out / "rays.npy"
        write_rays(cls.rays)

    def metric(self, name):
        return self.client.json("stats")[name]

    def wait_until_up(self):
        until(lambda: "cuda" in self.client.json("variants")["variants"][0]["targets"],
              self.daemon.log)

    def query(self, worker, *options, scene="woods"):
        """Returns (the command's JSON, the file's bytes) of a query of RAYS rays."""
        file = self.out / f"{worker}.npz"
        told = self.client.json("query", scene, "--rays", self.rays, "-o", file, "--worker", worker,
                                *options)
        return told, file.read_bytes()

    def refused(self, code, says, *command):
        done = self.client.run(*command)
        self.assertEqual(done.returncode, code, done.stderr)
        self.assertEqual(done.stderr.count("\n"), 1, done.stderr)
        self.assertIn(says, done.stderr)

    def inject(self, fault):
        """Writes a fault for the fake runtime (fake_runtime.cpp explains the file)."""
        # Rename the file into place, so that it is never read half-written.
        draft = self.out / "draft"
        draft.write_text(fault)
        draft.rename(self.fault)
