"""Writes and reads numbers and images with the Python package of Situ, and with the packages mcap and rosbags.

    bin/setup --with python-core
    pip install numpy mcap rosbags google-crc32c
    PYTHONPATH=apps/situ_python/priv/python python bench/python/stores.py [NUMBERS] [IMAGES]

The values are messages per second of CPU time (user and system), the median of three runs. Every run reads back and
checks what it wrote. Files are not compressed and in /dev/shm, so that disks do not matter.
"""

import resource
import shutil
import statistics
import struct
import sys
import tempfile

import numpy as np
import situ
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore

START, STEP = 1_700_000_000_000_000_000, 1_000_000


class Situ:
    """The package, message by message."""

    def __init__(self, folder, core=True):
        self.folder, self.core = folder, core

    def write_numbers(self, times, values):
        with situ.create("numbers", self.folder, core=self.core) as store:
            for time, value in zip(times.tolist(), values.tolist()):
                store.write("Level", time, value)

    def read_numbers(self):
        return sum(message.data for message in situ.open(f"{self.folder}/numbers", core=self.core).read("Level"))

    def write_images(self, times, image):
        with situ.create("images", self.folder, core=self.core) as store:
            for time in times.tolist():
                store.write("Camera", time, situ.Image.from_array(image, copy=False))

    def read_images(self):
        read = situ.open(f"{self.folder}/images", core=self.core).read("Camera")
        return sum(int(message.data.array[0, 0, 0]) for message in read)


class SituArrays(Situ):
    """The package, with arrays."""

    def write_numbers(self, times, values):
        with situ.create("numbers", self.folder, core=self.core) as store:
            store.write_array("Level", times, values)

    def read_numbers(self):
        return situ.open(f"{self.folder}/numbers", core=self.core).array("Level")[1].sum()


def measure_frames():
    """Prints the microseconds of CPU time for a row of a frame of IMU readings, with and without the core."""
    folder = tempfile.mkdtemp(dir="/dev/shm")
    try:
        with situ.create("imu", folder) as store:
            for n in range(50_000):
                turn = situ.Struct("Situ.Vector3", {"x": n / 3, "y": -n / 7, "z": 0.5})
                reading = {"acceleration": situ.Struct("Situ.Vector3", {**turn, "z": 9.81}), "angular_velocity": turn}
                store.write("IMU", START + STEP * n, situ.Struct("Situ.ImuReading", {**reading, "orientation": None}))
        for core in (True, False):
            store = situ.open(f"{folder}/imu", core=core)
            seconds, frame = measure(lambda: store.frame("IMU"))
            assert frame["acceleration.x"][3] == 1.0
            print(f"frames of IMU readings, {'with' if core else 'without'} the core: {seconds * 20:.2f} us a row")
    finally:
        shutil.rmtree(folder)


class Mcap:
    """The package mcap. A number is 8 bytes, and an image its pixels."""

    def __init__(self, folder):
        self.folder = folder

    def write(self, name, rows):
        with open(f"{self.folder}/{name}", "wb") as file:
            writer = Writer(file, compression=CompressionType.NONE)
            writer.start()
            schema = writer.register_schema("bytes", "", b"")
            channel = writer.register_channel(name, "bytes", schema)
            for time, data in rows:
                writer.add_message(channel, time, data, time)
            writer.finish()

    def read(self, name):
        with open(f"{self.folder}/{name}", "rb") as file:
            for _, _, message in make_reader(file).iter_messages():
                yield message.data

    def write_numbers(self, times, values):
        pack = struct.Struct("<d").pack
        self.write("numbers", zip(times.tolist(), map(pack, values.tolist())))

    def read_numbers(self):
        return sum(struct.unpack("<d", data)[0] for data in self.read("numbers"))

    def write_images(self, times, image):
        self.write("images", ((time, image.tobytes()) for time in times.tolist()))

    def read_images(self):
        return sum(int(np.frombuffer(data, "u1")[0]) for data in self.read("images"))


