"""Runs the command line and the Python client alike, each as a program of its own, for tests of what both
promise."""
import os
import subprocess
import sys

from daemon import PATIENCE

PYTHON = """
import sys, warnings, raynest
try:
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        with raynest.connect(sys.argv[1]) as client:
            print(client.connection.daemon.principal, client.scenes())
except raynest.Error as error:
    print(error, file=sys.stderr)
    sys.exit(error.exit_code)
finally:
    for warning in seen:
        print(warning.message, file=sys.stderr)
"""


class BothClients:
    """`raynest scenes` and its like in Python."""

    def __init__(self, raynest, config):
        self.commands = {"command line": lambda uri: [raynest, "--server", uri, "scenes"],
                         "Python": lambda uri: [sys.executable, "-c", PYTHON, uri]}
        inherited = {name: value for name, value in os.environ.items()
                     if not name.startswith("RAYNEST_") or name == "RAYNEST_BUILTIN_PACKS"}
        self.environment = {**inherited, "XDG_CONFIG_HOME": str(config)}

    def run(self, uri, **environment):
        """Yields (client's name, what became of it) of each."""
        for name, command in self.commands.items():
            yield name, subprocess.run(command(uri), env={**self.environment, **environment}, text=True,
                                       capture_output=True, stdin=subprocess.DEVNULL, timeout=PATIENCE)
