"""A scene as a program deals it out to many hosts: its files, read and hashed once, and the changes of it; and
the items that it is dealt out in."""
from __future__ import annotations

import asyncio
import collections
import concurrent.futures
import contextlib
import hashlib
import os
import pickle
import random
import threading
import weakref
from typing import Any, Callable, Iterable, Mapping, NamedTuple, Optional, Sequence

import numpy as np

from . import _travel
from ._copies import let_go, scattered
from ._net.frame import Array
from ._travel import (PACK, PACK_BYTES, PIECE_BYTES, PIECE_SECONDS, Carried, Source, held, key_of_changes, keys_of_file, named)
from ._notes import Told
from ._requests.arguments import whole
from ._requests.job import Progress
from ._requests.loads import Load, load_of_file, load_of_mesh, load_of_parts
from ._requests.materials import Mesh
from ._requests.precision import rounding_warning
from ._roster import PATIENCE, roster_of
from .edits import Change, Edit
from .errors import Error, FailedError, InvalidError, SceneWarning, UsageError, warn
from .scene import Scene

SLOW_SECONDS = 4.0          # after which a piece that a worker is slow to take is given to another one, too
SEND_SECONDS = 20.0         # after which the last worker that takes one counts as stuck


class Prepared:
    """A scene for the functions of raynest.dask, made by raynest.dask.prepare()."""

    piece_bytes, piece_seconds = PIECE_BYTES, PIECE_SECONDS

    def __init__(self, scene: Any, load: dict[str, Any]) -> None:
        self._pieces: dict[str, Any] = {}       # key -> its bytes
        self._holds: collections.Counter[str] = collections.Counter()   # how often each is needed
        self._holding = threading.Lock()
        _travel.own[id(self)] = self
        self._sent: weakref.WeakKeyDictionary[Any, dict[str, Any]] = weakref.WeakKeyDictionary()
        self._mesh: Any = None                  # vertices and faces, of which float32 may lose digits
        self._hides = ""                        # words of a daemon's warning that this program has better ones for
        self._must_be = ""                      # the digest of a Scene that this stands for
        if isinstance(scene, Scene):
            if scene.made is None:
                raise UsageError(f"{scene!r} is closed, or was not made by load(), mesh() or scene_of() here: pass the file, "
                                 "or the triangles, that it is of")
            self._must_be = str(scene.info["hash"])
            scene, load = scene.made[0], {**scene.made[1], **load}
        self.source = self._source(scene, load)
        self._log = os.urandom(8).hex()
        self._epoch = 1
        self._refused: tuple[int, ...] = ()     # changes that no daemon makes
        self._packs: tuple[int, ...] = (0,)     # where packs of changes begin and end
        self._unpacked: list[bytes] = []        # the changes after these
        self._others: dict[str, Prepared] = {}  # that edits add, by the name that their content gives them
        self.compared: list[Prepared] = []      # with this one, by requests that go on
        self.sending = 0
        self.noted: set[str] = set()            # what the user was told since the request began
        self.rounding: dict[str, str] = {}      # "how" those do that trace it for a request: others would give other bytes

    def _source(self, scene: Any, load: dict[str, Any]) -> Source:
        found: Load
        if isinstance(scene, Mapping):
            found, path = load_of_parts(scene, **load), ""
        elif isinstance(scene, (tuple, list)) and len(scene) == 2:
            self._mesh = scene
            found, path = load_of_mesh(*scene, **load), ""
        elif hasattr(scene, "vertices") and hasattr(scene, "faces"):
            self._mesh = scene.vertices, scene.faces
            load = {"material": scene.material, **load} if isinstance(scene, Mesh) else load
            found, path = load_of_mesh(scene.vertices, scene.faces, **load), ""
        elif isinstance(scene, (bytes, bytearray, memoryview)):
            found, path = load_of_file("", data=memoryview(scene).cast("B"), **load), ""
        else:
            path = os.fspath(scene)
            if not isinstance(path, str):
                raise TypeError(f"a path of type {type(path).__name__}: it must be a str")
            if not path.startswith(("builtin:", "root:")):
                path = os.path.abspath(path)
                if not os.path.exists(path):        # the workers may see it
                    return Source(path, load)
            found = load_of_file(path, "", **load)
        self._hides = found.hides
        source, most = Source(path, load, named(found.message), piece_bytes=self.piece_bytes,
                              piece_seconds=self.piece_seconds), self.piece_bytes
        for number, (digest, size) in enumerate(source.files()):
            data = next(found.read(number))
            for i, key in enumerate(keys_of_file(digest, size, most)):
                self._keep(key, data[i * most:(i + 1) * most])
        return source

    def _keep(self, key: str, piece: Array) -> None:
        with self._holding:
            self._pieces.setdefault(key, piece)
            self._holds[key] += 1

    def let_go(self, keys: Iterable[str]) -> None:
        """Has the workers drop pieces that were needed once more, unless they still are."""
        gone = set()
        with self._holding:
            for key in keys:
                self._holds[key] -= 1
                if self._holds[key] <= 0:
                    del self._holds[key]
                    self._pieces.pop(key, None)
                    gone.add(key)
        for sent in list(self._sent.values()):
            for key in [key for key in list(sent) if key.partition("~")[0] in gone]:
                sent.pop(key).release()

    def close(self) -> None:
        """Has the workers drop all of it now, and not when the object goes, which an error may keep."""
        self.let_go(list(self._holds.elements()))

    @property
    def bytes(self) -> int:
        """The size of the files."""
        return sum(size for _, size in self.source.files()) if self.source.message else 0

    def carry(self, digest: Any, data: Any) -> list[str]:
        """Has the content of a file travel as the scene does until its keys, which this returns, are let go."""
        keys = keys_of_file(digest, len(data), self.piece_bytes)
        for i, key in enumerate(keys):
            self._keep(key, np.frombuffer(data, np.uint8)[i * self.piece_bytes:(i + 1) * self.piece_bytes])
        return keys

    def take_along(self, other: Prepared) -> list[str]:
        """Has another scene travel with this one until its keys, which this returns, are let go."""
        keys = list(other._pieces)
        for key in keys:
            self._keep(key, other._pieces[key])
        return keys

    def piece(self, key: str) -> Optional[Array]:
        return self._pieces.get(key)

    def found(self, message: dict[str, Any]) -> None:
        """Takes the Load of files that a worker has read, and this machine cannot."""
        self.source = self.source._replace(message=message)

    def learn(self, info: dict[str, Any]) -> None:
        """Takes what a worker's daemon tells of the scene, and warns as a load does."""
        if self.source.digest:
            return
        if self._must_be not in ("", info["hash"]):
            raise InvalidError("the scene was edited, or what it was loaded from has changed: deal out what "
                               "raynest.dask.prepare() makes of that, and edit it there", "SCENE_UNKNOWN")
        self.source = self.source._replace(digest=info["hash"])
        for text in info["warnings"]:
            if not self._hides or self._hides not in text:
                warn(text, SceneWarning)
        if None in (info["box_min"], info["box_max"]):
            warn("the scene is empty: nothing can be hit", SceneWarning)
        if self._mesh is not None:
            vertices, faces = self._mesh
            lost = rounding_warning(vertices, faces, info)
            self._mesh = None
            if lost:
                warn(lost, SceneWarning)

    # ---- changes --------------------------------------------------------------------------------

    @property
    def epoch(self) -> int:
        """As a daemon counts: 1, and one more with each edit."""
        return self._epoch

    def edit(self) -> Edit:
        """As Scene.edit(): a batch of changes, which becomes the scene's next epoch when the block ends. The
        workers make them when they next need that epoch; the change travels, not the scene. A change that they refuse is
        told by the request that first needs it, and left out of all that follow."""
        return Edit(self._record, self._add)

    def _add(self, scene: Any, name: str) -> str:
        if not name:
            raise UsageError("an edit on many hosts adds a scene: give the name= that its paths begin with")
        if not isinstance(scene, Prepared) or scene is self:
            raise UsageError("an edit on many hosts adds another scene that raynest.dask.prepare() made")
        if scene.source.message is None:
            raise UsageError(f"{scene.source.path} is added to a scene on many hosts: it must be where this program runs")
        if scene.epoch > 1:
            raise UsageError("a scene that was edited is added: add it as it was prepared, and edit its parts here")
        if scene.source.name not in self._others:
            self._others[scene.source.name] = scene
            self.take_along(scene)
        return scene.source.name

    def _record(self, change: Change) -> dict[str, Any]:
        sources = [self._others[name].source for name in change.message.get("scenes", ())]
        piece = pickle.dumps((change, sources))
        if len(self._unpacked) == PACK or len(piece) + sum(map(len, self._unpacked)) > PACK_BYTES:
            self._pack()
        self._unpacked.append(piece)
        self._keep(key_of_changes(self._log, self._epoch - 1, self._epoch), np.frombuffer(piece, np.uint8))
        self._epoch += 1
        return {"epoch": self._epoch}

    def _pack(self) -> None:
        """Has all changes so far travel in packs: a worker that comes late needs them all."""
        if len(self._unpacked) > 1:
            self._keep(key_of_changes(self._log, self._packs[-1], self._epoch - 1),
                       np.frombuffer(b"".join(self._unpacked), np.uint8))
        if self._unpacked:
            self._packs, self._unpacked = (*self._packs, self._epoch - 1), []

    def at(self, epoch: Optional[int] = None) -> Source:
        """The scene at an epoch; None and 0 are the present one, as for one daemon."""
        changes = (self._epoch if epoch is None else whole("an epoch", epoch, self._epoch, 0) or self._epoch) - 1
        source = self.source._replace(sending=self.sending)
        return source._replace(log=self._log, changes=changes, packs=self._packs, refused=self._refused) if changes else source

    def refused(self, error: Error) -> Error:
        """The error to tell. If a daemon has refused a change, that is left out of all epochs from now on."""
        log, number = getattr(error, "raynest_refused", ("", 0))
        for scene in (self, *self._others.values(), *self.compared):
            if scene._log == log:
                scene._refused = *scene._refused, number
                return type(error)(f"edit {number + 1} of the scene is left out from now on: {error}", error.name, error.code)
        return error

    # ---- on the way -----------------------------------------------------------------------------

    def send_anew(self, keys: Sequence[str]) -> None:
        """Has the workers look for all pieces under new keys, as who has these is silent."""
        self.sending = max(self.sending, _sending_of(keys[0]) + 1)

    def send(self, cluster: Any, keys: Sequence[str], workers: Iterable[str], progress: Progress = None) -> None:
        """Gives pieces that no worker has to one of them each. They stay there as long as this object lives."""
        sent = self._sent.setdefault(cluster, {})
        takers = list(workers)
        random.shuffle(takers)
        for key in [key for key in sent if _sending_of(key) < self.sending]:
            del sent[key]       # nobody looks for it any more
        keys = [key for key in keys if _sending_of(key) >= self.sending]
        lost = set(self._lost(cluster, keys))
        for number, key in enumerate(keys, 1):
            if key.partition("~")[0] not in self._pieces:
                raise FailedError(f"the workers ask for {key}, which is no piece of this scene")
            if key in lost:
                sent[key] = self._give(cluster, key, takers)
                if progress:
                    progress(number, len(keys), "sending")
            elif key not in sent:       # another scene of this content has sent it, and may go
                sent[key] = held(cluster, key)

    def send_all(self, cluster: Any) -> None:
        """Gives the workers all that they may come to lack while nobody looks after them."""
        needed = {key for key, _ in self.at().changes_since(0)}
        if keys := [f"{key}~{self.sending}" for key in self._pieces if key in needed or not key.startswith(f"raynest-{self._log}-")]:
            self.send(cluster, keys, roster_of(cluster).living())

    def _lost(self, cluster: Any, keys: Sequence[str]) -> list[str]:
        try:
            places = cluster.sync(cluster.scheduler.who_has, keys=list(keys), callback_timeout=PATIENCE)
        except asyncio.TimeoutError:
            raise FailedError("the Dask scheduler does not answer") from None
        return [key for key in keys if not places.get(key)]

    def _give(self, cluster: Any, key: str, takers: list[str]) -> Any:
        """Gives a piece to the first of the takers, who is the last one then, and to the next ones while it waits. Who fails,
        or was waited for, takes no more, unless there is nobody else."""
        async def scatter(to: str) -> Any:
            return await scattered(cluster, {key: self._pieces[key.partition("~")[0]]}, to, await roster_of(cluster).reaches(to))
        giving: dict[Any, str] = {}
        waiting = list(takers)
        try:
            while waiting or giving:
                if waiting:
                    to = waiting.pop(0)
                    giving[asyncio.run_coroutine_threadsafe(scatter(to), cluster.loop.asyncio_loop)] = to
                ended, _ = concurrent.futures.wait(giving, SLOW_SECONDS if waiting else SEND_SECONDS,
                                                   concurrent.futures.FIRST_COMPLETED)
                if not ended and not waiting:
                    break
                for one in ended:
                    takers.remove(to := giving.pop(one))
                    if not one.cancelled() and one.exception() is None:
                        for whose in giving.values():
                            takers.remove(whose)
                        takers.append(to)
                        return one.result()[key]
        finally:
            for late in giving:
                late.add_done_callback(let_go)
        raise FailedError("no worker takes the scene's files")


