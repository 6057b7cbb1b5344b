"""Converts a small MediaPipe network (.tflite, 16-bit or 32-bit floats) to ONNX, opset 13.

    python3 tflite_to_onnx.py IN.tflite OUT.onnx INPUT OUTPUT...       # pip: numpy, onnx, tflite

INPUT and OUTPUT... name the ports of the result, in the order of the file. An output named `-` is omitted. Images keep
the shape {1, height, width, 3}. 16-bit weights remain in the file, and ONNX Runtime widens them when it loads the
model. MediaPipe's own operator Convolution2DTransposeBias is a transposed convolution with a bias. Its options are
three 32-bit integers (padding, horizontal stride, vertical stride).
"""
import struct
import sys

import numpy as np
import onnx
import tflite
from onnx import TensorProto, helper, numpy_helper

OP = tflite.BuiltinOperator
NAMES = {v: k for k, v in vars(OP).items() if isinstance(v, int)}
TYPES = {0: np.float32, 1: np.float16, 2: np.int32, 4: np.int64}
RELU, RELU6, SAME = 1, 3, 0


class Converter:
    def __init__(self, path):
        self.file = tflite.Model.GetRootAsModel(open(path, "rb").read(), 0)
        self.graph = self.file.Subgraphs(0)
        self.nodes, self.initializers, self.count = [], [], 0
        self.values, self.constants = {}, {}
        for i in range(self.graph.TensorsLength()):
            tensor = self.graph.Tensors(i)
            buffer = self.file.Buffers(tensor.Buffer())
            if buffer.DataLength():
                data = np.frombuffer(buffer.DataAsNumpy().tobytes(), TYPES[tensor.Type()])
                self.constants[i] = data.reshape(self.tensor_shape(i))

    def tensor_shape(self, i):
        shape = self.graph.Tensors(i).ShapeAsNumpy()
        return [] if isinstance(shape, int) else [int(x) for x in shape]

    def new_name(self, prefix):
        self.count += 1
        return f"{prefix}_{self.count}"

    def add_constant(self, array):
        name = self.new_name("c")
        self.initializers.append(numpy_helper.from_array(np.ascontiguousarray(array), name))
        return self.add_node("Cast", [name], to=TensorProto.FLOAT) if array.dtype == np.float16 else name

    def add_node(self, op, inputs, **attributes):
        name = self.new_name(op.lower())
        self.nodes.append(helper.make_node(op, inputs, [name], **attributes))
        return name

    def tensor_value(self, i):
        if i in self.values:
            return self.values[i]
        array = self.constants[i]
        return self.add_constant(array.transpose(0, 3, 1, 2) if array.ndim == 4 else array)

    def add_activation(self, x, kind):
        if kind == RELU:
            return self.add_node("Relu", [x])
        if kind == RELU6:
            return self.add_node("Clip", [x, self.add_constant(np.float32(0)), self.add_constant(np.float32(6))])
        if kind:
            raise SystemExit(f"activation {kind} is not supported")
        return x

    def compute_padding(self, kind, size, kernel, strides):
        pads = []
        for n, k, s in zip(size, kernel, strides):
            pads.append(max((-(-n // s) - 1) * s + k - n, 0) if kind == SAME else 0)
        return [p // 2 for p in pads] + [p - p // 2 for p in pads]

    def convert_operator(self, op):
        code = self.file.OperatorCodes(op.OpcodeIndex())
        kind = max(code.BuiltinCode(), code.DeprecatedBuiltinCode())
        ins, out = [int(i) for i in op.InputsAsNumpy()], int(op.OutputsAsNumpy()[0])

        def read_options(kind):
            options, table = kind(), op.BuiltinOptions()
            options.Init(table.Bytes, table.Pos)
            return options

        if kind == OP.DEQUANTIZE:
            self.constants[out] = self.constants[ins[0]]
            return
        if kind in (OP.CONV_2D, OP.DEPTHWISE_CONV_2D):
            deep = kind == OP.DEPTHWISE_CONV_2D
            o = read_options(tflite.DepthwiseConv2DOptions if deep else tflite.Conv2DOptions)
            w = self.constants[ins[1]].transpose(*((3, 0, 1, 2) if deep else (0, 3, 1, 2)))
            strides, kernel = [o.StrideH(), o.StrideW()], list(w.shape[2:])
            y = self.add_node(
                "Conv", [self.tensor_value(ins[0]), self.add_constant(w), self.add_constant(self.constants[ins[2]])],
                strides=strides, kernel_shape=kernel, group=w.shape[0] if deep else 1,
                pads=self.compute_padding(o.Padding(), self.tensor_shape(ins[0])[1:3], kernel, strides))
            y = self.add_activation(y, o.FusedActivationFunction())
        elif kind == OP.CUSTOM and code.CustomCode() == b"Convolution2DTransposeBias":
            pad, across, down = struct.unpack("<3i", op.CustomOptionsAsNumpy().tobytes()[:12])
            w = self.constants[ins[1]].transpose(3, 0, 1, 2)
            if list(w.shape[2:]) != [down, across]:
                raise SystemExit("transposed convolutions with overlapping steps are not supported")
            y = self.add_node(
                "ConvTranspose",
                [self.tensor_value(ins[0]), self.add_constant(w), self.add_constant(self.constants[ins[2]])],
                strides=[down, across], kernel_shape=list(w.shape[2:]))
        elif kind in (OP.ADD, OP.MUL):
            o = read_options(tflite.AddOptions if kind == OP.ADD else tflite.MulOptions)
            operands = [self.tensor_value(ins[0]), self.tensor_value(ins[1])]
            y = self.add_node("Add" if kind == OP.ADD else "Mul", operands)
            y = self.add_activation(y, o.FusedActivationFunction())
        elif kind in (OP.MAX_POOL_2D, OP.AVERAGE_POOL_2D):
            o = read_options(tflite.Pool2DOptions)
            kernel, strides = [o.FilterHeight(), o.FilterWidth()], [o.StrideH(), o.StrideW()]
            size = self.tensor_shape(ins[0])[1:3]
            y = self.add_node(
                "MaxPool" if kind == OP.MAX_POOL_2D else "AveragePool", [self.tensor_value(ins[0])],
                kernel_shape=kernel, strides=strides,
                pads=self.compute_padding(o.Padding(), size, kernel, strides))
        elif kind == OP.MEAN:
            y = self.add_node("GlobalAveragePool", [self.tensor_value(ins[0])])
            if len(self.tensor_shape(out)) == 2:
                y = self.add_node("Flatten", [y])
        elif kind == OP.FULLY_CONNECTED:
            o = read_options(tflite.FullyConnectedOptions)
            x = self.tensor_value(ins[0])
            if len(self.tensor_shape(ins[0])) == 4:
                x = self.add_node("Flatten", [self.add_node("Transpose", [x], perm=[0, 2, 3, 1])])
            w, b = self.constants[ins[1]], self.constants[ins[2]]
            y = self.add_node("Gemm", [x, self.add_constant(w), self.add_constant(b)], transB=1)
            y = self.add_activation(y, o.FusedActivationFunction())
        elif kind == OP.PAD:
            p = self.constants[ins[1]][[0, 3, 1, 2]]
            p = np.concatenate([p[:, 0], p[:, 1]]).astype(np.int64)
            y = self.add_node("Pad", [self.tensor_value(ins[0]), self.add_constant(p)])
        elif kind == OP.RELU:
            y = self.add_node("Relu", [self.tensor_value(ins[0])])
        elif kind == OP.LOGISTIC:
            y = self.add_node("Sigmoid", [self.tensor_value(ins[0])])
        elif kind == OP.HARD_SWISH:
            x = self.tensor_value(ins[0])
            y = self.add_node("Mul", [x, self.add_node("HardSigmoid", [x], alpha=1 / 6, beta=0.5)])
        elif kind == OP.RESIZE_BILINEAR:
            o = read_options(tflite.ResizeBilinearOptions)
            n, h, w, c = self.tensor_shape(out)
            way = "align_corners" if o.AlignCorners() else "half_pixel" if o.HalfPixelCenters() else "asymmetric"
            y = self.add_node(
                "Resize", [self.tensor_value(ins[0]), "", "", self.add_constant(np.array([n, c, h, w], np.int64))],
                mode="linear", coordinate_transformation_mode=way)
        elif kind == OP.RESHAPE:
            x = self.tensor_value(ins[0])
            if len(self.tensor_shape(ins[0])) == 4:
                x = self.add_node("Transpose", [x], perm=[0, 2, 3, 1])
            y = self.add_node("Reshape", [x, self.add_constant(np.array(self.tensor_shape(out), np.int64))])
            if len(self.tensor_shape(out)) == 4:
                y = self.add_node("Transpose", [y], perm=[0, 3, 1, 2])
        else:
            raise SystemExit("operator " + NAMES[kind] + " is not supported")
        self.values[out] = y

    def build_model(self, names):
        ins, outs = [int(i) for i in self.graph.InputsAsNumpy()], [int(i) for i in self.graph.OutputsAsNumpy()]
        given, wanted = names[: len(ins)], names[len(ins):]
        for i, name in zip(ins, given):
            self.values[i] = self.add_node("Transpose", [name], perm=[0, 3, 1, 2])
        for k in range(self.graph.OperatorsLength()):
            self.convert_operator(self.graph.Operators(k))
        results = []
        for i, name in zip(outs, wanted):
            if name != "-":
                flat = len(self.tensor_shape(i)) < 4
                self.nodes.append(helper.make_node("Identity", [self.values[i]], [name]) if flat else
                                  helper.make_node("Transpose", [self.values[i]], [name], perm=[0, 2, 3, 1]))
                results.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, self.tensor_shape(i)))
        inputs = [helper.make_tensor_value_info(n, TensorProto.FLOAT, self.tensor_shape(i)) for i, n in zip(ins, given)]
        graph = helper.make_graph(self.nodes, "converted", inputs, results, self.initializers)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], producer_name="tflite_to_onnx")
        model.ir_version = 8
        onnx.checker.check_model(model)
        return model


if __name__ == "__main__":
    onnx.save(Converter(sys.argv[1]).build_model(sys.argv[3:]), sys.argv[2])
