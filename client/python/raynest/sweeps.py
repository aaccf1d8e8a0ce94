"""Sweeps of a sensor in motion: the rays of each column of a lidar start where the sensor is at the column's time.

    times, poses = ...                              # (K,), (K, 3, 4): from the sensor's space to the world
    sweep = raynest.sweeps.lidar(np.linspace(-25, 15, 64), (0, 360, 1800), begin=0.0, end=0.1,
                                 trajectory=(times, poses))
    seen = s.trace(sweep.rays, fields=("t", "position", "hit"))
    raynest.points.save("sweep.ply", seen["position"], where=seen["hit"], ring=sweep.ring, time=sweep.time)
"""
from __future__ import annotations

import reprlib
from typing import Any, NamedTuple, Optional

import numpy as np

from . import _limits
from ._net.frame import Array
from ._requests.arguments import count_of, none_is_default, numbers, real
from .errors import UsageError

# Columns of a pose may be off unit length and right angles by so much.
_RIGID = 1e-4


class Sweep(NamedTuple):
    """Ray c * columns + j is channel c at column j, as for generators.lidar()."""

    rays: Array  # (N, 6): origins and unit directions, float64
    ring: Array  # (N,): the channel, uint16
    time: Array  # (N,): of the column, float64
    velocity: Array  # (N, 3): of the sensor, in the world, per unit of the trajectory's time, float64

    def where(self, chosen: Any) -> Sweep:
        """The rays that a mask (N,) or an array of indices chooses."""
        return Sweep(*(column[chosen] for column in self))


@none_is_default
def lidar(elevations: Any, azimuths: Any = (0.0, 360.0, 2048), *, begin: float = 0.0, end: float = 0.1,
          trajectory: Any) -> Sweep:
    """A rotating head that moves while it turns. `elevations` (C,) and azimuths are in degrees. `azimuths` is
    (start, stop, count), where stop itself is left out, or an array (A,) in any order, also clockwise. Column j is
    measured at begin + (end - begin) * j / A. `trajectory` is (times, poses): ascending times (K,), and rigid poses
    (K, 3, 4) or (K, 4, 4) from the sensor's space (x ahead, y left, z up) to the world. Between them positions are
    interpolated along lines and rotations along the shortest arc, in float64. A sensor that stands has one pose, which is
    its pose at all times."""
    heights, around = elevations_of(elevations), _azimuths(azimuths)
    begin, end = real("begin", begin), real("end", end)
    if not -np.inf < begin <= end < np.inf:
        raise UsageError(f"a sweep from {begin} to {end}: both must be finite, and it must end after it begins")
    return swept(heights, around, begin + (end - begin) * np.arange(len(around)) / len(around), trajectory)


def swept(elevations: Array, azimuths: Array, times: Array, trajectory: Any) -> Sweep:
    """A scan of a head with these angles (C,) and (A,) in degrees, whose columns are measured at `times` (A,)."""
    up, around = np.radians(elevations), np.radians(azimuths)
    poses = poses_at(trajectory, times)
    ways = np.stack([np.cos(up)[:, None] * np.cos(around), np.cos(up)[:, None] * np.sin(around),
                     np.broadcast_to(np.sin(up)[:, None], (len(up), len(around)))], -1)
    rays = np.empty((len(up), len(around), 6))
    rays[..., :3] = poses[:, :, 3]
    rays[..., 3:] = np.einsum("jrk,cjk->cjr", poses[:, :, :3], ways)
    return Sweep(rays.reshape(-1, 6), np.repeat(np.arange(len(up), dtype=np.uint16), len(around)),
                 np.tile(times, len(up)), np.tile(_velocity_at(trajectory, times), (len(up), 1)))


def _velocity_at(trajectory: Any, times: Array) -> Array:
    """The velocity (N, 3) of a sound trajectory. At a known time, that of the stretch which begins there."""
    known = np.asarray(trajectory[0], np.float64)
    places = np.asarray(trajectory[1], np.float64)[:, :3, 3]
    if len(known) == 1:
        return np.zeros((len(times), 3))
    slopes = np.diff(places, axis=0) / np.diff(known)[:, None]
    velocities: Array = slopes[np.clip(np.searchsorted(known, times, side="right"), 1, len(known) - 1) - 1]
    return velocities


def known_poses(trajectory: Any) -> tuple[Array, Array]:
    """Returns the times (K,) and poses (K, 3, 4) of a trajectory, checked, as float64."""
    if not isinstance(trajectory, (tuple, list)) or len(trajectory) != 2:
        raise UsageError("a trajectory is (times, poses)")
    known = finite("the trajectory's times", trajectory[0], _limits.trajectory_poses_max)
    poses = numbers("the trajectory's poses", trajectory[1]).astype(np.float64)
    if poses.ndim != 3 or poses.shape[1:] not in ((3, 4), (4, 4)) or len(poses) != len(known):
        raise UsageError(f"poses of shape {poses.shape} for {len(known)} times: they must be ({len(known)}, 3, 4) "
                         f"or ({len(known)}, 4, 4)")
    if poses.shape[1] == 4 and not (poses[:, 3] == (0, 0, 0, 1)).all():
        raise UsageError("the last row of a pose is not 0 0 0 1: is it transposed?")
    poses = poses[:, :3]
    if not (np.diff(known) > 0).all():
        raise UsageError("the trajectory's times must ascend")
    turns = poses[:, :, :3]
    off = np.abs(turns.swapaxes(1, 2) @ turns - np.eye(3)).max(axis=(1, 2))
    wrong = ~np.isfinite(poses).all(axis=(1, 2)) | ~(off < _RIGID) | ~(np.linalg.det(np.where(
        np.isfinite(turns), turns, 0)) > 0)
    if wrong.any():
        raise UsageError(f"pose {int(np.argmax(wrong))} of the trajectory is not rigid: it must turn and move alone, "
                         "without scale or reflection")
    return known, poses


