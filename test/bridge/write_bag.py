"""Writes the same 500 messages with rosbags as two bags, uncompressed and compressed."""
import sys
from pathlib import Path

from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

store = get_typestore(Stores.ROS1_NOETIC)
Float64 = store.types["std_msgs/msg/Float64"]
for name in ("none", "lz4"):
    path = Path(sys.argv[1]) / f"theirs-{name}.bag"
    writer = Writer(path)
    if name == "lz4":
        writer.set_compression(Writer.CompressionFormat.LZ4)
    with writer:
        connection = writer.add_connection("/values", "std_msgs/msg/Float64", typestore=store)
        for i in range(500):
            raw = store.serialize_ros1(Float64(data=i / 4), "std_msgs/msg/Float64")
            writer.write(connection, 1_000_000_000 + i * 1_000_000, raw)
