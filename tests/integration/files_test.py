#!/usr/bin/env python3
"""Tests files that the command line reads and writes: pipes, stdin and stdout, every form of
numpy.save, odd names, modes and links.

  files_test.py RAYNESTD RAYNEST
"""
import contextlib
import io
import json
import os
import pathlib
import pty
import shutil
import signal
import stat
import subprocess

import numpy

from daemon import DaemonTest, PATIENCE, main

DOWN = [0.3, 1000, 0.4, 0, -1, 0]
TRIANGLE = json.dumps({
    "asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
    "accessors": [{"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 3,
                   "min": [0, 0, 0], "max": [1, 1, 0]}],
    "bufferViews": [{"buffer": 0, "byteLength": 36}],
    "buffers": [{"byteLength": 36, "uri": "data:application/octet-stream;base64,"
                 "AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}]}).encode()


def npy(array):
    file = io.BytesIO()
    numpy.save(file, array)
    return file.getvalue()


class Files(DaemonTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.client.json("load", "builtin:terrain?size=32", "--name", "hills")
        cls.hit = cls.client.json("query", "hills", "--ray", "0.3,1000,0.4,0,-1,0")

    def run_with(self, data, *arguments, **options):
        """Runs the command with bytes on stdin; its output is bytes too."""
        return subprocess.run([self.raynest, *map(str, arguments)], input=data, check=False,
                              capture_output=True, timeout=PATIENCE,
                              env=dict(os.environ, RAYNEST_SERVER=self.daemon.uri), **options)

    def hits(self, done):
        self.assertEqual(done.returncode, 0, done.stderr)
        return [json.loads(line) for line in done.stdout.splitlines()]

    # ---- reading --------------------------------------------------------------------------------

    def test_rays_come_from_stdin_and_out_of_pipes(self):
        data = npy(numpy.array([DOWN], numpy.float32))
        for path in ("-", "/dev/stdin", "/dev/fd/0"):
            self.assertEqual(
                self.hits(self.run_with(data, "--json", "query", "hills", "--rays", path)),
                [self.hit])
        pipe = self.fed("rays", data)
        self.assertEqual(self.hits(self.run_with(b"", "--json", "query", "hills", "--rays", pipe)),
                         [self.hit])
        done = self.run_with(b"nothing", "query", "hills", "--rays", "-")
        self.assertEqual((done.returncode, done.stderr),
                         (5, b"raynest: stdin is not a .npy file; save its array with "
                             b"numpy.save(FILE, array)\n"))
        done = self.run_with(b"", "query", "hills", "--rays", self.out)
        self.assertEqual((done.returncode, done.stderr.endswith(b"is a folder\n")), (5, True))

    def test_a_reader_that_leaves_ends_the_command_silently(self):
        """A table and a .npz alike: as head and other readers of a part expect."""
        for more in ((), ("-o", "-")):
            process = subprocess.Popen(
                [self.raynest, "--server", self.daemon.uri, "query", "hills", "--generate", "lidar",
                 "elevations=-90:90:200", "azimuths=0:360:2000", *more],
                stdout=subprocess.PIPE, stderr=subprocess.PIPE)
            process.stdout.read(10)
            process.stdout.close()
            self.assertEqual(process.stderr.read(), b"")
            process.stderr.close()
            self.assertEqual(process.wait(PATIENCE), -signal.SIGPIPE)

    def test_a_pipe_that_nobody_fills_can_be_left(self):
        os.mkfifo(self.out / "silent.glb")
        for arguments in (("load",), ("query", "hills", "--rays")):
            process = self.client.start(*arguments, self.out / "silent.glb")
            # The pipe can be opened for writing once the command reads it.
            with open(self.out / "silent.glb", "wb"):
                process.send_signal(signal.SIGINT)
                _, errors = process.communicate(timeout=PATIENCE)
            self.assertEqual((process.returncode, errors), (130, "raynest: interrupted\n"))

    def test_every_array_of_numbers_is_read_as_python_reads_it(self):
        rays = numpy.array([DOWN, [3, 1000, 4, 0, -2, 0], [5, 1000, 6, 0, 1, 0]])
        expected = self.hits(self.run_with(npy(rays.round().astype(numpy.float32)), "--json",
                                           "query", "hills", "--rays", "-"))
        for kind in ("<f2", ">f2", ">f4", "<f8", ">f8", "<i2", ">i2", "<i4", ">i4", "<i8", ">i8"):
            for order in "CF":
                with self.subTest(kind=kind, order=order):
                    array = numpy.array(rays.round(), kind, order=order)
                    self.assertEqual(self.hits(self.run_with(npy(array), "--json", "query", "hills",
                                                             "--rays", "-")), expected)
        unsigned = numpy.array([[1, 0, 1, 0, 1, 0]])
        answers = {self.run_with(npy(unsigned.astype(kind)), "query", "hills", "--rays", "-").stdout
                   for kind in ("u1", ">u2", "u4", ">u8", "i1", "f4")}
        self.assertEqual(len(answers), 1)

    def test_what_holds_no_real_numbers_is_named(self):
        for array, words in ((numpy.array(["0,1,2"]), b"text (<U5)"),
                             (numpy.array([b"abc"]), b"text (|S3)"),
                             (numpy.zeros((1, 6), complex), b"complex numbers"),
                             (numpy.zeros((1, 6), bool), b"true and false"),
                             (numpy.zeros((1, 6), numpy.longdouble), b"long doubles (<f16)"),
                             (numpy.zeros(2, [("o", "<f4", 3)]), b"records with named fields"),
                             (numpy.zeros(2, [("o", "<f4", 3)]), b"structured_to_unstructured"),
                             (numpy.zeros((4, 5)), b"has the shape (4, 5); rays have the shape"),
                             (numpy.zeros(5), b"has the shape (5,); rays have the shape")):
            done = self.run_with(npy(array), "query", "hills", "--rays", "-")
            self.assertEqual(done.returncode, 5)
            self.assertIn(words, done.stderr)

    def test_one_ray_may_lack_its_brackets_and_none_have_empty_columns(self):
        done = self.run_with(npy(numpy.array(DOWN)), "--json", "query", "hills", "--rays", "-")
        self.assertEqual(self.hits(done), [self.hit])
        for none in (numpy.zeros((0, 6)), numpy.zeros((0, 8), numpy.float32), numpy.zeros(0)):
            self.assertEqual(
                self.hits(self.run_with(npy(none), "--json", "query", "hills", "--rays", "-")), [])
            done = self.run_with(npy(none), "--json", "query", "hills", "--rays", "-", "--fields",
                                 "t,ng,path", "-o", self.out / "none.npz")
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertEqual([json.loads(done.stdout)[key] for key in ("rays", "misses")], [0, 0])
            with numpy.load(self.out / "none.npz") as columns:
                self.assertEqual({name: (columns[name].dtype.str, columns[name].shape)
                                  for name in columns.files},
                                 {"t": ("<f4", (0,)), "ng": ("<f4", (0, 3)), "path": ("<u8", (0,))})
        self.run_with(npy(none), "query", "hills", "--rays", "-", "--kind", "multi", "-o",
                      self.out / "none.npz")
        with numpy.load(self.out / "none.npz") as columns:
            self.assertEqual(columns["ray_splits"].tolist(), [0])
        done = self.run_with(npy(none), "query", "hills", "--rays", "-")
        self.assertEqual(done.stdout.split(), b"ray t prim geom path u v".split())
        self.assertRegex(done.stderr, b"^raynest: 0 rays in .* hills epoch 1\n$")

    def test_an_endless_pipe_of_rays_is_refused_by_its_header(self):
        """Checks that the command ends while its pipe is still open for writing."""
        header = npy(numpy.zeros((4, 6)))[:128]
        for n, (begin, words) in enumerate((
                (header.replace(b"(4, 6)", b"(4, 5)"), "has the shape (4, 5)"),
                (header.replace(b"(4, 6), ", b"(99999999999, 6), "), "4799999999952 bytes"),
                (header.replace(b"(4, 6), ", b"(9999999999999999999, 6), "), "than any file has"),
                (header[:6] + b"\2\0" + b"\xff" * 120, "a header of 4294967295 bytes"),
                (header + bytes(4 * 6 * 8 + 1), "goes on after 320 bytes"),
                (b"x", "not a .npy file"))):
            pipe = self.out / f"endless-{n}"
            os.mkfifo(pipe)
            process = self.client.start("query", "hills", "--rays", pipe)
            with open(pipe, "wb", buffering=0) as writer:
                writer.write(begin)
                _, errors = process.communicate(timeout=PATIENCE)
            self.assertIn(words, errors)
            self.assertEqual(process.returncode, 5)

    def test_a_scene_comes_from_stdin_and_out_of_pipes(self):
        for path in ("-", "/dev/stdin"):
            done = self.run_with(TRIANGLE, "--json", "load", path, "--name", "three")
            self.assertEqual((done.returncode, json.loads(done.stdout)["unique_triangles"]), (0, 1))
        pipe = self.fed("piped.gltf", TRIANGLE)
        self.assertEqual(self.client.json("load", pipe)["name"], "piped")
        pipe = self.fed("unending", TRIANGLE)
        self.assertEqual(self.client.json("load", pipe, "--replace")["name"], "unending")
        done = self.run_with(b"", "load", "/dev/zero")
        self.assertEqual((done.returncode, b"/dev/zero brought no scene" in done.stderr), (5, True))
        done = self.run_with(TRIANGLE, "load", "-")
        self.assertEqual(done.returncode, 2)
        self.assertIn(b"a scene of stdin has no name of its own; pass --name NAME", done.stderr)
        done = self.run_with(b"hello", "load", "-", "--name", "x")
        self.assertEqual(done.returncode, 5)
        self.assertIn(b"known by its first bytes: a .glb, .gltf, .npy", done.stderr)
        balls = npy(numpy.array([[0, 0, 0, 1]], numpy.float32))
        done = self.run_with(balls, "load", "-", "--name", "balls", "--primitive", "sphere")
        self.assertEqual(done.returncode, 0, done.stderr)

    def test_a_picture_that_leaves_the_folder_is_left_out(self):
        (self.out / "leaf.png").symlink_to("/etc/hostname")
        scene = json.loads(TRIANGLE)
        scene |= {"images": [{"uri": "leaf.png"}], "textures": [{"source": 0}],
                  "materials": [{"alphaMode": "MASK", "pbrMetallicRoughness":
                                 {"baseColorTexture": {"index": 0}}}]}
        scene["meshes"][0]["primitives"][0]["material"] = 0
        (self.out / "linked.gltf").write_text(json.dumps(scene))
        done = self.client.run("load", self.out / "linked.gltf")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(done.stderr, "raynest: the picture leaf.png: link leaves the folder; only "
                                      "links that end inside it are followed. It is left out\n")
        self.assertRegex(done.stdout, "warning .*leaf.png")

    def test_names_need_not_be_utf8(self):
        folder = pathlib.Path(os.fsdecode(os.fsencode(self.out) + b"/caf\xe9"))
        folder.mkdir()
        path = folder / os.fsdecode(b"tr\xe8s.gltf")
        path.write_bytes(TRIANGLE)
        self.assertEqual(self.client.json("load", path)["name"], "tr?s")
        (folder / "rays.npy").write_bytes(npy(numpy.array([DOWN])))
        picture = folder / os.fsdecode(b"\xff.png")
        for arguments in (("load", path, "--name", "named"), ("info", "tr?s"),
                          ("query", "hills", "--rays", folder / "rays.npy"),
                          ("--json", "render", "hills", "--size", "8x8", "-o", picture)):
            done = self.client.run(*arguments)
            self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(picture.read_bytes()[:4], b"\x89PNG")

    # ---- writing --------------------------------------------------------------------------------

    def render(self, output, *arguments, raynest=(), **options):
        return subprocess.run([*raynest, self.raynest, *arguments, "render", "hills", "--size", "8x8",
                               "-o", output], check=False, capture_output=True, timeout=PATIENCE,
                              env=dict(os.environ, RAYNEST_SERVER=self.daemon.uri), **options)

    def test_stdout_takes_bytes_and_stderr_what_is_said_of_them(self):
        for output, start in (("-", b"\x89PNG"), ("-.exr", b"\x76\x2f\x31\x01"),
                              ("-.npy", b"\x93NUMPY")):
            done = self.render(output)
            self.assertEqual((done.returncode, done.stdout[:len(start)]), (0, start), done.stderr)
            self.assertIn(b"8x8", done.stderr)
        done = self.render("-", "--json")
        self.assertEqual((done.stdout[:4], json.loads(done.stderr)["file"]), (b"\x89PNG", "-"))
        done = self.run_with(b"", "query", "hills", "--ray", "0.3,1000,0.4,0,-1,0", "-o", "-")
        with numpy.load(io.BytesIO(done.stdout)) as columns:
            self.assertEqual(columns["prim"].shape, (1,))
        done = self.run_with(b"", "heatmap", "hills", "--size", "8x8", "-o", "-.npy")
        self.assertEqual(numpy.load(io.BytesIO(done.stdout)).shape, (8, 8))
        job = self.client.json("render", "hills", "--size", "8x8", "-o", "x.png", "--detach")["job"]
        self.client.run("wait", job)
        done = self.run_with(b"", "fetch", job, "-o", "-")
        self.assertEqual(done.stdout[:4], b"\x89PNG", done.stderr)

    def test_a_terminal_gets_no_bytes(self):
        ours, theirs = pty.openpty()
        with open(ours, "rb", buffering=0), open(theirs, "wb", buffering=0) as terminal:
            done = subprocess.run([self.raynest, "render", "hills", "-o", "-"], stdout=terminal,
                                  stderr=subprocess.PIPE, check=False, timeout=PATIENCE,
                                  env=dict(os.environ, RAYNEST_SERVER=self.daemon.uri))
        self.assertEqual(done.returncode, 2)
        self.assertIn(b"pipe them on, or name a file", done.stderr)

    def test_endings_may_be_capitals(self):
        for name, start in (("a.PNG", b"\x89PNG"), ("a.Npy", b"\x93NUMPY")):
            self.assertEqual(self.render(self.out / name).returncode, 0)
            self.assertEqual((self.out / name).read_bytes()[:len(start)], start)
        done = self.run_with(b"", "query", "hills", "--ray", "0,9,0,0,-1,0", "-o", self.out / "a.NPZ")
        self.assertEqual(done.returncode, 0, done.stderr)

    def test_what_is_there_keeps_its_mode_and_its_links(self):
        file, link = self.out / "mode.png", self.out / "link.png"
        file.write_bytes(b"old")
        file.chmod(0o640)
        link.symlink_to("mode.png")
        self.assertEqual(self.render(link).returncode, 0)
        self.assertEqual(stat.S_IMODE(file.stat().st_mode), 0o640)
        self.assertTrue(link.is_symlink())
        self.assertEqual(file.read_bytes()[:4], b"\x89PNG")

        second = self.out / "second.png"
        os.link(file, second)
        file.write_bytes(b"old")
        self.assertEqual(self.render(file).returncode, 0)
        self.assertEqual(second.read_bytes()[:4], b"\x89PNG")

        dangling = self.out / "dangling.png"
        dangling.symlink_to("made.png")
        self.assertEqual(self.render(dangling).returncode, 0)
        self.assertEqual((self.out / "made.png").read_bytes()[:4], b"\x89PNG")

        file.chmod(0o444)
        done = self.render(file)
        self.assertEqual(done.returncode, 1)
        self.assertIn(b"it is read-only; chmod +w it, or give -o another name", done.stderr)

    def test_a_name_may_be_as_long_as_the_system_allows(self):
        name = "n" * 251 + ".png"
        self.assertEqual(self.render(self.out / name).returncode, 0)
        self.assertEqual(self.render(self.out / name).returncode, 0)
        self.assertEqual([path.name for path in self.out.iterdir() if path.name.startswith(".raynest")], [])

    def test_a_file_in_a_folder_that_cannot_be_written_is_written(self):
        if os.geteuid() != 0:
            self.skipTest("only root can become another user, for whom a folder is read-only")
        self.out.chmod(0o755)
        folder = self.out / "closed"
        folder.mkdir()
        shutil.copy(self.raynest, self.out / "raynest")
        for name in ("mine.png", "others.png"):
            (folder / name).write_bytes(b"old")
        (folder / "mine.png").chmod(0o666)
        nobody = {"user": 65534, "group": 65534, "extra_groups": []}
        with contextlib.ExitStack() as restore:
            restore.callback(type(self).__setattr__, self, "raynest", self.raynest)
            self.raynest = str(self.out / "raynest")
            self.assertEqual(self.render(folder / "mine.png", **nobody).returncode, 0)
            self.assertEqual((folder / "mine.png").read_bytes()[:4], b"\x89PNG")
            self.assertEqual(os.listdir(folder).sort(), ["mine.png", "others.png"].sort())
            for name in ("others.png", "new.png"):
                done = self.render(folder / name, **nobody)
                self.assertEqual(done.returncode, 1)
                self.assertIn(b"Permission denied", done.stderr)


if __name__ == "__main__":
    main()
