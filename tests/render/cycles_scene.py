"""Renders a glTF file with Blender's Cycles, its materials replaced by nodes that equal RayNest's.

  blender -b --factory-startup --python-exit-code 1 --python cycles_scene.py -- \
      SCENE OUT.exr --size 256x256 --spp 64 (--camera NAME | --lookat ex,ey,ez,ax,ay,az --fov DEG) [--env FILE [--env-rotate DEG]]

Coordinates are the file's. The last line of the output says the CPU seconds of the render as JSON.
"""
import argparse
import json
import math
import re
import struct
import sys
import tempfile
import time
from pathlib import Path

import bpy
import numpy
from mathutils import Matrix, Vector

# Debian's importer of glTF uses a name that its numpy has dropped.
numpy.bool = bool

ANGLES, ROUGHNESSES, SAMPLES = 64, 32, 4096
# Cycles' metal has the Fresnel term of an index instead of Schlick's. Indices that may stand for it.
INDICES = numpy.linspace(1.15, 1.45, 16)


# ---- the file -------------------------------------------------------------------------------------

class File:
    """A glTF file's JSON, and its images as files that Blender can load."""

    def __init__(self, path):
        self.folder, data = path.parent, path.read_bytes()
        self.binary = b""
        if data[:4] == b"glTF":
            size, = struct.unpack_from("<I", data, 12)
            self.json, self.binary = json.loads(data[20:20 + size]), data[28 + size:]
        else:
            self.json = json.loads(data)
        self.scratch = tempfile.TemporaryDirectory()
        self.images = {}

    def image(self, texture, is_data):
        """The Blender image of a texture."""
        index = self.json["textures"][texture]["source"]
        if (index, is_data) in self.images:
            return self.images[index, is_data]
        entry = self.json["images"][index]
        if "uri" in entry:
            path = self.folder / entry["uri"]
        else:
            view = self.json["bufferViews"][entry["bufferView"]]
            first = view.get("byteOffset", 0)
            ending = "png" if entry["mimeType"].endswith("png") else "jpg"
            path = Path(self.scratch.name) / f"{index}.{ending}"
            path.write_bytes(self.binary[first:first + view["byteLength"]])
        image = bpy.data.images.load(str(path), check_existing=False)
        image.alpha_mode = "CHANNEL_PACKED"
        image.colorspace_settings.name = "Non-Color"
        if not is_data:
            image = linear_image(image)
        self.images[index, is_data] = image
        return image


def linear_image(image):
    """glTF decodes sRGB before it interpolates; Cycles would do so after, and darken fine detail."""
    width, height = image.size
    pixels = numpy.empty((height, width, 4), numpy.float32)
    image.pixels.foreach_get(pixels.ravel())
    colours = pixels[..., :3]
    pixels[..., :3] = numpy.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
    return picture(pixels)


# ---- albedo of GGX, as engine/shading/albedo_tables.cpp has it --------------------------------------

def albedo_rows():
    """(full, edge) of one bounce, by roughness and the square root of the cosine; and, by roughness, the index whose
    Fresnel term has the same mean over the hemisphere as Schlick's."""
    points = numpy.random.default_rng(1).random((2, SAMPLES))
    full, edge = numpy.empty((ROUGHNESSES, ANGLES)), numpy.empty((ROUGHNESSES, ANGLES))
    terms, index = numpy.empty((ANGLES, len(INDICES))), numpy.empty(ROUGHNESSES)
    cosines = (numpy.arange(ANGLES) / (ANGLES - 1)) ** 2
    solid = numpy.gradient(cosines ** 2)
    for row in range(ROUGHNESSES):
        alpha = max(row / (ROUGHNESSES - 1), 0.02) ** 2
        for column in range(ANGLES):
            z = max((column / (ANGLES - 1)) ** 2, 1e-4)
            o = numpy.array([math.sqrt(max(0, 1 - z * z)), 0, z])
            full[row, column], edge[row, column], terms[column] = one_bounce(o, alpha, points)
        index[row] = numpy.interp(solid @ edge[row], solid @ terms, INDICES)
    return full, edge, index


