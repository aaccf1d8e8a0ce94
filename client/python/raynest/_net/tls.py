"""TLS on a connected socket, with the few methods of a socket that a connection uses.

A call that would have to wait raises BlockingIOError, as a plain socket does. `pending()` counts the
decrypted bytes that poll() knows nothing of.
"""
from __future__ import annotations

import os
import socket
import ssl
import stat
import warnings
from typing import Sequence

from .. import errors
from .access import Access

RECORD_BYTES = 16 << 10

# Alerts by which a daemon refuses this client's certificate.
_REFUSALS = ("BAD_CERTIFICATE", "CERTIFICATE_EXPIRED", "CERTIFICATE_REVOKED", "CERTIFICATE_UNKNOWN",
             "UNSUPPORTED_CERTIFICATE", "UNKNOWN_CA", "ACCESS_DENIED", "CERTIFICATE_REQUIRED")
# OpenSSL's reasons for bytes that are not TLS.
_NOT_TLS = ("WRONG_VERSION_NUMBER", "HTTP_REQUEST", "UNSUPPORTED_PROTOCOL", "RECORD_LAYER_FAILURE")


class TlsSocket:
    """A socket whose bytes are encrypted. Not thread-safe, but for shutdown()."""

    def __init__(self, plain: socket.socket, host: str, access: Access) -> None:
        """Does the handshake within the socket's timeout, and verifies chain and name."""
        context = _context(access)
        try:
            self._tls = context.wrap_socket(plain, server_hostname=host)
        except ssl.SSLError as error:
            raise _explain(error, host) from None
        self._staged = bytearray(RECORD_BYTES)
        self._repeated = 0  # bytes of a write that OpenSSL wants again

    def fileno(self) -> int:
        return self._tls.fileno()

    def setblocking(self, blocks: bool) -> None:
        self._tls.setblocking(blocks)

    def pending(self) -> int:
        return self._tls.pending()

    def shutdown(self, how: int) -> None:
        # The encrypted stream must not be touched from another thread; its socket may be.
        socket.socket.shutdown(self._tls, how)

    def close(self) -> None:
        self._tls.close()

    def sendmsg(self, views: Sequence[memoryview]) -> int:
        """Sends a part of the views: at most a record, or less of the first one."""
        size = 0
        for view in views:
            part = view[:RECORD_BYTES - size]
            self._staged[size:size + len(part)] = part
            size += len(part)
            if size == RECORD_BYTES:
                break
        size = min(size, self._repeated or size)
        try:
            sent = self._tls.send(memoryview(self._staged)[:size])
        except (ssl.SSLWantWriteError, ssl.SSLWantReadError):
            self._repeated = size
            raise BlockingIOError from None
        self._repeated = 0
        return sent

    def recvmsg_into(self, views: Sequence[memoryview]) -> tuple[int]:
        """Fills the views in order with what is there; (0,) at the end of the stream."""
        total = 0
        for view in views:
            while view:
                try:
                    count = self._tls.recv_into(view)
                except (ssl.SSLWantReadError, ssl.SSLWantWriteError):
                    if total:
                        return (total,)
                    raise BlockingIOError from None
                except ssl.SSLEOFError:
                    count = 0
                except ssl.SSLError as error:
                    if (error.reason or "").endswith(_REFUSALS):
                        raise _refused(error) from None
                    raise
                total += count
                view = view[count:]
                if count == 0:
                    return (total,)
        return (total,)


def _context(access: Access) -> ssl.SSLContext:
    for file in (access.ca, access.certificate, access.key):
        if file:
            _check_readable(file)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    if not access.verify:
        warnings.warn("verify=False: whoever answers is trusted", RuntimeWarning, stacklevel=2)
        context.check_hostname = False
        context.verify_mode = ssl.CERT_NONE
    elif access.ca:
        try:
            context.load_verify_locations(access.ca)
        except (OSError, ssl.SSLError) as error:
            raise errors.UsageError(f"{access.ca}: there is no CA certificate in PEM form in it "
                                    f"({_reason(error)}); it is the ca.pem of: raynestd tls init "
                                    "DIR") from None
    else:
        context.load_default_certs()
    if access.certificate:
        try:
            context.load_cert_chain(access.certificate, access.key)
        except (OSError, ssl.SSLError) as error:
            raise errors.UsageError(f"{access.certificate} and {access.key}: no certificate and key "
                                    f"that belong together ({_reason(error)})") from None
    return context


def _check_readable(file: str) -> None:
    # Do not open it: a pipe, as of a shell's <(...), can be read once.
    try:
        is_folder = stat.S_ISDIR(os.stat(file).st_mode)
    except OSError as error:
        raise errors.UsageError(f"cannot read {file}: {error.strerror}") from None
    if is_folder or not os.access(file, os.R_OK):
        raise errors.UsageError(f"cannot read {file}: "
                                + ("it is a folder" if is_folder else "Permission denied"))


def _reason(error: OSError) -> str:
    """Says in words why OpenSSL takes a file for unusable."""
    reason = getattr(error, "reason", None) or str(error)
    return {"EE_KEY_TOO_SMALL": "its key is too short to be safe: RSA needs 2048 bits",
            "CA_KEY_TOO_SMALL": "the key of its CA is too short to be safe: RSA needs 2048 bits",
            "CA_MD_TOO_WEAK": "it is signed with an unsafe hash: sign it with SHA-256",
            "KEY_VALUES_MISMATCH": "the key is another certificate's"}.get(reason, reason)


def _refused(error: ssl.SSLError) -> errors.Error:
    return errors.NotAllowedError("the daemon refuses this client's certificate "
                                  f"({error.reason}); give cert= and key= of a CA that its "
                                  "--client-ca names")


def _explain(error: ssl.SSLError, host: str) -> errors.Error:
    """Returns the exception for a failed handshake."""
    reason = error.reason or ""
    if isinstance(error, ssl.SSLCertVerificationError):
        expired, other_host, other_address = 10, 62, 64
        if error.verify_code in (other_host, other_address):
            return errors.ConnectError(f"the daemon's certificate is not for {host}; connect by a "
                                       "name that it has, or make one with: raynestd tls init DIR "
                                       f"--host {host}")
        if error.verify_code == expired:
            return errors.ConnectError("the daemon's certificate has expired; on its machine: "
                                       "raynestd tls renew DIR, then SIGHUP")
        return errors.ConnectError("no CA known here has signed the daemon's certificate "
                                   f"({error.verify_message}); pass ca= or set RAYNEST_CA to its "
                                   "ca.pem")
    if reason.endswith(_REFUSALS):
        return _refused(error)
    if reason in _NOT_TLS:
        return errors.ConnectError(f"what listens there does not speak TLS ({reason}); is it tcp:// "
                                   "in place of tls://?")
    return errors.ConnectError(f"no RayNest daemon answers on TLS: {reason or error}")
