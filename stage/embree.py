"""Intel Embree from compiled code: rays in packets, several threads at a time.

The library is the one that embreex brings, called through its C interface (Embree 4, ``rtcore.h``). embreex's own
``run`` holds Python's interpreter lock while it traces, so that threads wait for each other, and wants every ray of a
light in an array; here kernels compiled by numba make rays from what they have, and let go of the lock.
"""

from __future__ import annotations

import ctypes
import weakref
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import embreex
import llvmlite.binding  # type: ignore[import-untyped]
import numpy as np
from embreex import rtcore_scene
from numba import njit, types
from numpy.typing import NDArray

from stage.errors import InputError

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Whole = NDArray[np.int32]

PACKET = 8
"""Rays traced together; neighbours that run to one light mostly visit the same boxes."""

# rtcore_common.h, rtcore_buffer.h, rtcore_geometry.h, rtcore_scene.h
_TRIANGLES, _INDICES, _VERTICES = 0, 0, 1
_UINT3, _FLOAT3 = 0x5003, 0x9003
_ROBUST = 1 << 2
_COHERENT, _ALL_FEATURES = 1 << 16, -1

# RTCRay8: eleven rows of eight; RTCHit follows a single RTCRay of twelve words
_NEAR, _TOWARD, _FAR, _MASK, _ROWS = 3, 4, 8, 9, 12
_PRIMITIVE, _GEOMETRY, _RAY_HIT_WORDS = 17, 18, 24
_ALIGNMENT = 32


class Frame(NamedTuple):
    """A scene as kernels take it, as long as the `Scene` lives: handles, and how coordinates are moved and scaled."""

    handle: int
    arguments: int
    centre: Array
    radius: float


class Packet(NamedTuple):
    """Up to eight rays as RTCRay8 has them, and which of them count."""

    rays: Floats
    valid: Whole


class _Arguments(ctypes.Structure):
    """RTCOccludedArguments; the pointers stay null."""

    _fields_ = (
        ("flags", ctypes.c_uint),
        ("features", ctypes.c_int),
        ("pointers", ctypes.c_void_p * 3),
        ("width", ctypes.c_float),
    )


_arguments = _Arguments(flags=_COHERENT, features=_ALL_FEATURES)


def _library() -> ctypes.CDLL:
    # looking a name up in the extension module finds it in the libraries that it was linked with; Windows does not
    extension = ctypes.CDLL(rtcore_scene.__file__)
    if hasattr(extension, "rtcNewDevice"):
        return extension
    beside = Path(embreex.__file__).parents[1] / "embreex.libs"
    for path in sorted(beside.glob("*embree4*")):
        return ctypes.CDLL(str(path))
    raise ImportError(f"embreex brings no Embree 4 that can be called: nothing in {beside}")


def _addresses(count: int) -> Any:
    """Signature of a function of addresses that returns nothing."""
    return types.void(*[types.intp] * count)


_embree = _library()
for _name in ("rtcOccluded8", "rtcIntersect1"):
    llvmlite.binding.add_symbol(_name, ctypes.cast(getattr(_embree, _name), ctypes.c_void_p).value)
_occluded8: Any = types.ExternalFunction("rtcOccluded8", _addresses(4))
_intersect1: Any = types.ExternalFunction("rtcIntersect1", _addresses(3))


def _call(name: str, *arguments: object, result: type | None = ctypes.c_void_p) -> int:
    function = getattr(_embree, name)
    function.restype = result
    return int(function(*arguments) or 0)


@cache
def _device() -> ctypes.c_void_p:
    return ctypes.c_void_p(_call("rtcNewDevice", None))


