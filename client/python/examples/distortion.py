#!/usr/bin/env python3
"""Draws one sweep of a lidar on a car, seen from above: while everything stands still, and while all cars drive."""
import numpy as np

import raynest
import terminal

SENSOR = 1.9                # metres over the ground
AHEAD, ASIDE = 23.0, 8.5    # metres around the sensor that the picture shows
SCALE = 17.0                # pixels per metre
GRID = 0.02                 # metres to which points are rounded
LEFT, TOP, BETWEEN = 34, 28, 46                                 # pixels
WIDTH, HEIGHT = 2 * AHEAD * SCALE, 2 * ASIDE * SCALE            # a panel's
SHADES = 10
EARLY, LATE = np.array([30, 70, 220]), np.array([245, 120, 0])  # colours of the first and the last column
AT_START = 'fill="none" stroke="#333"'
AT_END = AT_START + ' stroke-dasharray="5 4"'


def options():
    parser = terminal.parser(__doc__, "distortion.py -o distortion.svg", "builtin:street?cars=100&seconds=6",
                             loaded=False)
    parser.add_argument("--begin", type=float, default=0.5, help="when the sweep begins, in seconds (%(default)s)")
    parser.add_argument("--period", type=float, default=0.1, help="seconds of a sweep (%(default)s)")
    parser.add_argument("--channels", type=terminal.count, default=64, help="(%(default)s)")
    parser.add_argument("--azimuths", type=terminal.count, default=1800, help="(%(default)s)")
    parser.add_argument("--step-error", type=float, default=0.01, metavar="METRES",
                        help="by how much a car may be off (%(default)s)")
    parser.add_argument("-o", "--output", default="distortion.svg", help="(%(default)s)")
    return parser.parse_args()


def cars_at(scene, time):
    """The cars on the road, seen straight from above: (low, high, velocity) of each car, by its number."""
    ground = np.stack(np.meshgrid(np.arange(-60, 60, 0.1), np.arange(-6, 6, 0.1)), -1).reshape(-1, 2)
    seen = scene.trace(terminal.from_above(scene, ground), fields=("position", "velocity", "inst", "hit"), time=time,
                       only=["car-*"])
    flat, number = seen["position"][:, [0, 2]], seen["inst"]
    cars = {}
    for inst in np.unique(number[seen["hit"]]):
        mine = number == inst
        cars[inst] = flat[mine].min(axis=0), flat[mine].max(axis=0), seen["velocity"][mine][0]
    return cars


def sweep_of(scene, args, place, velocity, driver, moving):
    """The points of one turn of a sensor that looks along +X, and when they were measured."""
    times = args.begin + np.array([0, args.period])
    poses = np.zeros((2, 3, 4))
    poses[:, :, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]   # the sensor's x ahead, y to the left, z up
    poses[:, :, 3] = place + moving * np.outer([0, args.period], velocity)
    sweep = raynest.generators.sweep(np.linspace(-25, 10, args.channels), (0, 360, args.azimuths), begin=times[0],
                                     end=times[1], trajectory=(times, poses),
                                     step_error=args.step_error if moving else None)
    seen = scene.trace(sweep, fields=("position", "inst", "hit", "time"), hide=[driver], time=args.begin)
    hit = seen["hit"]
    return seen["position"][hit], seen["inst"][hit], (seen["time"][hit] - args.begin) / args.period


def dots(points, colour, gap, width):
    """A dot for each square of `gap` metres that points (N, 2), in metres, fall into: at the first of them."""
    _, first = np.unique(np.round(points / gap).astype(int), axis=0, return_index=True)
    steps = np.diff(np.round(points[np.sort(first)] / GRID).astype(int), axis=0, prepend=0)
    path, scale = "".join(f"m{x} {y}h0" for x, y in steps), SCALE * GRID
    return f'\n<path transform="scale({scale:g})" d="{path}" stroke="{colour}" stroke-width="{width / scale:g}"/>'


def outlines(cars, place, style):
    boxes = ((SCALE * (low - place[[0, 2]]), SCALE * (high - low)) for low, high, _ in cars.values())
    return "".join(f'<rect x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}" {style}/>'
                   for (x, y), (width, height) in boxes)


