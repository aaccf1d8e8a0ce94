"""A WebSocket client and plain HTTP requests, by hand, for the tests in this folder.

Nothing here is forgiving: what a browser would send is spelt out, so that a test can misspell it.
"""
import base64
import hashlib
import json
import os
import socket
import struct

from daemon import PATIENCE

GUID = b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11"
TEXT, BINARY, CLOSE, PING, PONG = 1, 2, 8, 9, 10
HEADER = struct.Struct("<4sHHIIQQ")


def place_of(http):
    """The host and port of http://HOST:PORT."""
    host, port = http.removeprefix("http://").rsplit(":", 1)
    return host.strip("[]"), int(port)


def raw(http, request, patience=PATIENCE):
    """Sends bytes, and returns all that come back until the daemon closes."""
    with socket.create_connection(place_of(http), timeout=patience) as connection:
        connection.sendall(request)
        answer = b""
        while part := connection.recv(65536):
            answer += part
        return answer


def split(answer):
    """Status, headers (names in lower case) and body of an answer."""
    head, _, body = answer.partition(b"\r\n\r\n")
    first, *lines = head.decode("latin-1").split("\r\n")
    headers = {name.lower(): value for name, value in (line.split(": ", 1) for line in lines)}
    return int(first.split()[1]), headers, body


def get(http, target="/", method="GET", host=None, headers=(), patience=PATIENCE):
    lines = [f"{method} {target} HTTP/1.1", f"Host: {host or http.removeprefix('http://')}",
             "Connection: close", *headers]
    return split(raw(http, "\r\n".join([*lines, "", ""]).encode("latin-1"), patience))


def upgrade_request(http, host=None, origin=None, target="/v1/stream", key="dGhlIHNhbXBsZSBub25jZQ=="):
    """The bytes of an upgrade; an origin of "" leaves the header out."""
    host = host or http.removeprefix("http://")
    origin = f"http://{host}" if origin is None else origin
    lines = [f"GET {target} HTTP/1.1", f"Host: {host}", "Connection: Upgrade", "Upgrade: websocket",
             f"Sec-WebSocket-Key: {key}", "Sec-WebSocket-Version: 13"]
    lines += [f"Origin: {origin}"] if origin else []
    return "\r\n".join([*lines, "", ""]).encode("latin-1")


class Closed(Exception):
    """The other end has closed; `code` is that of its close frame, if it sent one."""

    def __init__(self, code=None):
        super().__init__(f"closed, code {code}")
        self.code = code


class WebSocket:
    """One connection. `say` and `hear` speak frames of the protocol."""

    def __init__(self, http, receive_bytes=None, **request):
        """`receive_bytes` sets the size of the socket's buffer, which the kernel otherwise adapts."""
        self.socket = socket.socket()
        self.socket.settimeout(PATIENCE)
        if receive_bytes:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_bytes)
        self.socket.connect(place_of(http))
        self.buffer = b""
        key = base64.b64encode(os.urandom(16))
        self.socket.sendall(upgrade_request(http, key=key.decode(), **request))
        while b"\r\n\r\n" not in self.buffer:
            part = self.socket.recv(65536)
            if not part:
                break
            self.buffer += part
        head, _, self.buffer = self.buffer.partition(b"\r\n\r\n")
        status, headers, _ = split(head + b"\r\n\r\n")
        if status != 101:
            self.close()
            raise ConnectionError(status)
        expected = base64.b64encode(hashlib.sha1(key + GUID).digest()).decode()
        assert headers["sec-websocket-accept"] == expected, headers

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self):
        self.socket.close()

    def send(self, payload, opcode=TEXT, last=True, masked=True):
        """Sends one WebSocket frame."""
        if isinstance(payload, str):
            payload = payload.encode()
        size = len(payload)
        mark = 0x80 if masked else 0
        head = bytes([opcode | (0x80 if last else 0)])
        if size < 126:
            head += bytes([mark | size])
        elif size < 1 << 16:
            head += bytes([mark | 126]) + struct.pack(">H", size)
        else:
            head += bytes([mark | 127]) + struct.pack(">Q", size)
        self.socket.sendall(head + (b"\0\0\0\0" if masked else b"") + payload)

    def exactly(self, count):
        while len(self.buffer) < count:
            part = self.socket.recv(1 << 20)
            if not part:
                raise Closed()
            self.buffer += part
        taken, self.buffer = self.buffer[:count], self.buffer[count:]
        return taken

    def receive(self):
        """The opcode and payload of the next frame; the daemon sends no fragments."""
        first, size = self.exactly(2)
        assert first & 0x80 and not first & 0x70, "a whole frame without extensions"
        assert not size & 0x80, "a server does not mask"
        if size == 126:
            size = struct.unpack(">H", self.exactly(2))[0]
        elif size == 127:
            size = struct.unpack(">Q", self.exactly(8))[0]
        return first & 15, self.exactly(size)

    def say(self, name, request, message=None, bulk=b"", blocks=0, number=None):
        """Sends a frame: text without blocks, else binary under the type's number."""
        text = json.dumps(message or {})
        if not blocks:
            return self.send(f"{name} {request} {text}")
        header = HEADER.pack(b"RYN1", number, 0, len(text.encode()), blocks, len(bulk), request)
        return self.send(header + text.encode() + bulk, BINARY)

    def hear(self):
        """The next frame as (name, id, message, bulk); of a binary one the name is its number."""
        opcode, payload = self.receive()
        if opcode == CLOSE:
            raise Closed(struct.unpack(">H", payload[:2])[0] if payload else None)
        if opcode == TEXT:
            name, request, text = payload.decode().split(" ", 2)
            return name, int(request), json.loads(text), b""
        assert opcode == BINARY, opcode
        magic, number, flags, control, blocks, bulk, request = HEADER.unpack(payload[:HEADER.size])
        assert (magic, flags) == (b"RYN1", 0) and blocks != 0
        text = payload[HEADER.size:HEADER.size + control]
        assert len(payload) == HEADER.size + control + bulk, "lengths as the header says"
        return number, request, json.loads(text), payload[HEADER.size + control:]

    def answer(self, request):
        """The frames of one request until it ends; skips Progress and what others get."""
        frames = []
        while not frames or frames[-1][0] in ("Started", "Need", 153, 155):
            frame = self.hear()
            if frame[1] == request and frame[0] != "Progress":
                frames.append(frame)
        return frames

    def ask(self, name, request, message=None):
        self.say(name, request, message)
        return self.answer(request)


def greeted(http):
    """A WebSocket after its greeting."""
    connection = WebSocket(http)
    connection.say("Hello", 0, {"client": "test"})
    name, _, _, _ = connection.hear()
    assert name == "Welcome", name
    return connection
