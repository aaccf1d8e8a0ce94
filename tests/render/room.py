"""Writes a room as glTF, lit through one opening by a picture of the sky with the sun in it.

  room.py FOLDER [--without PART]...

Each part is one of PARTS; what is left out is replaced by its plainest form. Prints the view for
`raynest render`: the camera stands at the back wall and looks along the room at the opening's wall.
"""
import argparse
import json
import math
import pathlib
import struct
import zlib

import numpy

PARTS = ("textures", "normal_maps", "mask", "blend", "smooth", "gloss", "sun")
WIDTH, HEIGHT, LENGTH = 6.0, 3.0, 9.0
VIEW = ("--lookat=0.6,1.5,8.6,-0.3,1.2,0", "--fov", "60")


def png(pixels):
    height, width, channels = pixels.shape
    rows = b"".join(b"\0" + row.tobytes() for row in pixels.astype(numpy.uint8))

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">2I5B", width, height, 8, {3: 2, 4: 6}[channels], 0, 0, 0)) +
            chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


def noise(random, side, cells):
    """Smooth noise in [0, 1] that repeats."""
    grid = random.random((cells, cells))
    at = numpy.arange(side) * cells / side
    low = at.astype(int)
    part = at - low
    part = part * part * (3 - 2 * part)
    rows = grid[low] * (1 - part)[:, None] + grid[(low + 1) % cells] * part[:, None]
    return rows[:, low] * (1 - part) + rows[:, (low + 1) % cells] * part