def smith(w_xy2, w_z, alpha):
    return 0.5 * (numpy.sqrt(1 + alpha * alpha * w_xy2 / (w_z * w_z)) - 1)


def one_bounce(o, alpha, points):
    s = numpy.array([alpha * o[0], 0, o[2]])
    s /= numpy.linalg.norm(s)
    angle = 2 * math.pi * points[0]
    z = (1 - points[1]) * (1 + s[2]) - s[2]
    radius = numpy.sqrt(numpy.maximum(0, 1 - z * z))
    h = numpy.stack([alpha * (radius * numpy.cos(angle) + s[0]), alpha * radius * numpy.sin(angle),
                     numpy.maximum(z + s[2], 1e-7)])
    h /= numpy.linalg.norm(h, axis=0)
    seen = o @ h
    i = 2 * seen * h - o[:, None]
    up = i[2] > 0
    ours = smith(o[0] ** 2, o[2], alpha)
    theirs = smith(i[0] ** 2 + i[1] ** 2, numpy.where(up, i[2], 1), alpha)
    weight = numpy.where(up, (1 + ours) / (1 + ours + theirs), 0)
    return (weight.mean(), (weight * numpy.clip(1 - seen, 0, 1) ** 5).mean(),
            [(weight * fresnel(numpy.clip(seen, 0, 1), index)).mean() for index in INDICES])


def fresnel(cosine, index):
    """From 0 where light falls straight down to 1 where it grazes."""
    inside = numpy.sqrt(1 - (1 - cosine ** 2) / index ** 2)
    s = (cosine - index * inside) / (cosine + index * inside)
    p = (index * cosine - inside) / (index * cosine + inside)
    least = reflectance(index)
    return ((s ** 2 + p ** 2) / 2 - least) / (1 - least)


def reflectance(index):
    return ((index - 1) / (index + 1)) ** 2


def tables(ior):
    """Two pictures for a varnish of this index: its albedo by direction and roughness, with m5 of the
    direction and what comes of further bounces; and, by roughness, what the diffuse base below it is multiplied by, with
    Blender's "specular" of the index that stands for Schlick's term."""
    full, edge, index = ROWS
    f0 = reflectance(ior)
    cosine = (numpy.arange(2048) + 0.5) / 2048
    at = numpy.sqrt(cosine) * (ANGLES - 1)

    def fine(table):
        return numpy.array([numpy.interp(at, numpy.arange(ANGLES), row) for row in table])
    full_mean = 2 * (fine(full) * cosine).mean(axis=1)[:, None]
    schlick = f0 + (1 - f0) / 21
    more = schlick ** 2 * full_mean / (1 - schlick * (1 - full_mean))
    further = more * (1 - full)
    albedo = f0 * (full - edge) + edge + further
    # 1 - albedo is close to a line over m5 = (1 - cosine)^5: then it is a sum of Lambert's base and of
    # Disney's at roughness 0, which is 1 - m5 / 2. Cycles drops negative weights: below roughness 0.33
    # Disney's stands alone, at most 2.4 % too dark where light falls straight down.
    grazing = (1 - cosine) ** 5
    values = fine(albedo)
    left = 1 - 2 * (values * cosine).mean(axis=1)
    shares = numpy.empty((ROUGHNESSES, 3))
    for row in range(ROUGHNESSES):
        slope, level = numpy.polyfit(grazing, values[row], 1, w=numpy.sqrt(cosine))
        shares[row] = (1 - level - 2 * slope) / left[row], 2 * slope / left[row], reflectance(index[row]) / 0.08
        if shares[row, 0] < 0:
            shares[row, :2] = 0, 42 / 41
    direction = (numpy.arange(ANGLES) / (ANGLES - 1)) ** 2
    by_direction = numpy.stack([albedo, numpy.broadcast_to(1 - (1 - direction) ** 5 / 2, albedo.shape), further], axis=2)
    return picture(by_direction), picture(shares[:, None, :].repeat(2, 1))


def picture(values):
    height, width, count = values.shape
    image = bpy.data.images.new("table", width, height, alpha=True, float_buffer=True, is_data=True)
    image.alpha_mode = "CHANNEL_PACKED"
    pixels = numpy.ones((height, width, 4), numpy.float32)
    pixels[..., :count] = values
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    image.pack()
    return image


