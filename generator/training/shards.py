"""A network shared out among processes (PyTorch's FSDP2): each keeps a part of every tensor, and borrows the rest.

Weights are gathered block by block in the precision they are stored in, and autocast rounds them where one process
would: sharing changes where numbers lie, not which they are.
"""

import torch
from diffusers import WanVACETransformer3DModel
from torch import Tensor
from torch.distributed.device_mesh import init_device_mesh
from torch.distributed.fsdp import fully_shard
from torch.distributed.tensor import DTensor, distribute_tensor


def share_out(transformer: WanVACETransformer3DModel, device: torch.device, processes: int) -> None:
    """Leave this process its part of every parameter, on its device; the parameters are new ones.

    Args:
        transformer: In host memory, whole, and the same in every process.
        device: This process's.
        processes: How many there are; all must call.
    """
    mesh = init_device_mesh(device.type, (processes,))
    # the root, too, gives back what it borrowed: it would keep averaged weights after a look at the held-out clips
    for module in (*transformer.vace_blocks, *transformer.blocks, transformer):
        fully_shard(module, mesh=mesh, reshard_after_forward=True)


def whole(tensor: Tensor) -> Tensor:
    """All of a tensor, whether it is shared out or not; of a shared one all processes must ask."""
    return tensor.full_tensor() if isinstance(tensor, DTensor) else tensor


def part_of(tensor: Tensor, like: Tensor) -> Tensor:
    """What a process that holds ``like`` keeps of a whole tensor, on the same device."""
    tensor = tensor.to(like.device)
    if not isinstance(like, DTensor):
        return tensor
    return distribute_tensor(tensor, like.device_mesh, like.placements, src_data_rank=None)
