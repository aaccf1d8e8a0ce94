#!/usr/bin/env python3
"""Materials of meshes from Python: parts and single meshes look as they say, in each form in which a scene travels; equal
materials are one; and bad ones are refused in one line.

  part_materials_test.py RAYNESTD RAYNEST FLATC
"""
import warnings

import numpy as np

import raynest
from raynest import Material, Mesh, Place, Spheres
from with_daemon import WithDaemon, main

SQUARE = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
FACES = np.array([[0, 1, 2], [0, 2, 3]])
RED, BLUE = Material("red", (0.5, 0, 0)), Material("blue", (0, 0.25, 1))
NONE = 2**32 - 1
BALL = {"ball": Spheres([[0, 0, 0]], 1)}
FIELDS = ("t", "material", "base_colour", "path")


def parts():
    """Made anew: two red ones of equal materials, a blue one, and one without."""
    return {"a": Mesh(SQUARE, FACES, material=RED), "b": Mesh(SQUARE * 0.5, FACES, Material("red", [0.5, 0, 0, 1])),
            "c": Mesh(SQUARE, FACES, BLUE), "d": (SQUARE, FACES)}


def row(names, width=3):
    return {name: (name, (width * number, 0, 0)) for number, name in enumerate(names)}


def with_groups():
    return {**parts(), "pair": {"left": ("a", (0, 0, 0)), "right": ("c", (0, 3, 0))}}, {**row("abcd"), "pair": ("pair", (0, 9, 0))}


FORMS = {"meshes": (parts(), row("abcd")), "spheres": ({**parts(), **BALL}, {**row("abcd"), "ball": ("ball", (0, 9, 0))}),
         "groups": with_groups(),
         "user ids": (parts(), {name: Place(*place, uid=7) for name, place in row("abcd").items()})}


def seen(scene, along=(0, 0, -1), field=None):
    starts = np.array([[0.3 + 3 * number, 0.2, 0.1] for number in range(4)]) - 9 * np.array(along)
    found = scene.trace(starts, np.tile(along, (4, 1)), fields=FIELDS)
    return found[field] if field else found


class PartMaterials(WithDaemon):
    def test_each_form_has_the_materials_of_its_parts(self):
        for form, (made, places) in FORMS.items():
            with self.subTest(form):
                scene = self.client.scene_of(made, places)
                self.assertEqual(scene.info["materials"], 2)
                self.assertEqual([material["name"] for material in scene.materials], ["red", "blue"])
                found = seen(scene)
                np.testing.assert_array_equal(found["material"], [0, 0, 1, NONE])
                np.testing.assert_array_equal(found["base_colour"], [[0.5, 0, 0], [0.5, 0, 0], [0, 0.25, 1], [1, 1, 1]])

    def test_reflectance_is_that_of_the_colour(self):
        for form, (made, places) in FORMS.items():
            with self.subTest(form):
                scene = self.client.scene_of(made, places)
                starts = np.array([[3.0 * number + 0.3, 0.2, 9, 0, 0, -1] for number in range(4)])
                sweep = raynest.sweeps.Sweep(starts, np.zeros(4, int), np.zeros(4), np.zeros((4, 3)))
                intensity = raynest.returns.measure(scene, sweep)["intensity"]
                self.assertEqual(len(intensity), 4)
                self.assertAlmostEqual(float(intensity[0]), float(intensity[1]), 6)
                self.assertLess(intensity[0], 0.5 * intensity[3])
                self.assertLess(intensity[2], intensity[3])

    def test_materials_that_came_with_parts_can_be_set(self):
        for form, (made, places) in FORMS.items():
            with self.subTest(form):
                scene = self.client.scene_of(made, places)
                with scene.edit() as edit:
                    edit.set_material("b", "blue").set_material(["c", "d"], "red")
                np.testing.assert_array_equal(seen(scene, field="material"), [0, 1, 0, 0])

    def test_equal_content_is_sent_once(self):
        for form in FORMS:
            with self.subTest(form):
                news = []
                scenes = [self.client.scene_of({**FORMS[form][0], **parts()}, FORMS[form][1], progress=lambda *told: news.append(told))
                          for _ in range(2)]
                self.assertEqual(*(scene.info["hash"] for scene in scenes))
                self.assertEqual(*(scene.name[:-9] for scene in scenes))
                scene = self.client.scene_of({**FORMS[form][0], **parts(), "a": Mesh(SQUARE, FACES, BLUE)}, FORMS[form][1])
                self.assertNotEqual(scene.info["hash"], scenes[0].info["hash"])
                # The second of two equal loads is answered by digest: it uploads nothing.
                news.clear()
                self.client.scene_of({**FORMS[form][0], **parts()}, FORMS[form][1], progress=lambda *told: news.append(told))
                self.assertNotIn("uploading", [told[2] for told in news])

    def test_a_mesh_takes_one(self):
        long = Material("Stahl \N{GREEK SMALL LETTER ALPHA} " + "x" * 3000, (0.5, 0.5, 0.25, 0.5), 1, 0.5, (0, 1, 0))
        for origin in (None, (5e6, 0, 0)):
            scene = self.client.mesh(SQUARE + np.array(origin or (0, 0, 0)), FACES, material=long, origin=origin)
            ray = np.array([[0.3, 0.2, 9, 0, 0, -1]])
            ray[:, 0] += origin[0] if origin else 0
            found = scene.trace(ray, fields=("t", "material", "base_colour"))
            self.assertEqual(found["t"], 9)
            np.testing.assert_array_equal(found["base_colour"], [[0.5, 0.5, 0.25]])
            self.assertEqual([(of["name"][:99], of["alpha_mode"]) for of in scene.materials], [(long.name[:99], "BLEND")])
        self.assertEqual(self.client.mesh(SQUARE, FACES).info["materials"], 0)

    def test_far_parts_with_another_axis_stay_in_place(self):
        """A mesh with a material is another kind of file, which has an axis and an origin of its own."""
        at = np.array([4e6, 5e6, 100.0])
        for form, (made, places) in FORMS.items():
            with self.subTest(form), warnings.catch_warnings():
                warnings.simplefilter("error")
                far = {name: Mesh(part.vertices.astype(float) + at, FACES, part.material) if isinstance(part, Mesh) else part
                       for name, part in made.items()}
                far["d"] = SQUARE.astype(float) + at, FACES
                if "ball" in far:
                    far["ball"] = Spheres([at], 1)
                scene = self.client.scene_of(far, places, origin=at, up="z")
                starts = np.array([[0.3 + 3 * number, 0.2, 9] for number in range(4)]) + at
                found = scene.trace(starts, np.tile((0, 0, -1.0), (4, 1)), fields=FIELDS)
                np.testing.assert_allclose(found["t"], 9, rtol=1e-6)
                np.testing.assert_array_equal(found["material"], [0, 0, 1, NONE])

    def test_light_comes_from_what_is_emissive(self):
        pictures = []
        for light in (0, 1):
            scene = self.client.mesh(SQUARE, FACES, material=Material("lamp", (0, 0, 0), emissive=(light, light, light)))
            pictures.append(scene.render(integrator="path", environment="none", spp=1, size=(8, 8))["rgba"][..., :3].max())
        self.assertEqual(pictures[0], 0)
        self.assertGreater(pictures[1], 0.5)


