"""What planning gives back: ranked grasps with their postures and contacts, figures, and why there is nothing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Literal, TypeAlias, overload

import numpy as np

from graspd.errors import CallError, GraspdError, ProtocolError
from graspd.poses import Array
from graspd.v1 import planner_service_pb2

Moment: TypeAlias = Literal["pregrasp", "open", "contact", "squeezed"]
"""A moment of a grasp: before the approach, arrived with the hand open, touching, pressing."""


@dataclass(frozen=True, eq=False)
class Postures:
    """Positions by name at the three moments of a grasp; radians, or metres of sliding joints."""

    open: Mapping[str, float]
    """At the pre-grasp and during the approach."""
    contact: Mapping[str, float]
    """When the pads touch."""
    squeezed: Mapping[str, float]
    """What to command so that the fingers press: beyond contact, towards closed."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names, in the order of the hand."""
        return tuple(self.contact)

    def at(self, moment: Moment) -> Mapping[str, float]:
        """The positions at a moment; at the pre-grasp the hand is open."""
        by_moment = {
            "pregrasp": self.open,
            "open": self.open,
            "contact": self.contact,
            "squeezed": self.squeezed,
        }
        if moment not in by_moment:
            raise ValueError(f"moment: found {moment!r}, expected one of {', '.join(by_moment)}")
        return by_moment[moment]

    def array(self, moment: Moment) -> Array:
        """The positions at a moment as an array, in the order of `names`."""
        return np.array(list(self.at(moment).values()))


@dataclass(frozen=True, eq=False)
class Contact:
    """An expected contact."""

    point: Array
    """Point (3), metres, world frame."""
    normal: Array
    """Outward normal of the object (3), world frame, unit length."""
    pad: str
    """The hand's pad that touches there."""
    finger: str
    """The finger that the pad belongs to."""
    link: str
    """The link that carries the pad."""
    certainty: float
    """Certainty of the contact field there, 0 to 1."""


@dataclass(frozen=True)
class ScoreParts:
    """The parts of a score, each 0 to 1, larger is better."""

    objective: float
    """From the optimized objective."""
    force_closure: float
    """From the force-closure margin, times how squarely two of the touched surfaces face away from each other."""
    clearance: float
    """Room around the hand, outside its contacts, at the grasp and on the approach."""
    certainty: float
    """Mean certainty of the contacts."""


@dataclass(frozen=True)
class ObjectiveTerms:
    """The unweighted terms of the objective, smaller is better."""

    contact_distance: float
    """Distance of the contact candidates to the nearest focal contacts."""
    certainty: float
    """Lack of certainty at the contact candidates."""
    orientation: float
    """Mismatch of pad normals and contact orientations."""
    centroid: float
    """Distance of the mean contact to the nearest centred centroid."""
    independence: float
    """Lack of linear independence of the contact wrenches."""
    net_wrench: float
    """Net wrench."""
    approach: float
    """Departure from the reaching direction."""
    joint_limits: float
    """Joints beyond their limits."""
    coupling: float
    """Soft couplings of adaptive fingers."""
    penetration: float
    """Penetration of the scene, the table, keep-out boxes and the hand itself."""
    total: float
    """The weighted sum."""


