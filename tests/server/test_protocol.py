"""The golden messages of docs/protocol.md, read by the server's code and by the client's."""

from __future__ import annotations

import json
import time
from pathlib import Path

import make_golden
import msgpack
import numpy as np
import pytest
from glrender import ProtocolError
from glrender_camera.compression import decode
from glrender_client import Client, ServerError, shared
from glrender_client.wire import Packer, frames_fields, read_header, read_reply, render_fields
from glrender_server import codec, framing, pixels

GOLDEN = {name: [bytes.fromhex(part) for part in parts] for name, parts in json.loads(
    (Path(__file__).parents[1] / "data" / "golden.json").read_text(encoding="ascii")).items()}


def test_the_server_still_writes_the_golden_messages():
    assert {name: [part.hex() for part in parts] for name, parts in GOLDEN.items()} == make_golden.golden()


@pytest.mark.parametrize("name", make_golden.REQUESTS)
def test_the_server_reads_the_golden_requests(name):
    assert codec.unpack_request(GOLDEN[f"request_{name}"]) == make_golden.REQUESTS[name]


@pytest.mark.parametrize("order", ["C", "F"])
def test_the_client_reads_the_golden_frames(order):
    parts = GOLDEN[f"reply_frame_{order}"]

    arrays = read_reply(read_header(parts[0]), parts).arrays
    np.testing.assert_array_equal(arrays["image"], make_golden.IMAGE)
    np.testing.assert_array_equal(arrays["range"], make_golden.RANGE)
    assert arrays["image"].dtype == np.uint16


def test_the_client_reads_the_golden_frame_in_shared_memory(monkeypatch, tmp_path):
    monkeypatch.setattr(shared, "_FOLDER", tmp_path)
    header, frames = read_header(GOLDEN["reply_shared"][0]), shared.SharedFrames()
    assert header["shared"] == make_golden.PLACE
    with pytest.raises(shared.NotShared):
        frames.parts(header["shared"])
    (tmp_path / header["shared"]["name"]).write_bytes(GOLDEN["slot_shared"][0])
    arrays = read_reply(header, [b"", *frames.parts(header["shared"])]).arrays
    np.testing.assert_array_equal(arrays["image"], make_golden.IMAGE)
    np.testing.assert_array_equal(arrays["range"], make_golden.RANGE)
    with pytest.raises(shared.NotShared, match="another frame"):
        frames.parts({**header["shared"], "number": 301})


def test_the_client_writes_the_golden_request_for_shared_memory(monkeypatch):
    asked = []
    golden = make_golden.REQUESTS["shared"]
    fields = {name: value for name, value in golden.items() if name not in (*make_golden.ENVELOPE, "op", "shared")}
    with Client("ipc:///nowhere") as client:
        monkeypatch.setattr(client, "_ask", lambda op, fields: asked.append(Packer()(op, fields)[1]))
        client.render(**fields)
    (header,) = map(msgpack.unpackb, asked)
    assert header == {**golden, "id": 1, "client": header["client"]}


@pytest.mark.parametrize("order", ["C", "F"])
def test_the_client_reads_the_golden_frames_of_two_cameras(order):
    parts = GOLDEN[f"reply_frames_{order}"]

    reply = read_reply(read_header(parts[0]), parts)
    first, second = reply.frames
    assert reply.arrays == {} and (first.header["camera"], second.header["camera"]) == ("navcam", "wac")
    assert second.header["roi"] == [8, 4, 11, 6] and second.header["t_s"] == 12.5
    np.testing.assert_array_equal(first.arrays["image"], make_golden.IMAGE)
    np.testing.assert_array_equal(first.arrays["range"], make_golden.RANGE)
    np.testing.assert_array_equal(second.arrays["image"], make_golden.REGION)
    assert second.arrays.keys() == {"image"} and second.pixels.dtype == np.float32


def test_the_client_reads_the_golden_region_and_writes_its_request():
    parts = GOLDEN["reply_region"]

    np.testing.assert_array_equal(read_reply(read_header(parts[0]), parts).pixels, make_golden.REGION)
    fields = {name: value for name, value in make_golden.REQUESTS["region"].items()
              if name not in make_golden.ENVELOPE | {"op": ""}}
    header = msgpack.unpackb(Packer()("render", render_fields(**fields))[1])
    assert header == {**make_golden.REQUESTS["region"], "order": "C", "id": 1, "client": header["client"]}


