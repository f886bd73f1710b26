"""ROS messages as dictionaries, without ROS: `geometry_msgs`, `trajectory_msgs` and `moveit_msgs/Grasp`.

The keys are the fields of the ROS 2 messages, so `rosidl_runtime_py.set_message_fields(message, dictionary)` fills
them, and bridges that speak JSON take them as they are. In the other direction `depth_frame` reads
`sensor_msgs/Image` and `CameraInfo`, as messages or as dictionaries.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspd.frames import DepthFrame, Intrinsics
from graspd.plans import Grasp, Moment, Plan
from graspd.poses import Array, checked_pose, quaternion_from_matrix

Message: TypeAlias = dict[str, Any]
"""A message's fields by name."""

_DEPTH_TYPES = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}


def _xyz(values: ArrayLike) -> Message:
    x, y, z = np.asarray(values, dtype=np.float64).tolist()
    return {"x": x, "y": y, "z": z}


def _quaternion(matrix: Array) -> Message:
    x, y, z, w = quaternion_from_matrix(matrix).tolist()
    return {"x": x, "y": y, "z": z, "w": w}


def _duration(seconds: float) -> Message:
    whole = math.floor(seconds)
    return {"sec": whole, "nanosec": round((seconds - whole) * 1e9)}


def header(frame_id: str, stamp: datetime | None = None) -> Message:
    """`std_msgs/Header`; without a time its stamp is 0, which tf takes as the latest."""
    seconds, nanoseconds = 0, 0
    if stamp is not None:
        since = (stamp if stamp.tzinfo else stamp.replace(tzinfo=timezone.utc)) - datetime(
            1970, 1, 1, tzinfo=timezone.utc
        )
        seconds, nanoseconds = since.days * 86400 + since.seconds, since.microseconds * 1000
    return {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": frame_id}


def pose(matrix: ArrayLike) -> Message:
    """`geometry_msgs/Pose` of a 4 × 4 pose."""
    m = checked_pose(matrix, "matrix")
    return {"position": _xyz(m[:3, 3]), "orientation": _quaternion(m)}


def pose_stamped(matrix: ArrayLike, frame_id: str, stamp: datetime | None = None) -> Message:
    """`geometry_msgs/PoseStamped` of a 4 × 4 pose in a frame."""
    return {"header": header(frame_id, stamp), "pose": pose(matrix)}


def transform_stamped(matrix: ArrayLike, frame_id: str, child_frame_id: str, stamp: datetime | None = None) -> Message:
    """`geometry_msgs/TransformStamped` of a 4 × 4 pose: the child's frame in the frame."""
    m = checked_pose(matrix, "matrix")
    return {
        "header": header(frame_id, stamp),
        "child_frame_id": child_frame_id,
        "transform": {"translation": _xyz(m[:3, 3]), "rotation": _quaternion(m)},
    }


def pose_array(plan: Plan, stamp: datetime | None = None) -> Message:
    """`geometry_msgs/PoseArray` of a plan's grasps, best first."""
    frame_id = plan[0].frame_id if len(plan) else ""
    return {"header": header(frame_id, stamp or plan.capture_time), "poses": [pose(g.pose) for g in plan]}


def joint_state(grasp: Grasp, moment: Moment = "contact", stamp: datetime | None = None) -> Message:
    """`sensor_msgs/JointState` of the hand's joints at a moment of the grasp."""
    values = grasp.joints.at(moment)
    return {
        "header": header("", stamp),
        "name": list(values),
        "position": list(values.values()),
        "velocity": [],
        "effort": [],
    }


def joint_trajectory(grasp: Grasp, moments: Sequence[Moment], seconds: float = 1.0) -> Message:
    """`trajectory_msgs/JointTrajectory` of the hand's joints through some moments, so many seconds each."""
    return {
        "header": header(""),
        "joint_names": list(grasp.joints.names),
        "points": [
            {
                "positions": list(grasp.joints.at(moment).values()),
                "velocities": [],
                "accelerations": [],
                "effort": [],
                "time_from_start": _duration(seconds * (i + 1)),
            }
            for i, moment in enumerate(moments)
        ],
    }


def moveit_grasp(
    grasp: Grasp,
    *,
    id: str = "",
    up: ArrayLike = (0.0, 0.0, 1.0),
    retreat: float = 0.10,
    max_contact_force: float = 0.0,
    allowed_touch_objects: Sequence[str] = (),
    stamp: datetime | None = None,
) -> Message:
    """`moveit_msgs/Grasp`: pose of the hand's root link, postures, approach, and a retreat.

    Args:
        grasp: The grasp. Its poses are those of `grasp.wrist_link`; where the group's end-effector link is another one,
            multiply first.
        id: Name of the grasp.
        up: Direction of the retreat in the world frame.
        retreat: How far to retreat, metres.
        max_contact_force: Newtons; 0 says nothing.
        allowed_touch_objects: Objects that may be touched.
        stamp: Time of the poses.
    """
    way = float(np.linalg.norm(grasp.approach))
    # A pre-grasp offset of 0 leaves no direction: the hand is there already.
    direction = grasp.approach / way if way > 0 else np.zeros(3)

    def translation(vector: ArrayLike, distance: float) -> Message:
        return {
            "direction": {"header": header(grasp.frame_id, stamp), "vector": _xyz(vector)},
            "desired_distance": distance,
            "min_distance": distance,
        }

    lift = np.asarray(up, dtype=np.float64)
    return {
        "id": id,
        "pre_grasp_posture": joint_trajectory(grasp, ["open"]),
        "grasp_posture": joint_trajectory(grasp, ["squeezed"]),
        "grasp_pose": pose_stamped(grasp.pose, grasp.frame_id, stamp),
        "grasp_quality": grasp.score,
        "pre_grasp_approach": translation(direction, way),
        "post_grasp_retreat": translation(lift / np.linalg.norm(lift), retreat),
        "post_place_retreat": translation(-direction, way),
        "max_contact_force": max_contact_force,
        "allowed_touch_objects": list(allowed_touch_objects),
    }


def moveit_grasps(plan: Plan, **options: Any) -> list[Message]:
    """`moveit_msgs/Grasp` of every grasp of a plan, best first; options as for `moveit_grasp`."""
    return [moveit_grasp(g, **{"id": f"{plan.hand}_{i}", **options}) for i, g in enumerate(plan)]


def depth_frame(
    image: object,
    camera_info: object,
    *,
    camera_pose: Array | None = None,
    world_frame: str = "world",
) -> DepthFrame:
    """A depth frame from `sensor_msgs/Image` (16UC1 in millimetres, or 32FC1) and `sensor_msgs/CameraInfo`.

    Both may be messages or dictionaries. The frame's name and time are the image's.

    Raises:
        ValueError: Naming the field, what was found and what was expected.
    """
    encoding = str(_field(image, "encoding"))
    if encoding not in _DEPTH_TYPES:
        raise ValueError(f"image.encoding: found {encoding!r}, expected one of {', '.join(_DEPTH_TYPES)}")
    height, width, step = (int(_field(image, name)) for name in ("height", "width", "step"))
    order = ">" if _field(image, "is_bigendian") else "<"
    pixel = np.dtype(order + _DEPTH_TYPES[encoding])
    data = bytes(_field(image, "data"))
    if step < width * pixel.itemsize or len(data) < step * height:
        raise ValueError(
            f"image.data: found {len(data)} bytes in rows of {step}, expected {height} rows of at least "
            f"{width * pixel.itemsize}"
        )
    rows = np.frombuffer(data, dtype=np.uint8, count=step * height).reshape(height, step)
    pixels = np.ascontiguousarray(rows[:, : width * pixel.itemsize]).view(pixel)
    native: NDArray[Any] = pixels.astype(pixel.newbyteorder("=")) if pixel.byteorder != _native() else pixels
    stamp = _field(_field(image, "header"), "stamp")
    seconds = int(_field(stamp, "sec")) + int(_field(stamp, "nanosec")) * 1e-9
    return DepthFrame(
        native,
        intrinsics(camera_info),
        camera_frame=str(_field(_field(image, "header"), "frame_id")) or "camera",
        capture_time=datetime.fromtimestamp(seconds, timezone.utc) if seconds else None,
        camera_pose=camera_pose,
        world_frame=world_frame,
    )


def _native() -> str:
    return "<" if sys.byteorder == "little" else ">"


def intrinsics(camera_info: object) -> Intrinsics:
    """The lens of a `sensor_msgs/CameraInfo`: its K, and the coefficients of `plumb_bob` or `rational_polynomial`.

    For a rectified image, pass a camera info whose D is empty or 0.
    """
    # ROS 1 has capitals.
    k = _field(camera_info, "k", None) if _field(camera_info, "K", None) is None else _field(camera_info, "K")
    d = _field(camera_info, "d", None) if _field(camera_info, "D", None) is None else _field(camera_info, "D")
    if k is None or d is None:
        raise ValueError(f"camera_info: found no k or no d in {type(camera_info).__name__}, expected both")
    model = str(_field(camera_info, "distortion_model", ""))
    coefficients = tuple(float(c) for c in d)
    if not any(coefficients):
        coefficients = ()
    elif model not in ("plumb_bob", "rational_polynomial"):
        raise ValueError(f"camera_info.distortion_model: found {model!r}, expected plumb_bob or rational_polynomial")
    return Intrinsics.from_matrix(np.asarray(k, dtype=np.float64).reshape(3, 3), coefficients)


_REQUIRED = object()


def _field(message: object, name: str, default: object = _REQUIRED) -> Any:
    found = message.get(name, default) if isinstance(message, Mapping) else getattr(message, name, default)
    value: Any = found
    if value is _REQUIRED:
        raise ValueError(f"{name}: found no such field in {type(message).__name__}")
    return value
