"""Quality over time: what a distillation reaches in the seconds it is given, against what it converges to.

The embedded street with the true vehicle in it, before the street as it was recorded. Each schedule is made for its
time, which decoding and the layers of the background are part of; judging the result is not.
"""

import json
import os
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.progress import Progress

from benchmarks.metric import Metric
from benchmarks.workloads.oracle import ExactBackground, follow
from dwgs.datasets import folder
from dwgs.distill import DistillConfig, distill
from dwgs.scene import InputError
from dwgs.street import build_street

REFERENCE = Path(__file__).with_name("distill_reference.json")
"""What the street converges to; `python -m benchmarks run distill --reference-steps 30000` writes it anew."""


def run(frames: int, seconds: Sequence[float], reference_steps: int) -> list[Metric]:
    """Distil once for each of the times; once to convergence, too, if that shall have so many steps."""
    reference = json.loads(REFERENCE.read_text())
    if not reference_steps and reference["frames"] != frames:
        raise InputError(
            f"the reference beside the benchmark is of {reference['frames']} frames, not {frames}; "
            "measure one with --reference-steps 30000"
        )
    street = build_street(frames=frames)
    insertion = street.insertion()
    with Progress() as progress, TemporaryDirectory() as temporary:
        task = progress.add_task("record", total=2 * frames)
        street.render_all(lambda done, _total: progress.update(task, completed=done))
        video = Path(temporary) / "oracle"  # a video to decode, as whoever distils has it
        folder.write(street.oracle(insertion), video, lambda done, _: progress.update(task, completed=frames + done))
        scene, exact = folder.read(video), ExactBackground(street)

        def reach(config: DistillConfig, title: str) -> dict:
            return follow(distill(scene, exact, insertion, config), progress, title)[1]

        short = {time: reach(DistillConfig(seconds=time), f"{time:g} s") for time in seconds}
        loads = os.getloadavg()[0]
        if reference_steps:
            report = reach(DistillConfig(steps=reference_steps), f"{reference_steps:,} steps")
            reference = {key: report[key] for key in ("psnr_roi_heldout", "steps")} | {"frames": frames}
            REFERENCE.write_text(json.dumps(reference, indent=2) + "\n")
    metrics = [
        Metric("distill.street.psnr_converged", reference["psnr_roi_heldout"], "dB"),
        Metric("distill.street.steps_converged", reference["steps"], ""),
        Metric("distill.street.load", loads, ""),
    ]
    for time, report in short.items():
        gap = reference["psnr_roi_heldout"] - report["psnr_roi_heldout"]
        metrics += [
            Metric(f"distill.street.gap_db_at_{time:g}s", gap, "dB"),
            Metric(f"distill.street.steps_at_{time:g}s", report["steps"], ""),
            Metric(f"distill.street.prepare_at_{time:g}s", report["seconds"]["prepare"], "s"),
        ]
    return metrics
