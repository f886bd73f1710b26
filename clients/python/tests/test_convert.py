"""Converters: ROS messages that real ROS serialization takes, camera messages that become frames, scipy rotations."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime, timezone
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

import graspd
from graspd.convert import ros
from graspd.convert import scipy as to_scipy

STORE = get_typestore(Stores.ROS2_HUMBLE)
# moveit_msgs is not among the base types; these are its fields.
STORE.register(
    get_types_from_msg(
        "geometry_msgs/Vector3Stamped direction\nfloat32 desired_distance\nfloat32 min_distance",
        "moveit_msgs/msg/GripperTranslation",
    )
)
STORE.register(
    get_types_from_msg(
        """string id
trajectory_msgs/JointTrajectory pre_grasp_posture
trajectory_msgs/JointTrajectory grasp_posture
geometry_msgs/PoseStamped grasp_pose
float64 grasp_quality
GripperTranslation pre_grasp_approach
GripperTranslation post_grasp_retreat
GripperTranslation post_place_retreat
float32 max_contact_force
string[] allowed_touch_objects""",
        "moveit_msgs/msg/Grasp",
    )
)


def message(kind: str, fields: Mapping[str, Any]) -> Any:
    """A message of a real type from a dictionary; a field too many or too few is a failure."""
    built = {}
    # Nested tuples whose shape depends on their first element.
    definitions: Any = STORE.fielddefs[kind][1]
    expected = dict(definitions)
    assert set(fields) == set(expected), (kind, set(fields) ^ set(expected))
    for name, (node, inner) in expected.items():
        value = fields[name]
        if node.name == "NAME":
            value = message(inner, value)
        elif node.name in ("ARRAY", "SEQUENCE"):
            element, name_of = inner[0]
            if element.name == "NAME":
                value = [message(name_of, v) for v in value]
            elif name_of[0] != "string":
                value = np.array(value, dtype=np.dtype(name_of[0]))
        built[name] = value
    return STORE.types[kind](**built)


def through_ros(kind: str, fields: Mapping[str, Any]) -> Any:
    """The message after a journey through ROS 2's serialization."""
    return STORE.deserialize_cdr(STORE.serialize_cdr(message(kind, fields), kind), kind)


@pytest.fixture(scope="module")
def plan(planner: graspd.Planner, frame: graspd.DepthFrame) -> graspd.Plan:
    return planner.plan(frame, hand="leap", options=graspd.PlanOptions(seed=1))


def matrix_of(pose: Any) -> np.ndarray[Any, Any]:
    p, q = pose.position, pose.orientation
    return graspd.pose([p.x, p.y, p.z], [q.x, q.y, q.z, q.w])


def test_moveit_takes_a_grasp(plan: graspd.Plan) -> None:
    for i, (fields, grasp) in enumerate(zip(ros.moveit_grasps(plan, retreat=0.2), plan, strict=True)):
        sent = through_ros("moveit_msgs/msg/Grasp", fields)
        assert sent.id == f"leap_{i}" and sent.grasp_quality == grasp.score
        assert sent.grasp_pose.header.frame_id == "table"
        assert np.allclose(matrix_of(sent.grasp_pose.pose), grasp.pose, atol=1e-9)
        assert sent.pre_grasp_posture.joint_names == list(grasp.joints.names)
        assert np.array_equal(sent.pre_grasp_posture.points[0].positions, grasp.joints.array("open"))
        assert np.array_equal(sent.grasp_posture.points[0].positions, grasp.joints.array("squeezed"))
        approach = sent.pre_grasp_approach
        v = approach.direction.vector
        way = np.array([v.x, v.y, v.z]) * approach.desired_distance
        assert np.allclose(grasp.pregrasp_pose[:3, 3] + way, grasp.pose[:3, 3], atol=1e-6)
        assert sent.post_grasp_retreat.direction.vector.z == 1
        assert np.isclose(sent.post_grasp_retreat.desired_distance, 0.2)


def test_other_messages(plan: graspd.Plan) -> None:
    when = datetime(2026, 1, 2, 3, 4, 5, 678901, tzinfo=timezone.utc)
    grasp = plan.best
    stamped = through_ros("geometry_msgs/msg/PoseStamped", ros.pose_stamped(grasp.pose, "table", when))
    assert stamped.header.stamp.sec == int(when.timestamp()) and stamped.header.stamp.nanosec == 678901000
    placed = through_ros(
        "geometry_msgs/msg/TransformStamped", ros.transform_stamped(grasp.pose, "table", grasp.wrist_link)
    )
    assert (placed.header.frame_id, placed.child_frame_id) == ("table", grasp.wrist_link)
    assert np.isclose(placed.transform.translation.x, grasp.pose[0, 3])
    assert np.isclose(placed.transform.rotation.w, matrix_quaternion(grasp.pose)[3])
    poses = through_ros("geometry_msgs/msg/PoseArray", ros.pose_array(plan))
    assert len(poses.poses) == len(plan)
    joints = through_ros("sensor_msgs/msg/JointState", ros.joint_state(grasp, "contact"))
    assert dict(zip(joints.name, joints.position, strict=True)) == dict(grasp.joints.contact)
    steps = through_ros("trajectory_msgs/msg/JointTrajectory", ros.joint_trajectory(grasp, ["open", "squeezed"], 0.75))
    assert [(p.time_from_start.sec, p.time_from_start.nanosec) for p in steps.points] == [
        (0, 750000000),
        (1, 500000000),
    ]
    with pytest.raises(ValueError, match="moment: found 'later'"):
        ros.joint_state(grasp, "later")  # type: ignore[arg-type]


