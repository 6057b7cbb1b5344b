"""Decodes images that a recording stores as video. Needs PyAV (`pip install av`)."""

from __future__ import annotations

import collections
import dataclasses
from typing import Any, Iterable, Iterator

from .binary import Missing
from .values import Image, VideoPacket


def decode_video(messages: Iterable[Any]) -> Iterator[Any]:
    """Returns the messages of a stream with images instead of video packets.

    Messages before the first key frame are left out, because they cannot be decoded. Other messages are returned
    unchanged. Raises `Missing` if PyAV is not installed.
    """
    av = _import_av()
    decoder, shape = None, None
    waiting: collections.deque[Any] = collections.deque()
    for message in messages:
        packet = message.data
        if not isinstance(packet, VideoPacket):
            yield message
            continue
        if packet.position == 0 and shape != _shape_of(packet):
            if decoder is not None:
                yield from _take_images(decoder.decode(None), waiting)
            shape = _shape_of(packet)
            decoder = av.CodecContext.create(packet.codec, "r")
            decoder.thread_type = "SLICE"
        if decoder is not None:
            waiting.append(message)
            yield from _take_images(decoder.decode(av.Packet(bytes(packet.data))), waiting)
    if decoder is not None:
        yield from _take_images(decoder.decode(None), waiting)


def _import_av() -> Any:
    try:
        import av
    except ImportError:
        raise Missing("images that are stored as video need PyAV: pip install av") from None
    return av


def _shape_of(packet: VideoPacket) -> tuple[str, int, int, str]:
    return packet.codec, packet.width, packet.height, packet.format


# A decoder returns the images in the order of their packets.
def _take_images(frames: Iterable[Any], waiting: collections.deque[Any]) -> Iterator[Any]:
    for frame in frames:
        message = waiting.popleft()
        packet = message.data
        format = "gray" if packet.format == "gray8" else packet.format
        array = frame.to_ndarray(format=format)[: packet.height, : packet.width]
        yield dataclasses.replace(message, data=Image.from_array(array, packet.format))
