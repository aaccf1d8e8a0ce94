#!/usr/bin/env python3
"""Compares path-traced pictures with Blender's Cycles, which this project did not write.

  cycles_compare.py RAYNESTD RAYNEST SCENE --out DIR --size 256x256 --spp 256 (--camera NAME | --lookat ...)
      [--env FILE [--env-rotate DEG]]

Both sides get the same camera, lights, surroundings and depth. Prints one JSON line: differences of
8x8 blocks, all and those with surfaces (`surface_`; `surface_bias` is the median with its sign, which noise
leaves alone), and CPU seconds. Writes ours.png, cycles.png and
difference.png: red where ours is brighter, blue where it is darker, full colour at 10 %. With
--noise both render again with another seed: `noise` is the mean relative variance of a pixel on
surfaces, `equal_noise` our CPU seconds over those of Cycles for equal noise.
"""
import argparse
import json
import pathlib
import re
import struct
import subprocess
import sys
import zlib

import numpy

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent / "integration"))
from daemon import Client, Daemon  # noqa: E402
from exr import LINES_OF_A_BLOCK, read_header  # noqa: E402

BLOCK = 8
SCRIPT = pathlib.Path(__file__).resolve().parent / "cycles_scene.py"


def without_twins(path, folder):
    """A copy of a .glb in which triangles that cover others exactly are gone. A ray that leaves such a
    leaf starts beyond both here, but Cycles lets it meet the other one: its grass is 12 % darker."""
    data = bytearray(path.read_bytes())
    if data[:4] != b"glTF":
        return path
    size, = struct.unpack_from("<I", data, 12)
    scene, first = json.loads(data[20:20 + size]), 28 + size

    def values(accessor, kinds, width):
        entry = scene["accessors"][accessor]
        view = scene["bufferViews"][entry["bufferView"]]
        kind = numpy.dtype(kinds[entry["componentType"]])
        if view.get("byteStride", kind.itemsize * width) != kind.itemsize * width:
            raise ValueError("interleaved vertices are not read")
        at = first + view.get("byteOffset", 0) + entry.get("byteOffset", 0)
        return numpy.frombuffer(data, kind, entry["count"] * width, at).reshape(-1, width)
    for mesh in scene["meshes"]:
        for part in mesh["primitives"]:
            positions = values(part["attributes"]["POSITION"], {5126: "<f4"}, 3).round(4)
            corners = values(part["indices"], {5121: "u1", 5123: "<u2", 5125: "<u4"}, 1).reshape(-1, 3)
            seen = set()
            for triangle in corners:
                place = tuple(sorted(map(tuple, positions[triangle].tolist())))
                if place in seen:
                    triangle[1:] = triangle[0]
                seen.add(place)
    copy = folder / path.name
    copy.write_bytes(data)
    return copy


def read_colours(path, channels="RGB"):
    """Three channels of an EXR as an array (height, width, 3)."""
    data = path.read_bytes()
    attributes, at = read_header(data)
    left, top, right, bottom = struct.unpack("<4i", attributes["dataWindow"][1])
    width, height = right - left + 1, bottom - top + 1
    names, rest = [], attributes["channels"][1]
    while rest[0]:
        name, rest = rest.split(b"\0", 1)
        names.append(name.decode())
        rest = rest[16:]
    lines = LINES_OF_A_BLOCK[attributes["compression"][1][0]]
    picture = numpy.empty((height, width, 3), numpy.float32)
    for offset in struct.unpack_from(f"<{-(-height // lines)}Q", data, at):
        first, packed = struct.unpack_from("<iI", data, offset)
        rows = min(lines, bottom + 1 - first)
        size = rows * width * 4 * len(names)
        block = numpy.frombuffer(data, numpy.uint8, packed, offset + 8)
        if packed != size:
            deltas = numpy.frombuffer(zlib.decompress(block), numpy.uint8).astype(numpy.int64)
            deltas[1:] -= 128
            halves = numpy.cumsum(deltas).astype(numpy.uint8)
            block = numpy.empty(size, numpy.uint8)
            block[0::2], block[1::2] = halves[:(size + 1) // 2], halves[(size + 1) // 2:]
        planes = block.view("<f4").reshape(rows, len(names), width)
        for channel, name in enumerate(channels):
            picture[first - top:first - top + rows, :, channel] = planes[:, names.index(name)]
    return picture


def write_png(path, colours):
    """Writes sRGB values in [0, 1]."""
    pixels = (numpy.clip(colours, 0, 1) * 255 + 0.5).astype(numpy.uint8)
    height, width, _ = pixels.shape
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">2I5B", width, height, 8, 2, 0, 0, 0)) +
                     chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


