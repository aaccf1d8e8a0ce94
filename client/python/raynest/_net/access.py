"""The credentials of a client and its demands on a daemon: token, certificates, and the CA to trust."""
from __future__ import annotations

import os
import re
from typing import NamedTuple, Optional

from .. import errors
from .hosts import find_host
from .uri import authority_of, is_this_machine

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
    host = find_host(uri)

    def value(given: Optional[str], variable: str) -> Optional[str]:
        return os.fspath(given) if given is not None else os.environ.get(variable) or None

    words = [value(token, "RAYNEST_TOKEN"), value(ca, "RAYNEST_CA"), value(cert, "RAYNEST_CERT"),
             value(key, "RAYNEST_KEY")]
    if words[2] is None and words[3] is None:  # the two belong together
        words[2:] = host.get("cert"), host.get("key")
    access = Access(_token(host.get("token", "") if words[0] is None else words[0]),
                    host.get("ca", "") if words[1] is None else words[1], words[2] or "",
                    words[3] or "", verify)
    if bool(access.certificate) != bool(access.key):
        raise errors.UsageError("cert and key belong together; give both")
    # connect() refuses an address that cannot be split.
    if access.token and uri.startswith("tcp://") and authority_of(uri) and not is_this_machine(uri):
        raise not_secret(uri)
    return access


def not_secret(uri: str) -> errors.UsageError:
    """The error for a token that would be sent where others can read it."""
    return errors.UsageError(f"a token is not sent to {uri}: tcp:// would show it to the network; "
                             "use tls://, or unset RAYNEST_TOKEN")


def _token(text: str) -> str:
    token = text.strip(" \t\r\n")
    if text and not re.fullmatch(f"[!-~]{{1,{TOKEN_BYTES_MAX}}}", token):
        raise errors.UsageError("the token, of token= or RAYNEST_TOKEN, is none: it must be one word of "
                                "printable letters")
    return token
