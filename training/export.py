"""Write a checkpoint as ONNX with its golden output, and check it against PyTorch.

    python export.py run/small-u2w16/checkpoint.pt ../models/small-u2w16.onnx
"""

import argparse
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch
from onnx import numpy_helper

import onnx_graph
import self_test
from network import EPSILON, Network, grown

TOLERANCE = 1e-5


class Graph(onnx_graph.Graph):
    """A graph of the network's layers."""

    def __init__(self):
        super().__init__()
        self.constant("epsilon", np.array(EPSILON, np.float32))

    def convolution(self, x, name, layer):
        inputs = [x, self.constant(f"{name}.weight", layer.weight.detach().numpy())]
        if layer.bias is not None:
            inputs.append(self.constant(f"{name}.bias", layer.bias.detach().numpy()))
        return self.op(
            "Conv", inputs, kernel_shape=list(layer.kernel_size), strides=list(layer.stride),
            pads=list(layer.padding) * 2, group=layer.groups,
        )

    def normalise(self, x):
        centred = self.op("Sub", [x, self.op("ReduceMean", [x], axes=[1], keepdims=1)])
        variance = self.op("ReduceMean", [self.op("Mul", [centred, centred])], axes=[1], keepdims=1)
        deviation = self.op("Sqrt", [self.op("Add", [variance, "epsilon"])])
        return self.op("Div", [centred, deviation])

    def block(self, x, name, block, gist):
        def conv(y, part):
            return self.convolution(y, f"{name}.{part}", getattr(block, part))

        y = self.normalise(x)
        y = self.op("Mul", [conv(conv(y, "a1"), "a2"), conv(conv(y, "b1"), "b2")])
        attention = conv(self.op("GlobalAveragePool", [y]), "attention")
        if block.condition is not None:
            attention = self.op("Add", [attention, conv(gist, "condition")])
        y = self.op("Mul", [y, attention])
        x = self.op("Add", [x, conv(y, "c3")])
        y = self.normalise(x)
        return self.op("Add", [x, conv(self.op("Mul", [conv(y, "a4"), conv(y, "b4")]), "c5")])

    def blocks(self, x, name, sequence, gist=None):
        for number, block in enumerate(sequence):
            x = self.block(x, f"{name}.{number}", block, gist)
        return x

    def shuffle(self, x):
        return self.op("DepthToSpace", [x], blocksize=2, mode="CRD")


def build(network):
    """The network as an ONNX model with dynamic N, H and W."""
    graph = Graph()
    x = graph.convolution("input", "stem", network.stem)
    skips = []
    for number, (encoder, down) in enumerate(zip(network.encoders, network.downs)):
        skips.append(graph.blocks(x, f"encoder.{number}", encoder))
        x = graph.convolution(skips[-1], f"down.{number}", down)
    x = graph.blocks(x, "middle", network.middle)
    look = graph.op("Sigmoid", [graph.convolution(x, "look", network.look)])
    seen = graph.op("Mul", [look, graph.convolution(x, "gist", network.gist)])
    seen, look = (graph.op("GlobalAveragePool", [plane]) for plane in (seen, look))
    gist = graph.op("Div", [seen, graph.op("Add", [look, "epsilon"])])
    for number, (up, decoder) in enumerate(zip(network.ups, network.decoders)):
        x = graph.op("Add", [graph.shuffle(graph.convolution(x, f"up.{number}", up)), skips.pop()])
        x = graph.blocks(x, f"decoder.{number}", decoder, gist)
    residual = graph.shuffle(graph.convolution(x, "ending", network.ending))
    bounds = [graph.constant(name, np.array([at], np.int64)) for name, at in (("from", 0), ("to", 3), ("channels", 1))]
    graph.op("Add", [residual, graph.op("Slice", ["input", *bounds])], "output")
    ends = [[onnx_graph.value(name, "n", channels, "h", "w")] for name, channels in (("input", 6), ("output", 3))]
    model = graph.model("u2", *ends)
    onnx.checker.check_model(model)
    return model


def load(checkpoint, raw=False):
    """The network of a checkpoint: its moving average, or the raw weights; and the checkpoint."""
    state = torch.load(checkpoint, weights_only=True, map_location="cpu")
    network = Network(**state["shape"])
    network.load_state_dict(grown(network, state["network" if raw else "average"]))
    return network.eval(), state


# Names of the ONNX file's weights, and of the network's.
PREFIXES = {"encoder": "encoders", "down": "downs", "up": "ups", "decoder": "decoders"}


def weights(path):
    """The averaged weights of a checkpoint, or those of an exported file, as a state of the network."""
    if path.suffix != ".onnx":
        return torch.load(path, weights_only=True, map_location="cpu")["average"]
    state = {}
    for tensor in onnx.load(path).graph.initializer:
        first, dot, rest = tensor.name.partition(".")
        if dot:
            state[f"{PREFIXES.get(first, first)}.{rest}"] = torch.from_numpy(numpy_helper.to_array(tensor).copy())
    return state


def largest_difference(model, network):
    """Largest absolute difference between ONNX Runtime and PyTorch over three sizes."""
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    generator = torch.Generator().manual_seed(0)
    worst = 0.0
    for shape in ((1, 6, 64, 64), (2, 6, 48, 176), (1, 6, 320, 560)):
        pair = torch.rand(shape, generator=generator)
        with torch.no_grad():
            expected = network(pair).numpy()
        apart = float(np.abs(session.run(None, {"input": pair.numpy()})[0] - expected).max())
        # What is no number is no small difference.
        worst = max(worst, apart if np.isfinite(apart) else np.inf)
    return worst


def golden(network):
    """What the network makes of the self-test's images, as the file's content."""
    pair = torch.from_numpy(self_test.images())[None]
    with torch.no_grad():
        return network(pair)[0].numpy().astype("<f4").tobytes()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--raw", action="store_true", help="the raw weights instead of their moving average")
    parser.add_argument("--mix", nargs=2, metavar=("CHECKPOINT", "SHARE"), help="an ancestor (its average, or an exported file), and its share of the mean")
    options = parser.parse_args()
    torch.set_num_threads(1)
    network, state = load(options.checkpoint, options.raw)
    if options.mix:
        # Along the way from an ancestor to its descendant the mean of the weights is a network in between.
        ancestor, share = grown(network, weights(Path(options.mix[0]))), float(options.mix[1])
        network.load_state_dict({key: (1 - share) * value + share * ancestor[key] for key, value in network.state_dict().items()})
    model = build(network)
    worst = largest_difference(model, network)
    print(f"step {state['step']}, {state['seconds']:.0f} s; ONNX against PyTorch: {worst:.2e}")
    if not worst <= TOLERANCE:
        raise SystemExit("the exported network differs from the trained one")
    options.output.write_bytes(model.SerializeToString())
    options.output.with_suffix(".golden").write_bytes(golden(network))


if __name__ == "__main__":
    main()
