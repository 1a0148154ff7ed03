"""Tables on disk: a broken or foreign one is made again, one process of several makes it, and none is needed."""

from __future__ import annotations

import time
from multiprocessing import get_context

import numpy as np
from glrender.base.disk_cache import cached_arrays, cached_bytes


def test_a_table_of_another_size_is_made_again_and_kept(tmp_path, monkeypatch, caplog):
    """Loops look at no bounds; nothing else is left in the folder, nor where what is there can't be replaced."""
    monkeypatch.setenv("GLRENDER_CACHE", str(tmp_path))
    right, n_made = np.arange(6, dtype=np.uint8).reshape(2, 3), 0

    def make():
        nonlocal n_made
        n_made += 1
        return right

    for wrong in (right[:1], right.astype(np.int16), b"", b"PK", None):
        if isinstance(wrong, bytes):
            (tmp_path / "some.npz").write_bytes(wrong)
        elif wrong is not None:
            np.savez(tmp_path / "some.npz", table=wrong)
        # As a process leaves it that was killed.
        (tmp_path / "some.part.npz").write_bytes(b"half")
        np.testing.assert_array_equal(cached_bytes("some", (2, 3), make), right)
        (tmp_path / "some.part.npz").unlink(missing_ok=True)
    np.save(tmp_path / "some.npy", right)
    (tmp_path / "some.npy").replace(tmp_path / "some.npz")
    np.testing.assert_array_equal(cached_bytes("some", (2, 3), make), right)
    assert n_made == 5 and [file.name for file in tmp_path.iterdir()] == ["some.npz"]
    (tmp_path / "other.npz").mkdir()
    np.testing.assert_array_equal(cached_bytes("other", (2, 3), make), right)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["other.npz", "some.npz"]
    assert "other is not kept" in caplog.text


def _cache(folder, log, barrier):
    def make():
        with open(log, "a") as stream:
            stream.write("made\n")
        time.sleep(0.5)
        return {"a": np.arange(3)}

    barrier.wait()
    assert cached_arrays("some", ["a"], make, folder)["a"].tolist() == [0, 1, 2]


def test_of_processes_that_start_together_one_makes_what_is_kept(tmp_path):
    """Two workers of a server on an empty cache do not both take minutes on two cores."""
    spawn = get_context("spawn")
    barrier = spawn.Barrier(3)
    processes = [spawn.Process(target=_cache, args=(tmp_path / "cache", tmp_path / "log", barrier)) for _ in range(3)]
    for process in processes:
        process.start()
    for process in processes:
        process.join(60.0)
    assert [process.exitcode for process in processes] == [0, 0, 0]
    assert (tmp_path / "log").read_text() == "made\n"
    assert [file.name for file in (tmp_path / "cache").iterdir()] == ["some.npz"], "no lock is left"
