"""The loop: what is not yet explained of a frame moves the vehicle's Gaussians, and the poses of its box."""

from collections.abc import Generator, Iterator, Mapping
from typing import Any

import numpy as np

from dwgs.distill.config import DistillConfig
from dwgs.distill.photometric import Photometric, photometric
from dwgs.distill.prepare import Prepared
from dwgs.distill.symmetry import EVERY, Pull
from dwgs.optimize import Checkpoint, Event, Step, hold_then_decay, view_order
from dwgs.optimize.schedule import Pace
from dwgs.splat import Drawing, RetainedCloud

TAIL = 0.1
"""Fraction of the schedule, its end, over which the result is averaged."""
EVENNESS = (0.3, 3.0)
"""Bounds on the weight that makes every view count by the logarithm of its error, as in decibels."""
SETTLINGS, LEAST_BETWEEN = 3, 8
"""So many times in a round through the frames poses settle, but not after fewer steps than this."""


class Learner:
    """A vehicle, its poses where they are refined, and the frames that teach them.

    Args:
        prepared: Its vehicle and its poses change.
        config: What was asked for.
    """

    def __init__(self, prepared: Prepared, config: DistillConfig) -> None:
        self._shots, self._vehicle, self._poses = prepared.shots, prepared.vehicle, prepared.poses
        self._recipe, self._config = prepared.recipe, config
        self._cloud = RetainedCloud(self._vehicle.splats(), config.threads, moves=self._poses is not None)
        self._pictures = {i: shot.frozen.retain(self._cloud, shot.view) for i, shot in self._shots.items()}
        self._pull = None if prepared.imagined is None else Pull(prepared.imagined, self._cloud)
        self._judges: dict[int, tuple[Drawing, Photometric]] = {}
        self._squared_errors: dict[int, float] = {}
        self._step = 0

    def run(self, schedule: Iterator[Pace], checkpoint: Checkpoint | None) -> Generator[Event, None, int]:
        """Follow the schedule, from where the checkpoint left it; gives how many steps it had."""
        saved = None if checkpoint is None else checkpoint.load()
        if saved is not None:
            self._load(saved)
        learnt = list(self._shots)
        for pace, turn in zip(schedule, view_order(len(learnt), self._config.seed), strict=False):
            if pace.step <= self._step:
                continue
            if self._poses is not None and (pace.step - 1) % max(len(learnt) // SETTLINGS, LEAST_BETWEEN) == 0:
                self._poses.settle()
                self._move()
            pull = self._pull if pace.step % EVERY == 0 else None
            if pull is not None:
                self._vehicle.stand(self._shots[learnt[turn]].sight.world_from_vehicle)
                pull.draw(pace.step // EVERY)
            loss = self._learn(learnt[turn], watches=pace.step > len(learnt))
            if pull is not None:
                pull.add()
            factor = hold_then_decay(pace.progress, self._recipe.hold, self._recipe.final)
            self._vehicle.step(factor, is_averaged=pace.progress > 1 - TAIL)
            self._step = pace.step
            if checkpoint is not None:
                checkpoint.offer(self._state)
            yield Step(pace.step, pace.steps, loss)
        return self._step

    def _learn(self, i: int, watches: bool) -> float:
        """Leave the gradient of one frame's loss, and (if it ``watches``) tell the poses; the loss."""
        shot, picture = self._shots[i], self._pictures[i]
        self._vehicle.stand(shot.sight.world_from_vehicle)
        drawing = picture.draw()
        if i not in self._judges or self._judges[i][0] is not drawing:
            self._judges[i] = drawing, photometric(drawing, shot, self._recipe)
        error = loss = self._judges[i][1]()
        evenness = 1.0
        if not self._recipe.robust:
            self._squared_errors[i] = max(error, 1e-8)
            mean = sum(self._squared_errors.values()) / len(self._squared_errors)
            evenness = float(np.clip(mean / self._squared_errors[i], *EVENNESS))
            drawing.v_rgb.mul_(evenness)
        drawing.v_depth.zero_()
        drawing.v_alpha.zero_()
        if shot.lidar is not None and self._config.lidar_weight > 0:
            loss += shot.lidar.pull(drawing, self._config.lidar_weight)
        picture.adjoint()
        if self._poses is not None and watches:
            v_viewmat = picture.v_viewmat.double().numpy() / evenness
            self._poses.observe(i, shot, self._vehicle.splats(), error, v_viewmat)
        return loss

    def _move(self) -> None:
        """See the vehicle where the poses are now."""
        if self._poses is not None:
            for i, picture in self._pictures.items():
                picture.viewmat.copy_(self._shots[i].view_at(self._poses.old_from_new(i)).viewmat)

    def _state(self) -> dict[str, Any]:
        """Everything that further steps depend on."""
        poses = None if self._poses is None else self._poses.state_dict()
        state = {"step": self._step, "squared_errors": self._squared_errors}
        return state | {"vehicle": self._vehicle.state_dict(), "poses": poses}

    def _load(self, state: Mapping[str, Any]) -> None:
        """Be where `_state` was taken."""
        self._step, self._squared_errors = state["step"], state["squared_errors"]
        self._vehicle.load_state_dict(state["vehicle"])
        if self._poses is not None:
            self._poses.load_state_dict(state["poses"])
        self._move()
