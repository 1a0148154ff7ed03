"""Processes that draw: a Dask cluster's workers, on this machine or on others."""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from typing import Any

from ..base.errors import ConfigError, DeviceError
from .processes import Pool

_PAUSE_S = 2.0


@contextmanager
def dask_processes(address: str, patience_s: float = 60.0) -> Iterator[Pool]:
    """Workers of the Dask scheduler at an address.

    A worker that dies is replaced by others: its tasks are done anew. Start workers of one thread each,
    ``dask worker ADDRESS --nthreads 1 --nworkers N``, with the same glrender installed. Results come back to this
    process: the workers need no common disk.

    Parameters
    ----------
    address : str
        ``tcp://host:8786``
    patience_s : float [s]
        How long to wait for a worker where there is none, at the start and later.

    Raises
    ------
    ConfigError
        `distributed` is not installed, or nothing answers at the address.
    DeviceError
        No worker within the time.
    """
    try:
        from distributed import Client
        from distributed.scheduler import KilledWorker
    except ImportError:
        raise ConfigError("--dask", "needs distributed", hint="pip install 'glrender[dask]'") from None
    try:
        client = Client(address, timeout=10.0, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ConfigError("--dask", f"no scheduler answers: {error}", address,
                          "start one: `dask scheduler`; it prints its address") from None
    last_seen = time.monotonic()
    death = (f"the Dask scheduler {address} went away, or a task killed several of its workers: was memory short "
             "there?")

    def n_workers() -> int:
        """How many workers there are; raises where the scheduler is gone."""
        try:
            return len(client.nthreads())
        except (OSError, RuntimeError) as error:
            raise DeviceError(f"{death} ({type(error).__name__}); finished work stays: start again") from error

    def watch() -> None:
        """Raise where no worker was seen for too long."""
        nonlocal last_seen
        if n_workers():
            last_seen = time.monotonic()
        elif time.monotonic() - last_seen > patience_s:
            raise DeviceError(f"the Dask scheduler {address} has had no worker for {patience_s:g} s: start one, "
                              f"`dask worker {address} --nthreads 1`; finished work stays")

    kept: dict[int, Any] = {}

    def given(value: Any) -> Any:
        """A value for all tasks, sent once; lost with a worker, the scheduler makes it anew."""
        if id(value) not in kept:
            kept[id(value)] = client.submit(_same, value, pure=False)
        return kept[id(value)]

    try:
        while not n_workers():
            watch()
            time.sleep(0.1)
        executor = client.get_executor(pure=False)
        try:
            yield Pool(executor, n_workers, watch=watch, pause_s=_PAUSE_S, given=given,
                       deaths=(KilledWorker, CancelledError), death=death)
        finally:
            executor.shutdown(wait=False)
    finally:
        client.close(timeout=5.0)


def _same(value: Any) -> Any:
    return value
