"""Shared by the tests of formats: a daemon, a folder that holds files for it, and a Python client."""
import pathlib
import tempfile

import raynest
from daemon import DaemonTest


class WithFiles(DaemonTest):
    @classmethod
    def setUpClass(cls):
        folder = pathlib.Path(cls.enterClassContext(tempfile.TemporaryDirectory(prefix="raynest files ")))
        cls.scenes = folder / "scenes"
        cls.scenes.mkdir()
        cls.arguments = ("--scene-root", cls.scenes)
        super().setUpClass()

    def setUp(self):
        self.python = raynest.connect(self.daemon.uri)
        self.addCleanup(self.python.close)

    def write(self, name, data):
        path = self.scenes / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data.encode() if isinstance(data, str) else data)
        return path

    def load(self, name, data, **options):
        return self.python.load(self.write(name, data), replace=True, **options)