class Scene:
    """A mesh in Embree, moved and scaled to the unit sphere so that single precision goes as far as it can.

    Parameters
    ----------
    vertices : (n, 3) float
        Finite, not all the same.
    faces : (m, 3) int32
        Indices of `vertices`; m > 0.

    Raises
    ------
    InputError
        Where Embree runs out of memory.
    """

    def __init__(self, vertices: Array, faces: Whole) -> None:
        low, high = vertices.min(0), vertices.max(0)
        centre, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
        # Embree reads the arrays where they are, sixteen bytes at a time, so one number more is kept
        self._vertices = np.zeros(3 * len(vertices) + 1, dtype=np.float32)
        self._vertices[:-1] = ((vertices - centre) / radius).ravel()
        self._faces = np.ascontiguousarray(faces, dtype=np.int32)
        scene = ctypes.c_void_p(_call("rtcNewScene", _device()))
        weakref.finalize(self, _call, "rtcReleaseScene", scene, result=None)
        _call("rtcSetSceneFlags", scene, _ROBUST, result=None)
        geometry = ctypes.c_void_p(_call("rtcNewGeometry", _device(), _TRIANGLES))
        for kind, layout, array, rows in (
            (_VERTICES, _FLOAT3, self._vertices, len(vertices)),
            (_INDICES, _UINT3, self._faces, len(faces)),
        ):
            place, size = ctypes.c_void_p(array.ctypes.data), ctypes.c_size_t
            sizes = (size(0), size(12), size(rows))
            _call("rtcSetSharedGeometryBuffer", geometry, kind, 0, layout, place, *sizes, result=None)
        _call("rtcCommitGeometry", geometry, result=None)
        _call("rtcAttachGeometry", scene, geometry, result=ctypes.c_uint)
        _call("rtcReleaseGeometry", geometry, result=None)
        _call("rtcCommitScene", scene, result=None)
        fault = _call("rtcGetDeviceError", _device(), result=ctypes.c_int)
        if fault:
            raise InputError(f"mesh: Embree cannot build its tree of {len(faces):,} triangles: error {fault}")
        self.frame = Frame(scene.value or 0, ctypes.addressof(_arguments), centre, radius)


@njit(cache=True, nogil=True)
def new_packet() -> Packet:
    """Room for eight rays."""
    words = _ALIGNMENT // 4
    floats, whole = np.zeros(_ROWS * PACKET + words, np.float32), np.zeros(PACKET + words, np.int32)
    rays = floats[-floats.ctypes.data % _ALIGNMENT // 4 :][: _ROWS * PACKET]
    valid = whole[-whole.ctypes.data % _ALIGNMENT // 4 :][:PACKET]
    rays.view(np.int32)[_MASK * PACKET : (_MASK + 1) * PACKET] = -1
    return Packet(rays, valid)


@njit(cache=True, nogil=True, inline="always")
def put_ray(
    packet: Packet,
    slot: int,
    frame: Frame,
    origin: tuple[float, float, float],
    toward: tuple[float, float, float],
    distant: bool,
) -> None:
    """Set a ray from `origin`, metres, that ends at ``origin + toward``, or runs on without end if distant."""
    rays = packet.rays
    scale = 1.0 if distant else 1 / frame.radius
    for k in range(3):
        rays[k * PACKET + slot] = (origin[k] - frame.centre[k]) / frame.radius
        rays[(_TOWARD + k) * PACKET + slot] = toward[k] * scale
    rays[_NEAR * PACKET + slot] = 0.0
    rays[_FAR * PACKET + slot] = np.inf if distant else 1.0


@njit(cache=True, nogil=True, inline="always")
def trace_packet(packet: Packet, count: int, frame: Frame) -> None:
    """Look what the first `count` rays meet; `is_blocked` then knows."""
    for slot in range(PACKET):
        packet.valid[slot] = -1 if slot < count else 0
    _occluded8(packet.valid.ctypes.data, frame.handle, packet.rays.ctypes.data, frame.arguments)


@njit(cache=True, nogil=True, inline="always")
def is_blocked(packet: Packet, slot: int) -> bool:
    """Whether a traced ray meets anything: Embree then puts its end at minus infinity."""
    return packet.rays[_FAR * PACKET + slot] < 0  # type: ignore[no-any-return]


@njit(cache=True, nogil=True)
def first_hits(frame: Frame, origin: Array, toward: Array, hits: Whole, start: int, stop: int) -> None:
    """Triangle first met by rays start to stop, from one point (3,) along `toward` (n, 3); -1 for none."""
    words = np.zeros(_RAY_HIT_WORDS + 4, np.float32)
    ray = words[-words.ctypes.data % 16 // 4 :][:_RAY_HIT_WORDS]
    whole = ray.view(np.int32)
    for i in range(start, stop):
        for k in range(3):
            ray[k] = (origin[k] - frame.centre[k]) / frame.radius
            ray[4 + k] = toward[i, k] / frame.radius
        ray[3] = ray[7] = 0.0
        ray[8] = np.inf
        whole[9] = whole[_GEOMETRY] = -1
        _intersect1(frame.handle, ray.ctypes.data, 0)
        hits[i] = whole[_PRIMITIVE] if whole[_GEOMETRY] >= 0 else -1
