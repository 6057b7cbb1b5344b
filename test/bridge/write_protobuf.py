"""Writes an MCAP file of Foxglove messages with Foxglove's own package. FOLDER."""
import sys

from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.LaserScan_pb2 import LaserScan
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap_protobuf.writer import Writer

with open(f"{sys.argv[1]}/foxglove-theirs.mcap", "wb") as file, Writer(file) as writer:
    for n in range(50):
        time = 1_000_000_007 * (n + 1)
        stamp = {"seconds": time // 10**9, "nanos": time % 10**9}
        image = CompressedImage(timestamp=stamp, frame_id="cam", format="jpeg", data=b"\xff\xd8\xff\xe0" + bytes([n]))
        writer.write_message("/jpeg", image, log_time=time, publish_time=time)
        tf = FrameTransform(timestamp=stamp, parent_frame_id="world", child_frame_id="cam",
                            translation={"x": n}, rotation={"w": 1})
        writer.write_message("/tf", tf, log_time=time, publish_time=time)
        scan = LaserScan(timestamp=stamp, ranges=[0.5, float("inf"), float("nan")], end_angle=1.5)
        writer.write_message("/scan", scan, log_time=time, publish_time=time)
        entity = {"id": "box", "lifetime": {"seconds": 2}, "cubes": [{"size": {"x": 1}, "color": {"a": 1}}]}
        writer.write_message("/scene", SceneUpdate(entities=[entity]), log_time=time, publish_time=time)
