"""A graspd client in Python: plans grasps of a box on a table and checks the answers.

Usage: plan_client.py HOST:PORT, with the stubs generated from proto/ on PYTHONPATH.
"""

import sys

import grpc
import numpy as np

from graspd.v1 import frame_pb2, hand_service_pb2, hand_service_pb2_grpc
from graspd.v1 import options_pb2, planner_service_pb2, planner_service_pb2_grpc

WIDTH, HEIGHT, FOCAL = 320, 240, 300.0


def box_on_a_table():
    """Depth in millimetres of a camera 0.5 m above a table, looking straight down on a box of 4 x 7 x 8 cm."""
    columns, rows = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    x = (columns - (WIDTH - 1) / 2) / FOCAL
    y = (rows - (HEIGHT - 1) / 2) / FOCAL
    depth = np.full((HEIGHT, WIDTH), 0.50)
    top = 0.42
    depth[(np.abs(x * top) < 0.02) & (np.abs(y * top) < 0.035)] = top
    return np.rint(depth * 1000).astype("<u2")


def depth_frame(pixels):
    return frame_pb2.DepthFrame(
        width_px=WIDTH,
        height_px=HEIGHT,
        encoding=frame_pb2.DEPTH_ENCODING_RAW_U16,
        depth_scale_m=0.001,
        data=pixels.tobytes(),
        intrinsics=frame_pb2.CameraIntrinsics(
            fx_px=FOCAL, fy_px=FOCAL, cx_px=(WIDTH - 1) / 2, cy_px=(HEIGHT - 1) / 2
        ),
    )


def main(address):
    with grpc.insecure_channel(address) as channel:
        hands = hand_service_pb2_grpc.HandServiceStub(channel)
        planner = planner_service_pb2_grpc.PlannerServiceStub(channel)

        names = [hand.name for hand in hands.ListHands(hand_service_pb2.ListHandsRequest(), timeout=10).hands]
        assert "hands/robotiq-2f85" in names, names

        request = planner_service_pb2.PlanGraspsRequest(
            hand="hands/robotiq-2f85",
            frames=[depth_frame(box_on_a_table())],
            options=options_pb2.PlanOptions(max_grasp_count=5, seed=1),
        )
        answer = planner.PlanGrasps(request, timeout=60)
        assert 1 <= len(answer.grasps) <= 5, answer
        best = answer.grasps[0]
        position = best.wrist_pose.pose.position
        assert best.wrist_pose.frame_id == "camera", best
        assert np.hypot(position.x, position.y) < 0.3 and 0.1 < position.z < 0.6, position
        print(f"{len(answer.grasps)} grasps, best score {best.score:.2f}")

        stream = planner_service_pb2.StreamGraspsRequest(plan=request)
        events = [event.WhichOneof("event") for event in planner.StreamGrasps(stream, timeout=60)]
        assert events[0] == "accepted" and events[-1] == "finished", events

        request.frames[0].intrinsics.fx_px = 0
        try:
            planner.PlanGrasps(request, timeout=10)
        except grpc.RpcError as error:
            assert error.code() == grpc.StatusCode.INVALID_ARGUMENT, error
            assert "frames[0].intrinsics.fx_px" in error.details(), error.details()
        else:
            raise AssertionError("a focal length of 0 was taken")
    print("all checks passed")


if __name__ == "__main__":
    main(sys.argv[1])
