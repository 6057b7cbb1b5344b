"""Images, audio and other data with a binary layout, available as numpy arrays if numpy is installed."""

from __future__ import annotations

import dataclasses
import struct
from typing import Any, Optional

from .binary import Buffer, Damaged, Missing


def import_numpy() -> Any:
    """Returns the module numpy. Raises `Missing` if it is not installed."""
    try:
        import numpy
    except ImportError:
        raise Missing("numpy is not installed: pip install situ[numpy]") from None
    return numpy


# code: name, bits per channel, channels
IMAGE_FORMATS = {
    1: ("gray8", 8, 1),
    2: ("gray16", 16, 1),
    3: ("bgr24", 8, 3),
    4: ("rgb24", 8, 3),
    5: ("bgrx32", 8, 4),
    6: ("bgra32", 8, 4),
    7: ("rgba32", 8, 4),
    8: ("rgba64", 16, 4),
}
_IMAGE_CODES = {name: code for code, (name, _, _) in IMAGE_FORMATS.items()}
# code: name, numpy type
SAMPLE_FORMATS = {
    1: ("u8", "u1"),
    2: ("s16", "<i2"),
    3: ("s24", None),
    4: ("s32", "<i4"),
    5: ("f32", "<f4"),
    6: ("f64", "<f8"),
}
_SAMPLE_CODES = {name: code for code, (name, _) in SAMPLE_FORMATS.items()}
_SAMPLE_BYTES = {"u8": 1, "s16": 2, "s24": 3, "s32": 4, "f32": 4, "f64": 8}
TENSOR_TYPES = ["<f4", "<f8", "i1", "<i2", "<i4", "<i8", "u1", "<u2", "<u4", "<u8", "?", "<f2", "bf16"]


def _require(condition: Any, what: str) -> None:
    if not condition:
        raise Damaged(what)


class _Value:
    """Base class whose `repr` shows long bytes by their length, since an image has millions of them."""

    def __repr__(self) -> str:
        shown = (f"{name}={_format_field(field)}" for name, field in vars(self).items())
        return f"{type(self).__name__}({', '.join(shown)})"

    def __getstate__(self) -> dict[str, Any]:
        # A view of a mapped file cannot be pickled, but its bytes can.
        return {name: bytes(item) if isinstance(item, memoryview) else item for name, item in vars(self).items()}


def _format_field(value: Any) -> str:
    long = isinstance(value, (bytes, bytearray, memoryview)) and len(value) > 16
    return f"<{len(value)} bytes>" if long else repr(value)


_ARRAY_FORMATS = {
    ("uint8", 1): "gray8",
    ("uint16", 1): "gray16",
    ("uint8", 3): "rgb24",
    ("uint8", 4): "rgba32",
    ("uint16", 4): "rgba64",
}


