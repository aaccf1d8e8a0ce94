#!/usr/bin/env python3
"""Simulates one turn of a lidar and writes its point cloud; the daemon makes the rays."""
import numpy as np

import raynest
import terminal

POINT = np.dtype([("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("cosine", "<f4"), ("instance", "<u4"),
                  ("channel", "<u2")])


def options():
    parser = terminal.parser(__doc__, "lidar.py builtin:forest --channels 64 -o sweep.ply")
    terminal.add_up(parser)
    parser.add_argument("-o", "--output", default="sweep.ply",
                        help=".ply or .npy of the points (%(default)s)")
    parser.add_argument("--origin", type=float, nargs=3, metavar=("X", "Y", "Z"),
                        help="a point near a scene that lies far from zero, for its digits")
    parser.add_argument("--at", type=float, nargs=3, metavar=("X", "Y", "Z"),
                        help="where it stands (over the middle of the scene)")
    parser.add_argument("--height", type=float, default=1.8,
                        help="metres over the ground there (%(default)s)")
    parser.add_argument("--channels", type=terminal.count, default=64, help="beams above each other "
                        "(%(default)s)")
    parser.add_argument("--azimuths", type=terminal.count, default=2048,
                        help="of one turn (%(default)s)")
    parser.add_argument("--elevations", type=float, nargs=2, default=[-25, 15],
                        metavar=("LOW", "HIGH"),
                        help="degrees of the lowest and the highest channel (-25 15)")
    parser.add_argument("--range", type=float, default=120, help="metres (%(default)s)")
    return parser.parse_args()


def stand(scene, height, up):
    """`height` over what a ray from above meets in the middle of the scene."""
    low, high = np.array(scene.info["box_min"]), np.array(scene.info["box_max"])
    flat, axis = terminal.AXES[up]
    ray = terminal.from_above(scene, ((low + high) / 2)[None, flat], up)
    ground = scene.trace(ray, fields=("t",))["t"][0]
    ray[0, axis] -= min(ground, ray[0, axis] - low[axis]) - height
    return ray[0, :3]


def sweep(scene, lidar, azimuths, progress):
    """The points that are met."""
    seen = scene.trace(lidar, fields=("position", "direction", "ng", "inst", "hit"),
                       progress=progress)
    hit = np.flatnonzero(seen["hit"])
    points = np.empty(len(hit), POINT)
    points["x"], points["y"], points["z"] = seen["position"][hit].T
    points["cosine"] = np.abs((seen["ng"][hit] * seen["direction"][hit]).sum(1))
    points["instance"] = seen["inst"][hit]
    points["channel"] = hit // azimuths
    return points


def save(path, points):
    if path.endswith(".npy"):
        return np.save(path, points)
    raynest.points.save(path, np.stack([points[axis] for axis in "xyz"], -1),
                        **{name: points[name] for name in ("cosine", "instance", "channel")})


def main():
    chosen = options()
    if not chosen.output.endswith((".ply", ".npy")):
        raise raynest.UsageError(f"--output {chosen.output}: points are written as .ply or .npy")
    with raynest.connect(chosen.server) as client:
        scene = terminal.scene(client, chosen.source, chosen.origin)
        at = np.array(chosen.at) if chosen.at else stand(scene, chosen.height, chosen.up)
        lidar = raynest.generators.lidar(
            np.linspace(*chosen.elevations, chosen.channels), (0, 360, chosen.azimuths),
            look_at=(at, at + [1, 0, 0], np.eye(3)[terminal.AXES[chosen.up][1]]), tmin=0.1, tmax=chosen.range)
        points = sweep(scene, lidar, chosen.azimuths, terminal.progress(chosen.quiet))
        save(chosen.output, points)
        seconds = client.outcome["seconds"]
        print(f"{chosen.output}: {len(points):,} points of {lidar.count:,} rays from "
              f"{', '.join(f'{value:.2f}' for value in at)}, traced in {seconds:.3f} s")


if __name__ == "__main__":
    terminal.run(main)
