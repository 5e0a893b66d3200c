"""Train the guided deblurring network within a time budget.

    python train.py --minutes 240 --run run/small-u2w16
    python train.py --device cuda --batch 16 --workers 15 --minutes 20 --piece 9 --run run/small-u2w16

Started again with the same --run it goes on from the last checkpoint. On a CPU the budget is of the learning process's
own CPU time, so that other work on the machine changes when it ends more than how far it comes; on a GPU it is of the clock.
"""

import argparse
import copy
import math
import os
import time
from pathlib import Path

# Before NumPy and PyTorch are loaded: the processes that make patches would each take all cores for their matrix products.
for library in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(library, "1")

import torch
import torch.nn.functional as F
from torch.utils.data import DataLoader

import degrade
from dataset import Patches
from muon import Muon, matrices
from network import Network, grown, logarithmic_loss

WARM_UP = 0.02
# Share of the budget trained in bf16, which halves a step's cost on CPUs that have it; the rest is f32.
COARSE = 0.7
FLOOR = 0.01
# Brings gradients to the size that they are clipped at.
SCALE = 0.02
# Share of the patches without a guide that are given what the network itself makes of them. In the loop a guide comes from a scene
# of such images; a network that does not know its own work sharpens it once more.
OWN_GUIDES = 0.4
# Share of the budget after which guides are real renders too, where a folder of them is given.
SIMULATED_ONLY = 0.3
# No step takes so long, s: on a GPU the first one of a stream waits for patches, and one that compiles takes longer too.
LONGEST_STEP = 2.0


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", type=Path, default=Path("run/small-u2w16"), help="folder of checkpoint and log")
    parser.add_argument("--minutes", type=float, default=240, help="budget over all restarts")
    parser.add_argument("--piece", type=float, help="stop after so many minutes by the clock, to be started again")
    parser.add_argument("--device", default="cpu", help="cpu or cuda")
    parser.add_argument("--start", type=Path, help="begin with the weights of this checkpoint (its average) or exported ONNX file, also of one with fewer blocks or smaller kernels")
    parser.add_argument("--renders", type=Path, help="folder made by renders.py: guides that are real renders")
    parser.add_argument("--batch", type=int, default=2, help="patches of 256 px a step")
    parser.add_argument("--rate", type=float, default=1.5e-3, help="peak learning rate")
    parser.add_argument("--muon", action="store_true", help="Muon for the matrices: a step costs a seventh more at width 16, half as much again at 32")
    parser.add_argument("--width", type=int, default=16)
    parser.add_argument("--frequency", type=float, default=0.1, help="weight of the spectra in the loss")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=1, help="processes that make patches")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--eager", action="store_true", help="on a GPU without torch.compile, which needs a C compiler and Python.h")
    parser.add_argument("--exact", action="store_true", help="f32 from the beginning")
    parser.add_argument("--save-every", type=int, default=500, help="steps between checkpoints")
    return parser.parse_args()


def rate_at(progress, peak):
    """Linear warm-up, then cosine to FLOOR of the peak; `progress` is the share of the budget that is used up."""
    if progress < WARM_UP:
        return peak * max(progress / WARM_UP, 0.02)
    share = min((progress - WARM_UP) / (1 - WARM_UP), 1.0)
    return peak * (FLOOR + (1 - FLOOR) * 0.5 * (1 + math.cos(math.pi * share)))


class Trainer:
    """The network, its moving average and optimiser, with the time and steps spent so far."""

    def __init__(self, options):
        self.options = options
        torch.manual_seed(options.seed)
        self.path = options.run / "checkpoint.pt"
        network = Network(options.width)
        if options.start and not self.path.exists():
            # Only here: a machine that continues its own run needs no ONNX.
            from export import weights

            network.load_state_dict(grown(network, weights(options.start)))
        self.network = network.to(options.device, memory_format=torch.channels_last)
        self.average = copy.deepcopy(self.network).requires_grad_(False)
        dense, rest = matrices(self.network) if options.muon else ([], list(self.network.parameters()))
        self.optimisers = [torch.optim.AdamW(rest, lr=options.rate, betas=(0.9, 0.95), weight_decay=1e-4, fused=True)]
        if dense:
            self.optimisers.append(Muon(dense, options.rate))
        self.step, self.seconds, self.clipped = 0, 0.0, 0
        if self.path.exists():
            self.restore()
            # Else every restart would draw the same again.
            torch.manual_seed(options.seed + self.step)
        compiled = options.device == "cuda" and not options.eager
        self.forward = torch.compile(self.network) if compiled else self.network

    def restore(self):
        state = torch.load(self.path, weights_only=True, map_location=self.options.device)
        if state["network"].keys() != self.network.state_dict().keys():
            raise SystemExit(f"{self.path} is of another network than this recipe's: begin another --run with --start {self.path}")
        self.network.load_state_dict(state["network"])
        self.average.load_state_dict(state["average"])
        if "optimisers" not in state:
            raise SystemExit(f"{self.path} is of an older recipe: begin another --run with --start {self.path}")
        if len(state["optimisers"]) != len(self.optimisers):
            raise SystemExit(f"{self.path} was begun {'without' if self.options.muon else 'with'} --muon: go on so, or begin another --run")
        for optimiser, known in zip(self.optimisers, state["optimisers"]):
            optimiser.load_state_dict(known)
        self.step, self.seconds = state["step"], state["seconds"]

    def save(self):
        state = dict(
            network=self.network.state_dict(), average=self.average.state_dict(),
            optimisers=[optimiser.state_dict() for optimiser in self.optimisers], step=self.step, seconds=self.seconds,
            shape=self.network.shape, batch=self.options.batch, seed=self.options.seed,
        )
        temporary = self.path.with_suffix(".new")
        torch.save(state, temporary)
        os.replace(temporary, self.path)

    @property
    def progress(self):
        """Share of the budget that is used up."""
        return self.seconds / (60 * self.options.minutes)

    def update(self, pair, clean):
        """One step; returns the loss, still on the device."""
        for optimiser in self.optimisers:
            for group in optimiser.param_groups:
                # By steps too: on a GPU two hundredths of the budget may be few.
                group["lr"] = rate_at(self.progress, self.options.rate) * min(1.0, (self.step + 1) / 300)
        coarse = not self.options.exact and self.progress < COARSE
        with torch.autocast(self.options.device, torch.bfloat16, enabled=coarse):
            pair = with_own_guides(pair, self.average, OWN_GUIDES)
            output = self.forward(pair.contiguous(memory_format=torch.channels_last))
        output = output.float()
        loss = SCALE * logarithmic_loss(output, clean, self.options.frequency)
        self.network.zero_grad()
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(self.network.parameters(), 0.5)
        # A broken batch must not reach the weights.
        if torch.isfinite(norm):
            for optimiser in self.optimisers:
                optimiser.step()
        self.clipped += int(not norm <= 0.5)
        self.step += 1
        keep = min(0.999, (1 + self.step) / (10 + self.step))
        with torch.no_grad():
            torch._foreach_lerp_(list(self.average.parameters()), list(self.network.parameters()), 1 - keep)
        return loss.detach()


