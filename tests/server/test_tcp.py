"""Framed TCP against a live server: the same replies as ZeroMQ, and what a stream can do wrong is survived."""

from __future__ import annotations

import os
import select
import signal
import socket
import struct
import time

import msgpack
import numpy as np
import pytest
import serving
import views
import zmq
from glrender import ProtocolError
from glrender_client import Client
from glrender_server import framing, tcp_front
from serving import Framed

STATE = views.state().to_dict()


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    with serving.server(tmp_path_factory.mktemp("tcp"), "--tcp", "127.0.0.1:0") as (endpoint, process):
        yield endpoint, serving.tcp_address(process), process


@pytest.fixture
def address(live):
    return live[1]


def request(**changes):
    header = {"v": 1, "op": "render", "id": 1, "client": "framed", "state": STATE, "camera": "navcam", **changes}
    return msgpack.packb({key: value for key, value in header.items() if value is not ...})


def hello(number=1):
    return request(op="hello", id=number, state=..., camera=...)


def serves_on(address):
    with Framed(address) as good:
        return msgpack.unpackb(good.ask(hello())[0])["ok"]


@pytest.mark.parametrize("order", ["C", "F"])
def test_both_transports_carry_the_same_bytes(live, order):
    endpoint, address, _ = live
    with Client(endpoint) as client, Framed(address) as framed:
        theirs = client.render(STATE, "navcam", output="dn", seed=3, products=["range", "body_id"], order=order)
        header, *pixels = framed.ask(request(output="dn", seed=3, products=["range", "body_id"], order=order))
    arrays = msgpack.unpackb(header)["arrays"]
    assert [entry["name"] for entry in arrays] == ["image", "range", "body_id"]
    for entry, part in zip(arrays, pixels, strict=True):
        flat = np.frombuffer(part, np.dtype(entry["dtype"]))
        np.testing.assert_array_equal(flat.reshape(entry["shape"], order=order), theirs.arrays[entry["name"]])


def test_requests_sent_in_one_go_are_answered_in_their_order(address):
    with Framed(address) as framed:
        framed.socket.sendall(b"".join(framed.frame(request(id=k, camera="bare")) for k in range(1, 21)))
        assert [msgpack.unpackb(framed.receive()[0])["id"] for _ in range(20)] == list(range(1, 21))


def test_a_request_may_come_byte_by_byte(address):
    with Framed(address) as framed:
        for byte in framed.frame(hello(7)):
            framed.socket.sendall(bytes([byte]))
        assert msgpack.unpackb(framed.receive()[0])["id"] == 7


def test_a_client_that_closes_its_side_is_answered_still(address):
    with Framed(address) as framed:
        framed.send(request())
        framed.socket.shutdown(socket.SHUT_WR)
        assert msgpack.unpackb(framed.receive()[0])["ok"]
        assert framed.socket.recv(1) == b""


@pytest.mark.parametrize("data, message", [
    (b"GET / HTTP/1.1\r\n\r\n", "must begin with GLR1"),
    (b"GLR2" + bytes(8), "must begin with GLR1"),
    (b"\x00", "must begin with GLR1"),
    (b"GLR1" + struct.pack("<HH", 0, 0), "1 to 16 parts, got 0"),
    (b"GLR1" + struct.pack("<HH", 65535, 0), "1 to 16 parts, got 65535"),
    (Framed.frame(b"\x80", flags=1), "flags of a message must be 0"),
    (b"GLR1" + struct.pack("<HHI", 1, 0, 2**32 - 1), "must not exceed 1048576 bytes, got 4294967295"),
    (b"GLR1" + struct.pack("<HHII", 2, 0, 2**20, 1), "must not exceed"),
    (Framed.frame(bytes(4 << 20)), "must not exceed"),
])
def test_a_stream_that_loses_its_framing_is_told_and_closed(address, data, message):
    with Framed(address) as framed:
        framed.send(hello(3))
        framed.socket.sendall(data)
        assert msgpack.unpackb(framed.receive()[0])["id"] == 3, "what came before is answered first"
        header = msgpack.unpackb(framed.receive()[0])
        assert (header["ok"], header["id"], header["error"]["code"]) == (False, 0, "protocol")
        assert message in header["error"]["message"]
        assert framed.socket.recv(1) == b""
    assert serves_on(address)


@pytest.mark.parametrize("parts", [[b"garbage"], [b"\xc1"], [b""], [b"a", b"b"]])
def test_garbage_in_a_sound_frame_leaves_the_connection_open(address, parts):
    with Framed(address) as framed:
        assert msgpack.unpackb(framed.ask(*parts)[0])["error"]["code"] == "protocol"
        assert msgpack.unpackb(framed.ask(hello())[0])["ok"]


