"""Planning against a real server: what comes back is right, in every way of asking."""

from __future__ import annotations

import dataclasses
from datetime import datetime, timezone

import numpy as np
import pytest

import graspd
from graspd.poses import Array
from tests.png import png

GRIPPER = "robotiq-2f85"
HALF = np.array(graspd.examples.BOX_SIZE) / 2
VOXEL = 0.005


def on_the_box(points: Array) -> Array:
    """Distance of points from the surface of the box on the table, world frame."""
    q = np.abs(points - [0, 0, HALF[2]]) - HALF
    outside = np.linalg.norm(np.maximum(q, 0), axis=1)
    inside = np.minimum(q.max(axis=1), 0)
    distance: Array = np.abs(outside + inside)
    return distance


@pytest.mark.parametrize("hand", [GRIPPER, "leap", "barrett"])
def test_grasps_are_on_the_box(planner: graspd.Planner, frame: graspd.DepthFrame, hand: str) -> None:
    plan = planner.plan(frame, hand=hand, options=graspd.PlanOptions(seed=1))
    assert plan.hand == hand and len(plan) > 0 and plan.no_grasp is None
    scores = [grasp.score for grasp in plan]
    assert scores == sorted(scores, reverse=True) and 0 < scores[0] <= 1
    about = planner.hand(hand)
    for grasp in plan:
        assert grasp.frame_id == "table" and grasp.wrist_link == about.wrist_link
        # A contact is known to about a voxel and a half.
        assert on_the_box(grasp.contact_points).max() < 1.5 * VOXEL
        assert np.allclose(np.linalg.norm(grasp.contact_normals, axis=1), 1)
        assert np.allclose(graspd.examples.camera_pose() @ grasp.pose_in_camera, grasp.pose, atol=1e-9)
        assert np.allclose(
            graspd.examples.camera_pose() @ grasp.pregrasp_pose_in_camera, grasp.pregrasp_pose, atol=1e-9
        )
        assert np.isclose(np.linalg.norm(grasp.approach), 0.10)
        # The hand approaches along its own approach axis.
        assert np.allclose(grasp.pose[:3, :3] @ about.approach, grasp.approach / 0.10, atol=1e-6)
        assert grasp.joints.names == tuple(j.name for j in about.joints)
        assert grasp.actuators.names == tuple(a.name for a in about.actuators)
        limits = [(j.lower - 1e-6, j.upper + 1e-6) for j in about.joints]
        for moment in ("pregrasp", "open", "contact", "squeezed"):
            values = grasp.joints.array(moment)
            assert all(low <= v <= high for v, (low, high) in zip(values, limits, strict=True))
        assert {c.pad for c in grasp.contacts} <= {p.name for p in about.pads}
    assert plan.stats.candidates == 48 and plan.stats.iterations == 200 and plan.stats.seed == 1
    assert plan.stats.estimator == "geometric" and plan.stats.hand_revision == about.revision
    assert list(plan.stats.stages)[:3] == ["decode", "frame", "volume"]
    assert sum(plan.stats.stages.values()) <= plan.stats.total * 1.01
    assert plan.workspace and plan.workspace.size == 0.4 and plan.workspace.table_height is not None


def test_five_lines_and_no_pose_of_the_camera(planner: graspd.Planner) -> None:
    depth, intrinsics = graspd.examples.box_on_table()
    options = graspd.PlanOptions(seed=4)
    plan = planner.plan(depth, intrinsics, hand=GRIPPER, options=options)
    assert plan.best.frame_id == "camera"
    assert np.allclose(plan.best.pose, plan.best.pose_in_camera)
    points = graspd.transform(graspd.examples.camera_pose(), plan.best.contact_points)
    assert on_the_box(points).max() < 1.5 * VOXEL
    # A camera matrix, metres as floats, and a PNG file say the same.
    as_metres = planner.plan(depth.astype(np.float32) * 0.001, intrinsics.matrix, hand=GRIPPER, options=options)
    as_file = planner.plan(png(depth), intrinsics, hand=GRIPPER, options=options)
    assert np.allclose(as_file.best.pose, plan.best.pose, atol=0)
    assert np.allclose(as_metres.best.pose, plan.best.pose, atol=1e-3)


def test_the_same_question_has_the_same_answer(planner: graspd.Planner, frame: graspd.DepthFrame) -> None:
    ask = [planner.plan(frame, hand="leap", options=graspd.PlanOptions(seed=s)) for s in (5, 5, 6)]
    poses = [np.array([grasp.pose for grasp in plan]) for plan in ask]
    assert np.array_equal(poses[0], poses[1])
    assert poses[0].shape != poses[2].shape or not np.array_equal(poses[0], poses[2])


