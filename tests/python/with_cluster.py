"""Shared by the tests of many hosts: a Dask cluster of processes on this machine."""
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from daemon import until
from with_daemon import WithDaemon

try:
    import distributed
    import raynest.dask as many
except ImportError as missing:
    print(f"skipped: {missing}")
    sys.exit(77)


class Cluster:
    """A scheduler and workers in processes of their own, as on hosts: one daemon each."""

    def __init__(self, workers):
        self.folder = tempfile.TemporaryDirectory(prefix="raynest-test-dask-")
        file = Path(self.folder.name) / "scheduler.json"
        self.environment = {**os.environ, "RAYNESTD": WithDaemon.raynestd}
        self.scheduler = self.start("dask_scheduler", "--host", "tcp://127.0.0.1", "--port", "0", "--no-dashboard",
                                    "--no-show", "--scheduler-file", file)
        self.file = file
        until(file.exists)
        self.client = distributed.Client(scheduler_file=str(file), set_as_default=False)
        self.workers = [self.add() for _ in range(workers)]
        if workers:
            self.client.wait_for_workers(workers, timeout=60)

    def start(self, module, *words, patch=""):
        """Starts a program of Dask, after a line of Python."""
        program = f"{patch}\nfrom distributed.cli.{module} import main\nmain()"
        return subprocess.Popen([sys.executable, "-c", program, *map(str, words)],
                                env=self.environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                                stderr=subprocess.DEVNULL, start_new_session=True, cwd=self.folder.name)

    def add(self, patch=""):
        return self.start("dask_worker", "--scheduler-file", self.file, "--no-nanny", "--nthreads", 2, "--no-dashboard",
                          "--local-directory", self.folder.name, patch=patch)

    def close(self):
        try:
            self.client.close(timeout=2)
        finally:
            for process in [*self.workers, self.scheduler]:
                process.kill()
                process.wait()
            self.folder.cleanup()


class WithCluster(WithDaemon):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.setup = many.Setup(cls.raynestd, "worker", ("--threads", "1"))

    def cluster(self, workers):
        made = Cluster(workers)
        self.addCleanup(made.close)
        return made
