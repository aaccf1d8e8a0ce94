"""The credentials of a client and its demands on a daemon: token, certificates, and the CA to trust."""
from __future__ import annotations

import os
import pathlib
import re
import stat
from typing import Any, NamedTuple, Optional

from . import errors

TOKEN_BYTES_MAX = 256


class Access(NamedTuple):
    token: str = ""
    ca: str = ""           # PEM file of the CAs to trust; empty: the system's store
    certificate: str = ""  # PEM file of the client's own certificate
    key: str = ""
    verify: bool = True


def find_access(uri: str, token: Optional[str], ca: Optional[str], cert: Optional[str],
                key: Optional[str], verify: bool) -> Access:
    """Looks up what the arguments leave out: RAYNEST_TOKEN, RAYNEST_CA, RAYNEST_CERT and RAYNEST_KEY,
    then the daemon's entry in hosts.toml, which `raynest login` writes."""
    host = _host_entry(uri)

    def value(given: Optional[str], variable: str, entry: str) -> str:
        if given is not None:
            return os.fspath(given)
        return os.environ.get(variable) or str(host.get(entry, ""))

    access = Access(value(token, "RAYNEST_TOKEN", "token"), value(ca, "RAYNEST_CA", "ca"),
                    value(cert, "RAYNEST_CERT", "cert"), value(key, "RAYNEST_KEY", "key"), verify)
    if bool(access.certificate) != bool(access.key):
        raise errors.UsageError("cert and key belong together; give both")
    if access.token and _is_readable_by_others(uri):
        raise errors.UsageError(f"a token is not sent to {uri}: tcp:// would show it to the network; "
                                "use tls://, or unset RAYNEST_TOKEN")
    return access


def hosts_file() -> pathlib.Path:
    config = os.environ.get("XDG_CONFIG_HOME", "")
    base = pathlib.Path(config) if config.startswith("/") else pathlib.Path.home() / ".config"
    return base / "raynest" / "hosts.toml"


def _host_entry(uri: str) -> dict[str, Any]:
    file = hosts_file()
    try:
        if not file.exists():
            return {}
        if stat.S_IMODE(file.stat().st_mode) & 0o077:
            raise errors.UsageError(f"other users may read {file}, and it holds a token; chmod 600 "
                                    f"{file}")
        hosts = _parse(file)
    except OSError as error:
        raise errors.UsageError(f"cannot read {file}: {error.strerror}") from None
    except ValueError as error:
        if isinstance(error, errors.Error):
            raise
        raise errors.UsageError(f"{file}: {error}") from None
    entry = hosts.get(uri, {})
    return entry if isinstance(entry, dict) else {}


def _parse(file: pathlib.Path) -> dict[str, Any]:
    try:
        import tomllib
    except ImportError:  # before Python 3.11: what `raynest login` writes is simple enough
        return _parse_simple(file.read_text(encoding="utf-8"))
    with open(file, "rb") as opened:
        return tomllib.load(opened)


def _parse_simple(text: str) -> dict[str, Any]:
    hosts: dict[str, Any] = {}
    entry: dict[str, Any] = {}
    for line in text.splitlines():
        table = re.fullmatch(r"""\s*\[(?:'([^']*)'|"([^"\\]*)")\]\s*""", line)
        row = re.fullmatch(r"""\s*(\w+)\s*=\s*(?:'([^']*)'|"([^"\\]*)")\s*""", line)
        if table:
            entry = hosts.setdefault(table[1] or table[2], {})
        elif row:
            entry[row[1]] = row[2] or row[3] or ""
    return hosts


def _is_readable_by_others(uri: str) -> bool:
    return uri.startswith("tcp://") and \
        not uri.startswith(("tcp://127.", "tcp://localhost:", "tcp://[::1]:"))
