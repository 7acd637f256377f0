"""What a person sees while a stage runs."""

from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

console = Console(stderr=True)


class Bar:
    """One line of progress: a stage that counts, or a fit that tells events."""

    def __init__(self, progress: Progress, title: str) -> None:
        self._progress = progress
        self._title = title
        self._task = progress.add_task(title, total=None, detail="")

    def count(self, done: int, total: int | None) -> None:
        """Say that ``done`` of ``total`` are done; None is not known yet."""
        self._progress.update(self._task, completed=done, total=total)

    def tell(self, detail: str) -> None:
        """Say something beside the bar."""
        self._progress.update(self._task, detail=detail)

    def follow(self, events: Generator[Any, None, Any]) -> Any:
        """Run a fit to its end, showing its events; gives what the fit returns."""
        from dwgs.optimize import Evaluated, Grown, Preparing, Step

        detail = ""
        while True:
            try:
                event = next(events)
            except StopIteration as end:
                return end.value
            match event:
                case Preparing(what, done, total):
                    self._progress.update(self._task, completed=done, total=total, detail=what)
                case Step(step, steps, loss):
                    text = f"{detail} loss {loss:.4f}"
                    self._progress.update(self._task, completed=step, total=steps, detail=text)
                case Evaluated(_, psnr):
                    detail = f"{psnr:.2f} dB"
                case Grown(_, count):
                    detail = f"{count:,} Gaussians"


@contextmanager
def bar(title: str):
    """A line of progress that stays when it is done."""
    columns = (
        TextColumn("{task.description:<12}"),
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("[dim]{task.fields[detail]}"),
    )
    with Progress(*columns, console=console) as progress:
        yield Bar(progress, title)


def say(line: str) -> None:
    """One line for the person."""
    console.print(line, highlight=False, soft_wrap=True)


def decibels(psnr: float | None) -> str:
    """A PSNR for people; a clip too short to hold a frame out has none."""
    return "not measured (no frame held out)" if psnr is None else f"{psnr:.2f} dB"


OnProgress = Callable[[int, int], None]
