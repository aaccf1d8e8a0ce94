"""Edits of a scene: parts of it move, are hidden, removed and added. The result is the scene's next epoch."""
from __future__ import annotations

import contextlib
import itertools
import reprlib
from types import TracebackType
from typing import Any, Callable, Collection, NamedTuple, Optional, Sequence, Union

import numpy as np

from . import _limits
from ._net.connection import Connection
from ._net.control import Message
from ._net.frame import Array
from ._paths import Paths
from ._requests.arguments import check_name, numbers, user_ids, whole, whole_numbers
from ._requests.places import matrices_of
from ._requests.upload import FileSender
from ._session import Session
from .errors import InvalidError, ProtocolError, RayWarning, UsageError, warn


class Uids:
    """Instances by their user ids: edit.move(Uids([7, 9]), matrices). An id stands for all instances that have it,
    at any depth, with all that lies in them."""

    def __init__(self, uids: Any) -> None:
        self.uids = np.atleast_1d(user_ids("uids", uids))

    def __repr__(self) -> str:
        return f"Uids({reprlib.repr(self.uids.tolist())})"


# The number of an outermost instance, as in the column inst; the text of a path at any depth, which includes all
# below it and in which '*' stands for any text ('car#3/*' are the parts of that car, which stays); several of these;
# or user ids.
Which = Union[int, str, Sequence[Union[int, str]], Array, Uids]

_ROW = np.dtype([("what", "<u4"), ("target", "<u4"), ("by", "<u4"), ("value", "<u4"),
                 ("matrix", "<f8", (3, 4))])
_NUMBER, _TEXT, _USER_ID = range(3)  # values of "by"
_PLACE, _MOVE, _MASK, _REMOVE, _ADD, _VERTICES, _UID, _MATERIAL = range(8)
_FRAMES = ("world", "parent", "own")
_EXAMPLES = 3   # texts in an error
# Of texts that are sent: other lists, and the message itself, take room too.
_TEXTS_BYTES_MAX = _limits.control_bytes_max // 2


