"""Pictures, sound and other data with a layout of their own, as numpy arrays where numpy is there."""

import dataclasses
import struct

from .bytes import Damaged, Missing


def numpy():
    """numpy, or `Missing`."""
    try:
        import numpy
    except ImportError:
        raise Missing("numpy: pip install situ[numpy]") from None
    return numpy


#            code: name, bits a channel, channels
PICTURES = {
    1: ("gray8", 8, 1),
    2: ("gray16", 16, 1),
    3: ("bgr24", 8, 3),
    4: ("rgb24", 8, 3),
    5: ("bgrx32", 8, 4),
    6: ("bgra32", 8, 4),
    7: ("rgba32", 8, 4),
    8: ("rgba64", 16, 4),
}
_PICTURE_CODES = {name: code for code, (name, _, _) in PICTURES.items()}
SAMPLES = {1: ("u8", "u1"), 2: ("s16", "<i2"), 3: ("s24", None), 4: ("s32", "<i4"), 5: ("f32", "<f4"), 6: ("f64", "<f8")}
_SAMPLE_CODES = {name: code for code, (name, _) in SAMPLES.items()}
_SAMPLE_BYTES = {"u8": 1, "s16": 2, "s24": 3, "s32": 4, "f32": 4, "f64": 8}
TENSORS = ["<f4", "<f8", "i1", "<i2", "<i4", "<i8", "u1", "<u2", "<u4", "<u8", "?", "<f2", "bf16"]


def _expect(condition, what):
    if not condition:
        raise Damaged(what)


class _Value:
    """Is shown by its fields, of which long bytes by their number: a picture has millions."""

    def __repr__(self):
        shown = (f"{field.name}={_shown(getattr(self, field.name))}" for field in dataclasses.fields(self))
        return f"{type(self).__name__}({', '.join(shown)})"


def _shown(value):
    long = isinstance(value, (bytes, bytearray, memoryview)) and len(value) > 16
    return f"<{len(value)} bytes>" if long else repr(value)


