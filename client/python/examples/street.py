#!/usr/bin/env python3
"""Drives through traffic with a lidar on the roof: each period is one edit of all cars, and one sweep."""
import time

import numpy as np

import raynest
import terminal

LENGTH = 400.0         # metres, of builtin:street
LANE_WIDTH = 3.25
WHEEL_RADIUS = 0.33
SENSOR = 1.9           # metres over the ground, above the middle of the first car


def options():
    parser = terminal.parser(__doc__, "street.py --cars 50 --seconds 10 -o sweeps.npz")
    parser.add_argument("--cars", type=terminal.count, default=50, help="(%(default)s)")
    parser.add_argument("--speed", type=float, default=12, help="metres per second (%(default)s)")
    parser.add_argument("--rate", type=terminal.count, default=10, help="sweeps per second (%(default)s)")
    parser.add_argument("--seconds", type=terminal.count, default=10, help="(%(default)s)")
    parser.add_argument("--channels", type=terminal.count, default=64, help="(%(default)s)")
    parser.add_argument("--azimuths", type=terminal.count, default=1800, help="(%(default)s)")
    parser.add_argument("-o", "--output", help="a .npz with the points of each sweep, in the world")
    parser.set_defaults(source="")
    return parser.parse_args()


class Traffic:
    """Cars on the four lanes of builtin:street, at speeds of their own. Two lanes lead towards -X."""

    def __init__(self, cars, speed):
        number = np.arange(cars)
        self.names = [f"car-{i}" for i in number]
        self.wheels = [f"{name}/wheel-*" for name in self.names]
        self.z = LANE_WIDTH * (number % 4 - 1.5)
        self.ahead = np.where(number % 4 < 2, -1.0, 1.0)
        self.start = LENGTH * ((number // 4 + 0.5) / ((cars + 3) // 4) - 0.5)
        self.speed = speed * np.random.default_rng(1).uniform(0.9, 1.1, 4)[number % 4]

    def poses(self, now):
        """Where the cars stand, as (N, 3, 4); who leaves the street comes in again at its other end."""
        at = self.start + self.ahead * self.speed * now
        pose = np.zeros((len(at), 3, 4))
        pose[:, 0, 0] = pose[:, 2, 2] = self.ahead
        pose[:, 1, 1] = 1
        pose[:, 0, 3] = (at + LENGTH / 2) % LENGTH - LENGTH / 2
        pose[:, 2, 3] = self.z
        return pose

    def turns(self, seconds):
        """By how much the wheels turn in so many seconds, as (N, 3, 4)."""
        angle = -self.speed * seconds / WHEEL_RADIUS
        turn = np.zeros((len(angle), 3, 4))
        turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angle)
        turn[:, 1, 0] = np.sin(angle)
        turn[:, 0, 1] = -turn[:, 1, 0]
        turn[:, 2, 2] = 1
        return turn


def main():
    args = options()
    client = raynest.connect(args.server)
    scene = client.load(args.source or f"builtin:street?cars={args.cars}", "street", replace=True)
    traffic = Traffic(args.cars, args.speed)
    period = 1 / args.rate
    clouds, edits, sweeps, late = {}, [], [], 0
    begin = time.perf_counter()
    for sweep in range(args.rate * args.seconds):
        due = begin + sweep * period
        time.sleep(max(0, due - time.perf_counter()))
        started = time.perf_counter()
        poses = traffic.poses(sweep * period)
        with scene.edit() as edit:
            edit.place(traffic.names, poses)
            edit.move(traffic.wheels, traffic.turns(period), frame="own")
        edited = time.perf_counter()
        eye = poses[0, :, 3] + (0, SENSOR, 0)
        lidar = raynest.generators.lidar(np.linspace(-25, 10, args.channels), (0, 360, args.azimuths),
                                         look_at=(eye, eye + poses[0, :, 0]))
        # The sensor does not see the car that it stands on.
        seen = scene.trace(lidar, fields=("position", "hit"), epoch=edit.epoch, hide=["car-0"])
        done = time.perf_counter()
        edits.append(edited - started)
        sweeps.append(done - edited)
        late += done > due + 2 * period
        if args.output:
            clouds[f"sweep_{sweep:05d}"] = seen["position"][seen["hit"] != 0]
        if not args.quiet and sweep % args.rate == 0:
            print(f"{sweep * period:6.1f} s: epoch {edit.epoch}, {edit.instances} instances moved in "
                  f"{1000 * edits[-1]:.1f} ms, {int((seen['hit'] != 0).sum()):,} points in {1000 * sweeps[-1]:.1f} ms")
    if args.output:
        np.savez_compressed(args.output, **clouds)
    print(f"{len(sweeps)} sweeps of {args.channels * args.azimuths:,} rays: an edit takes "
          f"{1000 * np.median(edits):.1f} ms, a sweep {1000 * np.median(sweeps):.1f} ms (medians); "
          f"{late} were late by more than one period")


if __name__ == "__main__":
    terminal.run(main)
