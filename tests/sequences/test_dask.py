"""A real Dask cluster draws a data set: worker processes, one of them killed midway; the bytes are those of one."""

from __future__ import annotations

import os
import signal
from contextlib import contextmanager

import pytest
import serving
import views
from glrender import ConfigError, DeviceError, load_scene
from glrender.sequences.dask_processes import dask_processes
from glrender.sequences.dataset import drawing
from glrender.sequences.dataset.dataset import DataSet
from glrender.sequences.options import FrameOptions
from missing import needed_module

SECONDS = 240
STATES = [views.state(phase_deg=20.0 + 8.0 * k, range_m=1000.0 + 50.0 * k) for k in range(12)]


@contextmanager
def within(seconds):
    """What takes longer fails: nothing here may hang."""
    def late(*_):
        raise TimeoutError(f"not done within {seconds} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def shards(made):
    return {made.path(number).name: made.path(number).read_bytes() for number in made.numbers()}


@pytest.fixture(scope="module")
def distributed():
    return needed_module("distributed", "pip install distributed")


def test_a_worker_that_is_killed_costs_nothing(distributed, tmp_path):
    (tmp_path / "scene.toml").write_text(serving.SCENE)
    scene = load_scene(tmp_path / "scene.toml")
    options = FrameOptions(camera="navcam", output="dn", format="npz", seed=7, limb_points=16)
    whole, made = (DataSet(scene=scene, states=STATES, folder=tmp_path / name, options=options, frames_a_shard=1)
                   for name in ("whole", "dask"))
    list(whole.draw(1))
    with within(SECONDS), distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True,
                                                   dashboard_address=None) as cluster:
        pids = [worker.process.pid for worker in cluster.workers.values()]
        done = []
        for number in made.draw(pool=dask_processes(cluster.scheduler_address)):
            done.append(number)
            if len(done) == 2:
                os.kill(pids[0], signal.SIGKILL)
        assert pids[0] not in [worker.process.pid for worker in cluster.workers.values() if worker.process]
    assert sorted(done) == list(range(12))
    assert shards(made) == shards(whole)
    assert made.throughput()["n_frames"] == 12


@pytest.mark.slow
def test_a_scheduler_that_goes_away_is_told(distributed, tmp_path):
    (tmp_path / "scene.toml").write_text(serving.SCENE)
    made = DataSet(scene=load_scene(tmp_path / "scene.toml"), states=STATES * 20, folder=tmp_path / "out",
                   options=FrameOptions(camera="navcam", output="dn", format="npz"), frames_a_shard=2)
    with within(SECONDS):
        cluster = distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None)
        drawing = made.draw(pool=dask_processes(cluster.scheduler_address))
        next(drawing)
        cluster.close()
        with pytest.raises(DeviceError, match="went away.*finished work stays: start again"):
            list(drawing)
    assert 0 < len(made.missing()) < 120


@pytest.mark.slow
def test_no_scheduler_or_no_worker_is_told(distributed):
    with within(60):
        with pytest.raises(ConfigError, match="--dask: no scheduler answers.*dask scheduler"):
            with dask_processes("tcp://127.0.0.1:9"):
                pass
        with distributed.LocalCluster(n_workers=0, dashboard_address=None) as cluster:
            with pytest.raises(DeviceError, match="has had no worker for 1 s.*--nthreads 1"):
                with dask_processes(cluster.scheduler_address, patience_s=1.0):
                    pass


def test_workers_of_another_version_are_refused(tmp_path):
    (tmp_path / "scene.toml").write_text(serving.SCENE)
    setup = drawing.Setup(scene=load_scene(tmp_path / "scene.toml"), options=FrameOptions(camera="navcam"),
                          format="webdataset", version="0.0.1")
    with pytest.raises(ConfigError, match="a worker has glrender .*, not 0.0.1"):
        drawing.draw_elsewhere(setup, 0, [])
