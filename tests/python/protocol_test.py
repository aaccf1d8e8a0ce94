#!/usr/bin/env python3
"""The protocol as the Python client has it, against the house's own: the schema's compiler, the
golden frames, and the tables of PROTOCOL.md. Needs no daemon.

  protocol_test.py RAYNESTD RAYNEST FLATC
"""
import json
import os
import pathlib
import random
import re
import struct
import subprocess
import sys
import tempfile
import unittest

import numpy as np

from raynest import _limits, errors
from raynest._net.control import decode, encode
from raynest._net.frame import HEADER, Header, read_blocks, read_header, write_header
from raynest._net.schema import SCHEMA, SCALARS
from raynest._requests.columns import Answered, OF_HITS, OF_RAYS
from raynest._requests.files import read_file_beneath
from raynest._requests.gltf import file_names, file_of_uri, mesh_glb
from raynest._requests.obj import names_in
from raynest._requests.rays import Rays
from raynest._requests.sight import Segments

ROOT = pathlib.Path(__file__).resolve().parents[2]
SCHEMA_FILE = ROOT / "protocol" / "messages.fbs"
GLTF_URIS = ROOT / "tests" / "golden" / "gltf_uris.json"
PROTOCOL = (ROOT / "protocol" / "PROTOCOL.md").read_text(encoding="utf-8")


def golden_frames():
    """(name, bytes) of every frame in frames.hex."""
    text = (ROOT / "tests" / "golden" / "frames.hex").read_text(encoding="utf-8")
    for name, dump in re.findall(r"^frame (\w+).*\n((?:[0-9a-f]{4}  .*\n?)+)", text, re.MULTILINE):
        yield name, bytes.fromhex("".join(line[6:53] for line in dump.splitlines()))


def messages():
    """(name, header, control) of every frame in frames.hex."""
    for name, frame in golden_frames():
        header = read_header(frame[:HEADER.size])
        yield name, header, frame[HEADER.size:HEADER.size + header.control_bytes]


def pruned(value):
    """Without what is as good as absent, and floats as float32: to compare messages by meaning."""
    if isinstance(value, dict):
        items = {key: pruned(item) for key, item in value.items()}
        return {key: item for key, item in items.items() if item not in ("", [], {}, None, 0)}
    if isinstance(value, (list, tuple)):
        return [pruned(item) for item in value]
    return float(np.float32(value)) if isinstance(value, float) else value


