"""`raynest query` and `render` for what is several requests to a daemon: what a lidar measures, rays with times of their
own, and pictures of a camera in motion."""
from __future__ import annotations

import contextlib
import functools
import json
import os
import shutil
from typing import IO, Any, Callable, Iterator, Mapping, NamedTuple, Optional, Sequence, Union

import numpy as np

from . import generators, points, returns
from ._net.frame import Array
from ._requests.loads import load_of_file
from ._requests.npz import write_npz
from ._told import carry_out
from .client import Client, connect
from .errors import FailedError, InvalidError, UsageError
from .scene import Scene

Kind = Union[generators.Sweep, generators.Lidar]
# Columns of a point cloud that names none; those of a .las it has room for.
_OF_LAS = ("position", "ring", "time", "intensity", "return", "returns")
_OF_POINTS = ("position", "t", "ring", "time", "intensity", "return", "returns")


def main(words: Sequence[str]) -> int:
    """Is called with the file of what `raynest query` has read. Returns the exit code."""
    with open(words[-1], "rb") as file:
        asked = json.load(file)
    return carry_out(lambda: [_run(asked)], asked["json"])


class Asked(NamedTuple):
    """Methods of the scene that is asked, and the words and the document about what was made."""

    trace: Callable[..., dict[str, Array]]
    render: Callable[..., Any]
    measure: Callable[..., dict[str, Array]]
    told: Callable[[], tuple[str, dict[str, Any]]]


