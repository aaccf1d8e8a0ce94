"""The part of Scene that makes pictures."""
from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any, Callable, Iterator, Optional, Sequence, Union

from ._export import Exports
from ._net.control import Message
from ._net.frame import Array
from ._requests.arguments import Unpack, none_is_default
from ._requests.film import (Environment, EnvironmentFile, FilmOptions, Layers, film_message, is_lit,
                             layers_of, split_options, tells_settings, warn_if_incomplete, warn_of_options)
from ._requests.job import JobOptions, Outcome, Progress, SceneMoved, job_message
from ._requests.picture import Payload, camera_message, size_message, tile_message
from ._session import Session
from ._shutter import picture_in_motion, pieces_of, pixels_of
from .errors import InvalidError, UsageError
from .job import Job

# Time for encoding and sending a picture that its deadline ended.
GRACE_SECONDS = 600.0


class Renders(Exports):
    """Pictures of a scene."""

    name: str
    _client: Session
    if TYPE_CHECKING:
        _at: Callable[..., Any]
        trace: Callable[..., Any]
        _look_up: Callable[[JobOptions], None]
        _warn_of_eye: Callable[[Optional[Sequence[Any]]], None]

    @tells_settings
    @none_is_default
    def render(self, *, camera: Union[str, int] = "", look_at: Optional[Sequence[Any]] = None,
               fov: float = 0.0, size: tuple[int, int] = (960, 540), integrator: str = "primary",
               spp: int = 0, seed: int = 0, encode: str = "", progress: Progress = None,
               detach: bool = False, samples: Optional[int] = None,
               environment: Environment = "",
               environment_rotate: float = 0.0,
               sun: Optional[Sequence[float]] = None, noise: float = 0.0, tonemap: str = "",
               exposure: Union[str, float] = "", tile: Optional[Sequence[int]] = None,
               trajectory: Any = None, begin: float = 0.0, readout: float = 0.0,
               step_error: Optional[float] = None, **options: Unpack[FilmOptions]) -> Any:
        """Renders a picture. `integrator` "primary" gives base colours, darker where a surface turns away,
        as an Image: (height, width, 4) of u8, sRGB and alpha, row 0 on top, with png(). "ao", "direct" and
        "path" give a lit picture as Layers, a dict of arrays with linear rgba. `encode` "raw" gives an
        Image in both cases, "png" and "exr" the bytes of such a file. With `detach` the answer is a Job,
        whose fetch() returns the picture, and the bytes of an EXR in place of Layers.

        `camera` is a camera of the scene, by name or index, by default the first; or `look_at` is
        (eye, at) or (eye, at, up). `fov` is vertical, in degrees. `spp`, or `samples`, is the number
        of samples per pixel, by default 16, or 1024 with `noise`, which ends parts of the picture whose
        relative error is below it. `environment` is "sky", "none", "auto" (sky, unless the file has
        lights), or an EXR or HDR file, or its bytes. The middle of its picture lies at +X, and
        `environment_rotate` turns it by degrees from the north eastwards. `sun` is (azimuth from the north
        eastwards, elevation) in degrees. `tonemap` (agx, aces, reinhard, none) and `exposure` (stops, or
        "auto") are for Images and png.

        `tile` (x, y, width, height) makes only these pixels of the picture, with the bytes that they have
        in the whole; an Image or png of a lit tile needs `exposure` in stops. When a `deadline` passes, a
        lit picture comes with the samples that were made by then, and a warning.

        A camera that moves has a `trajectory` in place of camera and look_at, (times, poses): poses (K, 3, 4) from its
        space to the world, in which it looks along -z, with x to the right and y up. Row i of H is seen from where it
        is at begin + readout * i / H. With `step_error` an animated scene moves meanwhile, so that no part is further
        than that from where it should be. The integrator is "primary", the answer an Image or png, and `fov` by
        default 40.
        """
        settings, job = split_options(options)
        if trajectory is not None:
            others = {"camera": camera != "", "look_at": look_at is not None, "integrator": integrator != "primary",
                      "spp": spp, "samples": samples, "seed": seed, "detach": detach, **settings,
                      "environment": environment != "", "sun": sun is not None,
                      "environment_rotate": environment_rotate, "noise": noise, "tonemap": tonemap,
                      "exposure": exposure != "", "tile": tile is not None}

            def seen(rays: Any) -> Iterator[tuple[int, Array]]:
                for first, piece in pieces_of(rays):
                    yield first, pixels_of(self, piece, **job)
                    job["epoch"] = self._client.outcome["epoch"]    # all rows see one scene
            return picture_in_motion(seen, trajectory, begin, readout, step_error, fov, size, encode, progress, others)
        if begin or readout or step_error is not None:
            raise UsageError("begin, readout and step_error are of a camera in motion: pass a trajectory, too")
        if spp and samples is not None:
            raise UsageError("spp and samples are two names for the samples per pixel: pass one of them")
        film = _Film(self, camera, look_at, fov, size, encode, detach, job, {
            "integrator": integrator, "spp": spp if samples is None else samples, "seed": seed,
            "environment": environment, "environment_rotate": environment_rotate, "sun": sun, "noise": noise,
            "tonemap": tonemap, "exposure": exposure, **settings}, tile)
        if detach:
            self._look_up(job)
        answer = self._at(None, lambda origin, _: film.ask(origin, progress), repeats=not detach)
        if not detach:
            self._client.outcome.warn_of_view()
            self._warn_of_eye(look_at)
            warn_of_options(self._client.outcome)
            warn_if_incomplete(self._client.outcome)
        return answer

    @none_is_default
    def render_stream(self, *, camera: Union[str, int] = "",
                      look_at: Optional[Sequence[Any]] = None, fov: float = 0.0,
                      size: tuple[int, int] = (960, 540), integrator: str = "path", spp: int = 0,
                      seed: int = 0, encode: str = "", progress: Progress = None, environment: Environment = "",
                      environment_rotate: float = 0.0,
                      sun: Optional[Sequence[float]] = None, noise: float = 0.0,
                      tonemap: str = "", exposure: Union[str, float] = "",
                      **options: Unpack[FilmOptions]) -> Iterator[Any]:
        """Yields a lit picture again and again while it is refined: with 1, 2, 4, ... and at last `spp`
        samples per pixel. Arguments and pictures are those of render(). Until the loop ends, the
        connection takes no other request; leaving the loop cancels the job."""
        settings, job = split_options(options)
        film = _Film(self, camera, look_at, fov, size, encode, False, job, {
            "integrator": integrator, "spp": spp, "seed": seed, "environment": environment,
            "environment_rotate": environment_rotate, "sun": sun, "noise": noise, "tonemap": tonemap,
            "exposure": exposure, **settings})
        if not is_lit(integrator):
            raise UsageError("primary has one sample per pixel, which nothing refines: use render()")
        yield from self._at(None, lambda origin, _: film.stream(origin, progress))
        warn_of_options(self._client.outcome)
        warn_if_incomplete(self._client.outcome)


