"""A scene of the daemon: traces rays, makes pictures, and describes its contents."""
from __future__ import annotations

import contextlib
import dataclasses
import functools
from types import TracebackType
from typing import Any, Callable, Generator, Iterator, Literal, Mapping, Optional, Sequence, Union, cast, overload

import numpy as np

from . import _limits
from ._net.control import Message
from ._net.frame import Array
from ._render import Renders
from ._requests.arguments import Unpack, has_shape, is_several, none_is_default, numbers, real, whole
from ._requests.columns import Columns, Whole, anywhere, as_usual
from ._requests.explain import check_explain, path_message, pixel_message, ray_message, receive_document
from ._requests.film import FilmOptions, split_options, tells_settings, warn_of_options
from ._requests.job import JobOptions, Outcome, Progress, SceneMoved, job_message, other_message
from ._requests.picture import Payload, camera_message, size_message, tile_message
from ._requests.precision import Rounding, rounded_rays
from ._requests.query import Query, query_message
from ._requests.rays import Rays, Source, Starts, flat_pairs, masked, spread, vector
from ._requests.sight import Segments
from ._requests.words import rows_of, scene_info
from ._session import Session
from ._timed import trace_at_times
from .edits import Editable
from .errors import InvalidError, RayWarning, UsageError, warn
from .generators import Generator as RayGenerator, one_sample
from .images import HeatView, with_view
from .job import Job


