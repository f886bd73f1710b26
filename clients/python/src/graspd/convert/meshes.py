"""A hand at a moment of a grasp as trimesh meshes. Needs `pip install 'graspd[mesh]'`."""

from __future__ import annotations

from typing import Literal, cast

import trimesh

from graspd.hands import BoxForm, CylinderForm, HandGeometry, HandShape, SphereForm
from graspd.plans import Grasp, Moment
from graspd.poses import Array

_SECTIONS = 24


def shape_mesh(shape: HandShape) -> trimesh.Trimesh:
    """A shape in its own frame."""
    form = shape.form
    mesh: trimesh.Trimesh
    if isinstance(form, BoxForm):
        mesh = trimesh.creation.box(extents=2 * form.half_extents)
    elif isinstance(form, CylinderForm):
        mesh = trimesh.creation.cylinder(radius=form.radius, height=2 * form.half_length, sections=_SECTIONS)
    elif isinstance(form, SphereForm):
        mesh = trimesh.creation.icosphere(subdivisions=2, radius=form.radius)
    else:
        mesh = trimesh.Trimesh(vertices=form.vertices, faces=form.triangles, process=False)
    return mesh


def link_meshes(
    geometry: HandGeometry,
    grasp: Grasp,
    moment: Moment = "contact",
    shapes: Literal["visual", "collision"] = "visual",
) -> dict[str, trimesh.Trimesh]:
    """The mesh of every link that has one, by name, in the frame that the grasp's pose is in.

    Args:
        geometry: The hand's, from `Planner.hand_geometry`.
        grasp: The grasp.
        moment: The moment of the grasp.
        shapes: What to draw, or what the planner keeps out of collision.
    """
    bodies: Array = grasp.pose_at(moment) @ geometry.body_poses(grasp.joints.at(moment))
    chosen = geometry.visual_shapes if shapes == "visual" else geometry.collision_shapes
    parts: dict[str, list[trimesh.Trimesh]] = {}
    for shape in chosen:
        mesh = shape_mesh(shape)
        mesh.apply_transform(bodies[shape.body] @ shape.body_from_shape)
        parts.setdefault(shape.link, []).append(mesh)
    return {link: _joined(meshes) for link, meshes in parts.items()}


def hand_mesh(
    geometry: HandGeometry,
    grasp: Grasp,
    moment: Moment = "contact",
    shapes: Literal["visual", "collision"] = "visual",
) -> trimesh.Trimesh:
    """The whole hand as one mesh, in the frame that the grasp's pose is in; args as for `link_meshes`."""
    return _joined(list(link_meshes(geometry, grasp, moment, shapes).values()))


def _joined(meshes: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    return cast("trimesh.Trimesh", trimesh.util.concatenate(meshes))
