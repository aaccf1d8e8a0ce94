#!/usr/bin/env python3
"""Plays the first conversation of PROTOCOL.md to a daemon, byte by byte.

  conversation_test.py RAYNESTD RAYNEST

The table of section 2 has a row for each frame; the dumps below it are the frames. The test sends
the client's dumps and compares the daemon's frames with theirs. Frames without a dump name times
or the machine: their type, id and a few numbers are compared.
"""
import pathlib
import re
import socket
import struct
import urllib.parse

from daemon import PATIENCE, Daemon, Programs, main

ROOT = pathlib.Path(__file__).resolve().parents[2]
HEADER = struct.Struct("<4sHHIIQQ")  # magic, type, flags, control, blocks, bulk, request id
LETTERS = bytes(range(256)).decode("latin-1").translate({i: "." for i in [*range(33), *range(127, 256)]})


def dump(name, frame):
    """Returns the text of a frame as PROTOCOL.md shows it."""
    lines = [f"frame {name}"]
    for at in range(0, len(frame), 16):
        row = frame[at:at + 16]
        lines.append(f"{at:04x}  {row.hex(' '):47}  {''.join(LETTERS[byte] for byte in row)}")
    return "\n".join(lines)


def number(frame, field):
    """Returns a u64 of the frame's control message, by its place in messages.fbs."""
    table = HEADER.size + struct.unpack_from("<I", frame, HEADER.size)[0]
    vtable = table - struct.unpack_from("<i", frame, table)[0]
    place = 4 + 2 * field
    inside = place < struct.unpack_from("<H", frame, vtable)[0]
    offset = struct.unpack_from("<H", frame, vtable + place)[0] if inside else 0
    return struct.unpack_from("<Q", frame, table + offset)[0] if offset else 0


class Conversation(Programs):
    def setUp(self):
        page = (ROOT / "protocol" / "PROTOCOL.md").read_text(encoding="utf-8")
        section = page[page.index("## 2. "):page.index("## 3. ")]
        self.rows = re.findall(r"^\| (client|daemon) \| (\w+) \| (\d+) \|", section, re.MULTILINE)
        self.shown = dict(re.findall(r"^frame (\w+)\n((?:[0-9a-f]{4}  .*\n)+)", section, re.MULTILINE))
        schema = (ROOT / "protocol" / "messages.fbs").read_text(encoding="utf-8")
        union = schema[schema.index("union Message"):]
        self.types = {name: int(value) for name, value in re.findall(r"(\w+) = (\d+),", union)}

    def bytes_of(self, name):
        return bytes.fromhex("".join(line[6:53] for line in self.shown[name].splitlines()))

    def test_dumps_are_written_as_bytes_are(self):
        for name, text in self.shown.items():
            self.assertEqual(f"frame {name}\n{text}".rstrip(), dump(name, self.bytes_of(name)))

    def test_every_dump_has_its_row(self):
        names = [name for _, name, _ in self.rows]
        self.assertEqual(len(names), len(set(names)))
        self.assertLessEqual(set(self.shown), set(names))
        for sender, name, _ in self.rows:
            self.assertEqual(sender == "client", self.types[name] < 128, name)
            if sender == "client":
                self.assertIn(name, self.shown)

    def test_a_daemon_answers_as_the_page_says(self):
        daemon = Daemon(self.raynestd)
        self.addCleanup(daemon.stop)
        address = urllib.parse.urlsplit(daemon.uri)
        with socket.create_connection((address.hostname, address.port), timeout=PATIENCE) as self.peer:
            for sender, name, request in self.rows:
                act = self.send if sender == "client" else self.expect
                act(name, int(request))

    def send(self, name, request):
        frame = self.bytes_of(name)
        magic, kind, _, control, _, bulk, own = HEADER.unpack_from(frame)
        self.assertEqual((magic, kind, own), (b"RYN1", self.types[name], request))
        self.assertEqual(len(frame), HEADER.size + control + bulk)
        self.peer.sendall(frame)

    def expect(self, name, request):
        frame = self.receive()
        while struct.unpack_from("<H", frame, 4)[0] == self.types["Progress"]:
            frame = self.receive()
        _, kind, _, _, _, _, own = HEADER.unpack_from(frame)
        if name in self.shown:
            self.assertEqual(frame, self.bytes_of(name), "the daemon sent\n" + dump(name, frame))
        self.assertEqual((kind, own), (self.types[name], request), dump(f"in place of {name}", frame))
        if name == "Done":
            self.assertEqual([number(frame, field) for field in range(3)], [2, 1, 1])

    def receive(self):
        header = self.take(HEADER.size)
        _, _, _, control, _, bulk, _ = HEADER.unpack(header)
        return header + self.take(control + bulk)

    def take(self, count):
        taken = b""
        while len(taken) < count:
            part = self.peer.recv(count - len(taken))
            self.assertTrue(part, "the daemon closed the connection")
            taken += part
        return taken


if __name__ == "__main__":
    main()
