"""Connects to tls://HOST:PORT, tcp://HOST:PORT, with [IPV6] as a host, or to unix:PATH."""
from __future__ import annotations

import pathlib
import re
import socket
from typing import Union

from .. import errors
from .access import Access, not_secret
from .tls import TlsSocket
from .uri import authority_of, is_loopback, is_this_machine

DEFAULT_URI = "tcp://127.0.0.1:31060"


def connect(uri: str, seconds_max: float, access: Access) -> Union[socket.socket, TlsSocket]:
    """Returns a connected, non-blocking socket."""
    opened: Union[socket.socket, TlsSocket]
    try:
        opened = _connect_unix(uri[5:], seconds_max) if re.match("unix:.", uri) else \
            _connect_tcp(uri, seconds_max, access)
        if uri.startswith("tls://"):
            opened = _encrypt(opened, uri, access)
    except errors.Error:
        raise
    except OSError as error:
        kind = errors.NotAllowedError if isinstance(error, PermissionError) else errors.ConnectError
        raise kind(f"cannot connect to {uri}: {error.strerror or error}; "
                   f"{_start_hint(uri, error)}") from None
    opened.setblocking(False)
    return opened


def _start_hint(uri: str, error: OSError) -> str:
    """Says how to start or reach a daemon after a failed connect."""
    path = pathlib.Path(uri[5:]) if uri.startswith("unix:") else None
    if path and isinstance(error, PermissionError):
        return "you may not open this socket: join its group, or start raynestd with --socket-group"
    if path and path.exists() and not path.is_socket():
        return "it is no socket: name the PATH that a daemon was given with --listen unix:PATH"
    if uri == DEFAULT_URI:
        return "start a daemon with: raynestd &"
    if is_this_machine(uri) and not uri.startswith("tls://"):
        return f"start a daemon with: raynestd --listen {uri} &"
    return "is raynestd running there?"


def _encrypt(plain: socket.socket, uri: str, access: Access) -> TlsSocket:
    authority = authority_of(uri)
    assert authority is not None  # it is connected to
    try:
        return TlsSocket(plain, authority[0], access)
    except BaseException:
        plain.close()
        raise


def _connect_unix(path: str, seconds_max: float) -> socket.socket:
    opened = socket.socket(socket.AF_UNIX)
    try:
        opened.settimeout(seconds_max)
        opened.connect(path)
    except BaseException:
        opened.close()
        raise
    return opened


def _keep_alive(opened: socket.socket) -> None:
    """Turns on TCP keep-alive: a dead peer is noticed after 17 s, as in protocol/keep_alive.h."""
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in (("TCP_KEEPIDLE", 8), ("TCP_KEEPINTVL", 3), ("TCP_KEEPCNT", 3)):
        if hasattr(socket, name):  # not every system has all of them
            opened.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


def _connect_tcp(uri: str, seconds_max: float, access: Access) -> socket.socket:
    address = authority_of(uri)
    if address is None:
        if uri.startswith(("tcp://", "tls://")):
            raise errors.UsageError(f"{uri!r} is not {uri[:6]}HOST:PORT with a port from 1 to 65535")
        hint = f"; did you mean unix:{uri}?" if uri.startswith("/") else ""
        raise errors.UsageError(f"{uri!r} is no server: use tcp://HOST:PORT, tls://HOST:PORT, "
                                f"ssh://HOST or unix:PATH{hint}")
    opened = socket.create_connection(address, seconds_max)
    # The name of localhost may lead elsewhere.
    if uri.startswith("tcp://") and access.token and not is_loopback(opened.getpeername()[0]):
        opened.close()
        raise not_secret(uri)
    opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    _keep_alive(opened)
    return opened
