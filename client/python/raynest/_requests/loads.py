"""The message of a Load, from files, triangles or parts."""
from __future__ import annotations

import hashlib
import os
from typing import Any, Callable, Mapping, NamedTuple, Optional, Sequence, Union

import numpy as np

from .._net.control import Message
from ..errors import UsageError
from .arguments import Masks, mask_rules, real
from .composed import composition_of
from .files import path_text
from .gltf import mesh_files
from .materials import Mesh, checked
from .parts import parts_glb
from .places import read_parts
from .precision import ROUNDING_WORDS
from .principals import split_principals
from .rays import vector
from .upload import File, Read, Upload, gather, upload_of


class Load(NamedTuple):
    """A Load, what reads its files, the words of those of the daemon's warnings that the client puts better, and what is
    told which files the daemon wants, before any of them is read."""

    message: Message
    read: Read
    hides: str = ""
    need: Callable[[Sequence[int]], None] = lambda _numbers: None


def load_of_file(source: Union[str, os.PathLike[str]], name: Optional[str] = None, *,
                 data: Optional[memoryview] = None, origin: Any = None, replace: bool = False, build: str = "medium", primitive: str = "",
                 instances: Union[str, os.PathLike[str]] = "", masks: Masks = (), unit: Union[str, float] = 1,
                 up: str = "y", radius: float = 0, spacing: float = 0, variant: str = "",
                 share: Union[str, Sequence[str]] = ()) -> Load:
    """As Client.load() has it. `data` are the bytes of a file that names no others, in the place of `source`."""
    if hasattr(source, "vertices") and hasattr(source, "faces"):
        raise TypeError("source is a mesh: pass mesh.vertices and mesh.faces to Client.mesh()")
    if data is not None:
        upload = upload_of(data, primitive)
    else:
        upload = gather(path_text("source", source), primitive, path_text("instances", instances))
    if name is not None:
        upload = upload._replace(scene_name=name)
    elif upload.files and not upload.scene_name:
        raise UsageError(f"a scene of {source!s} has no name of its own: pass name=")
    chosen = isinstance(origin, str) and origin == "auto"
    return Load({
        **upload.message(), **_origin_message(None if chosen else origin), "replace": replace, "build": build,
        "primitive": primitive, "origin_auto": chosen, "unit": _metres(unit), "up": _axis(up),
        "radius": radius, "spacing": spacing, "variant": variant, "masks": mask_rules(masks),
        "share": split_principals(share) if isinstance(share, str) else list(share)}, upload.read)


def load_of_mesh(vertices: Any, faces: Any = None, name: Optional[str] = None, *, material: Any = None,
                 origin: Any = None, keep: bool = False, replace: bool = False, build: str = "medium", up: str = "y") -> Load:
    """As Client.mesh() has it."""
    if faces is None and hasattr(vertices, "vertices") and hasattr(vertices, "faces"):
        raise TypeError("vertices is a mesh: pass mesh.vertices and mesh.faces" +
                        (", with material=mesh.material" if isinstance(vertices, Mesh) else ""))
    if faces is None:
        raise TypeError("mesh() takes vertices and faces")
    shift = np.zeros(3) if origin is None else vector("origin", origin)
    glb, body = mesh_files(vertices, faces, "1.bin", shift, checked(material))
    upload = Upload("mesh.glb", name or "", (File("mesh.glb", glb), *([] if body is None else [File("1.bin", *body)])))
    message: Message = {**upload.message(), **_origin_message(shift), "replace": replace, "build": build,
                        "up": _axis(up), "temporary": not name and not keep}
    if not name:
        built = "" if build == "medium" else f"-{build}"
        message["name"] = _own_name(f"mesh-{_seal(message)}{built}", message)
    # The daemon sees float32 only, and cannot tell whether that lost anything.
    return Load(message, upload.read, ROUNDING_WORDS)


def load_of_parts(parts: Mapping[str, Any], places: Optional[Mapping[str, Any]] = None, name: Optional[str] = None,
                  *, origin: Any = None, keep: bool = False, replace: bool = False, build: str = "medium",
                  masks: Masks = (), up: str = "y") -> Load:
    """As Client.scene_of() has it."""
    made = read_parts(parts, places)
    rules, axis = mask_rules(masks), _axis(up)
    shift = None if origin is None else vector("origin", origin)
    if made.are_meshes:
        files = parts_glb(made.meshes, made.places, shift)
    else:
        if rules:
            raise UsageError("masks by path are for scenes of meshes without groups, whose places have no mask= or uid=: give "
                             "the places their masks, as raynest.Place('car', matrices, mask=2)")
        files, axis = composition_of(made, shift, up), ""
    upload = Upload(files[0].name, name or "", files)
    message: Message = {**upload.message(), **_origin_message(origin), "replace": replace, "build": build,
                        "masks": rules, "up": axis, "temporary": not name and not keep}
    if not name:
        message["name"] = _own_name(f"parts-{_seal(message)}", message)
    return Load(message, upload.read)


def _seal(message: Message) -> str:
    """Tells uploads of other content apart: the main file may name files alone."""
    digests: bytes = message["file_digests"]
    return (digests if len(message["file_names"]) == 1 else hashlib.sha256(digests).digest())[:8].hex()


def _own_name(name: str, message: Message) -> str:
    """Each scene that goes with its Scene object is another, so that its edits are its own. The daemon finds equal
    content under any name."""
    return f"{name}-{os.urandom(4).hex()}" if message["temporary"] else name


def _axis(up: str) -> str:
    """Returns the axis that points up, empty for the default. The daemon refuses what is none."""
    return "" if up == "y" else up


def _metres(unit: Union[str, float]) -> float:
    """Returns a unit in metres, 0 for one metre."""
    units = {"mm": 0.001, "cm": 0.01, "m": 1.0, "in": 0.0254, "ft": 0.3048}
    if isinstance(unit, str) and unit not in units:
        raise UsageError(f"unit must be one of {', '.join(units)}, or metres as a number, not {unit!r}")
    metres = units[unit] if isinstance(unit, str) else real("unit", unit)
    return 0.0 if metres == 1 else metres


def _origin_message(origin: Any) -> Message:
    shift = (0.0, 0.0, 0.0) if origin is None else vector("origin", origin).tolist()
    return dict(zip(("origin_x", "origin_y", "origin_z"), shift))