# ---- materials --------------------------------------------------------------------------------------

class Graph:
    """Nodes of one material. Values are sockets or numbers."""

    def __init__(self, material):
        material.use_nodes = True
        self.nodes, self.links = material.node_tree.nodes, material.node_tree.links
        self.nodes.clear()

    def add(self, kind, inputs=(), **settings):
        node = self.nodes.new(kind)
        for name, value in settings.items():
            setattr(node, name, value)
        for key, value in dict(inputs).items():
            if isinstance(value, bpy.types.NodeSocket):
                self.links.new(value, node.inputs[key])
            else:
                node.inputs[key].default_value = value
        return node

    def math(self, operation, a, b=0.0, clamp=False):
        if not isinstance(a, bpy.types.NodeSocket) and not isinstance(b, bpy.types.NodeSocket):
            return {"ADD": a + b, "SUBTRACT": a - b, "MULTIPLY": a * b}[operation]
        return self.add("ShaderNodeMath", {0: a, 1: b}, operation=operation, use_clamp=clamp).outputs[0]

    def sum(self, a, b):
        return self.math("ADD", a, b)

    def less(self, a, b):
        return self.math("SUBTRACT", a, b)

    def product(self, a, b):
        return self.math("MULTIPLY", a, b)

    def colours(self, kind, a, b, share=1.0):
        return self.add("ShaderNodeMixRGB", {0: share, 1: a, 2: b}, blend_type=kind).outputs[0]

    def texture(self, image):
        return self.add("ShaderNodeTexImage", image=image, interpolation="Linear")

    def principled(self, base, metallic, specular, roughness, inputs, distribution="GGX"):
        return self.add("ShaderNodeBsdfPrincipled", {
            "Base Color": base, "Metallic": metallic, "Specular": specular, "Roughness": roughness, **inputs},
            distribution=distribution).outputs[0]

    def mix(self, share, first, second):
        return self.add("ShaderNodeMixShader", {0: share, 1: first, 2: second}).outputs[0]


