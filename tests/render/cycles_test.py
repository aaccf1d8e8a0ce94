#!/usr/bin/env python3
"""Scenes of the shared set look as Blender's Cycles draws them: blocks with surfaces differ by less than 2 %.
A room with bumpy walls and a net and a pane in its opening (room.py) has more noise: the median of its blocks'
signed differences is below 2 %.

  cycles_test.py RAYNESTD RAYNEST
"""
import json
import os
import pathlib
import shutil
import struct
import subprocess
import sys
import tempfile

import room

HERE = pathlib.Path(__file__).resolve().parent
SCENES = (HERE / "../../../shared/scenes").resolve()
SKIPPED = 77
SKY = ("--env", str(SCENES / "light/spiaggia_di_mondello_1k.hdr"))
BOX_VIEW = "--lookat=-278,273,800,-278,273,-280"
VIEWS = (
    ("light/CornellBox.glb", "--size", "64x64", "--spp", "1024", BOX_VIEW),
    ("light/FlightHelmet/FlightHelmet.gltf", "--size", "96x128", "--spp", "1024", "--lookat=0.35,0.4,1,0,0.33,0", *SKY),
    ("temple.glb", "--size", "128x80", "--spp", "512", "--camera", "overview", *SKY),
    ("cocoa_temple.glb", "--size", "128x80", "--spp", "1024", "--camera", "track0", *SKY),
)


def glass_boxes(folder):
    """The boxes of CornellBox.glb as smooth glass, alone, below a sky with edges."""
    data = (SCENES / "light/CornellBox.glb").read_bytes()
    size, = struct.unpack_from("<I", data, 12)
    scene, rest = json.loads(data[20:20 + size]), data[20 + size:]
    for node in scene["nodes"]:
        if "box" not in node["name"] or node["name"].startswith("cornell"):
            del node["mesh"]
    scene["extensionsUsed"] += ["KHR_materials_transmission", "KHR_materials_volume"]
    scene["materials"][1].update(doubleSided=False, extensions={
        "KHR_materials_transmission": {"transmissionFactor": 1}, "KHR_materials_volume": {"thicknessFactor": 1}},
        pbrMetallicRoughness={"metallicFactor": 0, "roughnessFactor": 0})
    text = json.dumps(scene).encode()
    text += b" " * (-len(text) % 4)
    file = folder / "glass.glb"
    file.write_bytes(data[:8] + struct.pack("<I", 20 + len(text) + len(rest)) + struct.pack("<I", len(text)) +
                     b"JSON" + text + rest)
    sky = folder / "sky.hdr"
    rows = b"".join(bytes((40 + 6 * (31 - y), 40 + 2 * x, 60 + 150 * ((x // 8 + y // 8) % 2), 129))
                    for y in range(32) for x in range(64))
    sky.write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 32 +X 64\n" + rows)
    return file, "--size", "128x128", "--spp", "128", BOX_VIEW, "--env", str(sky)


def skip(why):
    print("skipped:", why)
    sys.exit(SKIPPED)


def main():
    if "RAYNEST_LONG" not in os.environ:
        skip("a minute of two cores per scene; run with --long")
    if shutil.which("blender") is None:
        skip("Blender is not installed: apt-get install --no-install-recommends blender")
    if not SCENES.exists():
        skip(f"no {SCENES}")
    failed = False
    with tempfile.TemporaryDirectory(prefix="raynest-cycles-") as folder:
        out = pathlib.Path(folder)
        inside, sky = room.write(out)
        indoors = (inside, "--size", "96x64", "--spp", "1024", *room.VIEW, "--env", str(sky))
        for scene, *view in (*VIEWS, glass_boxes(out), indoors):
            done = subprocess.run([sys.executable, HERE / "cycles_compare.py", *sys.argv[1:3], SCENES / scene,
                                   "--out", out, *view], capture_output=True, text=True, check=False)
            if done.returncode != 0:
                sys.exit(f"{scene}: {done.stderr}")
            print(done.stdout, end="", flush=True)
            told = json.loads(done.stdout)
            if not abs(told["surface_bias" if scene == inside else "surface_mean"]) < 0.02:
                print(f"{scene}: blocks with surfaces differ by 2 % or more")
                failed = True
    sys.exit(failed)


if __name__ == "__main__":
    main()
