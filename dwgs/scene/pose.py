"""Rigid transforms. ``p_a = a_from_b @ p_b``: adjacent names cancel."""

import numpy as np
from numpy.typing import ArrayLike, NDArray


def pose(rotation: ArrayLike, translation: ArrayLike) -> NDArray[np.float64]:
    """``a_from_b`` [..., 4, 4] from rotation [..., 3, 3] and translation [..., 3]."""
    rotation = np.asarray(rotation, np.float64)
    a_from_b = np.zeros((*rotation.shape[:-2], 4, 4))
    a_from_b[..., :3, :3] = rotation
    a_from_b[..., :3, 3] = translation
    a_from_b[..., 3, 3] = 1
    return a_from_b


def inverse(a_from_b: ArrayLike) -> NDArray[np.float64]:
    """``b_from_a`` [..., 4, 4] of rigid ``a_from_b`` [..., 4, 4]."""
    a_from_b = np.asarray(a_from_b, np.float64)
    rotation = np.swapaxes(a_from_b[..., :3, :3], -1, -2)
    return pose(rotation, -(rotation @ a_from_b[..., :3, 3:])[..., 0])


def transform_points(a_from_b: ArrayLike, points: ArrayLike) -> NDArray[np.float64]:
    """Points [N, 3] in ``b`` seen from ``a``."""
    a_from_b = np.asarray(a_from_b, np.float64)
    return np.asarray(points, np.float64) @ a_from_b[:3, :3].T + a_from_b[:3, 3]


def is_rigid(a_from_b: NDArray, tolerance: float = 1e-4) -> bool:
    """Whether every ``a_from_b`` [..., 4, 4] is a finite rotation and translation."""
    a_from_b = np.asarray(a_from_b)
    if a_from_b.shape[-2:] != (4, 4) or not np.isfinite(a_from_b).all():
        return False
    rotation = a_from_b[..., :3, :3]
    orthogonal = np.abs(rotation @ np.swapaxes(rotation, -1, -2) - np.eye(3)).max(initial=0) < tolerance
    proper = (np.linalg.det(rotation) > 0).all()
    return bool(orthogonal and proper and (np.abs(a_from_b[..., 3, :] - [0, 0, 0, 1]) < tolerance).all())


def rotation_from_quat(quat: ArrayLike) -> NDArray[np.float64]:
    """Rotation [..., 3, 3] from quaternion [..., 4] in wxyz order, of any length but zero."""
    quat = np.asarray(quat, np.float64)
    w, x, y, z = np.moveaxis(quat / np.linalg.norm(quat, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def quat_from_rotation(rotation: ArrayLike) -> NDArray[np.float64]:
    """Unit quaternion [..., 4], wxyz with w >= 0, from rotation [..., 3, 3].

    The eigenvector of the largest eigenvalue of Bar-Itzhack's symmetric 4x4 matrix ("New method for
    extracting the quaternion from a rotation matrix", 2000): no branches, stable at every angle.
    """
    r = np.asarray(rotation, np.float64)
    xx, yy, zz = r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]
    k = np.empty((*r.shape[:-2], 4, 4))
    k[..., 0, 0] = xx + yy + zz
    k[..., 1, 1], k[..., 2, 2], k[..., 3, 3] = xx - yy - zz, yy - xx - zz, zz - xx - yy
    k[..., 0, 1] = k[..., 1, 0] = r[..., 2, 1] - r[..., 1, 2]
    k[..., 0, 2] = k[..., 2, 0] = r[..., 0, 2] - r[..., 2, 0]
    k[..., 0, 3] = k[..., 3, 0] = r[..., 1, 0] - r[..., 0, 1]
    k[..., 1, 2] = k[..., 2, 1] = r[..., 0, 1] + r[..., 1, 0]
    k[..., 1, 3] = k[..., 3, 1] = r[..., 0, 2] + r[..., 2, 0]
    k[..., 2, 3] = k[..., 3, 2] = r[..., 1, 2] + r[..., 2, 1]
    quat = np.linalg.eigh(k)[1][..., -1]
    return np.where(quat[..., :1] < 0, -quat, quat)


def quat_product(quat_a: ArrayLike, quat_b: ArrayLike) -> NDArray[np.float64]:
    """Quaternion [..., 4], wxyz, of the rotation ``quat_b`` followed by ``quat_a`` (Hamilton's product)."""
    aw, ax, ay, az = np.moveaxis(np.asarray(quat_a, np.float64), -1, 0)
    bw, bx, by, bz = np.moveaxis(np.asarray(quat_b, np.float64), -1, 0)
    parts = [
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    ]
    return np.stack(parts, -1)


def slerp(quat_a: ArrayLike, quat_b: ArrayLike, s: ArrayLike) -> NDArray[np.float64]:
    """Unit quaternion [..., 4] on the shorter arc from ``quat_a`` (s = 0) to ``quat_b`` (s = 1)."""
    quat_a, quat_b = np.asarray(quat_a, np.float64), np.asarray(quat_b, np.float64)
    s = np.asarray(s, np.float64)[..., None]
    cosine = np.sum(quat_a * quat_b, -1, keepdims=True)
    quat_b = np.where(cosine < 0, -quat_b, quat_b)
    angle = np.arccos(np.clip(np.abs(cosine), 0, 1))
    sine = np.sin(angle)
    near = sine < 1e-6  # the arc is a straight line to within float64
    safe = np.where(near, 1, sine)
    weight_a = np.where(near, 1 - s, np.sin((1 - s) * angle) / safe)
    weight_b = np.where(near, s, np.sin(s * angle) / safe)
    quat = weight_a * quat_a + weight_b * quat_b
    return quat / np.linalg.norm(quat, axis=-1, keepdims=True)


def yaw_rotation(yaw: ArrayLike) -> NDArray[np.float64]:
    """Rotation [..., 3, 3] by ``yaw`` [rad] about +z."""
    yaw = np.asarray(yaw, np.float64)
    c, s, o, i = np.cos(yaw), np.sin(yaw), np.zeros_like(yaw), np.ones_like(yaw)
    return np.stack([np.stack([c, -s, o], -1), np.stack([s, c, o], -1), np.stack([o, o, i], -1)], -2)


def pitch_rotation(pitch: ArrayLike) -> NDArray[np.float64]:
    """Rotation [..., 3, 3] by ``pitch`` [rad] about +y: what looks up comes to look ahead."""
    pitch = np.asarray(pitch, np.float64)
    c, s, o, i = np.cos(pitch), np.sin(pitch), np.zeros_like(pitch), np.ones_like(pitch)
    return np.stack([np.stack([c, o, s], -1), np.stack([o, i, o], -1), np.stack([-s, o, c], -1)], -2)