class Room:
    def __init__(self, folder, without):
        self.folder, self.parts = folder, set(PARTS) - set(without)
        self.binary = bytearray()
        self.random = numpy.random.default_rng(7)
        self.gltf = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}], "nodes": [], "meshes": [],
                     "materials": [], "textures": [], "images": [], "accessors": [], "bufferViews": [],
                     "samplers": [{"wrapS": 10497, "wrapT": 10497}]}

    def accessor(self, values, kind):
        data = numpy.ascontiguousarray(values, "<f4" if kind != "SCALAR" else "<u4")
        self.gltf["bufferViews"].append({"buffer": 0, "byteOffset": len(self.binary), "byteLength": data.nbytes})
        self.binary += data.tobytes()
        entry = {"bufferView": len(self.gltf["bufferViews"]) - 1, "type": kind, "count": len(data),
                 "componentType": 5125 if kind == "SCALAR" else 5126}
        if kind == "VEC3":
            entry |= {"min": data.min(axis=0).tolist(), "max": data.max(axis=0).tolist()}
        self.gltf["accessors"].append(entry)
        return len(self.gltf["accessors"]) - 1

    def texture(self, name, pixels):
        (self.folder / f"{name}.png").write_bytes(png(pixels))
        self.gltf["images"].append({"uri": f"{name}.png"})
        self.gltf["textures"].append({"source": len(self.gltf["images"]) - 1, "sampler": 0})
        return len(self.gltf["textures"]) - 1

    def material(self, name, colour, roughness=0.9, bumps=0.0, alpha=None):
        """A two-sided material; `bumps` is the depth of its normal map, `alpha` = (mode, factor)."""
        entry = {"name": name, "doubleSided": True,
                 "pbrMetallicRoughness": {"baseColorFactor": [*colour, 1], "metallicFactor": 0,
                                          "roughnessFactor": roughness if "gloss" in self.parts else 1}}
        pbr = entry["pbrMetallicRoughness"]
        side = 128
        if "textures" in self.parts and not alpha:
            grain = 0.45 + 0.55 * noise(self.random, side, 16)
            pbr["baseColorTexture"] = {"index": self.texture(f"{name}_colour", numpy.repeat(
                (255 * grain)[..., None], 3, axis=2))}
        if "normal_maps" in self.parts and bumps:
            height = noise(self.random, side, 16) * bumps
            dx, dy = (numpy.roll(height, -1, k) - numpy.roll(height, 1, k) for k in (1, 0))
            n = numpy.stack([-dx * side / 8, dy * side / 8, numpy.ones_like(dx)], axis=2)
            n /= numpy.linalg.norm(n, axis=2, keepdims=True)
            entry["normalTexture"] = {"index": self.texture(f"{name}_normal", numpy.round(127.5 * (n + 1)))}
        if alpha:
            mode, factor = alpha
            entry["alphaMode"] = mode
            pbr["baseColorFactor"][3] = factor
            if mode == "MASK":
                holes = numpy.full((64, 64, 4), 255)
                y, x = numpy.mgrid[:64, :64]
                holes[..., 3] = numpy.where(((x // 8 + y // 8) % 2) == 0, 255, 0)
                pbr["baseColorTexture"] = {"index": self.texture(f"{name}_holes", holes)}
        self.gltf["materials"].append(entry)
        return len(self.gltf["materials"]) - 1

    def mesh(self, name, material, positions, normals, texcoords, indices):
        primitive = {"material": material, "indices": self.accessor(numpy.ravel(indices), "SCALAR"), "attributes": {
            "POSITION": self.accessor(positions, "VEC3"), "NORMAL": self.accessor(normals, "VEC3"),
            "TEXCOORD_0": self.accessor(texcoords, "VEC2")}}
        self.gltf["meshes"].append({"name": name, "primitives": [primitive]})
        self.gltf["nodes"].append({"name": name, "mesh": len(self.gltf["meshes"]) - 1})
        self.gltf["scenes"][0]["nodes"].append(len(self.gltf["nodes"]) - 1)

    def quad(self, name, material, corner, across, up):
        corner, across, up = (numpy.array(v, float) for v in (corner, across, up))
        normal = numpy.cross(across, up) / numpy.linalg.norm(numpy.cross(across, up))
        size = numpy.linalg.norm(across), numpy.linalg.norm(up)
        self.mesh(name, material, [corner, corner + across, corner + across + up, corner + up], [normal] * 4,
                  [(0, size[1]), (size[0], size[1]), (size[0], 0), (0, 0)], [0, 1, 2, 0, 2, 3])

    def curved(self, name, material, points, normals, along, texture_length):
        """A strip of flat pieces through `points`, moved by `along`, with the normals of a round one if `smooth`."""
        points, normals, along = (numpy.array(v, float) for v in (points, normals, along))
        positions, shown, texcoords, indices = [], [], [], []
        for k in range(len(points) - 1):
            first = len(positions)
            a, b = points[k], points[k + 1]
            flat = numpy.cross(b - a, along)
            flat /= numpy.linalg.norm(flat)
            inside_out = numpy.dot(flat, normals[k]) < 0
            flat = -flat if inside_out else flat
            positions += [a, b, b + along, a + along]
            shown += [normals[k], normals[k + 1], normals[k + 1], normals[k]] if "smooth" in self.parts else [flat] * 4
            s = [texture_length * (k + j) / (len(points) - 1) for j in (0, 1)]
            length = numpy.linalg.norm(along)
            texcoords += [(s[0], length), (s[1], length), (s[1], 0), (s[0], 0)]
            corners = [first, first + 1, first + 2, first, first + 2, first + 3]
            indices += corners[::-1] if inside_out else corners
        self.mesh(name, material, positions, shown, texcoords, indices)

    def build(self):
        wall = self.material("wall", (0.8, 0.75, 0.7), bumps=0.2)
        floor = self.material("floor", (0.7, 0.55, 0.4), roughness=0.4, bumps=0.15)
        plaster = self.material("plaster", (0.85, 0.85, 0.82), bumps=0.15)
        w, h, length = WIDTH / 2, HEIGHT, LENGTH
        self.quad("floor", floor, (-w, 0, length), (WIDTH, 0, 0), (0, 0, -length))
        self.quad("left", wall, (-w, 0, length), (0, 0, -length), (0, h, 0))
        self.quad("right", wall, (w, 0, 0), (0, 0, length), (0, h, 0))
        self.quad("back", wall, (w, 0, length), (-WIDTH, 0, 0), (0, h + 1.5, 0))
        # The wall with the opening, in four pieces; the opening is 2.4 m wide, from 0.6 m to 2.4 m.
        a, low, high = 1.2, 0.6, 2.4
        self.quad("below", wall, (-w, 0, 0), (WIDTH, 0, 0), (0, low, 0))
        self.quad("above", wall, (-w, high, 0), (WIDTH, 0, 0), (0, h + 1.5 - high, 0))
        self.quad("beside_left", wall, (-w, low, 0), (w - a, 0, 0), (0, high - low, 0))
        self.quad("beside_right", wall, (a, low, 0), (w - a, 0, 0), (0, high - low, 0))
        # The walls are thick: no light comes from behind one.
        out, top = w + 0.25, h + 1.75
        shell = self.material("shell", (0.5, 0.5, 0.5))
        self.quad("under", shell, (-out, -0.25, 0), (2 * out, 0, 0), (0, 0, length + 0.25))
        self.quad("over", shell, (-out, top, length + 0.25), (2 * out, 0, 0), (0, 0, -length - 0.25))
        self.quad("outer_left", shell, (-out, -0.25, 0), (0, 0, length + 0.25), (0, top + 0.25, 0))
        self.quad("outer_right", shell, (out, -0.25, length + 0.25), (0, 0, -length - 0.25), (0, top + 0.25, 0))
        self.quad("outer_back", shell, (-out, -0.25, length + 0.25), (2 * out, 0, 0), (0, top + 0.25, 0))
        # A vault of six pieces, and a column of eight, both with round normals.
        angles = numpy.linspace(0, math.pi, 7)
        vault = [(w * math.cos(t), h + 1.2 * math.sin(t), 0) for t in angles]
        inward = [numpy.array([-1.2 * math.cos(t), -w * math.sin(t), 0]) for t in angles]
        self.curved("vault", plaster, vault, [n / numpy.linalg.norm(n) for n in inward], (0, 0, length), 7)
        angles = numpy.linspace(0, 2 * math.pi, 9)
        column = [(-1.5 + 0.4 * math.cos(t), 0, 3 + 0.4 * math.sin(t)) for t in angles]
        outward = [(math.cos(t), 0, math.sin(t)) for t in angles]
        self.curved("column", plaster, column, outward, (0, h + 1.2, 0), 3)
        if "mask" in self.parts:
            net = self.material("net", (0.7, 0.2, 0.2), alpha=("MASK", 1))
            self.quad("net", net, (-a, low, 0.15), (a, 0, 0), (0, high - low, 0))
        if "blend" in self.parts:
            pane = self.material("pane", (0.5, 0.7, 0.9), roughness=0.6, alpha=("BLEND", 0.3))
            self.quad("pane", pane, (0, low, 0.1), (a, 0, 0), (0, high - low, 0))
        self.gltf["buffers"] = [{"uri": "room.bin", "byteLength": len(self.binary)}]
        (self.folder / "room.bin").write_bytes(self.binary)
        (self.folder / "room.gltf").write_text(json.dumps({name: value for name, value in self.gltf.items() if value}))
        self.write_sky()
        return self.folder / "room.gltf", self.folder / "sky.hdr"

    def write_sky(self):
        """A blue gradient over dark ground, and a sun of four texels that outshines it through the opening."""
        height, width = 128, 256
        y, _ = numpy.mgrid[:height, :width]
        up = 1 - (y + 0.5) / (height / 2)
        sky = numpy.where((up > 0)[..., None], (0.5 + 0.5 * numpy.clip(up, 0, 1))[..., None] * numpy.array([0.5, 0.8, 1.4]),
                          numpy.array([0.15, 0.13, 0.1]))
        if "sun" in self.parts:
            # The middle of the picture lies at +X, a quarter to its left at -Z: 15 degrees beside it, 35 up.
            column, row = int(width * (0.25 + 15 / 360)), int(height * (90 - 35) / 180)
            sky[row:row + 2, column:column + 2] = 3000 * numpy.array([1, 0.9, 0.75])
        exponents = numpy.ceil(numpy.log2(sky.max(axis=2) * 1.0001))
        mantissas = (sky / 2.0 ** exponents[..., None] * 256).astype(numpy.uint8)
        texels = numpy.concatenate([mantissas, (exponents + 128).astype(numpy.uint8)[..., None]], axis=2)
        (self.folder / "sky.hdr").write_bytes(
            f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n".encode() + texels.tobytes())


def write(folder, without=()):
    """Returns the files of the scene and of its sky."""
    return Room(folder, without).build()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--without", action="append", default=[], choices=PARTS)
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    write(options.folder, options.without)
    print(*VIEW)


if __name__ == "__main__":
    main()