def replace(material, entry, file):
    """Nodes that scatter as RayNest's `standard` does."""
    graph = Graph(material)
    pbr = entry.get("pbrMetallicRoughness", {})
    factor = pbr.get("baseColorFactor", [1, 1, 1, 1])
    base, alpha = tuple(factor[:3]) + (1,), factor[3]
    if "baseColorTexture" in pbr:
        node = graph.texture(file.image(pbr["baseColorTexture"]["index"], False))
        base = graph.colours("MULTIPLY", node.outputs[0], base)
        alpha = graph.product(node.outputs[1], alpha)
    roughness, metallic = pbr.get("roughnessFactor", 1), pbr.get("metallicFactor", 1)
    if "metallicRoughnessTexture" in pbr:
        node = graph.texture(file.image(pbr["metallicRoughnessTexture"]["index"], True))
        parts = graph.add("ShaderNodeSeparateRGB", {0: node.outputs[0]})
        roughness, metallic = graph.product(parts.outputs[1], roughness), graph.product(parts.outputs[2], metallic)
    roughness_factor = roughness
    roughness = graph.add("ShaderNodeClamp", {0: roughness, 1: 0.02, 2: 1}).outputs[0]
    geometry = graph.add("ShaderNodeNewGeometry")
    normal = geometry.outputs["Normal"]
    if "normalTexture" in entry:
        node = graph.texture(file.image(entry["normalTexture"]["index"], True))
        normal = graph.add("ShaderNodeNormalMap", {"Color": node.outputs[0],
                                                   "Strength": entry["normalTexture"].get("scale", 1)}).outputs[0]

    # The entries of the tables for this direction and roughness.
    ior = entry.get("extensions", {}).get("KHR_materials_ior", {}).get("ior", 1.5)
    by_direction, by_roughness = tables(ior)
    cosine = graph.add("ShaderNodeVectorMath", {0: normal, 1: geometry.outputs["Incoming"]}, operation="DOT_PRODUCT")
    cosine = graph.math("MAXIMUM", cosine.outputs["Value"], 0.0)
    across = graph.sum(graph.product(graph.math("POWER", cosine, 0.5, True), (ANGLES - 1) / ANGLES), 0.5 / ANGLES)
    down = graph.sum(graph.product(roughness, (ROUGHNESSES - 1) / ROUGHNESSES), 0.5 / ROUGHNESSES)
    place = graph.add("ShaderNodeCombineXYZ", {0: across, 1: down}).outputs[0]

    def entries(table):
        node = graph.add("ShaderNodeTexImage", {0: place}, image=table, extension="EXTEND")
        return graph.add("ShaderNodeSeparateRGB", {0: node.outputs[0]}).outputs
    albedo, disney, further = entries(by_direction)
    lambert_share, disney_share, schlick = entries(by_roughness)

    # The base gets what the varnish lets through, both ways.
    through = graph.less(1.0, albedo)
    common = {"Normal": normal}
    lambert = graph.add("ShaderNodeBsdfDiffuse", {
        "Color": graph.colours("MULTIPLY", base, graph.product(through, lambert_share)), "Roughness": 0, **common})
    bent = graph.math("DIVIDE", graph.product(through, disney_share), disney)
    other = graph.principled(graph.colours("MULTIPLY", base, bent), 0.0, 0.0, 0.0, common)
    f0 = reflectance(ior)
    # MULTI_GGX gains 1.5 % in a sum with other nodes. On a dark base the further bounces count.
    varnish = graph.principled((f0, f0, f0, 1), 1.0, schlick, roughness, common)
    bounces = graph.add("ShaderNodeBsdfDiffuse", {"Color": further, "Roughness": 0, **common}).outputs[0]
    varnish = graph.add("ShaderNodeAddShader", {0: varnish, 1: bounces}).outputs[0]
    surface = graph.add("ShaderNodeAddShader", {0: lambert.outputs[0], 1: other}).outputs[0]
    surface = graph.add("ShaderNodeAddShader", {0: surface, 1: varnish}).outputs[0]
    if isinstance(metallic, bpy.types.NodeSocket) or metallic > 0:
        surface = graph.mix(metallic, surface, graph.principled(base, 1.0, schlick, roughness, common, "MULTI_GGX"))
    glossy = {"Roughness": roughness, **common}
    extensions = entry.get("extensions", {})
    clear = extensions.get("KHR_materials_transmission", {}).get("transmissionFactor", 0)
    if clear > 0:
        # MULTI_GGX drops what smooth glass reflects outside: 0.95 of a white sky is left. GGX drops the further
        # bounces of rough glass.
        is_smooth = not isinstance(roughness_factor, bpy.types.NodeSocket) and roughness_factor < 0.1
        glass = graph.add("ShaderNodeBsdfGlass", {"Color": base, "IOR": ior, **glossy},
                          distribution="GGX" if is_smooth else "MULTI_GGX")
        surface = graph.mix(clear, surface, glass.outputs[0])
    emission = entry.get("emissiveFactor", [0, 0, 0])
    if any(emission):
        strength = extensions.get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1)
        shine = graph.add("ShaderNodeEmission", {"Color": tuple(emission) + (1,), "Strength": strength}).outputs[0]
        surface = graph.add("ShaderNodeAddShader", {0: surface, 1: shine}).outputs[0]
    mode = entry.get("alphaMode", "OPAQUE")
    if mode != "OPAQUE":
        if mode == "MASK":
            alpha = graph.less(1.0, graph.math("LESS_THAN", alpha, entry.get("alphaCutoff", 0.5)))
        clear = graph.add("ShaderNodeBsdfTransparent", {"Color": (1, 1, 1, 1)}).outputs[0]
        surface = graph.mix(alpha, clear, surface)
    graph.add("ShaderNodeOutputMaterial", {"Surface": surface})


def replace_all(file):
    entries = {}
    for index, entry in enumerate(file.json.get("materials", [])):
        entries.setdefault(entry.get("name", f"Material_{index}")[:63], entry)
    for material in list(bpy.data.materials):
        name = material.name if material.name in entries else re.sub(r"\.\d{3}$", "", material.name)
        replace(material, entries[name], file)


# ---- camera, surroundings, settings -------------------------------------------------------------------