class Edit:
    """A batch of changes, made by Scene.edit() and sent when its `with` block ends. They take effect together,
    in their order, except that additions and removals come last. If the block raises, nothing is sent. An
    Edit has one such block."""

    epoch: int      # the scene's after the edit
    # As they are here after a batch of no changes, which is not sent.
    instances: int = 0     # how many have changed
    refits: int = 0        # edits since the tree of the scene's root was built
    rebuilds: int = 0      # how often it was built again
    hash: str = ""         # the content's after the edit
    kept: bool = False     # the scene, as it is now, is there after a restart
    seconds: float = 0     # that the daemon took
    notes: Sequence[str] = ()  # what the edit has lost: animations of what it added

    def __init__(self, apply: Callable[[Change], Message], name_of: Callable[[Any, str], str], epoch: int = 0,
                 keep: bool = False, paths: Optional[Paths] = None) -> None:
        self._apply = apply
        self._name_of = name_of     # for a scene that is added
        self._paths = paths         # None where no daemon is at hand
        self._keep = bool(keep)
        self.epoch = whole("epoch", epoch, 2**64 - 1, 0)
        self._texts: dict[str, int] = {}
        self._added: dict[tuple[str, str], int] = {}
        self._materials: dict[str, int] = {}
        self._rows: list[Array] = []
        self._vertices: list[tuple[Array, Array]] = []  # and normals, as many or none
        self._is_used = False

    def move(self, which: Which, by: Any, frame: str = "world") -> Edit:
        """Moves instances from where they stand. `by` is an offset (3,), a matrix (3, 4) or (4, 4), or one of
        these for each of several instances: (N, 3), (N, 3, 4), (N, 4, 4). These several may be one text with '*', whose
        parts follow each other as Scene.find() gives them. `frame` says in which space `by` is: "world", "parent" (the
        object that the instance is part of) or "own" (to turn a wheel about its axle)."""
        return self._add(which, _MOVE, matrices_of("by", by), frame)

    def place(self, which: Which, matrices: Any, frame: str = "world") -> Edit:
        """Places instances: `matrices` maps the object's own coordinates to those of the world, or of the
        "parent". It is (3, 4) or (4, 4), or has one matrix for each of several instances: (N, 3, 4) or
        (N, 4, 4). Not for a scene with an origin, whose objects have coordinates of their own: move() those."""
        return self._add(which, _PLACE, matrices_of("matrices", matrices, offsets=False), frame)

    def add(self, scene: Any, matrices: Any = (0, 0, 0), name: str = "", mask: int = 2**32 - 1) -> Edit:
        """Adds placements of another loaded scene, given by its name or as a Scene: its geometry and materials,
        which are stored once however often it is placed. `matrices` are as for move(). Their paths begin with
        `name`, by default the scene's name; several placements have numbers: "taxi#0"."""
        if name != "":
            check_name("a placement", name)
        text = self._name_of(scene, name)
        placed = matrices_of("matrices", matrices)
        rows = np.zeros(len(placed) if placed.ndim == 3 else 1, _ROW)
        if not len(rows):
            raise UsageError("an edit that adds no placement: leave it away")
        rows["what"], rows["matrix"] = _ADD, placed[..., :3, :]
        rows["value"] = whole("a mask", mask, 2**32 - 1, 0)
        rows["target"] = self._added.setdefault((text, name), len(self._added))
        self._rows.append(rows)
        return self

    def remove(self, which: Which) -> Edit:
        """Removes outermost instances. The others keep the texts of their paths; their numbers change."""
        rows = self._targets(which)
        rows["what"] = _REMOVE
        self._rows.append(rows)
        return self

    def set_vertices(self, which: Which, vertices: Any, normals: Any = None) -> Edit:
        """Moves the vertices of meshes: (N, 3) in the object's own coordinates, as many as the mesh has and in
        the same order. A mesh with several placements changes only at those that `which` names. `normals` are (N, 3),
        of any finite length, for a mesh that has normals; without them its normals are computed anew, at each vertex
        from the triangles around it. Not for a scene with an origin. A mesh that an animation deforms, by a skin or
        morph targets, has the animation's vertices in requests with `time`, and these in all others. A mesh with more
        vertices than its faces have corners, from a glTF, mesh() or scene_of() of meshes alone, has only those that
        faces use: pass vertices[np.unique(faces)]."""
        points = _triples("vertices", vertices)
        directions = points[:0] if normals is None else _triples("normals", normals)
        if normals is not None and len(directions) != len(points):
            raise UsageError(f"{len(directions)} normals for {len(points)} vertices: give one for each")
        if not np.isfinite(directions).all():
            raise UsageError("normals must be finite in float32: "
                             f"that of vertex {np.argmin(np.isfinite(directions).all(1))} is not")
        rows = self._targets(which)
        rows["what"], rows["value"] = _VERTICES, len(self._vertices)
        self._vertices.append((points, directions))
        self._rows.append(rows)
        return self

    def set_mask(self, which: Which, mask: Any) -> Edit:
        """Sets the mask of instances, one number for all, or one for each: rays whose own mask shares no bit with it do
        not enter them."""
        masks = whole_numbers("a mask", mask, 2**32 - 1)
        if masks.ndim > 1:
            raise UsageError(f"mask has shape {masks.shape}: it must be one number, or (N,), one for each")
        rows = self._each(which, masks, "masks", masks.ndim == 1)
        rows["what"], rows["value"] = _MASK, masks
        self._rows.append(rows)
        return self

    def set_uid(self, which: Which, uid: Any) -> Edit:
        """Gives instances, and everything in them, a user id: one number for all, or one for each."""
        uids = user_ids("uid", uid)
        rows = self._each(which, uids, "uids", uids.ndim == 1)
        rows["what"], rows["value"] = _UID, uids
        self._rows.append(rows)
        return self

    def set_material(self, which: Which, material: Union[int, str]) -> Edit:
        """Gives the meshes of instances, and of all within them, a material of the scene: its name, or its number
        in the column `material`. If a mesh is placed several times, the named places get a mesh of their own, unless
        all are named. Neither the old nor the new material may let rays through (alpha modes MASK and BLEND)."""
        if isinstance(material, bool) or not isinstance(material, (int, str, np.integer)):
            raise TypeError(f"material of {reprlib.repr(material)}: it must be a name, or a number as in the column "
                            "material")
        text = material if isinstance(material, str) else str(whole("a material", material, 2**32 - 2, 0))
        if not text:
            raise UsageError("a material's name is empty: give its number")
        rows = self._targets(which)
        rows["what"], rows["value"] = _MATERIAL, self._materials.setdefault(text, len(self._materials))
        self._rows.append(rows)
        return self

    def hide(self, which: Which) -> Edit:
        """Hides instances: no ray enters them from now on."""
        return self.set_mask(which, 0)

    def show(self, which: Which) -> Edit:
        """Shows instances: every ray may enter them from now on."""
        return self.set_mask(which, 2**32 - 1)

    def __enter__(self) -> Edit:
        if self._is_used:
            raise UsageError("an edit is one batch of changes, and this one has ended: begin another with edit()")
        self._is_used = True
        return self

    def __exit__(self, kind: Optional[type[BaseException]], error: Optional[BaseException],
                 traceback: Optional[TracebackType]) -> None:
        if kind is None and self._rows:
            self._send()

    def __del__(self) -> None:
        if getattr(self, "_rows", ()) and not self._is_used:
            warn("an edit outside of a `with` block changes nothing: write `with scene.edit() as edit:`, and the changes in it",
                 RayWarning)

    def _targets(self, which: Which) -> Array:
        """Returns a row for each of these instances or texts."""
        if isinstance(which, (bytes, bytearray)):
            raise _wrong(which)
        if isinstance(which, Uids):
            rows = np.zeros(len(which.uids), _ROW)
            rows["target"], rows["by"] = which.uids, _USER_ID
            return _some(rows)
        several = [which] if isinstance(which, (str, int, np.integer)) else which
        if isinstance(several, np.ndarray) and several.dtype.kind in "iu" and several.ndim == 1:
            if len(several) and (several.min() < 0 or several.max() > 2**32 - 1):
                raise UsageError("instances must be whole numbers from 0 to 4294967295")
            rows = np.zeros(len(several), _ROW)
            rows["target"] = several
        else:
            if not isinstance(several, (Sequence, np.ndarray)) or not getattr(several, "ndim", 1):
                raise _wrong(which)
            rows = np.zeros(len(several), _ROW)
            for row, item in zip(rows, several):
                if isinstance(item, str) and item:
                    row["target"] = self._texts.setdefault(str(item), len(self._texts))
                    row["by"] = _TEXT
                elif isinstance(item, (int, np.integer)) and not isinstance(item, bool):
                    row["target"] = whole("an instance", item, 2**32 - 1, 0)
                else:
                    raise _wrong(which)
        return _some(rows)

    def _each(self, which: Which, values: Array, noun: str, is_several: bool) -> Array:
        """Returns the rows for values of which there are one for all targets, or several, one for each. For these, texts
        with '*' are listed where they would otherwise be too few."""
        counts: dict[str, int] = {}
        if is_several and self._paths and not isinstance(which, Uids):
            texts = [which] if isinstance(which, str) else which
            if isinstance(texts, (Sequence, np.ndarray)) and len(texts) != len(values) and \
                    any(isinstance(text, str) and "*" in text for text in texts):
                which = self._listed(texts, counts)
        rows = self._targets(which)
        if is_several and len(values) != len(rows):
            raise _uneven(f"{len(values)} {noun}", rows, counts)
        return rows

    def _listed(self, texts: Any, counts: dict[str, int]) -> list[Any]:
        """Returns the targets with the parts in place of each text with '*', and counts those."""
        assert self._paths is not None
        targets: list[Any] = []
        for text in texts:
            if not isinstance(text, str) or "*" not in text:
                targets.append(text)
                continue
            found, epoch = self._paths._find(text, self.epoch)
            counts[text] = len(found)
            numbers = [number for number in found.values() if number is not None]
            if len(found) > _limits.list_items_max and len(numbers) == len(found):
                self.epoch = epoch  # to which the numbers belong
                targets += numbers
            else:
                targets += found
        return targets

    def _add(self, which: Which, what: int, matrices: Array, frame: str) -> Edit:
        if frame not in _FRAMES or (what == _PLACE and frame == "own"):
            raise UsageError(f"frame is {frame!r}: it must be "
                             + ("'world', 'parent' or 'own'" if what == _MOVE else "'world' or 'parent'"))
        rows = self._each(which, matrices, "matrices", matrices.ndim == 3)
        rows["what"], rows["matrix"] = what, matrices[..., :3, :]
        rows["value"] = _FRAMES.index(frame)
        self._rows.append(rows)
        return self

    def change(self) -> Change:
        """Returns all changes that were asked for so far."""
        rows = np.concatenate(self._rows)
        if len(rows) > _limits.edit_rows_max:
            raise UsageError(f"{len(rows)} rows in one edit, at most {_limits.edit_rows_max} are taken")
        texts = self._texts if _fit(self._texts) or not self._paths else self._spared(rows)
        if not _fit(texts):
            longest = max(texts, key=_bytes_of)
            if _bytes_of(longest) > _TEXTS_BYTES_MAX:
                raise UsageError(f"{reprlib.repr(longest)} is a text of {_bytes_of(longest)} bytes, and those of one edit have "
                                 f"at most {_TEXTS_BYTES_MAX} in all")
            raise UsageError(f"{len(texts)} texts that use * or name a part within an instance, as "
                             f"{reprlib.repr(next(iter(texts)))}, and one edit takes {_limits.list_items_max}, of "
                             f"{_TEXTS_BYTES_MAX} bytes in all: let * stand for several, or name parts by user ids (raynest.Uids)")
        lists = {"targets": list(texts), "scenes": [scene for scene, _ in self._added],
                 "names": [name for _, name in self._added], "materials": list(self._materials),
                 "vertex_counts": [len(points) for points, _ in self._vertices],
                 "normal_counts": [len(normals) for _, normals in self._vertices]}
        # Small edits come many a second, and to write an empty list takes as long as to write one.
        message: Message = {"epoch": self.epoch, "rows": len(rows), "keep": self._keep,
                            **{name: each for name, each in lists.items() if each}}
        vertices = sum(len(points) for points, _ in self._vertices)
        if vertices > _limits.edit_vertices_max:
            raise UsageError(f"{vertices} vertices in one edit, at most {_limits.edit_vertices_max} are taken")
        meshes = (each.tobytes() for pair in self._vertices for each in pair)
        return Change(message, b"".join((rows.tobytes(), *meshes)))

    def _spared(self, rows: Array) -> dict[str, int]:
        """Names outermost instances by number in these rows. Returns the texts that are left."""
        assert self._paths is not None
        numbers, self.epoch = self._paths._numbers(self._texts, self.epoch)
        left = {text: at for at, text in enumerate(text for text in self._texts if text not in numbers)}
        target = np.array([numbers.get(text, left.get(text)) for text in self._texts], np.uint32)
        by = np.array([_NUMBER if text in numbers else _TEXT for text in self._texts], np.uint32)
        named = rows["by"] == _TEXT
        of = rows["target"][named]
        rows["target"][named], rows["by"][named] = target[of], by[of]
        return left

    def _send(self) -> None:
        for key, value in self._apply(self.change()).items():
            setattr(self, key, value)


