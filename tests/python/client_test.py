#!/usr/bin/env python3
"""Scenes, uploads, pictures and errors of the Python client against a real daemon, compared with
what the command line says.

  client_test.py RAYNESTD RAYNEST FLATC
"""
import copy
import inspect
import json
import os
import pickle
import socket
from unittest import mock

import numpy as np

import raynest
from raynest import _limits, generators
from raynest._requests.job import JobOptions
from raynest._requests.picture import Payload
from daemon import Daemon, closed_port
from with_daemon import MISS, WithDaemon, main, rain


class Scenes(WithDaemon):
    def test_its_version_is_that_of_the_programs(self):
        self.assertEqual(self.cli.run("--version").stdout.split(), ["raynest", raynest.__version__])

    def test_info_is_what_the_command_line_says(self):
        info, expected = self.woods.info, self.cli.json("info", "woods")
        # The command line asks for the EPO besides: it is measured for that.
        for key in expected.keys() - {"bytes_per_triangle", "epo"}:
            self.assertEqual(info[key], expected[key], key)
        self.assertTrue((np.array(info["box_min"]) < info["box_max"]).all())

    def test_lists_are_what_the_command_line_says(self):
        self.assertEqual([scene["name"] for scene in self.client.scenes()],
                         [scene["name"] for scene in self.cli.json("scenes")["scenes"]])
        masks = next(v for v in self.client.variants() if v["name"] == "alpha_mask")
        self.assertEqual([param["name"] for param in masks["params"]][:1], ["cutoff"])
        self.assertEqual(self.client.stats().keys(), self.cli.json("stats").keys())

    def test_paths_have_names(self):
        paths = self.woods.trace(rain(2000), fields=("path",))["path"]
        paths = paths[paths != MISS["path"]][:20]
        names = self.woods.path_of(paths)
        self.assertEqual(len(names), len(paths))
        # A miss has none, and hides none.
        self.assertEqual(self.woods.path_of([int(paths[0]), MISS["path"], int(paths[1])]),
                         [names[0], "", names[1]])
        self.assertEqual(self.woods.path_of(MISS["path"]), "")
        for path, name in list(zip(paths, names))[:3]:
            self.assertIn(name, self.cli.run("path", "woods", path).stdout)
            self.assertEqual(self.woods.path_of(int(path)), name)
        self.assertEqual(self.woods.path_of(paths[:0]), [])
        with self.assertRaisesRegex(raynest.Error, "no path"):
            self.woods.path_of([int(paths[0]), 2**60])
        with self.assertRaisesRegex(raynest.Error, "epoch 77|at epoch"):
            self.woods.path_of(int(paths[0]), epoch=77)
        # However many there are, they are one request.
        ids = np.arange(3000)
        before = self.client.connection._id
        texts = self.woods.path_of(ids)
        self.assertEqual(self.client.connection._id, before + 1)
        self.assertEqual(len(set(texts)), len(ids))
        for number in (0, 1234, 2999):
            self.assertEqual(texts[number], self.woods.path(number)["name"])

    def test_files_outside_of_the_folder_are_not_sent(self):
        folder = self.out / "scene"
        (folder / "inner").mkdir(parents=True)
        (self.out / "secret.bin").write_bytes(b"secret")
        (folder / "x.bin").write_bytes(b"there")
        (folder / "link.bin").symlink_to(self.out / "secret.bin")
        os.mkfifo(folder / "pipe.bin")
        for uri, why in (("../secret.bin", "beside or below"), ("link.bin", "link leaves the folder"),
                         ("pipe.bin", "regular file")):
            document = {"asset": {"version": "2.0"}, "buffers": [{"uri": uri, "byteLength": 5}]}
            (folder / "a.gltf").write_text(json.dumps(document))
            with self.assertRaisesRegex(raynest.InvalidError, f"a.gltf.*names.*{why}") as caught:
                self.client.load(folder / "a.gltf")
            self.assertEqual(caught.exception.exit_code, 5)
        for name in ("a.obj", "missing.glb"):
            with self.assertRaises(raynest.InvalidError):
                self.client.load(folder / name)

    def test_records_need_a_primitive(self):
        np.save(self.out / "balls.npy", np.array([[0, 0, 0, 1], [5, 0, 0, 2]], np.float32))
        with self.assertRaisesRegex(raynest.UsageError, "primitive="):
            self.client.load(self.out / "balls.npy")
        balls = self.client.load(self.out / "balls.npy", primitive="sphere")
        self.assertEqual(balls.name, "balls")
        for options in ({"primitive": "sphere"}, {"instances": self.out / "balls.npy"}):
            with self.assertRaisesRegex(raynest.UsageError, "are for .npy files"):
                self.client.load("builtin:forest?trees=20", **options)
        self.assertEqual(self.cli.run("load", "builtin:forest", "--primitive", "sphere").returncode,
                         raynest.UsageError.exit_code)
        hits = balls.trace([[0, 0, 9, 0, 0, -1], [5, 0, 9, 0, 0, -1]], fields=("t", "prim"))
        np.testing.assert_allclose(hits["t"], [8, 7], rtol=1e-6)
        self.assertEqual(hits["prim"].tolist(), [0, 1])

    def test_rows_of_faces_are_the_column_prim(self):
        chance = np.random.default_rng(5)
        centres = chance.uniform(-10, 10, (500, 3))
        centres[:, 2] = np.arange(500)
        vertices = (centres[:, None] + [[-1, -1, 0], [1, -1, 0], [0, 1, 0]]).reshape(-1, 3)
        scene = self.client.mesh(vertices, np.arange(1500).reshape(-1, 3), "triangles")
        hits = scene.trace(centres + [0, 0, 0.5], [0, 0, -1], fields=("t", "prim"))
        self.assertEqual(hits["prim"].tolist(), list(range(500)))
        np.testing.assert_allclose(hits["t"], 0.5, atol=1e-4)
        self.assertEqual(scene.info["unique_triangles"], 500)

    def test_a_mesh_that_is_kept_is_called_after_its_content(self):
        corners = np.eye(3)
        a, b = (self.client.mesh(corners, [[0, 1, 2]], keep=True) for _ in range(2))
        c = self.client.mesh(corners * 2, [[0, 1, 2]], keep=True)
        self.assertEqual(a.name, b.name)
        self.assertNotEqual(a.name, c.name)
        for scene in (a, c):
            scene.unload()
        with self.assertRaises(raynest.InvalidError):
            self.client.scene(c.name)

    def test_scenes_without_a_name_are_edited_apart_though_they_are_equal(self):
        face = [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]
        ray = [[0.2, 0.2, 5, 0, 0, -1]]
        with raynest.connect(self.daemon.uri) as other:
            for make in (lambda client: client.mesh(*face), lambda client: client.scene_of({"face": face})):
                moved, equal, theirs = make(self.client), make(self.client), make(other)
                before = self.client.stats()["scene_bytes"]
                with moved.edit() as edit:
                    edit.move(0, (0, 0, 1))
                again = make(self.client)
                self.assertEqual([float(each.trace(ray)["t"][0]) for each in (moved, equal, theirs, again)],
                                 [4, 5, 5, 5])
                # Equal content is there once.
                self.assertLess(self.client.stats()["scene_bytes"], 2.5 * before)
                for each in (moved, equal, again):
                    each.unload()

    def test_a_mesh_that_is_built_otherwise_is_another_scene(self):
        a, b = (self.client.mesh(np.eye(3), [[0, 1, 2]], build=build)
                for build in ("medium", "high"))
        self.assertNotEqual(a.name, b.name)
        self.assertEqual([a.info["build"], b.info["build"]], ["medium", "high"])

    def test_a_taken_name_needs_replace_and_is_a_new_epoch(self):
        corners = np.eye(3)
        first = self.client.mesh(corners, [[0, 1, 2]], "taken")
        with self.assertRaises(raynest.FailedError) as caught:
            self.client.mesh(corners * 2, [[0, 1, 2]], "taken")
        self.assertEqual(caught.exception.name, "NAME_TAKEN")
        self.assertEqual(first.info["epoch"], 1)
        again = self.client.mesh(corners * 2, [[0, 1, 2]], "taken", replace=True)
        self.assertEqual(again.info["epoch"], 2)
        with self.assertRaises(raynest.Error):
            again.trace(rain(1), epoch=1)


