"""Options: every one of them reaches its field, what is unset stays unset, and wrong ones are refused by name."""

from __future__ import annotations

import numpy as np
import pytest

import graspd
from graspd.v1 import options_pb2


def test_unset_options_stay_unset() -> None:
    defaults = options_pb2.PlanOptions(reaching=options_pb2.REACHING_TOP_DOWN, priority=options_pb2.PRIORITY_NORMAL)
    assert graspd.PlanOptions().to_wire() == defaults
    assert graspd.SceneOptions().to_wire() == options_pb2.SceneOptions(volume_kind=options_pb2.VOLUME_KIND_TSDF)


def test_every_field_of_the_protocol_can_be_set() -> None:
    box = graspd.Box(graspd.pose([1, 2, 3]), [0.1, 0.2, 0.3])
    plan = graspd.PlanOptions(
        max_grasps=3,
        budget=1.5,
        seed=2**63,
        target=graspd.TargetPoint([1, 2, 3], 0.1),
        keep_out=[box],
        reaching=[0, 0, -2],
        max_tilt=0.0,
        roll=(-1.0, 1.0),
        min_score=0.0,
        friction=0.4,
        pregrasp_offset=0.0,
        opening_fraction=0.3,
        batch_size=24,
        scheme=(100, 40),
        trace=True,
        priority="servo",
        require_complete=True,
    ).to_wire()
    either = {"target_label", "target_point"}
    fields = {f.name for f in options_pb2.PlanOptions.DESCRIPTOR.fields}
    assert {f.name for f, _ in plan.ListFields()} | either == fields
    assert plan.budget.ToNanoseconds() == 1_500_000_000
    assert (plan.scheme.iteration_count, plan.scheme.penetration_iteration_count) == (100, 40)
    assert plan.HasField("min_score") and plan.HasField("pregrasp_offset_m")
    assert plan.orientation_limits.HasField("max_tilt_rad")
    assert (plan.reaching, plan.reaching_direction.z) == (options_pb2.REACHING_DIRECTION, -2)
    assert plan.keep_out_boxes[0].pose.position.y == 2 and plan.keep_out_boxes[0].half_extents_m.z == 0.3
    assert graspd.PlanOptions(target=4).to_wire().target_label == 4

    scene = graspd.SceneOptions(
        volume="occupancy",
        estimator="geometric",
        placement=graspd.Placement(np.eye(4), 0.0),
        grasp_region=box,
        focal_contact_threshold=0.0,
        focal_centroid_threshold=0.9,
        volume_size=0.5,
        volume_resolution=64,
    ).to_wire()
    assert {f.name for f, _ in scene.ListFields()} == {f.name for f in options_pb2.SceneOptions.DESCRIPTOR.fields}
    assert scene.workspace.HasField("table_height_m")


def test_reaching_by_name() -> None:
    assert graspd.PlanOptions(reaching="free").to_wire().reaching == options_pb2.REACHING_FREE
    assert graspd.PlanOptions(reaching="camera_ray").to_wire().reaching == options_pb2.REACHING_CAMERA_RAY


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (graspd.PlanOptions(reaching="sideways"), "reaching: found 'sideways'"),
        (graspd.PlanOptions(priority="now"), "priority: found 'now'"),  # type: ignore[arg-type]
        (graspd.PlanOptions(reaching=[1, 2]), "reaching: found an array"),
        (graspd.PlanOptions(target=graspd.TargetPoint([1], 0.1)), "target.point: found"),
        (graspd.PlanOptions(keep_out=[graspd.Box(np.eye(3), [1, 1, 1])]), r"keep_out\[0\].pose: found"),
        (graspd.SceneOptions(volume="points"), "volume: found 'points'"),  # type: ignore[arg-type]
        (graspd.SceneOptions(placement=graspd.Placement(np.zeros((4, 4)))), "placement.pose: found"),
    ],
)
def test_wrong_options_are_refused_by_name(options: graspd.PlanOptions | graspd.SceneOptions, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        options.to_wire()
