"""A scene as a file that other programs read."""
from __future__ import annotations

import os
import pathlib
from typing import Any, Optional, Union

from ._requests.arguments import real
from ._requests.files import path_text
from ._requests.job import Progress
from ._requests.picture import Payload
from ._session import Session
from .errors import InvalidError, SceneWarning, UsageError, warn

COMPOSITION = ".rnscene.json"


class Exports:
    """The part of a scene that writes it."""

    name: str
    _client: Session

    def export(self, path: Union[str, os.PathLike[str]], *, epoch: int = 0, time: Optional[float] = None,
               animation: Union[str, int] = "", progress: Progress = None) -> dict[str, Any]:
        """Writes the scene to a .glb (binary glTF 2.0), or to a .rnscene.json, which keeps the scene's origin,
        with a .glb beside it. If there is no such .rnscene.json yet, that .glb must not exist either. With `time` it
        is the scene at this second of its animation. Returns scene, epoch, hash, glb (its path), bytes and notes: what
        the file lacks. Warnings say that, too."""
        text = path_text("path", path)
        glb = text[:-len(COMPOSITION)] + ".glb" if text.endswith(COMPOSITION) else text
        if not glb.endswith(".glb") or os.path.basename(glb) == ".glb":
            raise UsageError(f"export to {text!r}: the name must end with .glb or {COMPOSITION}, after a name of its own")
        if glb != text and os.path.exists(glb) and not os.path.exists(text):
            raise UsageError(f"{glb!r} exists, and the composition would replace it: name another file, or move it away")
        if glb != text and set(os.path.basename(glb)) & set(":\\"):
            raise UsageError(f"a composition cannot name {os.path.basename(glb)!r}: leave ':' and '\\' out of the name")
        message: dict[str, Any] = {"scene": self.name, "epoch": epoch, "format": "glb", "animation": str(animation)}
        if time is not None:
            message.update(timed=True, time=real("time", time))
        file = self._file(message, progress)
        composition: dict[str, Any] = {}
        if glb != text:
            # It says where the scene lies, which edits do not change.
            message.update(format="rnscene.json", file=os.path.basename(glb))
            composition = self._file(message, progress)
            if composition["origin"] != file["origin"]:
                raise InvalidError(f"the scene {self.name!r} was replaced while it was exported: export it again")
        pathlib.Path(glb).write_bytes(file["data"])
        if glb != text:
            pathlib.Path(text).write_bytes(composition["data"])
        del file["origin"]
        for note in file["notes"]:
            warn(note, SceneWarning)
        return {"glb": glb, "bytes": len(file.pop("data")), **file}

    def _file(self, message: dict[str, Any], progress: Progress) -> dict[str, Any]:
        answer = Payload("file", {"width": 1, "height": 1, "encode": "file"})
        data = answer.receive(self._client.connection, "Export", message, progress)
        outcome = answer.outcome
        return {"data": data, **{key: outcome[key] for key in ("scene", "epoch", "hash", "notes", "origin")}}
