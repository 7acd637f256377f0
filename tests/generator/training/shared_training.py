"""What every process runs in `test_shards`: trainings that share their network out or not, a folder each."""

import json
import sys
from dataclasses import replace
from pathlib import Path

from generator.training.cache import Cache
from generator.training.config import TrainingConfig
from generator.training.loop import Trainer, Validated
from generator.training.preview import preview
from generator.wan.weights import Backbone

CONFIG = TrainingConfig(steps=4, batch=4, rate=1e-3, warmup=2, ema=0.5, precision="no", checkpoint_every=2)
BF16 = replace(CONFIG, precision="bf16")
ALL = replace(CONFIG, trains="all")


def main(latents: str, backbone: str, out: str) -> None:
    """Train straight, in two halves, in 16 bits, with the backbone learning, too, and with a copy in each process."""
    cache, opened, root = Cache(Path(latents)), Backbone.open(Path(backbone)), Path(out)
    for name, config in (
        ("straight", CONFIG),
        ("halved", replace(CONFIG, steps=2)),
        ("halved", CONFIG),
        ("bf16", BF16),
        ("all", ALL),
        ("copied", CONFIG),
    ):
        trainer = Trainer(cache, opened, config, root / name, sharded=name != "copied")
        parameters = trainer.transformer.named_parameters() if name != "copied" else ()
        held = {n: [p.to_local().numel(), p.numel()] for n, p in parameters}
        events = list(trainer.run())
        clips = preview(trainer) if name == "straight" else []
        painted = [float(clip.painted.double().square().mean()) for clip in clips]
        if name == "all":
            trainer.export(root / name / "export")
        if trainer.accelerator.is_main_process:
            losses = [e.loss for e in events if not isinstance(e, Validated) and hasattr(e, "loss")]
            seen = [e.loss for e in events if isinstance(e, Validated)]
            told = {"losses": losses, "held_out": seen, "painted": painted, "held": held}
            (root / name / "told.json").write_text(json.dumps(told))


if __name__ == "__main__":
    main(*sys.argv[1:])
