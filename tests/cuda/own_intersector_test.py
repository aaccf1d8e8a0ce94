#!/usr/bin/env python3
"""Checks that a new intersector is one header and one row with CUDA, too: in a copy of engine/,
nvcc compiles the one of engine/INTERSECTORS.md, which runs on the CPU because of its outputs, and a
section in the form that a GPU needs.

  own_intersector_test.py SOURCE_DIR CMAKE HAS_CUDA(0|1) [CMAKE_OPTION...]

Exit code 77 (skipped) if the build has no CUDA.
"""
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

SOURCE, CMAKE, OPTIONS = pathlib.Path(), "", []
ARCHITECTURE = "90-real"  # one is enough: the host pass of nvcc reads the definitions

SECTION = """
#pragma once
#include <tuple>

#include "engine/intersectors/interface.h"

namespace raynest {

struct Section {
    static constexpr const char* text = "removes what lies above a horizontal plane";
    struct Params {
        float height = 0;
    };
    static constexpr auto params = std::tuple{param("height", &Params::height, -1e6F, 1e6F, "of the plane")};

    RAYNEST_FN Section(const SceneView& /*scene*/, const Params& values) : height(values.height) {}

    RAYNEST_FN auto operator()(const auto& ray, const BoxLike auto& boxes) {
        auto spans = intersect(ray, boxes);
        if (ray.world->direction.y > 0) {
            spans.keep_if([&](const EnteredBox& box) { return ray.world_at(box.near).y <= height; });
        }
        return spans;
    }
    RAYNEST_FN auto operator()(const auto& ray, const PrimitiveLike auto& primitive) {
        auto hits = intersect(ray, primitive);
        hits.keep_if([&](const Surface& hit) { return ray.world_at(hit.t).y <= height; });
        return hits;
    }
    RAYNEST_FN bool operator()(const auto& /*ray*/, const InstanceLike auto& /*instance*/) { return true; }

    float height;
};

}  // namespace raynest
"""


def start(*command):
    return subprocess.run([str(word) for word in command], capture_output=True, text=True, timeout=300, check=False)


class OwnIntersector(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        folder = pathlib.Path(cls.enterClassContext(tempfile.TemporaryDirectory(prefix="raynest own ")))  # a space on purpose
        cls.tree, cls.build = folder / "tree", folder / "build"
        cls.tree.mkdir()
        for entry in ("CMakeLists.txt", ".ci", "protocol", "server", "client"):
            (cls.tree / entry).symlink_to(SOURCE / entry)
        shutil.copytree(SOURCE / "engine", cls.tree / "engine")
        cls.folder = cls.tree / "engine/intersectors"
        page = (SOURCE / "engine/INTERSECTORS.md").read_text()
        header, row = (re.search(rf"^`{name}`\n```\w*\n(.*?)^```", page, re.M | re.S)[1]
                       for name in (r"clip_plane\.h", r"intersectors\.def"))
        (cls.folder / "clip_plane.h").write_text(header)
        (cls.folder / "section.h").write_text(SECTION)
        cls.list = (cls.folder / "intersectors.def").read_text() + row
        cls.configured = cls.configure("boxes, primitives, instances")

    @classmethod
    def configure(cls, overrides):
        (cls.folder / "intersectors.def").write_text(f"{cls.list}RAYNEST_INTERSECTOR(section, Section, {overrides})\n")
        return start(CMAKE, "-G", "Ninja", "-S", cls.tree, "-B", cls.build, "-DRAYNEST_CUDA=ON", *OPTIONS,
                     f"-DRAYNEST_CUDA_ARCHITECTURES={ARCHITECTURE}", "-DRAYNEST_WERROR=ON", "-DRAYNEST_TESTS=OFF",
                     "-DRAYNEST_BENCH=OFF")

    def compile(self, name):
        return start(CMAKE, "--build", self.build, "--target", f"pack_cuda_{name}")

    def kernels(self, name):
        """Returns the kernels of an object, by the names of the host functions that start them."""
        compiled = self.compile(name)
        self.assertEqual(compiled.returncode, 0, compiled.stdout[-3000:])
        [object_file] = self.build.rglob(f"pack_cuda_{name}.dir/*.o")
        return set(re.findall(r" t \S*trace_kernel\S*QueryE(\d)", start("nm", object_file).stdout))

    def test_all_overrides_of_a_row_reach_nvcc(self):
        self.assertEqual(self.configured.returncode, 0, self.configured.stderr)
        self.assertEqual(self.kernels("section"), {"0", "1", "2"})

    def test_the_page_s_own_is_compiled_and_has_no_kernels(self):
        self.assertEqual(self.kernels("clip_plane"), set())

    def test_what_the_row_leaves_out_is_a_readable_error(self):
        self.configure("primitives, instances")
        compiled = self.compile("section")
        self.assertNotEqual(compiled.returncode, 0)
        self.assertRegex(compiled.stdout, "the row and the type disagree about .boxes. on CUDA")


if __name__ == "__main__":
    SOURCE, CMAKE, has_cuda, *OPTIONS = pathlib.Path(sys.argv[1]), *sys.argv[2:]
    if has_cuda == "0":
        print("skipped: this build has no CUDA")
        sys.exit(77)
    unittest.main(argv=sys.argv[:1], verbosity=2)
