#!/usr/bin/env python3
"""Measures how long the io thread is kept by the largest requests: CPU time of its longest turn for each.

  turns.py RAYNESTD [--instances N] [--json]

The daemon logs each turn of 0.25 ms and more at level debug; a request without such a line prints `< 0.25`. All
requests travel as JSON over a WebSocket with TLS, which costs most: the other transports run the same handlers on less
text. Quiet machine, release build: no turn may take more than 5 ms. Fails if a request of the protocol has no row.
"""
import argparse
import json
import pathlib
import re
import struct
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "tests/integration"))

import websocket  # noqa: E402
from secure_daemon import Certificates, SecureDaemon, Tokens, command  # noqa: E402
from websocket import WebSocket  # noqa: E402

GOAL_MS = 5
LIST = 512          # list_items_max
SIDE = 8192         # picture_pixels_max is its square
UPLOAD = 8 << 20    # window_bytes
EDIT_ROW = 112      # bytes
EDIT_ROWS = 64
TOKENS = 20_000
MOVES_ALL = (1, 0, 1, 0, 1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0)  # move, the first text, by text, in the world: by 1
QUERY_RAYS, UPLOADED = 25, 9  # numbers of messages that have a bulk part


def text_of_bytes(size):
    """A value that fills a control message up to `size` bytes."""
    return "x" * (size - 200)


def block_of(name, kind, count, stride):
    return [{"name": name, "dtype": kind, "count": count, "stride": stride, "offset": 0, "bytes": count * stride}]


class Peer(WebSocket):
    asked = set()  # names of requests, by all peers

    def say(self, name, *more, **options):
        Peer.asked.add(name)
        return super().say(name, *more, **options)


def requests_without_row():
    listed = re.findall(r"^RAYNEST_REQUEST\(\d+, (\w+)", (ROOT / "protocol/lists/requests.def").read_text(), re.MULTILINE)
    return sorted(set(listed) - Peer.asked)


def greeted(daemon, token):
    peer = Peer(daemon.http, headers=[f"Authorization: Bearer {token}"])
    peer.say("Hello", 0, {"client": "turns"})
    peer.hear()
    return peer


def finish(peer, request):
    """Reads a request's frames to the last one, and returns that one's message; grants credit for all."""
    while True:
        name, of, message, bulk = peer.hear()
        if of != request:
            continue
        if bulk:
            peer.say("Credit", request, {"bytes": len(bulk)})
        if name not in ("Started", "Need", "Progress", "Credit", 153, 155):
            return message


class Turns:
    def __init__(self, daemon, token, as_json):
        self.daemon, self.token, self.as_json, self.rows = daemon, token, as_json, []

    def measure(self, name, act):
        """Runs `act` with a new connection and keeps the longest turn that the daemon logs meanwhile."""
        with greeted(self.daemon, self.token) as peer:
            time.sleep(0.1)
            before = len(self.daemon.log())
            act(peer)
        time.sleep(0.3)  # what is freed after the last frame
        turns = [json.loads(line) for line in self.daemon.log()[before:].splitlines() if '"long_turn"' in line]
        longest = max(turns, key=lambda turn: int(turn["cpu_us"]), default=None)
        row = {"request": name, "cpu_ms": int(longest["cpu_us"]) / 1e3 if longest else None,
               "turn": f"{longest['message']} {longest['does']}".strip() if longest else ""}
        self.rows.append(row)
        late = "  over the goal" if (row["cpu_ms"] or 0) > GOAL_MS else ""
        print(json.dumps(row) if self.as_json else
              f"{name:52} {row['cpu_ms'] or '< 0.25':>8} ms  {row['turn']}{late}", flush=True)

    def ask(self, name, message, label=None, parts=()):
        """Measures a request to its end; `parts` are the frames that follow it."""
        def act(peer):
            peer.say(name, 1, message)
            for part in parts:
                part(peer)
            finish(peer, 1)
        self.measure(label or name, act)

    def cancel(self, name, message, after, label):
        """Measures a request that is cancelled after so many seconds."""
        def act(peer):
            peer.say(name, 1, message)
            time.sleep(after)
            peer.say("Cancel", 1, {})
            finish(peer, 1)
        self.measure(label, act)


