"""Lists that client and daemon share. Written by .ci/lists.py from the .def files of the tree."""
from __future__ import annotations

from typing import Literal, Optional, TypedDict

Worker = Literal['auto', 'cuda', 'cpu']


class IntegratorSettings(TypedDict, total=False):
    """Keyword arguments of pictures that an integrator makes. None and 0 mean the default."""

    depth: Optional[int]
    ao_distance: Optional[float]


ERRORS: list[tuple[str, int]] = [
    ('BAD_FRAME', 1),
    ('UNSUPPORTED_VERSION', 3),
    ('UNKNOWN_TYPE', 1),
    ('LIMIT_EXCEEDED', 5),
    ('INVALID_FIELD', 2),
    ('INVALID_PARAM', 2),
    ('VARIANT_UNKNOWN', 5),
    ('SCENE_UNKNOWN', 5),
    ('SCENE_INVALID', 5),
    ('NAME_TAKEN', 1),
    ('QUOTA', 6),
    ('BUSY', 6),
    ('DEADLINE', 7),
    ('CANCELLED', 130),
    ('NOT_ALLOWED', 4),
    ('DRAINING', 6),
    ('SLOW_CONSUMER', 1),
    ('RESOURCE_EXHAUSTED', 6),
    ('UNSUPPORTED', 5),
    ('INTERNAL', 1),
    ('JOB_UNKNOWN', 5),
    ('NOT_FOUND', 5),
    ('FILE_UNUSABLE', 5),
]

OF_HITS: dict[str, tuple[str, int]] = {
    't': ('f32', 1),
    'prim': ('u32', 1),
    'geom': ('u32', 1),
    'path': ('u64', 1),
    'inst': ('u32', 1),
    'uid': ('u32', 1),
    'uv': ('f32', 2),
    'ng': ('f32', 3),
    'front': ('u8', 1),
    'position': ('f32', 3),
    'material': ('u32', 1),
    'object': ('u32', 1),
    'mask': ('u32', 1),
    'box_share': ('f32', 1),
    'tree_depth': ('u32', 1),
    'normal': ('f32', 3),
    'texcoord': ('f32', 2),
    'base_colour': ('f32', 3),
    'reflectance': ('f32', 1),
    'velocity': ('f32', 3),
    'radial_velocity': ('f32', 1),
    'sensor_position': ('f32', 3),
}

OF_RAYS: dict[str, tuple[str, int]] = {
    'hit': ('u8', 1),
    'flags': ('u8', 1),
    'origin': ('f32', 3),
    'direction': ('f32', 3),
    'nodes': ('u32', 1),
    'boxes': ('u32', 1),
    'leaves': ('u32', 1),
    'prims': ('u32', 1),
    'instances': ('u32', 1),
    'instance_misses': ('u32', 1),
    'rejects': ('u32', 1),
    'box_hits': ('u32', 1),
    'prim_hits': ('u32', 1),
    'total': ('u32', 1),
}

POINTS: list[str] = [
    'position',
    'origin',
]

TRUTHS: list[str] = [
    'hit',
    'front',
]

SHOWN: dict[str, list[str]] = {
    'hits': ['t', 'prim', 'geom', 'path', 'uv'],
    'any': ['hit'],
}

CSR: list[str] = [
    'multi',
    'all',
]

REDUCED: dict[str, dict[str, tuple[str, int]]] = {
    'hit_fraction': {'hit_fraction': ('f32', 1)},
    'visible_pixels': {'path': ('u64', 1), 'pixels': ('u32', 1)},
}

REDUCED_KIND: dict[str, str] = {
    'hit_fraction': 'any',
    'visible_pixels': 'closest',
}

REDUCED_TO_POINTS: list[str] = [
    'hit_fraction',
]

GENERATORS: dict[str, list[str]] = {
    'camera': ['size', 'camera', 'lookat', 'fov', 'range'],
    'pinhole': ['size', 'camera', 'lookat', 'pose', 'fx', 'fy', 'cx', 'cy', 'range'],
    'orthographic': ['size', 'camera', 'lookat', 'pose', 'window', 'range'],
    'equirectangular': ['size', 'camera', 'lookat', 'pose', 'range'],
    'lidar': ['elevations', 'azimuths', 'azimuth_offsets', 'origin_offsets', 'camera', 'lookat', 'pose', 'range'],
    'sweep': ['elevations', 'azimuths', 'azimuth_offsets', 'origin_offsets', 'channels', 'columns', 'trajectory', 'poses', 'scans', 'begin', 'end', 'step_error', 'range'],
    'rolling_shutter': ['size', 'fx', 'fy', 'cx', 'cy', 'trajectory', 'poses', 'begin', 'end', 'step_error', 'range'],
    'hemisphere': ['points', 'samples', 'seed', 'margin'],
}

ACTING: list[str] = [
    'Unload',
    'Edit',
    'Page',
    'CancelJob',
    'Restore',
    'Admin',
]

