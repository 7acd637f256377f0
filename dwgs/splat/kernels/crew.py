# type: ignore  (Warp's language, which is not Python's)
"""Several CPU threads inside one launch of one kernel, phase by phase, without Python between.

Every thread of a crew launches the same kernel. The first to arrive is the boss: it opens one phase after the
other. In an open phase everybody takes items, one at a time, until none is left; the boss waits for those still
at work before it opens the next. A thread that comes late joins in where the crew is, one that comes too late
finds nothing to do: nobody is waited for before it has taken an item.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

LINE = 16
"""Integers of a cache line; counters that several threads change have one each."""
PHASES = 4
"""At most."""
SIZE = LINE * (2 + 3 * PHASES)
"""Integers that a crew needs, zero at first: phases opened, arrivals; of each phase items, taken, finished."""

_PAUSE = """
    auto pause = [] {
        #if defined(__x86_64__)
        __builtin_ia32_pause();
        #endif
    };
"""
_COUNTERS = f"""
    int* const opened = crew.data;
    int* const items = crew.data + {LINE} * (2 + 3 * phase);
    int *const taken = items + {LINE}, *const finished = taken + {LINE};
{_PAUSE}
"""


@wp.func_native(f"return __atomic_fetch_add(crew.data + {LINE}, 1, __ATOMIC_RELAXED) == 0;")
def is_boss(crew: wp.array(dtype=int)) -> bool:
    """Whether this thread is the first; asked once."""


@wp.func_native(f"""
    {_COUNTERS}
    if (boss) {{
        *items = count;
        __atomic_store_n(opened, phase + 1, __ATOMIC_RELEASE);
    }} else {{
        while (__atomic_load_n(opened, __ATOMIC_ACQUIRE) <= phase) pause();
    }}
""")
def open_phase(crew: wp.array(dtype=int), phase: int, boss: bool, count: int):
    """Begin a phase of ``count`` items, of which only the boss need know."""


@wp.func_native(f"""
    {_COUNTERS}
    if (item >= 0) __atomic_fetch_add(finished, 1, __ATOMIC_RELEASE);
    const int next = __atomic_fetch_add(taken, 1, __ATOMIC_RELAXED);
    return next < *items ? next : -1;
""")
def take(crew: wp.array(dtype=int), phase: int, item: int) -> int:
    """The next item, -1 where none is left; ``item`` is the one just finished, -1 at first."""


@wp.func_native(f"""
    {_COUNTERS}
    while (boss && __atomic_load_n(finished, __ATOMIC_ACQUIRE) < *items) pause();
""")
def close_phase(crew: wp.array(dtype=int), phase: int, boss: bool):
    """Whatever the crew did in the phase is there for the boss to see."""


@wp.func_native(f"""
    {_PAUSE}
    if (boss) __atomic_store_n(crew.data, {PHASES} + 1, __ATOMIC_RELEASE);
    else while (__atomic_load_n(crew.data, __ATOMIC_ACQUIRE) <= {PHASES}) pause();
""")
def dismiss(crew: wp.array(dtype=int), boss: bool):
    """The end for everybody; what a late thread finds."""
