"""The JSON documents about rays, which client/EXPLAIN.md describes."""
from __future__ import annotations

import json
import math
import reprlib
from typing import Any, Optional, Sequence

import numpy as np

from .. import _limits
from .._net.connection import Connection
from .._net.control import Message
from .._net.frame import Array
from ..errors import ProtocolError, UsageError, shown_text
from .arguments import float32, has_shape, numbers, whole
from .film import film_message, given_of, is_lit
from .job import Outcome, Progress
from .picture import Payload


def check_explain(ray: Any, pixel: Any, integrator: str, view: dict[str, Any],
                  light: dict[str, Any], steps: int) -> None:
    """Refuses options that such a request does not use: a ray has no view, a traversal no light, and a
    path no steps."""
    if (ray is None) == (pixel is None):
        raise UsageError("explain() takes a ray or a pixel, and not both")
    if integrator and ray is not None:
        raise UsageError("a path begins at a pixel: pass pixel=(x, y) in place of a ray")
    for options, idle, reason in ((view, ray is not None, "a ray has no camera; pass pixel=(x, y)"),
                                  (light, not integrator, "only of a path; pass integrator='path'"),
                                  ({"steps": steps}, bool(integrator), "a path is told whole")):
        given = given_of(options)
        if idle and given:
            raise UsageError(f"{', '.join(given)}: {reason}")


def ray_message(ray: Any, origin: Array) -> Message:
    """(6,) is [o d], (8,) is [ox oy oz tmin dx dy dz tmax]; places are shifted by `origin`."""
    values = numbers("ray", ray).astype(np.float64)
    if values.shape == (6,):
        values = np.array([*values[:3], 0.0, *values[3:], math.inf])
    if values.shape != (8,):
        raise UsageError(f"ray of {reprlib.repr(ray)}: it must be six numbers, origin and direction, or "
                         "eight with tmin before the direction and tmax behind it")
    values[:3] -= origin
    row = float32(values).tolist()
    return {"origin": tuple(row[:3]), "tmin": row[3], "direction": tuple(row[4:7]),
            "tmax": 0.0 if math.isinf(row[7]) else row[7]}


def pixel_message(pixel: Sequence[int]) -> Message:
    if not has_shape(pixel, 2):
        raise UsageError(f"pixel of {reprlib.repr(pixel)}: it must be (x, y), from the upper left corner")
    x, y = (whole("a pixel's place", place, _limits.picture_side_max, 0) for place in pixel)
    return {"pixel_x": x, "pixel_y": y}


def path_message(pixel: Sequence[int], integrator: str, sample: int, seed: int, environment: str,
                 **light: Any) -> Message:
    """The fields of a Render that ask for a path: `light` has those of a lit picture."""
    if not is_lit(integrator):
        raise UsageError("primary has one ray and no path: leave integrator away")
    if environment not in ("", "auto", "sky", "none"):
        raise UsageError("environment of explain() is 'auto', 'sky' or 'none': a path is explained "
                         "without files")
    samples = whole("sample", sample, _limits.samples_max - 1, 0) + 1
    place = pixel_message(pixel)
    unused = {"environment_rotate": 0.0, "noise": 0.0, "tonemap": "", "exposure": ""}
    return {**film_message(integrator, samples, seed, {**light, **unused}),
            "environment": environment, "encode": f"path+{place['pixel_x']},{place['pixel_y']}"}


def receive_document(connection: Connection, request: str, message: Message, progress: Progress,
                     seconds: float, origin: Optional[Array]) -> tuple[dict[str, Any], Outcome]:
    """The document that such a request is answered with, and what ran."""
    answer = Payload("json", {"width": 1, "height": 1, "encode": "json"}, origin)
    text = answer.receive(connection, request, message, progress, seconds)
    try:
        document = json.loads(text)
        document = _shown(document)
    except (ValueError, RecursionError):
        document = None
    if not isinstance(document, dict):
        raise ProtocolError("the daemon sent something else than a JSON document")
    return document, answer.outcome


def _shown(value: Any) -> Any:
    """The value with all its texts, and the names of members, as shown_text() makes them."""
    if isinstance(value, dict):
        return {shown_text(name): _shown(member) for name, member in value.items()}
    if isinstance(value, list):
        return [_shown(item) for item in value]
    return shown_text(value) if isinstance(value, str) else value