def test_options_have_their_effect(planner: graspd.Planner, frame: graspd.DepthFrame) -> None:
    options = graspd.PlanOptions(max_grasps=2, scheme=(60, 20), pregrasp_offset=0.05, max_tilt=0.0, trace=True)
    plan = planner.plan(frame, hand=GRIPPER, options=options)
    assert 1 <= len(plan) <= 2 and plan.stats.iterations == 60 and len(plan.trace) == 60
    assert plan.trace[0].total > plan.trace[-1].total
    for grasp in plan:
        assert np.allclose(grasp.approach, [0, 0, -0.05], atol=1e-4)
    beside = planner.plan(
        frame, hand=GRIPPER, options=graspd.PlanOptions(target=graspd.TargetPoint([0.12, 0.1, 0.02], 0.02))
    )
    assert len(beside) == 0 and beside.no_grasp is not None and beside.no_grasp.nearest_fix
    above = graspd.Box(graspd.pose([0, 0, 0.2]), [0.5, 0.5, 0.11])
    blocked = planner.plan(frame, hand=GRIPPER, options=graspd.PlanOptions(keep_out=[above]))
    assert len(blocked) == 0 and "keep_out" in blocked.stats.rejected
    assert blocked.no_grasp is not None and blocked.no_grasp.nearest_fix
    small = graspd.SceneOptions(volume_resolution=64, volume_size=0.32, volume="occupancy")
    plan = planner.plan(frame, hand=GRIPPER, scene_options=small)
    assert plan.workspace and (plan.workspace.resolution, plan.workspace.size) == (64, 0.32)


def test_labels_and_times_come_back(planner: graspd.Planner, frame: graspd.DepthFrame) -> None:
    bare, _ = graspd.examples.box_on_table(box=False)
    labels = np.where(np.abs(frame.metres() - bare * 0.001) > 0.002, 3, 0).astype(np.uint8)
    when = datetime(2026, 5, 6, 7, 8, 9, 123456, tzinfo=timezone.utc)
    seen = dataclasses.replace(frame, labels=labels, capture_time=when, camera_frame="cell/eye")
    plan = planner.plan(seen, hand=GRIPPER, options=graspd.PlanOptions(target=3))
    assert plan.best.label == 3 and plan.capture_time == when and plan.best.camera_frame_id == "cell/eye"
    nothing = planner.plan(seen, hand=GRIPPER, options=graspd.PlanOptions(target=4))
    assert nothing.no_grasp is not None and nothing.no_grasp.reason == "target_not_found"


def test_several_frames_are_one_scene(planner: graspd.Planner, frame: graspd.DepthFrame) -> None:
    plan = planner.plan([frame, frame], hand=GRIPPER)
    assert on_the_box(plan.best.contact_points).max() < 1.5 * VOXEL
    with pytest.raises(graspd.InvalidArgumentError) as caught:
        planner.plan([frame, dataclasses.replace(frame, camera_pose=None)], hand=GRIPPER)
    assert caught.value.fields == ("frames[1].camera_pose",)


def test_no_grasp_is_no_error_until_one_is_asked_for(planner: graspd.Planner) -> None:
    plan = planner.plan(*graspd.examples.box_on_table(box=False), hand=GRIPPER)
    assert len(plan) == 0 and plan.no_grasp is not None and "EmptyTable" not in repr(plan)
    assert plan.no_grasp.reason == "empty_table"
    with pytest.raises(graspd.NoGraspError, match="empty_table") as caught:
        plan.best  # noqa: B018
    assert caught.value.no_grasp is plan.no_grasp


def test_a_stream_tells_better_sets_and_the_last(planner: graspd.Planner, frame: graspd.DepthFrame) -> None:
    options = graspd.PlanOptions(seed=2, scheme=(400, 80))
    with planner.stream(frame, hand="leap", options=options) as stream:
        events = list(stream)
    assert isinstance(events[0], graspd.Accepted) and isinstance(events[-1], graspd.Finished)
    assert all(isinstance(event, graspd.Improved) for event in events[1:-1])
    whole = planner.plan(frame, hand="leap", options=options)
    assert np.array_equal([g.pose for g in events[-1].plan], [g.pose for g in whole])
    assert list(stream) == []


def test_several_hands_in_one_scene(planner: graspd.Planner, frame: graspd.DepthFrame) -> None:
    options = graspd.PlanOptions(seed=3)
    several = planner.plan_hands(frame, hands=["leap", GRIPPER], options=options)
    assert list(several) == ["leap", GRIPPER] and not several.errors and several.total > 0
    alone = planner.plan(frame, hand=GRIPPER, options=options)
    assert np.array_equal(several[GRIPPER].get().best.pose, alone.best.pose)
    ranked = several.ranked()
    assert len(ranked) == sum(len(p) for p in several.plans.values())
    assert [g.score for _, g in ranked] == sorted((g.score for _, g in ranked), reverse=True)

    named = {"left": "leap", "right": graspd.HandTask("leap", graspd.PlanOptions(seed=9, max_grasps=1))}
    results = {r.task_id: r.get() for r in planner.stream_hands(frame, hands=named, options=options)}
    assert set(results) == {"left", "right"} and len(results["right"]) == 1
    assert (results["left"].stats.seed, results["right"].stats.seed) == (3, 9)
    with pytest.raises(ValueError, match="more than once"):
        planner.plan_hands(frame, hands=["leap", "hands/leap"])
    with pytest.raises(TypeError, match="expected a list of hands"):
        planner.plan_hands(frame, hands="leap")


