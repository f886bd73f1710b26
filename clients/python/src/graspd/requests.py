"""Questions as messages: what the synchronous and the asynchronous client send alike."""

from __future__ import annotations

import uuid
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from graspd.frames import DepthFrame, Frames, IntrinsicsLike, as_frames
from graspd.hands import HandLike, hand_id, hand_name
from graspd.options import PlanOptions, SceneOptions
from graspd.retry import RetryPolicy
from graspd.v1 import frame_pb2
from graspd.v1 import planner_service_pb2 as wire

Scene: TypeAlias = Frames | NDArray[np.generic] | bytes
"""What a camera sees: a depth array or a PNG file's bytes (with its intrinsics beside it), a frame, or frames."""


@dataclass(frozen=True, eq=False)
class HandTask:
    """Work for one hand with options of its own."""

    hand: HandLike
    """The hand."""
    options: PlanOptions | None = None
    """How grasps are searched; None means as for the other hands."""


Hands: TypeAlias = Iterable[HandLike] | Mapping[str, HandLike | HandTask]
"""Hands, whose ids name the tasks; or tasks by names of the caller's, for example `{"arm_left": "leap"}`."""


def plan_request(
    scene: Scene,
    intrinsics: IntrinsicsLike | None,
    hand: HandLike,
    options: PlanOptions | None,
    scene_options: SceneOptions | None,
    request_id: str,
) -> wire.PlanGraspsRequest:
    """The question for one hand."""
    return wire.PlanGraspsRequest(
        hand=hand_name(hand),
        frames=frames(scene, intrinsics),
        scene_options=None if scene_options is None else scene_options.to_wire(),
        options=None if options is None else options.to_wire(),
        request_id=request_id,
    )


def multi_hand_request(
    scene: Scene,
    intrinsics: IntrinsicsLike | None,
    hands: Hands,
    options: PlanOptions | None,
    scene_options: SceneOptions | None,
    request_id: str,
) -> wire.PlanMultiHandRequest:
    """The question for several hands."""
    tasks: list[tuple[str, HandTask]] = []
    if isinstance(hands, str):
        raise TypeError(f"hands: found the text {hands!r}, expected a list of hands")
    if isinstance(hands, Mapping):
        tasks += [(name, h if isinstance(h, HandTask) else HandTask(h)) for name, h in hands.items()]
    else:
        tasks += [(hand_id(h), HandTask(h)) for h in hands]
    names = [name for name, _ in tasks]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"hands: found {twice} more than once; name the tasks: hands={{'left': ..., 'right': ...}}")

    def message(name: str, task: HandTask) -> wire.HandTask:
        own = task.options or options
        return wire.HandTask(task_id=name, hand=hand_name(task.hand), options=None if own is None else own.to_wire())

    return wire.PlanMultiHandRequest(
        frames=frames(scene, intrinsics),
        scene_options=None if scene_options is None else scene_options.to_wire(),
        tasks=[message(name, task) for name, task in tasks],
        request_id=request_id,
    )


def chosen_id(request_id: str | None, policy: RetryPolicy) -> str:
    """The id of a call: the caller's, else a new one where the call may be repeated."""
    if request_id is not None:
        return request_id
    return uuid.uuid4().hex if policy.attempts > 1 else ""


def frames(scene: Scene, intrinsics: IntrinsicsLike | None) -> list[frame_pb2.DepthFrame]:
    """A scene's frames as messages."""
    seen: list[DepthFrame] = as_frames(scene, intrinsics)
    return [frame.to_wire() for frame in seen]
