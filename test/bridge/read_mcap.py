"""Reads Situ's MCAP files with the mcap package: checks the order of time and checksums, and decodes ROS messages."""
import pathlib
import sys

from mcap.reader import make_reader
from mcap_ros1.decoder import DecoderFactory

for path in sorted(pathlib.Path(sys.argv[1]).glob("out-*.mcap")):
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary.statistics.message_count == 545, summary.statistics
        assert summary.statistics.chunk_count > 3
        found = list(reader.iter_decoded_messages())
        assert len(found) == 545
        times = [message.log_time for _, _, message, _ in found]
        assert times == sorted(times)
        texts = [ros.data for _, channel, _, ros in found if channel.topic == "/chatter"]
        assert texts[:2] == ["tick 0", "tick 25"], texts
        imu = next(ros for _, channel, _, ros in found if channel.topic == "/imu/data_raw")
        assert abs(imu.linear_acceleration.z - 9.8) < 1
        print(path.name, "ok")
