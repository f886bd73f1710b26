"""Depth frames from numpy arrays, PNG files and ROS messages' fields: an image, its lens, where the camera stood."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspd.poses import Array, checked_pose, pose_to_wire, transform
from graspd.v1 import frame_pb2 as wire
from graspd.v1 import geometry_pb2

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_UNDISTORTION_ROUNDS = 20


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole lens with Brown-Conrady distortion (OpenCV's rational model). Pixels."""

    fx: float
    """Focal length along x."""
    fy: float
    """Focal length along y."""
    cx: float
    """Principal point, x; the centre of the first pixel is 0."""
    cy: float
    """Principal point, y."""
    distortion: tuple[float, ...] = ()
    """k1, k2, p1, p2, k3, k4, k5, k6: none of them (a rectified image), the first four, five, or all eight."""

    @classmethod
    def from_matrix(cls, matrix: ArrayLike, distortion: Iterable[float] = ()) -> Intrinsics:
        """The lens of a 3 × 3 camera matrix (OpenCV's K).

        >>> Intrinsics.from_matrix([[600, 0, 320], [0, 601, 240], [0, 0, 1]])
        Intrinsics(fx=600.0, fy=601.0, cx=320.0, cy=240.0, distortion=())
        """
        k = np.asarray(matrix, dtype=np.float64)
        if k.shape != (3, 3) or k[0, 1] != 0 or k[2].tolist() != [0, 0, 1]:
            raise ValueError(
                f"intrinsics: found {k.tolist()}, expected a 3 × 3 camera matrix without skew, its last row 0, 0, 1"
            )
        return cls(
            float(k[0, 0]),
            float(k[1, 1]),
            float(k[0, 2]),
            float(k[1, 2]),
            tuple(float(d) for d in distortion),
        )

    @property
    def matrix(self) -> Array:
        """The 3 × 3 camera matrix."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def rays(self, width: int, height: int) -> Array:
        """For each pixel (height × width × 3) the point that it sees at a depth of 1 m, camera frame."""
        columns, rows = np.meshgrid(np.arange(width), np.arange(height))
        xd, yd = (columns - self.cx) / self.fx, (rows - self.cy) / self.fy
        x, y = xd, yd
        if self.distortion:
            k1, k2, p1, p2, k3, k4, k5, k6 = (*self.distortion, *([0.0] * (8 - len(self.distortion))))
            # The distortion is inverted by fixed-point iteration, as OpenCV does.
            for _ in range(_UNDISTORTION_ROUNDS):
                r2 = x * x + y * y
                radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
                dx = 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
                dy = p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
                x, y = (xd - dx) / radial, (yd - dy) / radial
        return np.stack([x, y, np.ones_like(x)], axis=-1)


IntrinsicsLike: TypeAlias = Intrinsics | ArrayLike
"""A lens, or a 3 × 3 camera matrix of a rectified image."""


def as_intrinsics(value: IntrinsicsLike) -> Intrinsics:
    """The lens itself, or that of a camera matrix."""
    return value if isinstance(value, Intrinsics) else Intrinsics.from_matrix(value)


@dataclass(frozen=True, eq=False)
class DepthFrame:
    """A depth image with everything that is needed to turn its pixels into points.

    Depth is measured along the optical axis. The camera frame is the optical frame: x right, y down, z forward.
    """

    depth: NDArray[np.uint16] | NDArray[np.float32] | NDArray[np.float64] | bytes
    """Height × width: unsigned 16-bit pixels, or metres as floats; 0 and NaN mean no return. Or a 16-bit PNG file."""
    intrinsics: Intrinsics
    """The lens."""
    depth_scale: float = 0.001
    """Metres for one unit of a 16-bit pixel: millimetres unless said otherwise. Not used by floats."""
    camera_pose: Array | None = None
    """Pose of the camera, world_from_camera, 4 × 4. Without one the camera's frame is the world frame, and every pose
    of the question and of the answer is in it. Required for several frames."""
    world_frame: str = "world"
    """Name of the world frame; every frame of one question has the same."""
    camera_frame: str = "camera"
    """Name of the optical frame."""
    labels: NDArray[np.uint8] | None = None
    """Height × width: an object's number for each pixel, 0 for none. Optional."""
    capture_time: datetime | None = None
    """When the exposure ended, in the caller's own clock; comes back with the plan. A time without a zone is UTC."""

    def __post_init__(self) -> None:
        depth = self.depth
        if isinstance(depth, bytes | bytearray | memoryview):
            object.__setattr__(self, "depth", bytes(depth))
            if not bytes(depth[:8]) == _PNG_SIGNATURE:
                raise ValueError("depth: found bytes that are no PNG file, expected an array or a 16-bit PNG")
        else:
            object.__setattr__(self, "depth", _checked_depth(depth))
        object.__setattr__(self, "intrinsics", as_intrinsics(self.intrinsics))
        if self.camera_pose is not None:
            object.__setattr__(self, "camera_pose", checked_pose(self.camera_pose, "camera_pose"))
        if self.labels is not None:
            labels = np.asarray(self.labels)
            if labels.dtype != np.uint8 or labels.ndim != 2:
                raise ValueError(
                    f"labels: found {labels.dtype} of shape {labels.shape}, expected uint8, height × width"
                )
            if isinstance(self.depth, np.ndarray) and labels.shape != self.depth.shape:
                raise ValueError(f"labels: found shape {labels.shape}, expected the depth's {self.depth.shape}")

    def __repr__(self) -> str:
        depth = self.depth
        image = "PNG" if isinstance(depth, bytes) else f"{depth.shape[1]} × {depth.shape[0]} {depth.dtype}"
        where = self.camera_frame if self.camera_pose is None else f"{self.camera_frame} in {self.world_frame}"
        return f"<DepthFrame {image}, {where}>"

    def metres(self) -> NDArray[np.float32]:
        """Depth in metres, 0 where nothing was seen.

        Raises:
            TypeError: For a frame that holds a PNG file; only the server reads those.
        """
        if isinstance(self.depth, bytes):
            raise TypeError("depth: found a PNG file, expected an array; read it with an image library first")
        if self.depth.dtype == np.uint16:
            scaled: NDArray[np.float32] = (self.depth * np.float64(self.depth_scale)).astype(np.float32)
            return scaled
        metres = self.depth.astype(np.float32)
        return np.where(np.isfinite(metres) & (metres > 0), metres, np.float32(0))

    def points(self) -> Array:
        """The points that the camera sees (n × 3, metres), world frame, row by row; pixels without depth left out."""
        depth = self.metres()
        height, width = depth.shape
        points = (self.intrinsics.rays(width, height) * depth[..., None])[depth > 0]
        return points if self.camera_pose is None else transform(self.camera_pose, points)

    def to_wire(self) -> wire.DepthFrame:
        """The frame as a message."""
        lens = self.intrinsics
        message = wire.DepthFrame(
            camera_frame_id=self.camera_frame,
            intrinsics=wire.CameraIntrinsics(
                fx_px=lens.fx, fy_px=lens.fy, cx_px=lens.cx, cy_px=lens.cy, distortion=lens.distortion
            ),
        )
        if isinstance(self.depth, bytes):
            message.encoding = wire.DEPTH_ENCODING_PNG_U16
            message.depth_scale_m = self.depth_scale
            message.data = self.depth
        else:
            message.height_px, message.width_px = self.depth.shape
            if self.depth.dtype == np.uint16:
                message.encoding = wire.DEPTH_ENCODING_RAW_U16
                message.depth_scale_m = self.depth_scale
                message.data = self.depth.astype("<u2", copy=False).tobytes()
            else:
                message.encoding = wire.DEPTH_ENCODING_RAW_F32
                message.data = self.depth.astype("<f4", copy=False).tobytes()
        if self.camera_pose is not None:
            message.camera_pose.CopyFrom(
                geometry_pb2.PoseInFrame(frame_id=self.world_frame, pose=pose_to_wire(self.camera_pose, "camera_pose"))
            )
        if self.labels is not None:
            message.labels.CopyFrom(wire.LabelImage(encoding=wire.LABEL_ENCODING_RAW_U8, data=self.labels.tobytes()))
        if self.capture_time is not None:
            zoned = self.capture_time
            message.capture_time.FromDatetime(zoned if zoned.tzinfo is not None else zoned.replace(tzinfo=timezone.utc))
        return message


