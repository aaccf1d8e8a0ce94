"""Translates the protocol's words in messages to those of this package."""
from __future__ import annotations

import re

WORDS = {
    # requests
    "CancelJob": "Job.cancel()", "Edit": "Scene.edit()", "Export": "Scene.export()",
    "Fetch": "Job.fetch()",
    "Info": "Scene.info",
    "Jobs": "Client.jobs()", "Load": "Client.load()", "Pin": "Scene.pin()", "Scenes": "Client.scenes()",
    "Unload": "Scene.unload()", "Variants": "Client.variants()", "Wait": "Job.wait()",
    # fields
    "animation": "animation=", "ao_distance": "ao_distance=", "camera": "camera=", "count": "count=",
    "deadline_ms": "deadline=", "depth": "depth=",
    "detach": "detach=", "environment": "environment=", "environment_rotate": "environment_rotate=",
    "epoch": "epoch=",
    "exposure": "exposure=", "hide": "hide=", "keep": "keep=True", "level": "level=",
    "look_at": "look_at=", "mask": "mask=", "name": "name=", "noise": "noise=",
    "only": "only=", "origin": "origin=", "palette": "palette=", "primitive": "primitive=",
    "progressive": "render_stream()", "radius": "radius=", "replace": "replace=True",
    "samples": "spp=", "scale": "scale=", "seed": "seed=", "size": "size=",
    "skip_hidden_boxes": "skip_hidden_boxes=", "spacing": "spacing=", "sun": "sun=", "time": "time=",
    "tonemap": "tonemap=", "top": "top=",
    "traversal": "traversal=", "unit": "unit=", "up": "up=", "variant": "variant=", "worker": "worker="}


def _points(numbers: str) -> str:
    parts = numbers.split(",")
    points = ", ".join(f"({', '.join(parts[at:at + 3])})" for at in range(0, len(parts), 3))
    return f"({points})"


def localize_message(message: str) -> str:
    """Replaces the words between backticks in a message of the daemon, which are fields or messages
    of the protocol (PROTOCOL.md, 9), by this package's spelling."""
    message = re.sub(r"`origin` ([-+.,e\d]+)", r"origin=(\1)", message)
    # Eye, point and, where there is one, up.
    message = re.sub(r"`look_at` ([-+.,e\d]+)", lambda match: "look_at=" + _points(match[1]), message)
    return re.sub("`([A-Za-z_]+)`", lambda match: WORDS.get(match[1], match[0]), message)
