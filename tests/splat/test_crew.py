# type: ignore  (Warp's language, which is not Python's)
"""A crew does every item of every phase once, in order of the phases, whoever comes, and whenever."""

import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import warp as wp

from dwgs.splat import crew
from dwgs.splat.kernels.crew import close_phase, is_leader, open_phase, take


@wp.kernel
def count_up(counters: wp.array(dtype=int), firsts: wp.array(dtype=int), sums: wp.array(dtype=int)):
    """Add one to every number of the first array, then to each of the second all of the first."""
    leads = is_leader(counters)
    open_phase(counters, 0, leads, firsts.shape[0])
    item = take(counters, 0, leads, -1)
    while item >= 0:
        firsts[item] = firsts[item] + 1
        item = take(counters, 0, leads, item)
    close_phase(counters, 0, leads)

    open_phase(counters, 1, leads, sums.shape[0])
    item = take(counters, 1, leads, -1)
    while item >= 0:
        for k in range(firsts.shape[0]):
            sums[item] = sums[item] + firsts[k]
        item = take(counters, 1, leads, item)
    close_phase(counters, 1, leads)


class Counted:
    def __init__(self, threads: int) -> None:
        self.firsts, self.sums = np.zeros(300, np.int32), np.zeros(200, np.int32)
        arrays = [wp.array(array, device="cpu", copy=False) for array in (self.firsts, self.sums)]
        self.run, self.runs = crew.pack(count_up, arrays, threads), 0

    def go(self, runs: int) -> None:
        for _ in range(runs):
            self.run()
            self.runs += 1
            assert (self.firsts == self.runs).all()
            assert (self.sums == 300 * self.runs * (self.runs + 1) // 2).all()


@pytest.fixture(autouse=True)
def many_cores(monkeypatch) -> None:
    monkeypatch.setattr(crew, "CORES", 4)


@pytest.mark.parametrize("threads", [1, 2, 4])
def test_every_item_is_done_once_in_every_run(threads):
    Counted(threads).go(2_000)


def test_helpers_that_have_gone_home_come_again():
    counted = Counted(2)
    for _ in range(20):
        counted.go(5)
        time.sleep(0.01)


def test_nobody_waits_for_a_helper_that_does_not_come(monkeypatch):
    monkeypatch.setattr(crew._desk, "call", lambda helpers: None)
    time.sleep(0.01)
    Counted(3).go(10)


def test_several_lead_at_the_same_time():
    alone = Counted(2)
    alone.go(1)  # loads the kernel
    with ThreadPoolExecutor(4) as pool:
        for done in [pool.submit(counted.go, 500) for counted in (Counted(threads) for threads in (1, 2, 2, 3))]:
            done.result()


def test_the_interpreter_ends_while_helpers_look_out():
    script = (
        "import torch; from dwgs.splat import *;"
        "splats = Splats(*(torch.ones(99, *shape) for shape in ((3,), (4,), (3,), (), (1, 3))));"
        "[render(splats, View(torch.eye(4), (9.0, 9.0, 8.0, 8.0), 16, 16), threads=2) for _ in range(50)]"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
