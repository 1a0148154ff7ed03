"""Tables on disk: a broken or foreign one is made again, and none is needed."""

from __future__ import annotations

import numpy as np
from glrender.base.disk_cache import cached_bytes


def test_a_table_of_another_size_is_made_again_and_kept(tmp_path, monkeypatch, caplog):
    """Loops look at no bounds; nothing else is left in the folder, nor where what is there can't be replaced."""
    monkeypatch.setenv("GLRENDER_CACHE", str(tmp_path))
    right, n_made = np.arange(6, dtype=np.uint8).reshape(2, 3), 0

    def make():
        nonlocal n_made
        n_made += 1
        return right

    for wrong in (right[:1], right.astype(np.int16), b"", b"\x93NUMPY", None):
        if isinstance(wrong, bytes):
            (tmp_path / "some.npy").write_bytes(wrong)
        elif wrong is not None:
            np.save(tmp_path / "some.npy", wrong)
        np.testing.assert_array_equal(cached_bytes("some", (2, 3), make), right)
    assert n_made == 4 and [file.name for file in tmp_path.iterdir()] == ["some.npy"]
    (tmp_path / "other.npy").mkdir()
    np.testing.assert_array_equal(cached_bytes("other", (2, 3), make), right)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["other.npy", "some.npy"]
    assert "other is not kept" in caplog.text
