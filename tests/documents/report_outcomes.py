"""Plans with a server until it has 40 grasps, and reports what became of each: what documents on calibration need.

The better half of the grasps of every plan is reported as successes, the other half as failures.
"""

import graspd
import grpc
from graspd.v1 import planner_service_pb2 as wire
from graspd.v1 import planner_service_pb2_grpc as services

WANTED = 40

depth, intrinsics = graspd.examples.box_on_table()
reported = 0
with graspd.connect(timeout=120) as planner, grpc.insecure_channel("127.0.0.1:50051") as channel:
    service = services.PlannerServiceStub(channel)
    for seed in range(1, 30):
        plan = planner.plan(depth, intrinsics, hand="robotiq-2f85", options=graspd.PlanOptions(seed=seed))
        for index in range(len(plan)):
            outcome = wire.GRASP_OUTCOME_SUCCESS if index < len(plan) / 2 else wire.GRASP_OUTCOME_LOST_LIFTING
            request = wire.ReportOutcomeRequest(plan_id=plan.message.plan_id, grasp_index=index, outcome=outcome)
            service.ReportOutcome(request, timeout=60)
            reported += 1
        if reported >= WANTED:
            break
assert reported >= WANTED, f"found {reported} grasps in 29 plans, expected {WANTED}"
print(f"{reported} outcomes reported")