def job(**more):
    return {"scene": "large", **more}


def dearest_texts():
    """Texts of 64 KiB or as many tokens as are read, of one kind of token each."""
    def values(count, each):
        return '{"job":{"scene":"none","tables":[{"name":"a","values":[' + ",".join([each] * count) + "]}]}}"
    yield "short numbers", values(9990, "0.5")
    yield "numbers with exponents", values(9000, "1e-300")
    yield "numbers of 17 digits", values(2600, "1.2345678901234567e-30")
    yield "one number", values(1, "9" * 60000 + "e-60000")
    yield "numbers as texts", values(2000, '"1e-30"')
    yield "short texts", '{"fields":[' + ",".join(['""'] * 2000) + "]}"
    yield "escapes", '{"job":{"scene":"' + "\\u0041" * 10800 + '"}}'
    yield "empty objects", '{"job":{"tables":[' + ",".join(["{}"] * 4000) + "]}}"
    yield "blanks", "{" + " " * 65000 + "}"
    yield "functions", values(8100, "sin(1)")


def picture(side, **more):
    return {"job": job(), "width": side, "height": side, "encode": "raw", **more}


def measure_all(turns, instances):
    film = {"integrator": "ao", "samples": 1}
    hidden = job(hidden_instances=list(range(LIST)))
    turns.measure("a TLS handshake and Hello", lambda _: greeted(turns.daemon, turns.token).close())
    turns.ask("Load", {"source": "0.glb", "name": "files", "file_names": [f"{i}{'x' * 80}.glb" for i in range(LIST)],
                       "file_hashes": [2 ** 64 - 1] * LIST, "file_bytes": [0] * LIST}, "Load of 512 files, 60 KB of JSON")
    turns.measure("a broken message of 64 KiB",
                  lambda peer: (peer.say("Ping", 1, {}), peer.send("Ping 2 {" + text_of_bytes(65536)), finish(peer, 2)))
    for kind, text in dearest_texts():
        turns.measure(f"a text of {kind}", lambda peer, text=text: (peer.send("Query 2 " + text), finish(peer, 2)))
    for name in ("Scenes", "Variants", "Stats", "Jobs", "Page"):
        turns.ask(name, {})
    turns.ask("Info", {"scene": "large"})
    turns.ask("Parts", {"scene": "large", "kind": "meshes"})
    turns.ask("Path", {"scene": "large", "path": instances - 1}, "Path by number")
    turns.ask("Path", {"scene": "large", "text": "no such tree"}, "Path by text")
    for kind in ("objects", "placements", "boxes"):
        turns.ask("Structure", {"scene": "large", "kind": kind, "count": 16384, "depth_max": 32}, f"Structure, {kind}")
    lidar = {"kind": "lidar", "settings": ["elevations=" + ",".join(str(i / 10) for i in range(-45, 45)),
                                           "azimuths=0:360:65536"]}
    turns.cancel("Query", {"job": job(), "generator": lidar}, 0.5, "Query of a lidar")
    turns.ask("Query", {"job": hidden, "kind": "any", "generator": {"kind": "camera", "settings": ["size=640x480"]}},
              "Query that hides")
    turns.ask("Query", {"job": job(), "reduce": "visible_pixels",
                        "generator": {"kind": "camera", "settings": ["size=2048x2048"]}}, "Query, visible_pixels")
    rays = bytes(16384 * 32)
    block = block_of("rays", "f32", 16384, 32)
    turns.ask("Query", {"job": job(), "kind": "null", "ray_count": 8 * 16384}, "Query and its rays",
              [lambda peer, i=i: peer.say("QueryRays", 1, {"first_ray": i * 16384, "blocks": block}, rays, 1, QUERY_RAYS)
               for i in range(8)])
    turns.ask("Load", {"source": "builtin:street?seconds=10", "name": "street"}, "Load of a scene that moves")
    for again in ("", " again"):
        turns.ask("Query", {"job": {"scene": "street", "timed": True, "time": 5.0},
                            "generator": {"kind": "camera", "settings": ["size=64x64"]}}, f"Query of another time{again}")
    turns.cancel("Render", picture(SIDE), 0.3, "Render, primary")
    turns.cancel("Render", {**picture(SIDE), "job": hidden}, 0.3, "Render that hides")
    for after in (0.0, 0.05, 1.0):
        turns.cancel("Render", picture(6144, **film), after, f"Render of a film, cancelled after {after:g} s")
    turns.ask("Render", picture(2048, **film), "Render of a film, in tiles")
    turns.ask("Render", picture(2048, **film, progressive=True), "Render of a film, refined")
    turns.cancel("Heatmap", picture(SIDE, count="necessary", job=hidden), 0.3, "Heatmap")
    turns.ask("Blame", {"job": hidden, "width": 512, "height": 512, "top": 1000})
    turns.ask("Explain", {"job": hidden, "width": 512, "height": 512, "pixel_x": 256, "pixel_y": 400, "steps": 16384})
    turns.ask("Load", {"source": "a.glb", "name": "upload", "file_names": ["a.glb"], "file_hashes": [1],
                       "file_bytes": [UPLOAD]}, "Load and its upload",
              [lambda peer: peer.say("Upload", 1, {"blocks": block_of("data", "u8", UPLOAD, 1)}, bytes(UPLOAD), 1, UPLOADED)])

    turns.ask("Edit", {"scene": "large", "targets": ["*"], "rows": EDIT_ROWS}, "Edit and its rows",
              [lambda peer: peer.say("Upload", 1, {"blocks": block_of("data", "u8", EDIT_ROW * EDIT_ROWS, 1)},
                                     struct.pack("<4I12d", *MOVES_ALL) * EDIT_ROWS, 1, UPLOADED)])
    turns.ask("Pin", {"scene": "large"})
    turns.ask("Export", {"scene": "large", "format": "glb"})

    def detached(peer):
        peer.say("Query", 1, {"job": job(detach=True), "generator": {"kind": "camera", "settings": ["size=2048x2048"]}})
        number = int(finish(peer, 1)["job"])
        for i, name in enumerate(("Wait", "Jobs", "Fetch", "CancelJob")):
            peer.say(name, 2 + i, {} if name == "Jobs" else {"job": number})
            finish(peer, 2 + i)

    turns.measure("a detached Query, Wait, Jobs, Fetch, CancelJob", detached)
    turns.measure("/metrics", lambda peer: websocket.get(turns.daemon.http, "/metrics",
                                                         headers=[f"Authorization: Bearer {turns.token}"]))
    turns.measure("the page", lambda peer: websocket.get(turns.daemon.http, "/login.html"))
    turns.ask("Admin", {"act": "connections"}, "Admin connections")
    turns.ask("Admin", {"act": "reload"}, "Admin reload")
    turns.ask("Unload", {"scene": "large"})


