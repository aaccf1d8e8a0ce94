"""Commands of raynest that a worker runs beside the daemon of its host, each a part of one that the client was given."""
from __future__ import annotations

import contextlib
import json
import os
import subprocess
import tempfile
from typing import Any, Sequence

from ._own_daemon import NOBODY_WAITS, dropped, here
from ._requests.job import Outcome
from ._travel import Carried, Source
from ._workers import LOOK_SECONDS, Host
from .errors import BY_EXIT_CODE, CancelledError, Error, FailedError


def command(host: Host, source: Source, options: dict[str, Any]) -> tuple[bytes, dict[str, Any]]:
    """A command of raynest with --part, run beside the daemon. Returns the bytes of its file, and what it tells."""
    scene = host.scene(source)
    given = [host.local(word, source) for word in options["words"]]
    with tempfile.TemporaryDirectory(dir=host.folder) as folder:
        output = os.path.join(folder, "part" + options["ending"])
        words = [output if word is None else word.prefix + word.name if isinstance(word, Carried) else
                 found.name if isinstance(word, Source) else scene.name if word == options["scene"] else word
                 for word, found in zip(options["words"], given)]
        program = [os.path.join(os.path.dirname(host.binary()), "raynest"), "--server", host.uri, "--reconnect", "0",
                   "--json", *words]
        document = _told_by(host, program, host.files)
        host.client().outcome = Outcome({"target": document.get("target", "")})     # as if it had run here
        with open(output, "rb") as file:
            return file.read(), document


PARTIAL = 8        # exit code of an answer that lacks hits beyond --max-hits, or samples


def _told_by(host: Host, program: Sequence[str], folder: str) -> Any:
    """The document of --json of a program of this package, which ends early where nobody waits for it."""
    try:
        running = subprocess.Popen(program, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                                   cwd=folder)
    except OSError as error:
        raise FailedError(f"{here()} cannot start {program[0]}: {error.strerror}; install raynest there") from None
    with running:
        try:
            while True:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    told, said = running.communicate(timeout=LOOK_SECONDS)
                    break
                if dropped():
                    raise CancelledError(NOBODY_WAITS)
                host.look()
        finally:
            running.kill()
    if running.returncode not in (0, PARTIAL):
        raise error_of(running.returncode, said.decode(errors="replace"))
    return json.loads(told)


def error_of(exit_code: int, said: str) -> Error:
    """The error of a command with --json that ended with this code."""
    kind = BY_EXIT_CODE.get(exit_code, FailedError)
    line = said.strip().splitlines()[-1] if said.strip() else "it said nothing"
    try:
        told = json.loads(line)["error"]
        return kind(told["message"], told["name"], told["code"])
    except (ValueError, LookupError, TypeError):
        return kind(line.removeprefix("raynest: "))