def _checked_depth(depth: object) -> NDArray[np.uint16] | NDArray[np.float32] | NDArray[np.float64]:
    image: NDArray[np.generic] = np.asarray(depth)
    if image.ndim != 2 or 0 in image.shape:
        raise ValueError(f"depth: found an array of shape {image.shape}, expected height × width")
    if image.dtype.kind == "u" and image.dtype.itemsize == 2:
        return image.astype(np.uint16, copy=False)
    if image.dtype.kind == "f":
        return image.astype(np.float32, copy=False)
    raise ValueError(
        f"depth: found pixels of type {image.dtype}, expected uint16 (times depth_scale) or floats (metres)"
    )


Frames: TypeAlias = DepthFrame | Sequence[DepthFrame]
"""One frame, or up to 16 of one moment."""


def as_frames(scene: object, intrinsics: IntrinsicsLike | None) -> list[DepthFrame]:
    """Frames from what a caller hands to a planner: a depth array and its lens, a frame, or frames.

    Raises:
        TypeError: If it is none of these.
    """
    if isinstance(scene, DepthFrame | list | tuple) and intrinsics is not None:
        raise TypeError("intrinsics: found a lens beside a DepthFrame, which has its own")
    if isinstance(scene, DepthFrame):
        return [scene]
    if isinstance(scene, list | tuple):
        if not scene or not all(isinstance(frame, DepthFrame) for frame in scene):
            raise TypeError("frames: expected one DepthFrame or more")
        return list(scene)
    if intrinsics is None:
        raise TypeError(
            "intrinsics: found none, expected the camera's lens: graspd.Intrinsics or a 3 × 3 camera matrix"
        )
    if not isinstance(scene, np.ndarray | bytes):
        raise TypeError(f"depth: found {type(scene).__name__}, expected a numpy array or a PNG file's bytes")
    return [DepthFrame(scene, as_intrinsics(intrinsics))]
