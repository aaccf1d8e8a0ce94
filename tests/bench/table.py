#!/usr/bin/env python3
"""Rows of raynest-bench --json -> the table of the README, in Markdown, each row with its command.

  table.py ROWS.jsonl... [--commands]

Every line of the table is a claim: a geometric mean of ratios (rate of ours over the peer's, time of
the peer's build over ours, plain bytes) over the scenes and kinds of rays it names, beside the floor
and the goal that it is held to. `adjusted` divides by what the peer would gain with its asserts off;
that is what counts. Ratios of rates are of the parts of laps in which nobody else was on the core;
`crowded, too` is over all laps (BENCH.md says why).
Lines that name no traversal are of the one that `auto` chooses, as a worker does for every chunk; where
that may be packets or batches, the peer is the fastest of its forms too. A line whose rows are missing
says so; a mean over fewer rows than it names is never formed. Of several files, each a run, the median
counts, and the least and the largest are told.
"""
import argparse
import json
import math
import statistics
import sys

FLAT = ("terrain", "cards", "interior")
UNAVAILABLE = "not measured"


class Claim:
    """One line: the rows that it means, and how their numbers become one."""

    def __init__(self, title, floor, goal, cases, value="ratio_adjusted", best_of=(), less=False, **fixed):
        self.title, self.floor, self.goal = title, floor, goal
        self.cases = cases  # each a dict that must select rows, beside `fixed`
        self.value = value
        self.best_of = best_of  # opponents of which the one that is worse for us counts
        self.less = less  # small is good
        self.fixed = fixed

    def rows(self, rows):
        """The rows of every case, or None as soon as one case has none."""
        chosen = []
        for case in self.cases:
            wanted = {**self.fixed, **case}
            peers = self.best_of or (wanted.get("peer"),)
            found = []
            for peer in peers:
                match = {**wanted, "peer": peer} if peer is not None else wanted
                hits = [row for row in rows
                        if all(row.get(key) == value for key, value in match.items())]
                if not hits:
                    return None
                found.append(hits[-1])
            chosen.append(max(found, key=lambda row: row["peer_mrays"]) if self.best_of else found[0])
        return chosen

    def number(self, chosen, key=None):
        values = [row[key or self.value] for row in chosen]
        return math.exp(sum(map(math.log, values)) / len(values))

    def verdict(self, number):
        reached = (lambda bound: number <= bound) if self.less else (lambda bound: number >= bound)
        return "goal" if reached(self.goal) else "floor" if reached(self.floor) else "below"


def over(scenes, *rays):
    return [{"scene": scene, "rays": kind} for scene in scenes for kind in rays]


def claims(target):
    ours = {"intersector": "opaque", "threads": 1, "target": target}
    single = {**ours, "traversal": "single", "peer": "embree"}
    chosen = {**ours, "traversal": "auto"}
    plain = ("embree", "embree-coherent")
    stream = {**ours, "traversal": "stream", "best_of": plain}
    alpha = {**chosen, "intersector": "alpha_mask"}
    filters = ("embree-filter", "embree-filter-coherent", "embree-argument")
    multi = {**chosen, "kind": "multi"}
    build = {"kind": "build", "build": "medium", "stage": "tree", "value": "ratio"}
    yield Claim("single rays, closest (primary, diffuse, random)", 1.05, 1.2,
                over(FLAT, "primary", "diffuse", "random"), **single)
    yield Claim("single rays, any (shadow, AO)", 1.15, 1.35, over(FLAT, "shadow", "ao"), **single)
    yield Claim("stream, diffuse closest", 1.18, 1.5, over(FLAT, "diffuse"), **stream)
    yield Claim("stream, AO any", 1.25, 1.6, over(FLAT, "ao"), **stream)
    yield Claim("stream, random closest", 1.3, 2.0, over(FLAT, "random"), **stream)
    yield Claim("packet primary against its coherent packets", 1.33, 1.6, over(FLAT, "primary"),
                **{**ours, "traversal": "packet", "best_of": plain})
    yield Claim("alpha mask, closest (cards)", 1.2, 1.5,
                over(("cards",), "primary", "diffuse", "random"), best_of=filters, **alpha)
    yield Claim("alpha mask, any (cards)", 1.3, 1.7, over(("cards",), "shadow", "ao"),
                best_of=filters, **alpha)
    yield Claim("forest1 (primary, diffuse, AO)", 1.0, 1.3,
                over(("forest1",), "primary", "diffuse", "ao"), best_of=plain, **chosen)
    yield Claim("forest3 nested over our one-level list", 0.9, 1.0,
                over(("forest3",), "primary", "diffuse", "ao"), **{**chosen, "peer": "own-over"})
    yield Claim("forest3 nested, single rays alone", 0, 0,
                over(("forest3",), "primary", "diffuse", "ao"), **{**single, "peer": "own-over"})
    yield Claim("multi-hit N = 8 on cards, the better filter", 1.1, 1.5,
                over(("cards",), "primary", "diffuse", "random"),
                best_of=("embree-list", "embree-shrink"), **multi)
    yield Claim("single rays over its robust mode", 1.1, 1.3,
                over(FLAT, "primary", "diffuse", "random"), **{**single, "peer": "embree-robust"})
    for threads in (1, 2):
        yield Claim(f"medium build, {threads} thread{'s'[:threads - 1]} (its time over ours)", 0.9, 1.2,
                    [{"scene": scene} for scene in FLAT], **build, threads=threads)
    yield Claim("tree and leaves, bytes per triangle", 75, 60, [{"scene": scene} for scene in FLAT],
                value="bytes_per_triangle", less=True, kind="memory")
    yield Claim("bytes per instance", 200, 100, [{"scene": "forest3-flat"}],
                value="bytes_per_instance", less=True, kind="memory")
    yield Claim("2 threads, rays per CPU-second over one thread's", 0.95, 0.98,
                over(("terrain",), "primary", "diffuse"),
                **{**ours, "traversal": "single", "threads": 2, "peer": "own"})
    for traversal in ("single", "auto"):
        # The bounds are times: 1.15 in total, 1.35 per level, over single rays. Beside auto they are told.
        for counters, most in (("total", 1.15), ("level", 1.35)):
            bound = 1 / most if traversal == "single" else 0
            yield Claim(f"counting {'in total' if counters == 'total' else 'per level'}, over {traversal} without",
                        bound, bound, over(("terrain", "cards", "forest3"), "primary", "diffuse"), value="ratio",
                        **{**ours, "traversal": traversal, "counters": counters,
                           "peer": "own"})
    for counters, most in (("total", 1.15), ("level", 1.35)):
        yield Claim(f"counting {'in total' if counters == 'total' else 'per level'}, alpha mask, over single without",
                    1 / most, 1 / most, over(("cards",), "primary", "diffuse"), value="ratio",
                    **{**ours, "intersector": "alpha_mask", "traversal": "single",
                       "counters": counters, "peer": "own"})
    for name, test, base in (("null pointer, checked", "pointer_null", "no_test"),
                             ("no-op behind a pointer", "pointer_noop", "no_test"),
                             ("alpha test behind a pointer", "pointer_alpha", "fused_alpha")):
        # No bound: what static injection saves is reported, however small.
        yield Claim(f"run-time check: {name}, over {base}", 0, 0,
                    over(("cards",), "primary", "diffuse", "ao"), value="ratio",
                    **{**ours, "intersector": test, "traversal": "single", "peer": "own"})