def test_the_client_reads_the_golden_stream_and_writes_its_request():
    """Which `decode` reads by the header's fields, and no picture is made of."""
    parts = GOLDEN["reply_compressed"]
    reply = read_reply(read_header(parts[0]), parts)
    told = {name: reply.header[name] for name in ("codec", "shape", "bit_depth")}
    np.testing.assert_array_equal(decode(reply.pixels, **told), make_golden.IMAGE)
    assert reply.pixels.tobytes() == make_golden.STREAM and reply._repr_png_() is None
    assert f": {len(make_golden.STREAM)} uint8 [byte]," in repr(reply)
    fields = {name: value for name, value in make_golden.REQUESTS["compressed"].items()
              if name not in make_golden.ENVELOPE | {"op": ""}}
    header = msgpack.unpackb(Packer()("render", render_fields(**fields))[1])
    assert header == {**make_golden.REQUESTS["compressed"], "id": 1, "client": header["client"]}


def test_the_client_reads_the_golden_comparison_and_writes_its_request():
    parts, golden = GOLDEN["reply_compared"], make_golden.REQUESTS["compare"]
    found, told = read_reply(read_header(parts[0]), parts).comparison, make_golden.COMPARED_REPLY["comparison"]
    assert found.names == ("law.normal_albedo", "gain") and (found.chi2, found.gain) == (7.25, 1.03125)
    assert found.matrix.tolist() == told["matrix"] and found.vector.tolist() == told["vector"]
    header = msgpack.unpackb(Packer()("render", render_fields(
        golden["state"], "navcam", exposure_s=0.1, order="F", derivatives=["spacecraft"], unknown=["gain"], robust=True,
        blur_px=1.5, compare=np.arange(6, dtype=np.uint16).reshape(2, 3)))[1])
    assert header == {**golden, "id": 1, "client": header["client"]}


def test_the_client_reads_the_golden_warnings():
    parts = GOLDEN["reply_warned"]
    reply = read_reply(read_header(parts[0]), parts)
    assert [told._asdict() for told in reply.warnings] == make_golden.WARNED_REPLY["warnings"]
    assert str(reply.warnings[0]) == "body is behind the camera"
    np.testing.assert_array_equal(reply.pixels, make_golden.REGION)
    parts = GOLDEN["reply_region"]  # of a server before there were any
    assert read_reply(read_header(parts[0]), parts).warnings == ()


def test_the_client_writes_the_golden_request_for_two_cameras():
    golden = make_golden.REQUESTS["frames"]
    header = msgpack.unpackb(Packer()("render", frames_fields(golden["state"], golden["frames"], golden["order"]))[1])
    assert header == {**golden, "id": 1, "client": header["client"]}


def test_the_client_reads_the_golden_error_and_writes_the_golden_request():
    parts = GOLDEN["reply_error"]
    with pytest.raises(ServerError) as caught:
        read_reply(read_header(parts[0]), parts)
    assert (caught.value.code, caught.value.path) == ("config", "state.gamma")
    fields = dict(make_golden.REQUESTS["render"])
    for name in make_golden.ENVELOPE | {"op": ""}:
        del fields[name]
    header = msgpack.unpackb(Packer()("render", render_fields(**fields))[1])
    assert header == {**make_golden.REQUESTS["render"], "id": 1, "client": header["client"]}


@pytest.mark.parametrize("name", ["request_render", "reply_frame_F", "request_frames", "reply_frames_F"])
def test_a_message_on_tcp_is_the_parts_behind_their_sizes(name):
    (stream,), parts = GOLDEN[f"tcp_{name}"], GOLDEN[name]
    sizes = np.array([len(part) for part in parts], "<u4").tobytes()
    assert stream == b"GLR1" + bytes([len(parts), 0, 0, 0]) + sizes + b"".join(parts)
    decoder = framing.Decoder()
    decoder.feed(stream)
    assert list(decoder.messages()) == [parts]


