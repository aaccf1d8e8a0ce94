"""Addresses of daemons, as users write them: which entry of hosts.toml is theirs, and who can read along."""
from __future__ import annotations

import ipaddress
import re
from typing import Optional

_AUTHORITY = re.compile(r"(?:tcp|tls)://(?:\[([\w.:%-]+)\]|([\w.-]+)):(\d{1,5})", re.ASCII)


def authority_of(uri: str) -> Optional[tuple[str, int]]:
    """Splits tcp://HOST:PORT or tls://HOST:PORT, with [IPV6] as a host; None where a part is missing or is
    no name, address or port from 1 to 65535."""
    parts = _AUTHORITY.fullmatch(uri)
    if parts is None or not 1 <= int(parts[3]) <= 65535:
        return None
    return parts[1] or parts[2], int(parts[3])


def comparable(uri: str) -> str:
    """The address with scheme, host and port in small letters: names are compared without case. The user
    of ssh:// and paths keep theirs."""
    parts = re.fullmatch(r"([^:]*)(://)((?:[^/]*@)?)([^/]*)(.*)", uri, re.DOTALL)
    if parts is None:
        scheme, colon, rest = uri.partition(":")
        return scheme.lower() + colon + rest
    scheme, slashes, user, host, path = parts.groups()
    return scheme.lower() + slashes + user + host.lower() + path


def is_loopback(host: str) -> bool:
    """True for an address, not a name, of this machine's loopback: 127.0.0.0/8, ::1, and the former mapped
    into IPv6."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return False
    return (getattr(address, "ipv4_mapped", None) or address).is_loopback


def is_this_machine(uri: str) -> bool:
    """True for a server of this machine, by its words: unix:PATH, or `localhost` or a loopback address."""
    authority = authority_of(uri)
    return uri.startswith("unix:") or \
        (authority is not None and (authority[0].lower() == "localhost" or is_loopback(authority[0])))
