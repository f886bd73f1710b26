"""Reads a recording with the mcap package of Python: the independent reader of the end-to-end tests.

Checks every message against the schema that its file carries, and what viewers need. Arguments: the folder, the number
of calls, the number of outcomes.
"""

import struct
import sys
from pathlib import Path

from foxglove_schemas_protobuf import (
    CameraCalibration_pb2,
    FrameTransform_pb2,
    PointCloud_pb2,
    PosesInFrame_pb2,
    RawImage_pb2,
    SceneUpdate_pb2,
)
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

# The schemas as their owner publishes them: what we wrote by hand has to agree in every name, number and type.
OFFICIAL = {
    "foxglove.CameraCalibration": CameraCalibration_pb2.CameraCalibration,
    "foxglove.FrameTransform": FrameTransform_pb2.FrameTransform,
    "foxglove.PointCloud": PointCloud_pb2.PointCloud,
    "foxglove.PosesInFrame": PosesInFrame_pb2.PosesInFrame,
    "foxglove.RawImage": RawImage_pb2.RawImage,
    "foxglove.SceneUpdate": SceneUpdate_pb2.SceneUpdate,
}


def compare(ours, official, seen):
    """Every field of ours is a field of the official message, down to the last."""
    if ours.full_name in seen:
        return
    seen.add(ours.full_name)
    for field in ours.fields:
        other = official.fields_by_name.get(field.name)
        assert other is not None, f"{ours.full_name}.{field.name} is not official"
        assert (field.number, field.type) == (other.number, other.type), f"{ours.full_name}.{field.name}"
        if field.enum_type is not None:
            values = {v.name: v.number for v in other.enum_type.values}
            assert {v.name: v.number for v in field.enum_type.values} == values, field.enum_type.full_name
        if field.message_type is not None:
            compare(field.message_type, other.message_type, seen)


def main():
    folder, calls, outcomes = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    seen_official = set()
    topics = {}
    frames = set()
    for path in sorted(folder.glob("graspd-*.mcap")):
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
            summary = reader.get_summary()
            assert summary is not None and summary.statistics.message_count > 0
            for schema, channel, message, decoded in reader.iter_decoded_messages():
                assert schema.encoding == channel.message_encoding == "protobuf"
                topics[channel.topic] = topics.get(channel.topic, 0) + 1
                if schema.name in OFFICIAL:
                    compare(decoded.DESCRIPTOR, OFFICIAL[schema.name].DESCRIPTOR, seen_official)
                    again = OFFICIAL[schema.name].FromString(message.data)
                    assert again.SerializeToString() == decoded.SerializeToString()
                if schema.name == "foxglove.RawImage":
                    pixel = {"16UC1": 2, "32FC1": 4}[decoded.encoding]
                    assert decoded.step == decoded.width * pixel
                    assert len(decoded.data) == decoded.step * decoded.height
                    frames.add(decoded.frame_id)
                elif schema.name == "foxglove.PointCloud" and channel.topic.startswith("/grasps/"):
                    names = [f.name for f in decoded.fields]
                    assert names == ["x", "y", "z", "red", "green", "blue", "alpha"], names
                    assert decoded.point_stride == 16 and len(decoded.data) % 16 == 0
                    points = list(struct.iter_unpack("<fff4B", decoded.data))
                    # The hand is blue; lines of grasps are green to red, contacts yellow.
                    hand = [p for p in points if p[5] > p[3]]
                    assert not points or 500 < len(hand) <= 6000, (len(points), len(hand))
                    assert all(abs(v) < 2 for p in points for v in p[:3])
                elif schema.name == "foxglove.PointCloud":
                    assert decoded.point_stride == 12 and [f.name for f in decoded.fields] == ["x", "y", "z"]
                    points = list(struct.iter_unpack("<fff", decoded.data))
                    assert 1000 < len(points) <= 40000 and all(0.1 < z < 2 for _, _, z in points)
                    assert decoded.frame_id in frames
                elif schema.name == "foxglove.CameraCalibration":
                    assert len(decoded.K) == len(decoded.R) == 9 and len(decoded.P) == 12
                elif schema.name == "foxglove.SceneUpdate":
                    ids = [entity.id for entity in decoded.entities]
                    assert ids[0] == "grasps" and len(decoded.deletions) == 1
                    if decoded.entities[0].arrows:
                        assert ids[1:] == ["contacts of the best", "hand at contact", "hand at pre-grasp"], ids
                        hand = decoded.entities[2]
                        assert hand.cubes or hand.cylinders or hand.spheres or hand.triangles
                        assert len(decoded.entities[1].spheres) >= 2
                elif schema.name == "graspd.v1.PlanRecord":
                    assert decoded.WhichOneof("request") in ("plan_grasps", "plan_multi_hand")
                    assert decoded.results and decoded.total_duration.ToNanoseconds() > 0
    assert topics["/graspd/plan"] == calls, topics
    assert topics.get("/graspd/outcomes", 0) == outcomes, topics
    for topic in ["/camera/0/depth", "/camera/0/calibration", "/camera/0/points"]:
        assert topics[topic] == calls, topics
    for topic in ["/tf", "/grasps/poses", "/grasps/scene", "/grasps/points", "/graspd/stats", "/grasps/left_arm/scene"]:
        assert topics[topic] > 0, topics
    assert seen_official >= set(OFFICIAL), seen_official
    print("all checks passed", topics)


main()
