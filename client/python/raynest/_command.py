"""`raynest --dask ADDRESS COMMAND ...`: a command of raynest that a cluster carries out in parts."""
from __future__ import annotations

import asyncio
import contextlib
import functools
import io
import json
import logging
import os
import re
import signal
import sys
import tempfile
import threading
import warnings
from typing import Any, Callable, Iterator, Mapping, Optional, Sequence, Union

import numpy as np

from . import _limits, _query, dask
from ._beside import PARTIAL, command
from ._copies import settle
from ._deal import Deal
from .dask import known_to
from ._heat import tell_exceeded
from ._notes import Told, note_of_all, note_of_none, notes_of
from ._prepared import Baggage, Part, Prepared
from ._requests.deadlines import deadline_of, items_within, share_of
from ._requests.files import STANDARD, read_file
from ._requests.film import is_lit, samples_asked
from ._roster import PATIENCE, roster_of
from ._told import carry_out, fail
from ._own_daemon import Setup, distributed
from ._travel import Carried, Source
from ._workers import info_of
from .errors import ConnectError, DeadlineError, Error, FailedError, InvalidError, UsageError
from .merge import PARTS_OF, merge

PARTS_PER_THREAD = 4
PART_SECONDS = 1.0          # of a lit picture's deadline, at least: a part is a program of its own
PART_RAYS = 1 << 16         # at least: some 50 ms of work
# Words whose next one is a file, or with the mark NAME=@FILE.
FILES = {"--rays": "", "--masks": "", "--env": "", "--range-from": "", "--set": "@", "--diff": "@"}
SCENE = "--diff"            # whose next one may also be a scene
SETTINGS = ("points", "trajectory", "elevations", "azimuths")   # of --generate, whose value may be a file
SUMS = ("rays", "hits", "misses", "truncated", "invalid", "rows", "seconds", "queued_seconds")
OF_ALL_PIXELS = ("noise", "p50", "p90", "p99", "clipped", "below", "range_low", "range_high")


