"""Plans from their messages: what the protocol promises is checked here, once."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import timezone

from graspd.errors import ProtocolError, Violation, call_error, code_of
from graspd.plans import (
    Accepted,
    Contact,
    Finished,
    Grasp,
    Improved,
    MultiPlan,
    NoGrasp,
    ObjectiveTerms,
    Plan,
    PlanEvent,
    PlanStats,
    Postures,
    ScoreParts,
    TaskResult,
    Workspace,
)
from graspd.poses import Array, pose_from_wire, vector_from_wire
from graspd.v1 import geometry_pb2, grasp_pb2, planner_service_pb2


def _postures(message: grasp_pb2.Postures) -> Postures:
    def named(values: Sequence[float]) -> dict[str, float]:
        if len(values) != len(message.names):
            raise ProtocolError(f"a posture has {len(values)} values for {len(message.names)} names")
        return dict(zip(message.names, values, strict=True))

    return Postures(named(message.open), named(message.contact), named(message.squeezed))


def placed(message: geometry_pb2.PoseInFrame, field_name: str) -> tuple[str, Array]:
    """The frame and the pose of a message.

    Raises:
        ProtocolError: If there is none.
    """
    if not message.HasField("pose"):
        raise ProtocolError(f"the server's answer has no {field_name}")
    return message.frame_id, pose_from_wire(message.pose)


def _terms(message: grasp_pb2.ObjectiveTerms) -> ObjectiveTerms:
    return ObjectiveTerms(**{name: getattr(message, name) for name in ObjectiveTerms.__dataclass_fields__})


def grasp_from_wire(message: grasp_pb2.Grasp) -> Grasp:
    """A grasp from its message.

    Raises:
        ProtocolError: If the server left out what the protocol promises.
    """
    frame_id, wrist = placed(message.wrist_pose, "wrist_pose")
    camera_frame_id, wrist_in_camera = placed(message.wrist_pose_in_camera, "wrist_pose_in_camera")
    parts = message.score_parts
    return Grasp(
        wrist_link=message.wrist_link,
        frame_id=frame_id,
        pose=wrist,
        pregrasp_pose=placed(message.pregrasp_pose, "pregrasp_pose")[1],
        camera_frame_id=camera_frame_id,
        pose_in_camera=wrist_in_camera,
        pregrasp_pose_in_camera=placed(message.pregrasp_pose_in_camera, "pregrasp_pose_in_camera")[1],
        joints=_postures(message.joints),
        actuators=_postures(message.actuators),
        contacts=tuple(
            Contact(vector_from_wire(c.point), vector_from_wire(c.normal), c.pad, c.finger, c.link, c.certainty)
            for c in message.contacts
        ),
        score=message.score,
        score_parts=ScoreParts(parts.objective, parts.force_closure, parts.clearance, parts.certainty),
        objective=_terms(message.objective),
        epsilon=message.epsilon,
        clearance=message.clearance_m,
        centroid=vector_from_wire(message.centroid),
        jaw_width=message.jaw_width_m if message.HasField("jaw_width_m") else None,
        label=message.label if message.HasField("label") else None,
        better_not=message.better_not,
    )


def _stats(message: grasp_pb2.PlanStats) -> PlanStats:
    return PlanStats(
        total=message.total_duration.ToNanoseconds() * 1e-9,
        queue=message.queue_duration.ToNanoseconds() * 1e-9,
        stages={stage.name: stage.duration.ToNanoseconds() * 1e-9 for stage in message.stages},
        rejected=dict(message.rejected_counts),
        candidates=message.candidate_count,
        iterations=message.iteration_count,
        focal_contacts=message.focal_contact_count,
        focal_centroids=message.focal_centroid_count,
        centered_centroids=message.centered_centroid_count,
        budget_exhausted=message.budget_exhausted,
        estimator=message.estimator,
        hand_revision=message.hand_revision,
        seed=message.seed,
        invalid_pixels=message.invalid_pixel_count,
    )


def _no_grasp(message: grasp_pb2.NoGrasp) -> NoGrasp:
    # An enum's number that is newer than this client has no name.
    known = grasp_pb2.NoGraspReason.DESCRIPTOR.values_by_number.get(message.reason)
    name = known.name if known is not None else "NO_GRASP_REASON_UNSPECIFIED"
    return NoGrasp(name.removeprefix("NO_GRASP_REASON_").lower(), message.nearest_fix)


def workspace_from_wire(message: grasp_pb2.Workspace) -> Workspace:
    """The volume from its message.

    Raises:
        ProtocolError: If it has no pose.
    """
    return Workspace(
        pose=placed(message.pose, "workspace.pose")[1],
        size=message.size_m,
        resolution=message.resolution,
        table_height=message.table_height_m if message.HasField("table_height_m") else None,
    )


def plan_from_wire(message: planner_service_pb2.PlanGraspsResponse) -> Plan:
    """A plan from its message.

    Raises:
        ProtocolError: If the server left out what the protocol promises.
    """
    return Plan(
        hand=message.stats.hand.removeprefix("hands/"),
        grasps=tuple(grasp_from_wire(g) for g in message.grasps),
        no_grasp=_no_grasp(message.no_grasp) if message.HasField("no_grasp") else None,
        workspace=workspace_from_wire(message.workspace) if message.HasField("workspace") else None,
        stats=_stats(message.stats),
        trace=tuple(_terms(t) for t in message.trace),
        capture_time=(message.capture_time.ToDatetime(timezone.utc) if message.HasField("capture_time") else None),
        message=message,
    )


def event_from_wire(message: planner_service_pb2.StreamGraspsResponse) -> PlanEvent:
    """An event from its message.

    Raises:
        ProtocolError: If it has none.
    """
    kind = message.WhichOneof("event")
    if kind == "accepted":
        return Accepted(message.accepted.queue_position)
    if kind == "improved":
        return Improved(plan_from_wire(message.improved))
    if kind == "finished":
        return Finished(plan_from_wire(message.finished))
    raise ProtocolError("a message of StreamGrasps without an event")


def result_from_wire(message: planner_service_pb2.HandTaskResult) -> TaskResult:
    """How a task ended, from its message."""
    if message.WhichOneof("outcome") == "response":
        return TaskResult(message.task_id, plan_from_wire(message.response), None)
    error = message.error
    return TaskResult(
        message.task_id,
        None,
        call_error(
            code_of(error.code),
            error.message,
            reason=error.reason,
            violations=[Violation(v.field, v.description) for v in error.field_violations],
        ),
    )


def multi_plan(
    order: Iterable[str], results: Iterable[TaskResult], summary: planner_service_pb2.MultiHandSummary | None
) -> MultiPlan:
    """All results in the order of the question.

    Raises:
        ProtocolError: If one is missing, or there was no summary.
    """
    tasks = list(order)
    found = {result.task_id: result for result in results}
    missing = [task for task in tasks if task not in found]
    if missing or summary is None:
        raise ProtocolError(f"the answers of {missing or 'the summary'} are missing from a plan for several hands")
    return MultiPlan({task: found[task] for task in tasks}, summary.total_duration.ToNanoseconds() * 1e-9)
