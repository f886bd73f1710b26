"""Hands: what a server can plan for, their files, their shape and how their parts move."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from graspd.errors import ProtocolError
from graspd.poses import Array, frozen, matrix_from_quaternion, pose_from_wire, vector_from_wire
from graspd.v1 import hand_service_pb2 as wire

CHUNK_BYTES = 1 << 20
"""Size of the pieces in which files travel."""

HandFiles: TypeAlias = str | Path | Mapping[str, bytes]
"""A hand's folder, or its files' contents by their paths in that folder."""


@dataclass(frozen=True)
class Joint:
    """A movable joint."""

    name: str
    """Name in the URDF."""
    kind: Literal["revolute", "prismatic", "unspecified"]
    """Rotation (radians), translation (metres), or a type that is newer than this client."""
    lower: float
    """Lower limit."""
    upper: float
    """Upper limit."""
    max_effort: float
    """Largest effort, newton metres or newtons; 0 when unknown."""


@dataclass(frozen=True)
class Actuator:
    """What a controller commands: one coordinate that moves one joint or several."""

    name: str
    """Name."""
    lower: float
    """Lower limit."""
    upper: float
    """Upper limit."""
    open: float
    """Value with the hand open."""
    closed: float
    """Value towards which the hand closes."""
    max_effort: float
    """Largest effort; 0 when unknown."""


@dataclass(frozen=True)
class Pad:
    """A flat region of a finger's surface that may touch an object."""

    name: str
    """Name, unique in the hand."""
    finger: str
    """The finger that it belongs to."""
    link: str
    """The link that carries it."""


@dataclass(frozen=True, eq=False)
class Hand:
    """A hand or gripper. Its frame is that of its root link."""

    id: str
    """For example `leap`."""
    display_name: str
    """Shown to people."""
    revision: str
    """Changes with every change of the description."""
    origin: Literal["library", "folder", "created", "unspecified"]
    """Comes with the server, from the server's folder of hands, or created by a caller."""
    wrist_link: str
    """The root link: `Grasp.pose` is its pose."""
    approach: Array
    """Direction in the hand frame along which the hand reaches for objects, unit length."""
    lateral_axis: Array
    """Axis in the hand frame from which `PlanOptions.roll` is measured."""
    tool_point: Array
    """Point in the hand frame between the half-closed fingers, metres."""
    joints: tuple[Joint, ...]
    """Movable joints, in the order of `Grasp.joints`."""
    actuators: tuple[Actuator, ...]
    """Actuators, in the order of `Grasp.actuators`."""
    fingers: tuple[str, ...]
    """Names of the fingers."""
    pads: tuple[Pad, ...]
    """Regions that may touch an object."""
    contact_candidates: int
    """Samples on the pads."""
    opening: tuple[float, float] | None
    """Smallest and largest distance between opposed pads, metres; None when no two pads oppose each other."""
    warnings: tuple[str, ...]
    """Things worth a look that are not errors."""
    create_time: datetime | None
    """When it was created; None for hands that come with the server."""

    @property
    def name(self) -> str:
        """Resource name, for example `hands/leap`."""
        return f"hands/{self.id}"


HandLike: TypeAlias = str | Hand
"""A hand's id, its resource name, or the hand itself."""


@dataclass(frozen=True)
class CreatedHand:
    """A hand as the server read it."""

    hand: Hand
    """The hand."""
    proposed_toml: str | None
    """The description that the server wrote because the files had no `hand.toml`. Worth reading."""


@dataclass(frozen=True, eq=False)
class Body:
    """A part of a hand that moves as one."""

    parent: int | None
    """Index of the body that carries this one's joint; None for the root."""
    joint: str
    """The joint that moves this body; empty for the root."""
    kind: Literal["revolute", "prismatic", "fixed"]
    """How the joint moves."""
    axis: Array
    """The joint's axis in the body's frame."""
    parent_from_joint: Array
    """This body's frame at joint position 0 in the parent's, 4 × 4."""


@dataclass(frozen=True, eq=False)
class Link:
    """A link of the URDF, fixed to a body."""

    name: str
    """Name."""
    body: int
    """Index of its body."""
    body_from_link: Array
    """The link's frame in the body's, 4 × 4."""


@dataclass(frozen=True, eq=False)
class BoxForm:
    """A box about the origin."""

    half_extents: Array
    """Half extents, metres."""


