"""Looks at the live view with software of its own: the independent viewer of the end-to-end tests.

Speaks the Foxglove WebSocket protocol over the package `websockets`, decodes every message by the schema that the server
sends, and again by the owner's own schemas. Arguments: the port, a file with what gRPC answered (JSON: task, poses),
and a second one that is written once this script has said "looking". For the servo the third.
"""

import asyncio
import base64
import json
import struct
import sys
from pathlib import Path

import websockets
from foxglove_schemas_protobuf import (
    CameraCalibration_pb2,
    FrameTransform_pb2,
    PointCloud_pb2,
    PosesInFrame_pb2,
    RawImage_pb2,
    SceneUpdate_pb2,
)
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

OFFICIAL = {
    "foxglove.CameraCalibration": CameraCalibration_pb2.CameraCalibration,
    "foxglove.FrameTransform": FrameTransform_pb2.FrameTransform,
    "foxglove.PointCloud": PointCloud_pb2.PointCloud,
    "foxglove.PosesInFrame": PosesInFrame_pb2.PosesInFrame,
    "foxglove.RawImage": RawImage_pb2.RawImage,
    "foxglove.SceneUpdate": SceneUpdate_pb2.SceneUpdate,
}
PATIENCE = 60


class Viewer:
    """Subscribes to every channel that there is, and keeps the last message of each."""

    def __init__(self, socket):
        self.socket = socket
        self.channels = {}
        self.messages = {}
        self.seen = set()

    async def step(self):
        """One message of the server."""
        message = await asyncio.wait_for(self.socket.recv(), PATIENCE)
        if isinstance(message, bytes):
            opcode, subscription, time_ns = struct.unpack_from("<BIQ", message)
            assert opcode == 1
            channel = self.channels[subscription - 1000]
            self.messages[channel["topic"]] = (time_ns, self.decode(channel, message[13:]))
            return
        words = json.loads(message)
        if words["op"] == "serverInfo":
            assert words["name"].startswith("graspd ") and words["capabilities"] == [], words
        elif words["op"] == "advertise":
            new = []
            for channel in words["channels"]:
                assert channel["encoding"] == channel["schemaEncoding"] == "protobuf"
                channel["type"] = self.read_schema(channel)
                self.channels[channel["id"]] = channel
                new.append({"id": 1000 + channel["id"], "channelId": channel["id"]})
            await self.socket.send(json.dumps({"op": "subscribe", "subscriptions": new}))
        elif words["op"] == "unadvertise":
            for gone in words["channelIds"]:
                self.messages.pop(self.channels.pop(gone)["topic"], None)
        else:
            raise AssertionError(words)

    @staticmethod
    def read_schema(channel):
        files = descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"]))
        pool = descriptor_pool.DescriptorPool()
        for file in files.file:
            pool.Add(file)
        return message_factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))

    def decode(self, channel, data):
        ours = channel["type"].FromString(data)
        self.seen.add(channel["schemaName"])
        official = OFFICIAL.get(channel["schemaName"])
        if official is not None:
            # Nothing that the owner's schema does not know, and nothing that it reads otherwise.
            again = official.FromString(data)
            assert again.SerializeToString(deterministic=True) == ours.SerializeToString(deterministic=True)
        return ours

    async def until(self, topics, newer_than=0):
        """Until there is a message of each of these topics."""
        while not all(t in self.messages and self.messages[t][0] > newer_than for t in topics):
            await self.step()


def poses_of(message):
    return [
        [getattr(p.position, k) for k in "xyz"] + [getattr(p.orientation, k) for k in "xyzw"] for p in message.poses
    ]


def same(seen, expected):
    """Positions to the bit; quaternions are made unit once more before they are drawn."""
    assert len(seen) == len(expected), (seen, expected)
    for a, b in zip(seen, expected):
        assert a[:3] == b[:3] and all(abs(x - y) < 1e-12 for x, y in zip(a[3:], b[3:])), (a, b)