@dataclass(frozen=True, eq=False)
class Grasp:
    """A ranked grasp. Its poses are those of the hand's root link, which `wrist_link` names."""

    wrist_link: str
    """The hand's root link."""
    frame_id: str
    """Name of the world frame; the camera's where the frames had no pose."""
    pose: Array
    """Pose of the root link at the grasp, world_from_hand, 4 × 4."""
    pregrasp_pose: Array
    """Pose before the approach, world_from_hand; the straight line from here to `pose` is free of collision."""
    camera_frame_id: str
    """Name of the optical frame of the first camera."""
    pose_in_camera: Array
    """Pose at the grasp, camera_from_hand."""
    pregrasp_pose_in_camera: Array
    """Pose before the approach, camera_from_hand."""
    joints: Postures
    """Joint positions."""
    actuators: Postures
    """Actuator positions: what to command."""
    contacts: tuple[Contact, ...]
    """Expected contacts."""
    score: float
    """Probability that the hand lifts the object and keeps it, 0 to 1, in simulation or as the site has learned it."""
    score_parts: ScoreParts
    """What the score is made of."""
    objective: ObjectiveTerms
    """The optimized objective."""
    epsilon: float
    """Ferrari-Canny margin: the smallest wrench that breaks the grasp, per newton of grip; 0 without force closure."""
    clearance: float
    """Smallest distance between the hand, outside its contacts, and everything else, metres; may be slightly
    negative."""
    centroid: Array
    """Predicted centroid of the grasped object (3), world frame."""
    jaw_width: float | None
    """Distance between the opposed contacts, metres; only for hands with two fingers."""
    label: int | None
    """Label of the grasped object, where the frames had labels."""
    better_not: bool = False
    """The score is under 0.5: likelier lost than kept. Look again, or with more candidates, before trying it."""

    @property
    def contact_points(self) -> Array:
        """Contact points (n × 3), world frame."""
        return np.array([c.point for c in self.contacts]).reshape(-1, 3)

    @property
    def contact_normals(self) -> Array:
        """Outward normals of the object at the contacts (n × 3), world frame."""
        return np.array([c.normal for c in self.contacts]).reshape(-1, 3)

    def pose_at(self, moment: Moment) -> Array:
        """Pose of the root link at a moment, world_from_hand."""
        self.joints.at(moment)
        return self.pregrasp_pose if moment == "pregrasp" else self.pose

    @property
    def approach(self) -> Array:
        """The straight motion from the pre-grasp to the grasp (3), world frame, metres."""
        motion: Array = self.pose[:3, 3] - self.pregrasp_pose[:3, 3]
        return motion


@dataclass(frozen=True)
class NoGrasp:
    """Why there is no grasp, and what would help most."""

    reason: str
    """Machine readable, for example `empty_table` or `hand_too_small`; `unspecified` for one newer than this client."""
    nearest_fix: str
    """For people: the nearest fix with its figures."""


class NoGraspError(GraspdError, LookupError):
    """Raised by `Plan.best` where there is no grasp."""

    def __init__(self, no_grasp: NoGrasp) -> None:
        super().__init__(f"no grasp ({no_grasp.reason}): {no_grasp.nearest_fix}")
        self.no_grasp = no_grasp


@dataclass(frozen=True, eq=False)
class Workspace:
    """The volume that was looked at."""

    pose: Array
    """Pose of the volume frame (origin at a lower corner of the cube, z up), world frame."""
    size: float
    """Edge of the cube, metres."""
    resolution: int
    """Voxels along each edge."""
    table_height: float | None
    """Height of the table top in the volume, metres along its z; None when there is no table."""


@dataclass(frozen=True)
class PlanStats:
    """Figures of one plan. Durations are in seconds."""

    total: float
    """From the arrival of the request to the answer."""
    queue: float
    """Time that the work waited for a free core."""
    stages: Mapping[str, float]
    """Time of each stage, in the order of the pipeline."""
    rejected: Mapping[str, int]
    """Candidates that did not become a grasp, by reason."""
    candidates: int
    """Candidates started."""
    iterations: int
    """Iterations that every candidate completed."""
    focal_contacts: int
    """Focal contacts, N_fc."""
    focal_centroids: int
    """Focal centroids, N_fe."""
    centered_centroids: int
    """Centred centroids, N_ee."""
    budget_exhausted: bool
    """Planning stopped at its budget or deadline: more time could give more."""
    estimator: str
    """Contact estimator that was used."""
    hand_revision: str
    """Revision of the hand's description."""
    seed: int
    """Seed that was used."""
    invalid_pixels: int
    """Infinite or negative depth pixels, which were read as no return."""