class Editable(Paths):
    """The part of a scene that changes it."""

    def edit(self, *, epoch: int = 0, keep: bool = False) -> Edit:
        """Begins a batch of changes, which becomes the scene's next epoch when the block ends:

            with scene.edit() as edit:
                edit.move("car#3", (0.5, 0, 0))
                edit.hide("tree-1*")
        Requests that run keep the epoch that they began with. Only the scene's owner and administrators may edit it. With
        `epoch` the edit fails unless the scene is at that epoch. With `keep` the block ends when the changed scene is on the
        disk of a daemon with --state; without it, a restart brings back what was loaded or kept last."""
        return Edit(lambda change: change.apply(self._client.connection, self.name),
                    lambda scene, _: _name_at(self._client, scene), epoch, keep, self)

    def add(self, scene: Any, matrices: Any = (0, 0, 0), name: str = "", mask: int = 2**32 - 1, *, epoch: int = 0,
            keep: bool = False) -> Edit:
        """Adds placements of another loaded scene: an edit() of one Edit.add(). Returns that edit."""
        with self.edit(epoch=epoch, keep=keep) as edit:
            edit.add(scene, matrices, name, mask)
        return edit


class Change(NamedTuple):
    """The changes of an Edit, for any scene that has what they name."""

    message: Message
    rows: bytes

    def apply(self, connection: Connection, scene: str) -> Message:
        """Makes the changes the scene's next epoch. Returns what an Edit tells of it."""
        rows_file = FileSender(np.frombuffer(self.rows, np.uint8), 0)
        frames = connection.exchange("Edit", {**self.message, "scene": scene}, feed=lambda: rows_file.feed(connection))
        with connection.interrupts, contextlib.closing(frames):
            for kind, news in frames:
                if kind == "Edited":
                    told = ("epoch", "instances", "refits", "rebuilds", "hash", "kept", "seconds")
                    return {**{key: news[key] for key in told}, "notes": list(news["notes"] or ())}
        raise ProtocolError("the daemon ended an edit without an answer")


