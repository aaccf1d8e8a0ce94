"""The argument `material` of meshes: what their surface looks like, as glTF has it."""
from __future__ import annotations

import dataclasses
import reprlib
from typing import Any, Iterable, Optional

import numpy as np

from .arguments import check_name, float32, numbers, real
from .._net.frame import Array
from ..errors import UsageError


@dataclasses.dataclass(frozen=True)
class Material:
    """The looks of a mesh, as raynest.Mesh(vertices, faces, material=) and Client.mesh() take it. All are factors from 0
    to 1, as in glTF. `base_colour` (r, g, b) and `emissive`, the light that it gives off, are linear, not the values of
    a colour picker. A fourth number of `base_colour` is alpha: below 1, pictures with light see through it, and
    Edit.set_material() refuses it. In a scene a name stands for one material; equal ones are the same."""

    name: str
    base_colour: Any = (1, 1, 1)
    metallic: Any = 0
    roughness: Any = 1
    emissive: Any = (0, 0, 0)

    def __post_init__(self) -> None:
        check_name("a material", self.name)
        colour = _colour("base_colour", self.base_colour, 3, 4)
        values = {"base_colour": colour if len(colour) == 4 else (*colour, 1.0),
                  "metallic": _factor("metallic", self.metallic), "roughness": _factor("roughness", self.roughness),
                  "emissive": _colour("emissive", self.emissive, 3)}
        for name, value in values.items():
            object.__setattr__(self, name, value)   # as they travel: materials that are equal there are equal here

    def as_gltf(self) -> dict[str, Any]:
        return {"name": self.name, "emissiveFactor": self.emissive, **({"alphaMode": "BLEND"} if self.base_colour[3] < 1 else {}),
                "pbrMetallicRoughness": {"baseColorFactor": self.base_colour, "metallicFactor": self.metallic,
                                         "roughnessFactor": self.roughness}}


class Mesh:
    """A part of scene_of(): triangles as Client.mesh() takes them, vertices (N, 3) and faces (M, 3), with a raynest.Material."""

    def __init__(self, vertices: Any, faces: Any, material: Optional[Material] = None) -> None:
        self.vertices, self.faces, self.material = vertices, faces, checked(material)

    def __repr__(self) -> str:
        return f"<raynest.Mesh of {self.material!r}>" if self.material else "<raynest.Mesh>"


def checked(material: Any) -> Optional[Material]:
    if material is not None and not isinstance(material, Material):
        raise TypeError(f"material of {reprlib.repr(material)}: it must be a raynest.Material, as raynest.Material('steel', "
                        "(0.6, 0.6, 0.6))")
    return material


def distinct(meshes: Iterable[Mesh]) -> list[Material]:
    """Returns each material once, in the order in which meshes have them."""
    found = list(dict.fromkeys(mesh.material for mesh in meshes if mesh.material))
    of_name: dict[str, Material] = {}
    for material in found:
        if of_name.setdefault(material.name, material) != material:
            raise UsageError(f"two different materials have the name {material.name!r}: give one of them another")
    return found


def _colour(what: str, value: Any, *counts: int) -> tuple[float, ...]:
    given = numbers(what, value)
    if given.ndim != 1 or given.size not in counts:
        raise UsageError(f"{what} has shape {given.shape}: it must be {' or '.join(map(str, counts))} numbers")
    return _factors(f"{what} of {reprlib.repr(value)}: its numbers must be from 0 to 1; divide bytes by 255, then make them "
                    "linear", given)


def _factor(what: str, value: Any) -> float:
    return _factors(f"{what} of {reprlib.repr(value)}: it must be from 0 to 1", np.array([real(what, value)]))[0]


def _factors(refusal: str, given: Array) -> tuple[float, ...]:
    if not ((given >= 0) & (given <= 1)).all():
        raise UsageError(refusal)
    return tuple((float32(given) + np.float32(0)).tolist())     # without -0