class _Film:
    """A request for a picture."""

    def __init__(self, scene: Renders, camera: Union[str, int], look_at: Optional[Sequence[Any]],
                 fov: float, size: tuple[int, int], encode: str, detach: bool, job: JobOptions,
                 fields: dict[str, Any], tile: Optional[Sequence[int]] = None) -> None:
        integrator = fields.pop("integrator")
        self._lit = is_lit(integrator)
        self._scene, self._view, self._job = scene, (camera, look_at, fov), job
        self._detach = detach
        encode = encode or ("layers" if self._lit else "raw")
        if encode == "layers" and not self._lit:
            raise UsageError("primary has no layers: pass encode='raw', 'png' or 'exr'")
        self._layers = encode == "layers"
        self._shape: Message = {**size_message(size), "encode": "exr" if self._layers else encode}
        self._place, self._payload = tile_message(tile, self._shape)
        self._file = EnvironmentFile(fields.pop("environment"))
        if self._file.message["environment"] and not self._lit:
            raise UsageError("environment: only of a lit picture; pass integrator='path'")
        self._fields = film_message(integrator, fields.pop("spp"), fields.pop("seed"), fields)

    def _message(self, origin: Array) -> tuple[Message, float]:
        """The request, and the seconds after which a daemon without an answer counts as lost."""
        options = job_message(self._scene.name, self._job)
        camera, look_at, fov = self._view
        message: Message = {"job": {**options, "detach": self._detach}, **self._shape, **self._place,
                            "camera": camera_message(camera, look_at, fov, origin),
                            **self._fields, **self._file.message}
        deadline = options["deadline_ms"]
        if not self._lit or not deadline:
            return message, deadline / 1000
        message["job"]["deadline_ms"] = 0
        message["best_by_ms"] = deadline
        return message, deadline / 1000 + GRACE_SECONDS

    def ask(self, origin: Array, progress: Progress) -> Any:
        message, seconds = self._message(origin)
        client = self._scene._client
        self._file.again()

        def feed() -> None:
            self._file.feed(client.connection)
        if self._detach:
            return Job(client, client.connection.ask("Render", message, "Detached", feed)["job"])
        picture = self._picture(origin)
        result = picture.receive(client.connection, "Render", message, progress, seconds, feed)
        client.outcome = picture.outcome
        return self._shown(result, picture, True)

    def stream(self, origin: Array, progress: Progress) -> Iterator[Any]:
        message, seconds = self._message(origin)
        client = self._scene._client
        picture = self._picture(origin)
        passes = picture.passes(client.connection, "Render", {**message, "progressive": True},
                                progress, seconds, lambda: self._file.feed(client.connection),
                                streams=True)
        try:
            with contextlib.closing(passes):  # type: ignore[type-var]
                for _ in passes:
                    yield self._shown(picture.result(), picture, False)
        except SceneMoved:
            raise InvalidError(f"the scene '{self._scene.name}' was replaced by one with another "
                               "origin; ask again", "SCENE_UNKNOWN") from None
        client.outcome = picture.outcome
        yield self._shown(picture.result(), picture, True)

    def _picture(self, origin: Array) -> Payload:
        return Payload("render", self._payload, None if self._view[1] is None else origin)

    def _shown(self, result: Any, picture: Payload, last: bool) -> Any:
        if not self._layers:
            return result
        return layers_of(result, picture.outcome, last, self._payload["width"] * self._payload["height"])


def read_layers(file: bytes) -> Layers:
    """Returns the layers of a lit picture's EXR, such as that of a detached job. P is relative to the
    scene's origin."""
    return layers_of(file, Outcome(), True)

