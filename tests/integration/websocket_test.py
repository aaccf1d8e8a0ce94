#!/usr/bin/env python3
"""The WebSocket is one more transport: same requests, same answers, same limits as on TCP.

  websocket_test.py RAYNESTD RAYNEST
"""
import json
import pathlib
import socket
import struct
import sys
import time

from daemon import PATIENCE, Daemon, DaemonTest, main, until
from exr import read_exr
from websocket import BINARY, CLOSE, HEADER, PING, PONG, TEXT, Closed, WebSocket, get, greeted, place_of, raw, split, \
    upgrade_request

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "client" / "python"))
UPLOAD, QUERY_RAYS, CHUNK, PICTURE = 9, 25, 153, 155
RAYS = [(x * 0.25 - 8, 30.0, y * 0.25 - 8, 0.0, 0.1, -1.0, 0.05, float("inf"))
        for y in range(64) for x in range(64)]


class Transport(DaemonTest):
    arguments = ("--http", "127.0.0.1:0")

    loads = {"forest": "builtin:forest?trees=30"}

    def setUp(self):
        self.ws = greeted(self.daemon.http)
        self.addCleanup(self.ws.close)

    def stat(self, name):
        return self.client.json("stats")[name]

    def test_what_follows_a_refusal_is_thrown_away(self):
        """A connection that closes answers nothing, not even a message that cannot be read."""
        for _ in range(10):
            with WebSocket(self.daemon.http) as ws:
                ws.socket.sendall(b"".join(b"\x81" + bytes([0x80 | len(text)]) + b"\0\0\0\0" + text
                                           for text in (b"Ping 1 {}", b"x", b"Ping 1 {}")))
                self.assertTrue(ws.hear()[2]["closing"], "no Hello came first")
        self.assertEqual(get(self.daemon.http, "/healthz")[0], 200)
        self.ws.say("Ping", 5)
        self.assertEqual(self.ws.hear()[0], "Pong")

    def query(self, ws, request, fields, kind="closest"):
        """Asks for RAYS; the columns by name, with the rows in order."""
        ws.say("Query", request, {"job": {"scene": "forest"}, "kind": kind, "fields": fields,
                                  "ray_count": len(RAYS)})
        bulk = b"".join(struct.pack("<8f", *ray) for ray in RAYS)
        block = {"name": "rays", "dtype": "f32", "count": len(RAYS), "stride": 32, "offset": 0,
                 "bytes": len(bulk)}
        ws.say("QueryRays", request, {"first_ray": 0, "blocks": [block]}, bulk, 1, QUERY_RAYS)
        frames = ws.answer(request)
        self.assertEqual((frames[0][0], frames[-1][0]), ("Started", "Done"), frames[-1])
        columns = {name: b"" for name in fields}
        for _, _, chunk, data in sorted(frames[1:-1], key=lambda frame: frame[2]["first_ray"]):
            for block in chunk["blocks"]:
                columns[block["name"]] += data[block["offset"]:block["offset"] + block["bytes"]]
        return columns, frames[-1][2]

    def test_same_bytes_as_on_tcp(self):
        import numpy as np  # the daemon's Python client reads columns into arrays
        import raynest
        fields = ["t", "prim", "geom", "path", "uv", "ng", "position", "material", "boxes"]
        columns, done = self.query(self.ws, 5, fields)
        with raynest.connect(self.daemon.uri) as tcp:
            expected = tcp.scene("forest").trace(np.array(RAYS, np.float32), fields=tuple(fields))
        expected["position"] = expected["position"].astype(np.float32)  # with the origin float64
        for name in fields:
            self.assertEqual(columns[name], np.ascontiguousarray(expected[name]).tobytes(), name)
        self.assertEqual(done["hits"] + done["misses"], len(RAYS))
        self.assertGreater(done["hits"], 0)

    def test_pictures(self):
        frames = self.ws.ask("Heatmap", 3, {"job": {"scene": "forest"}, "width": 64, "height": 40,
                                            "encode": "raw"})
        self.assertEqual(frames[-1][0], "Done")
        counts = b"".join(data[:frame["blocks"][0]["bytes"]] for _, _, frame, data in frames[1:-1])
        counts = struct.unpack(f"<{64 * 40}I", counts)
        self.assertEqual(max(counts), frames[-1][2]["heat"]["max"])
        self.assertEqual(frames[-1][2]["heat"]["metric"], "total")

    def lit(self, request, upload=b"", **fields):
        """The frames of a lit picture, with the times at which they came."""
        self.ws.say("Render", request, {"job": {"scene": "forest"}, **fields, "resume_bytes": len(upload)})
        if upload:
            block = {"name": "data", "dtype": "u8", "count": len(upload), "stride": 1, "offset": 0, "bytes": len(upload)}
            self.ws.say("Upload", request, {"file": 0, "offset": 0, "blocks": [block]},
                        upload + bytes(-len(upload) % 64), 1, UPLOAD)
        frames = []
        while not frames or frames[-1][1][0] not in ("Done", "Error"):
            frames.append((time.monotonic(), self.ws.hear()))
            if frames[-1][1][0] == PICTURE:
                self.ws.say("Credit", request, {"bytes": len(frames[-1][1][3])})
        self.assertEqual(frames[-1][1][0], "Done", frames[-1][1][2])
        return frames

    def file_of(self, frames):
        return b"".join(data[:frame["blocks"][0]["bytes"]] for _, (name, _, frame, data) in frames if name == PICTURE)

    def test_the_time_that_a_lit_picture_takes_is_told_in_milliseconds_and_of_its_new_samples(self):
        path = {"integrator": "path", "encode": "exr", "width": 128, "height": 64}
        frames = self.lit(7, **path, samples=65536, best_by_ms=2500)
        told = [int(frame["left_ms"]) for _, (name, _, frame, _) in frames if name == "Progress" and "left_ms" in frame]
        self.assertLessEqual(max(told, default=0), 2500)
        samples, spent = 8, 0
        while spent < 2:  # until it has times to tell
            samples *= 2
            begun = self.lit(8, **path, samples=samples)
            spent = begun[-1][0] - begun[0][0]
        again = self.lit(9, self.file_of(begun), **path, samples=2 * samples)
        shares = []
        for at, (name, _, frame, _) in again:
            done, total = (int(frame.get(key, 0)) for key in ("done", "total"))
            if name == "Progress" and frame["stage"] == "tracing" and int(frame.get("left_ms", 0)) and 2 * done > total:
                shares.append(int(frame["left_ms"]) / 1000 / ((at - again[0][0]) * (total - done) / (done - total / 2)))
        # A share of what follows from the samples made now: at most a half, if those that were there counted as made now.
        self.assertTrue(shares)
        self.assertGreater(max(shares), 0.7, shares)

    def test_a_tile_tells_how_many_samples_it_took(self):
        asked = {"integrator": "ao", "samples": 256, "noise": 0.12, "width": 200, "height": 64}
        tiles = [frame for _, (name, _, frame, _) in self.lit(7, **asked, exposure="0", encode="raw")
                 if name == PICTURE and not frame.get("last")]
        width, _, layers = read_exr(self.file_of(self.lit(8, **asked, encode="exr")))
        taken = {(tile.get("x", 0), tile.get("y", 0)): tile["samples"] for tile in tiles}
        self.assertGreater(len(set(taken.values())), 1, taken)
        self.assertEqual(taken, {(x, y): layers["samples"][y * width + x] for x, y in taken})

    def test_numbers_travel_exactly(self):
        frame = self.ws.ask("Ping", 0, {"payload": "18446744073709551615"})
        self.assertEqual(frame[0][2], {"payload": "18446744073709551615"})
        self.assertEqual(self.ws.ask("Ping", 0, {"payload": 2**53})[0][2], {"payload": 2**53})
        self.assertEqual(self.ws.ask("Ping", 0, {"payload": str(2**53 + 1)})[0][2],
                         {"payload": str(2**53 + 1)})
        info = self.ws.ask("Info", 9, {"scene": "forest"})[0][2]
        told = self.client.json("info", "forest")
        for key in ("name", "hash", "instances", "instanced_triangles", "bytes", "cameras"):
            self.assertEqual(info[key], told[key], key)
        for key in ("box_min", "box_max"):
            as_float = [struct.unpack("<f", struct.pack("<f", info[key][axis]))[0] for axis in "xyz"]
            self.assertEqual(as_float, [struct.unpack("<f", struct.pack("<f", value))[0]
                                        for value in told[key]])
        self.assertEqual(self.ws.ask("Ping", 0)[0][2], {"payload": 0}, "defaults are written")

    def test_a_mistake_costs_its_request(self):
        for message, says in (('Info 4 {"scene":"forest","colour":"red"}', "unknown field: colour"),
                              ("Info 4 {scene:1}", ""), ("Info 4 [1]", ""), ("Info 4 {", ""),
                              ('Info 4 {"scene":"forest"} {}', ""), ("Info 4 table X {}", ""),
                              ('Info 4 {"scene":"forest"} table X { a: int; }', ""),
                              ('Info 4 include "/etc/passwd"; {}', ""),
                              ('Info 4 {"scene":7e9999}', ""), ('Info 4 {"scene":["a"]}', ""),
                              ('Info 4 {"scene":"a","scene":"b"}', ""),
                              ('Info 4 {"scene":"\ud800"}'.encode("utf-8", "surrogatepass"), None),
                              ('Heatmap 4 {"job":{"scene":"forest","mask":-1}}', "not fit"),
                              ("Heatmap 4 " + '{"job":' * 500 + "{}" + "}" * 500, "")):
            if says is None:
                continue  # a text of broken UTF-8 ends the WebSocket; see below
            self.ws.send(message)
            name, request, error, _ = self.ws.hear()
            self.assertEqual((name, request, error["name"]), ("Error", 4, "BAD_FRAME"), message[:60])
            self.assertIn(says, error["message"])
            self.assertLess(len(error["message"]), 400)
            self.assertFalse(error["closing"])
        self.ws.send("Nonsense 4 {}")
        self.assertEqual(self.ws.hear()[2]["name"], "UNKNOWN_TYPE")
        self.assertEqual(self.ws.ask("Info", 4, {"scene": "nothing"})[0][2]["name"], "SCENE_UNKNOWN")
        self.assertEqual(self.ws.ask("Info", 4, {"scene": "forest"})[0][0], "SceneInfo")

    def test_a_bad_part_ends_its_query(self):
        self.ws.say("Query", 6, {"job": {"scene": "forest"}, "ray_count": 64})
        self.ws.send('QueryRays 6 {"first":0}')
        frames = self.ws.answer(6)
        self.assertEqual(frames[-1][2]["name"], "BAD_FRAME")
        self.assertIn("unknown field: first", frames[-1][2]["message"])
        self.assertEqual(self.query(self.ws, 7, ["t"])[1]["rays"], len(RAYS))

    def ends(self, ws, code="BAD_FRAME"):
        """The connection ends after an Error that closes."""
        while True:
            name, _, error, _ = ws.hear()
            if name == "Error":
                break
        self.assertEqual((error["name"], error["closing"]), (code, True), error)
        with self.assertRaises(Closed) as closed:
            ws.hear()
        self.assertEqual(closed.exception.code, 1000)
        return error["message"]

    def test_messages_that_end_the_connection(self):
        rays = HEADER.pack(b"RYN1", QUERY_RAYS, 0, 2, 1, 64, 5) + b"{}"
        cases = [(TEXT, ""), (TEXT, "Info"), (TEXT, "Info {}"), (TEXT, "Info x {}"), (TEXT, "Info -1 {}"),
                 (TEXT, "Info 99999999999999999999 {}"), (TEXT, " 1 {}"), (TEXT, "x" * 100 + " 1 {}"),
                 (TEXT, "Welcome 0 {}"), (TEXT, "Hello 0 {}"), (BINARY, b""), (BINARY, b"RYN1"),
                 (BINARY, b"GET / HTTP/1.1\r\n" + bytes(60)), (BINARY, rays), (BINARY, rays + bytes(63)),
                 (BINARY, rays + bytes(65)), (BINARY, rays[:-1]),
                 (BINARY, HEADER.pack(b"RYN1", QUERY_RAYS, 0, 100, 0, 0, 5) + b"{}"),
                 (BINARY, HEADER.pack(b"RYN1", 11, 0, 2, 0, 0, 5) + b"{}more")]
        for opcode, message in cases:
            with self.subTest(message=message[:40]), greeted(self.daemon.http) as ws:
                ws.send(message, opcode)
                self.ends(ws)

    def test_limits(self):
        before = self.stat("bad_frames")
        with greeted(self.daemon.http) as ws:
            ws.send("Info 1 " + "x" * (65536 + 100))
            self.assertIn("control_bytes_max = 65536", self.ends(ws, "LIMIT_EXCEEDED"))
        with greeted(self.daemon.http) as ws:
            ws.send(HEADER.pack(b"RYN1", QUERY_RAYS, 0, 65537, 0, 0, 5), BINARY)
            self.assertIn("control_bytes_max", self.ends(ws, "LIMIT_EXCEEDED"))
        with greeted(self.daemon.http) as ws:
            ws.send(HEADER.pack(b"RYN1", QUERY_RAYS, 0, 2, 1, 64 << 20, 5) + b"{}", BINARY, last=False)
            self.assertIn("frame_bytes_max", self.ends(ws, "LIMIT_EXCEEDED"))
        with WebSocket(self.daemon.http) as ws:
            ws.send("Hello 0 " + json.dumps({"client": "x" * 5000}))
            self.assertIn("greeting_bytes_max = 4096", self.ends(ws, "LIMIT_EXCEEDED"))
        with WebSocket(self.daemon.http) as ws:
            ws.send(HEADER.pack(b"RYN1", 1, 0, 4097, 0, 0, 0) + bytes(4097), BINARY)
            self.assertIn("greeting_bytes_max = 4096", self.ends(ws, "LIMIT_EXCEEDED"))
        with WebSocket(self.daemon.http) as ws:
            ws.send('Stats 1 {}')
            self.assertIn("expected Hello", self.ends(ws))
        self.assertEqual(self.stat("bad_frames"), before + 6)
        # A message just below the limit is read.
        with greeted(self.daemon.http) as ws:
            ws.send("Info 1 {" + " " * 65000 + '"scene":"forest"}')
            self.assertEqual(ws.hear()[0], "SceneInfo")

    def test_no_hello_in_time(self):
        with WebSocket(self.daemon.http) as ws:
            self.assertIn("Hello", self.ends(ws, "DEADLINE"))

    def test_fragments(self):
        text = b'Info 2 {"scene":"forest"}'
        for at in range(len(text)):
            self.ws.send(text[at:at + 1], TEXT if at == 0 else 0, last=at == len(text) - 1)
            if at == 9:
                self.ws.send(b"between", PING)
                self.assertEqual(self.ws.receive(), (PONG, b"between"))
        self.assertEqual(self.ws.hear()[0], "SceneInfo")
        self.query(self.ws, 3, ["t"])

    def test_fragments_that_never_end(self):
        with greeted(self.daemon.http) as ws:
            try:
                ws.send("Info 1 ", TEXT, last=False)
                for _ in range(80):
                    ws.send("x" * 1024, 0, last=False)
            except OSError:
                pass  # cut off while sending
            self.assertIn("control_bytes_max", self.ends(ws, "LIMIT_EXCEEDED"))

    def test_frames_against_the_standard(self):
        for send in (lambda ws: ws.send("Ping 0 {}", masked=False),
                     lambda ws: ws.send(b"x" * 126, PING), lambda ws: ws.send("x", 3),
                     lambda ws: ws.send("x", 0), lambda ws: ws.send(b"\xff\xff 1 {}", TEXT),
                     lambda ws: ws.send(b"\x03", CLOSE),
                     lambda ws: ws.socket.sendall(b"\x81\xff" + b"\xff" * 8 + bytes(4))):
            with greeted(self.daemon.http) as ws:
                send(ws)
                with self.assertRaises((Closed, ConnectionError)):
                    for _ in range(10):
                        ws.hear()
        self.assertEqual(self.ws.ask("Ping", 0)[0][0], "Pong")

    def test_close(self):
        self.ws.send(struct.pack(">H", 1001) + b"bye", CLOSE)
        self.assertEqual(self.ws.receive(), (CLOSE, struct.pack(">H", 1001)))
        with self.assertRaises(Closed):
            self.ws.exactly(1)

    def test_closing_cancels_what_runs(self):
        before = self.stat("jobs_ended")
        with greeted(self.daemon.http) as ws:
            ws.say("Heatmap", 1, {"job": {"scene": "forest"}, "width": 8192, "height": 8192, "encode": "raw"})
            self.assertEqual(ws.hear()[0], "Started")
        until(lambda: self.stat("jobs_ended") > before)
        # The one that ended may be that of an earlier test.
        until(lambda: self.client.json("jobs").get("jobs", self.client.json("jobs")) == [])

    def test_cancel_and_credit(self):
        with WebSocket(self.daemon.http) as ws:
            ws.say("Hello", 0, {"window_bytes": 65536})
            ws.hear()
            ws.say("Heatmap", 1, {"job": {"scene": "forest"}, "width": 512, "height": 512, "encode": "raw"})
            self.assertEqual(ws.hear()[0], "Started")
            got, frame = 0, ws.hear()
            while got < 65536 // 2:
                if frame[0] == PICTURE:
                    got += len(frame[3])
                frame = ws.hear() if got < 65536 // 2 else frame
            self.assertLessEqual(got, 65536)
            ws.say("Credit", 1, {"bytes": 65536})
            while frame[0] != PICTURE or got <= 65536:
                frame = ws.hear()
                got += len(frame[3])
            ws.say("Cancel", 1)
            while frame[0] != "Error":
                frame = ws.hear()
                got += len(frame[3])
            self.assertEqual(frame[2]["name"], "CANCELLED")
            self.assertLessEqual(got, 2 * 65536)

    def test_a_slow_reader_stalls_itself(self):
        before = self.daemon.resident_bytes()
        slow = [greeted(self.daemon.http) for _ in range(8)]
        for ws in slow:
            for request in range(1, 5):
                ws.say("Heatmap", request, {"job": {"scene": "forest"}, "width": 1024, "height": 1024,
                                            "encode": "raw"})
                ws.say("Credit", request, {"bytes": 20 << 20})
        self.query(self.ws, 5, ["t"])  # which is answered while they wait
        self.assertTrue(self.client.json("jobs")["jobs"])
        # Four answers of 4 MiB each wait, for each of them.
        self.assertLess(self.daemon.resident_bytes() - before, 8 * (4 * 4 + 16) << 20)
        for ws in slow:
            ws.close()
        until(lambda: self.client.json("jobs").get("jobs", []) == [])

    def test_hundreds_that_come_and_go(self):
        files = len(list(pathlib.Path(f"/proc/{self.daemon.process.pid}/fd").iterdir()))
        for _ in range(100):
            greeted(self.daemon.http).close()
        until(lambda: len(list(pathlib.Path(f"/proc/{self.daemon.process.pid}/fd").iterdir())) <= files + 2)

    def test_half_an_upgrade(self):
        with socket.create_connection(place_of(self.daemon.http), timeout=PATIENCE) as connection:
            connection.sendall(b"GET /v1/stream HTTP/1.1\r\nUpgrade: websocket\r\n")
        for header in (b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n", b"Sec-WebSocket-Version: 13\r\n"):
            request = upgrade_request(self.daemon.http)
            self.assertIn(header, request)
            self.assertIn(split(raw(self.daemon.http, request.replace(header, b"")))[0], (400, 426))
        self.assertEqual(self.ws.ask("Ping", 0)[0][0], "Pong")


class Ends(DaemonTest):
    """A daemon's end, and its limits, as a WebSocket sees them."""
    arguments = ("--http", "127.0.0.1:0", "--principal-connections-max", "3")

    def test_a_principal_with_all_its_connections_is_told(self):
        open_ones = [greeted(self.daemon.http) for _ in range(3)]
        with WebSocket(self.daemon.http) as one_more:
            one_more.say("Hello", 0, {"client": "test"})
            name, _, message, _ = one_more.hear()
        self.assertEqual(name, "Error")
        self.assertIn("--principal-connections-max", message["message"])
        for ws in open_ones:
            ws.close()

    def test_too_many_are_told_over_http(self):
        daemon = Daemon(self.raynestd, "--http", "127.0.0.1:0", "--connections-max", "1")
        self.addCleanup(daemon.stop)
        with greeted(daemon.http), self.assertRaises(ConnectionError) as refused:
            WebSocket(daemon.http)
        self.assertEqual(refused.exception.args, (503,))

    def test_a_drain_and_a_restart(self):
        daemon = Daemon(self.raynestd, "--http", "127.0.0.1:0")
        ws = greeted(daemon.http)
        ws.ask("Load", 1, {"source": "builtin:forest?trees=400", "name": "forest"})
        ws.say("Heatmap", 2, {"job": {"scene": "forest"}, "width": 4096, "height": 4096, "encode": "raw"})
        self.assertEqual(ws.hear()[0], "Started")
        daemon.process.terminate()
        until(lambda: get(daemon.http, "/readyz")[0] == 503)
        self.assertEqual(get(daemon.http, "/healthz")[0], 200)
        with self.assertRaises(ConnectionError) as refused:
            WebSocket(daemon.http)
        self.assertEqual(refused.exception.args, (503,))
        ws.say("Cancel", 2)
        names = []
        with self.assertRaises(Closed):
            while True:
                frame = ws.hear()
                names += [frame[2]["name"]] if frame[0] == "Error" else []
        self.assertEqual(names, ["CANCELLED", "DRAINING"])
        port = place_of(daemon.http)[1]
        self.assertEqual(daemon.process.wait(timeout=PATIENCE), 0)
        daemon.folder.cleanup()
        ws.close()
        again = Daemon(self.raynestd, "--http", f"127.0.0.1:{port}")
        self.addCleanup(again.stop)
        self.assertEqual(again.http, daemon.http)
        with greeted(again.http) as ws:
            self.assertEqual(ws.ask("Ping", 0)[0][0], "Pong")


if __name__ == "__main__":
    main()
