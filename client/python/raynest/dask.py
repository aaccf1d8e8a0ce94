"""Rays and pictures on many hosts: a thin layer over Dask distributed, which distributes the work.

    import raynest.dask, raynest.generators
    from distributed import Client

    cluster = Client("tcp://head:8786")                 # after: dask-ssh head node1 node2
    rays = raynest.generators.camera(size=(8192, 8192))
    seen = raynest.dask.trace(cluster, "forest.glb", rays, fields=("t", "prim"))

Each host of the cluster gets one raynestd, which listens on a private Unix socket and ends with its worker. A
request is cut into items, which are parts of its rays or tiles of its picture. An item gives the same bytes
wherever and however often it is made. So items that are lost or silent are sent out again, and this machine makes
those that no worker finishes. Whoever reaches a Dask scheduler can run code on its workers: have one cluster per
user, or use Dask's TLS.
"""
from __future__ import annotations

import contextlib
import functools
import importlib
import inspect
import operator
import reprlib
import sys
from typing import Any, Callable, Iterable, Iterator, Mapping, Optional, Sequence, Union

import numpy as np

from . import _limits
from ._deal import Deal, of_scan
from ._net.frame import Array
from ._requests.arguments import Call, count_of, is_several, none_is_default, numbers, whole
from ._requests.columns import Columns
from ._requests.deadlines import deadline_of, items_within
from ._requests.film import LIT_SAMPLES, UNSAMPLED, EnvironmentFile, Layers, is_lit, samples_asked
from ._requests.job import JobOptions, Outcome
from ._requests.picture import size_message
from ._requests.rays import pair
from ._shutter import picture_in_motion, pixels_of
from ._timed import moments
from ._notes import Told, note_of_none
from ._prepared import Baggage, Part, Prepared, at_their_epoch
from ._roster import PATIENCE, roster_of
from ._version import VERSION
from ._own_daemon import Setup, distributed
from ._workers import SentRays, columns_of, files_at, info_of, paths_of
from .errors import DeadlineError, Error, RayWarning, UsageError
from .generators import Generator
from .images import Image
from .merge import joined
from .returns import OF_RETURNS, Beam, Tracer, check_sweep, measure as measured
from .scene import Scene
from .sweeps import Sweep

ITEM_RAYS = 1 << 18        # of a query's item: some 50 ms of work or more
ITEMS_PER_THREAD = 4       # of a picture whose rows may take long
ITEM_SAMPLES = 1 << 16     # of a lit picture's item


def prepare(scene: Any, faces: Any = None, **load: Any) -> Prepared:
    """Returns a scene for the functions here. It is read and hashed once, on this machine, and its files stay on the
    workers as long as the object lives, for workers that join late. `scene` is a file, its bytes, (vertices, faces)
    or an object that has both, parts as for Client.scene_of(), a Scene that load(), mesh() or scene_of() made, or
    "builtin:...". `load` are more arguments of load(), mesh() or scene_of(). Its edit() changes it as Scene.edit() does."""
    if isinstance(scene, Prepared):
        if faces is not None or load:
            raise UsageError(f"{', '.join(load) or 'faces'} with a scene that is prepared already: give it to the prepare() that "
                             "made it")
        return scene
    return Prepared(scene if faces is None else (scene, faces), load)


def _as(*functions: Callable[..., Any], without: Sequence[str] = ()) -> Callable[[Call], Call]:
    """Has a function take the arguments of others, too, with None for a default, and refuse what none of them has before
    anything is dealt out."""
    names = dict.fromkeys(name for each in functions for name in inspect.signature(each).parameters)
    return lambda function: none_is_default(function, tuple(
        name for name in [*names, *JobOptions.__annotations__] if name not in ("self", "scene", "job", *without)))


@contextlib.contextmanager
def _known(cluster: Any, scene: Any, setup: Setup, load: Optional[dict[str, Any]], patience: float,
           progress: Any = None) -> Iterator[Prepared]:
    """The scene of a request. The request's own one ends with it, also by an error that somebody keeps."""
    known = prepare(scene, **(load or {}))
    with contextlib.nullcontext() if known is scene else contextlib.closing(known):
        yield known_to(cluster, known, setup, patience, progress)


