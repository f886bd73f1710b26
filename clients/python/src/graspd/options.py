"""What a caller may ask for. Everything is optional: what is left out takes the server's documented default."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

from numpy.typing import ArrayLike

from graspd.poses import pose_to_wire, vector_to_wire
from graspd.v1 import options_pb2 as wire

_VOLUMES = {"tsdf": wire.VOLUME_KIND_TSDF, "occupancy": wire.VOLUME_KIND_OCCUPANCY}
_REACHING = {
    "top_down": wire.REACHING_TOP_DOWN,
    "camera_ray": wire.REACHING_CAMERA_RAY,
    "free": wire.REACHING_FREE,
}

_PRIORITIES = {
    "low": wire.PRIORITY_LOW,
    "normal": wire.PRIORITY_NORMAL,
    "high": wire.PRIORITY_HIGH,
    "servo": wire.PRIORITY_SERVO,
}

Priority: TypeAlias = Literal["low", "normal", "high", "servo"]
"""Work that may wait; the default; a robot stands still until it is answered; a correction of a motion under way."""
Reaching: TypeAlias = Literal["top_down", "camera_ray", "free"]
"""Straight down onto the table; along the camera's ray to what it sees; or any direction within 1.3 rad of down."""


@dataclass(frozen=True, eq=False)
class Box:
    """A box: where the hand must not be, or where things may be grasped."""

    pose: ArrayLike
    """Pose of its centre in the world frame, 4 × 4."""
    half_extents: ArrayLike
    """Half extents along its axes, metres."""


@dataclass(frozen=True, eq=False)
class TargetPoint:
    """Whatever is near a point."""

    point: ArrayLike
    """Point in the world frame, metres."""
    radius: float
    """Metres."""


@dataclass(frozen=True, eq=False)
class Placement:
    """A volume placed by the caller: a cube with an edge of `SceneOptions.volume_size`."""

    pose: ArrayLike
    """Pose of the volume frame in the world frame: its origin is a lower corner of the cube, z points up. 4 × 4."""
    table_height: float | None = None
    """Height of the table top in the volume, metres along its z. None: graspd looks for a table."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SceneOptions:
    """How the scene is read; shared by all hands of a question."""

    volume: Literal["tsdf", "occupancy"] = "tsdf"
    """`occupancy` takes everything that was not seen to be free as solid, shadows behind objects too."""
    estimator: str = ""
    """Contact estimator by name; empty means the server's default. `ServerInfo.estimators` names them."""
    placement: Placement | None = None
    """Where the volume stands. None: graspd finds the table and stands the volume on it."""
    grasp_region: Box | None = None
    """Where things may be grasped: what stands outside stays an obstacle. None: anywhere in the volume."""
    focal_contact_threshold: float | None = None
    """Focal contacts exceed this share of the largest contact certainty, 0 to 1; 0.7 by default."""
    focal_centroid_threshold: float | None = None
    """Focal centroids exceed this share of the largest centroid likelihood, 0 to 1; 0.95 by default."""
    volume_size: float | None = None
    """Edge of the volume, metres, 0.1 to 2; 0.4 by default."""
    volume_resolution: int = 0
    """Voxels along each edge, 16 to 128; 0 means 80."""

    def to_wire(self) -> wire.SceneOptions:
        """The options as a message."""
        if self.volume not in _VOLUMES:
            raise ValueError(f"volume: found {self.volume!r}, expected one of {', '.join(_VOLUMES)}")
        message = wire.SceneOptions(
            volume_kind=_VOLUMES[self.volume],
            estimator=self.estimator,
            focal_contact_threshold=self.focal_contact_threshold,
            focal_centroid_threshold=self.focal_centroid_threshold,
            volume_size_m=self.volume_size,
            volume_resolution=self.volume_resolution,
        )
        if self.placement is not None:
            message.workspace.CopyFrom(
                wire.WorkspacePlacement(
                    pose=pose_to_wire(self.placement.pose, "placement.pose"),
                    table_height_m=self.placement.table_height,
                )
            )
        if self.grasp_region is not None:
            message.grasp_region.CopyFrom(
                wire.GraspRegion(
                    pose=pose_to_wire(self.grasp_region.pose, "grasp_region.pose"),
                    half_extents_m=vector_to_wire(self.grasp_region.half_extents, "grasp_region.half_extents"),
                )
            )
        return message