class Pictures(WithDaemon):
    def test_pictures_are_what_the_command_line_gets(self):
        self.cli.run("heatmap", "woods", "--size", "64x36", "-o", self.out / "h.npy")
        np.testing.assert_array_equal(self.woods.heatmap(size=(64, 36)),
                                      np.load(self.out / "h.npy"))
        heat = self.client.outcome["heat"]
        self.assertEqual(heat["metric"], "total")
        for name, options in (("h.png", {}), ("h.exr", {"metric": "prims", "palette": "viridis"})):
            words = [word for key, value in options.items() for word in (f"--{key}", value)]
            self.cli.run("heatmap", "woods", "--size", "64x36", *words, "-o", self.out / name)
            self.assertEqual(self.woods.heatmap(size=(64, 36), encode=name[-3:], **options),
                             (self.out / name).read_bytes())
        self.cli.run("render", "woods", "--size", "64x36", "-o", self.out / "r.png")
        self.assertEqual(self.woods.render(size=(64, 36), encode="png"),
                         (self.out / "r.png").read_bytes())

    def test_a_scene_without_a_camera_is_framed_and_the_notes_say_so(self):
        self.client.mesh(np.eye(3), [[0, 1, 2]], "bare").render(size=(8, 8))
        self.assertIn("no camera", str(self.client.outcome["notes"]))
        self.woods.render(size=(8, 8))
        self.assertNotIn("no camera", str(self.client.outcome["notes"]))

    def test_raw_pixels_are_an_array(self):
        pixels = self.woods.render(size=(80, 45), camera=1)
        self.assertEqual((pixels.shape, pixels.dtype), ((45, 80, 4), np.uint8))
        self.assertEqual(self.client.outcome["camera"], "canopy")
        above = self.woods.render(size=(40, 30), fov=30,
                                  look_at=([0, 100, 0], [0, 0, 0], [0, 0, 1]))
        self.assertEqual(set(above[:, :, 3].ravel()), {255})

    def test_large_pictures_come_in_pieces(self):
        pieces, size = [], (1024, 1536)
        take = Payload._place

        def place(picture, *frame):
            pieces.extend(take(picture, *frame))
            return pieces[-1:]
        with mock.patch.object(Payload, "_place", place):
            pixels = self.woods.render(size=size)
        self.assertEqual(pixels.shape, (1536, 1024, 4))
        self.assertGreater(len(pieces), 2)
        self.assertEqual(sum(map(len, pieces)), pixels.nbytes)
        # Each pixel is where its ray is.
        rays = generators.camera(size=size)
        hit = self.woods.trace(rays, fields=("hit",))["hit"].reshape(size[::-1])
        np.testing.assert_array_equal(pixels[..., 3] == 255, hit != 0)

    def test_an_origin_shifts_cameras(self):
        far = np.array([4e6, 5e6, 100.0])
        corners = np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0]])
        view = {"size": (32, 24), "fov": 60}
        here = self.client.mesh(corners, [[0, 1, 2]]).render(
            look_at=((0, 0, 3), (0, 0, 0)), **view)
        there = self.client.mesh(far + corners, [[0, 1, 2]], origin=far).render(
            look_at=(far + [0, 0, 3], far), **view)
        self.assertGreater(np.count_nonzero(here[..., 3]), 50)
        np.testing.assert_array_equal(there, here)

    def test_bad_cameras_and_sizes_are_refused(self):
        for options in ({"size": (0, 5)}, {"size": (99999, 5)}, {"look_at": ([0, 0, 0],)},
                        {"look_at": ([0, 0], [1, 1])}, {"camera": "unheard"}, {"fov": 200},
                        {"encode": "unheard"}, {"camera": 7}):
            with self.assertRaises(raynest.UsageError, msg=options):
                self.woods.render(**{"size": (8, 8), **options})


