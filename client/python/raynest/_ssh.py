"""The way to a daemon of another machine over the user's own ssh: ssh://[USER@]HOST[:PORT][/PATH].

    client ──► a Unix socket in a temporary folder ──ssh -L──► HOST ──► /run/raynest/socket
"""
from __future__ import annotations

import os
import pathlib
import re
import subprocess
import tempfile
import time

from . import errors

START_SECONDS = 60.0  # long enough to type a password
# The host must not begin with "-": ssh would read it as an option.
_URI = re.compile(r"ssh://([A-Za-z0-9_][A-Za-z0-9_.@-]*)(?::(\d{1,5}))?(/[^:]*)?")


class SshTunnel:
    """An ssh that forwards a Unix socket; `uri` is this end of it."""

    def __init__(self, uri: str) -> None:
        parts = _URI.fullmatch(uri)
        if parts is None:
            raise errors.UsageError(f"{uri!r} is not ssh://[USER@]HOST[:PORT][/PATH of a socket]")
        host, port, path = parts.groups()
        remote = path if path and len(path) > 1 else "/run/raynest/socket"
        self._folder = tempfile.TemporaryDirectory(prefix="raynest-", dir="/tmp")
        socket = pathlib.Path(self._folder.name) / "socket"
        self.uri = f"unix:{socket}"
        command = ["ssh", "-N", "-T", "-o", "ExitOnForwardFailure=yes", "-o",
                   "ServerAliveInterval=10", "-L", f"{socket}:{remote}",
                   *(["-p", port] if port else []), "--", host]
        try:
            self._process = subprocess.Popen(command)
        except OSError as error:
            self._folder.cleanup()
            raise errors.ConnectError(f"cannot start ssh: {os.strerror(error.errno or 0)}") from None
        end = time.monotonic() + START_SECONDS
        while not socket.exists():
            if self._process.poll() is not None or time.monotonic() > end:
                self.close()
                raise errors.ConnectError(f"ssh to {host} failed; its reason is above")
            time.sleep(0.01)

    def close(self) -> None:
        """Ends ssh, and with it the connection."""
        if self._process.poll() is None:
            self._process.terminate()
            self._process.wait()
        self._folder.cleanup()
