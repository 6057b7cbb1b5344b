"""Rewrites the face models so that ONNX Runtime stays in its blocked layout (NCHWc), which has the fast kernels.

    python3 blocked_layout.py IN.onnx OUT.onnx        # pip: onnx, numpy

- PRelu has no kernel in that layout. It took 58 % of the face mesh's time, including the layout conversions around it.
  PRelu(x) = a x + (1 - a) Relu(x), and a multiplication per channel is a depthwise 1x1 convolution.
- Channel numbers that are not multiples of 16, and the Pads that widen BlazeFace's shortcuts by 4 to 8 channels, leave
  the layout as well. Trunk channels are padded with zeros to multiples of 16. If a shortcut is still narrower, a
  convolution with the identity widens it, and ONNX Runtime fuses the following addition at no cost.

The result is mathematically the same, with different rounding. On random images, no output changes by more than 1e-4
(pixels, logits).
"""
import sys

import numpy as np
import onnx
from onnx import helper, numpy_helper

BLOCK = 16


def round_up(n):
    """Rounds a number of channels up to a multiple of the block size."""
    return -(-n // BLOCK) * BLOCK


class LayoutRewriter:
    """Builds the rewritten graph node by node."""
    def __init__(self, model):
        self.model = model
        self.values = {i.name: numpy_helper.to_array(i) for i in model.graph.initializer}
        self.constants = {}
        self.nodes = []
        # Tensors whose channels were padded: name -> original number of channels.
        self.wide = {}
        self.consumers = {}
        for node in model.graph.node:
            for name in node.input:
                self.consumers.setdefault(name, []).append(node)

    def add_constant(self, name, array):
        self.constants[name] = array.astype("f4")
        return name

    def add_node(self, node):
        self.nodes.append(node)

    def can_widen(self, node):
        """Returns whether a node, and all nodes after it, accept additional channels."""
        if node.op_type in ("Transpose", "Reshape", "Concat", "Identity"):
            return False
        if node.op_type == "Conv":
            return True
        return all(self.can_widen(c) for out in node.output for c in self.consumers.get(out, []))

    def rewrite_conv(self, node):
        attributes = {a.name: helper.get_attribute_value(a) for a in node.attribute}
        weight = self.values[node.input[1]]
        bias = self.values[node.input[2]] if len(node.input) > 2 else np.zeros(weight.shape[0])
        out, group = node.output[0], attributes.get("group", 1)
        depthwise = group > 1
        wide_in = node.input[0] in self.wide
        consumers = self.consumers.get(out, [])
        wide_out = wide_in if depthwise else all(self.can_widen(c) for c in consumers)
        channels_out = round_up(weight.shape[0]) if wide_out else weight.shape[0]
        channels_in = 1 if depthwise else (round_up(weight.shape[1]) if wide_in else weight.shape[1])
        filled = np.zeros((channels_out, channels_in) + weight.shape[2:])
        filled[: weight.shape[0], : weight.shape[1]] = weight
        attributes["group"] = channels_out if depthwise else 1
        names = [self.add_constant(out + "_w", filled)]
        names.append(self.add_constant(out + "_b", np.pad(bias, (0, channels_out - bias.shape[0]))))
        if wide_out:
            self.wide[out] = weight.shape[0]
        self.add_node(helper.make_node("Conv", [node.input[0]] + names, [out], **attributes))

    def rewrite_pad(self, node):
        """Replaces a Pad at the end of the channels. A padded tensor may already have room for the new channels."""
        before = list(self.values[node.input[1]])
        (source, out) = node.input[0], node.output[0]
        if source not in self.wide or any(p for i, p in enumerate(before) if i != 5):
            return self.add_node(node)
        channels = self.wide[source]
        self.wide[out] = channels + int(before[5])
        have, want = round_up(channels), round_up(self.wide[out])
        if have == want:
            return self.add_node(helper.make_node("Identity", [source], [out]))
        identity = np.eye(want, have).reshape(want, have, 1, 1)
        name = self.add_constant(out + "_w", identity)
        self.add_node(helper.make_node("Conv", [source, name], [out], kernel_shape=[1, 1]))

    def rewrite_prelu(self, node):
        (x, slope), out = node.input, node.output[0]
        a = self.values[slope].reshape(-1, 1, 1, 1)
        if x in self.wide:
            a = np.pad(a, ((0, round_up(a.shape[0]) - a.shape[0]), (0, 0), (0, 0), (0, 0)))
            self.wide[out] = self.wide[x]
        shape = {"group": a.shape[0], "kernel_shape": [1, 1]}
        above = self.add_constant(out + "_above_w", 1 - a)
        line = self.add_constant(out + "_line_w", a)
        self.add_node(helper.make_node("Relu", [x], [out + "_relu"]))
        self.add_node(helper.make_node("Conv", [out + "_relu", above], [out + "_above"], **shape))
        self.add_node(helper.make_node("Conv", [x, line], [out + "_line"], **shape))
        self.add_node(helper.make_node("Add", [out + "_line", out + "_above"], [out]))

    def copy_node(self, node):
        wide = [self.wide[i] for i in node.input if i in self.wide]
        if wide:
            self.wide[node.output[0]] = wide[0]
        self.add_node(node)

    def run(self):
        rewrite = {"Conv": self.rewrite_conv, "Pad": self.rewrite_pad, "PRelu": self.rewrite_prelu}
        graph = self.model.graph
        for node in graph.node:
            rewrite.get(node.op_type, self.copy_node)(node)
        del graph.node[:]
        graph.node.extend(self.nodes)
        used = {name for node in self.nodes for name in node.input}
        kept = [i for i in graph.initializer if i.name in used and i.name not in self.constants]
        made = [numpy_helper.from_array(v, k) for k, v in self.constants.items() if k in used]
        del graph.initializer[:]
        graph.initializer.extend(kept + made)
        del graph.value_info[:]
        onnx.checker.check_model(self.model, full_check=True)
        return self.model


if __name__ == "__main__":
    onnx.save(LayoutRewriter(onnx.load(sys.argv[1])).run(), sys.argv[2])