@dataclasses.dataclass(repr=False)
class Image(_Value):
    """An image: `data` contains `height` rows of `stride` bytes."""

    width: int
    height: int
    format: str
    stride: int
    data: Buffer

    NAME = "situ.image"
    TYPE = "Situ.Image"
    HEAD = struct.Struct("<BBHIII48x")

    @classmethod
    def from_array(cls, array: Any, format: Optional[str] = None, copy: bool = True) -> Image:
        """Builds an image from a uint8 or uint16 array of shape (height, width) or (height, width, channels).

        Three channels are rgb24 unless `format` is given. With `copy=False`, the image refers to the array's memory.
        """
        np = import_numpy()
        array = np.asarray(array)
        channels = array.shape[2] if array.ndim == 3 else 1
        format = format or _ARRAY_FORMATS.get((array.dtype.name, channels))
        pixel = (array.dtype.itemsize * 8, channels)
        if format not in _IMAGE_CODES or IMAGE_FORMATS[_IMAGE_CODES[format]][1:] != pixel:
            raise ValueError(f"an array of {array.dtype} with shape {array.shape} is not an image of format {format}")
        array = np.ascontiguousarray(array)
        data = array.tobytes() if copy else memoryview(array).cast("B")
        return cls(array.shape[1], array.shape[0], format, len(data) // array.shape[0], data)

    @property
    def array(self) -> Any:
        """The pixels without a copy: (height, width) or (height, width, channels), uint8 or uint16.

        The channels are in the order of `format`.
        """
        _, bits, channels = IMAGE_FORMATS[_IMAGE_CODES[self.format]]
        pixel = bits * channels // 8
        shape: tuple[int, ...] = (self.height, self.width)
        strides: tuple[int, ...] = (self.stride, pixel)
        if channels > 1:
            shape, strides = (*shape, channels), (*strides, bits // 8)
        return import_numpy().ndarray(shape, "u1" if bits == 8 else "<u2", self.data, strides=strides)

    @property
    def rgb(self) -> Any:
        """The pixels as (height, width, 3) with red first, for any format."""
        array = self.array
        if array.ndim == 2:
            return import_numpy().stack([array] * 3, axis=2)
        return array[:, :, 2::-1] if self.format.startswith("bgr") else array[:, :, :3]

    def encode(self) -> bytes:
        return self._encode_head() + bytes(self.data)

    def _encode_head(self) -> bytes:
        return self.HEAD.pack(1, _IMAGE_CODES[self.format], 0, self.width, self.height, self.stride)

    @classmethod
    def decode(cls, raw: Any) -> Image:
        _require(len(raw) >= cls.HEAD.size, "an image is shorter than its header")
        version, code, _, width, height, stride = cls.HEAD.unpack_from(raw)
        _require(version == 1 and code in IMAGE_FORMATS, "an image has an unknown version or format")
        name, bits, channels = IMAGE_FORMATS[code]
        row, data = width * bits * channels // 8, raw[cls.HEAD.size :]
        enough = stride * max(height - 1, 0) + (row if height else 0)
        _require(row <= stride and len(data) >= enough, "an image has too few bytes")
        return cls(width, height, name, stride, data)


@dataclasses.dataclass(repr=False)
class DepthImage(_Value):
    """A depth image of 16-bit integers in units of `scale` metres.

    Depth is measured along the optical axis (`semantics` is "plane") or along the ray of the pixel ("point").
    """

    width: int
    height: int
    stride: int
    scale: float
    semantics: str
    data: Buffer

    NAME = "situ.depth_image"
    TYPE = "Situ.DepthImage"
    HEAD = struct.Struct("<BBHIIId40x")

    @classmethod
    def from_array(cls, array: Any, scale: float = 0.001, semantics: str = "plane") -> DepthImage:
        """Builds a depth image from a uint16 array of shape (height, width)."""
        array = import_numpy().ascontiguousarray(array, "<u2")
        return cls(array.shape[1], array.shape[0], 2 * array.shape[1], scale, semantics, array.tobytes())

    @property
    def array(self) -> Any:
        """The depths without a copy: (height, width), uint16."""
        return import_numpy().ndarray((self.height, self.width), "<u2", self.data, strides=(self.stride, 2))

    @property
    def metres(self) -> Any:
        """The depths in metres: (height, width), float64."""
        return self.array * self.scale

    def encode(self) -> bytes:
        head = self.HEAD.pack(1, self.semantics == "point", 0, self.width, self.height, self.stride, self.scale)
        return head + bytes(self.data)

    @classmethod
    def decode(cls, raw: Any) -> DepthImage:
        _require(len(raw) >= cls.HEAD.size and raw[0] == 1, "a depth image is too short or has an unknown version")
        _, semantics, _, width, height, stride, scale = cls.HEAD.unpack_from(raw)
        data = raw[cls.HEAD.size :]
        enough = stride * max(height - 1, 0) + (2 * width if height else 0)
        _require(2 * width <= stride and len(data) >= enough, "a depth image has too few bytes")
        return cls(width, height, stride, scale, "point" if semantics else "plane", data)


@dataclasses.dataclass(repr=False)
class EncodedImage(_Value):
    """An encoded image, `format` "jpeg" or "png"."""

    format: str
    width: int
    height: int
    data: Buffer

    NAME = "situ.encoded_image"
    TYPE = "Situ.EncodedImage"
    HEAD = struct.Struct("<BBHIII")

    def encode(self) -> bytes:
        return self.HEAD.pack(1, {"jpeg": 1, "png": 2}[self.format], 0, self.width, self.height, 0) + bytes(self.data)

    @classmethod
    def decode(cls, raw: Any) -> EncodedImage:
        _require(len(raw) >= cls.HEAD.size, "an encoded image is shorter than its header")
        version, code, _, width, height, _ = cls.HEAD.unpack_from(raw)
        _require(version == 1 and code in (1, 2), "an encoded image has an unknown version or format")
        return cls("jpeg" if code == 1 else "png", width, height, raw[cls.HEAD.size :])


# code: name
VIDEO_CODECS = {1: "h264", 2: "vp8", 3: "vp9"}
_VIDEO_CODES = {name: code for code, name in VIDEO_CODECS.items()}


@dataclasses.dataclass(repr=False)
class VideoPacket(_Value):
    """One image of a stream of images that is recorded as video: the bytes for a decoder.

    `position` is 0 for a key frame, where a decoder can start, otherwise the number of images since the last one.
    `situ.decode_video` returns the images.
    """

    codec: str
    position: int
    width: int
    height: int
    format: str
    data: bytes

    NAME = "situ.video_packet"
    TYPE = "Situ.VideoPacket"
    HEAD = struct.Struct("<BBBBIII")

    def encode(self) -> bytes:
        codes = (1, _VIDEO_CODES[self.codec], _IMAGE_CODES[self.format], 0)
        return self.HEAD.pack(*codes, self.width, self.height, self.position) + bytes(self.data)

    @classmethod
    def decode(cls, raw: Any) -> VideoPacket:
        _require(len(raw) >= cls.HEAD.size, "a video packet is shorter than its header")
        version, codec, format, _, width, height, position = cls.HEAD.unpack_from(raw)
        known = version == 1 and codec in VIDEO_CODECS and format in IMAGE_FORMATS
        _require(known, "a video packet has an unknown version, codec or format")
        return cls(VIDEO_CODECS[codec], position, width, height, IMAGE_FORMATS[format][0], raw[cls.HEAD.size :])


@dataclasses.dataclass(repr=False)
class AudioBuffer(_Value):
    """Audio: interleaved little-endian samples. The time of its message is the end of the buffer."""

    rate: int
    channels: int
    sample: str
    data: Buffer

    NAME = "situ.audio_buffer"
    TYPE = "Situ.AudioBuffer"
    HEAD = struct.Struct("<BBHI8x")

    @classmethod
    def from_array(cls, array: Any, rate: int) -> AudioBuffer:
        """Builds a buffer from an array of shape (frames,) or (frames, channels).

        The array's type is uint8, int16, int32, float32 or float64.
        """
        np = import_numpy()
        array = np.asarray(array)
        names = {"uint8": "u8", "int16": "s16", "int32": "s32", "float32": "f32", "float64": "f64"}
        sample = names.get(array.dtype.name)
        if sample is None or array.ndim > 2:
            raise ValueError(f"an array of {array.dtype} with shape {array.shape} is not audio")
        layout = SAMPLE_FORMATS[_SAMPLE_CODES[sample]][1]
        channels = array.shape[1] if array.ndim == 2 else 1
        return cls(rate, channels, sample, np.ascontiguousarray(array, layout).tobytes())

    @property
    def array(self) -> Any:
        """The samples as (frames, channels) in their own type; 24-bit samples are int32."""
        np = import_numpy()
        layout = SAMPLE_FORMATS[_SAMPLE_CODES[self.sample]][1]
        if layout:
            return np.frombuffer(self.data, layout).reshape(-1, self.channels)
        triples = np.frombuffer(self.data, "u1").reshape(-1, 3).astype("<i4")
        values = triples[:, 0] | triples[:, 1] << 8 | triples[:, 2] << 16
        return ((values ^ 0x800000) - 0x800000).reshape(-1, self.channels)

    @property
    def floats(self) -> Any:
        """The samples as (frames, channels), float32, scaled to full scale 1.0."""
        np = import_numpy()
        if self.sample in ("f32", "f64"):
            return self.array.astype("f4")
        if self.sample == "u8":
            return (self.array.astype("f4") - 128) / 128
        return (self.array / float(1 << {"s16": 15, "s24": 23, "s32": 31}[self.sample])).astype(np.float32)

    def encode(self) -> bytes:
        return self.HEAD.pack(1, _SAMPLE_CODES[self.sample], self.channels, self.rate) + bytes(self.data)

    @classmethod
    def decode(cls, raw: Any) -> AudioBuffer:
        _require(len(raw) >= cls.HEAD.size, "an audio buffer is shorter than its header")
        version, code, channels, rate = cls.HEAD.unpack_from(raw)
        known = version == 1 and code in SAMPLE_FORMATS and channels and rate
        _require(known, "an audio buffer has an unknown version or format")
        name, data = SAMPLE_FORMATS[code][0], raw[cls.HEAD.size :]
        _require(len(data) % (channels * _SAMPLE_BYTES[name]) == 0, "an audio buffer ends within a frame")
        return cls(rate, channels, name, data)


@dataclasses.dataclass(repr=False)
class Tensor(_Value):
    """A tensor: numbers with a shape. A numpy array is written as a tensor."""

    dtype: str
    shape: tuple[int, ...]
    data: Buffer

    NAME = "situ.tensor"
    TYPE = "Situ.Tensor"

    @classmethod
    def from_array(cls, array: Any, copy: bool = True) -> Tensor:
        """Builds a tensor from an array of booleans or numbers of up to 64 bits.

        With `copy=False`, the tensor refers to the array's memory.
        """
        np = import_numpy()
        array = np.asarray(array)
        layout = array.dtype.newbyteorder("<").str.replace("|", "")
        layout = "?" if layout == "b1" else layout
        if layout not in TENSOR_TYPES:
            raise ValueError(f"a tensor cannot contain {array.dtype}")
        shape, array = array.shape, np.ascontiguousarray(array, layout)
        # A memoryview of an empty array cannot be cast.
        data = array.tobytes() if copy or array.size == 0 else memoryview(array).cast("B")
        return cls(layout, shape, data)

    @property
    def array(self) -> Any:
        """The numbers as a numpy array; bfloat16 numbers are float32."""
        np = import_numpy()
        if self.dtype == "bf16":
            return (np.frombuffer(self.data, "<u2").astype("<u4") << 16).view("<f4").reshape(self.shape)
        return np.frombuffer(self.data, self.dtype).reshape(self.shape)

    def encode(self) -> bytes:
        return self._encode_head() + bytes(self.data)

    def _encode_head(self) -> bytes:
        dims = struct.pack(f"<{len(self.shape)}I", *self.shape)
        return bytes([TENSOR_TYPES.index(self.dtype), len(self.shape)]) + dims

    @classmethod
    def decode(cls, raw: Any) -> Tensor:
        known = len(raw) >= 2 and raw[0] < len(TENSOR_TYPES) and len(raw) >= 2 + 4 * raw[1]
        _require(known, "a tensor is too short or has an unknown type")
        shape = struct.unpack_from(f"<{raw[1]}I", raw, 2)
        dtype, data, count = TENSOR_TYPES[raw[0]], raw[2 + 4 * raw[1] :], 1
        for size in shape:
            count *= size
        width = 2 if dtype == "bf16" else 1 if dtype == "?" else int(dtype[-1])
        _require(len(data) == count * width, "a tensor's size does not match its shape")
        return cls(dtype, shape, data)


@dataclasses.dataclass(repr=False)
class PointCloud(_Value):
    """A point cloud: points of three float32 (metres), with optional colors (uint8) and values (float32)."""

    points: Buffer
    colors: Optional[Buffer] = None
    values: Optional[Buffer] = None

    NAME = "situ.point_cloud"
    TYPE = "Situ.PointCloud"

    @classmethod
    def from_array(cls, points: Any, colors: Any = None, values: Any = None) -> PointCloud:
        """Builds a cloud from arrays: points (n, 3), colors (n, 3) and values (n)."""
        np = import_numpy()

        def to_bytes(array: Any, kind: str) -> Any:
            return None if array is None else np.ascontiguousarray(array, kind).tobytes()

        return cls(to_bytes(points, "<f4"), to_bytes(colors, "u1"), to_bytes(values, "<f4"))

    @property
    def array(self) -> Any:
        """The points: (n, 3), float32."""
        return import_numpy().frombuffer(self.points, "<f4").reshape(-1, 3)

    @property
    def rgb(self) -> Any:
        """The colors: (n, 3), uint8, or None."""
        return None if self.colors is None else import_numpy().frombuffer(self.colors, "u1").reshape(-1, 3)

    @property
    def numbers(self) -> Any:
        """The values: (n), float32, or None."""
        return None if self.values is None else import_numpy().frombuffer(self.values, "<f4")

    def encode(self) -> bytes:
        flags = (self.colors is not None) + 2 * (self.values is not None)
        head = struct.pack("<BBHI", 1, flags, 0, len(self.points) // 12)
        return head + bytes(self.points) + bytes(self.colors or b"") + bytes(self.values or b"")

    @classmethod
    def decode(cls, raw: Any) -> PointCloud:
        known = len(raw) >= 8 and raw[0] == 1 and raw[1] in range(4)
        _require(known, "a point cloud is too short or has an unknown version")
        count = struct.unpack_from("<I", raw, 4)[0]
        has_colors, has_values = raw[1] & 1, raw[1] & 2
        points_end = 8 + 12 * count
        colors_end = points_end + (3 * count if has_colors else 0)
        size = colors_end + (4 * count if has_values else 0)
        _require(len(raw) == size, "a point cloud's size does not match its header")
        colors = raw[points_end:colors_end] if has_colors else None
        return cls(raw[8:points_end], colors, raw[colors_end:] if has_values else None)


@dataclasses.dataclass(repr=False)
class Pose(_Value):
    """A pose: a position in metres and a rotation as a quaternion (w, i, j, k)."""

    position: tuple[float, ...]
    rotation: tuple[float, ...]

    NAME = "situ.pose"
    TYPE = "Situ.Pose"
    LAYOUT = struct.Struct("<B7x7d")

    def encode(self) -> bytes:
        return self.LAYOUT.pack(1, *self.position, *self.rotation)

    @classmethod
    def decode(cls, raw: Any) -> Pose:
        _require(len(raw) == cls.LAYOUT.size and raw[0] == 1, "a pose has a wrong size or an unknown version")
        numbers = cls.LAYOUT.unpack(raw)[1:]
        return cls(numbers[:3], numbers[3:])


@dataclasses.dataclass(repr=False)
class Undecoded(_Value):
    """The bytes of a value whose codec this package does not know."""

    codec: str
    data: Buffer


_KINDS = (Image, DepthImage, EncodedImage, VideoPacket, AudioBuffer, Tensor, PointCloud, Pose)
CODECS = {kind.NAME: kind for kind in _KINDS}


def decode_value(name: str, raw: Any) -> Any:
    """Decodes the bytes of the codec `name`. Raises `Damaged`."""
    return CODECS[name].decode(raw) if name in CODECS else Undecoded(name, bytes(raw))


def encode_parts(value: Any) -> list[memoryview]:
    """Returns the encoded value as memoryviews. The last one is the own memory of an image or tensor."""
    if isinstance(value, (Image, Tensor)):
        return [memoryview(value._encode_head()), memoryview(value.data)]
    return [memoryview(value.encode())]


def to_writable(value: Any, copy: bool = True) -> Any:
    """Converts a numpy array to a tensor and a numpy number to a Python number; returns other values unchanged."""
    if not hasattr(value, "__array__"):
        return value
    return Tensor.from_array(value, copy) if getattr(value, "ndim", 0) > 0 else value.item()


def find_codec(value: Any) -> Any:
    """Returns the class that encodes a value, or None if the value has no binary layout."""
    return type(value) if type(value) in CODECS.values() else None
