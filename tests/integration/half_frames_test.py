#!/usr/bin/env python3
"""The memory of half a frame is counted for as long as it is held, also when its request has ended.

  half_frames_test.py RAYNESTD RAYNEST
"""
import json
import struct

from daemon import DaemonTest, main, until
from websocket import BINARY, HEADER, Closed, greeted

UPLOAD = 9
WINDOW = 8 << 20
REST = 64  # bytes of a frame that do not come


def message(request):
    """A whole window of a file, as a frame of WebSocket."""
    count = WINDOW - REST
    block = {"name": "data", "dtype": "u8", "count": count, "stride": 1, "offset": 0, "bytes": count}
    text = json.dumps({"file": 0, "offset": 0, "blocks": [block]}).encode()
    payload = HEADER.pack(b"RYN1", UPLOAD, 0, len(text), 1, count, request) + text + bytes(count)
    return bytes([0x80 | BINARY, 0x80 | 127]) + struct.pack(">Q", len(payload)) + bytes(4) + payload


class HalfFrames(DaemonTest):
    arguments = ("--http", "127.0.0.1:0", "--memory", "64M", "--give-way-ms", "500")

    def stat(self, name):
        return self.client.json("stats")[name]

    def begin(self, deadline_ms):
        """A connection that asks to upload a file, and the answer."""
        ws = greeted(self.daemon.http)
        self.addCleanup(ws.close)
        ws.say("Load", 1, {"source": "a.obj", "name": "a", "file_names": ["a.obj"], "file_bytes": [WINDOW],
                           "file_hashes": [0], "deadline_ms": deadline_ms})
        return ws, ws.hear()

    def test_the_memory_of_half_a_frame_is_counted_until_its_connection_gives_way(self):
        idle = self.stat("memory_used_bytes")
        halves = []
        for _ in range(4):
            ws, (name, _, answer, _) = self.begin(2000)
            self.assertEqual(name, "Need", answer)
            ws.socket.sendall(message(1)[:-REST])
            halves.append(ws)
        for ws in halves:
            frame = ws.answer(1)[-1]
            self.assertEqual(frame[2]["name"], "DEADLINE", frame)
        self.assertGreaterEqual(self.stat("memory_used_bytes") - idle, 4 * (WINDOW - REST))

        # Its rest makes a frame that nobody wants any more.
        halves[0].socket.sendall(bytes(REST))
        self.assertEqual(halves[0].ask("Ping", 2)[0][0], "Pong")
        self.assertLess(self.stat("memory_used_bytes") - idle, 4 * (WINDOW - REST))

        # The others give way when their memory is needed.
        gave_way = self.stat("gave_way_memory")
        until(lambda: self.begin(600_000)[1][0] == "Need" and self.stat("gave_way_memory") > gave_way)
        with self.assertRaises((Closed, ConnectionError)):
            while True:
                halves[1].hear()


if __name__ == "__main__":
    main()