class Schema(unittest.TestCase):
    flatc = None

    def by_flatc(self, name, control):
        """The message as the schema's compiler reads it."""
        with tempfile.TemporaryDirectory() as folder:
            binary = pathlib.Path(folder) / "message.bin"
            binary.write_bytes(control)
            subprocess.run([self.flatc, "--json", "--strict-json", "--raw-binary", "--root-type",
                            f"raynest.wire.{name}", "-o", folder, SCHEMA_FILE, "--", binary],
                           check=True, capture_output=True)
            message = json.loads((pathlib.Path(folder) / "message.json").read_text())
        return self.comparable(name, message)

    def comparable(self, table, value):
        """flatc's JSON in our words: structs are dicts there, enumerators are names."""
        out = {}
        for field in SCHEMA.tables[table]:
            item = value.get(field.name, field.default if field.type in SCALARS else None)
            if field.type in SCHEMA.structs and item:
                item = [list(each.values()) for each in item] if field.many else \
                    list(item.values())
            elif field.type in SCHEMA.tables and item:
                item = [self.comparable(field.type, each) for each in item] if field.many else \
                    self.comparable(field.type, item)
            elif isinstance(item, str) and field.type in SCALARS:
                item = SCHEMA.enums["Dtype"][item]
            out[field.name] = item
        return pruned(out)

    def test_golden_frames_read_as_flatc_reads_them(self):
        for name, _, control in messages():
            with self.subTest(name=name):
                self.assertEqual(pruned(decode(name, control)), self.by_flatc(name, control))

    def test_flatc_reads_what_is_written(self):
        for name, _, control in messages():
            with self.subTest(name=name):
                message = decode(name, control)
                self.assertEqual(self.by_flatc(name, encode(name, message)), pruned(message))

    def test_numbers_are_aligned(self):
        """FlatBuffers' verifier asks for it, relative to the buffer."""
        mark = 0x1122334455667788
        for n in range(8):
            texts = ["x" * n] * n
            for name, message in (
                    ("Load", {"source": "x" * n, "file_names": texts, "file_hashes": [mark],
                              "file_digests": bytes([n % 256] * n)}),
                    ("Started", {"scene": "x" * n, "notes": texts, "epoch": mark}),
                    ("Credit", {"bytes": mark}),
                    ("Query", {"job": {"scene": "x" * n, "epoch": mark, "settings": texts}}),
                    ("Loaded", {"info": {"name": "x" * n, "epoch": mark, "cameras": texts}}),
                    ("Chunk", {"blocks": [{"name": text} for text in texts] + [{"count": mark}]})):
                at = encode(name, message).index(struct.pack("<Q", mark))
                self.assertEqual(at % 8, 0, (name, n))

    def test_what_is_written_reads_the_same(self):
        for name, _, control in messages():
            with self.subTest(name=name):
                message = decode(name, control)
                self.assertEqual(decode(name, encode(name, message)), message)

    def test_every_message_has_a_golden_frame(self):
        self.assertEqual({name for name, _ in golden_frames()}, set(SCHEMA.types))

    def test_a_field_that_is_not_in_the_schema_cannot_be_written(self):
        with self.assertRaises(KeyError):
            encode("Ping", {"payloda": 1})

    def test_damaged_messages_are_refused_or_read_but_never_crash(self):
        chance = random.Random(7)
        refused = 0
        for name, _, control in messages():
            for cut in range(len(control)):
                refused += self.read(name, control[:cut])
            for _ in range(200):
                damaged = bytearray(control)
                for _ in range(chance.randint(1, 4)):
                    damaged[chance.randrange(len(damaged))] = chance.randrange(256)
                refused += self.read(name, bytes(damaged))
        self.assertGreater(refused, 1000)

    def read(self, name, data):
        try:
            decode(name, data)
        except errors.ProtocolError:
            return True
        return False

    def test_tables_that_point_at_each_other_are_refused_at_the_limit(self):
        # A vector of tables whose items are all the same: more than control_tables_max of them.
        many = encode("VariantList", {"variants": [{"name": "x"}] * 300})
        with self.assertRaisesRegex(errors.ProtocolError, "too many tables"):
            decode("VariantList", many)


class Tables(unittest.TestCase):
    def test_limits_are_those_of_the_protocol(self):
        documented = {name: int(value) for name, value in
                      re.findall(r"^\| `(\w+)` \| (\d+) \|", PROTOCOL, re.MULTILINE)}
        ours = {name: value for name, value in vars(_limits).items() if isinstance(value, int)}
        self.assertGreater(len(ours), 5)
        self.assertEqual(ours, {name: documented[name] for name in ours})

    def test_errors_are_those_of_the_protocol(self):
        rows = re.findall(r"^\| (\d+) \| ([A-Z_]+) \| (\d+) \|", PROTOCOL, re.MULTILINE)
        self.assertEqual([(int(code), name, int(exit_code)) for code, name, exit_code in rows],
                         [(i + 1, name, kind.exit_code)
                          for i, (name, kind) in enumerate(errors.TABLE)])

    def test_an_error_of_a_later_version_reads_as_internal(self):
        error = errors.from_daemon(999, "new", 0)
        self.assertEqual((error.name, error.exit_code, str(error)), ("INTERNAL", 1, "new"))

    def test_columns_are_those_of_the_protocol(self):
        section = PROTOCOL[PROTOCOL.index("lists: columns"):PROTOCOL.index("## 8. ")]
        documented = {}
        for names, kind in re.findall(r"^\| ((?:`\w+`,? ?)+) \| ([\w ,]+)", section, re.MULTILINE):
            kinds = kind.strip().split(", ")
            for i, name in enumerate(re.findall(r"`(\w+)`", names)):
                *width, dtype = kinds[min(i, len(kinds) - 1)].split(" x ")
                documented[name] = (dtype, int(width[0]) if width else 1)
        ours = {name: (f"{dtype.kind}{8 * dtype.itemsize}", width)
                for name, (dtype, width) in {**OF_HITS, **OF_RAYS}.items() if name != "ray_splits"}
        self.assertEqual(ours, documented)