def measure_state(turns, instances):
    """Measures a daemon with a state folder."""
    turns.ask("Load", {"source": f"builtin:forest?trees={instances}", "name": "large"}, "Load, stored")
    archive = bytearray()

    def backup(peer):
        peer.say("Backup", 1, {})
        while True:
            name, _, message, bulk = peer.hear()
            if bulk:
                archive.extend(bulk[:message["blocks"][0]["bytes"]])
                peer.say("Credit", 1, {"bytes": len(bulk)})
            if name in ("Done", "Error"):
                return

    def restore(peer):
        peer.say("Restore", 1, {"bytes": len(archive)})
        for first in range(0, len(archive), UPLOAD // 8):
            piece = bytes(archive[first:first + UPLOAD // 8])
            peer.say("Upload", 1, {"offset": first, "blocks": block_of("data", "u8", len(piece), 1)},
                     piece + bytes(-len(piece) % 64), 1, UPLOADED)
        finish(peer, 1)

    turns.measure("Backup", backup)
    turns.ask("Unload", {"scene": "large"}, "Unload, stored")
    turns.measure("Restore", restore)


def measure_tokens(turns, tokens, rows):
    """Measures a token file with so many rows."""
    many = "".join(f"token user never - {i:064x} t{i}\n" for i in range(rows))

    def watched(peer):
        with open(tokens.file, "a") as file:
            file.write("# read again\n")
        time.sleep(1)
        peer.say("Ping", 1, {})
        finish(peer, 1)

    with open(tokens.file, "a") as file:
        file.write(many)
    time.sleep(2)
    turns.measure(f"a Hello with one of {rows} tokens", lambda _: greeted(turns.daemon, turns.token).close())
    turns.measure(f"{rows} tokens, read because the file changed", watched)
    turns.ask("Admin", {"act": "reload"}, f"Admin reload with {rows} tokens")


def rsa_certificate(certificates, folder):
    """A certificate with a key of 4096 bits, as options of the daemon."""
    key, request, made = folder / "rsa.pem", folder / "rsa.csr", folder / "rsa-cert.pem"
    command("openssl", "req", "-new", "-newkey", "rsa:4096", "-nodes", "-keyout", key, "-subj", "/CN=localhost",
            "-addext", "subjectAltName=IP:127.0.0.1,DNS:localhost", "-out", request)
    command("openssl", "x509", "-req", "-in", request, "-CA", certificates.folder / "ca.pem", "-CAkey",
            certificates.folder / "ca-key.pem", "-days", "9", "-copy_extensions", "copy", "-out", made)
    key.chmod(0o600)
    return "--tls-cert", made, "--tls-key", key


def main():
    made = argparse.ArgumentParser()
    made.add_argument("raynestd")
    made.add_argument("--instances", type=int, default=1_000_000)
    made.add_argument("--json", action="store_true")
    words = made.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        certificates = Certificates(words.raynestd, folder / "tls")
        websocket.trusted.load_verify_locations(certificates.ca)
        tokens = Tokens(words.raynestd, folder / "tokens")
        token = tokens.add("me", "--role", "admin")
        logs = ("--log-level", "debug", "--log-format", "json", "--tokens", tokens.file)
        daemon = SecureDaemon(words.raynestd, certificates, *logs, "--http", "https://127.0.0.1:0", "--memory", "64G")
        try:
            turns = Turns(daemon, token, words.json)
            turns.ask("Load", {"source": f"builtin:forest?trees={words.instances}", "name": "large"}, "Load")
            measure_all(turns, words.instances)
            rows += turns.rows
        finally:
            daemon.stop()
        daemon = SecureDaemon(words.raynestd, certificates, *logs, "--http", "https://127.0.0.1:0", "--memory", "64G",
                              "--state", folder / "state")
        try:
            turns = Turns(daemon, token, words.json)
            measure_state(turns, words.instances)
            measure_tokens(turns, tokens, TOKENS)
            rows += turns.rows
        finally:
            daemon.stop()
        certificates.server = rsa_certificate(certificates, folder)
        daemon = SecureDaemon(words.raynestd, certificates, *logs, "--http", "https://127.0.0.1:0")
        try:
            turns = Turns(daemon, token, words.json)
            turns.measure("a TLS handshake with a key of RSA 4096", lambda _: greeted(daemon, token).close())
            rows += turns.rows
        finally:
            daemon.stop()
    if missing := requests_without_row():
        print("no row for " + ", ".join(missing), file=sys.stderr)
        return 1
    return any((row["cpu_ms"] or 0) > GOAL_MS for row in rows)


if __name__ == "__main__":
    sys.exit(main())
