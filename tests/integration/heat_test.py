#!/usr/bin/env python3
"""Tests `raynest heatmap` beyond the picture: differences, limits, reports, and ranges of other maps.

  heat_test.py RAYNESTD RAYNEST
"""
import html.parser
import json
import os
import re
from unittest import mock

import numpy

from daemon import Client, Daemon, DaemonTest, main
from exr import read_exr, read_texts
from picture_test import coloured_square

VIEW = ("--size", "64x36", "--lookat", "0,6,18,0,4,0")
HOSTILE = "<img src=x onerror=alert(1)>"


class Heat(DaemonTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.client.json("load", "builtin:forest?trees=20", "--name", "woods")
        cls.client.json("load", "builtin:forest?trees=12", "--name", "grove")
        square = json.loads(coloured_square())
        square["meshes"][0]["name"] = square["nodes"][0]["name"] = square["materials"][0]["name"] = HOSTILE
        cls.hostile = cls.out / "square.gltf"
        cls.hostile.write_text(json.dumps(square))

    def counts(self, scene, *arguments):
        self.client.json("heatmap", scene, *VIEW, *arguments, "-o", self.out / "c.npy")
        return numpy.load(self.out / "c.npy")

    def refused(self, *arguments, code=2, says=""):
        self.assertEqual(self.client.fails(code, says, "heatmap", *arguments).stdout, "")


class Time(Heat):
    def time(self, *arguments):
        told = self.client.json("heatmap", "woods", *VIEW, "--metric", "time", *arguments, "-o", self.out / "t.npy")
        return told, numpy.load(self.out / "t.npy")

    def test_rays_that_do_more_take_longer(self):
        told, time = self.time()
        self.assertEqual((told["metric"], time.dtype, time.shape), ("time", numpy.uint32, (36, 64)))
        self.assertEqual(told["max"], time.max())
        total = self.counts("woods", "--metric", "total")
        most = numpy.argsort(total.ravel())
        # From quarter to quarter counts differ by much; the load of the machine does not turn that round.
        medians = [float(numpy.median(time.ravel()[pixels])) for pixels in numpy.array_split(most, 4)]
        self.assertEqual(medians, sorted(medians))
        self.assertLess(medians[0], medians[-1])
        note, = [note for note in told["notes"] if "median of 5 runs" in note]
        self.assertRegex(note, "lie within [0-9]+ %")

    def test_noise_is_that_of_the_runs(self):
        told = self.client.json("heatmap", "woods", *VIEW, "--metric", "time", "-o", self.out / "t.exr")
        channels = read_exr((self.out / "t.exr").read_bytes())[-1]
        time, noise = (numpy.asarray(channels[name], float).ravel() for name in ("time", "time_noise"))
        self.assertGreater((noise > 0).mean(), 0.5)
        # The note's share is that of the pixels; both are rounded, which tells in short times.
        note, = [note for note in told["notes"] if "median of 5 runs" in note]
        share = int(re.search("within ([0-9]+) %", note).group(1)) / 100
        self.assertAlmostEqual((noise[time > 0] / time[time > 0]).sum() / time.size, share, delta=0.01 + 0.1 * share)
        told = self.client.json("heatmap", "woods", *VIEW, "--metric", "time_noise", "-o", self.out / "n.npy")
        alone = numpy.load(self.out / "n.npy")
        self.assertEqual((told["metric"], alone.shape, told["max"]), ("time_noise", (36, 64), alone.max()))
        # Both are rows of a report.
        self.client.run("heatmap", "woods", *VIEW, "--metric", "time_noise", "-o", self.out / "n.html")
        report = (self.out / "n.html").read_text()
        self.assertTrue("<td>time</td>" in report and "<td>time_noise</td>" in report)

    def test_files_have_it_where_it_is_asked_for(self):
        for words, is_there in ((("--metric", "time"), True), ((), False)):
            self.client.json("heatmap", "woods", *VIEW, *words, "-o", self.out / "t.exr")
            channels = read_exr((self.out / "t.exr").read_bytes())[-1]
            self.assertEqual(["time" in channels, "time_noise" in channels], 2 * [is_there])
            self.assertIn("L1.boxes", channels)
        done = self.client.run("heatmap", "woods", *VIEW, "--metric", "time", "-o", self.out / "t.png")
        self.assertEqual(done.returncode, 0, done.stderr)
        over = self.client.run("heatmap", "woods", *VIEW, "--metric", "time", "--fail-if", "time.max>0")
        self.assertEqual(over.returncode, 9, over.stderr)

    def test_a_difference_and_several_samples(self):
        told = self.client.json("heatmap", "woods", *VIEW, "--metric", "time", "--diff", "grove", "-o", self.out / "d.npy")
        self.assertTrue(told["difference"])
        self.assertLess(told["min"], 0)

    def test_it_is_measured_on_a_cpu_and_has_no_levels(self):
        for words, says in ((("--metric", "time", "--count", "necessary"), "leave it out of a map of time"),
                            (("--metric", "time", "--worker", "cuda"), "on the CPU alone"),
                            (("--metric", "time.0"), "there is no metric 'time.0'; known: nodes,")):
            self.refused("woods", *VIEW, *words, "-o", self.out / "x.png", says=says)


class Differences(Heat):
    def check_difference(self, ours, theirs, *arguments):
        """Compares the difference of the arguments with that of two maps."""
        told = self.client.json("heatmap", "woods", *VIEW, *arguments, "-o", self.out / "d.npy")
        difference = numpy.load(self.out / "d.npy")
        self.assertEqual(difference.dtype, numpy.int32)
        expected = ours.astype(numpy.int64) - theirs
        numpy.testing.assert_array_equal(difference, expected)
        self.assertTrue(told["difference"])
        self.assertEqual((told["min"], told["max"]), (expected.min(), expected.max()))
        self.assertAlmostEqual(told["mean"], expected.mean())
        for percent in (50, 90, 99):
            self.assertEqual(told[f"p{percent}"],
                             numpy.percentile(expected, percent, method="inverted_cdf"))
        reach = numpy.percentile(abs(expected), 99, method="inverted_cdf")
        self.assertEqual((told["range_low"], told["range_high"]), (-reach, reach))
        return told

    def test_a_difference_is_what_two_maps_of_the_same_rays_differ_by(self):
        masked = self.counts("woods")
        opaque = self.counts("woods", "--intersector", "opaque")
        told = self.check_difference(masked, opaque, "--diff", "intersector=opaque")
        self.assertGreater(told["max"], 0)
        self.assertIn("alpha_mask", told["notes"][0])
        self.assertIn("opaque", told["notes"][0])
        self.check_difference(opaque, masked, "--intersector", "opaque", "--diff", "intersector=alpha_mask")
        self.check_difference(masked, self.counts("woods", "--set", "cutoff=0.9"), "--diff", "cutoff=0.9")
        self.check_difference(masked, self.counts("woods", "--mask", "0"), "--diff", "mask=0")
        grove = self.counts("grove")
        self.assertLess(self.check_difference(masked, grove, "--diff", "grove")["min"], 0)
        necessary = ("--count", "necessary")
        self.check_difference(self.counts("woods", *necessary), self.counts("grove", *necessary), *necessary,
                              "--diff", "grove")
        level = ("--metric", "boxes.2")
        self.check_difference(self.counts("woods", *level), self.counts("grove", *level), *level, "--diff", "grove")

    def test_other_scenes_may_be_files_and_differ_in_levels(self):
        told = self.check_difference(self.counts("woods"), self.counts("builtin:terrain?size=16"),
                                     "--diff", "builtin:terrain?size=16")
        self.assertGreater(told["mean"], 0)
        self.client.json("heatmap", "builtin:terrain?size=16", *VIEW, "--diff", "woods", "-o", self.out / "d.exr")
        _, _, channels = read_exr((self.out / "d.exr").read_bytes())
        deepest = self.client.json("info", "woods")["levels"] - 1
        self.assertLess(min(channels[f"L{deepest}.boxes"]), 0)
        self.assertEqual(max(channels[f"L{deepest}.boxes"]), 0)
        levels = [channels[f"L{level}.boxes"] for level in range(deepest + 1)]
        self.assertEqual(list(channels["boxes"]), [sum(pixel) for pixel in zip(*levels)])

    def test_a_picture_has_zero_in_the_middle_of_its_palette(self):
        told = self.client.json("heatmap", "woods", *VIEW, "--diff", "intersector=opaque", "-o", self.out / "d.png")
        self.assertEqual(told["range_low"], -told["range_high"])
        same = self.client.json("heatmap", "woods", *VIEW, "--diff", "woods", "-o", self.out / "s.png")
        self.assertEqual((same["min"], same["max"], same["clipped"]), (0, 0, 0))
        text = self.client.run("heatmap", "woods", *VIEW, "--diff", "intersector=opaque", "-o", self.out / "d.png")
        self.assertRegex(text.stdout, r"total per ray, difference: min [-+]\d+, mean \+\d")
        for arguments in (("--scale", "log"), ("--palette", "turbo"), ("--range", "-40:40"), ("--range", "auto")):
            self.client.json("heatmap", "woods", *VIEW, "--diff", "grove", *arguments, "-o", self.out / "d.png")

    def test_what_makes_no_difference_is_refused(self):
        to = ("-o", self.out / "x.png")
        self.refused("woods", "--diff", "traversal=packet", *to, says="makes no difference")
        self.refused("woods", "--diff", "nowhere", *to, code=5, says="nowhere")
        self.refused("woods", "--diff", "cutof=0.3", *to, says="cutof")
        self.refused("woods", "--diff", "cutoff=7", *to, says="cutoff")
        self.refused("woods", "--diff", "intersector=glass", *to, code=5, says="glass")
        self.refused("woods", "--diff", "grove", "--diff", "woods", *to, says="second scene")
        self.refused("woods", "--diff", "epoch=99", *to, code=5, says="epoch 1, not 99")
        self.refused("woods", "--diff", "", *to, says="--diff")
        self.refused("woods", "--diff", "grove", "--range", "0:40", *to, says="-high:high")
        self.refused("woods", "--diff", "grove", "--metric", "boxes.9", *to, says="levels, 0 to")
        self.client.json("load", self.hostile, "--name", "far", "--origin", "1000,0,0")
        self.refused("woods", "--diff", "far", *to, says="other origins")
        self.client.run("unload", "far")


class Limits(Heat):
    def test_a_limit_that_is_exceeded_gives_exit_code_9_and_all_values(self):
        told = self.client.json("heatmap", "woods", *VIEW, "-o", self.out / "a.png")
        p99 = told["p99"]
        checks = ("--fail-if", f"total.p99>{p99 - 1}", "--fail-if", f"total.p99>{p99}", "--fail-if",
                  "boxes.1.max<1", "--fail-if", "levels>40", "--fail-if", "bytes >= 1")
        done = self.client.run("heatmap", "woods", *VIEW, *checks)
        self.assertEqual(done.returncode, 9, done.stderr)
        self.assertIn(f"total.p99 is {p99}, above {p99 - 1}: exceeded", done.stdout)
        self.assertIn(f"total.p99 is {p99}, not above {p99}: ok", done.stdout)
        self.assertIn("boxes.1.max is ", done.stdout)
        self.assertIn("2 of 5 limits exceeded", done.stderr)
        self.assertEqual(done.stderr.count("\n"), 1, done.stderr)
        done = self.client.run("--json", "heatmap", "woods", *VIEW, *checks)
        self.assertEqual(done.returncode, 9)
        answer = json.loads(done.stdout)
        self.assertEqual([check["exceeded"] for check in answer["checks"]], [True, False, False, False, True])
        self.assertEqual(answer["checks"][0]["value"], p99)
        self.assertEqual(answer["checks"][0]["limit"], p99 - 1)
        self.assertEqual(json.loads(done.stderr)["error"]["name"], "THRESHOLD")
        done = self.client.run("heatmap", "woods", *VIEW, "--fail-if", "total.max>1e9")
        self.assertEqual((done.returncode, done.stderr), (0, ""))

    def test_every_metric_level_and_statistic_is_that_of_its_own_map(self):
        levels = self.client.json("info", "woods")["levels"]
        for metric in ("nodes", "boxes", "leaves", "prims", "instances", "instance_misses", "rejects", "box_hits",
                       "prim_hits", "total", "prims.0", f"prims.{levels - 1}"):
            told = self.client.json("heatmap", "woods", *VIEW, "--metric", metric, "-o", self.out / "a.npy")
            checks = [word for key in ("min", "mean", "p50", "p90", "p99", "max")
                      for word in ("--fail-if", f"{metric}.{key}<-1")]
            answer = self.client.json("heatmap", "woods", *VIEW, *checks)
            for check in answer["checks"]:
                self.assertAlmostEqual(check["value"], told[check["check"].split("<")[0].rsplit(".", 1)[1]])

    def test_files_are_written_all_the_same_from_the_same_traversal(self):
        for ending in ("png", "exr", "npy"):
            self.client.json("heatmap", "woods", *VIEW, "-o", self.out / f"plain.{ending}")
            before = self.client.json("stats")["rays"]
            done = self.client.run("heatmap", "woods", *VIEW, "--fail-if", "prims.2.max>0", "-o",
                                   self.out / f"checked.{ending}")
            self.assertEqual(done.returncode, 9, done.stderr)
            self.assertEqual((self.out / f"plain.{ending}").read_bytes(), (self.out / f"checked.{ending}").read_bytes())
            self.assertEqual(self.client.json("stats")["rays"] - before, 64 * 36)

    def test_limits_of_a_difference_are_signed(self):
        more = ("heatmap", "woods", *VIEW, "--diff", "intersector=opaque", "--fail-if")
        self.assertEqual(self.client.run(*more, "total.mean>0").returncode, 9)
        self.assertEqual(self.client.run(*more, "total.mean<0").returncode, 0)

    def test_limits_that_cannot_be_checked_are_refused(self):
        self.refused("woods", "--fail-if", "total.p99", says="> >= < <=")
        self.refused("woods", "--fail-if", "total.p98>1", says="statistics are")
        self.refused("woods", "--fail-if", "cost.p99>1", says="no metric 'cost'")
        self.refused("woods", "--fail-if", "total.p99>x", says="a number")
        self.refused("woods", "--fail-if", "prims.30.max>1", *VIEW, says="levels are 0 to")
        self.refused("woods", "--fail-if", "time.max>0", *VIEW, says="ask for it with --metric time")
        self.refused("woods", "--fail-if", "total.p99>1", "--detach", says="--detach")

    def test_the_ranking_follows_a_limit_that_is_exceeded(self):
        done = self.client.run("heatmap", "woods", *VIEW, "--fail-if", "total.max>0", "--top", "3")
        self.assertEqual(done.returncode, 9)
        self.assertIn("diagnosis", done.stdout)


class Ranges(Heat):
    def test_two_maps_have_one_scale(self):
        first = self.client.json("heatmap", "woods", *VIEW, "-o", self.out / "first.exr")
        other = self.client.json("heatmap", "grove", *VIEW, "-o", self.out / "o.png")
        self.assertNotEqual(first["range_high"], other["range_high"])
        self.assertEqual(read_texts((self.out / "first.exr").read_bytes())["raynest:count"], "traversed")
        told = self.client.json("heatmap", "grove", *VIEW, "--range-from", self.out / "first.exr", "-o", self.out / "o.png")
        self.assertEqual((told["range_low"], told["range_high"]), (first["range_low"], first["range_high"]))
        again = self.client.json("heatmap", "grove", *VIEW, "--range-from", self.out / "first.exr", "-o", self.out / "o.exr")
        third = self.client.json("heatmap", "woods", *VIEW, "--range-from", self.out / "o.exr", "-o", self.out / "t.png")
        self.assertEqual(again["range_high"], third["range_high"])
        difference = self.client.json("heatmap", "woods", *VIEW, "--diff", "grove", "-o", self.out / "d.exr")
        told = self.client.json("heatmap", "grove", *VIEW, "--diff", "woods", "--range-from", self.out / "d.exr",
                                "-o", self.out / "d.png")
        self.assertEqual(told["range_low"], difference["range_low"])

    def test_a_range_that_no_file_has_is_refused(self):
        to = ("-o", self.out / "x.png")
        self.client.json("heatmap", "woods", *VIEW, "-o", self.out / "first.exr")
        self.client.json("render", "woods", *VIEW, "-o", self.out / "render.exr")
        (self.out / "cut.exr").write_bytes((self.out / "first.exr").read_bytes()[:200])
        (self.out / "text.exr").write_text("no EXR")
        first = self.out / "first.exr"
        self.refused("woods", "--range-from", first, "--metric", "prims", *to, says="of --metric total, not of prims")
        self.refused("woods", "--range-from", first, "--range", "0:3", *to, says="--range")
        self.refused("woods", "--range-from", first, "--diff", "grove", *to,
                     says="is of counts, but --diff draws a difference: name an EXR that was made with --diff")
        self.client.json("heatmap", "woods", *VIEW, "--diff", "grove", "-o", self.out / "d.exr")
        self.refused("woods", "--range-from", self.out / "d.exr", *to, says="is of a difference: name an EXR")
        for name, says in (("missing.exr", "missing.exr"), ("cut.exr", "cut short"), ("text.exr", "is no EXR"),
                           ("render.exr", "no heat map")):
            self.refused("woods", "--range-from", self.out / name, *to, code=5, says=says)
        for text in ("5:5", "9:1", "nan:3", "0:inf", "-1:3", "1e99:2e99"):
            self.refused("woods", f"--range={text}", *to, says="range")


class Document(html.parser.HTMLParser):
    """The elements of a page, with their attributes, and its text."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.words = [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))

    def handle_data(self, data):
        self.words.append(data)


class Reports(Heat):
    def report(self, *arguments, code=0):
        done = self.client.run("heatmap", *arguments, "-o", self.out / "report.html")
        self.assertEqual(done.returncode, code, done.stderr)
        # The ranking is printed where it is asked for.
        self.assertEqual("WORK/RAY" in done.stdout, "--top" in arguments, done.stdout)
        text = (self.out / "report.html").read_text()
        return text, Document(text)

    def test_a_report_has_all_parts_and_needs_nothing_else(self):
        text, page = self.report("woods", *VIEW, "--top", "4", "--fail-if", "total.p99>1", code=9)
        words = "".join(page.words)
        for part in ("Histogram", "Diagnosis", "Instances", "Meshes", "Materials", "Counters per ray", "Limits",
                     "exceeded", "raynest heatmap woods --size 64x36", "trees above", "boxes.1"):
            self.assertIn(part, words)
        images = [attributes for tag, attributes in page.elements if tag == "img"]
        self.assertEqual(len(images), 2)
        for image in images:
            self.assertTrue(image["src"].startswith("data:image/png;base64,"))
        self.assertFalse({"script", "link", "iframe", "object", "embed", "base", "form", "a"} &
                         {tag for tag, _ in page.elements})
        for _, attributes in page.elements:
            for name, value in attributes.items():
                self.assertFalse(name.startswith("on"), (name, value))
                if name in ("src", "href", "action"):
                    self.assertTrue(value.startswith("data:"))
        self.assertIsNone(re.search(r"https?://|url\(|@import", text))

    def test_names_out_of_a_scene_are_text(self):
        text, page = self.report(self.hostile, "--size", "32x32", "--lookat", "0,0,4,0,0,0")
        self.assertNotIn("<img src=x", text)
        self.assertIn(HOSTILE, "".join(page.words))
        self.assertEqual(len([tag for tag, _ in page.elements if tag == "img"]), 2)

    def test_a_report_of_a_difference_tells_both_sides(self):
        _, page = self.report("woods", *VIEW, "--diff", "grove")
        words = " ".join(page.words)
        self.assertIn("Less that of", words)
        self.assertIn("grove", words)

    def test_a_report_of_a_moment_says_it_where_scene_and_camera_stand(self):
        self.client.json("load", "builtin:street?seconds=2&cars=2&length=50", "--name", "street")
        self.client.json("load", "builtin:street?seconds=2&cars=2&length=50", "--name", "avenue")
        animation, = self.client.json("info", "street")["animations"]
        name = animation or "animation 0"
        text, page = self.report("street", *VIEW, "--time", "0.5", "--diff", "avenue")
        words = "".join(page.words)
        self.assertIn(f"Moment0.5 s of {name}", words.replace("\n", ""))
        self.assertIn(f"avenue epoch 1 at 0.5 s of {name},", words)
        # Both pictures and all tables.
        for stands in ("<figcaption>", "<caption>"):
            self.assertEqual(text.count(stands), len(re.findall(stands + f"(?:The view: )?street at 0.5 s of {name}", text)))
        self.assertNotIn("Moment", "".join(self.report("street", *VIEW)[1].words))

    def test_one_line_of_a_build_needs_no_daemon(self):
        client = Client(self.raynest, "unix:/nowhere")
        done = client.run("--local", "heatmap", self.hostile, "--size", "32x32", "--lookat", "0,0,4,0,0,0", "--fail-if",
                          "total.max>10000", "--fail-if", "triangles>2", "-o", self.out / "local.html")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("Heat map of", (self.out / "local.html").read_text())


class BadInput(Heat):
    def test_each_is_one_line_and_the_daemon_lives(self):
        to = ("-o", self.out / "x.png")
        self.refused("woods", "--size", "0x5", *to, says="0x5")
        self.refused("woods", "--size", "99999x99999", *to, says="99999x99999")
        self.refused("woods", "--metric", "speed", *to, says="no metric 'speed'")
        self.refused("woods", "--metric", "boxes.9", *to, says="levels, 0 to")
        self.refused("woods", "--metric", "boxes.-1", *to, says="boxes.-1")
        self.refused("woods", "--lookat", "nan,0,0,1,1,1", *to, says="not finite")
        self.refused("woods", "--lookat", "1,1,1,1,1,1", *to, says="look")
        self.refused("woods", "--palette", "pink", *to, says="no palette 'pink'")
        self.refused("woods", "--scale", "cubic", *to, says="cubic")
        self.refused("woods", "--count", "some", *to, says="some")
        self.refused("woods", "-o", self.out / "no folder" / "x.png", code=1, says="no folder")
        self.refused("woods", "-o", self.out / "x.jpg", says=".html")
        self.assertEqual(self.client.json("heatmap", "woods", *VIEW, *to)["rays"], 64 * 36)


class Watching(DaemonTest):
    """raynest top and raynest open."""

    def setUp(self):
        # No test may open a browser.
        displays = mock.patch.dict(os.environ)
        displays.start()
        self.addCleanup(displays.stop)
        for name in ("DISPLAY", "WAYLAND_DISPLAY"):
            os.environ.pop(name, None)

    def test_one_look_for_a_script(self):
        self.client.json("load", "builtin:terrain?size=16", "--name", "hills")
        self.client.run("query", "nowhere", "--ray", "0,0,1,0,0,-1")
        told = self.client.json("top", "--once")
        self.assertEqual((told["jobs_running"], told["queue"]), (0, 0))
        self.assertEqual([scene["name"] for scene in told["scenes"]], ["hills"])
        self.assertGreater(told["scenes"][0]["bytes"], 0)
        self.assertGreater(told["seconds"], 0.9)
        self.assertIn("jobs_refused", told["refused"])
        done = self.client.run("top", "--once")
        self.assertEqual(done.returncode, 0, done.stderr)
        for word in ("0 jobs, queue 0", "rays/s, your memory", "SCENE", "hills"):
            self.assertIn(word, done.stdout)
        self.assertNotIn("\x1b", done.stdout)

    def test_running_jobs_and_their_rays_are_seen_until_ctrl_c(self):
        self.client.json("load", "builtin:forest?trees=30", "--name", "woods")
        job = self.client.run("heatmap", "woods", "--size", "6000x6000", "--detach").stdout.strip()
        watch = self.client.start("--json", "top")
        try:
            looks = [json.loads(watch.stdout.readline())]
            self.client.json("edit", "woods", "--hide", "inst=1")
            looks.append(json.loads(watch.stdout.readline()))
        finally:
            watch.send_signal(2)
            rest, errors = watch.communicate(timeout=30)
        self.assertEqual((watch.returncode, errors), (0, ""))
        self.assertEqual(looks[1]["jobs_running"], 1)
        self.assertEqual(looks[1]["jobs"][0]["job"], int(job))
        self.assertGreater(looks[1]["rays_per_second"], 0)
        self.assertGreater(looks[1]["edits_per_second"], 0)
        self.client.run("cancel", job)

    def test_open_tells_the_address_where_there_is_no_display(self):
        done = self.client.run("open")
        self.assertEqual(done.returncode, 1)
        self.assertIn("serves no page", done.stderr)
        daemon = Daemon(self.raynestd, "--http", "127.0.0.1:0")
        self.addCleanup(daemon.stop)
        client = Client(self.raynest, daemon.uri)
        done = client.run("open")
        self.assertEqual(done.returncode, 0, done.stderr)
        code = "code=[0-9a-f]{64}"
        self.assertRegex(done.stdout, f"^{re.escape(daemon.http)}/#{code}\n$")
        port = daemon.http.rsplit(":", 1)[1]
        self.assertIn(f"ssh -L {port}:127.0.0.1:{port} HOST", done.stderr)
        done = client.run("open", "nowhere")
        self.assertEqual(done.returncode, 5)
        told = client.json("open", "builtin:terrain?size=8")
        self.assertFalse(told["opened"])
        self.assertRegex(told["address"], f"^{re.escape(daemon.http)}/#scene=terrain&{code}$")
        self.assertIn("terrain", client.run("scenes").stdout)
        self.assertEqual(client.run("--local", "open").returncode, 2)
        # A browser of our own, which notes what it is to show.
        (self.out / "xdg-open").write_text(f'#!/bin/sh\necho "$1" > "{self.out}/shown"\n')
        (self.out / "xdg-open").chmod(0o755)
        os.environ.update(DISPLAY=":99", PATH=f"{self.out}:{os.environ['PATH']}")
        done = client.run("open", "terrain")
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        self.assertEqual((self.out / "shown").read_text(), done.stdout)


if __name__ == "__main__":
    main()
