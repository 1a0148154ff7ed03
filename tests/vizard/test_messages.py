"""The reader of Basilisk's messages: what a real Basilisk recorded, and what nobody should send."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import vizard_peer as peer
from glrender import ProtocolError
from glrender_vizard import messages, recorded, wire
from glrender_vizard.messages import read_update
from hypothesis import given, settings
from hypothesis import strategies as st

# Basilisk 2.12.1: tests/support/basilisk_flight.py with "save", a custom model and no mode, 10 steps of 1 s.
RECORDING = Path(__file__).parents[1] / "data" / "basilisk_UnityViz.bin"
GOLDEN = list(recorded.messages(RECORDING))


def test_what_basilisk_recorded_is_read():
    """Names, places, the Sun, the camera that its module was told to be, and settings in the first message alone."""
    first, *rest = [read_update(data) for data in GOLDEN]
    assert [update.t_ns for update in (first, *rest)] == [k * 10**9 for k in range(1, 11)]
    assert [body.name for body in first.bodies] == ["bennu", "sun"]
    assert first.bodies[0].radius_m == pytest.approx(282.4) and first.bodies[0].polar_ratio == 1.0
    np.testing.assert_allclose(np.linalg.norm(first.bodies[1].r_inertial_m[:2]), 1.5e11)
    (camera,) = first.cameras
    assert (camera.id, camera.parent, camera.width_px, camera.height_px) == (1, "bskSat", 128, 128)
    assert camera.fov_deg == pytest.approx(30.0) and camera.r_camera_body_m == (0.0, 0.2, 2.2)
    assert [camera.is_due(update.t_ns) for update in (first, *rest)] == [False] * 9 + [True]
    (model,) = first.models
    assert (model.path, model.bodies, model.scale) == ("/data/shapes/bennu.obj", ("bennu",), (1.0, 1.0, 1.0))
    assert all(update.models is None for update in rest) and not first.is_last


def test_unknown_fields_are_skipped():
    """Of every wire type, also in messages inside."""
    more = peer.record(99, b"x" * 300) + peer.double(98, 2.5) + peer.whole(97, 7) + peer.varint(96 << 3 | 5) + b"1234"
    body = peer.record(2, more + peer.text(1, "a") + more + peer.doubles(2, (1.0, 2.0, 3.0)) + more)
    update = read_update(more + body + more)
    assert update.bodies[0].name == "a" and update.bodies[0].r_inertial_m == (1.0, 2.0, 3.0)


def test_lists_may_be_packed_or_not():
    loose = b"".join(peer.varint(2 << 3 | 1) + np.float64(value).tobytes() for value in (1.0, 2.0, 3.0))
    assert read_update(peer.record(2, loose)).bodies[0].r_inertial_m == (1.0, 2.0, 3.0)
    sides = peer.varint(4 << 3) + peer.varint(640) + peer.varint(4 << 3) + peer.varint(480)
    assert read_update(peer.record(4, sides)).cameras[0].width_px == 640


@pytest.mark.parametrize("data", [
    b"\x08", b"\x0a\x05abc", b"\x0b", b"\xff" * 11, peer.record(2, peer.text(1, "a")[:-1]),
    peer.record(2, peer.record(1, b"\xff\xfe")), peer.record(2, peer.doubles(2, (1.0, 2.0))),
    peer.record(2, peer.doubles(2, (1.0, 2.0, np.nan))), peer.record(2, peer.record(2, b"1234")),
    peer.record(2, peer.whole(1, 7)), peer.record(4, peer.doubles(8, (np.inf, 0.0, 0.0))),
    peer.whole(2, 3), peer.record(1, peer.double(2, 1e305)), b"\x0a\xff\xff\xff\xff\xff\xff\xff\xff\x7f"], ids=str)
def test_what_is_no_message_is_refused(data):
    with pytest.raises(ProtocolError):
        read_update(data)


def test_fields_are_counted():
    """A megabyte of empty messages takes a bounded time."""
    with pytest.raises(ProtocolError, match="at most 60000 fields"):
        read_update(peer.record(1, b"") * 70_000)
    with pytest.raises(ProtocolError, match="at most 60000 fields"):
        read_update(peer.record(2, peer.doubles(2, [0.0] * 70_000)))


@pytest.mark.parametrize("field, most", [(2, 65), (4, 64), (3, 10_000)], ids=["bodies", "cameras", "spacecraft"])
def test_more_than_a_scene_may_have_is_refused_as_it_is_read(field, most):
    read_update(peer.record(field, b"") * most)
    with pytest.raises(ProtocolError, match=f"must be at most {most}"):
        read_update(peer.record(field, b"") * (most + 1))
    with pytest.raises(ProtocolError, match="must be at most 1024"):
        read_update(peer.record(7, peer.record(12, b"") * 1025))


@pytest.mark.parametrize("name", ["x" * 129, "é" * 129, "\U0001f680" * 129, "x" * 4_000_000])
def test_a_name_is_no_longer_than_the_servers(name):
    read_update(peer.record(2, peer.text(1, name[:128])) + peer.record(3, peer.text(1, name[:128])))
    for data in (peer.record(2, peer.text(1, name)), peer.record(3, peer.text(1, name)),
                 peer.record(4, peer.text(2, name))):
        with pytest.raises(ProtocolError, match="must have at most 128 characters") as caught:
            read_update(data)
        assert len(str(caught.value)) < 300


@settings(max_examples=400, deadline=None)
@given(data=st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(data):
    _read_or_refused(data)


@settings(max_examples=400, deadline=None)
@given(message=st.sampled_from(GOLDEN), changes=st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)),
                                                        min_size=1, max_size=8), cut=st.integers(0, 1000))
def test_golden_messages_with_other_bytes_are_read_or_refused(message, changes, cut):
    data = bytearray(message)
    for place, value in changes:
        data[place % len(data)] = value
    _read_or_refused(bytes(data[:len(data) - cut % len(data)] if cut > 500 else data))


def _read_or_refused(data):
    try:
        update = read_update(data)
    except ProtocolError:
        return
    assert isinstance(update, messages.Update)
    assert all(np.isfinite(body.r_inertial_m).all() and len(body.r_inertial_m) == 3 for body in update.bodies)


@settings(max_examples=60, deadline=None)
@given(numbers=st.lists(st.integers(-2**63, 2**63 - 1), max_size=20),
       floats=st.lists(st.floats(allow_nan=False), max_size=20), words=st.lists(st.text(max_size=20), max_size=5))
def test_what_is_written_is_read(numbers, floats, words):
    """By the tests' writer, which shares no line with the reader."""
    schema = {1: ("numbers", "ints"), 2: ("floats", "doubles"), 3: ("words", wire.Many(wire.Text(20), 5)),
              4: ("inner", wire.Many({1: ("n", "int")}, 20))}
    data = (peer.record(1, b"".join(map(peer.varint, numbers))) + peer.doubles(2, floats)
            + b"".join(peer.text(3, word) for word in words)
            + b"".join(peer.record(4, peer.whole(1, number)) for number in numbers))
    found = wire.read(data, schema)
    assert (found["numbers"], found["floats"], found["words"]) == (numbers, floats, words)
    assert [each.get("n", 0) for each in found["inner"]] == numbers


def test_a_recording_that_is_cut_off_gives_what_is_whole(tmp_path):
    """And then says where it ends."""
    (tmp_path / "cut.bin").write_bytes(RECORDING.read_bytes()[:-1])
    reading, whole = recorded.messages(tmp_path / "cut.bin"), []
    with pytest.raises(ProtocolError, match=r"cut\.bin: byte 4924: the last message is cut off"):
        for message in reading:
            whole.append(message)
    assert whole == GOLDEN[:-1]
    for wrong in (b"\xff" * 20, peer.varint(1 << 30)):
        (tmp_path / "wrong.bin").write_bytes(wrong)
        with pytest.raises(ProtocolError, match="byte 0"):
            list(recorded.messages(tmp_path / "wrong.bin"))