def _run(asked: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    with connect(asked["server"], **asked["access"]) as client:
        if asked["folder"]:     # a daemon's for this command alone, to which nobody connects any more
            shutil.rmtree(asked["folder"], ignore_errors=True)
        scene = _scene(client, asked["scene"], asked["is_source"])

        def told() -> tuple[str, dict[str, Any]]:
            outcome = client.outcome
            return f", {outcome['intersector']}, {scene.name} epoch {outcome['epoch']}", {
                "scene": scene.name, "epoch": outcome["epoch"], "hash": outcome["hash"], "notes": list(outcome["notes"])}
        return answered(Asked(scene.trace, scene.render, functools.partial(returns.measure, scene), told), asked)


def answered(by: Asked, asked: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """Writes what was asked for; returns a line that says so, and the document of --json."""
    job = {**asked["job"], **({"params": _params(asked)} if asked["set"] or asked["tables"] else {})}
    if "film" in asked:
        return _filmed(by, asked, job)
    made, count = (_measured if asked["generate"] else _timed)(by, asked, job)
    words, document = by.told()
    written = _write(asked["output"], made)
    rows, rays = ("returns", "beams") if asked["generate"] else ("rows", "rays")
    return f"{asked['output']}: {written:,} {rows} of {count:,} {rays}{words}", {
        **document, "rays": count, "rows": written, "file": asked["output"]}


def _scene(client: Client, word: str, is_source: bool) -> Scene:
    """The scene of this name, or of a file, which goes with the connection."""
    if not is_source:
        return client.scene(word)
    stem = os.path.splitext(os.path.basename(word.split("?")[0].split(":")[-1]))[0]
    load = load_of_file(word, f"{stem or 'scene'}-{os.urandom(4).hex()}")
    load.message["temporary"] = True
    return client._load(load)[0]


def _params(asked: dict[str, Any]) -> dict[str, Any]:
    return {**dict(text.split("=", 1) for text in asked["set"]), **asked["tables"]}


def _measured(by: Asked, asked: dict[str, Any], job: dict[str, Any]) -> tuple[dict[str, Array], int]:
    sensor = _sensor(asked["generate"])
    fields = _fields(asked)
    step = job.pop("time_step", None)
    if step is not None:
        if not isinstance(sensor, generators.Sweep):
            raise UsageError("--time-step is for a sensor in motion: --generate sweep")
        # As with step_error: the animation's time at the beginning, or those of the trajectory.
        times, start = sensor.time, job.pop("time", None)
        job.update(time=times if start is None else start + (times - times.min()), time_step=step)
    return by.measure(sensor, **asked["measure"], fields=fields, **job), sensor.count


def _timed(by: Asked, asked: dict[str, Any], job: dict[str, Any]) -> tuple[dict[str, Array], int]:
    rays = np.array(asked["rays"]).reshape(-1, 8)
    directions = None
    if asked["rays_file"]:
        rays = _array(asked["rays_file"])
        if asked["from"]:
            rays, directions = np.array(asked["from"]), rays
    if asked["masks_file"]:
        job["mask"] = _array(asked["masks_file"])
    times = _array(asked["times_file"])
    if times.ndim != 1:
        raise InvalidError(f"{asked['times_file']} has the shape {times.shape}: a time for each ray has the shape (N,)", "FILE_INVALID")
    made = by.trace(rays, directions, time=times, kind=asked["kind"], fields=asked["fields"] or None,
                    max_hits=asked["max_hits"], **job)
    return made, len(times)


def _filmed(by: Asked, asked: dict[str, Any], job: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    film, path = asked["film"], asked["output"]
    way = _trajectory(film.pop("trajectory"))
    image = by.render(**film, **way, **job)
    with _writable(path) as file:
        if path.lower().endswith(".npy"):
            np.save(file, np.asarray(image))
        else:
            file.write(image.png())
    height, width = image.shape[:2]
    words, document = by.told()
    return f"{path}: {width}x{height}, {width * height:,} rays{words}", {
        **document, "rays": width * height, "width": width, "height": height, "file": path}


def _sensor(words: Sequence[str]) -> Kind:
    kind, *settings = words
    if kind not in ("lidar", "sweep"):
        raise UsageError(f"--generate {kind}: returns are measured of --generate lidar and sweep")
    given = dict(word.split("=", 1) for word in settings)
    unknown = sorted(given.keys() - _SETTINGS.keys())
    if unknown:
        raise UsageError(f"generator {kind} has no setting '{unknown[0]}' where returns are measured")
    read: dict[str, Any] = {}
    for name, text in given.items():
        try:
            read.update(_SETTINGS[name](text))
        except ValueError as error:
            if isinstance(error, UsageError):
                raise
            raise UsageError(f"{name}: '{text[:80]}' is not what it takes (see: raynest query --help)") from None
    make: Callable[..., Any] = getattr(generators, kind)
    try:
        made: Kind = make(**read)
    except TypeError as error:
        raise UsageError(f"--generate {kind}: {error}") from None
    return made


def _numbers(text: str) -> Array:
    return np.array([float(word) for word in text.split(",")])


def _elevations(text: str) -> Mapping[str, Any]:
    if ":" in text:
        low, high, count = text.split(":")
        return {"elevations": np.linspace(float(low), float(high), int(count))}
    return {"elevations": _array(text) if text.endswith(".npy") else _numbers(text)}


def _azimuths(text: str) -> Mapping[str, Any]:
    if text.endswith(".npy"):
        return {"azimuths": _array(text)}
    start, stop, count = text.split(":")
    return {"azimuths": (float(start), float(stop), int(count))}


def _trajectory(text: str) -> Mapping[str, Any]:
    rows = _array(text)
    if rows.ndim != 2 or rows.shape[1] != 13:
        raise InvalidError(f"{text} must have the shape (N, 13): a time, and a 3x4 matrix row by row", "FILE_INVALID")
    return {"trajectory": (rows[:, 0], rows[:, 1:].reshape(-1, 3, 4))}


def _range(text: str) -> Mapping[str, Any]:
    near, far = text.split(":")
    return {"tmin": float(near), "tmax": float(far) or None}


_SETTINGS: dict[str, Callable[[str], Mapping[str, Any]]] = {
    "elevations": _elevations, "azimuths": _azimuths, "trajectory": _trajectory, "range": _range,
    "azimuth_offsets": lambda text: {"azimuth_offsets": _numbers(text)},
    "origin_offsets": lambda text: {"origin_offsets": _numbers(text).reshape(-1, 3)},
    "pose": lambda text: {"pose": _numbers(text).reshape(3, 4)},
    "lookat": lambda text: {"look_at": _numbers(text).reshape(-1, 3)}, "camera": lambda text: {"camera": text},
    "scans": lambda text: {"scans": int(text)}, "begin": lambda text: {"begin": float(text)},
    "end": lambda text: {"end": float(text)}}


def _array(path: str) -> Array:
    try:
        made: Array = np.load(path, allow_pickle=False)
    except OSError as error:
        raise InvalidError(f"{path}: {error.strerror or error}", "FILE_INVALID") from None
    except (ValueError, EOFError) as error:
        raise InvalidError(f"{path} is no .npy of numbers: {error}", "FILE_INVALID") from None
    return made


def _ending_of(path: str) -> str:
    return os.path.splitext(path)[1].lower()


def _fields(asked: dict[str, Any]) -> Optional[Sequence[str]]:
    """The columns of returns that a file gets; None: those of measure()."""
    path, fields = asked["output"], asked["fields"]
    if _ending_of(path) not in points.ENDINGS:
        return fields or None
    if fields and "position" not in fields:
        raise UsageError(f"{path} needs the column position among --fields")
    return fields or (_OF_LAS if _ending_of(path) == ".las" else _OF_POINTS)


def _write(path: str, columns: dict[str, Array]) -> int:
    """Writes the columns, and returns the number of rows."""
    if _ending_of(path) not in points.ENDINGS:
        with _writable(path) as file:
            write_npz(file, columns)
        return max((len(column) for name, column in columns.items() if name != "ray_splits"), default=0)
    data, count = points.formatted(_ending_of(path), columns.pop("position"), None, columns)
    with _writable(path) as file:
        file.write(data)
    return count


@contextlib.contextmanager
def _writable(path: str) -> Iterator[IO[bytes]]:
    try:
        with open(path, "wb") as file:
            yield file
    except OSError as error:
        raise FailedError(f"cannot write {path}: {error.strerror}") from None
