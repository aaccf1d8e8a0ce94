#!/usr/bin/env python3
"""Flies over a scene with a laser that scans across its way, and writes the returns of each pulse."""
import numpy as np

import raynest
import terminal


def options():
    parser = terminal.parser(__doc__, "canopy.py builtin:forest --returns 5 -o flight.las")
    terminal.add_up(parser)
    parser.add_argument("-o", "--output", default="flight.las", help=".las, .ply or .pcd (%(default)s)")
    parser.add_argument("--height", type=float, default=80, help="metres over the highest point (%(default)s)")
    parser.add_argument("--lines", type=terminal.count, default=200, help="scans across, from one side of the scene "
                        "to the other (%(default)s)")
    parser.add_argument("--pulses", type=terminal.count, default=300, help="of each line (%(default)s)")
    parser.add_argument("--angle", type=float, default=40, help="degrees from side to side (%(default)s)")
    parser.add_argument("--divergence", type=float, default=3, help="of the beam, in milliradians (%(default)s)")
    parser.add_argument("--returns", type=terminal.count, default=5, help="of a pulse, at most (%(default)s)")
    parser.add_argument("--resolution", type=float, default=0.3, help="metres between two returns (%(default)s)")
    parser.add_argument("--noise", type=float, default=0.02, help="metres, the distance's deviation (%(default)s)")
    parser.add_argument("--speed", type=float, default=50, help="metres per second (%(default)s)")
    return parser.parse_args()


def flight(scene, chosen):
    """The sweep of a flight along x over the middle of the scene."""
    flat, axis = terminal.AXES[chosen.up]
    low, high = np.array(scene.info["box_min"]), np.array(scene.info["box_max"])
    up, ahead = np.eye(3)[axis], np.eye(3)[0]
    poses = np.zeros((2, 3, 4))
    poses[:, :, 0], poses[:, :, 1], poses[:, :, 2] = -up, np.cross(ahead, -up), ahead  # it looks down
    poses[:, :, 3] = (low + high) / 2
    poses[:, 0, 3] = low[0], high[0]
    poses[:, axis, 3] = high[axis] + chosen.height
    seconds = (high[0] - low[0]) / chosen.speed
    line = np.linspace(-chosen.angle / 2, chosen.angle / 2, chosen.pulses)
    return raynest.sweeps.lidar([0], np.tile(line, chosen.lines), end=seconds, trajectory=([0, seconds], poses))


def main():
    chosen = options()
    with raynest.connect(chosen.server) as client:
        scene = terminal.scene(client, chosen.source)
        sweep = flight(scene, chosen)
        points = raynest.returns.measure(scene, sweep, divergence=chosen.divergence / 1000, returns=chosen.returns,
                                         resolution=chosen.resolution, noise=chosen.noise)
        raynest.points.save(chosen.output, points["position"],
                            **{name: points[name] for name in ("time", "intensity", "return", "returns")})
        of_pulses = np.bincount(points["returns"][points["return"] == 0], minlength=chosen.returns + 1)
        of_pulses[0] = len(sweep.rays) - of_pulses.sum()
        print(f"{chosen.output}: {len(points['t']):,} points of {len(sweep.rays):,} pulses; pulses with 0, 1, 2, ... "
              f"returns: {', '.join(f'{count:,}' for count in of_pulses)}")


if __name__ == "__main__":
    terminal.run(main)
