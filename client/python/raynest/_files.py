"""Files that are going to be uploaded: regular ones only, and beneath the folder of the scene."""
from __future__ import annotations

import os
import stat

from .errors import InvalidError

# O_NONBLOCK: a pipe without a writer opens at once, and is then refused.
_READ = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY
_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC


def read_file(path: str, bytes_max: int) -> bytes:
    try:
        return _read_all(os.open(path, _READ), path, bytes_max)
    except OSError as error:
        raise _refuse(path, error.strerror) from None


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
