"""Files that are going to be uploaded: the one that the user names, which may be a pipe, and those
that it names itself: regular ones, beneath its folder."""
from __future__ import annotations

import os
import stat
import unicodedata
from typing import Any

from .errors import InvalidError

# O_NONBLOCK: a pipe without a writer opens at once, and is then refused.
_READ = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY
_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC


# Of a pipe or a device, which says nowhere how much will come.
PIPED_BYTES_MAX = 4 << 30

STANDARD = ("-", "/dev/stdin")


def path_text(what: str, path: Any) -> str:
    """A str or os.PathLike as a str. Bytes would not say which of the two ways to read them."""
    text = os.fspath(path) if isinstance(path, os.PathLike) else path
    if not isinstance(text, str):
        raise TypeError(f"{what} of type {type(path).__name__}: it must be a str or a path, and "
                        "os.fsdecode() makes one of bytes")
    return text


def is_nameless(path: str) -> bool:
    """Does it say nothing about what comes? stdin does not, nor a pipe of the shell, <(command)."""
    return path in STANDARD or path.startswith("/dev/fd/")


def sendable(name: str) -> str:
    """A file's name in letters that may travel: others become ?."""
    data = os.fsencode(name)
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        text = "".join(chr(byte) if byte < 0x80 else "?" for byte in data)
    return "".join("?" if unicodedata.category(letter) == "Cc" else letter for letter in text)


def read_file(path: str, bytes_max: int) -> bytes:
    """A file, a pipe or a device, or stdin as "-". A pipe is read to its end, and may be waited for:
    Ctrl-C ends that."""
    try:
        descriptor = os.dup(0) if path in STANDARD else os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        mode = os.fstat(descriptor).st_mode
        if stat.S_ISREG(mode) and path not in STANDARD:
            return _read_all(descriptor, path, bytes_max)
        with open(descriptor, "rb") as file:
            most = min(bytes_max, PIPED_BYTES_MAX)
            data = file.read(most + 1)
    except OSError as error:
        raise _refuse(path, error.strerror) from None
    if len(data) > most:
        raise _refuse(path, f"goes on after {most} bytes; more are not taken")
    return data


def read_file_beneath(folder: str, name: str, bytes_max: int) -> bytes:
    """`name` is relative to `folder` and stays in it: no link is followed on the way."""
    *folders, last = name.split("/")
    at = -1
    try:
        at = os.open(folder or ".", _FOLDER)
        for component in folders:
            next_at = os.open(component, _FOLDER | os.O_NOFOLLOW, dir_fd=at)
            os.close(at)
            at = next_at
        return _read_all(os.open(last, _READ | os.O_NOFOLLOW, dir_fd=at), name, bytes_max)
    except OSError as error:
        raise _refuse(name, error.strerror) from None
    finally:
        if at >= 0:
            os.close(at)


def _read_all(descriptor: int, name: str, bytes_max: int) -> bytes:
    with open(descriptor, "rb") as file:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise _refuse(name, "is not a regular file")
        if status.st_size > bytes_max:
            raise _refuse(name, f"has {status.st_size} bytes; at most {bytes_max} are taken")
        return file.read(status.st_size)


def _refuse(name: str, why: str) -> InvalidError:
    return InvalidError(f"{name}: {why}", "FILE_INVALID")
