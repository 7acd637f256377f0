"""Quality over time: what a distillation reaches in the seconds it is given, against what it converges to.

The embedded street with the true vehicle in it, before the street as it was recorded. Each schedule is made for its
time, which decoding and the layers of the background are part of; judging the result is not.
"""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.progress import Progress

from benchmarks.metric import Metric
from benchmarks.workloads.drives import inserted
from benchmarks.workloads.oracle import ExactBackground, follow
from dwgs.datasets import folder
from dwgs.distill import DistillConfig, distill
from dwgs.scene import InputError
from dwgs.street import Street

REFERENCE = Path(__file__).with_name("distill_reference.json")
"""What drives converge to; `python -m benchmarks run distill --reference-steps 30000` writes them anew."""
NEAR_ENOUGH = 0.3
"""So far below what it converges to [dB] a vehicle counts as distilled."""


@dataclass(frozen=True)
class Plan:
    """What is distilled, and for how long."""

    drives: Sequence[str]
    seconds: Sequence[float]
    reference_steps: int
    """Of a further fit that counts as converged; 0: there is one beside the benchmark."""
    without_shadow: float
    """Seconds of a further fit that may not explain the shadow; 0: none."""


def run(street: Street, plan: Plan, progress: Progress) -> list[Metric]:
    """Distil each drive once for each of the times, and what else is planned.

    A drive without a reference of as many frames has no gaps, but for the street's own, which raises `InputError`.
    """
    references = json.loads(REFERENCE.read_text())
    if not plan.reference_steps and "street" in plan.drives and references["street"]["frames"] != street.frames:
        raise InputError(
            f"the reference beside the benchmark is of {references['street']['frames']} frames, not {street.frames}; "
            "measure one with --reference-steps 30000"
        )
    task = progress.add_task("record", total=street.frames)
    street.render_all(lambda done, _total: progress.update(task, completed=done))
    exact, metrics = ExactBackground(street), []
    for drive in plan.drives:
        insertion = inserted(street, drive)
        with TemporaryDirectory() as temporary:
            video = Path(temporary) / "oracle"  # a video to decode, as whoever distils has it
            task = progress.add_task(f"film {drive}", total=street.frames)
            folder.write(
                street.oracle(insertion), video, lambda done, _, task=task: progress.update(task, completed=done)
            )
            scene = folder.read(video)

            def reach(config: DistillConfig, title: str, scene=scene, insertion=insertion) -> dict:
                return follow(distill(scene, exact, insertion, config), progress, title).report

            short = {time: reach(DistillConfig(seconds=time), f"{drive}, {time:g} s") for time in plan.seconds}
            load = os.getloadavg()[0]
            if plan.without_shadow:
                with_it = DistillConfig(seconds=plan.without_shadow)
                pair = [reach(replace(with_it, shadow_margin=m), f"shadow {m:g}") for m in (with_it.shadow_margin, 0.0)]
                metrics += _shadow_metrics(_name(drive), *pair)
            if plan.reference_steps:
                report = reach(DistillConfig(steps=plan.reference_steps), f"{drive}, {plan.reference_steps:,} steps")
                references[drive] = {key: report[key] for key in ("psnr_roi_heldout", "steps")}
                references[drive]["frames"] = street.frames
                REFERENCE.write_text(json.dumps(references, indent=2) + "\n")
        reference = references.get(drive)
        known = reference is not None and reference["frames"] == street.frames
        metrics += _metrics(_name(drive), short, reference if known else None)
        metrics.append(Metric(f"{_name(drive)}.load", load, ""))
    return metrics


def seconds_to(gap: float, gap_at: Mapping[float, float]) -> tuple[str, float]:
    """After which time a gap [dB] is as small as wanted, between schedules made for the times in ``gap_at``.

    Interpolated over the logarithm of time. Beyond the schedules there are only bounds: ``""`` names the time itself,
    ``"_at_most"`` and ``"_at_least"`` what is known of it.
    """
    times = sorted(gap_at)
    gaps = np.array([gap_at[time] for time in times])
    if gaps[0] <= gap:
        return "_at_most", times[0]
    if (gaps > gap).all():
        return "_at_least", times[-1]
    after = int(np.argmax(gaps <= gap))
    share = (gaps[after - 1] - gap) / (gaps[after - 1] - gaps[after])
    return "", float(np.exp((1 - share) * np.log(times[after - 1]) + share * np.log(times[after])))


def _metrics(name: str, short: Mapping[float, dict], reference: dict | None) -> list[Metric]:
    metrics = []
    for time, report in short.items():
        metrics += [
            Metric(f"{name}.psnr_at_{time:g}s", report["psnr_roi_heldout"], "dB"),
            Metric(f"{name}.steps_at_{time:g}s", report["steps"], ""),
            Metric(f"{name}.prepare_at_{time:g}s", report["seconds"]["prepare"], "s"),
        ]
    if reference is not None:
        gap_at = {time: reference["psnr_roi_heldout"] - report["psnr_roi_heldout"] for time, report in short.items()}
        metrics += [Metric(f"{name}.gap_db_at_{time:g}s", gap, "dB") for time, gap in gap_at.items()]
        metrics += [
            Metric(f"{name}.psnr_converged", reference["psnr_roi_heldout"], "dB"),
            Metric(f"{name}.steps_converged", reference["steps"], ""),
        ]
        bound, time = seconds_to(NEAR_ENOUGH, gap_at)
        metrics.append(Metric(f"{name}.seconds_to_quality{bound}", time, "s"))
    return metrics


def _shadow_metrics(name: str, with_it: dict, without: dict) -> list[Metric]:
    gain = with_it["psnr_roi_heldout"] - without["psnr_roi_heldout"]
    return [
        Metric(f"{name}.shadow_gain_db", gain, "dB"),
        Metric(f"{name}.shadow_gaussians", with_it["gaussians_shadow"], ""),
        Metric(f"{name}.shadow_gaussians_without", without["gaussians_shadow"], ""),
    ]


def _name(drive: str) -> str:
    return "distill.street" if drive == "street" else f"distill.street_{drive}"
