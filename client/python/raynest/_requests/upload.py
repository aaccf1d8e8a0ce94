"""Reads and sends the source of a load().

    builtin:..., root:...     a name only: the daemon has the content
    .glb, .gltf               the file, and the files that it names below its folder
    .obj                      the file, its MTL files and their pictures
    .rnscene.json             the composition, its files and what these name
    .ply .stl .off .npz .las  the file; so .tif
    .npy                      records of a primitive type, with an optional file of `instances`
    -, /dev/stdin, /dev/fd/N  one of these from a pipe; a .gltf's files are then read from the
                              current folder
    any other file or pipe    one of these, recognised by its first bytes
"""
from __future__ import annotations

import hashlib
import os
from typing import Callable, Iterator, NamedTuple, Optional, Sequence, Union

import numpy as np

from .. import _limits, errors
from .._lists import OTHER_FILES
from .._net.connection import Connection
from .._net.control import Message
from .._net.frame import Array, padding
from .._wording import localize_message
from .digest import Digest
from .files import (HEAD_BYTES, STANDARD, head_of, is_nameless, is_pipe, read_file, read_file_beneath,
                    sendable)
from .named_files import COMPOSITION, named_files

# Bytes of a file per frame: headers do not matter at this size, and it fits any frame limit.
PIECE_BYTES = 1 << 20

# Endings of the files that are scenes.
_SCENES = (".glb", ".gltf", ".npy", ".ply", ".stl", ".obj", ".off", ".npz", ".las", ".tif", ".tiff", COMPOSITION)


class File(NamedTuple):
    name: str  # as the main file names it
    data: Union[bytes, memoryview]
    digest: Optional[Digest] = None     # of the data; None: not begun

    def sha256(self) -> bytes:
        return self.digest.value() if self.digest else hashlib.sha256(self.data).digest()


class Upload(NamedTuple):
    source: str             # the main file's name, or the source as given
    scene_name: str
    files: tuple[File, ...] = ()

    def message(self) -> Message:
        """The daemon asks for the files unless it finds a scene by their digests."""
        return {"source": self.source, "name": self.scene_name,
                "file_names": [file.name for file in self.files],
                "file_digests": b"".join(file.sha256() for file in self.files),
                "file_bytes": [len(file.data) for file in self.files]}

    def read(self, number: int) -> Iterator[Array]:
        yield np.frombuffer(self.files[number].data, np.uint8)


def gather(source: str, primitive: str, instances: str) -> Upload:
    if source.startswith(("builtin:", "root:")):
        _check_records(source, False, primitive, instances)
        return Upload(source, "")
    folder, name = os.path.split(source)
    stem, extension = _split(name)
    nameless = is_nameless(source)
    if not nameless and extension.lower() in _SCENES:
        data = read_file(source, _limits.upload_bytes_max)
    elif nameless or is_pipe(source):
        data = read_file(source, _limits.upload_bytes_max, lambda begin: _sniffed(source, begin))
        extension = _sniffed(source, data)
        name += extension
    else:
        extension = "" if extension.lower() in OTHER_FILES else _sniff(head_of(source))
        name += extension
        if not extension:
            raise errors.InvalidError(f"{source} {_not_a_scene(source)}", "FILE_INVALID")
        data = read_file(source, _limits.upload_bytes_max)
    if nameless:
        stem, folder, name = "", ".", "stdin" + extension
    _refuse_empty(source, data)
    records = extension.lower() == ".npy"
    _check_records(source, records, primitive, instances)
    main = File(sendable(name), data)
    files = _with_named_files(main, source, folder)
    if instances:
        left = _limits.upload_bytes_max - len(data)
        files += (File(sendable(os.path.basename(instances)), read_file(instances, left)),)
    # The daemon refuses names with other blanks, which look alike.
    return Upload(main.name, " ".join(filter(None, sendable(stem).split(" "))), files)


def _split(name: str) -> tuple[str, str]:
    """The name without the ending that tells what the file is, and that ending."""
    if name.endswith(COMPOSITION):
        return name[:-len(COMPOSITION)], COMPOSITION
    return os.path.splitext(name)


def upload_of(data: memoryview, primitive: str) -> Upload:
    """The bytes of one file, of a kind that its first bytes tell."""
    if len(data) > _limits.upload_bytes_max:
        raise errors.InvalidError(f"the scene has {len(data)} bytes, at most {_limits.upload_bytes_max} are taken",
                                  "FILE_INVALID")
    extension = _sniffed("the scene", bytes(data[:HEAD_BYTES]))
    _check_records("the scene", extension == ".npy", primitive, "")
    return Upload("scene" + extension, "scene", (File("scene" + extension, data),))


def _check_records(source: str, records: bool, primitive: str, instances: str) -> None:
    if not records and (primitive or instances):
        raise errors.UsageError(f"primitive and instances are for .npy files; {source} is none")
    if records and not primitive:
        raise errors.UsageError(f"{source} holds records: say of what, for example with "
                                "primitive='sphere', or primitive='heights' for a grid")


def _not_a_scene(source: str) -> str:
    """Says why a source is none that can be read, and what to do about it."""
    if os.path.isdir(source):
        return "is a folder; name the .glb or .gltf file in it"
    other = OTHER_FILES.get(os.path.splitext(source)[1].lower())
    if other is not None:
        return localize_message(other)
    return ("is not a .glb, .gltf, .rnscene.json, .obj, .ply, .stl, .off, .npz, .las, .tif or .npy file, nor builtin:NAME; "
            "read it with trimesh and pass its vertices and faces to mesh(), or convert it to .glb")


