"""How a vehicle drives: with little jerk, and where it points. What a path trembles is told from what it does.

Forces bend the path of what has mass little by little. How little is read off a path that trembles, axis by axis: what
goes to and fro from frame to frame is noise, and what stays is the drive (smoothing splines by maximum likelihood,
Wahba 1985), which on an axis may as well be no drive at all. Wheels hardly slide sideways, so that where a vehicle
goes tells where it points, and the other way round.
"""

from collections.abc import Sequence
from math import factorial

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial.transform import Rotation

from dwgs.distill.config import PathPrior
from dwgs.scene.pose import pose

ROUGH = np.repeat((1e-3, 5e-3), 3)
"""Noise of a path [rad, m] above which no vehicle drives it."""
TO_AND_FRO = -0.4
"""Correlation of a path's jerk with the next; white noise has -0.75, a manoeuvre has more than 0."""
STRIDE = 8
"""Sights from one to the next that tell how sharply a path bends."""
LONG = 0.5
"""Seconds between frames over which nothing is known of a path."""
SLIP = 0.05
"""How fast wheels slide sideways [m/s]: 1.0 of 5 cm noise is left across by the path alone, 1.4 if they may."""
LASTING = 1.0
"""For how long [s] a vehicle that does slide goes on sliding."""
AXLE = 1.5
"""How far the box centre may be ahead of the rear axle, about which a vehicle turns [m]."""
ASKEW = 0.02
"""How far its box may be turned from where it points, in all frames alike [rad]."""
STIFFEST = 0.1
"""Of what noise makes of a path's slowest change: by how much less it changes, the path does not tell."""