def read_rows(path):
    with open(path, encoding="utf-8") as file:
        return [json.loads(line) for line in file if line.strip()]


def commands_of(chosen):
    """Every command once, in the order of the rows."""
    return list(dict.fromkeys(row["command"] for row in chosen))


def table(runs, target, with_commands):
    """The lines; `runs` are lists of rows, one of each run."""
    yield "| | ratio | adjusted | crowded, too | floor | goal | | mismatches |" + (" command |" if with_commands else "")
    yield "|---|---|---|---|---|---|---|---|" + ("---|" if with_commands else "")
    for claim in claims(target):
        chosen = [rows for rows in map(claim.rows, runs) if rows is not None]
        bounds = f"{claim.floor:g} | {claim.goal:g}" if claim.goal else "| "
        if not chosen:
            yield f"| {claim.title} | {UNAVAILABLE} | | | {bounds} | | |" + (" |" if with_commands else "")
            continue
        numbers = [claim.number(rows) for rows in chosen]
        adjusted = statistics.median(numbers)
        plain = adjusted
        if claim.value == "ratio_adjusted":
            plain = statistics.median(claim.number(rows, "ratio") for rows in chosen)
        spread = f" ({min(numbers):.3g} to {max(numbers):.3g})" if len(runs) > 1 else ""
        verdict = claim.verdict(adjusted) if claim.goal else ""
        worst = max((row.get("mismatches", 0) for rows in chosen for row in rows), default=0)
        crowded = ""
        if all("ratio_all" in row for rows in chosen for row in rows):
            of_all = claim.value.replace("ratio", "ratio_all")
            crowded = f"{statistics.median(claim.number(rows, of_all) for rows in chosen):.3g}"
        line = (f"| {claim.title} | {plain:.3g} | {adjusted:.3g}{spread} | {crowded} | {bounds} | {verdict} "
                f"| {worst} |")
        if with_commands:
            commands = commands_of([row for rows in chosen for row in rows])
            line += " " + "<br>".join(f"`{command}`" for command in commands) + " |"
        yield line


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rows", nargs="+", help="files of JSON rows, one per line; one file a run")
    parser.add_argument("--target", default="v4", help="the pack that the table is of")
    parser.add_argument("--commands", action="store_true", help="add each row's command")
    arguments = parser.parse_args()
    runs = [read_rows(path) for path in arguments.rows]
    rows = [row for run in runs for row in run]
    peers = {row["peer_about"] for row in rows if row.get("peer_about")}
    print(f"Against {', '.join(sorted(peers)) or 'nothing'}; target {arguments.target}.\n")
    for line in table(runs, arguments.target, arguments.commands):
        print(line)
    told = [row for row in rows if "uncrowded" in row]
    if told:
        # A race takes the least crowding that it met for an undisturbed core.
        alone = 1.1 * min(row["crowded_from"] for row in told)
        never = sum(row["crowded_from"] > alone for row in told)
        shares = [row["uncrowded"] for row in told]
        print(f"\nNobody else was on the core for {statistics.median(shares):.0%} of the laps (median of "
              f"{len(told)} rows; least {min(shares):.0%}); {never} rows never had it alone.")
    beyond = [row for row in rows if row.get("mismatches", 0) > row.get("mismatches_max", math.inf)]
    if beyond:
        print(f"\n{len(beyond)} rows have more mismatches than edges explain:")
        for row in beyond:
            print(f"- {row['scene']} {row['rays']} {row['intersector']} {row['traversal']} "
                  f"against {row['peer']}: {row['mismatches']} of {row['count']}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