def _name_at(client: Session, scene: Any) -> str:
    """Returns the name of a scene that is there for this client. Another daemon may have other content of that name."""
    text = scene if isinstance(scene, str) else getattr(scene, "name", None)
    if not isinstance(text, str) or not text:
        raise TypeError(f"{reprlib.repr(scene)} is no scene: give a loaded one, or its name")
    if isinstance(scene, Editable) and scene._client is not client:
        theirs = _hash_at(scene._client, text)
        try:
            is_here = _hash_at(client, text) == theirs
        except InvalidError:
            is_here = False
        if not is_here:
            raise UsageError(f"the scene {text!r} is at {scene._client.uri}: load it at this daemon, too")
    return text


def _hash_at(client: Session, name: str) -> str:
    return str(client.connection.ask("Info", {"scene": name}, "SceneInfo")["hash"])


def _triples(name: str, values: Any) -> Array:
    """Returns them as float32 (N, 3)."""
    with np.errstate(over="ignore", invalid="ignore"):
        triples = numbers(name, values).astype("<f4")
    if triples.ndim != 2 or triples.shape[1] != 3 or not len(triples):
        raise UsageError(f"{name} has shape {triples.shape}: it must be (N, 3)")
    return np.ascontiguousarray(triples)


def _bytes_of(text: str) -> int:
    return len(text.encode())


