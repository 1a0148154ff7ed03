"""Tasks in a forked child, which has a while for its answer."""

from __future__ import annotations

import multiprocessing

LIMIT_S = 60.0
"""A frame takes a second or two."""


def in_child(task, limit_s=LIMIT_S):
    """The result of a task in a forked child; its error, or its silence, fails the test."""
    fork = multiprocessing.get_context("fork")
    ours, theirs = fork.Pipe()

    def answer():
        try:
            theirs.send((True, task()))
        except BaseException as error:
            theirs.send((False, f"{type(error).__name__}: {error}"))

    process = fork.Process(target=answer)
    process.start()
    try:
        assert ours.poll(limit_s), f"no answer within {limit_s} s"
        is_done, answer = ours.recv()
        assert is_done, answer
        return answer
    finally:
        process.kill()
        process.join()