class BadMaterials(WithDaemon):
    def test_are_refused_in_one_line(self):
        clash = {"a": Mesh(SQUARE, FACES, RED), "b": Mesh(SQUARE, FACES, Material("red", (1, 0, 0)))}
        for make, why in (
                (lambda: Material("x", (1, 0)), r"base_colour has shape \(2,\): it must be 3 or 4 numbers"),
                (lambda: Material("x", 1), r"base_colour has shape \(\): it must be 3 or 4 numbers"),
                (lambda: Material("x", "red"), "base_colour must be numbers, not text"),
                (lambda: Material("x", (255, 0, 0)), r"base_colour of \(255, 0, 0\): its numbers must be from 0 to 1; divide"),
                (lambda: Material("x", (0, 0, np.nan)), "its numbers must be from 0 to 1"),
                (lambda: Material("x", (0, 0, -1e-60)), "its numbers must be from 0 to 1"),
                (lambda: Material("x", emissive=(1, 1, 1, 1)), r"emissive has shape \(4,\): it must be 3 numbers"),
                (lambda: Material("x", emissive=(2, 1, 1)), "emissive of .* from 0 to 1"),
                (lambda: Material("x", metallic=1.5), "metallic of 1.5: it must be from 0 to 1"),
                (lambda: Material("x", roughness=np.nan), "roughness of nan: it must be from 0 to 1"),
                (lambda: Material("x", roughness=[0, 1]), r"roughness of \[0, 1\]: it must be one number"),
                (lambda: Material(""), "'' is no name of a material"), (lambda: Material(7), "7 is no name of a material"),
                (lambda: Material("a\tb"), "is no name of a material: leave '.t' out, which is no visible character"),
                (lambda: Mesh(SQUARE, FACES, "red"), "material of 'red': it must be a raynest.Material"),
                (lambda: self.client.mesh(SQUARE, FACES, material=(1, 0, 0)), "it must be a raynest.Material"),
                (lambda: self.client.mesh(Mesh(SQUARE, FACES, RED)), "with material=mesh.material"),
                (lambda: self.client.scene_of(clash), "two different materials have the name 'red': give one of them another"),
                (lambda: self.client.scene_of({**clash, **BALL}), "two different materials have the name 'red'"),
                (lambda: self.client.scene_of({"a": Mesh(SQUARE, FACES + 9, RED)}), "the part 'a': faces go from 9")):
            with self.subTest(why), self.assertRaisesRegex((raynest.UsageError, TypeError), why) as caught:
                make()
            self.assertNotIn("\n", str(caught.exception))

    def test_what_is_the_same_in_float32_is_one_material(self):
        self.assertEqual(Material("x", (0.1, 0, 0)), Material("x", np.array([0.1, -0.0, 0, 1], np.float32)))
        self.assertEqual(len({Material("x"), Material("x", (1, 1, 1), 0, 1, (0, 0, 0)), Material("y")}), 2)


if __name__ == "__main__":
    main()
