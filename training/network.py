"""The guided deblurring network "u2": a NAFNet in folded form behind a stride-2 front.

Folded: the layer norm carries no affine part, the gate is two branches, and the blocks' output scales are part of
their last convolutions. What is trained is exactly what is exported.
"""

import torch
import torch.nn.functional as F
from torch import nn

from depthwise import depthwise

EPSILON = 1e-6


def normalise(x):
    """Layer norm over the channels at each pixel, without affine part."""
    return F.layer_norm(x.permute(0, 2, 3, 1), x.shape[1:2], eps=EPSILON).permute(0, 3, 1, 2)


# Channels in which the middle tells the decoder what it has seen of the whole image.
GIST = 16


class Block(nn.Module):
    """Gated depthwise convolution with channel attention, then a gated pixel-wise one; both residual.

    In the decoder the attention follows the image's gist too: a shake is the whole image's, and what undoes it depends on it.
    """

    def __init__(self, width, taps, gist=0):
        super().__init__()
        self.a1, self.b1 = nn.Conv2d(width, width, 1), nn.Conv2d(width, width, 1)
        self.a2 = nn.Conv2d(width, width, taps, padding=taps // 2, groups=width)
        self.b2 = nn.Conv2d(width, width, taps, padding=taps // 2, groups=width)
        self.attention = nn.Conv2d(width, width, 1)
        self.c3 = nn.Conv2d(width, width, 1)
        self.a4, self.b4 = nn.Conv2d(width, width, 1), nn.Conv2d(width, width, 1)
        self.c5 = nn.Conv2d(width, width, 1)
        nn.init.ones_(self.attention.bias)
        self.condition = nn.Conv2d(gist, width, 1, bias=False) if gist else None
        for last in (self.c3, self.c5):
            # A small start instead of NAFNet's zero scales: each block begins as nearly the identity.
            nn.init.normal_(last.weight, std=0.02)
            nn.init.zeros_(last.bias)

    def forward(self, x, gist=None):
        y = normalise(x)
        y = depthwise(self.a2, self.a1(y)) * depthwise(self.b2, self.b1(y))
        attention = self.attention(y.mean((2, 3), keepdim=True))
        y = y * (attention if self.condition is None else attention + self.condition(gist))
        x = x + self.c3(y)
        y = normalise(x)
        return x + self.c5(self.a4(y) * self.b4(y))


class Network(nn.Module):
    """[N, 6, H, W] = blurry RGB, guide RGB (a copy of blurry where there is none) to [N, 3, H, W].

    sRGB 0..1, sides multiples of 16, output not clipped. `taps` are the sides of the depthwise kernels of the three
    levels and of the middle: to undo a shake of 8 px takes filters about as wide, and ONNX Runtime takes no longer for them.
    """

    def __init__(self, width=16, encoder=(2, 2, 2), middle=2, decoder=(1, 2, 2), taps=(7, 7, 5, 3)):
        super().__init__()
        self.shape = dict(width=width, encoder=list(encoder), middle=middle, decoder=list(decoder), taps=list(taps))
        self.stem = nn.Conv2d(6, width, 6, stride=2, padding=2)
        self.encoders, self.downs = nn.ModuleList(), nn.ModuleList()
        for blocks, side in zip(encoder, taps):
            self.encoders.append(nn.Sequential(*[Block(width, side) for _ in range(blocks)]))
            self.downs.append(nn.Conv2d(width, 2 * width, 2, stride=2))
            width *= 2
        self.middle = nn.Sequential(*[Block(width, taps[3]) for _ in range(middle)])
        # Where to look: a sky says nothing about a shake.
        self.gist, self.look = nn.Conv2d(width, GIST, 1), nn.Conv2d(width, GIST, 1)
        nn.init.zeros_(self.look.weight)
        nn.init.zeros_(self.look.bias)
        self.ups, self.decoders = nn.ModuleList(), nn.ModuleList()
        for blocks, side in zip(decoder, taps[2::-1]):
            self.ups.append(nn.Conv2d(width, 2 * width, 1, bias=False))
            width //= 2
            self.decoders.append(nn.ModuleList(Block(width, side, GIST) for _ in range(blocks)))
        self.ending = nn.Conv2d(width, 12, 3, padding=1)
        nn.init.normal_(self.ending.weight, std=0.005)
        nn.init.zeros_(self.ending.bias)

    def forward(self, pair):
        x = self.stem(pair)
        skips = []
        for encoder, down in zip(self.encoders, self.downs):
            x = encoder(x)
            skips.append(x)
            x = down(x)
        x = self.middle(x)
        look = torch.sigmoid(self.look(x))
        gist = (look * self.gist(x)).mean((2, 3), keepdim=True) / (look.mean((2, 3), keepdim=True) + EPSILON)
        for up, decoder in zip(self.ups, self.decoders):
            x = F.pixel_shuffle(up(x), 2) + skips.pop()
            for block in decoder:
                x = block(x, gist)
        return F.pixel_shuffle(self.ending(x), 2) + pair[:, :3]


def grown(network, state):
    """The state with which `network` does what a network of fewer blocks or smaller kernels did with `state`.

    Kernels get a rim of zeros; what a new block or the gist adds begins as zero. Raises ValueError for another width.
    """
    grown = {}
    for name, fresh in network.state_dict().items():
        old = state.get(name)
        if old is None:
            last = name.split(".")[-2] in ("c3", "c5", "condition", "look")
            grown[name] = torch.zeros_like(fresh) if last else fresh
            continue
        if old.dim() == 4 and (rim := (fresh.shape[-1] - old.shape[-1]) // 2) > 0:
            old = F.pad(old, (rim,) * 4)
        if old.shape != fresh.shape:
            raise ValueError(f"{name} is {list(old.shape)}, here {list(fresh.shape)}")
        grown[name] = old
    if lost := state.keys() - grown.keys():
        raise ValueError(f"there is no place for {sorted(lost)[0]}")
    return grown


# Errors below these (37 dB) are good enough: what is nearly clean already must not outweigh what is blurred.
def logarithmic_loss(output, clean, frequency):
    """Mean over the samples of log(mean squared error) + `frequency` * log(mean absolute difference of the spectra).

    By logarithms every sample counts by how much of its own error goes, as in PSNR. With plain differences the noisiest
    samples, of which nobody can say what was there, make nearly all of the gradient, and what is nearly clean never gets
    deblurred.
    """
    difference = output - clean
    squared = difference.square().mean((1, 2, 3))
    spectrum = torch.fft.rfft2(difference, norm="ortho")
    spectral = torch.view_as_real(spectrum.contiguous()).abs().mean((1, 2, 3, 4))
    return (torch.log(squared + 2e-4) + frequency * torch.log(spectral + 3e-3)).mean()
