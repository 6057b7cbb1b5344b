"""Writes ROS 2 recordings (CDR in MCAP and in SQLite) with rosbags."""
import sys
from pathlib import Path

import numpy
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

store = get_typestore(Stores.ROS2_HUMBLE)
types = store.types
Time, Header, Image = (types[n] for n in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", "sensor_msgs/msg/Image"))
Imu, Vector3, Quaternion = (types[n] for n in ("sensor_msgs/msg/Imu", "geometry_msgs/msg/Vector3", "geometry_msgs/msg/Quaternion"))
header = Header(stamp=Time(sec=5, nanosec=7), frame_id="camera")
image = Image(header=header, height=2, width=4, encoding="rgb8", is_bigendian=0, step=12, data=numpy.frombuffer(bytes([1, 2, 3] * 8), numpy.uint8))
zeros = numpy.zeros(9)
imu = Imu(header=header, orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=1.0), orientation_covariance=zeros, angular_velocity=Vector3(x=1.0, y=2.0, z=3.0),
          angular_velocity_covariance=zeros, linear_acceleration=Vector3(x=0.5, y=1.5, z=3.5), linear_acceleration_covariance=zeros)
for name, plugin in (("ros2", StoragePlugin.MCAP), ("ros2-sqlite", StoragePlugin.SQLITE3)):
    with Writer(Path(sys.argv[1]) / name, version=9, storage_plugin=plugin) as writer:
        pictures = writer.add_connection("/image", "sensor_msgs/msg/Image", typestore=store)
        moves = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=store)
        writer.write(pictures, 1_000, store.serialize_cdr(image, "sensor_msgs/msg/Image"))
        for i in range(20):
            writer.write(moves, 1_000 + i, store.serialize_cdr(imu, "sensor_msgs/msg/Imu"))