class Errors(WithDaemon):
    def test_errors_have_the_class_of_their_exit_code(self):
        ray = rain(1)
        for kind, name, call in (
                (raynest.InvalidError, "SCENE_UNKNOWN", lambda: self.client.scene("nowhere")),
                (raynest.InvalidError, "VARIANT_UNKNOWN",
                 lambda: self.woods.trace(ray, intersector="unheard")),
                (raynest.UsageError, "INVALID_PARAM",
                 lambda: self.woods.trace(ray, params={"unheard": 1})),
                (raynest.UsageError, "INVALID_FIELD",
                 lambda: self.woods.trace(ray, kind="unheard")),
                (raynest.UsageError, "INVALID_FIELD",
                 lambda: self.woods.trace(ray, fields=("t", "unheard"))),
                (raynest.UsageError, "INVALID_FIELD",
                 lambda: self.woods.trace(ray, kind="any", fields=("t",))),
                (raynest.InvalidError, "SCENE_INVALID",
                 lambda: self.client.load("builtin:unheard"))):
            with self.assertRaises(kind, msg=name) as caught:
                call()
            self.assertEqual(caught.exception.name, name)
            self.assertNotIn("\n", str(caught.exception))
        # In the midst of many rays, too.
        with self.assertRaises(raynest.UsageError):
            self.woods.trace(rain(1_000_000), fields=("unheard",))
        self.assertEqual(len(self.woods.trace(ray)["t"]), 1)

    def test_arguments_out_of_range_are_named_and_nothing_is_sent(self):
        ray, sent = rain(1), self.client.stats()["frames_received"]
        for says, call in (
                ("mask of -1: .* from 0 to 4294967295", lambda: self.woods.trace(ray, mask=-1)),
                ("mask of 4294967296", lambda: self.woods.trace(ray, mask=2**32)),
                ("epoch of -1", lambda: self.woods.trace(ray, epoch=-1)),
                ("epoch of 1.5", lambda: self.woods.path_of(1, epoch=1.5)),
                ("max_hits is of", lambda: self.woods.trace(ray, max_hits=5)),
                ("max_hits of 2.5", lambda: self.woods.trace(ray, kind="multi", max_hits=2.5)),
                ("max_hits of -5", lambda: self.woods.trace(ray, kind="multi", max_hits=-5)),
                ("max_hits of 0", lambda: self.woods.trace(ray, kind="multi", max_hits=0)),
                ("max_hits of 257: .* from 1 to 256",
                 lambda: self.woods.trace(ray, kind="multi", max_hits=257)),
                ("max_hits of 1099511627776: .* from 1 to 65536",
                 lambda: self.woods.trace(ray, kind="all", max_hits=1 << 40)),
                ("priority of 3: it must be a text", lambda: self.woods.trace(ray, priority=3)),
                (r"fields of \[1\]: it must be a list", lambda: self.woods.trace(ray, fields=(1,))),
                ("Query of .* bytes", lambda: self.woods.trace(
                    ray, fields=[f"{i:099}" for i in range(999)])),
                ("deadline of -1", lambda: self.woods.trace(ray, deadline=-1)),
                ("deadline must be numbers", lambda: self.woods.trace(ray, deadline="soon")),
                (r"deadline of \[1\]: .* one number", lambda: self.woods.trace(ray, deadline=[1])),
                ("params of 5: it must be a dict", lambda: self.woods.trace(ray, params=5)),
                ("fields of 5: .* names of columns", lambda: self.woods.trace(ray, fields=5)),
                ("margin must be numbers", lambda: self.woods.occluded([0], [1], margin="x")),
                ("a path id of 0.7: it must be a whole", lambda: self.woods.path_of(0.7)),
                ("a path id of -1", lambda: self.woods.path_of(-1)),
                ("a path id of -2", lambda: self.woods.path_of(np.array([1, -2]))),
                ("a path id of 2.0", lambda: self.woods.path_of([1, 2.0])),
                ("fov of 1e-60: in float32", lambda: self.woods.render(fov=1e-60)),
                ("look_at is", lambda: self.woods.render(look_at=5)),
                ("deadline of inf", lambda: raynest.Job(self.client, 1).wait(deadline=np.inf)),
                ("spp of -1", lambda: self.woods.render(samples=-1)),
                ("seed of -1: .* to 18446744073709551615", lambda: self.woods.render(integrator="ao", seed=-1)),
                ("fov of 1e", lambda: self.woods.render(fov=1e300)),
                ("eye of ", lambda: self.woods.render(look_at=([1e300, 0, 0], [0, 0, 0]))),
                ("a side of size of 2.5", lambda: self.woods.heatmap(size=(2.5, 3))),
                ("width, height", lambda: self.woods.heatmap(size=5)),
                ("reconnect of 3601: .* 0 to 3600 seconds", lambda: raynest.connect(self.daemon.uri, reconnect=3601)),
                ("sample of", lambda: self.woods.explain(pixel=(1, 1), integrator="path", sample=_limits.samples_max)),
                ("job of -1", lambda: self.client.job(-1).fetch()),
                ("name of 3", lambda: self.client.load("builtin:forest", 3)),
                ("scene of 3", lambda: self.client.scene(3))):
            with self.assertRaisesRegex(raynest.UsageError, says):
                call()
        self.assertEqual(self.client.stats()["frames_received"], sent + 1)
        self.assertEqual(len(self.woods.trace(ray)["t"]), 1)

    def test_none_is_the_default_of_every_option(self):
        def options(function):
            parameters = inspect.signature(function).parameters
            names = {name for name, each in parameters.items() if each.default is not each.empty}
            names |= JobOptions.__annotations__.keys() if "job" in parameters else set()
            names |= generators.SensorPose.__annotations__.keys() if "sensor" in parameters else set()
            return dict.fromkeys(names)

        def outcome(function, *arguments, **options):
            got = function(*arguments, **options)
            if isinstance(got, generators.Generator):
                return got._kind, got._settings, got._sensor, got._fov, got.count
            if isinstance(got, raynest.Client):
                got.close()
                return got.connection._window_bytes
            if isinstance(got, raynest.Scene) and got.name.startswith("mesh-"):
                return got.info["hash"]
            return repr(got) if not inspect.isgenerator(got) else repr(list(got))
        points, ray = [[1, 50, 2], [3, -9, 4]], rain(1)
        job = self.woods.trace(ray, detach=True)
        small = {"size": (16, 9)}
        for function, arguments, given in (
                (raynest.connect, (), {"uri": self.socket}), (job.wait, (), {}),
                (job.fetch, (), {}), (self.client.load, ("builtin:forest?trees=20",), {}),
                (self.client.mesh, (np.eye(3),), {"faces": [[0, 1, 2]]}),
                (self.woods.trace, (ray,), {}), (self.woods.stream, (ray,), {}),
                (self.woods.occluded, points, {}), (self.woods.path_of, (0,), {}),
                (self.woods.render, (), small), (self.woods.heatmap, (), small),
                (generators.camera, (), {}), (generators.pinhole, (9,), {}),
                (generators.orthographic, ((2, 1),), {}), (generators.equirectangular, (), {}),
                (generators.lidar, ([1, 2],), {}), (generators.hemisphere, points, {})):
            nones = options(function)
            self.assertTrue(nones)
            self.assertEqual(outcome(function, *arguments, **{**nones, **given}),
                             outcome(function, *arguments, **given), function)
        self.assertEqual(self.woods.render(size=None).shape, (540, 960, 4))
        self.assertEqual(generators.lidar([1], None).count, generators.lidar([1]).count)
        self.woods.trace(ray, intersector="alpha_mask", params={"cutoff": None})

    def test_what_has_a_connection_is_not_for_another_process(self):
        for each in (self.client, self.woods, raynest.Job(self.client, 1)):
            for copied in (pickle.dumps, copy.deepcopy):
                with self.assertRaisesRegex(raynest.UsageError, "connect in each process"):
                    copied(each)

    def test_a_forked_process_must_connect_again(self):
        ray = [[0, 1000, 0, 0, -1, 0]]
        child = os.fork()
        if child == 0:
            code = 1
            try:
                self.woods.trace(ray)
            except raynest.UsageError:
                code = 0
            finally:
                os._exit(code)
        self.assertEqual(os.waitpid(child, 0)[1], 0)
        self.woods.trace(ray)

    def test_a_forked_process_leaves_the_streams_of_the_other_one_alone(self):
        rays = rain(400_000)
        for leave in ("stream.close", "next", "client.close"):
            stream = self.woods.stream(rays, fields=("t",))
            answered = len(next(stream)[1]["t"])
            child = os.fork()
            if child == 0:
                code = 1
                try:
                    if leave == "next":
                        next(stream)
                    (stream if leave == "stream.close" else self.client).close()
                    code = 0
                except raynest.UsageError:
                    code = 0
                finally:
                    os._exit(code)
            self.assertEqual(os.waitpid(child, 0)[1], 0)
            answered += sum(len(columns["t"]) for _, columns in stream)
            self.assertEqual(answered, len(rays))

    def test_one_column_may_be_named_by_itself(self):
        ray = [[0, 1000, 0, 0, -1, 0]]
        self.assertEqual(list(self.woods.trace(ray, fields="prim")), ["prim"])

    def test_servers_that_are_none(self):
        for uri in ("127.0.0.1:31060", "tcp://127.0.0.1", "tcp://127.0.0.1:0",
                    "tcp://127.0.0.1:65536"):
            with self.assertRaises(raynest.UsageError, msg=uri):
                raynest.connect(uri)
        with closed_port() as nobody:
            for uri in (nobody, f"unix:{self.out}/nobody", "unix:" + "x" * 200):
                with self.assertRaises(raynest.ConnectError, msg=uri) as caught:
                    raynest.connect(uri)
                self.assertEqual(caught.exception.exit_code, 3)
                self.assertIsInstance(caught.exception, ConnectionError)

    def test_the_address_comes_from_the_environment(self):
        os.environ["RAYNEST_SERVER"] = self.socket
        self.addCleanup(os.environ.pop, "RAYNEST_SERVER")
        with raynest.connect() as client:
            self.assertEqual(client.uri, self.socket)
            self.assertIn("raynestd", repr(client))
            self.assertEqual(len(client.scene("woods").trace(rain(3))["t"]), 3)
        with self.assertRaisesRegex(raynest.ConnectError, "connect again"):
            client.scenes()

    def test_a_peer_that_is_dead_is_noticed_after_17_seconds(self):
        opened = self.client.connection._socket
        told = [opened.getsockopt(socket.IPPROTO_TCP, name) for name in (socket.TCP_KEEPIDLE, socket.TCP_KEEPINTVL, socket.TCP_KEEPCNT)]
        self.assertEqual((opened.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE), told), (1, [8, 3, 3]))

    def test_a_daemon_that_goes_away_is_an_error(self):
        daemon = Daemon(self.raynestd)
        client = raynest.connect(daemon.uri)
        client.load("builtin:terrain?size=16", "hills")
        daemon.stop()
        with self.assertRaises(raynest.Error):
            client.scenes()


if __name__ == "__main__":
    main()