def run(address: str, parts_max: int, scene: str, out: str, words: Sequence[str], setup: Setup = Setup(),
        patience: float = PATIENCE, shows: bool = False) -> list[tuple[str, dict[str, Any]]]:
    """Has a cluster carry out a command of raynest, and writes the whole of its parts as `out`, or of all cameras as
    files beside it. Returns for each file a line that says so, and the document of --json."""
    if any(word.partition("=")[0] == "--server" for word in words):
        raise UsageError("--dask goes without --server: each worker has a daemon of its own")
    known = prepared(scene)
    ending, (limits, words) = _ending(words[0], out), _without_limits(words)
    with connected(address) as cluster, tempfile.TemporaryDirectory(prefix="raynest-dask-") as folder, Baggage(known) as baggage:
        progress = bar if shows else None
        known_to(cluster, known, setup, patience, progress)
        plain, rows = _carried(baggage, _without_output(words, out),
                               lambda other: known_to(cluster, other, setup, patience, progress, known))
        pictures: list[tuple[str, list[str]]] = [(out, [])]
        if at := _all_cameras(plain):
            del plain[at]
            info, = Deal(cluster, setup, known, info_of, [Part({})], patience, None).all()
            if not info["cameras"]:
                raise InvalidError("the scene has no cameras: leave --cameras out")
            # As render names them.
            stem, last = os.path.splitext(out)
            pictures = [(f"{stem}.{i}{last}", ["--camera", str(i)]) for i in range(len(info["cameras"]))]
        threads = roster_of(cluster).threads(patience)
        most = _parts_max(words, rows, parts_max)
        # A row of a lit picture may take minutes, so its parts are as small as pays.
        count = max(1, most if is_lit(_integrator(words)) else min(most, -(-PARTS_PER_THREAD * threads // len(pictures))))
        whole: dict[str, Any] = {}
        late = Told() if is_lit(_integrator(words)) else None
        if late and (seconds := deadline_of({"words": words})):
            count = min(count, max(1, items_within(seconds, threads, PART_SECONDS) // len(pictures)))
            # Parts of one picture must say the same request, so they have the same share.
            plain, whole = _with_share(plain, lambda seconds: share_of(seconds, threads, count * len(pictures))), {"deadline": seconds}
        parts = [Part({**whole, "scene": scene, "ending": ending,
                       "words": [*plain, *which, "-o", None, "--part", f"{i + 1}/{count}"]}, late=late)
                 for _, which in pictures for i in range(count)]
        paths = [os.path.join(folder, f"{i}{ending}") for i in range(len(parts))]
        told: dict[int, dict[str, Any]] = {}
        too_late: list[DeadlineError] = []
        with contextlib.closing(Deal(cluster, setup, known, command, parts, patience, progress, "parts").answers()) as answers:
            for item, answer in answers:
                if isinstance(answer, DeadlineError):
                    too_late.append(answer)
                    continue
                data, told[item] = answer
                with open(paths[item], "wb") as file:
                    file.write(data)
        made = []
        for i, (path, _) in enumerate(pictures):
            there = [item for item in range(i * count, (i + 1) * count) if item in told]
            if not there:
                raise too_late[0]
            documents = [told[item] for item in there]
            line, document = merge(path, [paths[item] for item in there], limits, late=len(there) < count)
            if height := document.pop("late", 0):
                documents.append({**documents[0], **dict.fromkeys(SUMS, 0), "height": height, "incomplete": True, "samples": 0,
                                  "note_of_all": "", "notes": [note_of_none(_samples_asked(words))]})
            made.append((line, {**whole_of(documents), **document}))
        return made


def prepared(scene: str) -> Prepared:
    """The scene that a command names."""
    if not re.search("[/:.]", scene):
        raise InvalidError(f"scene '{scene}' is not loaded; with --dask name a file in its place, such as {scene}.glb",
                           "SCENE_UNKNOWN")
    return Prepared(scene, {})


CLOSE_SECONDS = 2.0         # for what changes nothing any more
SETTLE_SECONDS = 5.0        # for what a Ctrl-C meets on its way to the workers, which would stay there


@contextlib.contextmanager
def connected(address: str) -> Iterator[Any]:
    cluster = _connected(address)
    try:
        yield cluster
    finally:
        settle(cluster, SETTLE_SECONDS)
        with contextlib.suppress(OSError, asyncio.TimeoutError):
            cluster.close(timeout=CLOSE_SECONDS)


def _connected(address: str) -> Any:
    if not re.search(r":[0-9]+$", address):
        raise UsageError(f"{address} is no address of a Dask scheduler: it is as tcp://HOST:8786")
    # The scheduler may have been started just before, so Dask's own time-out counts, 30 s unless it is configured.
    connect: Any = distributed.Client
    try:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            cluster = connect(address, set_as_default=False)
    except (OSError, asyncio.TimeoutError, ValueError, TypeError, RuntimeError, MemoryError) as error:
        raise ConnectError(f"no Dask scheduler answers at {address}: {error or 'it was too slow'}; "
                           "start one with dask-scheduler or dask-ssh"
                           + ("; one with TLS has an address tls://HOST:8786" if address.startswith("tcp://") else "")) from None
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
                with contextlib.suppress(OSError, asyncio.TimeoutError):
                    cluster.close(timeout=CLOSE_SECONDS)
                raise UsageError(f"{where} has {package} {theirs}, this machine {ours[package]}: install one version "
                                 "on all hosts")


def _ending(command: str, out: str) -> str:
    """The ending of the parts of a file."""
    ending = os.path.splitext(out)[1].lower()
    is_heat = command == "heatmap"
    if ending not in PARTS_OF or is_heat and ending not in (".exr", ".npy", ".png"):
        raise UsageError(f"{out}: with --dask " + (
            "a heat map is written as .png, .exr or .npy; its report is made by one daemon" if is_heat else
            "an answer is written as .npz, .png, .exr or .npy, or as a point cloud: .ply, .pcd or .las"))
    return ".exr" if is_heat else PARTS_OF[ending][0]


def _without_limits(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Those of --fail-if, which are of all parts together, and the other words."""
    limits, others, given = [], [], iter(words)
    for word in given:
        option, _, value = word.partition("=")
        if option == "--top":
            raise UsageError("--top ranks the work of all rays at once, which one daemon does: leave it out, or --dask")
        if option == "--fail-if":
            limits.append(value or next(given))
        else:
            others.append(word)
    return limits, others


def _without_output(words: Sequence[str], out: str) -> list[str]:
    at = next(i for i, word in enumerate(words) if word in ("-o", "--output", f"-o{out}", f"--output={out}"))
    return [*words[:at], *words[at + (2 if words[at] in ("-o", "--output") else 1):]]


def _with_share(words: Sequence[Any], share: Callable[[float], float]) -> list[Any]:
    """The words of a part, whose --deadline is its share."""
    made = list(words)
    for at, word in enumerate(made):
        option, sign, seconds = word.partition("=") if isinstance(word, str) else ("", "", "")
        if option == "--deadline":
            to = at if sign else at + 1
            made[to] = (option + sign if sign else "") + repr(share(float(seconds if sign else made[to])))
    return made


def _all_cameras(words: Sequence[Any]) -> Optional[slice]:
    """Where the words say so."""
    for at, word in enumerate(words):
        if word in ("--cameras", "--cameras=all"):
            return slice(at, at + (2 if word == "--cameras" else 1))
    return None


def _carried(baggage: Baggage, words: Sequence[str], known_here: Callable[[Prepared], Prepared]
             ) -> tuple[list[Union[str, Carried, Source]], dict[str, int]]:
    """The words, with the files and scenes that they name in their place, and how many rows the arrays among these
    have, by option or setting."""
    made: list[Union[str, Carried, Source]] = []
    rows: dict[str, int] = {}
    before = ""
    for word in _apart(words):
        start, sign, path = word.partition("=@" if "@" in FILES.get(before, "") else "=")
        if before == SCENE and is_scene(word):
            made.append(baggage.scene(Prepared(word, {}), known_here, is_own=True))
        elif before in FILES or start in SETTINGS:
            if FILES.get(before) == "":
                path, start, sign = word, "", ""
            if path in STANDARD or os.path.exists(path) and not os.path.isdir(path):
                data = read_file(path, _limits.upload_bytes_max)
                made.append(baggage.file(data, start + sign, os.path.splitext(path)[1]))
                rows[start or before] = _rows_of(data)
            else:
                made.append(word)
        else:
            made.append(word)
        before = word
    return made, rows


def _apart(words: Sequence[str]) -> Iterator[str]:
    """Options and their values as words of their own."""
    for word in words:
        option, _, value = word.partition("=")
        yield from (option, value) if option in FILES and value else (word,)


def is_scene(word: str) -> bool:
    """True for the OTHER_SCENE of --diff, false for its KEY=VALUE."""
    return "=" not in word or word.startswith(("builtin:", "root:")) or os.path.isfile(word)


def _integrator(words: Sequence[str]) -> str:
    for word, following in zip(words, [*words[1:], ""]):
        if word.startswith("--integrator"):
            return word.partition("=")[2] or following
    return "primary"


def _samples_asked(words: Sequence[str]) -> int:
    given = dict(zip(words, [*words[1:], ""]))
    given.update(word.split("=", 1) for word in words if word.startswith("--") and "=" in word)     # type: ignore[misc]
    return samples_asked(int(given.get("--spp", given.get("--samples", 0))), "--noise" in given)


def _rows_of(data: bytes) -> int:
    """The rows of a .npy; 0 of what is none, of which the daemon says what is wrong with it."""
    file = io.BytesIO(data)
    form: Any = np.lib.format       # has no types in older versions
    try:
        read = form.read_array_header_1_0 if form.read_magic(file) == (1, 0) else form.read_array_header_2_0
        return int(read(file)[0][0])
    except (ValueError, LookupError):
        return 0


def _parts_max(words: Sequence[str], rows: Mapping[str, int], told: int) -> int:
    """How many parts of sensible size there are at most. `told` is what `raynest` knows, which has not read the files."""
    given = dict(word.split("=", 1) for word in words if "=" in word)

    def angles(name: str) -> int:
        count = given[name].rpartition(":")[2]      # LOWEST:HIGHEST:COUNT, or a,b,...
        return rows.get(name) or (int(count) if ":" in given[name] else len(count.split(",")))
    try:
        if "--rays" in rows:
            rays = most = rows["--rays"]
        elif "points" in rows:
            most = rows["points"]
            rays = most * int(given.get("samples", 64))
        elif rows.keys() & {"elevations", "azimuths"}:
            rays = most = int(given.get("scans", 1)) * angles("elevations") * angles("azimuths")
        else:
            return told
    except (ValueError, LookupError):
        return told
    return max(1, min(most, rays // PART_RAYS))


def whole_of(told: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The document of --json of a whole, but for statistics that only all pixels together have."""
    whole = {key: value for key, value in told[0].items() if key not in OF_ALL_PIXELS}
    firsts = np.cumsum([0, *(each.get("rays", 0) for each in told)]).tolist()
    invalid = [first + each["first_invalid"] for first, each in zip(firsts, told) if "first_invalid" in each]
    if invalid:
        whole["first_invalid"] = invalid[0]
    for key in SUMS:
        if key in whole:
            whole[key] = sum(each[key] for each in told)
    if "mean" in whole:
        whole["mean"] = sum(each["mean"] * each["rays"] for each in told) / max(1, whole["rays"])
        whole["min"], whole["max"] = min(each["min"] for each in told), max(each["max"] for each in told)
    if "height" in whole:
        whole["height"] = sum(each["height"] for each in told)
    if "incomplete" in whole:
        whole["incomplete"] = any(each["incomplete"] for each in told)
        whole["samples"] = min(each["samples"] for each in told)
    whole.pop("note_of_all", None)
    whole["notes"] = [*notes_of((each.get("height", 1), each.get("notes", ())) for each in told),
                      *note_of_all(each.get("note_of_all", "") for each in told)]
    return whole


def bar(done: int, total: int, stage: str) -> None:
    what = "pieces of the files sent" if stage == "sending" else stage
    print(f"\r{done} of {total} {what}\033[K", end="", file=sys.stderr, flush=True)


def _tell_counts(document: dict[str, Any], as_json: bool) -> int:
    """Says how many rays were not valid, or had too many hits, as one machine does. Returns the exit code."""
    rays, invalid, truncated = (document.get(key, 0) for key in ("rays", "invalid", "truncated"))
    if invalid:
        first = f"ray {document['first_invalid']}"
        told = f"{first} is not valid and counts as a miss" if invalid == 1 else (
            f"{invalid:,} of {rays:,} rays are not valid and count as misses, the first is {first}")
        print(f"raynest: {told}: something in it is not finite, its direction is zero, or tmin is negative or beyond tmax",
              file=sys.stderr)
    if document.get("incomplete"):
        return fail(FailedError(f"{document['file']} has fewer samples than were asked for: give it more time, or leave "
                                "--deadline out", "PARTIAL"), PARTIAL, as_json)
    if not truncated:
        return 0
    return fail(FailedError(f"{truncated:,} of {rays:,} rays have more hits than --max-hits, of which the nearest were kept; "
                            "raise it", "PARTIAL"), PARTIAL, as_json)


def several(asked: dict[str, Any], shows: bool) -> tuple[str, dict[str, Any]]:
    """Several requests to a daemon, as _query makes them of one command, on all workers."""
    known = prepared(asked["scene"])
    with connected(asked["dask"]) as cluster:
        def on_hosts(function: Callable[..., Any]) -> Callable[..., Any]:
            return functools.partial(function, cluster, known, progress=bar if shows else None)
        return _query.answered(_query.Asked(on_hosts(dask.trace), on_hosts(dask.render), on_hosts(dask.measure),
                                            lambda: ("", {"hash": known.source.digest})), asked)


def main(words: Sequence[str]) -> int:
    """Is called with what `raynest --dask` has read, of `several` requests as a file. Returns the exit code."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))    # its temporary files go, too
    if words[0] == "--several":
        with open(words[-1], "rb") as file:
            asked = json.load(file)
        shows = sys.stderr.isatty() and not asked["json"] and not asked["quiet"]
        return carry_out_quietly(lambda: [several(asked, shows)], asked["json"], shows)
    as_json, is_quiet = (flag in words[:2] for flag in ("--json", "--quiet"))
    address, parts_max, scene, out, *rest = words[as_json + is_quiet:]
    is_quiet |= "--quiet" in rest
    shows = sys.stderr.isatty() and not as_json and not is_quiet
    done: list[tuple[str, dict[str, Any]]] = []

    def work() -> list[tuple[str, dict[str, Any]]]:
        done.extend(run(address, int(parts_max), scene, out, rest, shows=shows))
        return done
    code = carry_out_quietly(work, as_json, shows)
    return code or max((_tell_counts(document, as_json) or tell_exceeded(document, as_json) for _, document in done), default=0)


def carry_out_quietly(work: Callable[[], Sequence[tuple[str, dict[str, Any]]]], as_json: bool, shows: bool) -> int:
    """carry_out() for `work` of a cluster, which `shows` a bar meanwhile."""
    # Dask tells its troubles at length, from threads of its own; the user gets one line.
    logging.disable(logging.CRITICAL)
    threading.excepthook = lambda _: None
    sys.unraisablehook = lambda _: None
    # One that a Ctrl-C has kept from connecting would wait for itself for ever, when it goes.
    setattr(distributed.Client, "__del__", lambda _: None)

    def work_in_a_line() -> Sequence[tuple[str, dict[str, Any]]]:
        try:
            try:
                return work()
            finally:
                if shows:
                    print("\r\033[K", end="", file=sys.stderr)      # the bar goes before what is told
        except Error:
            raise
        except Exception as error:      # of Dask: a line of it is what the user can use
            said = str(error).strip().splitlines()
            raise FailedError(f"Dask failed: {type(error).__name__}: {said[0] if said else 'it said nothing'}") from None
    code = carry_out(work_in_a_line, as_json)
    signal.signal(signal.SIGINT, signal.SIG_DFL)    # the end of Python would tell where a Ctrl-C has met it
    return code
