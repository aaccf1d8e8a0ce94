"""Checks that mistakes of a pack's author do not compile, and that the error says what to write.

usage: mistakes_test.py SOURCE_DIR COMPILER
"""

import pathlib
import subprocess
import sys
import tempfile
import unittest

SOURCE, COMPILER = pathlib.Path(sys.argv[1]), sys.argv[2]
FLAGS = ["-std=c++20", "-fsyntax-only", "-march=x86-64-v2", "-DHWY_DISABLE_PCLMUL_AES", "-DHWY_COMPILE_ONLY_STATIC"]

DISC = """
#pragma once
#include "engine/intersectors/interface.h"
namespace raynest {
struct Disc { Vec3 center; float radius; Vec3 axis; };
inline Box bounds(const Disc& disc) { return {disc.center - disc.radius, disc.center + disc.radius}; }
template <class R>
auto intersect(const R& ray, const Disc& disc) {
    auto hits = no_hits<2>(disc);
    add_hit(hits, 0, glm::dot(disc.center - ray.origin, disc.axis), 0, 0, true);
    add_hit(hits, 1, 2, 0, 0, false);
    return hits;
}
NORMAL
}  // namespace raynest
"""

INTERSECTOR = """
#include "engine/intersectors/check.h"
#include "engine/intersectors/interface.h"
#include <tuple>
namespace raynest {
struct Mine {
    static constexpr const char* text = "";
    MEMBERS
    auto operator()(const auto& ray, const PrimitiveLike auto& primitive) { return intersect(ray, primitive); }
};
static_assert(check_intersector<Mine, Declared{.primitives = true}>());
}  // namespace raynest
"""
OUTPUTS = """struct Outputs { std::uint32_t seen = 0; };
    static constexpr auto outputs = std::tuple{output("seen", &Outputs::seen, "")};"""


class Mistakes(unittest.TestCase):
    def setUp(self):
        self.folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory(prefix="raynest mistakes ")))

    def compiled(self, name, text, *flags):
        """Compiles a file, or if `text` is None one of the tree; returns the errors."""
        path = SOURCE / name
        if text is not None:
            path = self.folder / name
            path.write_text(text)
        done = subprocess.run([COMPILER, *FLAGS, f"-I{SOURCE}", *flags, str(path)], capture_output=True, text=True,
                              timeout=600)
        self.assertEqual(done.returncode == 0, "error:" not in done.stderr, done.stderr[-3000:])
        return done.stderr if done.returncode != 0 else ""

    def table_of(self, disc):
        """Compiles a pack's table with one primitive more."""
        (self.folder / "disc.h").write_text(disc)
        (self.folder / "types.h").write_text(
            f'#include "{self.folder}/disc.h"\n#define RAYNEST_FOR_EACH_RECORD_TYPE(X) X(disc, Disc)\n')
        (self.folder / "variants.inc").write_text("RAYNEST_VARIANT(raynest_variant_none)\n")
        return self.compiled("engine/packs/pack.cpp", None, '-DRAYNEST_TARGET_NAME="v2"', "-DRAYNEST_CPU_TEST=true",
                             f'-DRAYNEST_RECORD_TYPES="{self.folder}/types.h"',
                             f'-DRAYNEST_VARIANT_LIST="{self.folder}/variants.inc"')

    def test_a_normal_with_other_arguments_or_another_result(self):
        good = "inline Vec3 normal(const Disc& disc, const Vec3& point) { return disc.axis + 0.0F * point; }"
        self.assertEqual(self.table_of(DISC.replace("NORMAL", good)), "")
        self.assertEqual(self.table_of(DISC.replace("NORMAL", "")), "")
        for bad in ("inline Vec3 normal(const Disc& disc) { return disc.axis; }",
                    "inline float normal(const Disc&, const Vec3&) { return 1; }",
                    "inline Vec3 normal(const Vec3&, const Disc& disc) { return disc.axis; }",
                    "inline Vec3 normal(Disc& disc, const Vec3&) { return disc.axis; }"):
            told = self.table_of(DISC.replace("NORMAL", bad))
            self.assertIn("normal() of a primitive is Vec3 normal(const P& primitive, const Vec3& point)", told)

    def test_a_hit_beyond_those_of_no_hits(self):
        call = "\ntemplate auto raynest::intersect(const raynest::RayView&, const raynest::Disc&);\n"
        disc = DISC.replace("NORMAL", "") + call
        self.assertEqual(self.compiled("good.cpp", disc), "")
        for old, new in (("no_hits<2>", "no_hits<1>"), ("hits, 1,", "hits, 2,"), ("hits, 0,", "hits, -1,")):
            self.assertIn("the hit's number, from 0 to below the N of no_hits<N>()",
                          self.compiled("bad.cpp", disc.replace(old, new)))
        for count in ("0", "40"):
            self.assertIn("a primitive reports 1 to 32 hits",
                          self.compiled("bad.cpp", disc.replace("no_hits<2>", f"no_hits<{count}>")))

    def test_outputs_without_state(self):
        state = "\n    Outputs* state = nullptr;"
        self.assertEqual(self.compiled("good.cpp", INTERSECTOR.replace("MEMBERS", OUTPUTS + state)), "")
        for members in (OUTPUTS, "struct Outputs { std::uint32_t seen = 0; };" + state):
            self.assertIn("an intersector with `outputs` has `Outputs* state = nullptr;`",
                          self.compiled("bad.cpp", INTERSECTOR.replace("MEMBERS", members)))

    def test_outputs_of_an_overload_that_names_its_triangles(self):
        text = INTERSECTOR.replace("MEMBERS", OUTPUTS + """
    Outputs* state = nullptr;
    auto operator()(const auto& ray, const Triangles8& triangles) { return intersect(ray, triangles); }
    auto operator()(const auto& ray, const TriangleRef& triangle) { return intersect(ray, triangle); }""")
        self.assertIn("sees each triangle once", self.compiled("bad.cpp", text))


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1], verbosity=2)