def poses_at(trajectory: Any, times: Any) -> Array:
    """Returns the poses (N, 3, 4) of a trajectory at `times` (N,), which lie within it, unless it is one pose alone."""
    known, poses = known_poses(trajectory)
    turns = poses[:, :, :3]
    at = numbers("times", times).astype(np.float64)
    if at.ndim != 1 or not np.isfinite(at).all():
        raise UsageError(f"times of shape {at.shape} must be (N,) and finite")
    if len(known) == 1:
        return np.repeat(poses, len(at), axis=0)
    if len(at) and (at.min() < known[0] or at.max() > known[-1]):
        raise UsageError(f"the sweep lasts from {at.min()} to {at.max()}, the trajectory from {known[0]} to {known[-1]}: "
                         "give poses for all of it")
    last = np.clip(np.searchsorted(known, at, side="right"), 1, len(known) - 1)
    share = ((at - known[last - 1]) / (known[last] - known[last - 1]))[:, None]
    made = np.empty((len(at), 3, 4))
    made[:, :, 3] = (1 - share) * poses[last - 1, :, 3] + share * poses[last, :, 3]
    made[:, :, :3] = _turned(turns[last - 1], turns[last], share)
    return made


def steps(speed: float, period: float, error: float) -> int:
    """Returns the number of equal steps of a period in which something that moves at `speed` is off by at most
    `error`, if it stands in each step where it is in the step's middle."""
    speed, period, error = real("speed", speed), real("period", period), real("error", error)
    if not (0 <= speed < np.inf and 0 <= period < np.inf and error > 0):
        raise UsageError("speed and period must be finite and not negative, and error above 0")
    return max(1, int(np.ceil(speed * period / (2 * error))))


def _turned(first: Array, second: Array, share: Array) -> Array:
    """Rotations between two others, along the shortest arc: first, then `share` of the turn to the second."""
    turn = first.swapaxes(1, 2) @ second
    cosine = np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1)
    # The antisymmetric part is the axis times the sine. Near half a turn that is rounding, and the symmetric part,
    # less the cosine, is the axis times itself.
    axis = np.stack([turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0],
                     turn[:, 1, 0] - turn[:, 0, 1]], -1) / 2
    sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, cosine)
    twice = (turn + turn.swapaxes(1, 2)) / 2 - cosine[:, None, None] * np.eye(3)
    column = np.argmax(np.diagonal(twice, axis1=1, axis2=2), axis=1)
    along = twice[np.arange(len(twice)), :, column]
    along = along / np.maximum(np.linalg.norm(along, axis=1), 1e-300)[:, None]
    along = np.where((axis * along).sum(axis=1) < 0, -1, 1)[:, None] * along
    unit = np.where((cosine < 0)[:, None], along, axis / np.maximum(sine, 1e-300)[:, None])
    part = angle[:, None] * share
    x, y, z = unit.T
    zero = np.zeros_like(x)
    across = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(-1, 3, 3)
    step = np.eye(3) + np.sin(part)[:, :, None] * across + (1 - np.cos(part))[:, :, None] * (across @ across)
    turned: Array = first @ step
    return turned


def turn_of(azimuths: Any) -> tuple[float, float, int]:
    """Checks (start, stop, count)."""
    try:
        start, stop, count = azimuths
    except (TypeError, ValueError):
        raise UsageError(f"azimuths of {reprlib.repr(azimuths)}: they must be (start, stop, count)") from None
    columns = count_of("the count of azimuths", count, _limits.azimuths_max)
    start, stop = finite("azimuths", (start, stop), 2).tolist()
    return start, stop, columns


def turn_or_angles(azimuths: Any) -> tuple[Optional[tuple[float, float, int]], Array]:
    """Returns (start, stop, count), which a tuple of three is, or a list of angles. Of lidar() a list of three is
    the former too, so one that can hardly be angles is refused."""
    if isinstance(azimuths, tuple) and len(azimuths) == 3:
        return turn_of(azimuths), np.empty(0)
    angles = finite("azimuths", azimuths, _limits.azimuths_max)
    if len(angles) == 3 and angles[2] > 360:
        raise UsageError(f"azimuths of {reprlib.repr(azimuths)}: a list has angles; write (start, stop, count) as a tuple")
    return None, angles


def _azimuths(azimuths: Any) -> Array:
    turn, angles = turn_or_angles(azimuths)
    return angles if turn is None else angles_of(turn)


def angles_of(turn: tuple[float, float, int]) -> Array:
    start, stop, columns = turn
    return start + (stop - start) * np.arange(columns) / columns


def elevations_of(elevations: Any, most: int = _limits.sweep_channels_max) -> Array:
    """Returns the elevations of 1 to `most` channels."""
    angles = finite("elevations", elevations, most)
    if (np.abs(angles) > 90).any():
        raise UsageError("elevations must lie between -90 and 90 degrees")
    return angles


def finite(what: str, values: Any, most: int) -> Array:
    """Returns a list of 1 to `most` finite numbers as float64."""
    given = numbers(what, values).astype(np.float64)
    if given.ndim != 1 or not 0 < len(given) <= most:
        raise UsageError(f"{what} of shape {given.shape}: 1 to {most} numbers are taken")
    if not np.isfinite(given).all():
        raise UsageError(f"{what} must be finite")
    return given