class Baggage:
    """All that a request takes along with its scene. It leaves the workers when the request ends, also by an error that
    somebody keeps."""

    def __init__(self, scene: Prepared) -> None:
        self._scene = scene
        self._end = contextlib.ExitStack()

    def __enter__(self) -> Baggage:
        return self

    def __exit__(self, *_: object) -> None:
        self._end.close()

    def file(self, data: Any, prefix: str = "", ending: str = "") -> Carried:
        """The content of a file that a command or a picture names."""
        digest = hashlib.sha256(data).digest()
        self._end.callback(self._scene.let_go, self._scene.carry(digest, data))
        return Carried(prefix, digest.hex()[:16] + ending, digest, len(data))

    def scene(self, other: Prepared, known_here: Callable[[Prepared], Prepared], is_own: bool) -> Source:
        """Another scene, which that of the request is compared with. The request's own one ends with it."""
        if is_own:
            self._end.callback(other.close)
        known_here(other)
        if other.epoch > 1 and self._scene.epoch > 1:
            raise UsageError("two scenes that were edited are compared: a host has one at a time; prepare one of them from "
                             "a file of what it has become")
        self._end.callback(self._scene.let_go, self._scene.take_along(other))
        self._scene.compared.append(other)
        self._end.callback(self._scene.compared.remove, other)
        return other.at()


class Part(NamedTuple):
    """An item: a method of Scene and its arguments. `rays` is called when the item is dealt."""

    options: dict[str, Any]
    rays: Optional[Callable[[], Any]] = None
    heavy: bool = False        # its rays travel from here to the worker, not through the scheduler
    weight: int = 1            # rays or samples, for progress
    source: Optional[Source] = None     # other than the deal's
    fits: Callable[[Any], bool] = lambda answer: True   # says whether an answer may be the item's
    # Told where its deadline passes: its share of that of the request. Its answer is the error then.
    late: Optional[Told] = None
    first: str = ""            # the worker that gets it first


def at_their_epoch(scene: Prepared, parts: Sequence[Part]) -> list[Part]:
    """Takes the option `epoch`: a host has a copy of the scene for it, whose daemon counts otherwise. Parts that name none
    are of the present one, whoever edits the scene meanwhile."""
    now = scene.at()

    def source(part: Part) -> Source:
        return part.source or (scene.at(part.options["epoch"]) if part.options.get("epoch") else now)
    return [part._replace(source=source(part), options={name: value for name, value in part.options.items() if name != "epoch"})
            for part in parts]


def _sending_of(key: str) -> int:
    return int(key.partition("~")[2])
