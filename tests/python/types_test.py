#!/usr/bin/env python3
"""The Python client is typed: as mypy sees it, where there is one, and as programs see it that ask
for hints at run time.

  types_test.py RAYNESTD RAYNEST FLATC      (uses none of them)
"""
import importlib.util
import inspect
import pathlib
import subprocess
import sys
import tempfile
import typing
import unittest

import raynest
import raynest.compat.trimesh
from daemon import run_tests

CLIENT = pathlib.Path(__file__).resolve().parents[2] / "client" / "python"


def resolve_hints():
    """Resolves the type hints of all public functions; returns their number."""
    functions = 0
    for module in (raynest, raynest.errors, raynest.generators, raynest.compat.trimesh):
        for name, value in vars(module).items():
            ours = getattr(value, "__module__", "").startswith("raynest")
            if name.startswith("_") or not ours or not (inspect.isclass(value) or callable(value)):
                continue
            typing.get_type_hints(value)
            members = vars(value).items() if inspect.isclass(value) else ()
            for function in [value, *(getattr(member, "fget", member) for key, member in members
                                      if key == "__init__" or not key.startswith("_"))]:
                if inspect.isfunction(function):
                    typing.get_type_hints(function)
                    functions += 1
    return functions


class Types(unittest.TestCase):
    def test_its_types_are_right(self):
        if importlib.util.find_spec("mypy") is None:
            self.skipTest("skipped: there is no mypy")
        with tempfile.TemporaryDirectory() as cache:
            checked = subprocess.run(
                [sys.executable, "-m", "mypy", "--cache-dir", cache, "raynest"], cwd=CLIENT,
                capture_output=True, text=True, check=False)
        self.assertEqual(checked.returncode, 0, checked.stdout + checked.stderr)

    def test_its_hints_can_be_resolved(self):
        self.assertGreater(resolve_hints(), 50)

    def test_its_hints_can_be_resolved_where_there_is_no_unpack(self):
        program = ("import typing; vars(typing).pop('Unpack', None)\n"
                   "import types_test; assert types_test.resolve_hints() > 50")
        subprocess.run([sys.executable, "-c", program], cwd=pathlib.Path(__file__).parent,
                       check=True)


if __name__ == "__main__":
    del sys.argv[1:4]
    run_tests()
