"""Threads that share the work of one image: each item once, errors raised, and nobody works on afterwards."""

from __future__ import annotations

import threading
import time

import pytest
from glrender_camera import threads


@pytest.mark.parametrize("n_threads", [1, 2, 8])
def test_each_item_is_done_once(n_threads):
    done = []
    threads.run(done.append, range(1000), n_threads)
    assert sorted(done) == list(range(1000))


def test_an_error_is_raised_when_all_that_help_have_ended():
    """What they work on is released then."""
    working, both = [], threading.Barrier(2)

    def work(k: int) -> None:
        both.wait(10.0)
        if k:
            raise RuntimeError("no luck")
        working.append(k)
        time.sleep(0.2)
        working.pop()

    with pytest.raises(RuntimeError, match="no luck"):
        threads.run(work, range(2), 2)
    assert not working


@pytest.mark.parametrize("n_items", [0, 1, 999, 1000, 1001, 5000])
def test_parts_depend_on_the_number_of_items_alone(n_items):
    """So bytes are the same whatever the number of cores: an even number of parts, none larger than was asked for."""
    parts = threads.run_in_parts(lambda part: (part.start, part.stop), n_items, 1000)
    assert parts[0][0] == 0 and parts[-1][1] == n_items
    assert all(one[1] == other[0] for one, other in zip(parts, parts[1:], strict=False))
    assert len(parts) == 1 or len(parts) % 2 == 0
    assert max(stop - start for start, stop in parts) <= 1000