def matrix_quaternion(matrix: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    return np.asarray(Rotation.from_matrix(matrix[:3, :3].copy()).as_quat(canonical=True))


def camera(encoding: str, pixels: np.ndarray[Any, Any], padding: int = 0) -> tuple[dict[str, Any], dict[str, Any]]:
    height, width = pixels.shape
    rows = pixels.view(np.uint8).reshape(height, -1)
    data = np.hstack([rows, np.zeros((height, padding), np.uint8)])
    image = {
        "header": {"stamp": {"sec": 12, "nanosec": 500000000}, "frame_id": "eye"},
        "height": height,
        "width": width,
        "encoding": encoding,
        "is_bigendian": int(pixels.dtype.byteorder == ">"),
        "step": data.shape[1],
        "data": data.tobytes(),
    }
    info = {"k": [600, 0, 3, 0, 601, 2, 0, 0, 1], "d": [0.0] * 5, "distortion_model": "plumb_bob"}
    return image, info


def test_camera_messages_become_frames(planner: graspd.Planner) -> None:
    millimetres = np.arange(12, dtype=np.uint16).reshape(3, 4)
    for image, info in (
        camera("16UC1", millimetres),
        camera("16UC1", millimetres, padding=6),
        camera("mono16", millimetres.astype(">u2")),
    ):
        frame = ros.depth_frame(image, info)
        assert np.array_equal(frame.depth, millimetres) and frame.camera_frame == "eye"
        assert frame.intrinsics == graspd.Intrinsics(600, 601, 3, 2)
        assert frame.capture_time == datetime(1970, 1, 1, 0, 0, 12, 500000, tzinfo=timezone.utc)
    image, info = camera("32FC1", millimetres.astype(np.float32))
    header = SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0), frame_id="")
    as_objects = SimpleNamespace(**{**image, "header": header})
    frame = ros.depth_frame(as_objects, SimpleNamespace(**{**info, "d": [0.1, 0, 0, 0, 0.2]}))
    assert frame.metres().dtype == np.float32 and frame.capture_time is None and frame.camera_frame == "camera"
    assert frame.intrinsics.distortion == (0.1, 0, 0, 0, 0.2)
    # ROS 1's names.
    assert ros.intrinsics({"K": info["k"], "D": [], "distortion_model": ""}).distortion == ()

    depth, lens = graspd.examples.box_on_table()
    image, info = camera("16UC1", depth)
    info["k"] = lens.matrix.ravel().tolist()
    assert len(planner.plan(ros.depth_frame(image, info), hand="panda")) > 0


def test_camera_messages_that_cannot_be_read_are_refused_by_name() -> None:
    image, info = camera("16UC1", np.zeros((3, 4), np.uint16))
    changes: list[tuple[dict[str, Any], str]] = [
        ({"encoding": "rgb8"}, "image.encoding: found 'rgb8'"),
        ({"data": b"short"}, "image.data: found 5 bytes"),
        ({"step": 7}, "image.data: found"),
    ]
    for changed, said in changes:
        with pytest.raises(ValueError, match=said):
            ros.depth_frame({**image, **changed}, info)
    with pytest.raises(ValueError, match="distortion_model: found 'equidistant'"):
        ros.intrinsics({**info, "d": [0.1, 0, 0, 0], "distortion_model": "equidistant"})
    with pytest.raises(ValueError, match="found no such field"):
        ros.depth_frame({}, info)
    with pytest.raises(ValueError, match="found no k or no d"):
        ros.intrinsics({})


def test_scipy_rotations(plan: graspd.Plan) -> None:
    for grasp in plan:
        rotation = to_scipy.rotation(grasp.pose)
        assert np.allclose(rotation.as_matrix(), grasp.pose[:3, :3])
        assert np.allclose(to_scipy.pose_of(rotation, grasp.pose[:3, 3]), grasp.pose)
    with pytest.raises(ValueError, match="no rigid motion"):
        to_scipy.rotation(np.zeros((4, 4)))
