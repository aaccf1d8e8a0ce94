"""A connection to a daemon, with the requests that concern the daemon rather than one scene."""
from __future__ import annotations

import contextlib
import os
import time
from types import TracebackType
from typing import Any, Mapping, Optional, Sequence, Union


from . import _limits
from ._net.access import find_access
from ._net.address import DEFAULT_URI
from ._net.control import Message
from ._net.hosts import forget_host
from ._net.reconnect import seconds_of
from ._requests.arguments import Masks, milliseconds, none_is_default
from ._requests.job import Progress
from ._requests.loads import Load, load_of_file, load_of_mesh, load_of_parts
from ._requests.materials import Material
from ._requests.precision import rounding_warning
from ._requests.upload import Sender
from ._requests.words import check_listed, rows_of, scene_info, variant_info
from ._session import Session
from .errors import ProtocolError, SceneWarning, warn
from .job import Job, job_infos
from .scene import Scene


@none_is_default
def connect(uri: Optional[str] = None, *, token: Optional[str] = None, ca: Optional[str] = None,
            cert: Optional[str] = None, key: Optional[str] = None, verify: bool = True,
            window_bytes: int = _limits.window_bytes,
            reconnect: Optional[float] = None) -> Client:
    """Connects to the daemon at tls://HOST:PORT, tcp://HOST:PORT, unix:PATH or ssh://HOST, by default at
    RAYNEST_SERVER, else at tcp://127.0.0.1:31060. ssh:// uses your own ssh, and /run/raynest/socket on
    that machine. The daemon sends at most `window_bytes` before the client reads; 0 is the default.

    `token` is by default RAYNEST_TOKEN, else the one that `raynest login` keeps for this daemon; do
    not write it into programs. `ca` is the file of the CA to trust with tls://, by default RAYNEST_CA,
    else the system's store; `cert` and `key` are files of a client certificate. `verify=False`
    accepts any certificate, and warns.

    If the daemon goes away, as in a restart, the client looks for it for `reconnect` seconds, by
    default RAYNEST_RECONNECT or 10, and repeats what is safe to repeat: traces, pictures, lists and
    loads, not streams and detached jobs. 0 raises at once. Without --state scenes do not survive a
    restart; then you get InvalidError with the name SCENE_UNKNOWN.
    """
    if not isinstance(uri, (str, type(None))):
        raise TypeError(f"uri of {uri!r}: it must be a text, as 'tcp://127.0.0.1:31060' or "
                        "'unix:PATH'")
    uri = uri or os.environ.get("RAYNEST_SERVER") or DEFAULT_URI
    access = find_access(uri, token, ca, cert, key, verify)
    return Client(uri, access, window_bytes or _limits.window_bytes, seconds_of(reconnect))


def logout(uri: Optional[str] = None) -> bool:
    """Removes what `raynest login` kept of a daemon, token and certificates: by default of RAYNEST_SERVER,
    else of tcp://127.0.0.1:31060. Returns False if nothing was kept. The token itself stays valid until the
    daemon's administrator revokes it."""
    return forget_host(uri or os.environ.get("RAYNEST_SERVER") or DEFAULT_URI)


