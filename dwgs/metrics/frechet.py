"""How far two sets of features are apart: FID of images, FVD of clips, given whose features they are."""

import numpy as np
from numpy.typing import NDArray

from dwgs.scene.errors import InputError


def frechet_distance(features: NDArray, reference: NDArray) -> float:
    """Squared Frechet distance of two normal distributions fitted to features [N, D] and [M, D].

    ``|m - m'|^2 + tr(C + C' - 2 (C C')^1/2)`` with unbiased covariances (Heusel et al. 2017). The last trace is the
    sum of the singular values of ``R R'^T`` where ``C = R^T R``: no root of an ill-conditioned matrix is taken, and
    fewer features than dimensions are no trouble. Raises `InputError` below two features or where dimensions differ.
    """
    a, b = np.asarray(features, np.float64), np.asarray(reference, np.float64)
    if a.ndim != 2 or b.ndim != 2 or a.shape[1] != b.shape[1] or min(len(a), len(b)) < 2:
        raise InputError(
            f"a Frechet distance compares at least two features with two, of one length; got {a.shape} and {b.shape}"
        )
    root_a, root_b = _covariance_root(a), _covariance_root(b)
    traces = (root_a**2).sum() + (root_b**2).sum()
    shared = np.linalg.svd(root_a @ root_b.T, compute_uv=False).sum()
    return max(0.0, float(((a.mean(0) - b.mean(0)) ** 2).sum() + traces - 2 * shared))


def _covariance_root(features: NDArray[np.float64]) -> NDArray[np.float64]:
    """R [min(N, D), D] with ``R^T R`` the covariance of features [N, D]."""
    centred = (features - features.mean(0)) / np.sqrt(len(features) - 1)
    return centred if len(centred) <= centred.shape[1] else np.asarray(np.linalg.qr(centred, mode="r"))
