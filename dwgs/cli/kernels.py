"""Compiles every kernel: `python -m dwgs.cli.kernels`. Warp keeps them, so that no first run waits for a compiler."""

import warp as wp


def compile_all() -> None:
    """Compile what runs on the CPU, module by module; what is compiled already is only loaded."""
    import dwgs.splat.parallel as splat
    from dwgs.optimize.kernels import activation, adam_cpu, photometric_cpu
    from dwgs.street import build_street
    from generator.conditions import kernels as conditions

    splat.load(wp.get_device("cpu"))
    for module in (activation, adam_cpu, photometric_cpu, conditions):
        wp.load_module(module.__name__, device="cpu")
    build_street(frames=1, width=16, height=16).pixels(0)


if __name__ == "__main__":
    compile_all()