@dataclass(frozen=True)
class CylinderForm:
    """A cylinder about the origin, along z."""

    radius: float
    """Metres."""
    half_length: float
    """Metres."""


@dataclass(frozen=True)
class SphereForm:
    """A sphere about the origin."""

    radius: float
    """Metres."""


@dataclass(frozen=True, eq=False)
class MeshForm:
    """A triangle mesh."""

    vertices: Array
    """Vertices (n × 3), metres."""
    triangles: NDArray[np.int64]
    """Indices of vertices (m × 3), counter-clockwise seen from outside."""


@dataclass(frozen=True, eq=False)
class HandShape:
    """A shape that is fixed to a link."""

    link: str
    """Name of the link."""
    body: int
    """Index of the link's body."""
    body_from_shape: Array
    """The shape's frame in the body's, 4 × 4."""
    form: BoxForm | CylinderForm | SphereForm | MeshForm
    """The shape in its own frame."""


@dataclass(frozen=True, eq=False)
class HandGeometry:
    """The shape of a hand and how its parts move."""

    hand: str
    """The hand's id."""
    revision: str
    """Revision of the hand's description."""
    bodies: tuple[Body, ...]
    """Parents before children; the first is the root, and its frame is the hand frame."""
    links: tuple[Link, ...]
    """Links of the URDF."""
    visual_shapes: tuple[HandShape, ...]
    """What to draw."""
    collision_shapes: tuple[HandShape, ...]
    """What the planner keeps out of collision."""

    def body_poses(self, joints: Mapping[str, float]) -> Array:
        """Pose of every body in the hand frame (n × 4 × 4) for joint positions by name.

        Raises:
            KeyError: If a joint is missing.
        """
        poses = np.zeros((len(self.bodies), 4, 4))
        for i, body in enumerate(self.bodies):
            if body.parent is None:
                poses[i] = np.eye(4)
                continue
            motion = _motion(body, joints[body.joint])
            poses[i] = poses[body.parent] @ body.parent_from_joint @ motion
        return poses

    def link_poses(self, joints: Mapping[str, float]) -> dict[str, Array]:
        """Pose of every link in the hand frame by name, for joint positions by name."""
        bodies = self.body_poses(joints)
        return {link.name: bodies[link.body] @ link.body_from_link for link in self.links}


def _motion(body: Body, position: float) -> Array:
    motion = np.eye(4)
    if body.kind == "prismatic":
        motion[:3, 3] = body.axis * position
    elif body.kind == "revolute":
        motion[:3, :3] = matrix_from_quaternion([*(body.axis * np.sin(position / 2)), np.cos(position / 2)])
    return motion


def hand_id(hand: HandLike) -> str:
    """The id of a hand that is named in any way."""
    return hand.id if isinstance(hand, Hand) else hand.removeprefix("hands/")


def hand_name(hand: HandLike) -> str:
    """The resource name of a hand that is named in any way."""
    return f"hands/{hand_id(hand)}"


_KINDS: dict[int, Literal["revolute", "prismatic"]] = {
    wire.JOINT_TYPE_REVOLUTE: "revolute",
    wire.JOINT_TYPE_PRISMATIC: "prismatic",
}
_ORIGINS: dict[int, Literal["library", "folder", "created"]] = {
    wire.HAND_ORIGIN_LIBRARY: "library",
    wire.HAND_ORIGIN_FOLDER: "folder",
    wire.HAND_ORIGIN_CREATED: "created",
}


def _kind(number: int, joint: str) -> Literal["revolute", "prismatic"]:
    if number not in _KINDS:
        raise ProtocolError(f"joint {joint!r} is of a type that this client does not know")
    return _KINDS[number]


def hand_from_wire(message: wire.Hand) -> Hand:
    """A hand from its message."""
    return Hand(
        id=message.name.removeprefix("hands/"),
        display_name=message.display_name,
        revision=message.revision,
        origin=_ORIGINS.get(message.origin, "unspecified"),
        wrist_link=message.wrist_link,
        approach=vector_from_wire(message.approach),
        lateral_axis=vector_from_wire(message.lateral_axis),
        tool_point=vector_from_wire(message.tool_point),
        joints=tuple(
            Joint(j.name, _KINDS.get(j.type, "unspecified"), j.min_position, j.max_position, j.max_effort)
            for j in message.joints
        ),
        actuators=tuple(
            Actuator(a.name, a.min_position, a.max_position, a.open_position, a.closed_position, a.max_effort)
            for a in message.actuators
        ),
        fingers=tuple(message.fingers),
        pads=tuple(Pad(p.name, p.finger, p.link) for p in message.pads),
        contact_candidates=message.contact_candidate_count,
        opening=(message.opening.min_m, message.opening.max_m) if message.HasField("opening") else None,
        warnings=tuple(message.warnings),
        create_time=(message.create_time.ToDatetime(timezone.utc) if message.HasField("create_time") else None),
    )