def to_blender(v):
    return Vector((v[0], -v[2], v[1]))


def set_camera(scene, options, width, height):
    if options.camera:
        camera = bpy.data.objects[options.camera]
        entry = next(node for node in FILE.json["nodes"] if node.get("name") == options.camera)
        fov = FILE.json["cameras"][entry["camera"]]["perspective"]["yfov"]
    else:
        numbers = [float(x) for x in options.lookat.split(",")]
        eye, at = to_blender(numbers[:3]), to_blender(numbers[3:6])
        camera = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
        scene.collection.objects.link(camera)
        back = (eye - at).normalized()
        right = Vector((0, 0, 1)).cross(back).normalized()
        up = back.cross(right)
        camera.matrix_world = Matrix((right, up, back)).transposed().to_4x4()
        camera.matrix_world.translation = eye
        fov = math.radians(options.fov)
    camera.data.sensor_fit = "VERTICAL"
    camera.data.angle = fov
    camera.data.clip_start, camera.data.clip_end = 1e-3, 1e6
    scene.camera = camera
    scene.render.resolution_x, scene.render.resolution_y = width, height
    scene.render.resolution_percentage = 100


def set_world(scene, path, rotate):
    scene.world = bpy.data.worlds.new("world")
    scene.world.use_nodes = True
    nodes, links = scene.world.node_tree.nodes, scene.world.node_tree.links
    background = next(node for node in nodes if node.type == "BACKGROUND")
    background.inputs[0].default_value = (0, 0, 0, 1)
    if not path:
        return
    picture = nodes.new("ShaderNodeTexEnvironment")
    picture.image = bpy.data.images.load(path)
    # The middle of the picture lies at +X, in the file as here: only --env-rotate turns it. The file's -Z is +Y here.
    turn, place = nodes.new("ShaderNodeMapping"), nodes.new("ShaderNodeTexCoord")
    turn.inputs["Rotation"].default_value = (0, 0, math.radians(rotate))
    links.new(place.outputs["Generated"], turn.inputs["Vector"])
    links.new(turn.outputs["Vector"], picture.inputs["Vector"])
    links.new(picture.outputs[0], background.inputs[0])


def set_cycles(scene, options):
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    render.threads_mode, render.threads = "FIXED", options.threads
    cycles.device, cycles.samples, cycles.seed = "CPU", options.spp, options.seed
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0
    cycles.blur_glossy = cycles.light_sampling_threshold = 0
    cycles.caustics_reflective = cycles.caustics_refractive = True
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = options.depth - 1
    cycles.transmission_bounces = options.depth - 1
    cycles.transparent_max_bounces = 256
    cycles.pixel_filter_type = "BOX"
    cycles.use_auto_tile = False
    settings = render.image_settings
    settings.file_format, settings.color_depth, settings.exr_codec = "OPEN_EXR", "32", "ZIP"
    settings.color_mode = "RGBA"
    render.filepath = str(Path(options.out).resolve())
    render.use_file_extension = False


def parse_options():
    parser = argparse.ArgumentParser()
    parser.add_argument("scene")
    parser.add_argument("out")
    parser.add_argument("--size", default="256x256")
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--depth", type=int, default=32)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--camera")
    parser.add_argument("--lookat")
    parser.add_argument("--fov", type=float, default=40)
    parser.add_argument("--env")
    parser.add_argument("--env-rotate", type=float, default=0)
    return parser.parse_args(sys.argv[sys.argv.index("--") + 1:])


OPTIONS = parse_options()
ROWS = albedo_rows()
FILE = File(Path(OPTIONS.scene).resolve())
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.import_scene.gltf(filepath=OPTIONS.scene, import_shading="NORMALS")
SCENE = bpy.context.scene
set_camera(SCENE, OPTIONS, *(int(x) for x in OPTIONS.size.split("x")))
set_world(SCENE, OPTIONS.env and str(Path(OPTIONS.env).resolve()), OPTIONS.env_rotate)
set_cycles(SCENE, OPTIONS)
replace_all(FILE)
BEGUN = time.process_time()
bpy.ops.render.render(write_still=True)
print(json.dumps({"cpu_seconds": round(time.process_time() - BEGUN, 3)}))