INTEGRATOR_SETTINGS: dict[str, tuple[Optional[int], str]] = {
    'depth': (1024, 'for path: most bounces of a path (8)'),
    'ao_distance': (None, 'for ao: distance within which surfaces hide the sky (a tenth of the scene)'),
}

WORDS: dict[str, tuple[str, str]] = {
    'CancelJob': ('raynest cancel', 'Job.cancel()'),
    'Edit': ('raynest edit', 'Scene.edit()'),
    'Export': ('raynest export', 'Scene.export()'),
    'Fetch': ('raynest fetch', 'Job.fetch()'),
    'Info': ('raynest info', 'Scene.info'),
    'Jobs': ('raynest jobs', 'Client.jobs()'),
    'Load': ('raynest load', 'Client.load()'),
    'Pin': ('raynest pin', 'Scene.pin()'),
    'Scenes': ('raynest scenes', 'Client.scenes()'),
    'Unload': ('raynest unload', 'Scene.unload()'),
    'Variants': ('raynest variants', 'Client.variants()'),
    'Wait': ('raynest wait', 'Job.wait()'),
    'animation': ('--animation', 'animation='),
    'camera': ('--camera', 'camera='),
    'count': ('--count', 'count='),
    'deadline_ms': ('--deadline', 'deadline='),
    'detach': ('--detach', 'detach='),
    'environment': ('--env', 'environment='),
    'environment_rotate': ('--env-rotate', 'environment_rotate='),
    'epoch': ('--epoch', 'epoch='),
    'exposure': ('--exposure', 'exposure='),
    'hide': ('--hide', 'hide='),
    'keep': ('--keep', 'keep=True'),
    'level': ('--level', 'level='),
    'look_at': ('--lookat', 'look_at='),
    'mask': ('--mask', 'mask='),
    'name': ('--name', 'name='),
    'noise': ('--noise', 'noise='),
    'only': ('--only', 'only='),
    'origin': ('--origin', 'origin='),
    'palette': ('--palette', 'palette='),
    'primitive': ('--primitive', 'primitive='),
    'progressive': ('--progressive', 'render_stream()'),
    'radius': ('--radius', 'radius='),
    'replace': ('--replace', 'replace=True'),
    'samples': ('--spp', 'spp='),
    'scale': ('--scale', 'scale='),
    'seed': ('--seed', 'seed='),
    'size': ('--size', 'size='),
    'skip_hidden_boxes': ('--skip-hidden-boxes', 'skip_hidden_boxes='),
    'spacing': ('--spacing', 'spacing='),
    'sun': ('--sun', 'sun='),
    'time': ('--time', 'time='),
    'tonemap': ('--tonemap', 'tonemap='),
    'top': ('--top', 'top='),
    'traversal': ('--traversal', 'traversal='),
    'unit': ('--unit', 'unit='),
    'up': ('--up', 'up='),
    'variant': ('--variant', 'variant='),
    'worker': ('--worker', 'worker='),
    'depth': ('--depth', 'depth='),
    'ao_distance': ('--ao-distance', 'ao_distance='),
}

OTHER_FILES: dict[str, str] = {
    '.xz': 'is packed; unpack it and load what comes out',
    '.gz': 'is packed; unpack it and load what comes out',
    '.bz2': 'is packed; unpack it and load what comes out',
    '.zst': 'is packed; unpack it and load what comes out',
    '.zip': 'is packed; unpack it and load what comes out',
    '.7z': 'is packed; unpack it and load what comes out',
    '.tar': 'is packed; unpack it and load what comes out',
    '.tgz': 'is packed; unpack it and load what comes out',
    '.laz': 'is compressed (LAZ): unpack it with laszip -i in.laz -o out.las',
    '.e57': 'holds points, and points have no surface to hit: save them as .ply or .las and load them with \n                    `radius`, or make a mesh of them',
    '.pcd': 'holds points, and points have no surface to hit: save them as .ply or .las and load them with \n                    `radius`, or make a mesh of them',
    '.xyz': 'holds points, and points have no surface to hit: save them as .ply or .las and load them with \n                    `radius`, or make a mesh of them',
    '.asc': 'is a raster of heights, which becomes a mesh by its grid: make a .tif of it with gdal_translate',
    '.epw': "is weather, which is no part of a scene: take the sun's directions from it and trace rays to them",
    '.exr': 'is a picture: render a scene with it as `environment`',
    '.hdr': 'is a picture: render a scene with it as `environment`',
    '.3ds': 'is a file of another program: export it from there as .glb, for example from Blender',
    '.abc': 'is a file of another program: export it from there as .glb, for example from Blender',
    '.blend': 'is a file of another program: export it from there as .glb, for example from Blender',
    '.dae': 'is a file of another program: export it from there as .glb, for example from Blender',
    '.fbx': 'is a file of another program: export it from there as .glb, for example from Blender',
    '.usd': 'is a file of another program: export it from there as .glb, for example from Blender',
    '.usda': 'is a file of another program: export it from there as .glb, for example from Blender',
    '.usdc': 'is a file of another program: export it from there as .glb, for example from Blender',
    '.usdz': 'is a file of another program: export it from there as .glb, for example from Blender',
}
