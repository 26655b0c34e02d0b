from __future__ import annotations

import gc
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from stage.embree import PACKET, Frame, Scene, first_hits, is_blocked, new_packet, put_ray, trace_packet

Array = NDArray[np.float64]
RAYS = 203


@njit(cache=False, nogil=True)
def blocked(frame: Frame, origins: Array, toward: Array, distant: bool, out: NDArray[np.bool_]) -> None:
    packet = new_packet()
    for first in range(0, len(origins), PACKET):
        count = min(PACKET, len(origins) - first)
        for slot in range(count):
            o, d = origins[first + slot], toward[first + slot]
            put_ray(packet, slot, frame, (o[0], o[1], o[2]), (d[0], d[1], d[2]), distant)
        trace_packet(packet, count, frame)
        for slot in range(count):
            out[first + slot] = is_blocked(packet, slot)


def soup(seed: int) -> tuple[Array, NDArray[np.int32], Array, Array]:
    """Triangles anywhere, and rays; the vertices' bounds make the unit sphere, so that nothing is moved or scaled."""
    rng = np.random.default_rng(seed)
    corners = np.array([[1.0, 1, 1], [-1, -1, -1]]) / np.sqrt(3)
    vertices = np.concatenate([corners, rng.uniform(-0.57, 0.57, (60, 3))])
    faces = (rng.permutation(60).reshape(20, 3) + 2).astype(np.int32)
    toward = rng.normal(size=(RAYS, 3))
    return vertices, faces, rng.uniform(-1, 1, (RAYS, 3)), toward / np.linalg.norm(toward, axis=1, keepdims=True)


def by_embreex(
    vertices: Array, faces: NDArray[np.int32], origins: Array, toward: Array, reach: float, query: str
) -> NDArray[np.int32]:
    scene = EmbreeScene(robust=True)
    # must outlive the query
    mesh = TriangleMesh(scene, vertices.astype(np.float32), faces)
    limits = np.full(len(origins), reach, np.float32)
    hits: NDArray[np.int32] = scene.run(
        origins.astype(np.float32), toward.astype(np.float32), dists=limits, query=query
    )
    del mesh
    return hits


@given(st.integers(0, 10_000), st.booleans())
@settings(max_examples=25, deadline=None)
def test_agrees_with_embreex_own_binding(seed: int, distant: bool) -> None:
    vertices, faces, origins, toward = soup(seed)
    scene, out = Scene(vertices, faces), np.empty(RAYS, bool)
    blocked(scene.frame, origins, toward, distant, out)
    expected = by_embreex(vertices, faces, origins, toward, np.inf if distant else 1.0, "OCCLUDED") >= 0
    # a ray through the very edge of a triangle may fall on either side
    assert (out != expected).sum() <= 1
    hits = np.empty(RAYS, np.int32)
    first_hits(scene.frame, origins[0], toward, hits, 0, RAYS)
    same_origin = np.broadcast_to(origins[0], toward.shape)
    assert (hits != by_embreex(vertices, faces, same_origin, toward, np.inf, "INTERSECT")).sum() <= 1


def test_threads_share_a_scene() -> None:
    vertices, faces, origins, toward = soup(1)
    scene = Scene(vertices, faces)

    def trace(_: int) -> NDArray[np.bool_]:
        out = np.empty(RAYS, bool)
        for _ in range(20):
            blocked(scene.frame, origins, toward, True, out)
        return out

    with ThreadPoolExecutor(4) as pool:
        first, *others = pool.map(trace, range(4))
    assert first.any()
    for other in others:
        assert_array_equal(other, first)


def test_a_scene_is_released_with_its_object(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[str] = []
    from stage import embree

    real = embree._call
    monkeypatch.setattr(embree, "_call", lambda name, *rest, **more: (calls.append(name), real(name, *rest, **more))[1])
    scene = Scene(*soup(2)[:2])
    assert "rtcReleaseScene" not in calls
    del scene
    gc.collect()
    assert calls[-1] == "rtcReleaseScene"
