#!/usr/bin/env python3
"""Drives through traffic with a lidar on the roof. All cars move, the sensor too, while a sweep is measured."""
import time

import numpy as np

import raynest
import terminal

LENGTH = 400.0         # metres, of builtin:street
LANE_WIDTH = 3.25
WHEEL_RADIUS = 0.33
SENSOR = 1.9           # metres over the ground, above the middle of the first car


def options():
    parser = terminal.parser(__doc__, "street.py --cars 50 --seconds 10 -o sweep.ply", "builtin:street", loaded=False)
    parser.add_argument("--cars", type=terminal.count, default=50, help="(%(default)s)")
    parser.add_argument("--speed", type=float, default=12, help="metres per second (%(default)s)")
    parser.add_argument("--rate", type=terminal.count, default=10, help="sweeps per second (%(default)s)")
    parser.add_argument("--seconds", type=terminal.count, default=10, help="(%(default)s)")
    parser.add_argument("--channels", type=terminal.count, default=64, help="(%(default)s)")
    parser.add_argument("--azimuths", type=terminal.count, default=1800, help="(%(default)s)")
    parser.add_argument("--step-error", type=float, default=np.inf, metavar="METRES",
                        help="by how much another car may be off: the cars move several times in a sweep (once)")
    parser.add_argument("-o", "--output", help="a .npz with the points of each sweep, in the world; or the last "
                        "sweep as a .ply, .pcd or .las")
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


def sweep_of(scene, traffic, args, begin, steps):
    """One turn of the sensor, in so many steps: for each, the cars stand where they are in its middle, while
    the sensor moves on from column to column. Returns columns of the points, and the seconds of edits."""
    period = 1 / args.rate
    parts, editing = [], 0.0
    times = begin + np.linspace(0, period, 9)
    # The sensor looks ahead along its x; its y is to the left, its z up.
    frame = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], float)
    poses = np.zeros((len(times), 3, 4))
    car = traffic.poses(begin)[0]
    poses[:, :, :3] = car[:, :3] @ frame
    poses[:, :, 3] = car[:, 3] + (0, SENSOR, 0)
    poses[:, 0, 3] += traffic.ahead[0] * traffic.speed[0] * (times - begin)
    azimuths = np.linspace(0, 360, args.azimuths, endpoint=False)
    for step, chosen in enumerate(np.array_split(azimuths, steps)):
        first, last = begin + period * step / steps, begin + period * (step + 1) / steps
        started = time.perf_counter()
        with scene.edit() as edit:
            edit.place(traffic.names, traffic.poses((first + last) / 2))
            edit.move(traffic.wheels, traffic.turns(last - first), frame="own")
        editing += time.perf_counter() - started
        sweep = raynest.generators.sweep(np.linspace(-25, 10, args.channels), chosen, begin=first, end=last,
                                         trajectory=(times, poses))
        # The sensor does not see the car that it stands on.
        seen = scene.trace(sweep, fields=("t", "position", "inst", "hit"), epoch=edit.epoch, hide=["car-0"])
        parts.append({"position": seen["position"], "where": seen["hit"], "ring": sweep.ring, "time": sweep.time,
                      "distance": seen["t"], "instance": seen["inst"]})
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}, edit, editing


def main():
    args = options()
    client = raynest.connect(args.server)
    scene = client.load(f"builtin:street?cars={args.cars}" if args.source == "builtin:street" else args.source, "street", replace=True)
    traffic = Traffic(args.cars, args.speed)
    period = 1 / args.rate
    # The cars that come towards the sensor are the fastest as it sees them.
    steps = raynest.sweeps.steps(traffic.speed.max(), period, args.step_error) if args.step_error < np.inf else 1
    clouds, edits, sweeps, late = {}, [], [], 0
    begin = time.perf_counter()
    for number in range(args.rate * args.seconds):
        due = begin + number * period
        time.sleep(max(0, due - time.perf_counter()))
        started = time.perf_counter()
        cloud, edit, editing = sweep_of(scene, traffic, args, number * period, steps)
        done = time.perf_counter()
        edits.append(editing)
        sweeps.append(done - started)
        late += done > due + 2 * period
        if args.output and args.output.endswith(".npz"):
            clouds[f"sweep_{number:05d}"] = cloud["position"][cloud["where"] != 0]
        if not args.quiet and number % args.rate == 0:
            print(f"{number * period:6.1f} s: epoch {edit.epoch}, {edit.instances} instances moved in "
                  f"{1000 * editing:.1f} ms, {int((cloud['where'] != 0).sum()):,} points in {1000 * sweeps[-1]:.1f} ms")
    if args.output and args.output.endswith(".npz"):
        np.savez_compressed(args.output, **clouds)
    elif args.output:
        kept = ("where", "ring", "time") if args.output.endswith(".las") else tuple(cloud)[1:]
        raynest.points.save(args.output, cloud["position"], **{name: cloud[name] for name in kept})
    print(f"{len(sweeps)} sweeps of {args.channels * args.azimuths:,} rays in {steps} "
          f"{'step' if steps == 1 else 'steps'}: {1000 * np.median(sweeps):.1f} ms each, of which edits take "
          f"{1000 * np.median(edits):.1f} ms (medians); {late} were late by more than one period")


if __name__ == "__main__":
    terminal.run(main)