@dataclasses.dataclass(repr=False)
class Image(_Value):
    """A picture: `data` are `height` rows of `stride` bytes."""

    width: int
    height: int
    format: str
    stride: int
    data: bytes

    NAME = "situ.image"
    TYPE = "Situ.Image"
    HEAD = struct.Struct("<BBHIII48x")

    @classmethod
    def from_array(cls, array, format=None):
        """Of an array (height, width) or (height, width, channels) of uint8 or uint16; three channels are rgb24
        unless `format` says otherwise."""
        np = numpy()
        array = np.asarray(array)
        channels = array.shape[2] if array.ndim == 3 else 1
        guess = {("uint8", 1): "gray8", ("uint16", 1): "gray16", ("uint8", 3): "rgb24", ("uint8", 4): "rgba32", ("uint16", 4): "rgba64"}
        format = format or guess.get((array.dtype.name, channels))
        if format not in _PICTURE_CODES or PICTURES[_PICTURE_CODES[format]][1:] != (array.dtype.itemsize * 8, channels):
            raise ValueError(f"no picture of {array.dtype} with the shape {array.shape} and the format {format}")
        data = np.ascontiguousarray(array).tobytes()
        return cls(array.shape[1], array.shape[0], format, len(data) // array.shape[0], data)

    @property
    def array(self):
        """(height, width) or (height, width, channels), uint8 or uint16, channels in the order of `format`; no copy."""
        _, bits, channels = PICTURES[_PICTURE_CODES[self.format]]
        pixel = bits * channels // 8
        shape, strides = (self.height, self.width), (self.stride, pixel)
        if channels > 1:
            shape, strides = (*shape, channels), (*strides, bits // 8)
        return numpy().ndarray(shape, "u1" if bits == 8 else "<u2", self.data, strides=strides)

    @property
    def rgb(self):
        """(height, width, 3), red first, whatever the format."""
        array = self.array
        if array.ndim == 2:
            return numpy().stack([array] * 3, axis=2)
        return array[:, :, 2::-1] if self.format.startswith("bgr") else array[:, :, :3]

    def encode(self):
        return self.HEAD.pack(1, _PICTURE_CODES[self.format], 0, self.width, self.height, self.stride) + bytes(self.data)

    @classmethod
    def decode(cls, raw):
        _expect(len(raw) >= cls.HEAD.size, "a picture is too short")
        version, code, _, width, height, stride = cls.HEAD.unpack_from(raw)
        _expect(version == 1 and code in PICTURES, "a picture of an unknown format")
        name, bits, channels = PICTURES[code]
        row, data = width * bits * channels // 8, raw[cls.HEAD.size :]
        _expect(row <= stride and len(data) >= stride * max(height - 1, 0) + (row if height else 0), "a picture has too few bytes")
        return cls(width, height, name, stride, data)


@dataclasses.dataclass(repr=False)
class DepthImage(_Value):
    """Depths of 16 bits: `scale` metres each, along the optical axis (`plane`) or the ray (`point`)."""

    width: int
    height: int
    stride: int
    scale: float
    semantics: str
    data: bytes

    NAME = "situ.depth_image"
    TYPE = "Situ.DepthImage"
    HEAD = struct.Struct("<BBHIIId40x")

    @classmethod
    def from_array(cls, array, scale=0.001, semantics="plane"):
        """Of a uint16 array (height, width)."""
        array = numpy().ascontiguousarray(array, "<u2")
        return cls(array.shape[1], array.shape[0], 2 * array.shape[1], scale, semantics, array.tobytes())

    @property
    def array(self):
        """(height, width), uint16; no copy."""
        return numpy().ndarray((self.height, self.width), "<u2", self.data, strides=(self.stride, 2))

    @property
    def metres(self):
        """(height, width), float64."""
        return self.array * self.scale

    def encode(self):
        head = self.HEAD.pack(1, self.semantics == "point", 0, self.width, self.height, self.stride, self.scale)
        return head + bytes(self.data)

    @classmethod
    def decode(cls, raw):
        _expect(len(raw) >= cls.HEAD.size and raw[0] == 1, "a depth image is too short")
        _, semantics, _, width, height, stride, scale = cls.HEAD.unpack_from(raw)
        data = raw[cls.HEAD.size :]
        enough = stride * max(height - 1, 0) + (2 * width if height else 0)
        _expect(2 * width <= stride and len(data) >= enough, "a depth image has too few bytes")
        return cls(width, height, stride, scale, "point" if semantics else "plane", data)


@dataclasses.dataclass(repr=False)
class EncodedImage(_Value):
    """A JPEG or PNG as it is."""

    format: str
    width: int
    height: int
    data: bytes

    NAME = "situ.encoded_image"
    TYPE = "Situ.EncodedImage"
    HEAD = struct.Struct("<BBHIII")

    def encode(self):
        return self.HEAD.pack(1, {"jpeg": 1, "png": 2}[self.format], 0, self.width, self.height, 0) + bytes(self.data)

    @classmethod
    def decode(cls, raw):
        _expect(len(raw) >= cls.HEAD.size, "an encoded picture is too short")
        version, code, _, width, height, _ = cls.HEAD.unpack_from(raw)
        _expect(version == 1 and code in (1, 2), "an encoded picture of an unknown format")
        return cls("jpeg" if code == 1 else "png", width, height, raw[cls.HEAD.size :])


@dataclasses.dataclass(repr=False)
class AudioBuffer(_Value):
    """Sound: frames of all channels' samples, little-endian. The time of its message is that of its end."""

    rate: int
    channels: int
    sample: str
    data: bytes

    NAME = "situ.audio_buffer"
    TYPE = "Situ.AudioBuffer"
    HEAD = struct.Struct("<BBHI8x")

    @classmethod
    def from_array(cls, array, rate):
        """Of an array (frames,) or (frames, channels) of uint8, int16, int32, float32 or float64."""
        np = numpy()
        array = np.asarray(array)
        sample = {"uint8": "u8", "int16": "s16", "int32": "s32", "float32": "f32", "float64": "f64"}.get(array.dtype.name)
        if sample is None or array.ndim > 2:
            raise ValueError(f"no sound of {array.dtype} with the shape {array.shape}")
        layout = SAMPLES[_SAMPLE_CODES[sample]][1]
        return cls(rate, array.shape[1] if array.ndim == 2 else 1, sample, np.ascontiguousarray(array, layout).tobytes())

    @property
    def array(self):
        """(frames, channels) in the type of the samples; those of 24 bits as int32."""
        np = numpy()
        layout = SAMPLES[_SAMPLE_CODES[self.sample]][1]
        if layout:
            return np.frombuffer(self.data, layout).reshape(-1, self.channels)
        triples = np.frombuffer(self.data, "u1").reshape(-1, 3).astype("<i4")
        values = triples[:, 0] | triples[:, 1] << 8 | triples[:, 2] << 16
        return ((values ^ 0x800000) - 0x800000).reshape(-1, self.channels)

    @property
    def floats(self):
        """(frames, channels), float32, full scale 1.0."""
        np = numpy()
        if self.sample in ("f32", "f64"):
            return self.array.astype("f4")
        if self.sample == "u8":
            return (self.array.astype("f4") - 128) / 128
        return (self.array / float(1 << {"s16": 15, "s24": 23, "s32": 31}[self.sample])).astype(np.float32)

    def encode(self):
        return self.HEAD.pack(1, _SAMPLE_CODES[self.sample], self.channels, self.rate) + bytes(self.data)

    @classmethod
    def decode(cls, raw):
        _expect(len(raw) >= cls.HEAD.size, "a buffer of sound is too short")
        version, code, channels, rate = cls.HEAD.unpack_from(raw)
        _expect(version == 1 and code in SAMPLES and channels and rate, "sound of an unknown format")
        name, data = SAMPLES[code][0], raw[cls.HEAD.size :]
        _expect(len(data) % (channels * _SAMPLE_BYTES[name]) == 0, "sound ends within a frame")
        return cls(rate, channels, name, data)


@dataclasses.dataclass(repr=False)
class Tensor(_Value):
    """Numbers with a shape. A numpy array is written as one."""

    dtype: str
    shape: tuple
    data: bytes

    NAME = "situ.tensor"
    TYPE = "Situ.Tensor"

    @classmethod
    def from_array(cls, array):
        np = numpy()
        array = np.asarray(array)
        layout = array.dtype.newbyteorder("<").str.replace("|", "")
        layout = "?" if layout == "b1" else layout
        if layout not in TENSORS:
            raise ValueError(f"no tensor of {array.dtype}")
        return cls(layout, array.shape, np.ascontiguousarray(array, layout).tobytes())

    @property
    def array(self):
        """The numpy array; numbers of 16 bits of the kind bfloat16 as float32."""
        np = numpy()
        if self.dtype == "bf16":
            return (np.frombuffer(self.data, "<u2").astype("<u4") << 16).view("<f4").reshape(self.shape)
        return np.frombuffer(self.data, self.dtype).reshape(self.shape)

    def encode(self):
        dims = struct.pack(f"<{len(self.shape)}I", *self.shape)
        return bytes([TENSORS.index(self.dtype), len(self.shape)]) + dims + bytes(self.data)

    @classmethod
    def decode(cls, raw):
        _expect(len(raw) >= 2 and raw[0] < len(TENSORS) and len(raw) >= 2 + 4 * raw[1], "a tensor is too short")
        shape = struct.unpack_from(f"<{raw[1]}I", raw, 2)
        dtype, data, count = TENSORS[raw[0]], raw[2 + 4 * raw[1] :], 1
        for size in shape:
            count *= size
        width = 2 if dtype == "bf16" else 1 if dtype == "?" else int(dtype[-1])
        _expect(len(data) == count * width, "a tensor has another size than its shape says")
        return cls(dtype, shape, data)


@dataclasses.dataclass(repr=False)
class PointCloud(_Value):
    """Points of three float32 (metres), and their colours and values (float32) or None."""

    points: bytes
    colors: bytes = None
    values: bytes = None

    NAME = "situ.point_cloud"
    TYPE = "Situ.PointCloud"

    @classmethod
    def from_array(cls, points, colors=None, values=None):
        """Of an array (n, 3), one of uint8 (n, 3), and one of numbers (n)."""
        np = numpy()
        bytes_of = lambda array, kind: None if array is None else np.ascontiguousarray(array, kind).tobytes()
        return cls(bytes_of(points, "<f4"), bytes_of(colors, "u1"), bytes_of(values, "<f4"))

    @property
    def array(self):
        """(n, 3), float32."""
        return numpy().frombuffer(self.points, "<f4").reshape(-1, 3)

    @property
    def rgb(self):
        """(n, 3), uint8, or None."""
        return None if self.colors is None else numpy().frombuffer(self.colors, "u1").reshape(-1, 3)

    @property
    def numbers(self):
        """The values: (n), float32, or None."""
        return None if self.values is None else numpy().frombuffer(self.values, "<f4")

    def encode(self):
        flags = (self.colors is not None) + 2 * (self.values is not None)
        head = struct.pack("<BBHI", 1, flags, 0, len(self.points) // 12)
        return head + bytes(self.points) + bytes(self.colors or b"") + bytes(self.values or b"")

    @classmethod
    def decode(cls, raw):
        _expect(len(raw) >= 8 and raw[0] == 1 and raw[1] in range(4), "a cloud is too short")
        count = struct.unpack_from("<I", raw, 4)[0]
        tones, numbers = 8 + 12 * count, 8 + 12 * count + (3 * count if raw[1] & 1 else 0)
        _expect(len(raw) == numbers + (4 * count if raw[1] & 2 else 0), "a cloud has another size than it says")
        return cls(raw[8:tones], raw[tones:numbers] if raw[1] & 1 else None, raw[numbers:] if raw[1] & 2 else None)


@dataclasses.dataclass(repr=False)
class Pose(_Value):
    """A position (metres) and a rotation, a quaternion (w, i, j, k)."""

    position: tuple
    rotation: tuple

    NAME = "situ.pose"
    TYPE = "Situ.Pose"
    LAYOUT = struct.Struct("<B7x7d")

    def encode(self):
        return self.LAYOUT.pack(1, *self.position, *self.rotation)

    @classmethod
    def decode(cls, raw):
        _expect(len(raw) == cls.LAYOUT.size and raw[0] == 1, "no pose")
        numbers = cls.LAYOUT.unpack(raw)[1:]
        return cls(numbers[:3], numbers[3:])


@dataclasses.dataclass(repr=False)
class Undecoded(_Value):
    """Data of a codec that this package does not know, as bytes."""

    codec: str
    data: bytes


CODECS = {kind.NAME: kind for kind in (Image, DepthImage, EncodedImage, AudioBuffer, Tensor, PointCloud, Pose)}


def decode(name, raw):
    """The value in a codec's bytes. Raises `Damaged`."""
    return CODECS[name].decode(raw) if name in CODECS else Undecoded(name, bytes(raw))


def coded(value):
    """The value to write: the value itself, for an array its tensor, for one of numpy's numbers that of Python."""
    if not hasattr(value, "__array__"):
        return value
    return Tensor.from_array(value) if getattr(value, "ndim", 0) > 0 else value.item()


def codec(value):
    """The class whose layout a value has, or None."""
    return type(value) if type(value) in CODECS.values() else None