def known_to(cluster: Any, scene: Prepared, setup: Setup, patience: float, progress: Any = None,
             of: Optional[Prepared] = None) -> Prepared:
    """The scene with the digest that all workers must agree on, as a request begins, or is `of` another scene, too."""
    if not isinstance(cluster, distributed.Client):
        raise UsageError("the first argument is a distributed.Client, as Client('tcp://head:8786')")
    if cluster.status in ("closing", "closed"):
        raise UsageError("the Client is closed, or its scheduler went away: connect anew")
    if cluster.asynchronous:    # all that waits here would keep its loop from answering
        raise UsageError("the Client is asynchronous: give one made without asynchronous=True, or call this in another "
                         "thread, as asyncio.to_thread() does")
    scene.noted, scene.rounding = (set(), {}) if of is None else (of.noted, of.rounding)

    if getattr(distributed.threadpoolexecutor.thread_state, "proceed", False):
        # A task of Dask that waits for others leaves its thread to them.
        distributed.secede()    # type: ignore[no-untyped-call]

    def ask(method: Any) -> Any:
        def send(done: int, total: int, stage: str) -> None:
            if progress and stage == "sending":
                progress(done, total, stage)
        answer, = Deal(cluster, setup, scene, method, [Part({}, source=scene.source)], patience, send).all()
        return answer
    if scene.source.message is None:
        scene.found(ask(files_at))
    if not scene.source.digest:
        scene.learn(ask(info_of))
    return scene


def _file(baggage: Baggage, given: Any, _known_here: Any) -> Any:
    data = EnvironmentFile(given).data
    return baggage.file(data) if len(data) else given


def _other(baggage: Baggage, given: Any, known_here: Callable[[Prepared], Prepared]) -> Any:
    if given is None or isinstance(given, Mapping):
        return given
    other = prepare(given)
    return baggage.scene(other, known_here, is_own=other is not given)


# Arguments of a picture that name what only this machine may have, and what travels in their place.
TRAVELS: dict[str, Callable[[Baggage, Any, Callable[[Prepared], Prepared]], Any]] = {"environment": _file, "diff": _other}


@_as(Scene.trace)
def trace(cluster: Any, scene: Any, rays: Any, directions: Any = None, *, fields: Union[str, Sequence[str], None] = None,
          kind: Optional[str] = None, reduce: str = "", load: Optional[dict[str, Any]] = None, setup: Setup = Setup(),
          item_rays: int = ITEM_RAYS, patience: float = PATIENCE, progress: Any = None, **job: Any) -> Columns:
    """As Scene.trace(), on all workers of a cluster: the same columns, in every byte. `scene` is what prepare() takes
    or returns, or a path that only the hosts see; `load` are more arguments of prepare(). `rays` has all forms of
    Scene.trace(), and may be (origins, directions). Items have `item_rays` rays; after `patience` seconds of silence they
    are sent out again."""
    with _known(cluster, scene, setup, load, patience, progress) as known:
        parts = list(_parts_of(rays, item_rays, {**job, "fields": fields, "kind": kind, "reduce": reduce}, directions))
        return joined(Deal(cluster, setup, known, "trace", parts, patience, progress).all(), reduce)