@dataclass(frozen=True, eq=False)
class Plan(Sequence[Grasp]):
    """Ranked grasps of one hand, best first. A plan without any is no error: `no_grasp` says why."""

    hand: str
    """The hand's id, for example `leap`."""
    grasps: tuple[Grasp, ...]
    """Best first."""
    no_grasp: NoGrasp | None
    """Set exactly when there is no grasp."""
    workspace: Workspace | None
    """The volume that was looked at."""
    stats: PlanStats
    """What was done."""
    trace: tuple[ObjectiveTerms, ...] = ()
    """With `PlanOptions.trace`: for each iteration the terms of the candidate that ended best."""
    capture_time: datetime | None = None
    """That of the first frame."""
    message: planner_service_pb2.PlanGraspsResponse = field(
        default_factory=planner_service_pb2.PlanGraspsResponse, repr=False
    )
    """The answer as it came."""

    @property
    def best(self) -> Grasp:
        """The best grasp.

        Raises:
            NoGraspError: If there is none; it says why and what would help.
        """
        if not self.grasps:
            raise NoGraspError(self.no_grasp or NoGrasp("unspecified", "the server gives no reason"))
        return self.grasps[0]

    @overload
    def __getitem__(self, index: int) -> Grasp: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Grasp, ...]: ...
    def __getitem__(self, index: int | slice) -> Grasp | tuple[Grasp, ...]:
        return self.grasps[index]

    def __len__(self) -> int:
        return len(self.grasps)

    def __iter__(self) -> Iterator[Grasp]:
        return iter(self.grasps)

    def __repr__(self) -> str:
        found = f"{len(self)} grasps, best {self[0].score:.2f}" if self.grasps else repr(self.no_grasp)
        return f"<Plan of {self.hand}: {found}>"


@dataclass(frozen=True)
class Accepted:
    """The work is queued."""

    queue_position: int
    """Jobs before it."""


@dataclass(frozen=True, eq=False)
class Improved:
    """A better set was found."""

    plan: Plan
    """The set."""


@dataclass(frozen=True, eq=False)
class Finished:
    """The last word."""

    plan: Plan
    """What `plan` would have given."""


PlanEvent: TypeAlias = Accepted | Improved | Finished
"""What a stream of grasps tells."""


@dataclass(frozen=True, eq=False)
class TaskResult:
    """How the work for one hand ended: with a plan, or an error that leaves the other hands alone."""

    task_id: str
    """As asked: the hand's id, or what the caller named it."""
    plan: Plan | None
    """The plan."""
    error: CallError | None
    """Why there is none."""

    def get(self) -> Plan:
        """The plan.

        Raises:
            CallError: If the work failed.
        """
        if self.plan is None:
            raise self.error or ProtocolError(f"task {self.task_id!r} has neither a plan nor an error")
        return self.plan


@dataclass(frozen=True, eq=False)
class MultiPlan(Mapping[str, TaskResult]):
    """The plans of several hands in one scene, by task, in the order of the question."""

    results: Mapping[str, TaskResult]
    """One for each task."""
    total: float
    """Seconds from the arrival of the request to its last message."""

    @property
    def plans(self) -> dict[str, Plan]:
        """The plans of the tasks that were planned."""
        return {task: r.plan for task, r in self.results.items() if r.plan is not None}

    @property
    def errors(self) -> dict[str, CallError]:
        """The errors of the tasks that failed."""
        return {task: r.error for task, r in self.results.items() if r.error is not None}

    def ranked(self) -> list[tuple[str, Grasp]]:
        """All grasps with their tasks, best score first.

        Scores rank the grasps of one hand; between hands they are no more than a first guess.
        """
        every = [(task, grasp) for task, plan in self.plans.items() for grasp in plan]
        return sorted(every, key=lambda pair: -pair[1].score)

    def __getitem__(self, task_id: str) -> TaskResult:
        return self.results[task_id]

    def __iter__(self) -> Iterator[str]:
        return iter(self.results)

    def __len__(self) -> int:
        return len(self.results)