@dataclass(frozen=True, kw_only=True, eq=False)
class PlanOptions:
    """How grasps of one hand are searched."""

    max_grasps: int = 0
    """At most this many grasps, 1 to 1000; 0 means 10."""
    budget: float | None = None
    """Stop after so many seconds and answer with the best so far, even if the call's timeout is later."""
    seed: int = 0
    """Same seed, frames, options and hand revision: same answer, if the budget was not hit."""
    target: int | TargetPoint | None = None
    """What to grasp: an object's number in `DepthFrame.labels`, or whatever is near a point. None: anything."""
    keep_out: Sequence[Box] = ()
    """Where the hand must not be, in addition to what the camera sees; at most 64 boxes."""
    reaching: Reaching | ArrayLike = "top_down"
    """Along which direction the hand reaches: by name, or a vector in the world frame."""
    max_tilt: float | None = None
    """Largest angle between the hand's approach axis and the reaching direction, radians. 0 leaves only the rotation
    about it (a 4-axis SCARA); by default pi/3, and 1.3 where reaching is free."""
    roll: tuple[float, float] | None = None
    """Allowed rotation about the reaching direction, from and to, radians; see `RollRange` of the protocol. By default
    any."""
    min_score: float | None = None
    """Grasps that score less are left out, 0 to 1; 0 by default."""
    friction: float | None = None
    """Coulomb friction between pads and objects, more than 0, at most 5; 0.5 by default."""
    pregrasp_offset: float | None = None
    """Distance of the pre-grasp from the grasp, metres, 0 to 1; 0.10 by default."""
    opening_fraction: float | None = None
    """Initial joints lie within this share of the closing range, more than 0, at most 1; 0.2 by default."""
    batch_size: int = 0
    """Candidates that are optimized together, 1 to 4096; 0 means 48."""
    scheme: tuple[int, int] | None = None
    """Iterations, and how many of the last also avoid penetration. By default (200, 40), or less where the deadline
    leaves no time for it."""
    trace: bool = False
    """Return the objective's terms of every iteration too."""
    priority: Priority = "normal"
    """How urgent it is; whoever may plan may ask for any priority."""
    require_complete: bool = False
    """Do not answer with the best so far: a search that time ends early is `DeadlineExceededError`."""

    def to_wire(self) -> wire.PlanOptions:
        """The options as a message."""
        if self.priority not in _PRIORITIES:
            raise ValueError(f"priority: found {self.priority!r}, expected one of {', '.join(_PRIORITIES)}")
        message = wire.PlanOptions(
            priority=_PRIORITIES[self.priority],
            require_complete=self.require_complete,
            batch_size=self.batch_size,
            seed=self.seed,
            max_grasp_count=self.max_grasps,
            min_score=self.min_score,
            friction=self.friction,
            pregrasp_offset_m=self.pregrasp_offset,
            opening_fraction=self.opening_fraction,
            trace=self.trace,
        )
        if self.scheme is not None:
            iterations, penetration = self.scheme
            message.scheme.iteration_count = iterations
            message.scheme.penetration_iteration_count = penetration
        if isinstance(self.reaching, str):
            if self.reaching not in _REACHING:
                raise ValueError(
                    f"reaching: found {self.reaching!r}, expected one of {', '.join(_REACHING)}, or a vector"
                )
            message.reaching = _REACHING[self.reaching]
        else:
            message.reaching = wire.REACHING_DIRECTION
            message.reaching_direction.CopyFrom(vector_to_wire(self.reaching, "reaching"))
        if self.max_tilt is not None:
            message.orientation_limits.max_tilt_rad = self.max_tilt
        if self.roll is not None:
            message.orientation_limits.roll.min_rad, message.orientation_limits.roll.max_rad = self.roll
        for i, box in enumerate(self.keep_out):
            message.keep_out_boxes.append(
                wire.KeepOutBox(
                    pose=pose_to_wire(box.pose, f"keep_out[{i}].pose"),
                    half_extents_m=vector_to_wire(box.half_extents, f"keep_out[{i}].half_extents"),
                )
            )
        if isinstance(self.target, TargetPoint):
            message.target_point.point.CopyFrom(vector_to_wire(self.target.point, "target.point"))
            message.target_point.radius_m = self.target.radius
        elif self.target is not None:
            message.target_label = self.target
        if self.budget is not None:
            message.budget.FromNanoseconds(round(self.budget * 1e9))
        return message
