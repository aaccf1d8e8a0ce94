#!/usr/bin/env python3
"""Mutual visibility: for every two points of a list, whether anything stands between them."""
import numpy as np

import raynest
import terminal


def options():
    parser = terminal.parser(__doc__, "visibility.py builtin:forest --random 200 -o sees.npy")
    terminal.add_up(parser)
    parser.add_argument("-o", "--output", default="sees.npy",
                        help=".npy of the matrix, (N, N) bool (%(default)s)")
    parser.add_argument("--points", metavar="FILE.npy", help="(N, 3) points")
    parser.add_argument("--random", type=terminal.count, default=200, metavar="N",
                        help="without --points: so many, scattered over the scene (%(default)s)")
    parser.add_argument("--height", type=float, default=1.7,
                        help="of eyes over the ground, metres (%(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of the scattering (%(default)s)")
    return parser.parse_args()


def scatter(scene, count, height, seed, up="y"):
    """Points over the middle of the scene, `height` above what rays from the sky meet."""
    low, high = np.array(scene.info["box_min"]), np.array(scene.info["box_max"])
    middle, half = (low + high) / 2, (high - low) / 4
    flat, axis = terminal.AXES[up]
    rays = terminal.from_above(scene, np.random.default_rng(seed).uniform(
        middle - half, middle + half, (count, 3))[:, flat], up)
    ground = scene.trace(rays, fields=("t",))["t"]
    rays[:, axis] -= np.minimum(ground, high[axis] + 1 - low[axis]) - height
    return rays[:, :3]


def who_sees_whom(scene, points, progress):
    """(N, N) bool, true on the diagonal. Sight goes both ways, so half of the pairs are asked."""
    a, b = np.triu_indices(len(points), 1)
    sees = np.eye(len(points), dtype=bool)
    sees[a, b] = sees[b, a] = ~scene.occluded(points[a], points[b], progress=progress)
    return sees


def main():
    chosen = options()
    with raynest.connect(chosen.server) as client:
        scene = terminal.scene(client, chosen.source)
        points = np.load(chosen.points) if chosen.points else \
            scatter(scene, chosen.random, chosen.height, chosen.seed, chosen.up)
        if len(points) < 2:
            raise raynest.UsageError("two points are needed, or nobody sees another")
        sees = who_sees_whom(scene, points, terminal.progress(chosen.quiet))
        with open(chosen.output, "wb") as file:  # under this very name, whatever it ends in
            np.save(file, sees)
        pairs = len(points) * (len(points) - 1) // 2
        others = sees.sum(1) - 1
        print(f"{chosen.output}: {(sees.sum() - len(points)) // 2:,} of {pairs:,} pairs see each "
              f"other, traced in {client.outcome['seconds']:.3f} s; point {others.argmax()} sees "
              f"most, {others.max()} of {len(points) - 1}")


if __name__ == "__main__":
    terminal.run(main)
