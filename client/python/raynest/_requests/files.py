"""Reads files to upload: the file that the user names, which may be a pipe, and the files that it
names in turn, which must be regular files below its folder."""
from __future__ import annotations

import contextlib
import os
import stat
import unicodedata
from typing import Any, Callable

from ..errors import InvalidError

# O_NONBLOCK: a pipe without a writer opens at once, and is then refused.
_READ = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY
_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC
_LINKS_MAX = 40  # as many as Linux follows
_LEAVES = "link leaves the folder; only links that end inside it are followed"


# Maximum bytes read from a pipe or a device, whose size is unknown.
PIPED_BYTES_MAX = 4 << 30

STANDARD = ("-", "/dev/stdin")

# First bytes of a file that suffice to recognise its format.
HEAD_BYTES = 256


def path_text(what: str, path: Any) -> str:
    """Returns a str or os.PathLike as a str. Bytes are refused: their encoding would be a guess."""
    text = os.fspath(path) if isinstance(path, os.PathLike) else path
    if not isinstance(text, str):
        if hasattr(path, "read"):
            hint = "; write what it holds to a file and pass its name"
        elif isinstance(path, (bytes, bytearray, memoryview)):
            hint = ("; write these bytes to a file and pass its name" if bytes(path[:4]) in (b"glTF", b"\x93NUM") else
                    ", and os.fsdecode() makes one of bytes")
        else:
            hint = ""
        raise TypeError(f"{what} of type {type(path).__name__}: it must be a str or a path{hint}")
    return text


def is_nameless(path: str) -> bool:
    """True for paths without a file name: stdin, and a shell's <(command)."""
    return path in STANDARD or path.startswith("/dev/fd/")


def is_pipe(path: str) -> bool:
    """True for a pipe or a device, whose bytes can be read only once."""
    with contextlib.suppress(OSError, ValueError):
        mode = os.stat(path).st_mode
        return not stat.S_ISREG(mode) and not stat.S_ISDIR(mode)
    return False


def head_of(path: str) -> bytes:
    """Returns the first bytes of a file; none if it cannot be read."""
    with contextlib.suppress(OSError, ValueError), open(path, "rb") as file:
        return file.read(HEAD_BYTES)
    return b""


def sendable(name: str) -> str:
    """Returns a file's name with ? for the characters that the protocol does not allow."""
    data = os.fsencode(name)
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        text = "".join(chr(byte) if byte < 0x80 else "?" for byte in data)
    return "".join("?" if unicodedata.category(letter) == "Cc" else letter for letter in text)


def read_file(path: str, bytes_max: int,
              check: Callable[[bytes], object] = lambda begin: None) -> bytes:
    """Reads a file, a pipe or a device; "-" is stdin. Reads a pipe to its end, however long that
    takes; Ctrl-C interrupts it. Calls `check` with its first bytes, which may raise."""
    try:
        descriptor = os.dup(0) if path in STANDARD else os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        mode = os.fstat(descriptor).st_mode
        if stat.S_ISREG(mode) and path not in STANDARD:
            return _read_all(descriptor, path, bytes_max)
        with open(descriptor, "rb") as file:
            most = min(bytes_max, PIPED_BYTES_MAX)
            data = file.read(min(HEAD_BYTES, most + 1))
            check(data)
            data += file.read(most + 1 - len(data))
    except OSError as error:
        raise _refuse(path, error.strerror) from None
    if len(data) > most:
        raise _refuse(path, f"goes on after {most} bytes; more are not taken")
    return data


def read_file_beneath(folder: str, name: str, bytes_max: int) -> bytes | None:
    """Reads the file `name` in `folder`; None if there is none. Symbolic links are followed if they
    end in the folder; what is opened lies below it, even if something is renamed meanwhile."""
    folder = folder or "."
    try:
        try:
            descriptor = _open_beneath(folder, name)
        except _LeavesError:  # on its way: it may come back
            base = os.path.realpath(folder)
            end = os.path.relpath(os.path.realpath(os.path.join(base, name)), base)
            if end.split("/")[0] == "..":
                raise
            descriptor = _open_beneath(folder, end)
        return _read_all(descriptor, name, bytes_max)
    except _LeavesError:
        raise _refuse(name, _LEAVES) from None
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise _refuse(name, error.strerror) from None


class _LeavesError(Exception):
    """A link leads out of the folder."""


def _open_beneath(folder: str, name: str) -> int:
    """Opens one component after the other and resolves links itself. Each step starts at an open
    folder, so that nobody can replace a folder on the way."""
    rest = name.split("/")[::-1]
    links = 0
    path = [os.open(folder, _FOLDER)]  # from the folder down to where the next component is looked up
    try:
        while True:
            component = rest.pop()
            if component == "..":
                os.close(path.pop())
                if not path:
                    raise _LeavesError
            elif component not in ("", "."):
                try:
                    flags = _FOLDER if rest else _READ
                    opened = os.open(component, flags | os.O_NOFOLLOW, dir_fd=path[-1])
                except OSError:
                    # Follow a link; for all else raise the system's error again.
                    target = _link(component, path[-1])
                    if target is None:
                        raise
                    links += 1
                    if links > _LINKS_MAX:
                        raise _refuse(name, "links lead in a circle") from None
                    if target.startswith("/"):
                        raise _LeavesError from None
                    rest += target.split("/")[::-1]
                    continue
                if not rest:
                    return opened
                path.append(opened)
            if not rest:
                return os.dup(path[-1])
    finally:
        for descriptor in path:
            os.close(descriptor)


def _link(component: str, folder: int) -> str | None:
    try:
        return os.readlink(component, dir_fd=folder)
    except OSError:
        return None


def _read_all(descriptor: int, name: str, bytes_max: int) -> bytes:
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode):
        os.close(descriptor)
        raise _refuse(name, "is not a regular file")
    with open(descriptor, "rb") as file:
        if status.st_size > bytes_max:
            raise _refuse(name, f"has {status.st_size} bytes; at most {bytes_max} are taken")
        return file.read(status.st_size)


def _refuse(name: str, why: str) -> InvalidError:
    return InvalidError(f"{name}: {why}", "FILE_INVALID")
