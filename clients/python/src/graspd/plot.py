"""Pictures of a plan with matplotlib. Needs `pip install 'graspd[plot]'`."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, cast

import numpy as np
from matplotlib import pyplot
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from graspd.frames import DepthFrame
from graspd.hands import BoxForm, CylinderForm, HandGeometry, HandShape, MeshForm, SphereForm
from graspd.plans import Grasp, Moment, Plan
from graspd.poses import Array, inverse, transform

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d import Axes3D

_MOST_POINTS = 8000
_AXIS_M = 0.03
_NORMAL_M = 0.02
_MARGIN_M = 0.02
_SECTIONS = 12


def plan(
    plan: Plan,
    frame: DepthFrame | None = None,
    geometry: HandGeometry | None = None,
    *,
    count: int = 3,
    moment: Moment = "contact",
    elevation: float = 35.0,
    azimuth: float = -60.0,
) -> Figure:
    """The best grasps side by side in three dimensions: the scene, the hand, contacts with normals, the approach.

    Args:
        plan: The plan.
        frame: The frame that it was planned from; its points are drawn.
        geometry: The hand's; without it only the wrist's axes are drawn.
        count: At most so many grasps.
        moment: The moment of the grasps at which the hand is drawn.
        elevation: Angle of the view above the horizon, degrees.
        azimuth: Angle of the view about the vertical, degrees.

    Returns:
        A figure: `figure.savefig("plan.png")`. `pyplot.close(figure)` frees it.
    """
    shown = list(plan[:count])
    figure = pyplot.figure(figsize=(5.0 * max(len(shown), 1), 5.0), layout="constrained")
    figure.suptitle(f"{plan.hand}: {len(plan)} grasps" if shown else f"{plan.hand}: {plan.no_grasp}")
    points = _scene(plan, frame)
    # A camera's frame has y down and z forward: seen as the picture was taken.
    upright = frame is None or frame.camera_pose is not None
    for i, grasp in enumerate(shown or [None]):
        axes = cast("Axes3D", figure.add_subplot(1, max(len(shown), 1), i + 1, projection="3d"))
        near = points
        if grasp is not None:
            low, high = draw_grasp(axes, grasp, geometry, moment)
            near = points[((points >= low) & (points <= high)).all(axis=1)]
            axes.set_title(f"{i + 1}: score {grasp.score:.2f}, {len(grasp.contacts)} contacts", fontsize=10)
        if near.size:
            near = near[:: max(1, len(near) // _MOST_POINTS)]
            axes.scatter(*near.T, s=1.5, c=near[:, 2], cmap="viridis" if upright else "viridis_r", depthshade=False)
        axes.set_xlabel("x, m", labelpad=8)
        axes.set_ylabel("y, m", labelpad=8)
        axes.set_zlabel("z, m", labelpad=8)
        axes.tick_params(labelsize=7)
        axes.set_aspect("equal")
        axes.view_init(elev=elevation if upright else -60.0, azim=azimuth if upright else -90.0)
    return figure


def scores(plan: Plan) -> Figure:
    """What the scores of a plan are made of, a row of bars for each grasp, best first."""
    figure, axes = pyplot.subplots(figsize=(7.0, 1.2 + 0.45 * max(len(plan), 1)), layout="constrained")
    parts = ("objective", "force_closure", "clearance", "certainty")
    height = 0.8 / len(parts)
    rows = np.arange(len(plan))
    for i, part in enumerate(parts):
        values = [getattr(grasp.score_parts, part) for grasp in plan]
        axes.barh(rows + (i + 0.5) * height - 0.4, values, height=height, label=part.replace("_", " "))
    axes.plot([grasp.score for grasp in plan], rows, "k|", markersize=14, label="score")
    axes.set(yticks=rows, yticklabels=[str(i + 1) for i in rows], xlim=(0, 1), xlabel="0 to 1, larger is better")
    axes.invert_yaxis()
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=5, fontsize=8, frameon=False)
    return figure


def draw_grasp(axes: Axes3D, grasp: Grasp, geometry: HandGeometry | None, moment: Moment) -> tuple[Array, Array]:
    """Draws one grasp into axes of the caller's and sets their limits to it; the lower and the upper corner."""
    wrist = grasp.pose_at(moment)
    for axis, color in zip(range(3), ("tab:red", "tab:green", "tab:blue"), strict=True):
        _line(axes, [wrist[:3, 3], wrist[:3, 3] + _AXIS_M * wrist[:3, axis]], color)
    _line(axes, [grasp.pregrasp_pose[:3, 3], grasp.pose[:3, 3]], "0.3", "--")
    for contact in grasp.contacts:
        _line(axes, [contact.point, contact.point + _NORMAL_M * contact.normal], "tab:red")
    if grasp.contacts:
        axes.scatter(*grasp.contact_points.T, s=22.0, c="tab:red", depthshade=False)
    reached = [wrist[None, :3, 3], grasp.pose[None, :3, 3], grasp.contact_points]
    if geometry is not None:
        bodies: Array = wrist @ geometry.body_poses(grasp.joints.at(moment))
        faces = [
            transform(bodies[shape.body] @ shape.body_from_shape, face)
            for shape in geometry.visual_shapes
            for face in _faces(shape)
        ]
        edges, filling = (0.15, 0.3, 0.5, 0.4), (0.35, 0.55, 0.8, 0.2)
        axes.add_collection3d(Poly3DCollection(faces, facecolors=filling, edgecolors=edges, linewidths=0.3))
        reached += faces
    every = np.concatenate(reached)
    low, high = every.min(axis=0) - _MARGIN_M, every.max(axis=0) + _MARGIN_M
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    return low, high


def _line(axes: Axes3D, ends: list[Array], color: str, style: str = "-") -> None:
    axes.add_collection3d(Line3DCollection([ends], colors=color, linestyles=style, linewidths=1.5))


def _scene(plan: Plan, frame: DepthFrame | None) -> Array:
    """The points that the camera saw, those in the volume where there is one."""
    if frame is None:
        return np.empty((0, 3))
    points = frame.points()
    if plan.workspace is not None:
        volume = plan.workspace
        inside = transform(inverse(volume.pose), points)
        points = points[((inside >= 0) & (inside <= volume.size)).all(axis=1)]
    return points


def _faces(shape: HandShape) -> list[Array]:
    """The faces of a shape in its own frame, as polygons."""
    form = shape.form
    if isinstance(form, MeshForm):
        return list(form.vertices[form.triangles])
    if isinstance(form, BoxForm):
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * form.half_extents
        sides = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]]
        return [corners[side] for side in sides]
    turn = np.linspace(0, 2 * np.pi, _SECTIONS + 1)
    if isinstance(form, CylinderForm):
        radii, heights = np.array([form.radius] * 2), np.array([-form.half_length, form.half_length])
    else:
        assert isinstance(form, SphereForm)
        tilt = np.linspace(-np.pi / 2, np.pi / 2, _SECTIONS // 2 + 1)
        radii, heights = form.radius * np.cos(tilt), form.radius * np.sin(tilt)
    rings = np.stack(
        [
            np.stack([r * np.cos(turn), r * np.sin(turn), np.full_like(turn, h)], axis=-1)
            for r, h in zip(radii, heights, strict=True)
        ]
    )
    sides_of_rings = [np.array([a[i], a[i + 1], b[i + 1], b[i]]) for a, b in pairwise(rings) for i in range(_SECTIONS)]
    return [rings[0, :-1], rings[-1, :-1], *sides_of_rings]
