"""What became of a grasp, told to a server that records."""

from __future__ import annotations

from typing import Literal, TypeAlias

from graspd.plans import Plan
from graspd.v1 import planner_service_pb2 as wire

Outcome: TypeAlias = Literal[
    "success",
    "collision",
    "unstable_contact",
    "lost_lifting",
    "lost_carrying",
    "not_delivered",
    "other_failure",
    "not_executed",
]
"""How an attempt ended; the failures are the paper's classes."""

_OUTCOMES = {
    "success": wire.GRASP_OUTCOME_SUCCESS,
    "collision": wire.GRASP_OUTCOME_COLLISION,
    "unstable_contact": wire.GRASP_OUTCOME_UNSTABLE_CONTACT,
    "lost_lifting": wire.GRASP_OUTCOME_LOST_LIFTING,
    "lost_carrying": wire.GRASP_OUTCOME_LOST_CARRYING,
    "not_delivered": wire.GRASP_OUTCOME_NOT_DELIVERED,
    "other_failure": wire.GRASP_OUTCOME_OTHER_FAILURE,
    "not_executed": wire.GRASP_OUTCOME_NOT_EXECUTED,
}


def outcome_request(plan: Plan | str, grasp_index: int, outcome: Outcome, note: str) -> wire.ReportOutcomeRequest:
    """The report as a message.

    Raises:
        ValueError: If the outcome is none.
    """
    if outcome not in _OUTCOMES:
        raise ValueError(f"outcome: found {outcome!r}, expected one of {', '.join(_OUTCOMES)}")
    plan_id = plan if isinstance(plan, str) else plan.message.plan_id
    return wire.ReportOutcomeRequest(plan_id=plan_id, grasp_index=grasp_index, outcome=_OUTCOMES[outcome], note=note)
