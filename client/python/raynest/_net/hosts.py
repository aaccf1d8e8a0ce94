"""hosts.toml: what `raynest login` keeps of each daemon. client/net/hosts.h says how it is read."""
from __future__ import annotations

import contextlib
import fcntl
import importlib
import os
import pathlib
import re
import stat
import tempfile
from typing import Any, Iterator, NamedTuple

from .. import errors
from .uri import comparable

FILES = ("ca", "cert", "key")
FILE_BYTES_MAX = 1 << 20


class Hosts(NamedTuple):
    lines: list[tuple[str, str]]        # its text, and the comparable address that it is about or ""
    entries: dict[str, dict[str, Any]]  # by comparable addresses
    broken: list[int]                   # numbers of the lines that were left out


def hosts_file() -> pathlib.Path:
    config = os.environ.get("XDG_CONFIG_HOME", "")
    base = pathlib.Path(config) if config.startswith("/") else pathlib.Path.home() / ".config"
    return base / "raynest" / "hosts.toml"


def find_host(uri: str) -> dict[str, str]:
    """Returns token, ca, cert and key, as far as they are kept; the last three are absolute paths. Warns
    of lines that were left out."""
    hosts = _read()
    for number in hosts.broken:
        errors.warn(f"{hosts_file()}: line {number} cannot be read and is left out; correct or remove it",
                    errors.Warning)
    entry = {key: value for key, value in hosts.entries.get(comparable(uri), {}).items()
             if isinstance(value, str) and value}
    return {key: str(hosts_file().parent / value) if key in FILES else value
            for key, value in entry.items()}


def forget_host(uri: str) -> bool:
    """Removes all that is kept of a daemon. Returns False where nothing was."""
    with _alone():
        return _forget(uri)


@contextlib.contextmanager
def _alone() -> Iterator[None]:
    """Holds the folder: who reads hosts.toml and writes it again would lose what another wrote meanwhile."""
    try:
        folder = os.open(hosts_file().parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except OSError:
        yield  # there is nothing to change, or _read() says why not
        return
    try:
        fcntl.flock(folder, fcntl.LOCK_EX)
        yield
    finally:
        os.close(folder)


def _forget(uri: str) -> bool:
    hosts, name = _read(), comparable(uri)
    kept = [text for text, about in hosts.lines if about != name or text.startswith("#")]
    if len(kept) == len(hosts.lines):
        return False
    file = hosts_file()
    there = os.path.realpath(file)  # it may be a link into a folder of its own
    try:
        descriptor, made = tempfile.mkstemp(prefix="hosts.toml.", dir=os.path.dirname(there))  # mode 0600
        try:
            with open(descriptor, "wb") as opened:
                opened.write("".join(text + "\n" for text in kept).encode("utf-8", "surrogateescape"))
                opened.flush()
                os.fsync(descriptor)  # a crash after the rename must not leave an empty file
            os.replace(made, there)
        except BaseException:
            os.unlink(made)
            raise
    except OSError as error:
        raise errors.UsageError(f"cannot write {file}: {error.strerror}") from None
    for key in FILES:
        copy = hosts.entries.get(name, {}).get(key, "")
        # A path from elsewhere is not this package's to remove.
        if isinstance(copy, str) and copy.endswith(".pem") and "/" not in copy:
            with contextlib.suppress(OSError):
                (file.parent / copy).unlink()
    return True


def _read() -> Hosts:
    file = hosts_file()
    if not os.path.exists(file):  # or its folder may not be entered: HOME is that of another user
        return Hosts([], {}, [])
    try:
        with open(os.open(file, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK), "rb") as opened:
            mode = os.fstat(opened.fileno()).st_mode
            if not stat.S_ISREG(mode) or mode & 0o077:
                raise errors.UsageError(f"other users may read {file}, and it holds a token; chmod 600 "
                                        f"{file}")
            content = opened.read(FILE_BYTES_MAX + 1)
            if len(content) > FILE_BYTES_MAX:
                raise errors.UsageError(f"{file} is over {FILE_BYTES_MAX} bytes")
            return _parse(content.decode("utf-8", "surrogateescape"))
    except FileNotFoundError:
        return Hosts([], {}, [])
    except OSError as error:
        raise errors.UsageError(f"cannot read {file}: {error.strerror}") from None


def _parse(content: str) -> Hosts:
    """Reads line by line. A broken heading hides the lines below it."""
    hosts = Hosts([], {}, [])
    name, hidden = "", False
    for number, text in enumerate(content.split("\n")[:-1] if content.endswith("\n") else
                                  content.split("\n"), 1):
        text = text[:-1] if text.endswith("\r") else text
        heading = text.lstrip(" \t").startswith("[")
        try:
            row = _parse_line(text)
            broken = heading and not (len(row) == 1 and isinstance(next(iter(row.values())), dict))
        except ValueError:
            row, broken = {}, True
        if heading:
            name, hidden = "" if broken else comparable(next(iter(row))), broken
        if broken:
            hosts.broken.append(number)
        about = name
        for key, value in {} if heading or hidden else row.items():
            if name:
                hosts.entries.setdefault(name, {})[key] = value
            elif isinstance(value, dict):  # URI = { token = "..." }
                about = comparable(key)
                hosts.entries[about] = value
        hosts.lines.append((text, about))
    return hosts


def _parse_line(text: str) -> dict[str, Any]:
    """Returns a line of TOML as a dict; ValueError where it is none."""
    text.encode("utf-8")  # ValueError for bytes that are not UTF-8
    try:
        tomllib: Any = importlib.import_module("tomllib")
    except ImportError:  # before Python 3.11: what `raynest login` writes is simple enough
        return _parse_simple(text)
    row: dict[str, Any] = tomllib.loads(text)
    return row


def _parse_simple(text: str) -> dict[str, Any]:
    heading = re.fullmatch(r"""\s*\[\s*(?:'([^']*)'|"([^"\\]*)")\s*\]\s*(?:#.*)?""", text)
    row = re.fullmatch(r"""\s*(\w+)\s*=\s*(?:'([^']*)'|"([^"\\]*)")\s*(?:#.*)?""", text)
    if heading:
        return {heading[1] or heading[2] or "": {}}
    if row:
        return {row[1]: row[2] or row[3] or ""}
    if re.fullmatch(r"\s*(?:#.*)?", text):
        return {}
    raise ValueError
