"""What is done in spare time: last, alone, at the least priority, and ended when it is told to."""

from __future__ import annotations

import os
import sys
import threading
import time

import pytest
from glrender_camera import threads

_SOON_S, _LATE_S = 0.01, 10.0


@pytest.fixture
def spare():
    made = threads.SpareTime(_SOON_S)
    yield made
    made.close()


def test_only_the_last_task_is_done_and_after_a_pause(spare):
    done, is_done = [], threading.Event()
    begin_s = time.perf_counter()
    for k in range(5):
        spare.give(lambda k=k: (done.append((k, time.perf_counter() - begin_s)), is_done.set()))
    assert is_done.wait(_LATE_S)
    (number, after_s), = done
    assert number == 4 and after_s >= _SOON_S


def test_what_is_done_goes_on_while_others_wait(spare):
    is_begun, may_end, done = threading.Event(), threading.Event(), []

    def long() -> None:
        is_begun.set()
        may_end.wait(_LATE_S)
        threads.run(lambda k: done.append("long"), range(1))

    spare.give(long)
    assert is_begun.wait(_LATE_S)
    is_done = threading.Event()
    spare.give(is_done.set)
    may_end.set()
    assert is_done.wait(_LATE_S) and done == ["long"]


def test_a_task_ends_between_two_items_when_it_is_told_to(spare):
    is_begun, n_done, is_next = threading.Event(), [], threading.Event()

    def work(_k: int) -> None:
        n_done.append(None)
        is_begun.set()
        time.sleep(0.001)

    spare.give(lambda: threads.run(work, range(100_000), 2))
    assert is_begun.wait(_LATE_S)
    spare.stop()
    spare.give(is_next.set)
    assert is_next.wait(_LATE_S) and len(n_done) < 1000
    # Of what waits nothing is begun.
    spare.give(lambda: n_done.append("waited"))
    spare.stop()
    spare.close()
    assert "waited" not in n_done


def test_its_end_is_waited_for_with_all_that_help(spare):
    """Also where another gives up first: what they work on is released then."""
    left, is_begun = [], threading.Event()

    def work(k: int) -> None:
        if not threading.current_thread().name.startswith("glrender-spare"):
            left.append(k)
            is_begun.set()
            time.sleep(0.3)
            left.pop()
        else:
            time.sleep(0.01)

    spare.give(lambda: threads.run(work, range(1000), 4))
    assert is_begun.wait(_LATE_S)
    spare.close()
    assert not left
    spare.give(lambda: left.append("after"))
    time.sleep(5.0 * _SOON_S)
    assert not left


def test_an_error_is_nobodys(spare):
    is_done = threading.Event()

    def fails() -> None:
        raise RuntimeError

    spare.give(fails)
    time.sleep(5.0 * _SOON_S)
    spare.give(is_done.set)
    assert is_done.wait(_LATE_S)


@pytest.mark.skipif(sys.platform != "linux", reason="threads have no priority of their own")
def test_all_its_threads_have_the_least_priority_and_no_others(spare):
    found, is_done = [], threading.Event()

    def nice(_k: int = 0) -> None:
        found.append(os.getpriority(os.PRIO_PROCESS, threading.get_native_id()))
        time.sleep(0.02)

    def task() -> None:
        nice()
        threads.run(nice, range(4), 2)
        is_done.set()

    before = os.getpriority(os.PRIO_PROCESS, threading.get_native_id())
    spare.give(task)
    assert is_done.wait(_LATE_S) and found == [19] * 5
    found.clear()
    threads.run(nice, range(4), 2)
    assert found == [before] * 4 and before < 19