def trusted(view, render):
    """degrade.trusted of [N, 3, P, P] whose sides are multiples of the cells'."""
    size = view.shape[2:]
    difference = F.avg_pool2d(view - render, degrade.CELL)
    trust = torch.exp(-difference.square().mean(1, keepdim=True) / degrade.DISAGREEMENT**2)
    trust, difference = (F.interpolate(coarse, size, mode="bilinear") for coarse in (trust, difference))
    return (view + trust * (render + difference - view)).clamp(0, 1)


def with_own_guides(pair, network, share):
    """[N, 6, P, P] in which a share of those without a guide have one that the network made of the view alone."""
    own = (pair[:, 3:] == pair[:, :3]).flatten(1).all(1) & (torch.rand(len(pair), device=pair.device) < share)
    if own.any():
        pair = pair.clone()
        with torch.no_grad():
            render = network(pair[own]).float().clamp(0, 1)
        pair[own, 3:] = trusted(pair[own, :3], render)
    return pair


def stream(trainer, options):
    """Batches from where the trainer stands."""
    renders = options.renders if trainer.progress >= SIMULATED_ONLY else None
    return DataLoader(
        Patches(options.seed, trainer.step, renders, max(60, 12 * options.batch)), options.batch, num_workers=options.workers,
        prefetch_factor=4 if options.workers else None, pin_memory=options.device == "cuda",
    )


def mean_psnr(images, clean):
    """Mean over the batch, dB."""
    errors = ((images.clamp(0, 1) - clean) ** 2).mean((1, 2, 3)).clamp_min(1e-9)
    return float((-10 * torch.log10(errors)).mean())


def main():
    options = arguments()
    options.run.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(options.threads)
    trainer = Trainer(options)
    began, clock = time.monotonic(), time.process_time if options.device == "cpu" else time.monotonic
    if options.renders:
        # A wrong folder is told now and not when the budget comes to SIMULATED_ONLY.
        Patches(options.seed, 0, options.renders)
    mark, finished, stopped = clock(), trainer.progress >= 1, False
    with open(options.run / "log.txt", "a", buffering=1) as log:
        while not (finished or stopped):
            # Once more for the second part, in which the guides are real renders.
            simulated, total, steps = trainer.progress < SIMULATED_ONLY, 0.0, 0
            for pair, clean in stream(trainer, options):
                pair, clean = (tensor.to(options.device, non_blocking=True) for tensor in (pair, clean))
                total, steps = total + trainer.update(pair, clean), steps + 1
                now = clock()
                trainer.seconds += now - mark if options.device == "cpu" else min(now - mark, LONGEST_STEP)
                mark = now
                if trainer.step % 100 == 0:
                    report(trainer, pair, clean, total / steps, log)
                    total, steps, trainer.clipped = 0.0, 0, 0
                finished = trainer.progress >= 1
                stopped = options.piece is not None and time.monotonic() - began >= 60 * options.piece
                if finished or stopped or trainer.step % options.save_every == 0:
                    trainer.save()
                over = simulated and options.renders and trainer.progress >= SIMULATED_ONLY
                if finished or stopped or over:
                    break
    print(f"step {trainer.step}, {100 * min(trainer.progress, 1):.1f} % of the budget", flush=True)


def report(trainer, pair, clean, loss, log):
    """A line about the last hundred steps."""
    with torch.no_grad():
        before, after = mean_psnr(pair[:, :3], clean), mean_psnr(trainer.average(pair), clean)
    print(
        f"step {trainer.step} seconds {trainer.seconds:.0f} loss {loss:.5f} "
        f"input {before:.2f} average {after:.2f} clipped {trainer.clipped}", file=log,
    )


if __name__ == "__main__":
    main()
