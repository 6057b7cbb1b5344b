"""Reads Situ's Protobuf messages with Foxglove's own decoder, and its CDR messages in the same way as ROS 2. FOLDER."""
import sys

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory as Protobuf
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

folder = sys.argv[1]
with open(f"{folder}/foxglove.mcap", "rb") as file:
    reader = make_reader(file, validate_crcs=True, decoder_factories=[Protobuf()])
    found = {}
    for schema, channel, message, decoded in reader.iter_decoded_messages():
        found.setdefault(channel.topic, []).append((schema.name, message.log_time, decoded))
assert {topic: (rows[0][0], len(rows)) for topic, rows in found.items()} == {
    "/camera": ("foxglove.RawImage", 20), "/cloud": ("foxglove.PointCloud", 20),
    "/tf": ("foxglove.FrameTransforms", 20),
    "/log": ("foxglove.Log", 20), "/jpeg": ("foxglove.CompressedImage", 20), "/place": ("foxglove.LocationFix", 20),
    "/level": ("lab.Level", 20)}, found.keys()
_, time, image = found["/camera"][3]
assert (image.width, image.height, image.encoding, image.step, image.frame_id) == (2, 1, "rgb8", 6, "lens"), image
assert image.data == bytes([1, 2, 3, 4, 5, 6]) and image.timestamp.seconds * 10**9 + image.timestamp.nanos == time
_, _, cloud = found["/cloud"][0]
assert [(f.name, f.offset, f.type) for f in cloud.fields] == [("x", 0, 7), ("y", 4, 7), ("z", 8, 7)], cloud.fields
_, _, tree = found["/tf"][0]
assert [(t.parent_frame_id, t.child_frame_id, t.translation.x) for t in tree.transforms] == [("world", "robot", 1.0)]
assert found["/log"][0][2].message == "step 0" and found["/log"][0][2].level == 2
assert (found["/place"][0][2].latitude, found["/place"][0][2].position_covariance[4]) == (46.5, 4.0)
level = found["/level"][1][2]
assert (level.volts, list(level.raw), level.kind, dict(level.tags)) == (0.5, [-1, 2**31], 1, {"a": 7}), level

store = get_typestore(Stores.ROS2_HUMBLE)
known = get_typestore(Stores.EMPTY)
with open(f"{folder}/ros2.mcap", "rb") as file:
    for schema, channel, message in make_reader(file).iter_messages():
        assert schema.encoding == "ros2msg" and channel.message_encoding == "cdr"
        if schema.name not in known.fielddefs:
            known.register(get_types_from_msg(schema.data.decode(), schema.name))
            # The definitions must have the same fields as in ROS 2.
            assert str(known.fielddefs[schema.name]) == str(store.fielddefs[schema.name]), schema.name
        decoded = store.deserialize_cdr(message.data, schema.name)
        if schema.name == "sensor_msgs/msg/Imu":
            assert decoded.header.stamp.sec * 10**9 + decoded.header.stamp.nanosec == message.log_time
            assert (decoded.header.frame_id, decoded.linear_acceleration.z) == ("base", 9.81)
        elif schema.name == "sensor_msgs/msg/CameraInfo":
            assert list(decoded.k)[:3] == [500.0, 0.0, 32.0], decoded.k
        else:
            assert schema.name == "tf2_msgs/msg/TFMessage" and decoded.transforms[0].child_frame_id == "robot"
