"""How a body's colours follow the sun: learnt beside the colours, from frames that show the vehicle turned."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from dwgs.optimize.adam import EPSILON

RATE = 0.1
"""How far a coefficient per slope goes in a step."""


class Shader:
    """Changes of the body's first coefficients per slope of the sun, see `dwgs.scene.Shading`, and Adam on them.

    Not with `torch.optim`, whose first use imports for more than a second: that is time a distillation is given.

    Args:
        count: Gaussians of the body.
        betas: Of Adam.
    """

    def __init__(self, count: int, betas: tuple[float, float]) -> None:
        self.by_slope = torch.zeros(2, count, 3)
        """[2, count, 3]."""
        self.slopes = np.zeros((2, 2))
        """Lowest and highest that were asked for."""
        self._moments, self._betas, self._steps = torch.zeros(2, 2, count, 3), betas, 0

    def turn(self, colors: Tensor, before: NDArray[np.float64], after: NDArray[np.float64]) -> None:
        """Change colours [count, 3] that are lit at one slope [2] to what they are at another."""
        for by_slope, change in zip(self.by_slope, after - before, strict=True):
            colors.add_(by_slope, alpha=change)
        self.slopes = np.stack([np.minimum(self.slopes[0], after), np.maximum(self.slopes[1], after)])

    def step(self, v_colors: Tensor, slope: NDArray[np.float64], factor: float) -> None:
        """Learn from the gradient [count, 3] by colours that are lit at a slope [2], at the rate times ``factor``."""
        v_by_slope = v_colors * torch.from_numpy(slope).float()[:, None, None]
        (mean, square), (slow, slower) = self._moments, self._betas
        mean.lerp_(v_by_slope, 1 - slow)
        square.mul_(slower).addcmul_(v_by_slope, v_by_slope, value=1 - slower)
        self._steps += 1
        rate = factor * RATE * (1 - slower**self._steps) ** 0.5 / (1 - slow**self._steps)
        self.by_slope.addcdiv_(mean, square.sqrt().add_(EPSILON), value=-rate)

    def state_dict(self) -> dict[str, Any]:
        """Everything that further steps depend on."""
        slopes = torch.from_numpy(self.slopes)
        return {"by_slope": self.by_slope, "slopes": slopes, "moments": self._moments, "steps": self._steps}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Be what `state_dict` gave."""
        self.by_slope.copy_(state["by_slope"])
        self._moments.copy_(state["moments"])
        self.slopes, self._steps = state["slopes"].numpy(), state["steps"]