def test_truncated_messages_hold_nothing_up(live):
    _, address, process = live
    before = len(os.listdir(f"/proc/{process.pid}/fd"))
    whole = Framed.frame(request())
    for cut in (1, 4, 7, 9, 12, 100, len(whole) - 1):
        with Framed(address) as framed:
            framed.socket.sendall(whole[:cut])
        assert serves_on(address)
    time.sleep(0.5)
    assert len(os.listdir(f"/proc/{process.pid}/fd")) <= before + 1


def test_a_client_that_resets_with_a_frame_on_its_way_is_forgotten(live):
    _, address, process = live

    def descriptors_after_resets(first):
        for number in range(first, first + 20):
            with Framed(address) as framed:
                framed.send(request(id=number, products=["r_body", "range"]))
                # Linger 0: closing sends a reset.
                framed.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        assert serves_on(address)
        time.sleep(0.5)
        return len(os.listdir(f"/proc/{process.pid}/fd"))

    # Slots of shared memory take some, however many they are just now.
    assert descriptors_after_resets(20) < descriptors_after_resets(0) + 10


BIG = serving.SCENE + """
[[cameras]]
name = "big"
width_px = 2048
height_px = 2048
focal_length_px = 400.0
"""


def test_a_reader_who_does_not_read_delays_nobody_and_gets_every_byte_in_the_end(tmp_path):
    with serving.server(tmp_path, "--tcp", "127.0.0.1:0", scene=BIG) as (_, process):
        address = serving.tcp_address(process)
        with Framed(address, receive_buffer=65536) as slow, Framed(address) as quick:
            message = request(camera="big", samples=1)
            slow.send(message)
            slow.send(request(camera="big", samples=1, id=2))
            reference = quick.ask(request(camera="big", samples=1, client="quick"))[1]
            began = time.monotonic()
            for number in range(20):
                assert msgpack.unpackb(quick.ask(hello(number))[0])["ok"]
            assert time.monotonic() - began < 2.0
            for number in (1, 2):
                header, pixels = slow.receive()
                assert msgpack.unpackb(header)["id"] == number and pixels == reference


@pytest.mark.slow
def test_one_connection_cannot_make_the_server_hold_frames_without_end(tmp_path):
    """A client that asks and never reads: beyond 16 requests and 64 MiB of replies its requests stay where they are."""
    with serving.server(tmp_path, "--tcp", "127.0.0.1:0", scene=BIG) as (_, process):
        address = serving.tcp_address(process)

        def resident_mib():
            with open(f"/proc/{process.pid}/statm") as file:
                return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20

        with Framed(address, receive_buffer=65536) as greedy:
            greedy.socket.settimeout(0.2)
            assert msgpack.unpackb(greedy.ask(hello())[0])["ok"]
            before = resident_mib()
            try:
                for number in range(400):
                    greedy.send(request(camera="big", samples=1, id=number))
            except TimeoutError:
                pass
            time.sleep(1.0)
            assert serves_on(address)
            # 16 MiB a frame: 400 of them would be 6.4 GiB.
            assert resident_mib() - before < 25 * 16
            greedy.socket.settimeout(30.0)
            assert [msgpack.unpackb(greedy.receive()[0])["id"] for _ in range(60)] == list(range(60))


def test_a_connection_too_many_takes_the_place_of_who_was_silent_longest(live):
    _, address, _ = live
    with Framed(address) as framed:
        most = msgpack.unpackb(framed.ask(hello())[0])["limits"]["max_tcp_connections"]
    silent, at_work = Framed(address), [Framed(address) for _ in range(most - 1)]
    try:
        for framed in at_work:
            assert msgpack.unpackb(framed.ask(hello())[0])["ok"]
        with Framed(address) as one_more:
            assert msgpack.unpackb(one_more.ask(hello())[0])["ok"]
            assert silent.socket.recv(1) == b"", "it has asked for nothing yet"
            assert msgpack.unpackb(at_work[0].ask(hello())[0])["ok"]
    finally:
        for framed in (silent, *at_work):
            framed.socket.close()
    time.sleep(0.3)
    assert serves_on(address)