class Rosbags:
    """The package rosbags, with MCAP files: std_msgs/Float64 and sensor_msgs/Image."""

    def __init__(self, folder):
        self.folder = folder
        self.types = get_typestore(Stores.ROS2_HUMBLE)

    def write(self, name, kind, rows):
        with BagWriter(f"{self.folder}/{name}", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
            connection = bag.add_connection(f"/{name}", kind, typestore=self.types)
            for time, message in rows:
                bag.write(connection, time, self.types.serialize_cdr(message, kind))

    def read(self, name):
        from pathlib import Path

        with AnyReader([Path(f"{self.folder}/{name}")], default_typestore=self.types) as reader:
            for connection, _, raw in reader.messages():
                yield reader.deserialize(raw, connection.msgtype)

    def write_numbers(self, times, values):
        kind = self.types.types["std_msgs/msg/Float64"]
        rows = ((time, kind(data=value)) for time, value in zip(times.tolist(), values.tolist()))
        self.write("numbers", "std_msgs/msg/Float64", rows)

    def read_numbers(self):
        return sum(message.data for message in self.read("numbers"))

    def write_images(self, times, image):
        types = self.types.types
        moment = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
        header = types["std_msgs/msg/Header"](stamp=moment, frame_id="")
        message = types["sensor_msgs/msg/Image"](header, 1080, 1920, "rgb8", 0, 5760, image.reshape(-1))
        self.write("images", "sensor_msgs/msg/Image", ((time, message) for time in times.tolist()))

    def read_images(self):
        return sum(int(message.data[0]) for message in self.read("images"))


def cpu_seconds():
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def measure(work):
    before = cpu_seconds()
    result = work()
    return cpu_seconds() - before, result


def run(build, numbers, images):
    random = np.random.default_rng(1)
    times, values = START + STEP * np.arange(numbers), random.normal(size=numbers)
    image = random.integers(1, 255, (1080, 1920, 3), dtype="u1")
    rates = {}
    for _ in range(3):
        folder = tempfile.mkdtemp(dir="/dev/shm")
        try:
            peer = build(folder)
            jobs = {
                "write_numbers": (numbers, lambda: peer.write_numbers(times, values)),
                "read_numbers": (numbers, peer.read_numbers),
                "write_images": (images, lambda: peer.write_images(times[:images], image)),
                "read_images": (images, peer.read_images),
            }
            for job, (count, work) in jobs.items():
                seconds, result = measure(work)
                wanted = {"read_numbers": values.sum(), "read_images": images * int(image[0, 0, 0])}.get(job)
                assert wanted is None or np.isclose(result, wanted), (job, result, wanted)
                rates.setdefault(job, []).append(count / seconds)
        finally:
            shutil.rmtree(folder)
    return {job: statistics.median(found) for job, found in rates.items()}


def main():
    numbers, images = (int(word) for word in (sys.argv[1:] + ["1000000", "100"])[:2])
    peers = {
        "Situ, arrays": (SituArrays, numbers),
        "Situ, messages": (Situ, numbers),
        "Situ in Python, arrays": (lambda folder: SituArrays(folder, core=False), numbers // 10),
        "Situ in Python, messages": (lambda folder: Situ(folder, core=False), numbers // 10),
        "mcap": (Mcap, numbers // 10),
        "rosbags": (Rosbags, numbers // 10),
    }
    print("| | numbers written | read | 1080p images written | read |\n|---|---|---|---|---|")
    for label, (build, count) in peers.items():
        rates = run(build, count, images)
        cells = [f"{rates[job] / 1e6:.2f} M/s" for job in ("write_numbers", "read_numbers")]
        cells += [f"{rates[job]:,.0f}/s" for job in ("write_images", "read_images")]
        print(f"| {label} | {' | '.join(cells)} |", flush=True)
    measure_frames()


if __name__ == "__main__":
    main()
