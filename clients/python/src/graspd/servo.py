"""One grasp carried on from frame to frame: how it is followed, frames with their numbers, answers."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from graspd.answers import grasp_from_wire, placed
from graspd.errors import ProtocolError
from graspd.frames import DepthFrame
from graspd.hands import HandLike, hand_name
from graspd.options import PlanOptions, SceneOptions
from graspd.plans import Grasp
from graspd.poses import Array, pose_to_wire
from graspd.v1 import servo_service_pb2 as wire

ServoMode: TypeAlias = Literal["dynamic", "static"]
"""Every frame refines the grasp; or the first frame decides, for comparison."""
ServoState: TypeAlias = Literal["tracking", "replanning", "lost"]
"""Follow the stand-off's pose; come no nearer than it; or stay, or retreat: there is nothing to follow."""

_MODES = {"dynamic": wire.SERVO_MODE_DYNAMIC, "static": wire.SERVO_MODE_STATIC}
_STATES: dict[int, ServoState] = {
    wire.SERVO_STATE_TRACKING: "tracking",
    wire.SERVO_STATE_REPLANNING: "replanning",
    wire.SERVO_STATE_LOST: "lost",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class ServoOptions:
    """How a grasp is followed. What is left out takes the server's documented default."""

    mode: ServoMode = "dynamic"
    """What becomes of frames after the first."""
    iterations_per_frame: int = 0
    """Iterations for each frame, 1 to 100; 0 means 3."""
    standoff_start: float | None = None
    """Distance from the grasp at which the approach begins, metres, 0.01 to 0.5; 0.15 by default."""
    standoff_end: float | None = None
    """Distance from which the hand goes straight in, metres, 0 to `standoff_start`; 0.05 by default."""
    standoff_speed: float | None = None
    """How fast the stand-off shrinks, metres per second, 0.001 to 1; 0.06 by default."""
    max_change: float | None = None
    """Largest change of the grasp between answers while it is tracked, metres, 0.0001 to 0.1; 0.008 by default."""
    max_change_angle: float | None = None
    """The same for its orientation, radians, 0.001 to 3.2; 0.06 by default."""
    camera_max_speed: float | None = None
    """A camera that has gone faster since the frame before is not believed, metres per second; 2 by default."""
    camera_max_turn: float | None = None
    """The same for turning, radians per second; 6 by default."""
    hand_from_camera: ArrayLike | None = None
    """Pose of the optical frame in the hand's root frame, 4 × 4, for a camera that the hand carries: what it sees of
    the hand is then not taken for an object."""


@dataclass(frozen=True, eq=False)
class HandPosture:
    """Where a hand was when a frame was taken."""

    pose: ArrayLike
    """Pose of the hand's root link, world_from_hand, 4 × 4."""
    joints: Sequence[float] | Mapping[str, float] = ()
    """Joint positions in the order of `Hand.joints`, for example a grasp's `joints.open`; empty: open."""


@dataclass(frozen=True)
class ServoCounters:
    """What became of a stream's frames."""

    answered: int
    """Frames that were answered."""
    superseded: int
    """Frames that the server replaced by a newer one before it looked at them."""
    late: int
    """Frames that were older than one that was answered."""
    repeated: int
    """Frames that came twice."""
    wild: int
    """Frames from where the camera cannot have gone."""
    invalid: int
    """Frames that cannot be read."""
    shed: int
    """Frames for which the server had no room."""
    replanned: int
    """Times that another grasp was announced, the first included."""


@dataclass(frozen=True, eq=False)
class ServoAnswer:
    """The answer to a frame."""

    sequence: int
    """Number of the frame that this answers."""
    state: ServoState
    """What the robot should do."""
    reason: str
    """Why it is replanning or lost, for example `first`, `better`, `target_moved`, `hidden`; empty while tracking."""
    grasp: Grasp | None
    """The grasp; while it is searched anew or lost the last one there was. None where there never was one."""
    settled: bool
    """False while the grasp is on its way to a better one, or is held though the newest frame speaks against it."""
    go: bool
    """True when the hand may go straight in and grip."""
    standoff: float
    """Distance from the grasp, against the approach, at which the hand should be now, metres."""
    standoff_pose: Array | None
    """Pose of the hand's root link there, world_from_hand, 4 × 4; None without a grasp."""
    change: float
    """By how much the grasp differs from that of the answer before, metres, in the middle of the contacts."""
    change_angle: float
    """The same for its orientation, radians."""
    visible_share: float
    """Share of the target's place in the picture that shows something, 0 to 1."""
    age: float
    """From the arrival of the frame at the server until the answer left, seconds."""
    counters: ServoCounters
    """Counted since the stream began."""
    refused: str
    """Why the last frame that was not looked at was refused; empty if there was none since the answer before."""
    stages: Mapping[str, float]
    """Time of each stage, seconds."""
    capture_time: datetime | None = None
    """That of the frame."""
    message: wire.ServoGraspResponse = field(default_factory=wire.ServoGraspResponse, repr=False)
    """The answer as it came."""


def servo_config(
    hand: HandLike,
    servo_options: ServoOptions | None,
    options: PlanOptions | None,
    scene_options: SceneOptions | None,
) -> wire.ServoGraspRequest:
    """The first message of a stream.

    Raises:
        ValueError: If an option cannot be what it should be.
    """
    s = servo_options or ServoOptions()
    if s.mode not in _MODES:
        raise ValueError(f"mode: found {s.mode!r}, expected one of {', '.join(_MODES)}")
    config = wire.ServoConfig(
        hand=hand_name(hand),
        scene_options=None if scene_options is None else scene_options.to_wire(),
        options=None if options is None else options.to_wire(),
        mode=_MODES[s.mode],
        iterations_per_frame=s.iterations_per_frame,
        standoff_start_m=s.standoff_start,
        standoff_end_m=s.standoff_end,
        standoff_speed_m_s=s.standoff_speed,
        max_change_m=s.max_change,
        max_change_rad=s.max_change_angle,
        camera_max_speed_m_s=s.camera_max_speed,
        camera_max_turn_rad_s=s.camera_max_turn,
        hand_from_camera=(None if s.hand_from_camera is None else pose_to_wire(s.hand_from_camera, "hand_from_camera")),
    )
    return wire.ServoGraspRequest(config=config)


class Numbers:
    """Numbers of a stream's frames: they rise."""

    def __init__(self) -> None:
        self._last = 0

    def message(self, frame: DepthFrame, hand: HandPosture | None, sequence: int | None) -> wire.ServoGraspRequest:
        """A frame as a message; without a number it gets the next one.

        Raises:
            ValueError: If the frame has no pose, or the number does not rise.
        """
        if frame.camera_pose is None:
            raise ValueError("frame: found no camera_pose, expected one on every frame of a servo")
        number = self._last + 1 if sequence is None else sequence
        if number <= self._last:
            raise ValueError(f"sequence: found {number}, expected more than {self._last}, the one before")
        message = wire.ServoFrame(sequence=number, frame=frame.to_wire())
        if hand is not None:
            joints = hand.joints.values() if isinstance(hand.joints, Mapping) else hand.joints
            message.hand.CopyFrom(
                wire.HandPosture(
                    wrist_pose=pose_to_wire(hand.pose, "hand.pose"),
                    joint_positions=np.asarray(list(joints), dtype=np.float64).tolist(),
                )
            )
        self._last = number
        return wire.ServoGraspRequest(frame=message)


def answer_from_wire(message: wire.ServoGraspResponse) -> ServoAnswer:
    """An answer from its message.

    Raises:
        ProtocolError: If the server left out what the protocol promises.
    """
    state = _STATES.get(message.state)
    if state is None:
        raise ProtocolError(f"the servo state {message.state} is none that this client knows")
    counted = message.counters
    counters = {f.name: getattr(counted, f"{f.name}_count") for f in dataclasses.fields(ServoCounters)}
    has_place = message.HasField("standoff_pose")
    return ServoAnswer(
        sequence=message.sequence,
        state=state,
        reason=message.reason,
        grasp=grasp_from_wire(message.grasp) if message.HasField("grasp") else None,
        settled=message.settled,
        go=message.go,
        standoff=message.standoff_m,
        standoff_pose=placed(message.standoff_pose, "standoff_pose")[1] if has_place else None,
        change=message.change_m,
        change_angle=message.change_rad,
        visible_share=message.visible_share,
        age=message.age.ToNanoseconds() * 1e-9,
        counters=ServoCounters(**counters),
        refused=message.refused,
        stages={stage.name: stage.duration.ToNanoseconds() * 1e-9 for stage in message.stages},
        capture_time=message.capture_time.ToDatetime(timezone.utc) if message.HasField("capture_time") else None,
        message=message,
    )