class Frames(unittest.TestCase):
    def test_headers_of_golden_frames_are_written_alike(self):
        for name, frame in golden_frames():
            header = read_header(frame[:HEADER.size])
            self.assertEqual(write_header(header), frame[:HEADER.size], name)
            self.assertEqual(SCHEMA.names[header.type], name)

    def test_blocks_of_golden_frames_fill_them(self):
        seen = 0
        for name, header, control in messages():
            blocks = read_blocks(header, decode(name, control).get("blocks", []))
            seen += len(blocks)
        self.assertGreater(seen, 3)

    def test_headers_beyond_the_limits_are_refused(self):
        good = Header(153, 64, 1, 128, 7)
        for bad in (good._replace(control_bytes=_limits.control_bytes_max + 1),
                    good._replace(bulk_bytes=_limits.frame_bytes_max),
                    good._replace(bulk_bytes=2**64 - 64), good._replace(bulk_bytes=65),
                    good._replace(block_count=65), good._replace(block_count=0)):
            with self.assertRaises(errors.ProtocolError, msg=bad):
                read_header(write_header(bad))
        with self.assertRaises(errors.ProtocolError):
            read_header(b"HTTP" + write_header(good)[4:])
        self.assertEqual(read_header(write_header(good)), good)

    def test_blocks_that_do_not_fit_are_refused(self):
        good = {"name": "t", "dtype": 3, "count": 16, "stride": 4, "offset": 0, "bytes": 64}
        header = Header(153, 0, 1, 64, 1)
        self.assertEqual(len(read_blocks(header, [good])), 1)
        for change in ({"dtype": 4}, {"stride": 5}, {"stride": 2}, {"count": 17},
                       {"count": 2**62, "bytes": 0}, {"offset": 64}, {"bytes": 2**63},
                       {"count": 1, "bytes": 4, "offset": 1}, {"count": 17, "bytes": 68}):
            with self.assertRaises(errors.ProtocolError, msg=change):
                read_blocks(header, [{**good, **change}])
        with self.assertRaises(errors.ProtocolError):
            read_blocks(Header(153, 0, 2, 128, 1), [good, {**good, "offset": 64}])


