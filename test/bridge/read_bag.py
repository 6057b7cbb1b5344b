"""Reads Situ's bag with rosbags and decodes every message."""
import sys

from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_typestore

store = get_typestore(Stores.ROS1_NOETIC)
with Reader(sys.argv[1]) as reader:
    assert reader.message_count == int(sys.argv[2])
    for connection in reader.connections:
        assert store.generate_msgdef(connection.msgtype, ros_version=1)[1] == connection.digest, connection
    messages = [store.deserialize_ros1(raw, connection.msgtype) for connection, _, raw in reader.messages()]
assert len(messages) == int(sys.argv[2])
