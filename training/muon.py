"""Muon (Jordan et al., 2024), with the scale of Moonlight (Liu et al., 2025) so that AdamW's learning rates fit."""

import torch

# Of the polynomial that takes singular values from 0..1 to about 1 in five turns.
A, B, C = 3.4445, -4.7750, 2.0315
TURNS = 5
MOMENTUM = 0.95
# Root mean square of an update in learning rates: AdamW's.
SIZE = 0.2


def matrices(network):
    """(the weights that are matrices, all others): a depthwise kernel has one input and is none."""
    depthwise = {id(layer.weight) for layer in network.modules() if getattr(layer, "groups", 1) > 1}
    dense = [weight for weight in network.parameters() if weight.dim() == 4 and id(weight) not in depthwise]
    chosen = {id(weight) for weight in dense}
    return dense, [weight for weight in network.parameters() if id(weight) not in chosen]


def orthogonal(stack):
    """[N, rows <= columns] with all singular values near 1 and the directions kept."""
    stack = stack / (stack.norm(dim=(1, 2), keepdim=True) + 1e-7)
    for _ in range(TURNS):
        product = stack @ stack.mT
        stack = A * stack + (B * product + C * (product @ product)) @ stack
    return stack


class Muon(torch.optim.Optimizer):
    """Momentum, made orthogonal, for convolution weights [out, in, height, width] taken as matrices [out, the rest]."""

    def __init__(self, weights, lr, weight_decay=1e-4):
        super().__init__(weights, dict(lr=lr, weight_decay=weight_decay))

    @torch.no_grad()
    def step(self):
        """One update of all weights."""
        for group in self.param_groups:
            # Those of one shape go together: most are small.
            by_shape = {}
            for weight in group["params"]:
                state = self.state[weight]
                if not state:
                    state["momentum"] = torch.zeros_like(weight)
                momentum = state["momentum"]
                momentum.lerp_(weight.grad, 1 - MOMENTUM)
                ahead = weight.grad.lerp(momentum, MOMENTUM).flatten(1)
                tall = ahead.shape[0] > ahead.shape[1]
                ahead = ahead.T if tall else ahead
                by_shape.setdefault(ahead.shape, []).append((weight, tall, ahead))
            for shape, members in by_shape.items():
                updates = orthogonal(torch.stack([ahead for _, _, ahead in members]))
                for (weight, tall, _), update in zip(members, updates):
                    weight.mul_(1 - group["lr"] * group["weight_decay"])
                    update = (update.T if tall else update).reshape(weight.shape)
                    weight.sub_(update, alpha=group["lr"] * SIZE * max(shape) ** 0.5)