def test_column_major_bytes_are_what_matlab_reshapes():
    """MATLAB's reshape(bytes, [height width]) fills columns first."""
    part = GOLDEN["reply_frame_F"][1]
    np.testing.assert_array_equal(np.frombuffer(part, "<u2"), make_golden.IMAGE.T.ravel())


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "int32", "float32", "float64"])
@pytest.mark.parametrize("shape", [(7,), (1, 1), (5, 3), (64, 97), (6, 4, 3), (1, 9, 3)])
def test_both_orders_carry_the_same_array(rng, shape, dtype):
    array = (100.0 * rng.random(shape)).astype(dtype)
    for order in ("C", "F"):
        parts = pixels.pack({}, {"x": (array, "1"), "view": (np.repeat(array, 2, axis=0)[::2], "1")}, order)
        for part in parts[1:]:
            assert bytes(part) == array.tobytes(order)


@pytest.mark.parametrize("parts, message", [
    ([], "one part"), ([b"a", b"b"], "one part"), ([b""], "not msgpack"), ([b"\xc1"], "not msgpack"),
    ([b"\x91\x91\x91"], "not msgpack"), ([b"\x01"], "must be a map"), ([b"\x81\x01\x02"], "not msgpack"),
    ([b"\xdf\xff\xff\xff\xff"], "not msgpack"), ([b"\xdd\x7f\xff\xff\xff" + b"\x00" * 10], "not msgpack"),
    ([b"\x81\xa1a" * 600], "not msgpack"), ([b"\xa1" * (codec.MAX_HEADER_BYTES + 1)], "must not exceed"),
])
def test_hostile_bytes_are_refused_at_once(parts, message):
    with pytest.raises(ProtocolError, match=message):
        codec.unpack_request(parts)


@pytest.mark.parametrize("name", ["hello", "render", "frames", "region"])
def test_the_envelope_holds_the_plain_values(name):
    whole, top = make_golden.REQUESTS[name], codec.unpack_envelope(GOLDEN[f"request_{name}"])
    assert top == {key: [] if isinstance(value, list | dict) else value for key, value in whole.items()}


@pytest.mark.parametrize("message, rule", [
    (b"", "text keys"), (b"\x01", "text keys"), (b"\x91\x91\x91", "text keys"), (b"\x81\x01\x02", "text keys"),
    (b"\x81\x91\xa1a\x02", "text keys"), (b"\xdf\xff\xff\xff\xff", "at most 64 fields"), (b"\x81\xa1a", "not msgpack"),
    (b"\x81\xa1a\xdd\x7f\xff\xff\xff\x00", "not msgpack"), (b"\x81\xa1a\xc7\x01\x01x", "not msgpack"),
    (b"\x81\xa1a" + b"\x91" * 5000 + b"\xc0", "not msgpack"), (b"\x80\x00", "left behind"),
    (b"\x82\xa1a\x01\xa1a\x02", "twice"), (b"\x81\xa1\xff\x01", "not msgpack"),
    (msgpack.packb({str(k): [] for k in range(20_000)}), "at most 64 fields"),
    (b"\xa1" * (codec.MAX_HEADER_BYTES + 1), "must not exceed")])
def test_an_envelope_that_is_none_is_refused(message, rule):
    began = time.process_time()
    with pytest.raises(ProtocolError, match=rule):
        codec.unpack_envelope([message])
    assert time.process_time() - began < 0.05


def test_what_lists_hold_costs_whoever_decodes_it():
    """60 kB of empty lists: some tens of milliseconds to decode, and a hundredth of that to pass over."""
    message = msgpack.packb({"v": 1, "op": "render", "id": 1, "client": "c", "state": [[]] * 59_000})

    def seconds(function):
        times = []
        for _ in range(5):
            began = time.process_time()
            function([message])
            times.append(time.process_time() - began)
        return min(times)

    assert seconds(codec.unpack_envelope) < 0.25 * seconds(codec.unpack_request)


def test_random_envelopes_are_refused_never_crash(rng):
    for size in rng.integers(1, 200, 3000):
        data = b"\x84" + rng.bytes(int(size))
        try:
            top = codec.unpack_envelope([data])
        except ProtocolError:
            continue
        assert isinstance(top, dict) and all(isinstance(key, str) for key in top)


def test_random_bytes_are_refused_never_crash(rng):
    for size in rng.integers(1, 200, 3000):
        data = rng.bytes(int(size))
        try:
            header = codec.unpack_request([data])
        except ProtocolError:
            continue
        assert isinstance(header, dict)


def test_an_array_that_the_protocol_has_no_name_for_is_a_bug():
    with pytest.raises(TypeError, match="complex128"):
        pixels.pack({}, {"image": (np.zeros((2, 2), complex), "1")})
