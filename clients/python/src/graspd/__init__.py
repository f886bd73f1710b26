"""graspd: a depth frame in, ranked grasps out, for any robotic hand.

    import graspd

    depth, intrinsics = graspd.examples.box_on_table()
    with graspd.connect() as planner:
        plan = planner.plan(depth, intrinsics, hand="leap")
    for grasp in plan:
        print(grasp.score, grasp.pose, grasp.joints.contact)

`graspd.aio` is the same with `await`; `graspd.convert` turns grasps into what ROS, scipy and trimesh take;
`graspd.plot` and `graspd.rerun_log` draw them. Metres, radians, seconds; `a_from_b` takes coordinates in b to
coordinates in a.
"""

from graspd import examples
from graspd._version import __version__
from graspd.calls import Stream
from graspd.cancellation import Cancellation
from graspd.client import Planner, connect
from graspd.connection import Tls
from graspd.errors import (
    AlreadyExistsError,
    CallError,
    CancelledError,
    ConnectError,
    DeadlineExceededError,
    FailedPreconditionError,
    GraspdError,
    InternalError,
    InvalidArgumentError,
    NotFoundError,
    PermissionDeniedError,
    ProtocolError,
    ResourceExhaustedError,
    UnauthenticatedError,
    UnavailableError,
    UnimplementedError,
    VersionError,
    Violation,
)
from graspd.frames import DepthFrame, Intrinsics
from graspd.hands import CreatedHand, Hand, HandGeometry
from graspd.options import Box, Placement, PlanOptions, SceneOptions, TargetPoint
from graspd.outcomes import Outcome
from graspd.plans import (
    Accepted,
    Contact,
    Finished,
    Grasp,
    Improved,
    Moment,
    MultiPlan,
    NoGrasp,
    NoGraspError,
    Plan,
    PlanEvent,
    PlanStats,
    Postures,
    TaskResult,
)
from graspd.poses import inverse, pose, transform
from graspd.reading import ContactField, SceneReading
from graspd.requests import HandTask
from graspd.retry import RetryPolicy
from graspd.servo import HandPosture, ServoAnswer, ServoCounters, ServoOptions
from graspd.servo_stream import Servo
from graspd.versions import ServerInfo

__all__ = [
    "Accepted",
    "AlreadyExistsError",
    "Box",
    "CallError",
    "Cancellation",
    "CancelledError",
    "ConnectError",
    "Contact",
    "ContactField",
    "CreatedHand",
    "DeadlineExceededError",
    "DepthFrame",
    "FailedPreconditionError",
    "Finished",
    "Grasp",
    "GraspdError",
    "Hand",
    "HandGeometry",
    "HandPosture",
    "HandTask",
    "Improved",
    "InternalError",
    "Intrinsics",
    "InvalidArgumentError",
    "Moment",
    "MultiPlan",
    "NoGrasp",
    "NoGraspError",
    "NotFoundError",
    "Outcome",
    "PermissionDeniedError",
    "Placement",
    "Plan",
    "PlanEvent",
    "PlanOptions",
    "PlanStats",
    "Planner",
    "Postures",
    "ProtocolError",
    "ResourceExhaustedError",
    "RetryPolicy",
    "SceneOptions",
    "SceneReading",
    "ServerInfo",
    "Servo",
    "ServoAnswer",
    "ServoCounters",
    "ServoOptions",
    "Stream",
    "TargetPoint",
    "TaskResult",
    "Tls",
    "UnauthenticatedError",
    "UnavailableError",
    "UnimplementedError",
    "VersionError",
    "Violation",
    "__version__",
    "connect",
    "examples",
    "inverse",
    "pose",
    "transform",
]
