#!/usr/bin/env python3
"""The times that the page waits, as ratios to their limits, one line each (1 or less: reached).

  page.py BIN_DIR [--json] [--rounds N]      e.g. page.py build/bin

It asks as the page does, over the WebSocket, for counts and normals of the built-in forest at 960x540: a
coarse picture of 1/16 of the rays, then the fine one. The browser's own share is in figures.mjs.

  first_coarse   time to the coarse picture, over a tenth of that to the fine one plus 30 ms
  coarse_rays    rays of both pictures, over 1.10 of the fine one's
  orbit          10 pictures per second, over those of a camera that moves with each; every 20th time a fine
                 picture begins that the next movement cancels
  health         longest answer of /healthz while all workers are busy, over 50 ms
"""
import argparse
import json
import math
import pathlib
import statistics
import sys
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "integration"))
from daemon import Client, Daemon  # noqa: E402
from websocket import get, greeted  # noqa: E402

FINE, COARSE = (960, 540), (240, 135)
CREDIT_BYTES = 1 << 20  # granted anew each time so much was read


class Page:
    """Asks for pictures over one WebSocket."""

    def __init__(self, http):
        self.socket = greeted(http)
        self.request = 0

    def ask(self, size, angle=0.0):
        """Begins a picture from a place on a circle; returns its number."""
        self.request += 1
        eye = f"{13 * math.sin(angle):.6g},2.2,{13 * math.cos(angle):.6g}"
        self.socket.say("Query", self.request, {
            "job": {"scene": "forest"}, "kind": "closest", "fields": ["total", "ng"],
            "generator": {"kind": "camera", "settings": ["size={}x{}".format(*size), f"lookat={eye},0,2,0,0,1,0"]}})
        return self.request

    def wait(self, request):
        """Reads until the picture is complete, or its cancellation is confirmed."""
        unread = 0
        while True:
            name, number, message, bulk = self.socket.hear()
            if number != request:
                continue
            if name in ("Done", "Error"):
                assert message.get("name", "CANCELLED") == "CANCELLED", message
                return
            unread += len(bulk)
            if unread >= CREDIT_BYTES:
                self.socket.say("Credit", request, {"bytes": unread})
                unread = 0

    def time(self, size, angle=0.0):
        begun = time.perf_counter()
        self.wait(self.ask(size, angle))
        return time.perf_counter() - begun


def rows(folder, rounds):
    daemon = Daemon(folder / "raynestd", "--http", "127.0.0.1:0")
    try:
        Client(folder / "raynest", daemon.uri).json("load", "builtin:forest", "--name", "forest")
        page = Page(daemon.http)
        page.time(FINE)
        coarse, fine = [], []
        for _ in range(rounds):
            coarse.append(page.time(COARSE))
            fine.append(page.time(FINE))
        early, whole = statistics.median(coarse), statistics.median(fine)
        yield {"figure": "first_coarse", "ratio": early / (whole / 10 + 0.03), "coarse_ms": 1000 * early, "fine_ms": 1000 * whole}
        rays = COARSE[0] * COARSE[1] / (FINE[0] * FINE[1])
        yield {"figure": "coarse_rays", "ratio": (1 + rays) / 1.10, "rays": 1 + rays}
        frames = 20 * rounds
        begun = time.perf_counter()
        for frame in range(frames):
            page.time(COARSE, 0.02 * frame)
            if frame % 20 == 19:
                useless = page.ask(FINE, 0.02 * frame)
                time.sleep(0.03)
                page.socket.say("Cancel", useless)
                page.wait(useless)
        rate = frames / (time.perf_counter() - begun)
        yield {"figure": "orbit", "ratio": 10 / rate, "pictures_per_second": rate}
        answers = []
        for _ in range(rounds):
            busy = [page.ask((2048, 2048), turn) for turn in (0, 3)]
            for _ in range(20):
                begun = time.perf_counter()
                assert get(daemon.http, "/healthz")[0] == 200
                answers.append(time.perf_counter() - begun)
            for request in busy:
                page.socket.say("Cancel", request)
            page.wait(busy[-1])
        yield {"figure": "health", "ratio": max(answers) / 0.05, "median_ms": 1000 * statistics.median(answers),
               "longest_ms": 1000 * max(answers)}
    finally:
        daemon.stop()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bin_dir", type=pathlib.Path, help="of the build: where raynestd lies")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--json", action="store_true", help="rows as JSON lines")
    options = parser.parse_args()
    for row in rows(options.bin_dir, options.rounds):
        if options.json:
            print(json.dumps(row), flush=True)
            continue
        rest = ", ".join(f"{key} {value:.3g}" for key, value in row.items() if key not in ("figure", "ratio"))
        print(f"{row['figure']:14} {row['ratio']:.3f}   {rest}", flush=True)


if __name__ == "__main__":
    main()
