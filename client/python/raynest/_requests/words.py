"""Converts the daemon's answers to the keys and types of `raynest --json`."""
from __future__ import annotations

from typing import Any

import numpy as np

from .._net.control import Message
from .._wording import localize_message
from .job import origin_of

_NO_NODE = 2**32 - 1


def scene_info(message: Message) -> dict[str, Any]:
    """Converts a SceneInfo: names with counts become dicts, points lists; boxes move to the world."""
    info = dict(message)
    info["origin"] = origin = origin_of(info)
    info["up"] = info["up"] or "y"  # an older daemon says nothing
    info["warnings"] = [localize_message(warning) for warning in info["warnings"]]
    triangles = info["unique_triangles"]
    info["bytes_per_triangle"] = info["tree_bytes"] / triangles if triangles else 0.0
    info["skipped"] = dict(zip(info.pop("skipped_reasons"), info.pop("skipped_counts")))
    info["records"] = dict(zip(info.pop("record_types"), info.pop("record_counts")))
    lower, upper = info["box_min"], info["box_max"]
    is_empty = not lower or not upper or not lower[0] <= upper[0]
    for corner in ("box_min", "box_max"):
        info[corner] = None if is_empty else [_world(*place) for place in zip(info[corner], origin)]
    return info


def _world(relative: float, origin: float) -> float:
    """Returns a coordinate in the world; without an origin, with a float32's own digits. Never -0."""
    return relative + origin if origin else float(str(np.float32(relative))) + 0.0


def path_info(message: Message) -> dict[str, Any]:
    columns = zip(message["steps"], message["instances"], message["uids"], message["nodes"])
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
