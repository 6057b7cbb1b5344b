"""Converts a small network of MediaPipe (.tflite, 16-bit or 32-bit floats) to ONNX, opset 13.

    python3 tflite_to_onnx.py IN.tflite OUT.onnx INPUT OUTPUT...       # pip: numpy, onnx, tflite

INPUT and OUTPUT... name the ports of the result, in the order of the file; an output named `-` is left out. Pictures
stay {1, height, width, 3}. Weights of 16 bits stay so in the file and are widened when ONNX Runtime loads it. The
operator Convolution2DTransposeBias is MediaPipe's own: a transposed convolution with a bias, whose options are three
32-bit integers (padding, stride across, stride down).
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
        self.nodes, self.inits, self.count = [], [], 0
        self.values, self.constants = {}, {}
        for i in range(self.graph.TensorsLength()):
            tensor = self.graph.Tensors(i)
            buffer = self.file.Buffers(tensor.Buffer())
            if buffer.DataLength():
                data = np.frombuffer(buffer.DataAsNumpy().tobytes(), TYPES[tensor.Type()])
                self.constants[i] = data.reshape(self.shape(i))

    def shape(self, i):
        shape = self.graph.Tensors(i).ShapeAsNumpy()
        return [] if isinstance(shape, int) else [int(x) for x in shape]

    def name(self, prefix):
        self.count += 1
        return f"{prefix}_{self.count}"

    def constant(self, array):
        name = self.name("c")
        self.inits.append(numpy_helper.from_array(np.ascontiguousarray(array), name))
        return self.add("Cast", [name], to=TensorProto.FLOAT) if array.dtype == np.float16 else name

    def add(self, op, inputs, **attributes):
        name = self.name(op.lower())
        self.nodes.append(helper.make_node(op, inputs, [name], **attributes))
        return name

    def value(self, i):
        if i in self.values:
            return self.values[i]
        array = self.constants[i]
        return self.constant(array.transpose(0, 3, 1, 2) if array.ndim == 4 else array)

    def activated(self, x, kind):
        if kind == RELU:
            return self.add("Relu", [x])
        if kind == RELU6:
            return self.add("Clip", [x, self.constant(np.float32(0)), self.constant(np.float32(6))])
        if kind:
            raise SystemExit(f"activation {kind} is not known")
        return x

    def padding(self, kind, size, kernel, strides):
        pads = []
        for n, k, s in zip(size, kernel, strides):
            pads.append(max((-(-n // s) - 1) * s + k - n, 0) if kind == SAME else 0)
        return [p // 2 for p in pads] + [p - p // 2 for p in pads]

    def operator(self, op):
        code = self.file.OperatorCodes(op.OpcodeIndex())
        kind = max(code.BuiltinCode(), code.DeprecatedBuiltinCode())
        ins, out = [int(i) for i in op.InputsAsNumpy()], int(op.OutputsAsNumpy()[0])

        def options(of):
            options, table = of(), op.BuiltinOptions()
            options.Init(table.Bytes, table.Pos)
            return options

        if kind == OP.DEQUANTIZE:
            self.constants[out] = self.constants[ins[0]]
            return
        if kind in (OP.CONV_2D, OP.DEPTHWISE_CONV_2D):
            deep = kind == OP.DEPTHWISE_CONV_2D
            o = options(tflite.DepthwiseConv2DOptions if deep else tflite.Conv2DOptions)
            w = self.constants[ins[1]].transpose(*((3, 0, 1, 2) if deep else (0, 3, 1, 2)))
            strides, kernel = [o.StrideH(), o.StrideW()], list(w.shape[2:])
            y = self.add(
                "Conv", [self.value(ins[0]), self.constant(w), self.constant(self.constants[ins[2]])], strides=strides,
                kernel_shape=kernel, group=w.shape[0] if deep else 1,
                pads=self.padding(o.Padding(), self.shape(ins[0])[1:3], kernel, strides))
            y = self.activated(y, o.FusedActivationFunction())
        elif kind == OP.CUSTOM and code.CustomCode() == b"Convolution2DTransposeBias":
            pad, across, down = struct.unpack("<3i", op.CustomOptionsAsNumpy().tobytes()[:12])
            w = self.constants[ins[1]].transpose(3, 0, 1, 2)
            if list(w.shape[2:]) != [down, across]:
                raise SystemExit("transposed convolutions whose steps overlap are not known")
            y = self.add("ConvTranspose", [self.value(ins[0]), self.constant(w), self.constant(self.constants[ins[2]])],
                         strides=[down, across], kernel_shape=list(w.shape[2:]))
        elif kind in (OP.ADD, OP.MUL):
            o = options(tflite.AddOptions if kind == OP.ADD else tflite.MulOptions)
            y = self.add("Add" if kind == OP.ADD else "Mul", [self.value(ins[0]), self.value(ins[1])])
            y = self.activated(y, o.FusedActivationFunction())
        elif kind in (OP.MAX_POOL_2D, OP.AVERAGE_POOL_2D):
            o = options(tflite.Pool2DOptions)
            kernel, strides = [o.FilterHeight(), o.FilterWidth()], [o.StrideH(), o.StrideW()]
            size = self.shape(ins[0])[1:3]
            y = self.add("MaxPool" if kind == OP.MAX_POOL_2D else "AveragePool", [self.value(ins[0])],
                         kernel_shape=kernel, strides=strides, pads=self.padding(o.Padding(), size, kernel, strides))
        elif kind == OP.MEAN:
            y = self.add("GlobalAveragePool", [self.value(ins[0])])
            if len(self.shape(out)) == 2:
                y = self.add("Flatten", [y])
        elif kind == OP.FULLY_CONNECTED:
            o = options(tflite.FullyConnectedOptions)
            x = self.value(ins[0])
            if len(self.shape(ins[0])) == 4:
                x = self.add("Flatten", [self.add("Transpose", [x], perm=[0, 2, 3, 1])])
            w, b = self.constants[ins[1]], self.constants[ins[2]]
            y = self.add("Gemm", [x, self.constant(w), self.constant(b)], transB=1)
            y = self.activated(y, o.FusedActivationFunction())
        elif kind == OP.PAD:
            p = self.constants[ins[1]][[0, 3, 1, 2]]
            p = np.concatenate([p[:, 0], p[:, 1]]).astype(np.int64)
            y = self.add("Pad", [self.value(ins[0]), self.constant(p)])
        elif kind == OP.RELU:
            y = self.add("Relu", [self.value(ins[0])])
        elif kind == OP.LOGISTIC:
            y = self.add("Sigmoid", [self.value(ins[0])])
        elif kind == OP.HARD_SWISH:
            x = self.value(ins[0])
            y = self.add("Mul", [x, self.add("HardSigmoid", [x], alpha=1 / 6, beta=0.5)])
        elif kind == OP.RESIZE_BILINEAR:
            o = options(tflite.ResizeBilinearOptions)
            n, h, w, c = self.shape(out)
            way = "align_corners" if o.AlignCorners() else "half_pixel" if o.HalfPixelCenters() else "asymmetric"
            y = self.add("Resize", [self.value(ins[0]), "", "", self.constant(np.array([n, c, h, w], np.int64))],
                         mode="linear", coordinate_transformation_mode=way)
        elif kind == OP.RESHAPE:
            x = self.value(ins[0])
            if len(self.shape(ins[0])) == 4:
                x = self.add("Transpose", [x], perm=[0, 2, 3, 1])
            y = self.add("Reshape", [x, self.constant(np.array(self.shape(out), np.int64))])
            if len(self.shape(out)) == 4:
                y = self.add("Transpose", [y], perm=[0, 3, 1, 2])
        else:
            raise SystemExit("operator " + NAMES[kind] + " is not known")
        self.values[out] = y

    def convert(self, names):
        ins, outs = [int(i) for i in self.graph.InputsAsNumpy()], [int(i) for i in self.graph.OutputsAsNumpy()]
        given, wanted = names[: len(ins)], names[len(ins):]
        for i, name in zip(ins, given):
            self.values[i] = self.add("Transpose", [name], perm=[0, 3, 1, 2])
        for k in range(self.graph.OperatorsLength()):
            self.operator(self.graph.Operators(k))
        results = []
        for i, name in zip(outs, wanted):
            if name != "-":
                flat = len(self.shape(i)) < 4
                self.nodes.append(helper.make_node("Identity", [self.values[i]], [name]) if flat else
                                  helper.make_node("Transpose", [self.values[i]], [name], perm=[0, 2, 3, 1]))
                results.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, self.shape(i)))
        inputs = [helper.make_tensor_value_info(n, TensorProto.FLOAT, self.shape(i)) for i, n in zip(ins, given)]
        graph = helper.make_graph(self.nodes, "converted", inputs, results, self.inits)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], producer_name="tflite_to_onnx")
        model.ir_version = 8
        onnx.checker.check_model(model)
        return model


if __name__ == "__main__":
    onnx.save(Converter(sys.argv[1]).convert(sys.argv[3:]), sys.argv[2])