def shown(picture, scale):
    linear = picture * scale
    return numpy.where(linear <= 0.0031308, 12.92 * linear, 1.055 * numpy.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


def blocks(picture):
    height, width = (side // BLOCK * BLOCK for side in picture.shape[:2])
    cut = picture[:height, :width].reshape(height // BLOCK, BLOCK, width // BLOCK, BLOCK, 3)
    return cut.mean(axis=(1, 3))


def differences(ours, theirs):
    """The relative difference of each block: over its three channels, of their sum."""
    a, b = blocks(ours), blocks(theirs)
    total = b.sum(axis=2)
    # A black block has no scale of its own.
    total = numpy.maximum(total, 0.01 * total.mean())
    return numpy.abs(a - b).sum(axis=2) / total, (a - b).sum(axis=2) / total




def noise(one, other):
    """The mean relative variance of a pixel: half of the squared difference of two seeds."""
    mean = (one + other).sum(axis=2) / 2
    half = (one - other).sum(axis=2) ** 2 / 2
    return float(numpy.mean(half / numpy.maximum(mean, 0.05 * mean.mean()) ** 2))


def render_cycles(options, view, out, seed=1):
    command = ["blender", "-b", "--factory-startup", "--python-exit-code", "1", "--python", str(SCRIPT), "--",
               str(options.scene), str(out), "--spp", str(options.cycles_spp or options.spp),
               "--seed", str(seed), *view]
    if options.env:
        command += ["--env", str(options.env), "--env-rotate", str(options.env_rotate)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    told = re.findall(r'^\{"cpu_seconds".*\}$', done.stdout, re.M)
    if done.returncode != 0 or not told:
        raise RuntimeError("Blender failed:\n" + done.stdout[-2000:] + done.stderr[-2000:])
    return json.loads(told[-1])["cpu_seconds"]


def cpu_seconds(pid):
    fields = pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / 100


def render_ours(options, view, out, seed=1):
    daemon = Daemon(options.raynestd, "--log-level", "warn")
    light = ["--env", options.env, "--env-rotate", options.env_rotate] if options.env else ["--env", "none"]
    try:
        client = Client(options.raynest, daemon.uri)
        client.json("load", options.scene, "--name", "scene")
        before = cpu_seconds(daemon.process.pid)
        done = client.run("render", "scene", "--integrator", "path", "--intersector", "alpha_blend", "-o", out,
                          "--seed", seed, "--spp", options.spp, *light, *view, timeout=3600)
        if done.returncode != 0:
            raise RuntimeError(done.stderr)
        return cpu_seconds(daemon.process.pid) - before
    finally:
        daemon.stop()


def compare(options):
    options.out.mkdir(parents=True, exist_ok=True)
    options.scene = without_twins(pathlib.Path(options.scene), options.out)
    view = ["--size", options.size, "--depth", str(options.depth)]
    if options.camera:
        view += ["--camera", options.camera]
    else:
        view += ["--lookat=" + options.lookat, "--fov", str(options.fov)]
    ours_at, theirs_at = options.out / "ours.exr", options.out / "cycles.exr"
    our_seconds = render_ours(options, view, ours_at)
    their_seconds = render_cycles(options, view, theirs_at)
    ours, theirs = read_colours(ours_at), read_colours(theirs_at)
    size, signed = differences(ours, theirs)
    told = {}
    if options.noise:
        render_ours(options, view, options.out / "ours2.exr", 2)
        render_cycles(options, view, options.out / "cycles2.exr", 2)
        told["noise"] = noise(ours, read_colours(options.out / "ours2.exr"))
        told["cycles_noise"] = noise(theirs, read_colours(options.out / "cycles2.exr"))
        told["equal_noise"] = told["noise"] * our_seconds / (told["cycles_noise"] * their_seconds)
    depth = read_colours(ours_at, "ZZZ")[..., :1].repeat(3, 2)
    is_solid = blocks(depth < 1e9)[..., 0] > 0.5
    solid = size[is_solid]
    scale = 0.5 / max(float(numpy.median(theirs[theirs > 0])), 1e-9)
    write_png(options.out / "ours.png", shown(ours, scale))
    write_png(options.out / "cycles.png", shown(theirs, scale))
    part = numpy.clip(signed / 0.1, -1, 1)
    heat = numpy.stack([1 + numpy.minimum(part, 0), 1 - numpy.abs(part), 1 - numpy.maximum(part, 0)], axis=2)
    write_png(options.out / "difference.png", heat.repeat(BLOCK, 0).repeat(BLOCK, 1))
    return {"scene": pathlib.Path(options.scene).name, "blocks": size.size,
            "mean": round(float(size.mean()), 5), "median": round(float(numpy.median(size)), 5),
            "p95": round(float(numpy.percentile(size, 95)), 5), "worst": round(float(size.max()), 4),
            "surface_mean": round(float(solid.mean()), 5), "surface_median": round(float(numpy.median(solid)), 5),
            "surface_bias": round(float(numpy.median(signed[is_solid])), 5),
            "bias": round(float(ours.mean() / theirs.mean() - 1), 5),
            "cpu_seconds": round(our_seconds, 2), "cycles_cpu_seconds": their_seconds,
            **{name: round(value, 5) for name, value in told.items()}}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("raynestd")
    parser.add_argument("raynest")
    parser.add_argument("scene")
    parser.add_argument("--out", type=pathlib.Path, required=True)
    parser.add_argument("--size", default="256x256")
    parser.add_argument("--spp", type=int, default=256)
    parser.add_argument("--cycles-spp", type=int, default=0, help="the same without it")
    parser.add_argument("--depth", type=int, default=32)
    parser.add_argument("--camera")
    parser.add_argument("--lookat")
    parser.add_argument("--fov", type=float, default=40)
    parser.add_argument("--env")
    parser.add_argument("--env-rotate", type=float, default=0)
    parser.add_argument("--noise", action="store_true")
    options = parser.parse_args()
    print(json.dumps(compare(options)))


if __name__ == "__main__":
    main()
