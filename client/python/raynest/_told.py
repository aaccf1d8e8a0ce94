"""A command of raynest that this package carries out: its notes, its answer and its errors, as `raynest` tells them."""
from __future__ import annotations

import json
import sys
import warnings
from typing import Any, Callable, Sequence

from ._wording import speak_as_command
from .errors import Error, Warning

NAMES: dict[int, str] = {2: "USAGE", 3: "CANNOT_CONNECT", 5: "FILE_INVALID", 7: "DEADLINE", 130: "INTERRUPTED"}


def carry_out(work: Callable[[], Sequence[tuple[str, dict[str, Any]]]], as_json: bool) -> int:
    """Prints the lines that `work` returns, or with --json the documents, and its warnings. Returns the exit code."""
    speak_as_command()
    notes: list[str] = []

    def show(message: Any, category: type[BaseException], *_: Any, **__: Any) -> None:
        if issubclass(category, Warning):
            notes.append(str(message))
    warnings.showwarning = show
    warnings.simplefilter("always")
    try:
        done = work()
    except KeyboardInterrupt:
        return fail(Error("interrupted", "INTERRUPTED"), 130, as_json)
    except Error as error:
        return fail(error, error.exit_code, as_json)
    told: set[str] = set()
    for line, document in done:
        document["notes"] = list(dict.fromkeys([*document.get("notes", []), *notes]))
        if as_json:
            print(json.dumps(document, separators=(",", ":")))
            continue
        for note in document["notes"]:
            if note not in told:
                print(f"raynest: {note}", file=sys.stderr)
        told.update(document["notes"])
        print(line)
    return 0


def fail(error: Error, exit_code: int, as_json: bool) -> int:
    """Prints the error; returns the exit code."""
    if as_json:
        told = {"code": error.code or 1000 + exit_code, "name": error.name or NAMES.get(exit_code, "FAILED"),
                "message": str(error)}
        print(json.dumps({"error": told}, separators=(",", ":")), file=sys.stderr)
    else:
        print(f"raynest: {error}", file=sys.stderr)
    return exit_code
