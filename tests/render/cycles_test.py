#!/usr/bin/env python3
"""The scenes of the shared set look as Blender's Cycles draws them: blocks differ by less than 3 %.

  cycles_test.py RAYNESTD RAYNEST
"""
import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
SCENES = (HERE / "../../../shared/scenes").resolve()
SKIPPED = 77
SKY = ("--env", str(SCENES / "light/spiaggia_di_mondello_1k.hdr"))
VIEWS = (
    ("light/CornellBox.glb", "--size", "64x64", "--spp", "1024", "--lookat=-278,273,800,-278,273,-280"),
    ("light/FlightHelmet/FlightHelmet.gltf", "--size", "96x128", "--spp", "256", "--lookat=0.35,0.4,1,0,0.33,0", *SKY),
    ("temple.glb", "--size", "128x80", "--spp", "256", "--camera", "overview", *SKY),
)


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
    for scene, *view in VIEWS:
        with tempfile.TemporaryDirectory(prefix="raynest-cycles-") as out:
            done = subprocess.run([sys.executable, HERE / "cycles_compare.py", *sys.argv[1:3], SCENES / scene,
                                   "--out", out, *view], capture_output=True, text=True, check=False)
        if done.returncode != 0:
            sys.exit(f"{scene}: {done.stderr}")
        print(done.stdout, end="")
        if not json.loads(done.stdout)["mean"] < 0.03:
            print(f"{scene}: blocks differ by 3 % or more")
            failed = True
    sys.exit(failed)


if __name__ == "__main__":
    main()