def test_a_connection_too_many_is_told_busy_where_all_are_at_work():
    front, poller = tcp_front.TcpFront("127.0.0.1:0", max_connections=2), zmq.Poller()
    front.start(poller)
    host, _, port = front.endpoint.rpartition(":")

    def turned():
        time.sleep(0.05)
        return front.take_in(dict(poller.poll(1000)))

    try:
        with Framed((host, int(port))) as one, Framed((host, int(port))) as two:
            for framed in (one, two):
                framed.send(hello())
            asked = [request for _ in range(3) for request in turned()]
            assert len(asked) == 2 and asked[0].sender != asked[1].sender
            spare = [Framed((host, int(port))) for _ in range(tcp_front.SPARE_CONNECTIONS)]
            for framed in spare:
                framed.send(hello())
            for_operators = [request for _ in range(4) for request in turned()]
            assert [request.is_spare for request in asked + for_operators] == [False] * 2 + [True] * len(spare)
            with Framed((host, int(port))) as three:
                turned()
                error = msgpack.unpackb(three.receive()[0])["error"]
                assert error["code"] == "busy" and error["retry_after_s"] > 0.0
                assert three.socket.recv(1) == b""
            for_operators[0].answer([msgpack.packb({"id": 1})])
            with Framed((host, int(port))) as four:
                four.send(hello())
                assert [request.is_spare for _ in range(3) for request in turned()] == [True], "one was answered"
            for request in asked:
                request.answer([msgpack.packb({"id": 1})])
            with Framed((host, int(port))) as five:
                five.send(hello())
                assert [request.is_spare for _ in range(3) for request in turned()] == [False], "others are silent now"
            for framed in spare:
                framed.socket.close()
    finally:
        front.close()


def test_a_spare_place_is_lost_after_a_second(monkeypatch):
    clock = [100.0]
    monkeypatch.setattr(tcp_front.time, "monotonic", lambda: clock[0])
    ours, theirs = connected_pair()
    connection = tcp_front._Connection(ours, "127.0.0.1", is_spare=True)
    clock[0] += 0.9 * tcp_front.SPARE_S
    assert connection.turn(0) == [] and not connection.is_done
    clock[0] += 0.2 * tcp_front.SPARE_S
    assert connection.turn(0) == [] and connection.is_done
    connection.close()
    theirs.close()


def connected_pair():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        theirs = socket.create_connection(listener.getsockname())
        return listener.accept()[0], theirs


@pytest.mark.parametrize("own, in_all, takes", [
    (0, 2**40, True), (2**20, 2**40, True), (2**20 + 1, 2**40, False), (2**20 + 1, 15 * 2**26, True),
    (2**26, 15 * 2**26, True), (2**26 + 1, 0, False)])
def test_whoever_has_much_to_take_is_read_no_further(own, in_all, takes):
    """64 MiB of its own, and 1 MiB where all together have 960 MiB: also of replies that are no frames."""
    ours, theirs = connected_pair()
    connection = tcp_front._Connection(ours, "127.0.0.1", in_all=lambda: in_all)
    connection._output.n_bytes = own
    assert connection.wants_input is takes
    connection.close()
    theirs.close()


def test_a_front_that_stops_listening_serves_on_those_who_are_there():
    front, poller = tcp_front.TcpFront("127.0.0.1:0"), zmq.Poller()
    front.start(poller)
    host, _, port = front.endpoint.rpartition(":")
    try:
        with Framed((host, int(port))) as framed:
            assert not front.take_in(dict(poller.poll(1000)))
            front.stop_listening()
            with pytest.raises(ConnectionRefusedError):
                Framed((host, int(port)))
            framed.send(hello())
            serving.until(lambda: front.take_in(dict(poller.poll(100))))
    finally:
        front.close()