class Path:
    """What is known of a vehicle's path before its pictures are seen.

    Args:
        times: [N] of the sights [s], camera by camera.
        cameras: [N] which saw it.
        given: [N, 4, 4] ``world_from_vehicle``, up to some noise.
        prior: How much noise and how much jerk there is, unless the path trembles and says so itself.
    """

    def __init__(
        self, times: NDArray[np.float64], cameras: Sequence[str], given: NDArray[np.float64], prior: PathPrior
    ) -> None:
        self._given = self._smooth = given
        self._derivatives = [_derivative(times, cameras, order) for order in (1, 2, 3)]
        high = _derivative(times, cameras, 5)
        far_apart = _derivative(times, cameras, 3, stride=max(1, min(STRIDE, (len(times) - 1) // 3)))
        self._noise = _measure_noise(high, given)
        self._bends = np.full((3, 6), np.inf)
        self._bends[2] = np.maximum(_measure_jerk(far_apart, given, self._noise), np.repeat(prior.jerk, 3))
        self._slack = np.maximum(self._noise, np.repeat(prior.slack, 3))
        self._slip = np.inf
        telling = np.flatnonzero(self._noise > np.repeat(prior.slack, 3))
        if self.is_rough() and len(telling):
            self._settle()
            self._tell_apart(telling, np.repeat(prior.slack, 3)[telling])
            self._settle()
            self._slip = self._measure_slip(times)
            for _ in range(2):
                self._settle()
        self._stiffness, self._force = self._hold()

    def is_rough(self) -> bool:
        """Whether the path trembles as no vehicle does: to and fro, where one that bends sharply goes on bending."""
        jerks = self._derivatives[2] @ _coordinates(self._given)
        turns_back = (jerks[1:] * jerks[:-1]).sum(0) < TO_AND_FRO * (jerks**2).sum(0)
        return bool((turns_back & (self._noise > ROUGH)).any())

    def moves(
        self, poses: NDArray[np.float64], information: NDArray[np.float64], pull: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """[N, 6] turns [rad] and shifts [m] in the world after which the path, and what else is known, agree best.

        Args:
            poses: [N, 4, 4] ``world_from_vehicle`` as they are now.
            information: [N, 6, 6] second derivatives, by the move of each pose, of minus the logarithm of the
                likelihood of what else is known.
            pull: [N, 6] its first derivatives.
        """
        car = np.zeros(2)
        matrix = self._stiffness + sparse.block_diag([*information, np.diag(car)])
        slope = np.append(pull, car) + self._stiffness @ np.append(apart(poses, self._smooth), car) + self._force
        return -sparse.linalg.spsolve(matrix.tocsc(), slope)[:-2].reshape(-1, 6)

    def _settle(self) -> None:
        """Be smoother: the path as given and how vehicles drive agree best, as far as that is known by now."""
        self._stiffness, self._force = self._hold()
        nothing = np.zeros((len(self._given), 6))
        self._smooth = moved(self._smooth, self.moves(self._smooth, np.zeros((*nothing.shape, 6)), nothing))

    def _hold(self) -> tuple[sparse.csc_array, NDArray[np.float64]]:
        """[6 N + 2, 6 N + 2] and [6 N + 2] second and first derivatives of minus the logarithm of the likelihood.

        By turns and shifts from the smooth path, and by what is unknown of the car: how far the box is ahead of its
        axle, and how askew.
        """
        own = _own_from_world(self._smooth)
        rows = [
            _blocks(own[_middles(derivative)] / sigma[:, None]) @ sparse.kron(derivative, np.eye(6))
            for derivative, sigma in zip(self._derivatives, self._bends, strict=True)
        ]
        staying = _blocks(own / self._slack[:, None])
        places = _coordinates(self._smooth).reshape(-1)
        misfits = [*(row @ places for row in rows), staying @ apart(self._smooth, self._given).reshape(-1)]
        slips, by_pose, by_car, car = self._sliding()
        jacobian = sparse.block_array(
            [
                [sparse.vstack([*rows, staying]), None],
                [by_pose / self._slip, by_car / self._slip],
                [None, np.diag([1 / AXLE, 1 / ASKEW])],
            ]
        )
        misfit = np.concatenate([*misfits, slips / self._slip, car / (AXLE, ASKEW)])
        return (jacobian.T @ jacobian).tocsc(), jacobian.T @ misfit

    def _sliding(self) -> tuple[NDArray[np.float64], sparse.csr_array, sparse.csr_array, NDArray[np.float64]]:
        """[pairs] how fast the rear axle slides sideways on the smooth path [m/s]; by all poses; by the car; the car.

        Between every two sights, by the `car` [2] that does so least: by its axle [m] and how askew its box is [rad].
        """
        velocity = self._derivatives[0]
        between = sparse.csr_array((np.full(velocity.nnz, 0.5), velocity.indices, velocity.indptr), velocity.shape)
        axes = (between @ self._smooth[:, :3, :3].reshape(-1, 9)).reshape(-1, 3, 3)
        ahead, left, up = np.moveaxis(axes, 2, 0)
        turning, moving = np.split(velocity @ _coordinates(self._smooth), 2, axis=1)
        sideways = (left * moving).sum(1)
        by_car = np.stack([(up * turning).sum(1), (ahead * moving).sum(1)], 1)
        slip = SLIP if np.isinf(self._slip) else self._slip
        doubt = slip**2 * np.diag([AXLE**-2, ASKEW**-2])
        car = np.linalg.solve(by_car.T @ by_car + doubt, by_car.T @ sideways)
        by_turn = np.hstack([np.cross(left, moving), np.zeros_like(left)])
        by_rate = np.hstack([-car[0] * up, left])
        by_turns = _blocks(by_turn[:, None]) @ sparse.kron(between, np.eye(6))
        by_rates = _blocks(by_rate[:, None]) @ sparse.kron(velocity, np.eye(6))
        return sideways - by_car @ car, sparse.csr_array(by_turns + by_rates), sparse.csr_array(-by_car), car

    def _measure_slip(self, times: NDArray[np.float64]) -> float:
        """How fast it slides from one sight to the next [m/s]: more than wheels do, where the path goes sideways."""
        slips = self._sliding()[0]
        more = max(float((slips**2).mean()) - (2 * SLIP) ** 2, 0)
        return float(np.sqrt(SLIP**2 + more * LASTING / np.median(np.diff(times))))

    def _tell_apart(self, telling: NDArray[np.intp], least: NDArray[np.float64]) -> None:
        """Read off the path how much it bends and how much noise there is, by and along these axes of the vehicle.

        They tremble by more than they may be off anyhow, which is the `least` noise; how the others bend is not seen,
        as boxes are annotated level. Which derivative is white, its size, and the noise are those by which the path is
        most likely. Each number that it starts from (a place; a speed, too; an acceleration) has to explain more than
        chance does (Schwarz 1978), so that an axis where nothing happens keeps still.
        """
        path = _coordinates(self._smooth) + apart(self._given, self._smooth)
        own = _own_from_world(self._smooth)
        most, count = np.full(len(telling), -np.inf), len(path)
        for order, derivative in enumerate(self._derivatives):
            changes = np.einsum("nij,nj->ni", own[_middles(derivative)], derivative @ path)[:, telling]
            sizes, shapes = np.linalg.eigh((derivative @ derivative.T).toarray())
            squares = (shapes.T @ changes) ** 2
            for ratio in np.geomspace(STIFFEST * sizes[0], sizes[-1], 121):
                noise = (squares / (sizes + ratio)[:, None]).mean(0)
                lost = np.log1p(ratio / sizes).sum() + (count - len(sizes)) * np.log(count)
                likelihood = -(count * np.log(noise) + lost) / 2
                better = likelihood > most
                most[better] = likelihood[better]
                self._bends[:, telling[better]] = np.inf
                self._bends[order, telling[better]] = np.sqrt(ratio * noise[better])
                self._slack[telling[better]] = np.maximum(np.sqrt(noise), least)[better]


def apart(poses: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
    """[N, 6] rotation vectors [rad] and shifts [m] in the world that lead from others [N, 4, 4] to poses [N, 4, 4]."""
    turned = poses[:, :3, :3] @ np.swapaxes(others[:, :3, :3], 1, 2)
    return np.hstack([Rotation.from_matrix(turned).as_rotvec(), poses[:, :3, 3] - others[:, :3, 3]])


def moved(poses: NDArray[np.float64], moves: NDArray[np.float64]) -> NDArray[np.float64]:
    """[N, 4, 4] poses [N, 4, 4] after moves [N, 6]: what `apart` gives."""
    turned = Rotation.from_rotvec(moves[:, :3]).as_matrix() @ poses[:, :3, :3]
    return pose(turned, poses[:, :3, 3] + moves[:, 3:])


def _own_from_world(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """[N, 6, 6] about and along the vehicle's axes, from about and along the world's."""
    own = np.zeros((len(poses), 6, 6))
    own[:, :3, :3] = own[:, 3:, 3:] = np.swapaxes(poses[:, :3, :3], 1, 2)
    return own


def _coordinates(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """[N, 6] angles [rad] turned since the first pose and places [m]."""
    rotations = Rotation.from_matrix(poses[:, :3, :3])
    turns = (rotations[1:] * rotations[:-1].inv()).as_rotvec()
    angles = np.vstack([np.zeros(3), np.cumsum(turns.reshape(-1, 3), 0)])
    return np.hstack([angles, poses[:, :3, 3]])


def _measure_noise(derivative: sparse.csr_array, poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """[6] sigma of the white noise about and along each axis [rad, m] that makes a high ``derivative`` so large."""
    if derivative.nnz == 0:
        return np.zeros(6)
    return np.median(np.abs(derivative @ _coordinates(poses)) / _sizes(derivative), 0) / 0.6745


def _measure_jerk(
    derivative: sparse.csr_array, poses: NDArray[np.float64], noise: NDArray[np.float64]
) -> NDArray[np.float64]:
    """[6] of the path [rad/s^3, m/s^3] between places so far apart that noise makes little of it."""
    if derivative.nnz == 0:
        return np.zeros(6)
    squares = (derivative @ _coordinates(poses)) ** 2 - (_sizes(derivative) * noise) ** 2
    return np.sqrt(np.maximum(squares.mean(0), 0))


def _derivative(times: NDArray[np.float64], cameras: Sequence[str], order: int, stride: int = 1) -> sparse.csr_array:
    """[runs of sights of one camera, sights] by divided differences in time [1/s^order] of every so-many-th sight."""
    weights, places = [], []
    for k in range(len(times) - order * stride):
        run = np.arange(k, k + order * stride + 1, stride)
        t = times[run]
        if cameras[run[0]] == cameras[run[-1]] and np.diff(t).max() < stride * LONG:
            spans = t[:, None] - t + np.eye(order + 1)
            weights.append(factorial(order) / spans.prod(1))
            places.append(run)
    rows = np.repeat(np.arange(len(weights)), order + 1)
    columns = np.concatenate([*places, np.zeros(0, int)])
    return sparse.csr_array((np.concatenate([*weights, np.zeros(0)]), (rows, columns)), (len(weights), len(times)))


def _sizes(derivative: sparse.csr_array) -> NDArray[np.float64]:
    """[runs, 1] how much each row makes of white noise."""
    return sparse.linalg.norm(derivative, axis=1).reshape(-1, 1)


def _middles(derivative: sparse.csr_array) -> NDArray[np.signedinteger]:
    """[runs] a sight in the middle of each."""
    return (derivative.indices[derivative.indptr[:-1]] + derivative.indices[derivative.indptr[1:] - 1]) // 2


def _blocks(blocks: NDArray[np.float64]) -> sparse.bsr_array:
    """[N rows, N columns] a matrix with blocks [N, rows, columns] along its diagonal."""
    count, rows, columns = blocks.shape
    return sparse.bsr_array((blocks, np.arange(count), np.arange(count + 1)), (count * rows, count * columns))
