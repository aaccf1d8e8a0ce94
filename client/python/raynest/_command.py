"""`raynest --dask ADDRESS COMMAND ...`: a command of raynest that a cluster carries out in parts."""
from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import re
import sys
import tempfile
import threading
import warnings
from typing import Any, Sequence, Union

import numpy as np

from ._beside import command
from ._deal import PATIENCE, Deal, Part, known_to
from ._prepared import Prepared
from ._requests.files import STANDARD
from ._told import carry_out
from ._own_daemon import Setup, distributed
from ._workers import Carried
from .errors import ConnectError, Error, FailedError, UsageError
from .merge import merge

PARTS_PER_THREAD = 4
PART_RAYS = 1 << 16         # at least, of a file's
# Words whose next one is a file, or begins with a mark and a file.
FILES = {"--rays": "", "--masks": "", "--env": "", "--range-from": "", "--set": "@"}
SUMS = ("rays", "hits", "misses", "truncated", "invalid", "rows", "seconds", "queued_seconds")
OF_ALL_PIXELS = ("p50", "p90", "p99", "clipped", "below", "range_low", "range_high")


def run(address: str, parts_max: int, scene: str, out: str, words: Sequence[str], setup: Setup = Setup(),
        patience: float = PATIENCE, shows: bool = False) -> tuple[str, dict[str, Any]]:
    """Has a cluster carry out a command of raynest, and writes the whole of its parts as `out`. Returns a line that
    says so, and the document of --json."""
    ending = os.path.splitext(out)[1].lower()
    if ending not in (".npz", ".png", ".exr"):
        raise UsageError(f"{out}: with --dask an answer is written as .npz, .png or .exr")
    known = Prepared(scene, {})
    cluster = _connected(address)
    with cluster, tempfile.TemporaryDirectory(prefix="raynest-dask-") as folder:
        progress = _bar if shows else None
        known_to(cluster, known, setup, patience, progress)
        plain, rays = _carried(known, _without_output(words, out))
        threads = sum(worker["nthreads"] for worker in cluster.scheduler_info()["workers"].values())
        count = max(1, min(rays // PART_RAYS + 1 if rays else parts_max, PARTS_PER_THREAD * threads))
        parts = [Part({"scene": scene, "ending": ending,
                       "words": [*plain, "-o", None, "--part", f"{i + 1}/{count}"]}) for i in range(count)]
        paths = [os.path.join(folder, f"{i}{ending}") for i in range(count)]
        told: list[dict[str, Any]] = [{}] * count
        for item, (answer, document) in Deal(cluster, setup, known, command, parts, patience,
                                             progress, "parts").answers():
            told[item] = document
            with open(paths[item], "wb") as file:
                file.write(answer)
        return merge(out, paths), {**whole_of(told), "file": out, "parts": count}


def _connected(address: str) -> Any:
    if not re.search(r":[0-9]+$", address):
        raise UsageError(f"{address} is no address of a Dask scheduler: it is as tcp://HOST:8786")
    # The scheduler may have been started just before, so Dask's own time-out counts, 30 s unless it is configured.
    connect: Any = distributed.Client
    try:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            cluster = connect(address, set_as_default=False)
    except (OSError, asyncio.TimeoutError, ValueError, TypeError, RuntimeError) as error:
        raise ConnectError(f"no Dask scheduler answers at {address}: {error or 'it was too slow'}; "
                           "start one with dask-scheduler or dask-ssh") from None
    if any("Mismatched versions" in str(each.message) for each in said):
        _check_versions(cluster)
    return cluster


def _check_versions(cluster: Any) -> None:
    """Refuses a cluster that may not understand this program; other versions of numpy may."""
    versions = cluster.get_versions()
    ours = versions["client"]["packages"]
    others = {"the scheduler": versions["scheduler"],
              **{f"the worker {address}": each for address, each in versions["workers"].items()}}
    for where, each in others.items():
        for package in ("distributed", "dask", "msgpack"):
            theirs = each["packages"].get(package)
            if theirs != ours[package]:
                with contextlib.suppress(OSError, asyncio.TimeoutError):    # slow to go, which changes nothing
                    cluster.close(timeout=2)
                raise UsageError(f"{where} has {package} {theirs}, this machine {ours[package]}: install one version "
                                 "on all hosts")


def _without_output(words: Sequence[str], out: str) -> list[str]:
    at = next(i for i, word in enumerate(words) if word in ("-o", "--output", f"-o{out}", f"--output={out}"))
    return [*words[:at], *words[at + (2 if words[at] in ("-o", "--output") else 1):]]


def _carried(known: Prepared, words: Sequence[str]) -> tuple[list[Union[str, Carried]], int]:
    """The words, with the files that they name in their place, and how many rays or points those have."""
    made: list[Union[str, Carried]] = []
    rows, before = 0, ""
    for word in words:
        option, _, value = word.partition("=")
        prefix = ""
        if option in FILES and value:
            before, prefix, word = option, option + "=", value
        mark = FILES.get(before)
        if mark == "@":
            name, sign, path = word.partition("=@")
            prefix += name + sign
        elif option in ("points", "trajectory", "elevations", "azimuths") and value:
            prefix, path, word = option + "=", value, value
        else:
            path = word if mark is not None else ""
        if path and (path in STANDARD or os.path.isfile(path)):
            made.append(known.carry(path, prefix))
            if before == "--rays" or prefix == "points=":
                rows = _rows_of(path)
        else:
            made.append(prefix + word if prefix and mark != "@" else word)
        before = word if word in FILES else ""
    return made, rows


def _rows_of(path: str) -> int:
    try:
        return int(np.load(path, mmap_mode="r").shape[0])
    except (OSError, ValueError, AttributeError, LookupError):
        return 0        # a pipe; or the daemon says what is wrong with it


def whole_of(told: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The document of --json of a whole, but for statistics that only all pixels together have."""
    whole = {key: value for key, value in told[0].items() if key not in OF_ALL_PIXELS}
    for key in SUMS:
        if key in whole:
            whole[key] = sum(each[key] for each in told)
    if "mean" in whole:
        whole["mean"] = sum(each["mean"] * each["rays"] for each in told) / max(1, whole["rays"])
        whole["min"], whole["max"] = min(each["min"] for each in told), max(each["max"] for each in told)
    if "height" in whole:
        whole["height"] = sum(each["height"] for each in told)
    whole["notes"] = list(dict.fromkeys(note for each in told for note in each.get("notes", ())))
    return whole


def _bar(done: int, total: int, stage: str) -> None:
    print(f"\r{done} of {total} {'pieces of the files sent' if stage == 'sending' else stage} ", end="\n" if done == total else "", file=sys.stderr, flush=True)


def main(words: Sequence[str]) -> int:
    """Is called with what `raynest --dask` has read. Returns the exit code."""
    as_json = words[0] == "--json"
    address, parts_max, scene, out, *rest = words[1:] if as_json else words
    # Dask tells its troubles at length, from threads of its own; the user gets one line.
    logging.disable(logging.CRITICAL)
    threading.excepthook = lambda _: None
    sys.unraisablehook = lambda _: None
    def work() -> tuple[str, dict[str, Any]]:
        try:
            return run(address, int(parts_max), scene, out, rest, shows=sys.stderr.isatty() and not as_json)
        except Error:
            raise
        except Exception as error:      # of Dask: a line of it is what the user can use
            said = str(error).strip().splitlines()
            raise FailedError(f"Dask failed: {type(error).__name__}: {said[0] if said else 'it said nothing'}") from None
    return carry_out(work, as_json)
