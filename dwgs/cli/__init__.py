"""The `dwgs` command: one file per verb, heavy imports inside the verbs."""

import errno
import sys
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one verb; exit with 2 and one sentence on bad input, with 130 when interrupted."""
    import tyro

    from dwgs.cli.condition import Condition
    from dwgs.cli.distill import Distill
    from dwgs.cli.evaluate import Evaluate
    from dwgs.cli.generate import Generate
    from dwgs.cli.insert import Insert
    from dwgs.cli.inspect import Inspect
    from dwgs.cli.reconstruct import Reconstruct
    from dwgs.cli.render import Render
    from dwgs.cli.train import Train
    from dwgs.scene import InputError

    verbs = {
        "insert": Insert,
        "reconstruct": Reconstruct,
        "condition": Condition,
        "generate": Generate,
        "distill": Distill,
        "render": Render,
        "evaluate": Evaluate,
        "train": Train,
        "inspect": Inspect,
    }
    verb = tyro.extras.subcommand_cli_from_dict(
        verbs,
        prog="dwgs",
        description="Put a vehicle into a recorded drive, and take it home as 3D Gaussians.",
        args=arguments,
        config=(tyro.conf.OmitArgPrefixes,),
    )
    try:
        verb.run()
    except InputError as error:
        fail(str(error))
    except OSError as error:
        fail(system_sentence(error))
    except KeyboardInterrupt:
        print("dwgs: interrupted; finished stages are kept, and the same command goes on from here", file=sys.stderr)
        sys.exit(130)


def system_sentence(error: OSError) -> str:
    """What the operating system refused, and what is left."""
    is_short_write = error.errno is None and "requested and" in str(error)  # NumPy's, where the disk is full
    if error.errno in (errno.ENOSPC, errno.EDQUOT) or is_short_write:
        return "the disk is full; free some space and run the same command again, finished stages are kept"
    place = f" ({error.filename})" if error.filename else ""
    return f"the system says: {error.strerror or error}{place}; nothing half-written is left behind"


def fail(sentence: str) -> None:
    """Say what is wrong and leave."""
    print(f"dwgs: {sentence}", file=sys.stderr)
    sys.exit(2)
