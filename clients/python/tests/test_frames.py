"""Frames: what arrays become on the wire, points, lenses, and what is refused."""

from __future__ import annotations

from datetime import datetime, timezone
from typing import Any

import numpy as np
import pytest

import graspd
from graspd.frames import as_frames
from graspd.v1 import frame_pb2
from tests.png import png

LENS = graspd.Intrinsics(500, 501, 3.5, 2.5)


def test_pixels_become_bytes() -> None:
    millimetres = np.arange(48, dtype=np.uint16).reshape(6, 8)
    wire = graspd.DepthFrame(millimetres, LENS, depth_scale=0.00025).to_wire()
    assert (wire.width_px, wire.height_px, wire.depth_scale_m) == (8, 6, 0.00025)
    assert wire.encoding == frame_pb2.DEPTH_ENCODING_RAW_U16
    assert wire.data == millimetres.tobytes()
    assert not wire.HasField("camera_pose") and not wire.HasField("labels")

    # A view with strides, in doubles, and big-endian pixels: the wire is tight, single, little-endian.
    metres = np.linspace(0, 1, 96).reshape(12, 8)[::2]
    wire = graspd.DepthFrame(metres, LENS).to_wire()
    assert wire.encoding == frame_pb2.DEPTH_ENCODING_RAW_F32
    assert wire.data == np.ascontiguousarray(metres, dtype="<f4").tobytes()
    wire = graspd.DepthFrame(millimetres.astype(">u2"), LENS).to_wire()
    assert wire.data == millimetres.tobytes()

    file = png(millimetres)
    wire = graspd.DepthFrame(file, LENS).to_wire()
    assert (wire.encoding, wire.data, wire.width_px) == (frame_pb2.DEPTH_ENCODING_PNG_U16, file, 0)


def test_everything_else_reaches_the_wire() -> None:
    when = datetime(2026, 3, 4, 5, 6, 7, 250000, tzinfo=timezone.utc)
    wire = graspd.DepthFrame(
        np.ones((2, 3), np.float32),
        graspd.Intrinsics(1, 2, 3, 4, (0.1, 0.2, 0.3, 0.4, 0.5)),
        camera_pose=graspd.pose([1, 2, 3]),
        world_frame="arm/base",
        camera_frame="cell/eye",
        labels=np.eye(2, 3, dtype=np.uint8),
        capture_time=when,
    ).to_wire()
    lens = wire.intrinsics
    assert (lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px) == (1, 2, 3, 4)
    assert list(lens.distortion) == [0.1, 0.2, 0.3, 0.4, 0.5]
    assert (wire.camera_pose.frame_id, wire.camera_frame_id) == ("arm/base", "cell/eye")
    assert wire.camera_pose.pose.position.z == 3
    assert wire.labels.data == bytes([1, 0, 0, 0, 1, 0])
    assert wire.capture_time.ToDatetime(timezone.utc) == when


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"depth": np.zeros((2, 2, 1), np.uint16)}, "depth: found an array of shape"),
        ({"depth": np.zeros((0, 2), np.uint16)}, "depth: found an array of shape"),
        ({"depth": np.zeros((2, 2), np.uint8)}, "depth: found pixels of type uint8"),
        ({"depth": np.zeros((2, 2), np.int16)}, "depth: found pixels of type int16"),
        ({"depth": b"JFIF"}, "depth: found bytes that are no PNG"),
        ({"labels": np.zeros((2, 3), np.uint8)}, "labels: found shape"),
        ({"labels": np.zeros((2, 2), np.int64)}, "labels: found int64"),
        ({"camera_pose": np.eye(3)}, "camera_pose: found an array of shape"),
        ({"intrinsics": np.eye(4)}, "intrinsics: found"),
        ({"intrinsics": [[1, 0.5, 0], [0, 1, 0], [0, 0, 1]]}, "without skew"),
    ],
)
def test_what_no_camera_gives_is_refused_by_name(arguments: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        graspd.DepthFrame(**{"depth": np.zeros((2, 2), np.uint16), "intrinsics": LENS, **arguments})


def test_a_scene_is_an_array_with_its_lens_a_frame_or_frames() -> None:
    depth = np.ones((2, 2), np.float32)
    frame = graspd.DepthFrame(depth, LENS)
    assert as_frames(frame, None) == [frame]
    assert as_frames((frame, frame), None) == [frame, frame]
    assert as_frames(depth, LENS.matrix)[0].intrinsics == LENS
    for scene, lens in [(depth, None), (frame, LENS), ([], None), ([depth], None), (depth.tolist(), LENS)]:
        with pytest.raises(TypeError, match=r"expected|has its own"):
            as_frames(scene, lens)


def test_points_lie_on_what_the_camera_sees() -> None:
    points = graspd.examples.box_frame().points()
    # Millimetres are rounded, so half of one along a slanted ray.
    assert points[:, 2].min() > -0.001 and np.isclose(points[:, 2].max(), graspd.examples.BOX_SIZE[2], atol=0.001)
    top = points[points[:, 2] > 0.079]
    assert np.allclose(np.abs(top[:, :2]).max(axis=0), np.array(graspd.examples.BOX_SIZE[:2]) / 2, atol=0.002)
    depth, lens = graspd.examples.box_on_table()
    seen = graspd.DepthFrame(depth, lens).points()
    assert np.allclose(graspd.transform(graspd.examples.camera_pose(), seen), points)


def test_pixels_without_depth_have_no_points() -> None:
    depth = np.array([[0.0, np.nan], [-1.0, 2.0]])
    assert graspd.DepthFrame(depth, graspd.Intrinsics(1, 1, 0, 0)).points().tolist() == [[2.0, 2.0, 2.0]]


@pytest.mark.parametrize(
    "distortion",
    [(0.1, -0.2, 0.001, -0.002), (-0.28, 0.09, 1e-4, -3e-4, 0.01), (5.6, 3.4, 2e-4, -6e-5, 0.16, 5.9, 5.2, 0.9)],
)
def test_rays_undo_the_distortion(distortion: tuple[float, ...]) -> None:
    lens = graspd.Intrinsics(600, 610, 320, 240, distortion)
    rays = lens.rays(640, 480)
    x, y = rays[..., 0], rays[..., 1]
    k1, k2, p1, p2, k3, k4, k5, k6 = (*distortion, *[0.0] * (8 - len(distortion)))
    # OpenCV's forward model, written down once more.
    r2 = x**2 + y**2
    radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    column = 600 * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)) + 320
    row = 610 * (y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y) + 240
    columns, rows = np.meshgrid(np.arange(640), np.arange(480))
    assert np.abs(column - columns).max() < 1e-3 and np.abs(row - rows).max() < 1e-3
