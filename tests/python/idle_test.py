#!/usr/bin/env python3
"""Options that a request does not use are refused or noted, by both clients: every option of a picture with
every integrator, of a path, of a heat map's file, and of what is hidden.

  idle_test.py RAYNESTD RAYNEST FLATC
"""
import warnings

import numpy as np

import raynest
from with_daemon import WithDaemon, main

SMALL = {"size": (8, 8), "look_at": ([0, 6, 18], [0, 4, 0])}
VIEW = ("--size", "8x8", "--lookat", "0,6,18,0,4,0")
LIT = ("ao", "direct", "path")
BY_LIGHT = ("direct", "path")
# The option of both clients, whether a path of explain has it, and the integrators that use it.
OPTIONS = (
    (("--spp", "2"), {"spp": 2}, False, LIT),
    (("--seed", "3"), {"seed": 3}, True, LIT),
    (("--depth", "3"), {"depth": 3}, True, ("path",)),
    (("--ao-distance", "2"), {"ao_distance": 2.0}, True, ("ao",)),
    (("--env", "sky"), {"environment": "sky"}, True, BY_LIGHT),
    (("--sun", "130,35"), {"sun": np.array([130, 35])}, True, BY_LIGHT),
    (("--noise", "0.5"), {"noise": 0.5}, False, LIT),
    (("--tonemap", "aces"), {"tonemap": "aces"}, False, LIT),
    (("--exposure", "0"), {"exposure": 0.0}, False, LIT))


class Idle(WithDaemon):
    def test_a_ranking_alone_takes_no_colours(self):
        for option in (("--palette", "viridis"), ("--scale", "log"), ("--range", "0:5")):
            done = self.cli.run("heatmap", "woods", *VIEW, "--top", "3", *option)
            self.assertEqual((done.returncode, "add -o" in done.stderr), (2, True), done.stderr)

    def notes(self, *arguments):
        """Returns the notes of a command that succeeds."""
        done = self.cli.run(*arguments)
        self.assertEqual(done.returncode, 0, f"{arguments}: {done.stdout}{done.stderr}")
        return done.stderr

    def warned(self, call):
        """Returns the error of a call, or its warnings."""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                call()
            except raynest.UsageError as error:
                return "refused: " + str(error)
        return " ".join(str(warning.message) for warning in caught)

    def test_each_integrator_names_the_options_that_it_does_not_use(self):
        for integrator in ("primary", *LIT):
            for (flag, value), keyword, in_paths, users in OPTIONS:
                with self.subTest(integrator=integrator, option=flag):
                    (name,) = keyword
                    idle = integrator not in users
                    says = f"no effect with integrator {integrator}: {flag}"
                    words = ("--integrator", integrator, flag, value)
                    few = () if flag in ("--spp", "--noise") or integrator == "primary" else ("--spp", "1")
                    told = self.notes("render", "woods", *VIEW, *words, *few, "-o", self.out / "a.png")
                    self.assertEqual("no effect" in told, idle, told)
                    self.assertEqual(says in told, idle, told)
                    told = self.warned(lambda: self.woods.render(
                        integrator=integrator, encode="png", **{**({"spp": 1} if few else {}), **keyword}, **SMALL))
                    self.assertEqual("no effect" in told or "refused" in told, idle, told)
                    self.assertEqual(name in told, idle, told)
                    if not in_paths or integrator == "primary":
                        continue
                    told = self.notes("explain", "woods", *VIEW, "--pixel", "3,4", *words)
                    self.assertEqual(says in told, idle, told)
                    told = self.warned(lambda: self.woods.explain(pixel=(3, 4), integrator=integrator, **keyword, **SMALL))
                    self.assertEqual(f"no effect with integrator {integrator}: {name}=" in told, idle, told)

    def test_a_stream_of_pictures_tells_too(self):
        def last():
            for _ in self.woods.render_stream(integrator="ao", spp=1, depth=3, **SMALL):
                pass
        self.assertIn("no effect with integrator ao: depth=", self.warned(last))
        told = self.notes("render", "woods", *VIEW, "--progressive", "-o", self.out / "a.png")
        self.assertIn("no effect with integrator primary: --progressive", told)

    def test_a_traversal_has_no_light_and_a_path_no_steps(self):
        for (flag, value), keyword, in_paths, _ in OPTIONS:
            if in_paths:
                (name,) = keyword
                done = self.cli.run("explain", "woods", *VIEW, "--pixel", "3,4", flag, value)
                self.assertEqual((done.returncode, flag in done.stderr), (2, True), done.stderr)
                self.assertIn(f"refused: {name}: only of a path",
                              self.warned(lambda: self.woods.explain(pixel=(3, 4), **keyword, **SMALL)))
        lit = {"pixel": (3, 4), "integrator": "path", **SMALL}
        self.assertIn("refused: steps", self.warned(lambda: self.woods.explain(steps=9, **lit)))
        done = self.cli.run("explain", "woods", *VIEW, "--pixel", "3,4", "--integrator", "path", "--all")
        self.assertEqual((done.returncode, "--all" in done.stderr), (2, True), done.stderr)
        self.assertIn("refused: look_at: a ray has no camera",
                      self.warned(lambda: self.woods.explain([0, 9, 0, 0, -1, 0], look_at=SMALL["look_at"])))

    def test_files_without_colours_name_the_options_of_colours(self):
        for flag, value, keyword in (("--palette", "viridis", {"palette": "viridis"}), ("--scale", "log", {"scale": "log"})):
            for ending, idle in (("png", False), ("html", False), ("exr", True), ("npy", True)):
                told = self.notes("heatmap", "woods", *VIEW, flag, value, "-o", self.out / f"h.{ending}")
                self.assertEqual(f"no effect on counts, which have no colours: {flag}" in told, idle, told)
            # Python's raw map keeps them for its png().
            for encode, idle in (("png", False), ("exr", True), ("raw", False)):
                told = self.warned(lambda: self.woods.heatmap(encode=encode, **keyword, **SMALL))
                self.assertEqual("no effect" in told, idle, told)
        said = "no effect on an EXR, which is linear: --tonemap, --exposure"
        self.assertIn(said, self.notes("render", "woods", *VIEW, "--integrator", "ao", "--spp", "1", "--tonemap", "aces",
                                       "--exposure", "1", "-o", self.out / "a.exr"))

    def test_boxes_of_hidden_things_are_skipped_where_something_is_hidden(self):
        for hide, idle in ((), True), (("--hide", "inst=0"), False):
            told = self.notes("render", "woods", *VIEW, *hide, "--skip-hidden-boxes", "-o", self.out / "a.png")
            self.assertEqual("no effect without --hide or --only: --skip-hidden-boxes" in told, idle, told)


if __name__ == "__main__":
    main()
