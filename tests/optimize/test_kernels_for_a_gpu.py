"""What steps and judges on a GPU compiles for one; `tests/splat/test_on_gpu.py` runs it where there is one."""

import pytest
import warp as wp

from dwgs.optimize.kernels import activation, adam_cuda, photometric_cuda


@pytest.mark.parametrize("arch", [80, 90, 120])
@pytest.mark.parametrize("module", [activation, adam_cuda, photometric_cuda])
def test_kernels_compile_for_a_gpu(module, arch, tmp_path):
    wp.compile_aot_module(module.__name__, arch=arch, module_dir=tmp_path, use_ptx=False)
    assert list(tmp_path.glob("*.cubin"))
