#!/usr/bin/env python3
"""Hours of direct sun in a day: for points with normals, at a place on earth, behind what a scene has.
Up is y, east is x, and north -z, as in glTF; with --up z north is y."""
import argparse
import datetime
import math

import numpy as np

import raynest
import terminal

HOURS = 3600.0


def day(text):
    """Parses YYYY-MM-DD; the type of an option."""
    try:
        return datetime.date.fromisoformat(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not a day as YYYY-MM-DD") from None


def options():
    parser = terminal.parser(__doc__, "sun_hours.py builtin:forest --place 52.5,13.4 --day 2026-06-21")
    terminal.add_up(parser)
    parser.add_argument("-o", "--output", default="sun.npy",
                        help=".npy of hours, one per point (%(default)s)")
    parser.add_argument("--place", default="52.5,13.4", metavar="LATITUDE,LONGITUDE",
                        help="in degrees, north and east (%(default)s)")
    parser.add_argument("--day", type=day, default=datetime.date(2026, 6, 21),
                        metavar="YYYY-MM-DD", help="(%(default)s)")
    parser.add_argument("--minutes", type=terminal.count, default=10,
                        help="between looks at the sun, at most 720 (%(default)s)")
    parser.add_argument("--grid", type=terminal.count, default=40,
                        help="points a side, spread over the ground (%(default)s)")
    return parser.parse_args()


def sun_direction(time, place, up="y"):
    """Unit vector to the sun: x is east, y up, -z north, as the daemon's sky has them; or z up and y
    north. `time` is in UTC, `place` (latitude, longitude) in degrees. The low-precision formulas of the Astronomical
    Almanac: about 0.01 degrees from 1950 to 2050."""
    days = (time - datetime.datetime(2000, 1, 1, 12, tzinfo=datetime.timezone.utc)).total_seconds() / 86400
    mean = math.radians(280.460 + 0.9856474 * days)
    anomaly = math.radians(357.528 + 0.9856003 * days)
    ecliptic = mean + math.radians(1.915 * math.sin(anomaly) + 0.020 * math.sin(2 * anomaly))
    tilt = math.radians(23.439 - 0.0000004 * days)
    ascension = math.atan2(math.cos(tilt) * math.sin(ecliptic), math.cos(ecliptic))
    declination = math.asin(math.sin(tilt) * math.sin(ecliptic))
    latitude, longitude = map(math.radians, place)
    sidereal = math.radians((280.46062 + 360.98564737 * days) % 360) + longitude
    hour = sidereal - ascension
    east = -math.cos(declination) * math.sin(hour)
    north = (math.cos(latitude) * math.sin(declination)
             - math.sin(latitude) * math.cos(declination) * math.cos(hour))
    height = (math.sin(latitude) * math.sin(declination)
              + math.cos(latitude) * math.cos(declination) * math.cos(hour))
    return np.array([east, height, -north] if up == "y" else [east, north, height])


def day_times(day, minutes, place):
    """Times about so many minutes apart that share the day evenly, by the sun's time at the place."""
    count = math.ceil(24 * 60 / minutes)
    noon = datetime.datetime.combine(day, datetime.time(12), datetime.timezone.utc)
    start = noon - datetime.timedelta(hours=12 + place[1] / 15)
    return [start + (number + 0.5) / count * datetime.timedelta(days=1) for number in range(count)]


def sun_hours(scene, points, normals, times, place, progress=None, up="y"):
    """Hours of direct sun of each point, (N,): the time between `times`, two or more and equally far
    apart, in which the sun stands over the horizon and in front of the surface, and nothing of the
    scene hides it. `points` and `normals` are (N, 3); `up` is the axis that points up, "y" or "z"."""
    points, normals = np.asarray(points, float), np.asarray(normals, float)
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    hours = np.zeros(len(points))
    step = (times[1] - times[0]).total_seconds() / HOURS
    # Points lie on surfaces: leave these by more than rounding, which is relative to the origin.
    if len(points) == 0:
        return hours
    size = np.subtract(scene.info["box_max"], scene.info["box_min"]).max()
    rounding = np.spacing(np.abs(points - scene.origin).max().astype(np.float32))
    start = points + (1e-6 * size + 8 * rounding) * normals
    for number, time in enumerate(times):
        sun = sun_direction(time, place, up)
        lit = np.flatnonzero(normals @ sun > 0) if sun[terminal.AXES[up][1]] > 0 else []
        if len(lit) == 0:
            continue
        hidden = scene.trace(start[lit], sun, kind="any")["hit"]
        hours[lit] += step * ~hidden
        if progress:
            progress(number, len(times), "following the sun")
    return hours


def ground(scene, side, up="y"):
    """Points on what rays from the sky meet, and the normals there."""
    low, high = np.array(scene.info["box_min"]), np.array(scene.info["box_max"])
    middle, half = (low + high) / 2, (high - low) / 4
    flat, axis = terminal.AXES[up]
    grid = np.meshgrid(*(np.linspace(middle[k] - half[k], middle[k] + half[k], side) for k in flat))
    rays = terminal.from_above(scene, np.stack([part.ravel() for part in grid], -1), up)
    found = scene.trace(rays, fields=("hit", "position", "ng"))
    normals = np.where(found["ng"][:, [axis]] < 0, -found["ng"], found["ng"])
    return found["position"][found["hit"]], normals[found["hit"]]


def main():
    chosen = options()
    try:
        place = tuple(map(float, chosen.place.split(",")))
        if len(place) != 2 or abs(place[0]) > 90 or abs(place[1]) > 180:
            raise ValueError
    except ValueError:
        raise raynest.UsageError(f"--place {chosen.place}: it must be LATITUDE,LONGITUDE") from None
    if chosen.minutes > 720:
        raise raynest.UsageError(f"--minutes {chosen.minutes}: it must be at most 720")
    with raynest.connect(chosen.server) as client:
        scene = terminal.scene(client, chosen.source)
        points, normals = ground(scene, chosen.grid, chosen.up)
        if len(points) == 0:
            raise raynest.UsageError("nothing of the scene is seen from the sky")
        hours = sun_hours(scene, points, normals, day_times(chosen.day, chosen.minutes, place), place,
                          terminal.progress(chosen.quiet), chosen.up)
        with open(chosen.output, "wb") as file:
            np.save(file, hours)
        print(f"{chosen.output}: {len(points):,} points have {hours.min():.1f} to {hours.max():.1f} "
              f"hours of sun on {chosen.day}, {hours.mean():.1f} on average")


if __name__ == "__main__":
    terminal.run(main)
