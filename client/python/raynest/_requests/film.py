"""Lit pictures: the fields of their requests, and their layers as arrays."""
from __future__ import annotations

import inspect
import os
from typing import Any, Callable, Optional, TypeVar, Union, cast

import numpy as np

from .. import _limits
from .._lists import INTEGRATOR_SETTINGS, IntegratorSettings
from .._net.control import Message
from .._net.frame import Array
from ..errors import InvalidError, RayWarning, UsageError, warn
from .arguments import count_of, has_shape, numbers, real, whole
from .exr import read_exr
from .files import path_text, read_file
from .job import JobOptions, Outcome
from .upload import FileSender

ENVIRONMENT_BYTES_MAX = 512 << 20
LIT_SAMPLES = 16
LIT_CHANNELS_MAX = 64
# At most, of a picture that ends where its error is small enough.
NOISE_SAMPLES = 1024
# Layers of several channels, by the name under which they are returned.
GROUPS = {"rgba": ("R", "G", "B", "A"), "albedo": ("albedo.R", "albedo.G", "albedo.B"),
          "N": ("N.X", "N.Y", "N.Z"), "P": ("P.X", "P.Y", "P.Z")}

# Values of a pixel without a sample, where they are not 0.
UNSAMPLED: dict[str, Any] = {"Z": np.float32(1e10), **dict.fromkeys(("instance", "mesh", "material"), np.uint32(0xFFFFFFFF))}

Environment = Union[str, bytes, os.PathLike[str]]
Call = TypeVar("Call", bound=Callable[..., Any])


class FilmOptions(JobOptions, IntegratorSettings, total=False):
    """Keyword arguments of render() and explain()."""


def tells_settings(function: Call) -> Call:
    """Writes the settings of integrators behind the help of a function."""
    settings = [f"{name}, {text}" for name, (_, text) in INTEGRATOR_SETTINGS.items()]
    help_of_all = inspect.cleandoc(function.__doc__ or "")
    function.__doc__ = "\n".join([help_of_all, "", "Settings of integrators:", *settings])
    return function


def split_options(options: FilmOptions) -> tuple[dict[str, Any], JobOptions]:
    """Returns the settings of the integrator, 0 where they are not given, and the other options."""
    job: dict[str, Any] = {**options}
    given = {name: job.pop(name, None) for name in INTEGRATOR_SETTINGS}
    return {name: 0 if value is None else value for name, value in given.items()}, cast(JobOptions, job)


class Layers(dict[str, Array]):
    """The layers of a lit picture, row 0 on top: rgba (height, width, 4), linear and premultiplied;
    albedo, N and P (height, width, 3); Z, instance, mesh, material, samples, variance and dropped
    (height, width). P is in the world, in float64 where the scene has an origin. `last` says whether
    no better picture follows, `outcome` what ran, `texts` what the file's header says."""

    last = True
    outcome: Outcome
    texts: dict[str, str]


def is_lit(integrator: str) -> bool:
    return integrator != "primary"


def samples_asked(spp: int, noise: Any) -> int:
    """How many samples a lit picture is asked for."""
    return spp or (NOISE_SAMPLES if noise else LIT_SAMPLES)


def given_of(options: dict[str, Any]) -> list[str]:
    """The names of options that are not at their defaults: None, "" and 0."""
    return sorted(name for name, value in options.items()
                  if np.ndim(value) != 0 or value is not None and value != "" and value != 0)


def film_message(integrator: str, spp: int, seed: int, fields: dict[str, Any]) -> Message:
    """The fields of a Render beside those of all pictures."""
    samples = samples_asked(spp, fields["noise"]) if is_lit(integrator) else spp or 1
    message: Message = {"integrator": integrator, "seed": seed,
                        "samples": count_of("spp", samples, _limits.samples_max)}
    if not is_lit(integrator):
        # An exposure of 0 stops is one.
        given = given_of({"seed": seed, **fields, "exposure": str(fields["exposure"])})
        if given:
            raise UsageError(f"{', '.join(given)}: only of a lit picture; pass integrator='path'")
        return message
    for name, (most, _) in INTEGRATOR_SETTINGS.items():
        message[name] = real(name, fields[name]) if most is None else whole(name, fields[name], most, 0)
    for name in ("noise", "environment_rotate"):
        message[name] = real(name, fields[name])
    message["tonemap"] = fields["tonemap"]
    exposure = fields["exposure"]
    message["exposure"] = exposure if isinstance(exposure, str) else repr(real("exposure", exposure))
    if fields["sun"] is not None:
        azimuth, elevation = sun_angles(fields["sun"])
        message.update(sun=True, sun_azimuth=azimuth, sun_elevation=elevation)
    return message


def sun_angles(sun: Any) -> tuple[float, float]:
    if isinstance(sun, str) or not has_shape(sun, 2):
        raise UsageError(f"sun of {sun!r}: it must be (azimuth, elevation) in degrees")
    azimuth, elevation = numbers("sun", sun).astype(np.float64).tolist()
    if not abs(elevation) <= 90:
        raise UsageError(f"sun of {sun!r}: its elevation must lie between -90 and 90 degrees")
    return azimuth, elevation


class EnvironmentFile(FileSender):
    """The environment of a request: a word, or a file that is sent with it."""

    def __init__(self, environment: Optional[Environment]) -> None:
        super().__init__(np.empty(0, np.uint8), 1)
        self.message: Message = {}
        if environment is None or environment in ("", "auto", "sky", "none"):
            self.message = {"environment": environment or ""}
            return
        name = "the environment" if isinstance(environment, bytes) else path_text("environment", environment)
        data = environment if isinstance(environment, bytes) else read_file(name, ENVIRONMENT_BYTES_MAX)
        if not data:
            raise InvalidError(f"{name} is empty", "FILE_INVALID")
        if not data.startswith((b"\x76\x2f\x31\x01", b"#?RADIANCE", b"#?RGBE")):
            raise UsageError(f"{name} is neither an EXR nor an HDR: convert it to one of them")
        self._data = np.frombuffer(data, np.uint8)
        self.message = {"environment": "picture", "environment_bytes": len(data)}

    @property
    def data(self) -> Array:
        """The bytes of the file; none of a word."""
        return self._data


def layers_of(file: bytes, outcome: Outcome, last: bool, pixels_max: int = _limits.picture_pixels_max) -> Layers:
    channels, texts = read_exr(file, pixels_max, LIT_CHANNELS_MAX)
    layers = Layers()
    for name, members in GROUPS.items():
        if all(member in channels for member in members):
            layers[name] = np.stack([channels.pop(member) for member in members], -1)
    layers.update(channels)
    origin = np.array(outcome.get("origin", (0, 0, 0)))
    if "P" in layers and origin.any():
        layers["P"] = np.where((layers["Z"] < 1e10)[..., None], layers["P"] + origin, 0)
    layers.last, layers.outcome, layers.texts = last, outcome, texts
    return layers


def warn_of_options(outcome: Outcome) -> None:
    """Warns of options that changed nothing or did not suffice."""
    for note in outcome.get("notes", ()):
        if note.startswith(("no effect ", "the error ", "the environment ", "light starts ")):
            warn(note, RayWarning)


def warn_if_incomplete(outcome: Outcome) -> None:
    if outcome.get("incomplete"):
        warn(f"the deadline passed: pixels of the picture have {outcome.get('samples', 0)} samples or "
             "more, fewer than it was asked for", RayWarning)