class Client(Session):
    """A connection, which runs one request at a time. Threads take turns; while a stream is open, all other
    calls raise UsageError. For concurrent requests, open several. As a context manager it closes itself."""

    def __enter__(self) -> Client:
        return self

    def __exit__(self, kind: Optional[type[BaseException]], error: Optional[BaseException],
                 traceback: Optional[TracebackType]) -> None:
        self.close()

    def __repr__(self) -> str:
        state = "closed" if self.connection.closed else self.connection.daemon.name
        return f"<raynest.Client {self.uri} ({state})>"

    # ---- scenes ---------------------------------------------------------------------------------

    @none_is_default
    def load(self, source: Union[str, os.PathLike[str]], name: Optional[str] = None, *,
             origin: Any = None, replace: bool = False, build: str = "medium", primitive: str = "",
             instances: Union[str, os.PathLike[str]] = "", masks: Masks = (),
             unit: Union[str, float] = 1, up: str = "y", radius: float = 0, spacing: float = 0,
             variant: str = "", share: Union[str, Sequence[str]] = (), progress: Progress = None) -> Scene:
        """Uploads a .glb, .gltf, .obj or .rnscene.json with the files that it names; a .ply, .stl, .off,
        .las or .tif; a .npz of the arrays vertices and faces; or a .npy of `primitive` records or
        "heights", with `instances` a .npy of matrices that place the records. Or it loads
        "builtin:forest?trees=9" or "root:PATH", which the daemon has. A file may also come from a pipe, or
        with "-" from stdin; it then needs a `name`.

        The scene is called `name`, by default the file's stem. If other content has that name, the
        load fails unless `replace`, which begins a new epoch. `build` is "fast", "medium" or
        "high": a slower build gives trees that trace faster.

        float32 loses small details far from zero. `origin`, three float64 near the scene, is
        subtracted before they are lost. It stays with the scene; rays, cameras and positions are in
        the world for every client. A SceneWarning says when an origin would help.

        `up="z"` says that +Z points up in a file. Coordinates stay as they are; the default camera, the
        sky and its sun follow it.

        These are for formats without a unit, which are all but glTF, compositions and records: `unit` is
        "mm", "cm", "m", "in", "ft" or a number of metres. `radius` makes spheres of the points of a .ply or
        .las, and `spacing` is the distance between the heights of a grid, both in the file's unit. Rows of
        a grid go along z and columns along x, with up="z" along -y and x. With `origin="auto"` the daemon
        chooses an origin. `variant` is one of a glTF file's KHR_materials_variants, which
        `info["variants"]` lists.

        The client first sends the files' SHA-256. If the daemon has a scene of the same content that you
        may see, it publishes that scene under the new name, and nothing else is sent.

        `masks` sets what trace(mask=) sees: {"stand-*": 0x1} gives placements whose path matches,
        or lies below a match, this mask instead of 0xFFFFFFFF. "*" stands for any text. If several
        patterns match, from a dict or a list of pairs, the last one wins.

        A scene is its owner's alone. `share` is "public", a list of the principals that may use it
        too, or their names joined by commas, with "\\," for a comma in a name.
        """
        load = load_of_file(source, name, origin=origin, replace=replace, build=build, primitive=primitive,
                            instances=instances, masks=masks, unit=unit, up=up, radius=radius, spacing=spacing,
                            variant=variant, share=share)
        scene = self._load(load, progress)[0]
        scene.made = (source, {"origin": origin, "build": build, "primitive": primitive, "instances": instances,
                               "masks": masks, "unit": unit, "up": up, "radius": radius, "spacing": spacing,
                               "variant": variant})
        return scene

    @none_is_default
    def mesh(self, vertices: Any, faces: Any = None, name: Optional[str] = None, *,
             material: Optional[Material] = None, origin: Any = None,
             keep: bool = False, replace: bool = False, build: str = "medium", up: str = "y",
             progress: Progress = None) -> Scene:
        """Loads triangles: vertices (N, 3), faces (M, 3), with a raynest.Material. The column prim is a row of faces.

        float64 vertices become float32 after `origin` was subtracted, as in load(). A SceneWarning says
        when they lose digits that matter, or, if they are float32, have lost them before. Equal content is
        sent and built only once, as in load(), whose `up` it takes, too. Without a name each call makes a
        scene of its own, whose edits change no other. It goes with its Scene object (`with c.mesh(...) as s:`), or with the
        connection. A name keeps it in the daemon; so does `keep`, under a name that its content and `build`
        give it. The Scene refers to the arrays until it is closed, for raynest.dask.
        """
        load = load_of_mesh(vertices, faces, name, material=material, origin=origin, keep=keep, replace=replace, build=build,
                            up=up)
        scene, info = self._load(load, progress)
        scene.made = (vertices, faces), {"material": material, "origin": origin, "build": build, "up": up}
        lost = rounding_warning(vertices, faces, info)
        if lost:
            warn(lost, SceneWarning)
        return scene

    @none_is_default
    def scene_of(self, parts: Mapping[str, Any], places: Optional[Mapping[str, Any]] = None,
                 name: Optional[str] = None, *, origin: Any = None, keep: bool = False,
                 replace: bool = False, build: str = "medium", masks: Masks = (),
                 up: str = "y", progress: Progress = None) -> Scene:
        """Loads a scene made of parts, which Scene.edit() can move.

        `parts` are meshes by name: (vertices, faces), or an object that has both, such as a mesh of trimesh; or
        raynest.Mesh(vertices, faces, material=raynest.Material("steel", (0.6, 0.6, 0.6))); or
        raynest.Spheres(centres, radii), or raynest.Records(primitive, rows) of another type. A part that is a dict of
        places is a group, of any parts and of other groups: {"car": {"body": "body", "wheel": ("wheel", wheels)}}.

        `places` says where they stand, by names of their own: {"ground": "ground", "car": ("car", matrices)}. A place
        is the name of a part, alone or with an offset (3,) or a matrix (3, 4) or (4, 4); or with several of these,
        (N, 3), (N, 3, 4) or (N, 4, 4), whose paths are "car#0", "car#1", ... A group's places have paths below,
        "car#0/wheel#3"; one that holds a single part once is that part, and has none. raynest.Place("car", matrices, mask=, uid=, visible=) says more of
        each place. Without `places` each part that is in no group stands once where its vertices are.

        Places are the outermost instances, numbered in their order. Each part and each group is stored once, however
        often it is placed. `masks` by path are for meshes without groups, at places without mask= and uid=.
        Everything else is as in load() and mesh().
        """
        scene = self._load(load_of_parts(parts, places, name, origin=origin, keep=keep, replace=replace, build=build,
                                         masks=masks, up=up), progress)[0]
        scene.made = parts, {"places": places, "origin": origin, "build": build, "masks": masks, "up": up}
        return scene

    def _load(self, load: Load, progress: Progress = None) -> tuple[Scene, dict[str, Any]]:
        self.drop_unused()
        return self.connection.again(lambda: self._load_once(load, progress))

    def _load_once(self, load: Load, progress: Progress) -> tuple[Scene, dict[str, Any]]:
        """Warns of what the daemon warns of, but for lines with the words that the load hides."""
        message = load.message
        sender = Sender(self.connection, message["file_bytes"], load.read)
        frames = self.connection.exchange("Load", message, feed=sender.feed)
        loaded: Message = {}
        with self.connection.interrupts, contextlib.closing(frames):
            for kind, news in frames:
                if kind == "Need":
                    load.need(news["files"])
                    sender.need(news["files"])
                elif kind == "Loaded":
                    loaded = news
                elif progress and kind == "Progress":
                    progress(news["done"], news["total"], news["stage"])
                if progress and kind in ("Need", "Credit"):
                    progress(sender.sent, sender.total, "uploading")
        if not loaded.get("info"):
            raise ProtocolError("the daemon ended a load without its scene")
        info = scene_info(loaded["info"])
        if progress:
            progress(1, 1, "loaded")
        for text in info["warnings"]:
            if not load.hides or load.hides not in text:
                warn(text, SceneWarning)
        if None in (info["box_min"], info["box_max"]):
            warn(f"the scene {info['name']!r} is empty: nothing can be hit", SceneWarning)
        scene = Scene(self, info["name"], info)  # first: it keeps the name from drop_unused()
        self.handles.loaded(info["name"], bool(message.get("temporary")))
        return scene, info

    def scene(self, name: str) -> Scene:
        """Opens a loaded scene; InvalidError if there is none of that name. This connection then
        holds it: it works until the connection ends, even if others unload it."""
        info = scene_info(self.connection.ask("Info", {"scene": name, "hold": True}, "SceneInfo"))
        return Scene(self, info["name"], info)

    def scenes(self) -> list[dict[str, Any]]:
        """Lists the loaded scenes: name, hash, epoch, instanced_triangles, bytes, owner,
        age_seconds, idle_seconds (since a request last used it), holders (the open connections
        that loaded or opened it), share ("", "public" or principals joined by commas) and state
        (memory; pinned: it stays there; disk: the next request reads it; damaged: load it again)."""
        columns = {"name": "names", "hash": "hashes", "epoch": "epochs",
                   "instanced_triangles": "instanced_triangles", "bytes": "bytes",
                   "owner": "owners", "age_seconds": "age_ms", "idle_seconds": "idle_ms",
                   "holders": "holders", "share": "shares", "state": "states"}
        newer = list(columns).index("share")  # than some daemons
        scenes = [dict(zip(columns, row + late[1:])) for page in self.pages("Scenes", "SceneList", "names")
                  for row, late in zip(rows_of(page, *list(columns.values())[:newer]),
                                       rows_of(page, "names", "shares", "states", absent=""))]
        for scene in scenes:
            scene["age_seconds"] /= 1000
            scene["idle_seconds"] /= 1000
        return scenes

    @none_is_default
    def unload_all(self, *, idle: float = 0.0) -> list[str]:
        """Unloads all scenes of this owner, as Scene.unload() does, or those that were not used for
        `idle` seconds. Returns their names."""
        idle_ms = milliseconds(idle, "idle")
        message: Message = {"idle_ms": idle_ms} if idle_ms else {"all": True}
        names: list[str] = []
        while unloaded := self.connection.ask("Unload", message, "Unloaded")["names"]:
            names += unloaded  # a page of them
            check_listed(len(names))
            for name in unloaded:
                self.handles.unloaded(name)
        return names

    # ---- jobs -----------------------------------------------------------------------------------

    def job(self, number: int) -> Job:
        """Returns a detached job by its number; InvalidError if there is none."""
        job = Job(self, number)
        return Job(self, job.info["job"])

    def jobs(self) -> list[dict[str, Any]]:
        """Lists running jobs of all clients, and detached jobs whose answers are kept: job (its number),
        owner, kind, scene, state, done, total, age_seconds, left_seconds, bytes, ..."""
        return list(job_infos(self.connection))

    # ---- the daemon -----------------------------------------------------------------------------

    def variants(self) -> list[dict[str, Any]]:
        """Lists the intersectors: name, text, target, queries, params (with defaults) and outputs."""
        return [variant_info(variant) for page in self.pages("Variants", "VariantList", "variants")
                for variant in page["variants"]]

    def stats(self) -> dict[str, float]:
        """Returns the daemon's metrics."""
        message = self.connection.ask("Stats", {}, "Statistics")
        return dict(rows_of(message, "names", "values"))

    def ping(self) -> float:
        """Measures a round trip in seconds."""
        begin = time.perf_counter()
        self.connection.ask("Ping", {"payload": 1}, "Pong")
        return time.perf_counter() - begin