def test_a_message_begun_and_never_ended_is_given_up(monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        theirs = socket.create_connection(listener.getsockname())
        ours, _ = listener.accept()
    clock = [100.0]
    monkeypatch.setattr(tcp_front.time, "monotonic", lambda: clock[0])
    connection = tcp_front._Connection(ours, "127.0.0.1")
    assert connection.turn(0) == [] and not connection.is_done
    clock[0] += 1000.0
    assert connection.turn(0) == [] and not connection.is_done, "a silent client may come back (a paused Simulink)"
    theirs.send(b"GLR1\x01")
    assert select.select([ours], [], [], 5.0)[0]
    connection.turn(zmq.POLLIN)
    clock[0] += 0.9 * tcp_front.STALL_S
    connection.turn(0)
    assert not connection.is_done
    clock[0] += 0.2 * tcp_front.STALL_S
    connection.turn(0)
    assert connection.is_done
    connection.close()
    theirs.close()


def test_what_the_system_did_not_take_wakes_the_loop():
    """Not after the loop's next look, ten milliseconds later: as soon as there is room."""
    front, poller = tcp_front.TcpFront("127.0.0.1:0"), zmq.Poller()
    front.start(poller)
    host, port = front.endpoint.split(":")
    try:
        with Framed((host, int(port)), receive_buffer=65536) as framed:
            front.take_in(dict(poller.poll(5000)))
            framed.send(hello())
            (request,) = front.take_in(dict(poller.poll(5000)))
            (watched,) = [entry for entry in poller.sockets if entry[0] != front._listener.fileno()]
            assert watched[1] == zmq.POLLIN
            request.answer([b"header", bytes(1 << 23)])
            assert not front.is_idle and (watched[0], zmq.POLLIN | zmq.POLLOUT) in poller.sockets
            framed.socket.settimeout(1.0)
            room = (dict(poller.poll(100)).get(watched[0], 0) & zmq.POLLOUT for _ in iter(
                lambda: framed.socket.recv(65536), b""))
            assert any(room), "woken while the reply is on its way"
    finally:
        front.close()


def test_a_vanished_peer_is_probed_for(live):
    """Half-open connections: keep-alive is on, on the server's side of each."""
    _, address, process = live
    with Framed(address) as framed:
        framed.ask(hello())
        port = framed.socket.getsockname()[1]
        with open(f"/proc/{process.pid}/net/tcp") as file:
            rows = [line.split() for line in file.readlines()[1:]]
        # Timer 02 of /proc/net/tcp: keep-alive.
        timers = [row[5].split(":")[0] for row in rows if int(row[2].split(":")[1], 16) == port and row[3] == "01"]
        assert timers == ["02"]


def test_sigterm_answers_what_waits_on_tcp(tmp_path):
    with serving.server(tmp_path, "--tcp", "127.0.0.1:0") as (_, process), \
            Framed(serving.tcp_address(process)) as framed:
        framed.ask(hello())
        for number in range(3):
            framed.send(request(id=10 + number, samples=16, products=["range"]))
        time.sleep(0.05)
        process.send_signal(signal.SIGTERM)
        assert [msgpack.unpackb(framed.receive()[0])["id"] for _ in range(3)] == [10, 11, 12]
        assert process.wait(timeout=20.0) == 0


def test_what_the_decoder_yields_does_not_depend_on_how_the_bytes_are_cut(rng):
    messages = [[rng.bytes(int(n)) for n in rng.integers(0, 300, rng.integers(1, 5))] for _ in range(200)]
    stream = b"".join(bytes(view) for parts in messages for view in framing.framed(parts))
    assert stream == b"".join(Framed.frame(*parts) for parts in messages)
    decoder, found, start = framing.Decoder(), [], 0
    while start < len(stream):
        step = int(rng.integers(1, 700))
        decoder.feed(stream[start:start + step])
        found += decoder.messages()
        start += step
    assert found == messages and decoder.is_between_messages


def test_random_bytes_are_refused_by_the_decoder_or_wait(rng):
    for _ in range(3000):
        data = bytearray(Framed.frame(rng.bytes(20)))
        for _ in range(rng.integers(1, 4)):
            data[rng.integers(0, 12)] = rng.integers(0, 256)
        decoder = framing.Decoder()
        decoder.feed(bytes(data))
        try:
            assert all(len(parts) <= framing.MAX_PARTS for parts in decoder.messages())
        except ProtocolError as error:
            assert error.code == "protocol"


@pytest.mark.parametrize("arguments, message", [
    (["--tcp", "0.0.0.0:5556"], "--tcp: leads beyond this machine"),
    (["--tcp", "5556"], "--tcp: must be HOST:PORT"),
    (["--tcp", "127.0.0.1:x"], "the port between 0 and 65535"),
    (["--tcp", "127.0.0.1:99999"], "the port between 0 and 65535"),
])
def test_a_wrong_address_is_refused_at_the_start(tmp_path, arguments, message, capfd):
    from glrender_server.__main__ import main

    (tmp_path / "scene.toml").write_text(serving.SCENE)
    assert main([str(tmp_path / "scene.toml"), *arguments]) == 1
    assert message in capfd.readouterr().err


def test_a_tcp_port_in_use_says_so(live, tmp_path, capfd):
    from glrender_server.__main__ import main

    (tmp_path / "scene.toml").write_text(serving.SCENE)
    host, port = live[1]
    assert main([str(tmp_path / "scene.toml"), "--zmq", "tcp://127.0.0.1:*", "--tcp", f"{host}:{port}"]) == 1
    assert "cannot listen on" in (said := capfd.readouterr().err) and "--tcp" in said
