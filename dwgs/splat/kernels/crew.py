# type: ignore  (Warp's language, which is not Python's)
"""Several CPU threads inside one launch of one kernel, phase by phase, without Python between.

Every thread of a crew runs the same kernel. The first to arrive, its leader, opens one phase after the other. In
an open phase everybody takes items, one at a time, until none is left; the leader waits for those still at work before
it opens the next. The leader takes items from the front, its helpers from the back: what a thread wrote in one phase
it mostly reads itself in the next, out of its own cache. A thread that comes late joins in where the crew is, one that
comes too late finds nothing to do: nobody is waited for before it has taken an item.

Helpers come from the desk. There a leader offers its run; helpers look out for one, for a while, before they go back
to Python. A run ends when no helper is inside any more.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

LINE = 16
"""Integers of a cache line; counters that several threads change have one each."""
PHASES = 4
"""At most."""
SIZE = LINE * (2 + 5 * PHASES)
"""Integers that a crew needs: phases opened, arrivals; of each phase items, taken, finished, from front and back."""
DESK = 5 * LINE // 2
"""Long integers of a desk, zero at first: whether it is taken, the run on offer, seats, helpers inside, looking out."""
WAITING = 4 * LINE // 2
"""Where a desk says how many look out."""
PATIENCE = 4096
"""Looks, some 50 ns each, after which a helper goes home: longer than between the launches of one step of a fit."""

_PAUSE = """
    auto pause = [] {
        #if defined(__x86_64__)
        __builtin_ia32_pause();
        #endif
    };
"""
_COUNTERS = f"""
    int* const opened = crew.data;
    int* const items = crew.data + {LINE} * (2 + 5 * phase);
    int *const taken = items + {LINE}, *const finished = taken + {LINE};
{_PAUSE}
"""


@wp.func_native(f"return __atomic_fetch_add(crew.data + {LINE}, 1, __ATOMIC_RELAXED) == 0;")
def is_leader(crew: wp.array(dtype=int)) -> bool:
    """Whether this thread is the first; asked once."""


@wp.func_native(f"""
    {_COUNTERS}
    if (leads) {{
        *items = count;
        __atomic_store_n(opened, phase + 1, __ATOMIC_RELEASE);
    }} else {{
        while (__atomic_load_n(opened, __ATOMIC_ACQUIRE) <= phase) pause();
    }}
""")
def open_phase(crew: wp.array(dtype=int), phase: int, leads: bool, count: int):
    """Begin a phase of ``count`` items, of which only the leader need know."""


@wp.func_native(f"""
    {_COUNTERS}
    if (item >= 0) __atomic_fetch_add(finished, 1, __ATOMIC_RELEASE);
    const int next = __atomic_fetch_add(taken, 1, __ATOMIC_RELAXED);
    if (next >= *items) return -1;
    int *const from_front = taken + 2 * {LINE}, *const from_back = from_front + {LINE};
    return leads ? (*from_front)++ : *items - 1 - __atomic_fetch_add(from_back, 1, __ATOMIC_RELAXED);
""")
def take(crew: wp.array(dtype=int), phase: int, leads: bool, item: int) -> int:
    """The next item, -1 where none is left; ``item`` is the one just finished, -1 at first."""


@wp.func_native(f"""
    {_COUNTERS}
    while (leads && __atomic_load_n(finished, __ATOMIC_ACQUIRE) < *items) pause();
""")
def close_phase(crew: wp.array(dtype=int), phase: int, leads: bool):
    """Whatever the crew did in the phase is there for the leader to see."""


_DESK = f"""
{_PAUSE}
    long long *const taken = desk.data, *const offer = taken + {LINE // 2}, *const seats = offer + {LINE // 2};
    long long *const inside = seats + {LINE // 2}, *const waiting = inside + {LINE // 2};
    struct Run {{ void (*kernel)(long long bounds, long long arguments); long long bounds, arguments; int* counters;
                 long long helpers; }};
"""


@wp.func_native(f"""
    {_DESK}
    Run* const own = (Run*)run.data;
    for (int k = 0; k < {SIZE}; ++k) own->counters[k] = 0;
    const bool offers = own->helpers > 0 && !__atomic_exchange_n(taken, 1, __ATOMIC_ACQUIRE);
    if (offers) {{
        __atomic_store_n(seats, own->helpers, __ATOMIC_RELAXED);
        __atomic_store_n(offer, (long long)own, __ATOMIC_SEQ_CST);
    }}
    own->kernel(own->bounds, own->arguments);
    if (offers) {{
        __atomic_store_n(offer, 0, __ATOMIC_SEQ_CST);
        while (__atomic_load_n(inside, __ATOMIC_SEQ_CST)) pause();
        __atomic_store_n(taken, 0, __ATOMIC_RELEASE);
    }}
""")
def lead_run(desk: wp.array(dtype=wp.int64), run: wp.array(dtype=wp.int64)):
    """Run, with whoever comes; alone, if another leader has the desk."""


@wp.func_native(f"""
    {_DESK}
    __atomic_fetch_add(waiting, 1, __ATOMIC_RELAXED);
    for (int look = 0; look < {PATIENCE}; ++look, pause()) {{
        if (!__atomic_load_n(offer, __ATOMIC_RELAXED) || __atomic_load_n(seats, __ATOMIC_RELAXED) <= 0) continue;
        __atomic_fetch_add(inside, 1, __ATOMIC_SEQ_CST);
        Run* const open = (Run*)__atomic_load_n(offer, __ATOMIC_SEQ_CST);  // inside: its leader waits for us
        if (open && __atomic_fetch_sub(seats, 1, __ATOMIC_RELAXED) > 0) {{
            while (!__atomic_load_n(open->counters + {LINE}, __ATOMIC_RELAXED)) pause();  // the leader goes first
            open->kernel(open->bounds, open->arguments);
            look = 0;
        }}
        __atomic_fetch_sub(inside, 1, __ATOMIC_SEQ_CST);
    }}
    __atomic_fetch_sub(waiting, 1, __ATOMIC_RELAXED);
""")
def help_runs(desk: wp.array(dtype=wp.int64)):
    """Join every run that comes up, until none has for a while."""


@wp.kernel
def lead(desk: wp.array(dtype=wp.int64), run: wp.array(dtype=wp.int64)):
    """Run a kernel as a crew: where it is, where its bounds, arguments and counters are, and how many may help."""
    lead_run(desk, run)


@wp.kernel
def attend(desk: wp.array(dtype=wp.int64)):
    """Help those who lead, for a while."""
    help_runs(desk)
