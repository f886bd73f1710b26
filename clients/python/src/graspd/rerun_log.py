"""Logging of frames and plans to Rerun. Needs `pip install 'graspd[rerun]'`.

Everything goes to the active recording, or to the one that is handed over: `rerun.init("cell", spawn=True)` opens the
viewer, `rerun.save("run.rrd")` writes a file.
"""

from __future__ import annotations

import json

import numpy as np
import rerun
from numpy.typing import NDArray

from graspd.frames import DepthFrame
from graspd.hands import BoxForm, CylinderForm, HandGeometry, HandShape, SphereForm
from graspd.plans import Grasp, Moment, Plan
from graspd.poses import Array

_ARROW_M = 0.02
_CONTACT_M = 0.003


def frame(frame: DepthFrame, *, path: str = "camera", recording: rerun.RecordingStream | None = None) -> None:
    """Logs a frame: the camera where it stands, its lens, its depth image (and labels, where there are)."""
    if frame.camera_pose is not None:
        rerun.log(path, _transform(frame.camera_pose), recording=recording)
    depth = frame.metres()
    height, width = depth.shape
    lens = frame.intrinsics
    pinhole = rerun.Pinhole(
        image_from_camera=lens.matrix, width=width, height=height, camera_xyz=rerun.ViewCoordinates.RDF
    )
    rerun.log(path, pinhole, recording=recording)
    rerun.log(f"{path}/depth", rerun.DepthImage(depth, meter=1.0), recording=recording)
    if frame.labels is not None:
        rerun.log(f"{path}/labels", rerun.SegmentationImage(frame.labels), recording=recording)


def plan(
    plan: Plan,
    geometry: HandGeometry | None = None,
    *,
    path: str = "grasps",
    count: int = 5,
    moment: Moment = "contact",
    recording: rerun.RecordingStream | None = None,
) -> None:
    """Logs a plan: the best grasps with their contacts and the hand, scores, durations and rejections.

    Args:
        plan: The plan. What an earlier one logged under the same path is cleared.
        geometry: The hand's, from `Planner.hand_geometry`; without it hands are drawn as their wrists' axes.
        path: Where in the recording: best grasp at `{path}/0`.
        count: At most so many grasps.
        moment: The moment of the grasps at which the hand is drawn.
        recording: The recording; None for the active one.
    """
    rerun.log(path, rerun.Clear(recursive=True), recording=recording)
    for i, grasp in enumerate(plan[:count]):
        _grasp(f"{path}/{i}", grasp, geometry, moment, recording)
        rerun.log(f"{path}/scores/{i}", rerun.Scalars(grasp.score), recording=recording)
    for name, seconds in [*plan.stats.stages.items(), ("total", plan.stats.total), ("queue", plan.stats.queue)]:
        rerun.log(f"{path}/seconds/{name}", rerun.Scalars(seconds), recording=recording)
    said = f"{plan.hand}: {len(plan)} grasps"
    if plan.no_grasp is not None:
        said += f" ({plan.no_grasp.reason}): {plan.no_grasp.nearest_fix}"
    if plan.stats.rejected:
        said += f"; rejected {json.dumps(dict(plan.stats.rejected))}"
    rerun.log(f"{path}/log", rerun.TextLog(said, level="INFO" if len(plan) else "WARN"), recording=recording)


def _transform(pose: Array) -> rerun.Transform3D:
    return rerun.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3])


def _grasp(
    path: str,
    grasp: Grasp,
    geometry: HandGeometry | None,
    moment: Moment,
    recording: rerun.RecordingStream | None,
) -> None:
    wrist = grasp.pose_at(moment)
    axes = rerun.Arrows3D(
        origins=np.tile(wrist[:3, 3], (3, 1)),
        vectors=(wrist[:3, :3] * 2 * _ARROW_M).T,
        colors=[[220, 60, 60], [60, 180, 60], [60, 90, 220]],
    )
    rerun.log(f"{path}/wrist", axes, recording=recording)
    way = np.stack([grasp.pregrasp_pose[:3, 3], grasp.pose[:3, 3]])
    rerun.log(f"{path}/approach", rerun.LineStrips3D([way]), recording=recording)
    labels = [f"{c.finger}: {c.pad}" for c in grasp.contacts]
    points = rerun.Points3D(grasp.contact_points, radii=_CONTACT_M, labels=labels, show_labels=False)
    rerun.log(f"{path}/contacts", points, recording=recording)
    normals = rerun.Arrows3D(origins=grasp.contact_points, vectors=grasp.contact_normals * _ARROW_M)
    rerun.log(f"{path}/contacts/normals", normals, recording=recording)
    if geometry is None:
        return
    bodies: Array = wrist @ geometry.body_poses(grasp.joints.at(moment))
    for i, shape in enumerate(geometry.visual_shapes):
        placed = f"{path}/hand/{shape.link}/{i}"
        rerun.log(placed, _transform(bodies[shape.body] @ shape.body_from_shape), recording=recording)
        rerun.log(placed, _form(shape), recording=recording)


def _form(shape: HandShape) -> rerun.AsComponents:
    form = shape.form
    if isinstance(form, BoxForm):
        return rerun.Boxes3D(half_sizes=[form.half_extents])
    if isinstance(form, CylinderForm):
        return rerun.Cylinders3D(lengths=[2 * form.half_length], radii=[form.radius])
    if isinstance(form, SphereForm):
        return rerun.Ellipsoids3D(radii=[form.radius])
    triangles: NDArray[np.uint32] = form.triangles.astype(np.uint32)
    return rerun.Mesh3D(vertex_positions=form.vertices.astype(np.float32), triangle_indices=triangles)