def check_scene(update, count):
    ids = [entity.id for entity in update.entities]
    assert ids == ["grasps", "contacts of the best", "hand at contact", "hand at pre-grasp"], ids
    assert len(update.entities[0].arrows) == count and len(update.entities[1].spheres) >= 2
    hand = update.entities[2]
    assert hand.cubes or hand.cylinders or hand.spheres or hand.triangles


async def main():
    port, first, second, third = int(sys.argv[1]), *map(Path, sys.argv[2:5])
    protocols = ["foxglove.websocket.v1"]
    async with websockets.connect(f"ws://127.0.0.1:{port}", subprotocols=protocols, max_size=None) as socket:
        assert socket.subprotocol == protocols[0]
        viewer = Viewer(socket)
        base = ["/camera/0/depth", "/camera/0/calibration", "/camera/0/points", "/tf", "/graspd/stats", "/graspd/plan"]
        # What was planned before this viewer came.
        expected = json.loads(first.read_text())
        await viewer.until([*base, "/grasps/poses", "/grasps/scene", "/grasps/points"])
        time_ns, poses = viewer.messages["/grasps/poses"]
        same(poses_of(poses), expected["poses"])
        assert poses.frame_id == expected["frame_id"], (poses.frame_id, expected["frame_id"])
        check_scene(viewer.messages["/grasps/scene"][1], len(expected["poses"]))
        image = viewer.messages["/camera/0/depth"][1]
        pixel = {"16UC1": 2, "32FC1": 4}[image.encoding]
        assert image.step == image.width * pixel and len(image.data) == image.step * image.height
        cloud = viewer.messages["/camera/0/points"][1]
        points = list(struct.iter_unpack("<fff", cloud.data))
        assert 1000 < len(points) <= 40000 and all(0.1 < z < 2 for _, _, z in points)
        stats = viewer.messages["/graspd/stats"][1]
        assert stats.hand == expected["hand"] and len(stats.stages) > 3
        # Pixels are sent once, as an image.
        plan = viewer.messages["/graspd/plan"][1]
        assert plan.plan_grasps.frames[0].data == b"" and plan.results[0].response.plan_id == expected["plan_id"]
        transform = viewer.messages["/tf"][1]
        assert (transform.parent_frame_id, transform.child_frame_id) == (expected["frame_id"], image.frame_id)

        print("looking", flush=True)
        # Two hands at once, while we look: other channels, and the old ones are gone.
        topics = ["/grasps/left_arm/poses", "/grasps/right/poses", "/grasps/left_arm/scene", "/grasps/right/scene"]
        await viewer.until(topics, newer_than=time_ns)
        while not second.exists():
            await asyncio.sleep(0.05)
        for task, answer in json.loads(second.read_text()).items():
            poses = viewer.messages[f"/grasps/{task}/poses"][1]
            same(poses_of(poses), answer["poses"])
            check_scene(viewer.messages[f"/grasps/{task}/scene"][1], len(answer["poses"]))
        assert "/grasps/poses" not in viewer.messages

        print("looking at the servo", flush=True)
        seen = ("camera/depth", "camera/calibration", "camera/points", "poses", "scene", "points", "answer")
        servo = [f"/servo/{t}" for t in seen]
        await viewer.until(servo)
        while not third.exists():
            await asyncio.sleep(0.05)
        expected = json.loads(third.read_text())
        # Pictures may have been left out, the last one may not.
        while viewer.messages["/servo/answer"][1].sequence != expected["sequence"]:
            await viewer.step()
        await viewer.until(["/servo/poses"], newer_than=viewer.messages["/servo/answer"][0] - 1)
        same(poses_of(viewer.messages["/servo/poses"][1]), expected["poses"])
        check_scene(viewer.messages["/servo/scene"][1], 1)

        assert viewer.seen >= {*OFFICIAL, "graspd.v1.PlanRecord", "graspd.v1.PlanStats", "graspd.v1.ServoGraspResponse"}
        print("looking at the end", flush=True)
        try:
            while True:
                await viewer.step()
        except websockets.ConnectionClosed as closed:
            assert closed.rcvd is not None and closed.rcvd.code == 1001, closed
    print("all checks passed", sorted(viewer.seen))


asyncio.run(main())