def panel(title, top, points, inst, share, place, before, after):
    """A picture of the sweep, `top` pixels down. Cars are outlined where they stand when it begins and ends."""
    near = (np.abs(points - place) < (AHEAD, 30, ASIDE)).all(axis=1)
    flat, is_car = points[near][:, [0, 2]] - place[[0, 2]], np.isin(inst[near], list(before))
    ground = points[near][:, 1] < 0.2
    drawn = dots(flat[~is_car & ground], "#ccd2d9", 0.2, 1.2) + dots(flat[~is_car & ~ground], "#858c95", 0.1, 1.4)
    drawn += outlines(before, place, AT_START) + outlines(after, place, AT_END)
    shade = np.minimum(share[near] * SHADES, SHADES - 1).astype(int)
    for number in range(SHADES):
        drawn += dots(flat[is_car & (shade == number)], colour_of(number), 0.07, 1.8)
    drawn += f'<path d="M0 0H{AHEAD * SCALE}" stroke="#c00" stroke-dasharray="2 4"/><circle r="5" fill="#c00"/>'
    made = (f'<g transform="translate({LEFT},{top})"><text y="-8" font-size="14" font-weight="bold">{title}</text>'
            f'<svg width="{WIDTH}" height="{HEIGHT}" viewBox="{-WIDTH / 2} {-HEIGHT / 2} {WIDTH} {HEIGHT}">'
            f'<g stroke-linecap="round">{drawn}</g></svg>'
            f'<rect width="{WIDTH}" height="{HEIGHT}" fill="none" stroke="#999"/>')
    for metres in range(-20, 21, 5):
        made += f'<text x="{(metres + AHEAD) * SCALE}" y="{HEIGHT + 15}" text-anchor="middle">{metres}</text>'
        if abs(metres) < ASIDE:
            made += f'<text x="-6" y="{(ASIDE - metres) * SCALE + 4}" text-anchor="end">{metres}</text>'
    return made + "</g>"


def colour_of(number):
    return "#" + bytes((EARLY + (number + 0.5) / SHADES * (LATE - EARLY)).astype(np.uint8)).hex()


def legend(top, period):
    end = f"{1000 * period:g} ms"
    boxes = "".join(f'<rect x="{112 + 10 * number}" width="10" height="12" fill="{colour_of(number)}"/>'
                    for number in range(SHADES))
    return (f'<g transform="translate({LEFT},{top})"><text y="11">cars, measured at 0</text>{boxes}'
            f'<text x="{118 + 10 * SHADES}" y="11">{end}</text>'
            f'<rect x="278" y="1" width="24" height="10" {AT_START}/><text x="308" y="11">stood there at 0</text>'
            f'<rect x="414" y="1" width="24" height="10" {AT_END}/><text x="444" y="11">at {end}</text>'
            '<circle cx="522" cy="6" r="5" fill="#c00"/><path d="M522 6h30" stroke="#c00" stroke-dasharray="2 4"/>'
            '<text x="558" y="11">sensor; its turn begins and ends here (metres)</text></g>')


def main():
    args = options()
    client = raynest.connect(args.server)
    scene = client.load(args.source, "street", replace=True)
    before, after = cars_at(scene, args.begin), cars_at(scene, args.begin + args.period)
    # The sensor rides on a car near the middle of those that drive along +X.
    driver = min((inst for inst in before if before[inst][2][0] > 0), key=lambda inst: np.abs(before[inst][0]).sum())
    low, high, velocity = before.pop(driver)
    after.pop(driver)
    place = np.array([(low[0] + high[0]) / 2, SENSOR, (low[1] + high[1]) / 2])
    titles = ("All stands still",
              f"The sensor and all cars drive: {1000 * args.period:g} ms pass while it turns, and cars become longer, "
              "shorter, or torn")
    drawn = ""
    for moving, title in enumerate(titles):
        sweep = sweep_of(scene, args, place, velocity, f"inst={driver}", moving)
        if not args.quiet:
            print(f"{title}: {len(sweep[0]):,} points")
        drawn += panel(title, TOP + moving * (HEIGHT + BETWEEN), *sweep, place, before, after if moving else {})
    height = TOP + 2 * (HEIGHT + BETWEEN)
    with open(args.output, "w", encoding="utf-8") as file:
        file.write(f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {LEFT + WIDTH + 4:g} {height:g}" '
                   'font-family="sans-serif" font-size="12"><rect width="100%" height="100%" fill="#fff"/>'
                   f"{drawn}{legend(height - 20, args.period)}</svg>\n")
    print(args.output)


if __name__ == "__main__":
    terminal.run(main)
