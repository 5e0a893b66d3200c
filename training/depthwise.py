"""Depthwise convolution whose backward pass is fast on a CPU: PyTorch's takes ten times its forward pass beyond 3 x 3.

The gradient of the weights is `depthwise.c`, built by the machine's C compiler when it is first needed.
"""

import ctypes
import functools
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import torch
import torch.nn.functional as F


# What there is code for in depthwise.c: sides of kernels, and what the channels must be a multiple of.
TAPS, LANES = (3, 5, 7, 9), 16


@functools.cache
def library():
    """The compiled code, or None where there is no compiler: PyTorch's own backward pass then does it."""
    with tempfile.TemporaryDirectory() as folder:
        built = Path(folder) / "depthwise.so"
        source = Path(__file__).with_suffix(".c")
        command = [os.environ.get("CC", "cc"), "-O3", "-march=native", "-shared", "-fPIC", "-o", built, source]
        try:
            subprocess.run(command, check=True)
            loaded = ctypes.CDLL(str(built))
        except (OSError, subprocess.CalledProcessError) as reason:
            print(f"without {source.name} a step takes 1.6 times as long: {reason}", file=sys.stderr, flush=True)
            return None
    pointer, count = ctypes.c_void_p, ctypes.c_long
    loaded.depthwise_weights.argtypes = [pointer] * 3 + [count] * 4 + [ctypes.c_int]
    return loaded


class Depthwise(torch.autograd.Function):
    """`F.conv2d` of odd kernels with as many groups as channels, sides kept; on CPUs."""

    @staticmethod
    def forward(context, x, weight, bias):
        if torch.is_autocast_enabled("cpu"):
            x, weight, bias = (tensor.to(torch.bfloat16) for tensor in (x, weight, bias))
        context.save_for_backward(x, weight)
        with torch.autocast("cpu", enabled=False):
            return F.conv2d(x, weight, bias, padding=weight.shape[2] // 2, groups=len(weight))

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(context, gradient):
        x, weight = context.saved_tensors
        (n, channels, height, width), taps = x.shape, weight.shape[2]
        turned = weight.flip(2, 3).contiguous()
        of_input = F.conv2d(gradient.to(weight.dtype), turned, padding=taps // 2, groups=channels)
        inputs, gradients = (tensor.float().contiguous(memory_format=torch.channels_last) for tensor in (x, gradient))
        of_weight = torch.empty(taps, taps, channels)
        code = library().depthwise_weights(
            inputs.data_ptr(), gradients.data_ptr(), of_weight.data_ptr(), n, height, width, channels, taps
        )
        if code:
            raise ValueError(f"no code for {taps} x {taps} taps of {channels} channels at {width} px")
        return of_input, of_weight.permute(2, 0, 1)[:, None], gradients.sum((0, 2, 3))


def depthwise(layer, x):
    """What `layer`, an nn.Conv2d with as many groups as channels, makes of [N, C, H, W]."""
    slow = layer.kernel_size[0] > 3 and x.device.type == "cpu" and torch.is_grad_enabled() and not torch.compiler.is_compiling()
    if slow and layer.kernel_size[0] in TAPS and layer.in_channels % LANES == 0 and library():
        return Depthwise.apply(x, layer.weight, layer.bias)
    return layer(x)
