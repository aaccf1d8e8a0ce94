"""Converts the daemon's answers to the keys and types of `raynest --json`."""
from __future__ import annotations

from typing import Any

import numpy as np

from .._net.control import Message
from .._wording import localize_message
from ..errors import ProtocolError
from .job import origin_of

_NO_NODE = 2**32 - 1
# Entries of a list that comes page by page: more than a daemon has, so that its pages end.
LISTED_MAX = 1 << 20


def check_listed(count: int) -> None:
    """Fails beyond LISTED_MAX entries."""
    if count > LISTED_MAX:
        raise ProtocolError(f"the daemon sent a list of more than {LISTED_MAX} entries")


def rows_of(message: Message, *names: str, absent: Any = None) -> list[Any]:
    """The rows, as tuples, of a message's lists, which are equally long. An older daemon leaves out those that have an `absent`."""
    count = len(message[names[0]])
    lists = [message[name] or [absent] * count if absent is not None else message[name] for name in names]
    if any(len(each) != count for each in lists):
        raise ProtocolError(f"the daemon sent lists of different lengths: {', '.join(names)}")
    return list(zip(*lists))


def scene_info(message: Message) -> dict[str, Any]:
    """Converts a SceneInfo: names with counts become dicts, points lists; boxes move to the world."""
    info = dict(message)
    info["origin"] = origin = origin_of(info)
    info["up"] = info["up"] or "y"  # an older daemon says nothing
    info["warnings"] = [localize_message(warning) for warning in info["warnings"]]
    triangles = info["unique_triangles"]
    info["bytes_per_triangle"] = info["tree_bytes"] / triangles if triangles else 0.0
    for key, names, counts in (("skipped", "skipped_reasons", "skipped_counts"),
                               ("records", "record_types", "record_counts")):
        info[key] = dict(rows_of(info, names, counts))
        del info[names], info[counts]
    lower, upper = info["box_min"], info["box_max"]
    if not all(map(np.isfinite, (*(lower or ()), *(upper or ())))) and not (lower and upper and lower[0] > upper[0]):
        raise ProtocolError("the daemon sent a scene without finite bounds")
    is_empty = not lower or not upper or not lower[0] <= upper[0]
    for corner in ("box_min", "box_max"):
        info[corner] = None if is_empty else [_world(*place) for place in zip(info[corner], origin)]
    return info


def _world(relative: float, origin: float) -> float:
    """Returns a coordinate in the world; without an origin, with a float32's own digits. Never -0."""
    return relative + origin if origin else float(str(np.float32(relative))) + 0.0


def path_info(message: Message) -> dict[str, Any]:
    columns = rows_of(message, "steps", "instances", "uids", "nodes")
    return {"path": message["path"], "name": message["name"], "steps": [
        {"name": name, "instance": instance, "uid": uid, "node": None if node == _NO_NODE else node}
        for name, instance, uid, node in columns]}


def variant_info(message: Message) -> dict[str, Any]:
    return {**message, "params": [_param(param) for param in message["params"]]}


def _param(message: Message) -> dict[str, Any]:
    """Converts a parameter: it has a range, or choices of which the default is one."""
    param = {key: message[key] for key in ("name", "type", "text")}
    if not message["choices"]:
        return {**param, "minimum": message["minimum"], "maximum": message["maximum"],
                "default": [] if message["type"] == "table" else message["initial"]}
    param["choices"] = message["choices"]
    if 0 <= message["initial"] < len(message["choices"]):
        param["default"] = message["choices"][int(message["initial"])]
    return param


def job_info(message: Message) -> dict[str, Any]:
    """Converts a JobInfo: times in seconds, `error` None unless the job failed."""
    info = dict(message)
    info["age_seconds"] = info.pop("age_ms") / 1000
    left = info.pop("left_ms")
    info["left_seconds"] = left / 1000 if left else None
    info["error"] = info["error"] if info.pop("code") else None
    return info