@_as(Scene.trace, without=("progress", "directions"))
def arrays(cluster: Any, scene: Any, rays: Any, *, fields: Union[str, Sequence[str]] = ("t", "prim"), kind: str = "closest",
           load: Optional[dict[str, Any]] = None, setup: Setup = Setup(), item_rays: int = ITEM_RAYS,
           patience: float = PATIENCE, **job: Any) -> dict[str, Any]:
    """Returns the columns of trace() as dask arrays, whose blocks stay on the workers that made them, to be reduced or
    written there, as by to_zarr() to where all hosts see it. Their methods work with the Client that Dask takes by
    default; another one has client.compute(column). For kinds "closest" and "any". A block that is lost is made again, of
    rays that the scheduler keeps until then: have few that are sent, or a generator. Hosts that fail, round otherwise or have
    another version at the time of the call get no block, and one that fails later leaves its blocks to others. Where none is
    left of the workers that had the scene's files, call arrays() again: Dask cannot send them anew. And Dask alone waits for
    the blocks: those of a worker that is stuck come when Dask gives it up, after the scheduler's
    `distributed.scheduler.worker-ttl` (5 minutes), or at once if you end that worker.
    Warnings come when a block is made, of its rays alone."""
    from dask.delayed import delayed

    array: Any = importlib.import_module("dask.array")  # has no types

    if kind not in ("closest", "any"):
        raise UsageError(f"arrays() has a row per ray, and kind {kind} has not: use trace()")
    known = prepare(scene, **(load or {}))
    with contextlib.ExitStack() as failed:
        if known is not scene:
            failed.callback(known.close)
        known_to(cluster, known, setup, patience)
        one, *parts = at_their_epoch(known, [next(_parts_of(rays, 1, {**job, "fields": fields, "kind": kind})),
                                             *_parts_of(rays, item_rays, {**job, "fields": fields, "kind": kind})])
        # All hosts are asked, so that those which are no good get no blocks.
        hosts = roster_of(cluster).living(patience)
        deal = Deal(cluster, setup, known, "trace", [one._replace(first=host) for host in hosts or [""]], patience, None)
        row, good, rounding = deal.all()[0], deal.good(), deal.rounding.get("how", "")
        known.send_all(cluster)
        blocks: list[Any] = []
        firsts = np.cumsum([0, *(part.weight for part in parts)]).tolist()
        for first, part in zip(firsts, parts):
            assert part.rays is not None
            # With the rays in it the scheduler can have it made again.
            blocks.append(cluster.submit(columns_of, VERSION, setup, part.source, part.rays(), part.options, first, part.weight,
                                         rounding, good, workers=good or None, pure=False, retries=5))
            blocks[-1].raynest_scene = known    # whose files the workers have as long as there are blocks
        failed.pop_all()
    return {name: array.concatenate([
        array.from_delayed(delayed(operator.getitem)(block, name), (part.weight, *column.shape[1:]), column.dtype)
        for part, block in zip(parts, blocks)])
            for name, column in row.items()}


@_as(Scene.trace, measured, without=("directions", "sweep"))
def sweep(cluster: Any, scene: Prepared, scans: Iterable[tuple[int, Any]], *,
          fields: Union[str, Sequence[str], None] = None, kind: Optional[str] = None, reduce: str = "",
          setup: Setup = Setup(), patience: float = PATIENCE, progress: Any = None, **job: Any) -> list[Columns]:
    """As trace(), for many scans while the scene moves. A scan is (epoch, rays): scene.epoch after the edits that the
    scan is to see, and a generator or an array. Each scan is one item, so that a host makes each change once. Returns
    the columns of each scan. With `returns`, `divergence` or another argument of measure() each scan is what that
    takes, and is measured. Errors name a scan by its place, as scans[0]."""
    options = {**job, "fields": fields, "kind": kind, "reduce": reduce}
    if options.pop("epoch", None):
        raise UsageError("epoch= is of a scan here: give each with its epoch, as (epoch, rays)")
    measures = bool(OF_RETURNS & job.keys())
    _check(options, 1)
    if not isinstance(scans, Iterable):
        raise UsageError(f"scans of type {type(scans).__name__}: they must be a list, of a pair (epoch, rays) for each scan")
    with _known(cluster, scene, setup, None, patience, progress) as known:
        parts = []
        for number, scan in enumerate(scans):
            try:
                if not isinstance(scan, (tuple, list)) or len(scan) != 2:
                    raise UsageError(f"a scan of {reprlib.repr(scan)}: it must be a pair (epoch, rays)")
                epoch, rays = scan
                part, = _scan_of(rays, options) if measures else _parts_of(rays, sys.maxsize, options)
                parts.append(part._replace(source=known.at(whole("an epoch", epoch, known.epoch))))
            except (Error, TypeError) as error:
                raise of_scan(number, error) from None
        return Deal(cluster, setup, known, measured if measures else "trace", parts, patience, progress, apart=True).all()


@_as(Scene.trace, measured, without=("directions",))
def measure(cluster: Any, scene: Any, sweep: Any, *, load: Optional[dict[str, Any]] = None, setup: Setup = Setup(),
            item_rays: int = ITEM_RAYS, patience: float = PATIENCE, progress: Any = None, **options: Any) -> Columns:
    """As raynest.returns.measure(), on all workers of a cluster: the same returns, in every byte. Items are beams, of
    `item_rays` rays together; the noise is drawn here, over all of them."""
    item_rays = _check(options, item_rays)
    with _known(cluster, scene, setup, load, patience, progress) as known:
        return measured(_Dealt(cluster, known, setup, item_rays, patience, progress, options.pop("epoch", None)), sweep, **options)