def test_a_hand_that_fails_leaves_the_others_alone(planner: graspd.Planner, frame: graspd.DepthFrame) -> None:
    hopeless = graspd.HandTask(GRIPPER, graspd.PlanOptions(budget=1e-6))
    several = planner.plan_hands(frame, hands={"a": "leap", "b": hopeless})
    assert len(several["a"].get()) > 0
    b = several["b"]
    # Out of time is an answer or an error of the task, as the server sees it; never of the others.
    assert (b.plan is None) == (b.error is not None)
    if b.plan is not None:
        assert b.plan.no_grasp is not None and b.plan.no_grasp.reason == "out_of_time"


def test_faults_name_their_field(planner: graspd.Planner, frame: graspd.DepthFrame) -> None:
    blind = dataclasses.replace(frame, intrinsics=graspd.Intrinsics(0, 300, 160, 120))
    with pytest.raises(graspd.InvalidArgumentError) as caught:
        planner.plan(blind, hand="leap")
    error = caught.value
    assert error.fields == ("frames[0].intrinsics.fx_px",) and error.reason == "INVALID_INTRINSICS"
    assert "found 0" in error.violations[0].description and "frames[0].intrinsics.fx_px" in str(error)

    for options, field in [
        (graspd.PlanOptions(friction=-1.0), "options.friction"),
        (graspd.PlanOptions(reaching=[0, 0, 0]), "options.reaching_direction"),
        (graspd.PlanOptions(keep_out=[graspd.Box(np.eye(4), [1, -1, 1])]), "options.keep_out_boxes[0].half_extents_m"),
    ]:
        with pytest.raises(graspd.InvalidArgumentError) as caught:
            planner.plan(frame, hand="leap", options=options)
        assert any(f.startswith(field) for f in caught.value.fields), caught.value.fields
    with pytest.raises(graspd.InvalidArgumentError) as caught:
        planner.plan_hands(frame, hands={"x": graspd.HandTask("leap", graspd.PlanOptions(batch_size=-1))})
    assert caught.value.fields == ("tasks[0].options.batch_size",)
    with pytest.raises(graspd.NotFoundError, match="no-such-hand") as missing:
        planner.plan(frame, hand="no-such-hand")
    assert missing.value.reason == "HAND_NOT_FOUND"
    with pytest.raises(graspd.NotFoundError, match="geometric") as missing:
        planner.plan(frame, hand="leap", scene_options=graspd.SceneOptions(estimator="oracle"))
    assert missing.value.reason == "ESTIMATOR_NOT_FOUND" and missing.value.metadata["known"] == "geometric, learned"


def test_a_message_that_is_too_large_is_refused(planner: graspd.Planner) -> None:
    assert planner.server and planner.server.max_message_bytes == 16 << 20
    lens = graspd.Intrinsics(1000, 1000, 1000, 1000)
    with pytest.raises(graspd.ResourceExhaustedError) as caught:
        planner.plan(np.ones((2400, 2400), np.float32), lens, hand="leap")
    assert caught.value.reason == "MESSAGE_TOO_LARGE" and caught.value.retry_after is None


def test_a_scene_is_read_without_a_search(planner: graspd.Planner, frame: graspd.DepthFrame) -> None:
    reading = planner.read_scene(frame, max_points=20_000)
    field = reading.contact_field
    assert len(field.contacts) == len(field.inward) == len(field.certainties) > 0
    # Centres of voxels at the surface; at its edges some stand a voxel farther out.
    assert np.median(on_the_box(field.contacts)) < VOXEL and on_the_box(field.contacts).max() < 3 * VOXEL
    assert np.allclose(np.linalg.norm(field.inward, axis=1), 1, atol=1e-5)
    assert ((field.certainties > 0) & (field.certainties <= 1)).all()
    # A finger presses towards the middle of the box, not away from it.
    towards = np.einsum("ij,ij->i", field.inward, [0, 0, HALF[2]] - field.contacts)
    assert (towards > 0).mean() > 0.9
    assert len(field.centroids) == len(field.centroid_weights) > 0
    (points,) = reading.points
    assert points.shape[2] == 3 and 5_000 < points.shape[0] * points.shape[1] <= 20_000
    # Rows and columns are kept: holes stand where no pixel has a return.
    seen = points[np.isfinite(points).all(axis=2)]
    assert len(seen) > 0 and np.abs(on_the_table_or_box(seen)).max() < 0.005
    plan = planner.plan(frame, hand=GRIPPER)
    assert plan.workspace is not None and reading.estimator == plan.stats.estimator
    assert np.array_equal(reading.workspace.pose, plan.workspace.pose) and "optimize" not in reading.stages
    assert planner.read_scene(frame).points == ()
    with pytest.raises(graspd.InvalidArgumentError) as refused:
        planner.read_scene(frame, max_points=-1)
    assert [v.field for v in refused.value.violations] == ["max_point_count"]


def on_the_table_or_box(points: Array) -> Array:
    """Distance of points from the nearer of box and table top."""
    nearest: Array = np.minimum(on_the_box(points), np.abs(points[:, 2]))
    return nearest
