"""The daemon's words in those of this package."""
from __future__ import annotations

import re

WORDS = {
    # requests
    "CancelJob": "Job.cancel()", "Fetch": "Job.fetch()", "Info": "Scene.info",
    "Jobs": "Client.jobs()", "Load": "Client.load()", "Scenes": "Client.scenes()",
    "Unload": "Scene.unload()", "Variants": "Client.variants()", "Wait": "Job.wait()",
    # fields
    "camera": "camera=", "deadline_ms": "deadline=", "epoch": "epoch=", "look_at": "look_at=",
    "mask": "mask=", "name": "name=", "origin": "origin=", "primitive": "primitive=",
    "replace": "replace=True",
    "samples": "spp=", "size": "size=", "traversal": "traversal=", "worker": "worker="}


def in_own_words(message: str) -> str:
    """A message of the daemon, in which each word between backticks is a field or a message of the
    protocol (PROTOCOL.md, 9), with this package's spelling in its place."""
    message = re.sub(r"`origin` ([-+.,e\d]+)", r"origin=(\1)", message)
    return re.sub("`([A-Za-z_]+)`", lambda match: WORDS.get(match[1], match[0]), message)