def _scan_of(sweep: Any, options: dict[str, Any]) -> list[Part]:
    check_sweep(sweep)
    given = {name: value for name, value in options.items() if name not in ("kind", "reduce") or value}
    return [Part(given, functools.partial(SentRays, (sweep,), {}), isinstance(sweep, Sweep),
                 len(sweep.rays) if isinstance(sweep, Sweep) else sweep.count, fits=_has_returns)]


class _Dealt(Tracer):
    """A scene on all workers of a cluster."""

    def __init__(self, cluster: Any, known: Prepared, setup: Setup, item_rays: int, patience: float, progress: Any,
                 epoch: Optional[int]) -> None:
        super().__init__(None)
        self._source, self._item_rays, self._progress = known.at(epoch), item_rays, progress
        self._deal = functools.partial(Deal, cluster, setup, known, patience=patience)

    def _dealt(self, method: Any, parts: Iterable[Part], progress: Any = None) -> list[Any]:
        """All of it at one epoch, whoever edits the scene meanwhile."""
        return self._deal(method, [part._replace(source=self._source) for part in parts], progress=progress).all()

    def trace(self, rays: Any, **options: Any) -> Columns:
        progress = options.pop("progress", None)
        return joined(self._dealt("trace", _parts_of(rays, self._item_rays, options), progress), options.get("reduce") or "")

    def path_of(self, ids: Array) -> list[str]:
        found, = self._dealt(paths_of, [Part({"ids": ids})])
        return list(found)

    def _rays_max(self) -> int:
        return self._item_rays

    def _of(self, beam: Beam, pieces: Sequence[tuple[Array, dict[str, Any]]]) -> list[Columns]:
        parts = []
        for beams, job in pieces:
            own = {name: value for name, value in job.items() if isinstance(value, np.ndarray)}
            options = {name: value for name, value in job.items() if name not in own}
            parts.append(Part(options, functools.partial(SentRays, (beams,), own), True, len(beams) * len(beam.power),
                              fits=_has_returns))
        return self._dealt(beam.measured, parts, self._progress)


def _has_returns(answer: Any) -> bool:
    return isinstance(answer, dict) and len({len(column) for column in answer.values()}) == 1


@_as(trace)
def reduce(cluster: Any, scene: Any, rays: Any, name: str, **options: Any) -> Columns:
    """trace() with a reducer, "visible_pixels" or "hit_fraction": few bytes leave the workers."""
    return trace(cluster, scene, rays, reduce=name, **options)


def _check(options: dict[str, Any], per_item: Any, *refused: str) -> int:
    try:
        per_item = count_of("items", per_item, sys.maxsize)
    except UsageError:
        raise UsageError(f"items of {per_item!r}: each needs one ray or sample, or more of them") from None
    for name in ("detach", *refused):
        if options.get(name):
            raise UsageError(f"{name}= is for one daemon alone: leave it out")
    return int(per_item)


