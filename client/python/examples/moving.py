#!/usr/bin/env python3
"""Scans a scene with a lidar while a part of it moves: each frame is an edit and a sweep."""
import argparse
import time

import numpy as np

import raynest
import terminal


def options():
    parser = terminal.parser(__doc__, "moving.py builtin:forest --part birch-17 --by 0.5,0,0 --frames 20",
                             loaded=False)
    parser.add_argument("--part", default="birch-1*",
                        help="text of a path; * stands for any text (%(default)s)")
    parser.add_argument("--by", type=numbers, default=(0.5, 0, 0), metavar="DX,DY,DZ",
                        help="metres that it moves in each frame (0.5,0,0)")
    parser.add_argument("--frames", type=terminal.count, default=20, help="(%(default)s)")
    parser.add_argument("--channels", type=terminal.count, default=32, help="(%(default)s)")
    parser.add_argument("--azimuths", type=terminal.count, default=1800, help="(%(default)s)")
    parser.add_argument("-o", "--output", help="a .npz with the points of each frame")
    return parser.parse_args()


def numbers(text):
    """Parses DX,DY,DZ; the type of an option."""
    try:
        x, y, z = (float(word) for word in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not DX,DY,DZ") from None
    return x, y, z


def main():
    args = options()
    client = raynest.connect(args.server)
    # A name of its own: an edit changes the scene for all who use it.
    scene = client.load(args.source, "moving", replace=True)
    low, high = np.array(scene.info["box_min"]), np.array(scene.info["box_max"])
    eye = (low + high) / 2 + (0, high[1] - low[1], 0)
    lidar = raynest.generators.lidar(np.linspace(-60, 10, args.channels), (0, 360, args.azimuths),
                                     look_at=(eye, eye + (1, 0, 0)))
    frames, edits, sweeps = {}, [], []
    for frame in range(args.frames):
        begin = time.perf_counter()
        with scene.edit() as edit:
            edit.move(args.part, args.by)
        edited = time.perf_counter()
        seen = scene.trace(lidar, fields=("position", "hit"), epoch=edit.epoch)
        edits.append(edited - begin)
        sweeps.append(time.perf_counter() - edited)
        frames[f"frame_{frame:04d}"] = seen["position"][seen["hit"] != 0]
        if not args.quiet:
            print(f"frame {frame}: epoch {edit.epoch}, {edit.instances} instances moved in "
                  f"{1000 * edits[-1]:.1f} ms, {len(frames[f'frame_{frame:04d}']):,} points in "
                  f"{1000 * sweeps[-1]:.1f} ms")
    if args.output:
        np.savez_compressed(args.output, **frames)
    print(f"{args.frames} frames: an edit takes {1000 * np.median(edits):.1f} ms, a sweep "
          f"{1000 * np.median(sweeps):.1f} ms (medians)")


if __name__ == "__main__":
    terminal.run(main)
