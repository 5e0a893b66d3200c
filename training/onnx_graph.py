"""The parts of an ONNX graph, gathered while it is written."""

import numpy as np
from onnx import TensorProto, helper, numpy_helper

# Opset 17 and IR 8 are read by every ONNX Runtime since 1.13.
OPSET, IR = 17, 8


def value(name, *shape):
    """An input or output of f32; a letter is a dimension that varies."""
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)


class Graph:
    """Collects nodes and weights; each method adds one operation and returns its output's name."""

    def __init__(self):
        self.nodes, self.weights = [], []

    def constant(self, name, array):
        self.weights.append(numpy_helper.from_array(np.ascontiguousarray(array), name))
        return name

    def op(self, kind, inputs, output=None, **attributes):
        output = output or f"{kind.lower()}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, inputs, [output], name=output, **attributes))
        return output

    def split(self, x, sizes, count):
        """Columns side by side, as so many outputs."""
        outputs = [f"split_{len(self.nodes)}_{part}" for part in range(count)]
        self.nodes.append(helper.make_node("Split", [x, sizes], outputs, name=f"split_{len(self.nodes)}", axis=1))
        return outputs

    def model(self, name, inputs, outputs):
        """The ONNX model of what was collected."""
        return helper.make_model(
            helper.make_graph(self.nodes, name, inputs, outputs, self.weights),
            opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR, producer_name="fled training",
        )
