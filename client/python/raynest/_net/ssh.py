"""The way to a daemon of another machine over the user's own ssh: ssh://[USER@]HOST[:PORT][/PATH].

    client ──► a Unix socket in a temporary folder ──ssh -L──► HOST ──► /run/raynest/socket

ssh ends with this process, however that ends. A watcher holds the end of a pipe whose other end is this
process': when that is gone, it ends ssh and removes the folder. PR_SET_PDEATHSIG would end ssh with the
thread that has started it.
"""
from __future__ import annotations

import os
import pathlib
import re
import shutil
import subprocess
import tempfile
import time
import weakref
from typing import IO

from .. import errors

START_SECONDS = 60.0  # long enough to type a password
END_SECONDS = 5.0
# No part begins with "-", which ssh would read as an option, and nothing in the path is expanded.
_URI = re.compile(r"ssh://((?:[A-Za-z0-9_][A-Za-z0-9_.-]*@)?[A-Za-z0-9_][A-Za-z0-9_.-]*)(?::(\d{1,5}))?"
                  r"(/[^:$%\\\x00-\x1f\x7f]*)?", re.ASCII)
# Ctrl-C is for this process, which cancels its request over ssh.
_SSH = 'trap "" INT; exec ssh "$@"'
_WATCHER = 'read -r _; kill "$0"; rm -rf "$1"'


class SshTunnel:
    """An ssh that forwards a Unix socket; `uri` is this end of it."""

    def __init__(self, uri: str) -> None:
        parts = _URI.fullmatch(uri)
        if parts is None:
            raise errors.UsageError(f"{uri!r} is not ssh://[USER@]HOST[:PORT][/PATH of a socket]")
        self._host, port, path = parts.groups()
        if shutil.which("ssh") is None:
            raise errors.ConnectError("cannot start ssh: there is none in PATH")
        folder = tempfile.mkdtemp(prefix="raynest-", dir="/tmp")
        socket = pathlib.Path(folder) / "socket"
        self.uri = f"unix:{socket}"
        remote = path if path and len(path) > 1 else "/run/raynest/socket"
        # -S none: a connection that other ssh programs share would outlive this one.
        command = ["/bin/sh", "-c", _SSH, "sh", "-N", "-T", "-S", "none", "-o", "ExitOnForwardFailure=yes",
                   "-o", "ServerAliveInterval=10", "-L", f"{socket}:{remote}",
                   *(["-p", port] if port else []), "--", self._host]
        environment = {name: value for name, value in os.environ.items() if name != "RAYNEST_TOKEN"}
        # The reader of this process' output does not wait for ssh.
        self._log = tempfile.TemporaryFile()
        self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                                         stderr=self._log, env=environment)
        self._watcher = subprocess.Popen(["/bin/sh", "-c", _WATCHER, str(self._process.pid), folder], cwd="/",
                                         stdin=subprocess.PIPE, stdout=subprocess.DEVNULL,
                                         stderr=subprocess.DEVNULL, start_new_session=True)
        self._end = weakref.finalize(self, _end, os.getpid(), self._process, self._watcher,
                                     self._log, folder)
        _TUNNELS.add(self)
        try:
            self._await(socket)
        except BaseException:
            self.close()
            raise

    def _await(self, socket: pathlib.Path) -> None:
        end = time.monotonic() + START_SECONDS
        while not socket.exists():
            if self._process.poll() is not None:
                raise self.explain(errors.ConnectError(""))
            if time.monotonic() > end:
                raise errors.ConnectError(f"ssh to {self._host} did not connect within "
                                          f"{START_SECONDS:g} s")
            time.sleep(0.01)
        time.sleep(0.01)  # ssh listens a moment after the socket has its name

    def close(self) -> None:
        """Ends ssh, and with it the connection."""
        self._end()

    def explain(self, error: errors.ConnectError) -> errors.ConnectError:
        """Returns ssh's reason for a connection that failed, if ssh has one, else `error`."""
        lines = os.pread(self._log.fileno(), 1 << 16, 0).decode(errors="replace").split("\n")
        line = next((errors.shown_text(line.strip()) for line in reversed(lines) if line.strip()), "")
        if self._process.poll() is not None:
            return errors.ConnectError(f"ssh to {self._host} failed: {line or 'it gave no reason'}")
        if "open failed" not in line:
            return error
        # ssh is there, and found no daemon's socket: one that restarts would be there.
        return errors.ConnectError(f"no daemon answers on {self._host} (ssh: {line}); is raynestd running "
                                   "there, and may you open its socket?")


_TUNNELS: weakref.WeakSet[SshTunnel] = weakref.WeakSet()


def _end(owner: int, process: subprocess.Popen[bytes], watcher: subprocess.Popen[bytes],
         log: IO[bytes], folder: str) -> None:
    if os.getpid() != owner:  # the tunnel is of the process that was forked
        return
    watcher.kill()  # before the number of ssh's process can be another's
    watcher.communicate()
    process.terminate()
    try:
        process.wait(END_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    log.close()
    shutil.rmtree(folder, ignore_errors=True)


def _let_go() -> None:
    """In a process that was forked: the watcher waits for the one that has started ssh alone."""
    for tunnel in list(_TUNNELS):
        if tunnel._watcher.stdin is not None:
            tunnel._watcher.stdin.close()


os.register_at_fork(after_in_child=_let_go)
