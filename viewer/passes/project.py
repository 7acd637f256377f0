"""First pass: Gaussians of several clouds to splats in one buffer."""

import moderngl
import numpy as np
from numpy.typing import NDArray

from dwgs.scene import Camera, Gaussians
from dwgs.scene.pose import inverse
from viewer.shaders import intrinsics, set_uniforms, source

SPLAT_BYTES = 64
"""Size of ``Splat`` in splat.glsl."""
_GROUP = 256


class Projection:
    """Keeps clouds on the device, projects them into a camera, hands out depth keys."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._shader = context.compute_shader(source("rules", "splat", "project"))
        self._clouds: dict[int, tuple[Gaussians, list[moderngl.Buffer]]] = {}
        self.splats = context.buffer(reserve=SPLAT_BYTES)
        self._keys = context.buffer(reserve=4)

    def run(self, clouds: list[tuple[Gaussians, NDArray[np.float64]]], camera: Camera) -> NDArray[np.uint32]:
        """Fill `splats` and return their depth keys [N], cloud after cloud.

        Each cloud comes with its ``world_from_cloud``. A cloud is uploaded when it first appears and stays
        until a picture lacks it; in between only matrices travel.
        """
        self._keep_only([cloud for cloud, _ in clouds])
        total = sum(len(cloud) for cloud, _ in clouds)
        if total == 0:
            return np.zeros(0, np.uint32)
        self._make_room(total)
        self.splats.bind_to_storage_buffer(5)
        self._keys.bind_to_storage_buffer(6)
        set_uniforms(self._shader, intrinsics=intrinsics(camera), image_size=(camera.width, camera.height))
        first = 0
        for cloud, world_from_cloud in clouds:
            for binding, buffer in enumerate(self._buffers_of(cloud)):
                buffer.bind_to_storage_buffer(binding)
            camera_from_cloud = camera.camera_from_world @ world_from_cloud  # in float64: worlds are large
            set_uniforms(
                self._shader,
                count=len(cloud),
                first=first,
                sh_count=cloud.sh.shape[1],
                camera_from_cloud=tuple(camera_from_cloud.T.ravel()),
                camera_position=tuple(inverse(camera_from_cloud)[:3, 3]),
            )
            self._shader.run(-(-len(cloud) // _GROUP))
            first += len(cloud)
        self._context.memory_barrier()
        return np.frombuffer(self._keys.read(4 * total), np.uint32)

    def _make_room(self, count: int) -> None:
        if self._keys.size < 4 * count:
            self.splats.orphan(SPLAT_BYTES * count)
            self._keys.orphan(4 * count)

    def _buffers_of(self, cloud: Gaussians) -> list[moderngl.Buffer]:
        if id(cloud) not in self._clouds:
            arrays = (cloud.means, cloud.quats, cloud.scales, cloud.opacities, cloud.sh)
            buffers = [self._context.buffer(np.ascontiguousarray(array)) for array in arrays]
            self._clouds[id(cloud)] = cloud, buffers  # holding the cloud keeps its id from being given away
        return self._clouds[id(cloud)][1]

    def _keep_only(self, clouds: list[Gaussians]) -> None:
        for key in self._clouds.keys() - {id(cloud) for cloud in clouds}:
            for buffer in self._clouds.pop(key)[1]:
                buffer.release()
