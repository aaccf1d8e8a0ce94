"""Pictures as arrays: what render() and heatmap() return. They show themselves in Jupyter."""
from __future__ import annotations

import base64
import html
import struct
import zlib
from typing import TYPE_CHECKING, Any, Callable, Optional

import numpy as np

from ._net.frame import Array
from .errors import Error, UsageError

if TYPE_CHECKING:
    NDArray = np.ndarray[Any, Any]
else:
    NDArray = np.ndarray


class _Pixels(NDArray):
    """An array whose sums, comparisons and so on are plain arrays and numbers again."""

    def __array_wrap__(self, array: Array, _context: Any = None, _scalar: bool = False) -> Any:
        return array[()] if array.ndim == 0 else np.asarray(array)


class Image(_Pixels):
    """A picture: (height, width, 4) of u8, sRGB and straight alpha, row 0 on top. Otherwise a numpy
    array."""

    def png(self) -> bytes:
        """The bytes of a PNG file of the picture."""
        if self.ndim != 3 or self.shape[2] != 4 or self.dtype != np.uint8 or 0 in self.shape:
            raise UsageError("png() is of a whole picture, (height, width, 4) of u8")
        return _encode_png(np.asarray(self))

    def _repr_png_(self) -> Optional[bytes]:
        return self.png() if self.ndim == 3 and self.shape[2] == 4 and self.size else None


class Heatmap(_Pixels):
    """The cost of the ray of each pixel: (height, width) of u32, for a difference i32. Otherwise a numpy
    array. Slices of it are plain counts: they have no png(), top() or explain()."""

    _view: Optional[HeatView]

    def __array_finalize__(self, other: Any) -> None:
        self._view = None

    @property
    def counts(self) -> Array:
        """The counts as a plain array."""
        return np.asarray(self)

    @property
    def outcome(self) -> dict[str, Any]:
        """The outcome: scene, epoch, intersector, camera, rays, ..., and `heat`, the statistics."""
        return self._whole().outcome

    def png(self, **options: Any) -> bytes:
        """The bytes of a PNG file with a legend. `options` may be palette, scale and range, as in
        Scene.heatmap(), by default those that it was called with. The daemon traces the view again."""
        return self._whole().png(options)

    def top(self, count: int = 10, *, level: int = 0) -> dict[str, Any]:
        """Ranks what the rays of this view spend their work on: Scene.blame()."""
        view = self._whole()
        answer: dict[str, Any] = view.ask("blame", top=count, level=level)
        return answer

    def explain(self, x: int, y: int, *, steps: int = 0) -> dict[str, Any]:
        """Returns how the ray of pixel (x, y) finds its hit, step by step: Scene.explain()."""
        answer: dict[str, Any] = self._whole().ask("explain", pixel=(x, y), steps=steps)
        return answer

    def _whole(self) -> HeatView:
        if self._view is None:
            raise UsageError("this is an array of counts, without the view that they are of: ask the "
                             "array that heatmap() returned")
        return self._view

    def _repr_png_(self) -> Optional[bytes]:
        try:
            return None if self._view is None else self._view.png({})
        except Error:  # the daemon is gone, or the scene: the counts are shown as numbers
            return None

    def _repr_html_(self) -> Optional[str]:
        png = self._repr_png_()
        if self._view is None or png is None:
            return None
        outcome = self._view.outcome
        heat = outcome["heat"]
        numbers = ", ".join(f"{name} {heat[name]:.6g}" for name in ("min", "mean", "p50", "p90", "p99", "max"))
        words = (f"{outcome['scene']} epoch {outcome['epoch']}, {outcome['intersector']}, camera "
                 f"{outcome['camera']}: {heat['metric']} per ray, {numbers}")
        return (f'<figure style="margin:0"><img alt="heat map" style="max-width:100%" '
                f'src="data:image/png;base64,{base64.b64encode(png).decode()}">'
                f"<figcaption>{html.escape(words)}</figcaption></figure>")


class HeatView:
    """The view that a heat map is of: asks about the same rays of the same epoch. `ask` calls a
    method of the scene with the view's arguments and some more."""

    def __init__(self, outcome: dict[str, Any], ask: Callable[..., Any],
                 colours: dict[str, Any]) -> None:
        self.outcome = outcome
        self.ask = ask
        self._colours = colours
        self._pngs: dict[str, bytes] = {}

    def png(self, options: dict[str, Any]) -> bytes:
        unknown = options.keys() - {"palette", "scale", "range"}
        if unknown:
            raise TypeError(f"png() has no option {', '.join(sorted(unknown))}; there are palette, "
                            "scale, range")
        colours = {**self._colours, **options}
        key = repr(sorted(colours.items(), key=lambda item: item[0]))
        if key not in self._pngs:
            self._pngs[key] = self.ask("heatmap", encode="png", **colours)
        return self._pngs[key]


def with_view(counts: Array, view: Optional[HeatView]) -> Heatmap:
    heatmap: Heatmap = counts.view(Heatmap)
    heatmap._view = view
    return heatmap


def _encode_png(rgba: Array) -> bytes:
    height, width = rgba.shape[:2]
    # Every row begins with its filter: 0 is none.
    rows = np.zeros((height, 1 + 4 * width), np.uint8)
    rows[:, 1:] = rgba.reshape(height, 4 * width)

    def block(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    return (b"\x89PNG\r\n\x1a\n" + block(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)) +
            block(b"IDAT", zlib.compress(rows.tobytes(), 6)) + block(b"IEND", b""))