def _fit(texts: Collection[str]) -> bool:
    """True if a message has room for these."""
    return len(texts) <= _limits.list_items_max and sum(map(_bytes_of, texts)) <= _TEXTS_BYTES_MAX


def _some(rows: Array) -> Array:
    if not len(rows):
        raise UsageError("an edit of no instances: leave it away")
    return rows


def _uneven(given: str, rows: Array, counts: dict[str, int]) -> UsageError:
    """The error where there is neither one value for all targets nor one for each. `counts` are of texts that were
    listed."""
    texts = ""
    if counts:
        texts = ": " + ", ".join(f"{text!r} stands for {count}" for text, count in itertools.islice(counts.items(), _EXAMPLES))
    elif (rows["by"] == _TEXT).any():
        texts = (", and a text counts as one, also where it stands for several: list those, as "
                 "['row#0', 'row#1']")
    return UsageError(f"{given} for {len(rows)} {'target' if len(rows) == 1 else 'targets'}: give one, or one for "
                      f"each{texts}")


def _wrong(which: Any) -> TypeError:
    return TypeError(f"{reprlib.repr(which)} names no instance: it must be its number as in the column inst, "
                     "the text of a path as 'birch-17', in which '*' stands for any text, a list of them, or "
                     "raynest.Uids")