def _sniff(data: bytes) -> str:
    """Returns the file ending that fits the first bytes; "" if none does."""
    for start, extension in ((b"glTF", ".glb"), (b"\x93NUMPY", ".npy"), (b"ply\n", ".ply"), (b"ply\r", ".ply"),
                             (b"LASF", ".las"), (b"PK\x03\x04", ".npz"), (b"solid ", ".stl"), (b"OFF", ".off"),
                             (b"COFF", ".off"), *((tiff, ".tif") for tiff in (b"II*", b"II+", b"MM\0*", b"MM\0+"))):
        if data.startswith(start):
            return extension
    if data.lstrip(b" \t\r\n")[:1] != b"{":
        return ""
    return COMPOSITION if b'"rnscene"' in data[:256] else ".gltf"


def _refuse_empty(source: str, data: bytes) -> None:
    if not data:
        raise errors.InvalidError(f"{'stdin' if source in STANDARD else source} is empty",
                                  "FILE_INVALID")


def _sniffed(source: str, data: bytes) -> str:
    _refuse_empty(source, data)
    # Out of a pipe an OBJ is known by its first word; other texts that begin so have endings.
    extension = ".obj" if data.startswith((b"#", b"mtllib ", b"o ", b"g ", b"v ")) else _sniff(data)
    if not extension:
        raise errors.InvalidError(f"{source} brought no scene that is known by its first bytes: a .glb, .gltf, "
                                  ".npy, .ply, .stl, .obj, .off, .npz, .las or .tif; name a file of another kind by its ending",
                                  "FILE_INVALID")
    return extension


def _with_named_files(main: File, source: str, folder: str) -> tuple[File, ...]:
    """The main file, what it names beneath its folder, what these name in turn, and so on."""
    files = [main]
    known = {main.name}
    left = _limits.upload_bytes_max - len(main.data)
    for by in files:  # which grows
        shown = source if by is main else by.name
        try:
            names = named_files(by.name, bytes(by.data))
        except errors.InvalidError as error:
            raise errors.InvalidError(f"{shown} {error}", error.name) from None
        for name, spare in names.items():
            if name in known:
                continue
            known.add(name)
            if len(known) > _limits.upload_files_max:
                raise errors.InvalidError(f"{shown} names over {_limits.upload_files_max} files; pack it into one .glb",
                                          "FILE_INVALID")
            try:
                data = read_file_beneath(folder, name, left)
            except errors.InvalidError as error:
                if not spare:
                    raise errors.InvalidError(f"{shown} names {error}", error.name) from None
                errors.warn(f"the {spare} {error}. It is left out", errors.SceneWarning)
                continue
            if data is None:  # the daemon complains if it needs it
                continue
            left -= len(data)
            files.append(File(name, data))
    return tuple(files)


class FileSender:
    """Sends one file of a request, piece by piece as credit allows."""

    def __init__(self, data: Array, number: int) -> None:
        self._data = data
        self._number = number
        self._offset = 0

    def feed(self, connection: Connection) -> None:
        """Queues as much of the file as credit allows."""
        most = min(PIECE_BYTES, connection.daemon.bulk_bytes_max)
        while self._offset < len(self._data):
            piece = self._data[self._offset:self._offset + most]
            if connection.credit < len(piece) + padding(len(piece)):
                return
            connection.queue("Upload", {"file": self._number, "offset": self._offset}, ("data", piece, 1))
            self._offset += len(piece)

    def again(self) -> None:
        """For another request."""
        self._offset = 0


# Returns the bytes of a file of an upload, by its number, as arrays of any length.
Read = Callable[[int], Iterator[Array]]


class Sender:
    """Answers NEED with the files' bytes, in order, as credit allows."""

    def __init__(self, connection: Connection, sizes: Sequence[int], read: Read) -> None:
        self._connection = connection
        self._sizes, self._read = sizes, read
        self._is_asked = False
        self._needed: list[int] = []
        self._arrays: Iterator[Array] = iter(())    # the file that is sent
        self._rest: Array = np.zeros(0, np.uint8)   # what is left of its array
        self._offset = 0
        self.sent = 0
        self.total = 0

    def need(self, files: list[int]) -> None:
        if self._is_asked:
            raise errors.ProtocolError("the daemon sent Need twice")
        self._is_asked = True
        if any(index >= len(self._sizes) for index in files) or len(set(files)) != len(files):
            raise errors.ProtocolError("the daemon asks for a file twice, or for one that was not offered")
        self._needed = files
        self.total = sum(self._sizes[index] for index in files)
        self._begin()

    def _begin(self) -> None:
        self._arrays = self._read(self._needed[0]) if self._needed else iter(())
        self._offset = 0

    def feed(self) -> None:
        while self._needed:
            if len(self._rest) == 0:
                following = next(self._arrays, None)
                if following is None:
                    self._needed = self._needed[1:]
                    self._begin()
                else:
                    self._rest = following
                continue
            piece = self._rest[:min(PIECE_BYTES, self._connection.daemon.bulk_bytes_max)]
            if self._connection.credit < len(piece) + padding(len(piece)):
                return
            self._connection.queue("Upload", {"file": self._needed[0], "offset": self._offset}, ("data", piece, 1))
            self._rest = self._rest[len(piece):]
            self._offset += len(piece)
            self.sent += len(piece)