class Chunks(unittest.TestCase):
    def test_answers_come_in_any_order_but_once(self):
        chance = random.Random(3)
        for _ in range(50):
            cuts = sorted(chance.sample(range(1, 1000), 20))
            ranges = list(zip([0] + cuts, cuts + [1000]))
            chance.shuffle(ranges)
            answered = Answered()
            for first, end in ranges:
                answered.add(Range(first, end - first), 1000)
                with self.assertRaises(errors.ProtocolError):
                    answered.add(Range(chance.randrange(first, end), 1), 1000)
            self.assertEqual(answered.count, 1000)
        for first, count in ((990, 11), (5, 0), (1000, 1)):
            with self.assertRaises(errors.ProtocolError):
                Answered().add(Range(first, count), 1000)

    def test_a_uri_names_a_file_beneath_the_folder_or_none(self):
        for uri, name in json.loads(GLTF_URIS.read_text(encoding="utf-8")):
            self.assertEqual(file_of_uri(uri), name, uri)
        self.assertIsNone(file_of_uri("%ff"))
        self.assertIsNone(file_of_uri("x" * 1025))

    def test_an_obj_names_files_beneath_its_folder(self):
        for case in json.loads(GLTF_URIS.with_name("obj_names.json").read_text(encoding="utf-8")):
            self.assertEqual(names_in(case["file"], case["text"].encode()), case["names"], case)

    def test_links_are_followed_where_they_end_in_the_folder(self):
        with tempfile.TemporaryDirectory() as outside, tempfile.TemporaryDirectory() as inside:
            folder = pathlib.Path(inside)
            (pathlib.Path(outside) / "secret").write_bytes(b"secret")
            (folder / "deep" / "er").mkdir(parents=True)
            (folder / "deep" / "er" / "b").write_bytes(b"two")
            os.mkfifo(folder / "pipe")
            for link, target in (("file", "deep/er/b"), ("deep/again", "../deep/./er/../er/b"),
                                 ("dir", "deep"), ("round", "around"), ("around", "round"),
                                 ("secret", f"{outside}/secret"), ("zero", "/dev/zero"),
                                 ("out", f"../{pathlib.Path(outside).name}"), ("here", "dir/.."),
                                 ("out_and_in", f"../{folder.name}/deep/er/b"),
                                 ("absolute", f"{inside}/deep/er/b"),
                                 ("absolute_dir", f"{inside}/deep/er")):
                (folder / link).symlink_to(target)
            for name in ("deep/er/b", "file", "deep/again", "dir/er/b", "dir/again", "here/file",
                         "out_and_in", "absolute", "absolute_dir/b"):
                self.assertEqual(read_file_beneath(inside, name, 100), b"two", name)
            for name in ("gone", "gone/x", "file/x"):
                self.assertIsNone(read_file_beneath(inside, name, 100), name)
            for name in ("secret", "zero", "out/secret", "../x"):
                with self.assertRaisesRegex(errors.InvalidError, "link leaves the folder", msg=name):
                    read_file_beneath(inside, name, 100)
            for name, why in (("round", "in a circle"), ("round/x", "in a circle"),
                              ("pipe", "regular file"), ("deep", "regular file"),
                              ("deep/er/b", "at most 2")):
                with self.assertRaisesRegex(errors.InvalidError, why, msg=name):
                    read_file_beneath(inside, name, 2)
            self.assertLess(len(os.listdir("/proc/self/fd")), 64)

    def test_files_that_a_gltf_names(self):
        document = {"buffers": [{"uri": "a.bin"}, {"uri": "data:,x"}, {}],
                    "images": [{"uri": "./b.png"}, {"uri": "a.bin"}, {"uri": "../c"}], "extras": {"uri": "c"}}
        self.assertEqual(file_names(json.dumps(document).encode()), {"a.bin": False, "b.png": True})
        for text in (b"", b"[]", b"{", b"[" * 100000, b"\xff", b"glTF" + bytes(20)):
            with self.assertRaises(errors.InvalidError, msg=text[:9]):
                file_names(text)
        mesh = bytes(mesh_glb([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]))
        self.assertEqual(file_names(mesh), {})
        json_bytes, = struct.unpack_from("<I", mesh, 12)
        padded = mesh[20:20 + json_bytes].rstrip().ljust(json_bytes + 4, b"\0")   # not with spaces, as it should be
        self.assertEqual(file_names(struct.pack("<5I", *struct.unpack_from("<2I", mesh), len(mesh) + 4, len(padded),
                                                0x4E4F534A) + padded + mesh[20 + json_bytes:]), {})
        for cut in range(len(mesh)):
            with self.assertRaises(errors.InvalidError, msg=cut):
                file_names(mesh[:cut])

    def test_bad_meshes_are_refused(self):
        corners = np.zeros((3, 3))
        for vertices, faces in ((corners, [[0, 1, 3]]), (corners, [[0, 1, -1]]),
                                (corners, [[0, 1]]), (corners, np.zeros((0, 3), int)),
                                (corners[:, :2], [[0, 1, 2]]),
                                (corners, [[0., 1., 2.]]), (corners * np.nan, [[0, 1, 2]]),
                                (corners + 1e39, [[0, 1, 2]])):
            with self.assertRaises(errors.UsageError):
                mesh_glb(vertices, faces)


class Range:
    """As much of a chunk as Answered looks at."""

    def __init__(self, first, count):
        self.first, self.count = first, count