def _parts_of(rays: Any, item_rays: int, options: dict[str, Any], directions: Any = None) -> Iterator[Part]:
    item_rays = _check(options, item_rays)
    if isinstance(rays, Generator):
        if directions is not None:
            raise UsageError("a generator makes its own directions; pass no others")
        sends = rays._points is not None
        total = len(rays._points) if rays._points is not None else rays.count
        each = max(1, item_rays * total // max(1, rays.count))
        width = int(rays._settings.get("size", "0x0").split("x")[0])
        band = 8 * width        # rows of the daemon's tiles, which it traces faster together
        if band and each >= band:
            each = each // band * band
        take: Callable[[int, int], tuple[Any, ...]] = lambda first, count: (rays.part(first, count) if total else rays,)
    else:
        total, rows = _sent(rays, directions)
        sends, each = True, item_rays
        take = lambda first, count: rows(slice(first, first + count))
    per_item = rays.count // total if isinstance(rays, Generator) and total else 1
    of_rays: dict[str, Array] = {}
    if is_several("mask", options.get("mask")):
        of_rays["mask"] = np.asarray(options["mask"])
        if of_rays["mask"].shape != (total,) or not sends:
            raise UsageError(f"mask of shape {of_rays['mask'].shape}: it must be one number, or one for each of the rays that "
                             "are sent")
    if is_several("time", options.get("time")) and not isinstance(rays, Generator):
        of_rays["time"] = moments(options["time"], options.get("time_step"), total)     # as they are for all rays
        options = {**options, "time_step": None}
    options = {name: value for name, value in options.items() if name not in of_rays}

    def carried(first: int, count: int) -> Any:
        given = take(first, count)
        own = {name: values[first:first + count] for name, values in of_rays.items()}
        return SentRays(given, own) if own or len(given) > 1 else given[0]
    for first in range(0, max(1, total), each):     # no rays have an answer, too
        count = min(each, total - first)
        yield Part(options, functools.partial(carried, first, count), sends, count * per_item,
                   fits=functools.partial(_has_rows, count * per_item, bool(options.get("reduce"))))


def _sent(rays: Any, directions: Any) -> tuple[int, Callable[[slice], tuple[Any, ...]]]:
    """The number of rays that are sent, in all forms of Scene.trace(), and what gives some of them in the same form."""
    if directions is None and isinstance(rays, tuple) and len(rays) == 2 and all(np.shape(each)[-1:] == (3,) for each in rays):
        rays, directions = rays
    given = numbers("rays", rays)
    if directions is not None:
        origins, ways = pair(given, directions)
        # One that all have is sent once.
        return len(ways), lambda part: (given if given.shape == (3,) else origins[part], ways[part])
    rows = given[None] if given.shape in ((6,), (8,)) else given if given.size else np.empty((0, 6), np.float32)
    if rows.ndim != 2 or rows.shape[1] not in (6, 8):
        raise UsageError(f"rays of shape {given.shape}: they must be (N, 6), (N, 8), origins and directions, or a generator")
    return len(rows), lambda part: (rows[part],)


def _has_rows(rays: int, is_reduced: bool, answer: Any) -> bool:
    """True for columns of so many rays."""
    if not isinstance(answer, dict) or not all(isinstance(column, np.ndarray) and column.ndim for column in answer.values()):
        return False
    splits = answer.get("ray_splits")
    if splits is None:
        return is_reduced or all(len(column) == rays for column in answer.values())
    return len(splits) == rays + 1 and all(len(column) in (rays, rays + 1, int(splits[-1])) for column in answer.values())


def _has_pixels(width: int, height: int, answer: Any) -> bool:
    """True for the pixels of a tile, or for layers of them."""
    pieces = list(answer.values()) if isinstance(answer, dict) else [answer]
    return bool(pieces) and all(isinstance(piece, np.ndarray) and piece.shape[:2] == (height, width) for piece in pieces)


@_as(Scene.render)
def render(cluster: Any, scene: Any, *, size: tuple[int, int] = (960, 540), integrator: str = "primary",
           spp: int = 0, encode: str = "", load: Optional[dict[str, Any]] = None, setup: Setup = Setup(),
           patience: float = PATIENCE, progress: Any = None, item_samples: int = ITEM_SAMPLES, **options: Any) -> Any:
    """As Scene.render(), in tiles: returns an Image, or for a lit picture its Layers. With `encode` "raw" a lit picture
    is an Image too, and needs `exposure` in stops. Each tile of a lit picture gets its share of what is left
    of a `deadline`; the pixels of one that has no sample by then are 0."""
    if options.get("trajectory") is not None:
        with _known(cluster, scene, setup, load, patience, progress) as known:
            return _in_motion(functools.partial(Deal, cluster, setup, known, pixels_of, patience=patience, progress=progress),
                              roster_of(cluster).threads(patience), size, encode,
                              {"integrator": integrator != "primary", "spp": spp}, options)
    encode = encode or ("layers" if is_lit(integrator) else "raw")
    if encode not in ("layers", "raw"):
        raise UsageError(f"encode {encode}: a picture of tiles is 'raw' or 'layers'; write raw as a file with its png()")
    samples = count_of("spp", spp or LIT_SAMPLES, _limits.samples_max) if is_lit(integrator) else 1
    options.update(integrator=integrator, spp=spp, encode=encode)
    with _known(cluster, scene, setup, load, patience, progress) as known:
        whole = _tiled(cluster, known, "render", size, samples, item_samples, options, setup, patience, progress)
    if encode == "raw":
        return whole[""].view(Image)
    layers = Layers(whole)
    layers.last = True
    return layers


def _in_motion(deal: Callable[..., Deal], threads: int, size: tuple[int, int], encode: str, others: dict[str, Any],
               options: dict[str, Any]) -> Any:
    """The picture of a camera that moves. Its rows are dealt out so that all threads have some: a row of an animated scene
    may take long."""
    given: dict[str, Any] = {"begin": 0.0, "readout": 0.0, "step_error": None, "fov": 0.0}
    given.update((name, value) for name, value in options.items() if value is not None)
    job: Any = {name: given.pop(name) for name in list(given) if name in JobOptions.__annotations__}
    way, begin, readout, step_error, fov = map(given.pop, ("trajectory", "begin", "readout", "step_error", "fov"))

    def seen(rays: Generator) -> Iterator[tuple[int, Array]]:
        each = min(ITEM_RAYS, size[0] * -(-size[1] // (ITEMS_PER_THREAD * max(1, threads))))
        parts = [part._replace(fits=functools.partial(_has_pixels, 4, part.weight)) for part in _parts_of(rays, each, job)]
        firsts = np.cumsum([0, *(part.weight for part in parts)])
        return ((firsts[item], pixels) for item, pixels in deal(parts=parts).answers())
    return picture_in_motion(seen, way, begin, readout, step_error, fov, size, encode, None, {**others, **given})


@_as(Scene.heatmap)
def heatmap(cluster: Any, scene: Any, *, size: tuple[int, int] = (960, 540),
            load: Optional[dict[str, Any]] = None, setup: Setup = Setup(), patience: float = PATIENCE,
            progress: Any = None, item_samples: int = ITEM_SAMPLES, **options: Any) -> Array:
    """As Scene.heatmap(), in tiles: returns the counts, (height, width). `diff` may be what prepare() takes, too, but for
    parts."""
    if options.pop("encode", None) not in (None, "", "raw"):
        raise UsageError("encode= is for one daemon alone: leave it out")
    with _known(cluster, scene, setup, load, patience, progress) as known:
        return _tiled(cluster, known, "heatmap", size, 1, item_samples, options, setup, patience, progress)[""]


def tiles(size: tuple[int, int], pixels: int) -> list[tuple[int, int, int, int]]:
    """Cuts a picture into tiles (x, y, width, height) of about so many pixels, at multiples of 64 and 8."""
    width, height = size
    rows = max(1, pixels // (8 * width)) * 8
    columns = width if pixels >= 8 * width else max(1, pixels // (64 * 8)) * 64
    return [(x, y, min(columns, width - x), min(rows, height - y))
            for y in range(0, height, rows) for x in range(0, width, columns)]


def _tiled(cluster: Any, known: Prepared, method: str, size: tuple[int, int], samples: int, item_samples: int,
           options: dict[str, Any], setup: Setup, patience: float, progress: Any) -> dict[str, Array]:
    item_samples = _check(options, item_samples, "tile")
    width, height = size_message(size).values()
    cut = tiles(size, item_samples // samples)
    late = None
    if is_lit(options.get("integrator", "primary")) and (seconds := deadline_of(options)):
        cut = tiles(size, max(item_samples // samples, width * height // items_within(seconds, roster_of(cluster).threads(patience))))
        late = Told(((note_of_none(samples_asked(options["spp"], options.get("noise"))), RayWarning),),
                    Outcome(incomplete=True, samples=0))
    with Baggage(known) as baggage:
        options = {name: TRAVELS[name](baggage, value, lambda other: known_to(cluster, other, setup, patience, progress, known))
                   if name in TRAVELS else value for name, value in options.items()}
        parts = [Part({**options, "size": size, "tile": tile}, weight=tile[2] * tile[3],
                      fits=functools.partial(_has_pixels, tile[2], tile[3]), late=late) for tile in cut]
        return _mosaic(size, cut, Deal(cluster, setup, known, method, parts, patience, progress))


def _mosaic(size: tuple[int, int], cut: Sequence[tuple[int, int, int, int]], deal: Deal) -> dict[str, Array]:
    whole: dict[str, Array] = {}
    late: list[tuple[tuple[slice, slice], DeadlineError]] = []
    with contextlib.closing(deal.answers()) as answers:     # whoever keeps an error keeps the loop that it left
        for item, answer in answers:
            x, y, width, height = cut[item]
            tile = slice(y, y + height), slice(x, x + width)
            if isinstance(answer, DeadlineError):
                late.append((tile, answer))
                continue
            for name, piece in (answer if isinstance(answer, dict) else {"": answer}).items():
                if name not in whole:
                    whole[name] = np.empty((size[1], size[0], *piece.shape[2:]), piece.dtype)
                whole[name][tile] = piece
    for tile, error in late:
        if not whole:
            raise error
        for name, pixels in whole.items():
            pixels[tile] = UNSAMPLED.get(name, 0)
    return whole