class Scene(Renders, Editable):
    """A scene, made by Client.load(), mesh() or scene(). Rays, cameras and positions are in the
    world: the scene's origin is subtracted before they are sent and added to answers, in float64."""

    def __init__(self, client: Session, name: str,
                 info: Optional[dict[str, Any]] = None) -> None:
        self.name = name
        self._client = client
        self._origin = np.zeros(3)
        self._box: Optional[Array] = None   # its corners, in the world
        self.made: Optional[tuple[Any, dict[str, Any]]] = None  # what it is made from, and with which options
        if info:
            self._learn(info)
        self._open = True
        client.handles.enter(name)

    def __del__(self) -> None:
        if getattr(self, "_open", False):
            self._client.handles.leave(self.name)

    def __copy__(self) -> Scene:
        """Another object of the same scene: it holds the scene as this one does."""
        twin = Scene(self._client, self.name)
        twin._origin, twin._box, twin.made = self._origin, self._box, self.made
        return twin

    def close(self) -> None:
        """Ends this object's use of the scene. A mesh without a name is unloaded, unless another Scene object or connection
        holds it; a scene with a name stays."""
        if self._open:
            self._open = False
            self.made = None        # it may keep large arrays
            self._client.handles.leave(self.name)
            self._client.drop_unused()

    def __enter__(self) -> Scene:
        return self

    def __exit__(self, kind: Optional[type[BaseException]], error: Optional[BaseException],
                 traceback: Optional[TracebackType]) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<raynest.Scene {self.name!r} at {self._client.uri}>"

    @property
    def origin(self) -> Array:
        """The point, three float64, that was subtracted from coordinates when the scene was loaded."""
        return self._origin.copy()

    # ---- rays -----------------------------------------------------------------------------------

    @overload
    def trace(self, rays: Any, directions: Any = None, *, kind: Optional[str] = None,
              fields: Union[str, Sequence[str], None] = None, max_hits: Optional[int] = None,
              reduce: str = "", origin: Any = None, progress: Progress = None,
              detach: Literal[False] = False, **job: Unpack[JobOptions]) -> Columns: ...
    @overload
    def trace(self, rays: Any, directions: Any = None, *, kind: Optional[str] = None,
              fields: Union[str, Sequence[str], None] = None, max_hits: Optional[int] = None,
              reduce: str = "", origin: Any = None, progress: Progress = None,
              detach: Literal[True], **job: Unpack[JobOptions]) -> Job: ...

    def trace(self, rays: Any, directions: Any = None, *, kind: Optional[str] = None,
              fields: Union[str, Sequence[str], None] = None, max_hits: Optional[int] = None,
              reduce: str = "", origin: Any = None, progress: Progress = None,
              detach: bool = False, **job: Unpack[JobOptions]) -> Union[Columns, Job]:
        """Traces rays and returns their hits as a dict of arrays with a row per ray. With `detach` it returns a Job that
        goes on without this client; its fetch() returns the dict.

        `rays` is (N, 6) [ox oy oz dx dy dz], (N, 8) [ox oy oz tmin dx dy dz tmax], or origins (N, 3) with `directions`
        (N, 3); one of the latter may be a single (3,). One ray may also be (6,) or (8,); [] has no rays; masked rows are
        invalid rays. Directions need not have unit length: t is in units of theirs. float32 arrays of the first two
        forms, and directions with one common origin, are sent without a copy; all others are converted while they are
        sent. A generator of raynest.generators in place of `rays` makes them in the daemon. `mask` may be an array (N,)
        with a mask for each ray that is sent, at most 64 different ones: a ray enters the instances that share a bit
        with its mask. `time` may be an array (N,), too: each ray that is sent meets the scene as its animation has it
        then, in a request for each time, or with `time_step` for each stretch of so many seconds, at its middle.

        If the scene has an origin, it is subtracted first, in float64. `origin` replaces it for this call: with
        (0, 0, 0), rays and answers are relative to the scene's origin. A detached job takes no `origin`.

        kind "closest", the default, gives the nearest hit; "any" only whether there is one (column hit); "multi" the
        nearest `max_hits` (8); "all" every hit. A ray with more than `max_hits` (4096) in "all" keeps the nearest, has
        flag 2, and counts in Client.outcome["truncated"]. In "multi" and "all" the hits of ray i are rows ray_splits[i]
        to ray_splits[i + 1] of the hit columns; a ray through an edge that triangles share hits each of them, at one t.
        "null" traces nothing and answers misses. `fields` are the columns, by default t prim geom path uv, and for "any"
        hit. A miss has t = inf and ids of all ones. `reduce` "hit_fraction", for generators.hemisphere(), gives one
        column of that name: the share of each point's rays that hit, and 0 for an invalid point or normal.
        "visible_pixels" gives the columns path, ascending, and pixels, the number of rays that meet that path first.
        """
        if is_several("time", job.get("time")):
            return trace_at_times(self.trace, lambda: self._client.outcome, rays, directions, dict(
                job, kind=kind, fields=fields, max_hits=max_hits, reduce=reduce, origin=origin, progress=progress, detach=detach))
        if detach:
            if origin is not None:
                raise UsageError("a detached job answers in world coordinates: pass those and leave "
                                 "origin= away")
            self._look_up(job)
        answer: Union[Columns, Job] = self._at(origin, lambda shift, expected: self._trace(
            self._source(rays, directions, shift), shift, expected, kind, fields, max_hits, job,
            reduce, progress, detach), repeats=not detach)
        if not detach:
            self._client.outcome.warn_of_rays()
        return answer

    def _trace(self, source: Source, origin: Array, expected: bool, kind: Optional[str],
               fields: Union[str, Sequence[str], None], max_hits: Optional[int], job: JobOptions,
               reduce: str, progress: Progress, detach: bool) -> Union[Columns, Job]:
        source, job = masked(source, job)
        fields, own = source.own_columns(fields)
        # A query needs at least one ray. For none, ask about an invalid one, so that errors and
        # dtypes are those of any other query.
        asked = source if source.count else dataclasses.replace(
            source, sent=Rays(np.zeros((1, 8), np.float32)), count=1, masks=None,
            generator=source.generator and one_sample(source.generator))
        query = self._query(asked, origin, expected, kind, fields, max_hits, job, reduce)
        if detach:
            if source.count == 0:
                raise UsageError("a detached job needs rays: pass some, or leave detach away")
            number = query.detach()
            self._warn_of_rounding(source.starts)
            return Job(self._client, number, own)
        answer = Whole(query.rows, reduce)
        with self._client.connection.interrupts, contextlib.closing(query.chunks(answer.place)) as chunks:
            for _ in chunks:
                if progress:
                    progress(query.answered, query.rows or query.answered, "tracing")
        self._client.outcome = query.outcome
        columns = answer.columns()
        if source.count == 0:
            query.outcome.pop("first_invalid", None)
            query.outcome.update(rays=0, misses=0, invalid=0)
            columns = {name: column[:int(name == "ray_splits")] for name, column in columns.items()}
        query.outcome.rounding = self._warn_of_rounding(source.starts)
        return columns if not own else {**columns, **own}

    def stream(self, rays: Any, directions: Any = None, *, kind: Optional[str] = None,
               fields: Union[str, Sequence[str], None] = None, max_hits: Optional[int] = None,
               origin: Any = None,
               **job: Unpack[JobOptions]) -> Generator[tuple[int, Columns], None, None]:
        """Like trace(), but yields (first_ray, columns) for some thousand rays at a time as they are
        traced, in any order. Leaving the loop cancels the rest. While the stream is open the client
        takes no other request: calls from this and from other threads raise UsageError. connect()
        once more for those.

        `rays` may be an iterator of arrays or generators. Each item is a query; all see the same
        epoch, and first_ray counts on. If the scene is replaced meanwhile, the next query fails
        with InvalidError, SCENE_UNKNOWN. A query starts when the one before is answered, so items
        should have 100,000 rays or more to keep the daemon busy. Masks of single rays must then be an
        iterator of arrays, too.
        """
        if isinstance(rays, (list, tuple)) and rays and (
                isinstance(rays[0], RayGenerator) or np.ndim(rays[0]) > 1):
            raise UsageError("a list of blocks is not an iterator of them: pass iter(blocks)")
        asked = {"origin": origin, "kind": kind, "fields": fields, "max_hits": max_hits}
        chosen, masks = job.get("epoch"), job.get("mask")
        streamed = Outcome()
        for block in rays if isinstance(rays, Iterator) else (rays,):
            if isinstance(masks, Iterator):
                job["mask"] = next(masks, ())
            try:
                outcome = yield from self._stream(block, directions, streamed.rays, asked, job)
            except InvalidError as error:
                if chosen or error.name != "SCENE_UNKNOWN" or not streamed:
                    raise
                raise InvalidError(f"the scene '{self.name}' was replaced or unloaded while it was "
                                   "streamed; begin the stream again", error.name) from None
            if outcome is not None:
                job["epoch"] = outcome.get("epoch")
                self._client.outcome = streamed = outcome.following(streamed)

    def _stream(self, rays: Any, directions: Any, before: int, asked: Mapping[str, Any],
                job: JobOptions) -> Generator[tuple[int, Columns], None, Optional[Outcome]]:
        """A block of a stream, after `before` rays. Returns the block's outcome; None without rays."""
        try:
            shift = self._shift(asked["origin"])
            source = self._source(rays, directions, shift)
            source, options = masked(source, job)
            fields, own = source.own_columns(asked["fields"])
            if source.count == 0:
                return None
            query = self._query(source, shift, asked["origin"] is None, asked["kind"],
                                fields, asked["max_hits"], options)
            with contextlib.closing(query.chunks(anywhere, streams=True)) as chunks:
                for chunk in chunks:
                    there = slice(chunk.first, chunk.first + chunk.count)
                    yield before + chunk.first, {**as_usual(chunk.columns),
                                                 **{name: column[there] for name, column in own.items()}}
        except SceneMoved as moved:  # before the first chunk
            self._moved(moved.origin)
            return (yield from self._stream(rays, directions, before, asked, job))
        query.outcome.warn_of_rays(before)
        self._warn_of_rounding(source.starts)
        return query.outcome

    @none_is_default
    def occluded(self, a: Any, b: Any, *, margin: Optional[float] = None,
                 margin_distance: Optional[float] = None, origin: Any = None,
                 progress: Progress = None, **job: Unpack[JobOptions]) -> Array:
        """Returns, as bool, whether anything lies between points a and b: (N, 3) each, or any two
        shapes (..., 3) that broadcast, so that a[:, None], b[None] asks for all pairs. A margin at
        both ends of each segment is left out, so that points on a surface do not hide themselves. It
        is `margin`, a share of the segment, or `margin_distance`, in the scene's units (metres in glTF).
        By default it is four steps of float32 at that end's coordinates, the scene's size and, at b, the
        segment's length: 0.3 mm in a scene of 500 m. Surfaces whose plane passes an end as closely hide
        nothing then, as a grazing line meets that of its end; this takes twice as long as with a margin
        of your own. The answer is False for a segment no longer than both margins, and for one with an end that
        is masked or not finite; a RayWarning counts the latter. `mask` is one number, or broadcasts to the
        shape of the answer."""
        a, b, shape = flat_pairs(a, b)
        if len(shape) > 1 and is_several("mask", job.get("mask")):
            job["mask"] = spread("mask", job["mask"], shape)

        def ask(shift: Array, expected: bool) -> Array:
            lines, outcomes = Segments(a, b, margin, margin_distance, shift, self._size()), list[Outcome]()

            def traced(rays: Rays, kind: str, fields: Sequence[str], job: JobOptions) -> Any:
                return self._trace(self._source(rays, None, shift), shift, expected, kind, fields, None, job, "",
                                   None if outcomes else progress, False)

            def nearest(some: Array, rays: Rays) -> Any:
                mask: Any = {"mask": np.asarray(job["mask"])[some]} if is_several("mask", job.get("mask")) else {}
                found = traced(rays, "closest", ("t", "ng"), cast(JobOptions, {**job, **mask}))
                outcomes.append(self._client.outcome)
                return found
            if lines.rows is None:      # the caller chose a margin
                return np.asarray(traced(lines.rays, "any", ("hit",), job)["hit"] != 0)
            hidden, self._client.outcome = lines.hidden(nearest), outcomes[0]   # that of all lines
            return hidden
        return np.asarray(self._at(origin, ask)).reshape(shape)

    def _size(self) -> float:
        return 0.0 if self._box is None else float(np.linalg.norm(self._box[1] - self._box[0]))

    def _learn(self, info: dict[str, Any]) -> None:
        """Takes the scene's place from its info."""
        self._origin = np.array(info["origin"])
        corners = info["box_min"], info["box_max"]
        self._box = None if None in corners else np.array(corners)

    def _moved(self, origin: Array) -> None:
        self._learn({**self.info, "origin": origin})

    def _warn_of_rounding(self, starts: Starts) -> Optional[Rounding]:
        """Must follow the answer, which tells whether the scene lies where it was thought to lie."""
        lost = rounded_rays(starts, self._box, self._origin)
        if lost:
            warn(lost.text, RayWarning)
        return lost

    def _warn_of_eye(self, look_at: Optional[Sequence[Any]]) -> None:
        if look_at is not None:
            eye = numbers("look_at", look_at)[:1]
            self._warn_of_rounding(Starts(eye, 1, self._origin, "look_at"))

    def _shift(self, origin: Any) -> Array:
        return self._origin if origin is None else vector("origin", origin)

    def _at(self, origin: Any, ask: Callable[[Array, bool], Any], repeats: bool = True) -> Any:
        """Returns ask(shift, expected) for the scene's origin, or `origin` if given. Asks once more
        if the scene was replaced by one with another origin, and, if it `repeats`, if the daemon went
        away."""
        def answer(shift: Array, expected: bool) -> Any:
            if not repeats:
                return ask(shift, expected)
            return self._client.connection.again(functools.partial(ask, shift, expected))
        try:
            return answer(self._shift(origin), origin is None)
        except SceneMoved as moved:
            self._moved(moved.origin)
        try:
            return answer(self._origin, True)
        except SceneMoved:
            raise InvalidError(f"the scene '{self.name}' is being replaced by others with other "
                               "origins; ask again", "SCENE_UNKNOWN") from None

    def _look_up(self, job: JobOptions) -> None:
        """Fixes a detached job's epoch to the one whose origin is known."""
        info = self.info
        self._learn(info)
        if not job.get("epoch"):
            job["epoch"] = info["epoch"]

    def _source(self, rays: Any, directions: Any, origin: Array) -> Source:
        if isinstance(rays, RayGenerator):
            if directions is not None:
                raise UsageError("a generator makes its own directions; pass no others")
            return rays.source(origin)
        sent = rays if isinstance(rays, Rays) else Rays(rays, directions, origin)
        return Source(sent, sent.count)

    def _query(self, source: Source, origin: Array, expected: bool, kind: Optional[str],
               fields: Union[str, Sequence[str], None], max_hits: Optional[int], job: JobOptions,
               reduce: str = "") -> Query:
        message = query_message(self.name, kind, fields, max_hits, job, reduce)
        return Query(self._client.connection, message, source, origin, expected)

    # ---- pictures -------------------------------------------------------------------------------

    @none_is_default
    def heatmap(self, *, camera: Union[str, int] = "", look_at: Optional[Sequence[Any]] = None,
                fov: float = 0.0, size: tuple[int, int] = (960, 540), metric: str = "total",
                palette: str = "", scale: str = "linear",
                range: Union[str, Sequence[float]] = "p99",
                count: str = "traversed", diff: Union[Scene, Mapping[str, Any], None] = None,
                encode: str = "raw", tile: Optional[Sequence[int]] = None, progress: Progress = None,
                detach: bool = False, **job: Unpack[JobOptions]) -> Any:
        """Returns a Heatmap: what the ray of each pixel costs, (height, width) of u32, with png(), top()
        and explain(x, y). With `encode` "png" or "exr" it returns the bytes of such a file: a PNG with
        a legend, or an EXR with a channel for every metric and level. Statistics over all pixels are in
        Client.outcome["heat"].

        `metric` is a counter, or the counter of one level, such as "boxes.1". "time" is measured, in
        nanoseconds per ray on one thread of a CPU, and "time_noise" is how far its runs lie apart.
        `range` is "p99", "auto" or (low, high). `diff` is another Scene, or the job options that differ,
        such as {"intersector": "opaque"}: what the same rays cost there is subtracted, and counts are
        i32. Cameras, `tile` and `detach` are those of render(); a tile has no png."""
        colours = {"palette": palette, "scale": scale, "range": range}
        if not isinstance(range, str):
            if not has_shape(range, 2):
                raise UsageError(f"range of {range!r}: it must be 'p99', 'auto' or (low, high)")
            range = ":".join(map(repr, numbers("range", range).astype(np.float64).tolist()))
        answer = self._picture("Heatmap", camera, look_at, fov, size, progress, detach, job, {
            "metric": metric, "palette": palette, "scale": scale, "range": range, "count": count,
            "encode": encode, "other": other_message(self.name, job, diff)}, tile)
        if detach or encode != "raw" or tile is not None:
            return answer
        outcome = dict(self._client.outcome)
        view = {"camera": camera, "look_at": look_at, "fov": fov, "size": size, **job,
                "epoch": outcome["epoch"]}

        def ask(method: str, **more: Any) -> Any:
            if method == "heatmap":
                more.update(metric=metric, count=count, diff=diff)
            return getattr(self, method)(**view, **more)
        return with_view(answer, HeatView(outcome, ask, colours))

    def _picture(self, name: str, camera: Union[str, int], look_at: Optional[Sequence[Any]],
                 fov: float, size: tuple[int, int], progress: Progress, detach: bool,
                 job: JobOptions, fields: Message, tile: Optional[Sequence[int]] = None) -> Any:
        if detach:
            self._look_up(job)
        options = job_message(self.name, job)
        shape = {**size_message(size), "encode": fields["encode"]}
        place, shown = tile_message(tile, shape)
        connection = self._client.connection

        def ask(origin: Array, _expected: bool) -> Any:
            message = {"job": {**options, "detach": detach}, **shape, **place,
                       "camera": camera_message(camera, look_at, fov, origin), **fields}
            if detach:
                return Job(self._client, connection.ask(name, message, "Detached")["job"])
            picture = Payload(name.lower(), shown, None if look_at is None else origin)
            pixels = picture.receive(connection, name, message, progress,
                                     options["deadline_ms"] / 1000)
            self._client.outcome = picture.outcome
            return pixels
        answer = self._at(None, ask, repeats=not detach)
        if not detach:
            self._client.outcome.warn_of_view()
            self._warn_of_eye(look_at)
            if fields["encode"] != "raw":  # whose colours are for png()
                warn_of_options(self._client.outcome)
        return answer

    @tells_settings
    @none_is_default
    def explain(self, ray: Any = None, *, pixel: Optional[Sequence[int]] = None,
                camera: Union[str, int] = "", look_at: Optional[Sequence[Any]] = None,
                fov: float = 0.0, size: tuple[int, int] = (960, 540), steps: int = 0,
                integrator: str = "", sample: int = 0, seed: int = 0,
                environment: str = "", sun: Optional[Sequence[float]] = None, progress: Progress = None,
                **more: Unpack[FilmOptions]) -> dict[str, Any]:
        """Returns how one ray finds its hit, step by step: the document of client/EXPLAIN.md. `ray` is
        [ox oy oz dx dy dz] or [ox oy oz tmin dx dy dz tmax]; or `pixel` is (x, y) of the picture that
        render() makes with these arguments. The document has at most `steps` steps, 256 by default.
        With the `integrator` "ao", "direct" or "path" it has the rays of one `sample` of the pixel."""
        settings, job = split_options(more)
        light: dict[str, Any] = {"sample": sample, "seed": seed, "environment": environment, "sun": sun, **settings}
        check_explain(ray, pixel, integrator, {"camera": camera, "look_at": look_at, "fov": fov}, light, steps)
        options = job_message(self.name, job)
        fields: Message = {**size_message(size), "job": options}
        if integrator and pixel is not None:
            fields.update(path_message(pixel, integrator, **light))
        else:
            fields["steps"] = whole("steps", steps, _limits.explain_steps_max, 0)
            fields.update(pixel_message(pixel) if pixel is not None else {})

        def ask(origin: Array, _expected: bool) -> dict[str, Any]:
            message = {**fields, "camera": camera_message(camera, look_at, fov, origin)}
            if ray is not None:
                message.update(ray_message(ray, origin))
            document, self._client.outcome = receive_document(
                self._client.connection, "Render" if integrator else "Explain", message, progress,
                options["deadline_ms"] / 1000, origin)
            return document
        answer: dict[str, Any] = self._at(None, ask)
        self._warn_of_eye(look_at)
        warn_of_options(self._client.outcome)
        return answer

    @none_is_default
    def blame(self, *, top: int = 10, level: int = 0, camera: Union[str, int] = "",
              look_at: Optional[Sequence[Any]] = None, fov: float = 0.0,
              size: tuple[int, int] = (960, 540), progress: Progress = None,
              **job: Unpack[JobOptions]) -> dict[str, Any]:
        """Ranks instances, meshes and materials by the work that the rays of a picture do inside
        them, with a diagnosis: the document of client/EXPLAIN.md. `level` 0 is the innermost
        instance, 1 those of the root, and so on; cameras are those of render()."""
        options = job_message(self.name, job)
        fields: Message = {**size_message(size), "job": options,
                           "top": whole("top", top, _limits.list_items_max),
                           "level": whole("level", level, 31, 0)}

        def ask(origin: Array, _expected: bool) -> dict[str, Any]:
            message = {**fields, "camera": camera_message(camera, look_at, fov, origin)}
            document, self._client.outcome = receive_document(
                self._client.connection, "Blame", message, progress,
                options["deadline_ms"] / 1000, None if look_at is None else origin)
            return document
        answer: dict[str, Any] = self._at(None, ask)
        self._warn_of_eye(look_at)
        return answer

    # ---- what it is -----------------------------------------------------------------------------

    @property
    def info(self) -> dict[str, Any]:
        """The scene's counts of triangles and instances, levels, materials, cameras, bytes, ..."""
        return scene_info(self._client.connection.ask("Info", {"scene": self.name}, "SceneInfo"))

    def info_at(self, time: float, animation: Union[str, int] = "") -> dict[str, Any]:
        """The same at a moment of an animation: its name or number."""
        moment = {"timed": True, "time": real("time", time), "animation": str(animation)}
        return scene_info(self._client.connection.ask("Info", {"scene": self.name, **moment}, "SceneInfo"))

    @property
    def meshes(self) -> list[dict[str, Any]]:
        """The scene's meshes as in `raynest info --meshes`: name, triangles and records (of other
        primitive types) of one copy, and placements."""
        return self._parts("meshes", ("name", "triangles", "records", "placements"))

    @property
    def materials(self) -> list[dict[str, Any]]:
        """The scene's materials: name, alpha_mode, triangles and placements of the meshes that use it."""
        return self._parts("materials", ("name", "alpha_mode", "triangles", "placements"))

    def _parts(self, kind: str, keys: Sequence[str]) -> list[dict[str, Any]]:
        plural = {"name": "names", "alpha_mode": "alpha_modes"}
        pages = self._client.pages("Parts", "PartList", "names", scene=self.name, kind=kind)
        return [dict(zip(keys, row)) for page in pages
                for row in rows_of(page, *(plural.get(key, key) for key in keys))]

    def pin(self, on: bool = True) -> None:
        """Keeps the scene in memory, whatever is loaded, also after a restart; `on=False` ends that."""
        self._client.connection.ask("Pin", {"scene": self.name, "off": not on}, "Pinned")

    def unload(self) -> list[str]:
        """Releases the name's hold of the scene, and this connection's. Returns the remaining
        holders, such as "uid:1000 (2 connections)": they can keep using the name, for others it is
        free. The daemon frees the scene when nobody holds it and no job uses it."""
        reply = self._client.connection.ask("Unload", {"scene": self.name}, "Unloaded")
        self._client.handles.unloaded(self.name)
        return list(reply["holders"])
