"""Writes the tiny networks that the deblurring tests use, a few hundred bytes each, into tests/golden/onnx/.

    pip install onnx==1.22.0 && python3 tests/golden/make_onnx.py
"""

from pathlib import Path

import numpy as np
from onnx import TensorProto, checker, helper, numpy_helper
from onnx.external_data_helper import set_external_data

FOLDER = Path(__file__).resolve().parent / "onnx"


def save(
    name, nodes, constants=(), channels=3, size=("h", "w"), output_channels=3, element=TensorProto.FLOAT,
    outputs=("restored",), batch="n", external=None,
):
    graph = helper.make_graph(
        nodes, name,
        [helper.make_tensor_value_info("view", element, [batch, channels, *size])],
        [helper.make_tensor_value_info(output, element, [batch, output_channels, *size]) for output in outputs],
        [numpy_helper.from_array(value, key) for key, value in constants],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    checker.check_model(model)
    if external:
        for tensor in [*graph.initializer, *(node.attribute[0].t for node in graph.node if node.op_type == "Constant")]:
            in_file(tensor, external)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    (FOLDER / f"{name}.onnx").write_bytes(model.SerializeToString())


def in_file(tensor, location):
    (FOLDER / "weights").mkdir(exist_ok=True)
    (FOLDER / "weights" / "external3.data").write_bytes(tensor.raw_data)
    set_external_data(tensor, location, offset=0, length=len(tensor.raw_data))
    tensor.ClearField("raw_data")


def node(kind, inputs, output="restored", **attributes):
    return helper.make_node(kind, inputs, [output], **attributes)


def main():
    FOLDER.mkdir(exist_ok=True)
    identity = [node("Identity", ["view"])]
    save("identity3", identity)
    save("fixed_size", identity, size=(32, 48))
    save("fixed_width", identity, size=("h", 48))
    save("channels_last", identity, channels="h", size=("w", 3), output_channels="h")
    save("four_images", identity, batch=4)
    save("bytes3", identity, element=TensorProto.UINT8)
    save("four_channels", identity, channels=4, output_channels=4)
    save("half_precision", identity, element=TensorProto.FLOAT16)
    save("unknown_channels", identity, channels="c", output_channels="c")

    # 3/4 of the view and 1/4 of the guide: tells the two apart.
    slices = [(key, np.array([at], np.int64)) for key, at in (("zero", 0), ("three", 3), ("six", 6), ("axis", 1))]
    parts = [
        node("Slice", ["view", "zero", "three", "axis"], "blurry"),
        node("Slice", ["view", "three", "six", "axis"], "guide"),
        node("Mul", ["blurry", "most"], "a"), node("Mul", ["guide", "rest"], "b"), node("Add", ["a", "b"]),
    ]
    weights = [("most", np.array(0.75, np.float32)), ("rest", np.array(0.25, np.float32))]
    save("mix6", parts, slices + weights, channels=6)

    # Refuse sides that are no multiple of their number.
    for side in (16, 32):
        save(f"blocks{side}", [
            node("SpaceToDepth", ["view"], "blocks", blocksize=side),
            node("DepthToSpace", ["blocks"], blocksize=side, mode="DCR"),
        ])

    # A mean over 3x3 pixels with zeros outside: dark at the edges of what it is given.
    box = np.zeros((3, 3, 3, 3), np.float32)
    for channel in range(3):
        box[channel, channel] = 1 / 9
    save("box3", [node("Conv", ["view", "box"], pads=[1, 1, 1, 1])], [("box", box)])

    # Out of range wherever the view is brighter than 0.95, which the self-test's pattern is not.
    save("loud3", [
        node("Greater", ["view", "limit"], "bright"), node("Where", ["bright", "nine", "view"]),
    ], [("limit", np.array(0.95, np.float32)), ("nine", np.array(9, np.float32))])
    # Brightens: the square root.
    save("root3", [node("Pow", ["view", "half"])], [("half", np.array(0.5, np.float32))])
    # As networks of several scales have it: the coarse one comes first.
    save("two_outputs3", [
        node("Mul", ["view", "half"], "coarse"), node("Identity", ["view"]),
    ], [("half", np.array(0.5, np.float32))], outputs=("coarse", "restored"))
    # Weights in a file beside the network, and where they may not lie.
    half = [("half", np.array([0.5], np.float32))]
    halves = [node("Mul", ["view", "half"])]
    save("external3", halves, half, external="weights/external3.data")
    save("climbing3", halves, half, external="../onnx/weights/external3.data")
    save("absolute3", halves, half, external="/weights/external3.data")
    constant = node("Constant", [], "half", value=numpy_helper.from_array(half[0][1]))
    save("constant3", [constant, *halves], external="weights/external3.data")
    save("infinite3", [node("Div", ["view", "zero"])], [("zero", np.array(0, np.float32))])
    save("random3", [
        node("RandomNormalLike", ["view"], "noise", scale=0.01), node("Add", ["view", "noise"]),
    ])


if __name__ == "__main__":
    main()
