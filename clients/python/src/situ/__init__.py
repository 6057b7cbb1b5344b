"""Reads and writes Situ's recordings and datasets, and exchanges live streams with Situ.

Times are integer nanoseconds since 1970, UTC, as in the rest of Situ.

    import situ

    with situ.create("lobby", "recordings") as store:
        store.write("Level", situ.now(), 0.5)

    for message in situ.open("recordings/lobby").read("Level"):
        print(message.time, message.data)

    with situ.publish("tcp://*:5556", topic="answers") as answers:
        for message in situ.subscribe("tcp://127.0.0.1:5555", topic="levels"):
            answers.send(message.time, message.data * 2)
"""

from .annotation import Annotation, Layer, layers
from .annotation import open_layer as annotations
from .binary import Damaged, Missing
from .component import Component
from .dataset import ConflictError, Dataset, Partition, Session
from .frames import Frame
from .lazy import Lazy
from .network import publish, pull, push, subscribe
from .reader import AbandonedWarning, DeletedWarning, Message, Store, Stream, open
from .segments import SegmentedStore
from .terms import Atom, Struct
from .times import from_datetime, from_text, now, to_datetime, to_text
from .values import AudioBuffer, DepthImage, EncodedImage, Image, PointCloud, Pose, Tensor, Undecoded, VideoPacket
from .video import decode_video
from .writer import Writer, create

__version__ = "1.0.0"
__all__ = [
    "AbandonedWarning",
    "Annotation",
    "Atom",
    "AudioBuffer",
    "Component",
    "ConflictError",
    "Damaged",
    "DeletedWarning",
    "Dataset",
    "DepthImage",
    "EncodedImage",
    "Frame",
    "Image",
    "Layer",
    "Lazy",
    "Message",
    "Missing",
    "Partition",
    "PointCloud",
    "Pose",
    "SegmentedStore",
    "Session",
    "Store",
    "Stream",
    "Struct",
    "Tensor",
    "Undecoded",
    "VideoPacket",
    "Writer",
    "annotations",
    "create",
    "decode_video",
    "from_datetime",
    "from_text",
    "layers",
    "now",
    "open",
    "publish",
    "pull",
    "push",
    "subscribe",
    "to_datetime",
    "to_text",
]