def created_from_wire(message: wire.CreateHandResponse) -> CreatedHand:
    """A created hand from its message."""
    return CreatedHand(hand_from_wire(message.hand), message.proposed_hand_toml or None)


def geometry_from_wire(hand: str, message: wire.GetHandGeometryResponse) -> HandGeometry:
    """A hand's geometry from its message.

    Raises:
        ProtocolError: If it is not a tree of bodies, or a shape is of a kind that this client does not know.
    """
    bodies = tuple(_body(i, body) for i, body in enumerate(message.bodies))
    shapes = [*message.visual_shapes, *message.collision_shapes]
    for index in [*(x.body for x in message.links), *(s.body for s in shapes)]:
        if not 0 <= index < len(bodies):
            raise ProtocolError(f"body {index} of {len(bodies)} does not exist")
    return HandGeometry(
        hand=hand,
        revision=message.revision,
        bodies=bodies,
        links=tuple(Link(x.name, x.body, pose_from_wire(x.body_from_link)) for x in message.links),
        visual_shapes=tuple(_shape(s) for s in message.visual_shapes),
        collision_shapes=tuple(_shape(s) for s in message.collision_shapes),
    )


def _body(index: int, message: wire.HandBody) -> Body:
    if not message.HasField("parent"):
        return Body(None, "", "fixed", frozen(np.zeros(3)), frozen(np.eye(4)))
    if not 0 <= message.parent < index:
        raise ProtocolError(f"body {index} hangs on body {message.parent}, which does not come before it")
    return Body(
        message.parent,
        message.joint,
        _kind(message.joint_type, message.joint),
        vector_from_wire(message.axis),
        pose_from_wire(message.parent_from_joint),
    )


def _shape(message: wire.HandShape) -> HandShape:
    kind = message.WhichOneof("shape")
    form: BoxForm | CylinderForm | SphereForm | MeshForm
    if kind == "box":
        form = BoxForm(vector_from_wire(message.box.half_extents_m))
    elif kind == "cylinder":
        form = CylinderForm(message.cylinder.radius_m, message.cylinder.half_length_m)
    elif kind == "sphere":
        form = SphereForm(message.sphere.radius_m)
    elif kind == "mesh":
        vertices = np.array(message.mesh.vertices_m, dtype=np.float64).reshape(-1, 3)
        triangles = np.array(message.mesh.triangles, dtype=np.int64).reshape(-1, 3)
        if triangles.size and triangles.max() >= len(vertices):
            raise ProtocolError(f"a mesh of link {message.link!r} names vertices that it has not")
        form = MeshForm(frozen(vertices), triangles)
    else:
        raise ProtocolError(f"a shape of link {message.link!r} is of a kind that this client does not know")
    return HandShape(message.link, message.body, pose_from_wire(message.body_from_shape), form)


def read_files(files: HandFiles) -> dict[str, bytes]:
    """The files of a hand: those of its folder without hidden ones, or those given.

    Raises:
        FileNotFoundError: If there is no such folder.
    """
    if isinstance(files, Mapping):
        return dict(files)
    folder = Path(files)
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder}: found no folder, expected a hand's folder with its hand.urdf")
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not any(part.startswith(".") for part in path.relative_to(folder).parts)
    }


def upload(hand: str, files: Mapping[str, bytes], validate_only: bool) -> Iterator[wire.CreateHandRequest]:
    """The messages that create a hand: a header, then the files in pieces."""
    header = wire.CreateHandHeader(hand_id=hand, validate_only=validate_only)
    yield wire.CreateHandRequest(header=header)
    for path, contents in files.items():
        # An empty file is one empty piece.
        for begin in range(0, max(len(contents), 1), CHUNK_BYTES):
            piece = wire.FileChunk(path=path, data=contents[begin : begin + CHUNK_BYTES])
            yield wire.CreateHandRequest(chunk=piece)
