"""The table of experiment.py: reports of runs by capture, variant and seed, a row each capture and variant."""

import statistics
from dataclasses import dataclass

COLUMNS = (
    "capture",
    "variant",
    "renders, held out: psnr_cc dB / SSIM",
    "against the first, dB",
    "training views, dB above",
    "deblurred training views: psnr_cc dB / SSIM",
    "sharpness",
    "Gaussians",
    "s",
    "seeds",
)
NOTHING = "-"
BRIGHTENED = "(the brightened photographs)"
MEAN = "mean"


@dataclass
class Score:
    """PSNR after a colour fit, dB, and SSIM against ground truth at the final brightness."""

    psnr: float
    ssim: float


@dataclass
class Result:
    """What the table shows of a run: of its last round, but for the seconds that all rounds trained."""

    scores: dict
    sharpness: float
    gaussians: int
    seconds: float

    @property
    def held_out(self):
        return self.scores["held_out", "render"]


def result(report):
    """Of a run's report."""
    last = report["rounds"][-1]
    scores = {
        (record["split"], record["image"]): Score(record["psnr_cc_db"], record["ssim"])
        for record in last["records"]
        if (record["reference"], record["brightness"]) == ("gt", "final")
    }
    if ("held_out", "render") not in scores:
        raise SystemExit("a run has no held-out views with ground truth")
    steps = report["config"]["steps"]
    return Result(
        scores=scores,
        sharpness=last["sharpness"]["render"],
        gaussians=last["gaussians"],
        seconds=sum(steps / entry["steps_per_second"] for entry in report["rounds"]),
    )


def score_cell(scores):
    """Means over the seeds, and the spread of the PSNR."""
    scores = [score for score in scores if score is not None]
    if not scores:
        return NOTHING
    psnr = [score.psnr for score in scores]
    spread = f" ± {statistics.stdev(psnr):.2f}" if len(psnr) > 1 else ""
    return f"{statistics.mean(psnr):.2f}{spread} / {statistics.mean(score.ssim for score in scores):.4f}"


def difference(by_seed, base):
    """Mean difference of the held-out PSNR, dB, seed by seed: what the seeds share is not noise. None of the base itself."""
    shared = [seed for seed in by_seed if seed in base]
    if by_seed is base or not shared:
        return None
    return statistics.mean(by_seed[seed].held_out.psnr - base[seed].held_out.psnr for seed in shared)


def row(capture, name, by_seed, base):
    """Cells of a variant on a capture."""
    runs = list(by_seed.values())
    apart = difference(by_seed, base)
    trained = [run.scores.get(("train", "render")) for run in runs]
    gaps = [score.psnr - run.held_out.psnr for score, run in zip(trained, runs) if score]
    return [
        capture,
        name,
        score_cell([run.held_out for run in runs]),
        NOTHING if apart is None else f"{apart:+.2f}",
        f"{statistics.mean(gaps):.1f}" if gaps else NOTHING,
        score_cell([run.scores.get(("train", "deblurred")) for run in runs]),
        f"{statistics.mean(run.sharpness for run in runs):.0f}",
        f"{statistics.mean(run.gaussians for run in runs):.0f}",
        f"{statistics.mean(run.seconds for run in runs):.0f}",
        str(len(runs)),
    ]


def mean_row(name, results, base):
    """Cells of a variant over the captures, each of which counts the same."""
    means = [
        Score(
            statistics.mean(run.held_out.psnr for run in by_seed.values()),
            statistics.mean(run.held_out.ssim for run in by_seed.values()),
        )
        for by_seed in results
    ]
    apart = [difference(by_seed, own) for by_seed, own in zip(results, base)]
    mean = Score(statistics.mean(m.psnr for m in means), statistics.mean(m.ssim for m in means))
    shown = NOTHING if None in apart else f"{statistics.mean(apart):+.2f}"
    empty = [NOTHING] * (len(COLUMNS) - 4)
    return [MEAN, name, score_cell([mean]), shown, *empty]


def table(reports, brightened):
    """Markdown of {(capture, variant): {seed: report}}; `brightened` has a row of what was photographed, without 3D.

    Differences are to the first variant; the mean over captures has the variants that are finished on all of them.
    """
    results = {
        key: {seed: result(report) for seed, report in by_seed.items()} for key, by_seed in reports.items()
    }
    captures = list(dict.fromkeys(capture for capture, _ in results))
    names = list(dict.fromkeys(name for _, name in results))
    rows = []
    for capture in captures:
        base = results.get((capture, names[0]), {})
        photographs = [run.scores.get(("held_out", "enhanced")) for run in base.values()]
        if brightened and any(photographs):
            empty = [NOTHING] * (len(COLUMNS) - 3)
            rows.append([capture, BRIGHTENED, score_cell(photographs), *empty])
        rows += [row(capture, name, results[capture, name], base) for name in names if (capture, name) in results]
    if len(captures) > 1:
        base = [results.get((capture, names[0]), {}) for capture in captures]
        for name in names:
            everywhere = [results[capture, name] for capture in captures if (capture, name) in results]
            if len(everywhere) == len(captures):
                rows.append(mean_row(name, everywhere, base))
    lines = [COLUMNS, ["---"] * len(COLUMNS), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
