"""The files that the files of a scene name, read from text that may be hostile."""
from __future__ import annotations

import json
from typing import Any, Iterator

from .gltf import JSON_BYTES_MAX, file_names
from .obj import file_of_name, names_in

COMPOSITION = ".rnscene.json"


def named_files(file: str, data: bytes) -> dict[str, str]:
    """Returns what a .gltf, .glb, .obj, .mtl or .rnscene.json names, and what kind of file each is
    that the scene can do without: "picture", "file", or "" for none. `file` is its name beneath the
    scene's folder; names outside of that folder are left out: the daemon complains if it needs them.
    InvalidError for a glTF that is none; the daemon says what is wrong with a composition."""
    if file.lower().endswith((".glb", ".gltf")):
        folder = file[:file.rfind("/") + 1]
        return {folder + name: "picture" if is_picture else ""
                for name, is_picture in file_names(data, file.lower().endswith(".glb")).items()}
    if not file.endswith(COMPOSITION):
        return dict.fromkeys(names_in(file, data), "file")
    try:
        root = json.loads(data[:JSON_BYTES_MAX])
        names = [file_of_name(file, text) for text in _texts(root)]
    except (ValueError, RecursionError):
        return {}
    return {name: "" for name in names if name is not None}


def _texts(value: Any) -> Iterator[str]:
    """The texts of the members `file` and `matrices`, wherever they stand."""
    if isinstance(value, list):
        for item in value:
            yield from _texts(item)
    elif isinstance(value, dict):
        for key, item in value.items():
            if key in ("file", "matrices") and isinstance(item, str):
                yield item
            else:
                yield from _texts(item)
