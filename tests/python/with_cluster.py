"""Shared by the tests of many hosts: a Dask cluster of processes on this machine."""
import asyncio
import contextlib
import os
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

from daemon import PATIENCE, until
from with_daemon import WithDaemon

try:
    import distributed
    import raynest.dask as many
except ImportError as missing:
    print(f"skipped: {missing}")
    sys.exit(77)


class Cluster:
    """A scheduler and workers in processes of their own, as on hosts: one daemon each."""

    def __init__(self, workers, host="127.0.0.1"):
        self.folder = tempfile.TemporaryDirectory(prefix="raynest-test-dask-")
        file = Path(self.folder.name) / "scheduler.json"
        # The folders of workers that are killed go with the cluster's.
        self.environment = {**os.environ, "RAYNESTD": WithDaemon.raynestd, "TMPDIR": self.folder.name}
        self.scheduler = self.start("dask_scheduler", "--host", f"tcp://{host}", "--port", "0", "--no-dashboard",
                                    "--no-show", "--scheduler-file", file)
        self.file, self.workers, self.client = file, [], None
        try:
            until(file.exists, patience=2 * PATIENCE)
            self.client = distributed.Client(scheduler_file=str(file), set_as_default=False)
            self.workers += [self.add() for _ in range(workers)]
            self.wait(workers)
        except BaseException:
            self.close()
            raise

    def start(self, module, *words, patch="", under=()):
        """Starts a program of Dask, after a line of Python, by the command `under`."""
        program = f"{patch}\nfrom distributed.cli.{module} import main\nmain()"
        return subprocess.Popen([*under, sys.executable, "-c", program, *map(str, words)],
                                env=self.environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                                stderr=subprocess.DEVNULL, start_new_session=True, cwd=self.folder.name)

    def wait(self, workers):
        """Until there are so many workers."""
        until(lambda: len(self.client.scheduler_info()["workers"]) >= workers, patience=2 * PATIENCE)

    def add(self, patch="", under=()):
        return self.start("dask_worker", "--scheduler-file", self.file, "--no-nanny", "--nthreads", 2, "--no-dashboard",
                          "--local-directory", self.folder.name, patch=patch, under=under)

    def close(self):
        try:
            if self.client is not None:
                with contextlib.suppress(OSError, asyncio.TimeoutError):    # its scheduler may be gone
                    self.client.close(timeout=2)
        finally:
            for process in [*self.workers, self.scheduler]:
                process.kill()
                process.wait()
            self.folder.cleanup()


class Elsewhere:
    """A network namespace as another host, at the address `there`, on a link to this one, `here`, that can be cut."""

    def __init__(self):
        net = f"10.{128 + os.getpid() // 256 % 128}.{os.getpid() % 256}"    # which no other test has at that time
        self.here, self.there = f"{net}.1", f"{net}.2"
        self.name = f"raynest-{os.getpid()}"
        self.link = f"rn{os.getpid()}"
        self.under = ("ip", "netns", "exec", self.name)
        try:
            for line in (f"netns add {self.name}", f"link add {self.link} type veth peer name peer netns {self.name}",
                         f"addr add {self.here}/24 dev {self.link}", f"link set {self.link} up",
                         f"-n {self.name} addr add {self.there}/24 dev peer", f"-n {self.name} link set peer up",
                         f"-n {self.name} link set lo up", f"netns exec {self.name} true"):
                self.ip(line)
        except (OSError, subprocess.CalledProcessError) as error:
            self.close()
            raise unittest.SkipTest(f"skipped: no network namespaces here: {error}") from None

    def ip(self, line, check=True):
        subprocess.run(["ip", *line.split()], check=check, stdin=subprocess.DEVNULL, capture_output=True)

    def cut(self):
        self.ip(f"link set {self.link} down")

    def mend(self):
        self.ip(f"link set {self.link} up")

    def close(self):
        for line in (f"link del {self.link}", f"netns del {self.name}"):
            with contextlib.suppress(OSError):
                self.ip(line, check=False)


class WithCluster(WithDaemon):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.setup = many.Setup(cls.raynestd, "worker", ("--threads", "1"))

    def cluster(self, workers, host="127.0.0.1"):
        made = Cluster(workers, host)
        self.addCleanup(made.close)
        return made
