"""Classes of other libraries, on RayNest."""
from . import trimesh as trimesh
