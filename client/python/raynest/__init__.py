"""RayNest from Python: send rays to a raynestd, get numpy columns back.

    import numpy as np, raynest

    c = raynest.connect()                               # RAYNEST_SERVER, else tcp://127.0.0.1:31060
    s = c.load("builtin:forest")                        # or "scene.glb", or c.mesh(vertices, faces)
    hits = s.trace(np.array([[8, 50, -8, 0, -1, 0]]), fields=("t", "prim", "path"))
    print(hits["t"], s.path_of(hits["path"]))

See README.md in this package's folder. Errors are in raynest.errors.
"""
import sys

from . import compat, generators, points, returns, sweeps
from ._version import VERSION as __version__
from .client import Client, connect, logout
from .edits import Uids
from .errors import (BusyError, CancelledError, ConnectError, DeadlineError, Error, FailedError,
                     InvalidError, NotAllowedError, ProtocolError, RayWarning, SceneWarning,
                     UsageError)
from ._requests.film import Layers
from ._requests.materials import Material, Mesh
from ._requests.places import Place, Records, Spheres
from ._render import read_layers
from .images import Heatmap, Image
from .job import Job
from .scene import Scene

if sys.byteorder != "little":
    raise ImportError("raynest: columns travel as they lie in memory: little endian machines only")

__all__ = ["BusyError", "CancelledError", "Client", "ConnectError", "DeadlineError", "Error",
           "FailedError", "Heatmap", "Image", "InvalidError", "Job", "Layers", "Material", "Mesh", "NotAllowedError",
           "Place", "ProtocolError", "RayWarning", "Records", "Scene", "SceneWarning", "Spheres", "Uids", "UsageError", "compat",
           "connect", "generators", "logout", "points", "read_layers", "returns", "sweeps", "__version__"]