class RayForms(unittest.TestCase):
    def frame(self, *arguments, **options):
        rays = Rays(*arguments, **options)
        frame = rays.frame(0, rays.count)
        self.assertEqual((frame.dtype, frame.shape[1], frame.flags.c_contiguous),
                         (np.float32, rays.width, True))
        return frame

    def test_all_forms_travel_alike(self):
        for width in (6, 8):
            rows = np.arange(5 * width, dtype=np.float64).reshape(5, width)
            for rays in ((rows,), (rows.astype(np.float32),), (rows.astype(int),),
                         (rows.tolist(),), (np.asfortranarray(rows),), (rows.astype(">f4"),),
                         (np.repeat(rows, 2, 0)[::2],)):
                np.testing.assert_array_equal(self.frame(*rays), rows)
        np.testing.assert_array_equal(self.frame(rows[:, :3], rows[:, 4:7]),
                                      rows[:, [0, 1, 2, 4, 5, 6]])

    def test_ready_rays_are_not_copied(self):
        for width in (6, 8):
            rays = np.zeros((10, width), np.float32)
            self.assertTrue(np.shares_memory(Rays(rays).frame(3, 4), rays))
            self.assertFalse(np.shares_memory(Rays(rays, origin=[1, 2, 3]).frame(3, 4), rays))

    def test_an_origin_is_subtracted_before_digits_are_lost(self):
        far = np.array([[1e7 + 0.125, 5e6 + 0.25, -3e6 + 0.5, 0, 0, 1]])
        frame = self.frame(far, origin=[1e7, 5e6, -3e6])
        np.testing.assert_array_equal(frame[0, :3], [0.125, 0.25, 0.5])

    def test_one_origin_travels_once(self):
        ways = np.eye(3, dtype=np.float32)
        for directions in (ways, ways.tolist(), ways.astype(np.float64)):
            for shift, origin in ((None, [1, 2, 3]), ([1, 2, 2.5], [0, 0, 0.5])):
                rays = Rays([1, 2, 3], directions, shift)
                self.assertEqual((rays.count, rays.width, rays.common["origin"]), (3, 3, origin))
                np.testing.assert_array_equal(rays.frame(1, 2), ways[1:])
        self.assertTrue(np.shares_memory(Rays([1, 2, 3], ways, [1, 1, 1]).frame(1, 2), ways))
        self.assertEqual(Rays([1, 2, 3], [0, 0, 1]).frame(0, 1).tolist(), [[0, 0, 1]])
        self.assertEqual(Rays([1e300, 2, 3], ways).common["origin"][0], np.inf)
        self.assertEqual(Rays(ways, [0, 0, 1]).width, 6)
        self.assertEqual(Rays([1], ways).frame(0, 1).tolist(), [[1, 1, 1, 1, 0, 0]])

    def test_a_range_travels_once(self):
        self.assertEqual(Rays(np.zeros((2, 6)), tmin=1, tmax=2).common, {"tmin": 1, "tmax": 2})
        self.assertEqual(Rays(np.zeros((2, 6))).common, {"tmin": 0, "tmax": 0})
        self.assertEqual(Rays(np.zeros((2, 8))).common, {})

    def test_segments_leave_their_ends_out(self):
        ends = [[2, 0, 0], [0, 4, 0]]
        for start, origin in (([1, 0, 0], None), ([2, 0, 0], [1, 0, 0])):
            rays = Segments(start, ends, 0.25, None, origin).rays
            self.assertEqual(rays.common, {"tmin": 0.25, "tmax": 0.75, "origin": [1, 0, 0]})
            np.testing.assert_array_equal(rays.frame(0, 2), np.subtract(ends, start))
        rays = Segments([start] * 2, ends, 0.25, None, origin).rays
        self.assertEqual(rays.common, {"tmin": 0.25, "tmax": 0.75})
        np.testing.assert_array_equal(rays.frame(0, 2), [[1, 0, 0, 0, 0, 0], [1, 0, 0, -2, 4, 0]])

    def test_what_is_no_ray_is_refused(self):
        for rays in ((np.zeros((4, 7)),), (np.zeros(7),), (np.zeros((2, 3)), np.zeros((3, 3))),
                     (np.zeros((2, 2)), np.zeros((2, 2))), (["a"],), (np.zeros((1, 6), complex),)):
            with self.assertRaises(errors.UsageError):
                Rays(*rays)
        with self.assertRaises(errors.UsageError):
            Rays(np.zeros((1, 6)), origin=[1, 2])


if __name__ == "__main__":
    Schema.flatc = sys.argv[3]
    unittest.main(argv=sys.argv[:1])
