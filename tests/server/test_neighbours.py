"""Other users of the machine, and other clients, can neither block a server nor take what is another's."""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import socket
import stat
import struct
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import msgpack
import pytest
import serving
import views
import zmq
from glrender_server import ipc_path, keys, limits, peers, slots, zmq_front
from glrender_server.zmq_front import ZmqFront
from serving import children

STATE = views.state().to_dict()
SHARED_MEMORY = Path("/dev/shm")
needs_shared_memory = pytest.mark.skipif(not SHARED_MEMORY.is_dir(), reason="SKIPPED FOR WANT OF /dev/shm")


def head(op, number, client="neighbour", **fields):
    return msgpack.packb({"v": 1, "op": op, "id": number, "client": client, **fields})


@contextmanager
def peer(endpoint, **options):
    with zmq.Context() as context, context.socket(zmq.DEALER) as dealer:
        dealer.set(zmq.LINGER, 0)
        for name, value in options.items():
            dealer.set(getattr(zmq, name), value)
        dealer.connect(endpoint)
        yield dealer


def reply(dealer, seconds=10.0):
    return msgpack.unpackb(dealer.recv_multipart()[0]) if dealer.poll(1e3 * seconds) else None


@contextmanager
def serving_front(*arguments, **options):
    """A front and a function that takes in what comes within a while."""
    front, poller = ZmqFront(*arguments, **options), zmq.Poller()
    front.start(poller)

    def taken_in(seconds=1.0, enough=1):
        requests, deadline = [], time.monotonic() + seconds
        while time.monotonic() < deadline and len(requests) < enough:
            requests += front.take_in(dict(poller.poll(20)))
        return requests

    try:
        yield front, taken_in
    finally:
        front.close()


@needs_shared_memory
def test_what_others_leave_in_shared_memory_neither_blocks_nor_removes_anything():
    store = slots.SlotStore()
    slot = store.take(1000)
    owner = next(path for path in SHARED_MEMORY.glob("glrender-slot-*") if slot.name.startswith(path.name + "-"))
    pipe, pattern = (SHARED_MEMORY / name for name in ("glrender-slot-ffffffffffff", owner.name[:-1] + "?"))
    try:
        os.mkfifo(pipe)
        pattern.touch()
        slots.SlotStore().close()  # removes what the dead left; a FIFO would be waited for
        assert (SHARED_MEMORY / slot.name).exists() and owner.exists()
    finally:
        pipe.unlink(missing_ok=True)
        pattern.unlink(missing_ok=True)
        store.close()


@needs_shared_memory
def test_memory_that_somebody_removed_is_not_used_again():
    store = slots.SlotStore()
    try:
        slot = store.take(1000)
        store.give_back(slot)
        (SHARED_MEMORY / slot.name).unlink()
        other = store.take(1000)
        assert other.name != slot.name and (SHARED_MEMORY / other.name).exists()
    finally:
        store.close()


def test_a_unix_socket_is_not_taken_from_a_server_and_admits_its_user_alone(tmp_path):
    endpoint = f"ipc://{tmp_path}/socket"
    with serving_front(endpoint) as (front, taken_in), peer(endpoint) as dealer:
        assert stat.S_IMODE((tmp_path / "socket").stat().st_mode) == 0o600
        with pytest.raises(OSError, match="a server listens there"):
            ZmqFront(endpoint)
        dealer.send(head("hello", 1))
        assert taken_in(), "the first is still reached"
    with serving_front(endpoint):
        pass  # it is free again


def test_a_socket_that_a_killed_server_left_is_taken(tmp_path):
    path = tmp_path / "socket"
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(path))
    ipc_path.Claim(path).release()
    with serving_front(f"ipc://{path}"):
        pass


def test_a_file_that_is_no_socket_is_left_alone(tmp_path):
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(OSError, match="no socket"):
        ZmqFront(f"ipc://{tmp_path}/thesis.txt")
    assert (tmp_path / "thesis.txt").read_text() == "years of work"


def test_who_takes_a_clients_identity_does_not_get_its_replies():
    with serving_front("tcp://127.0.0.1:*") as (front, taken_in), peer(front.endpoint, IDENTITY=b"loop") as first:
        first.send(head("hello", 1))
        request, = taken_in()
        with peer(front.endpoint, IDENTITY=b"loop") as second:
            second.send(head("hello", 2))
            taken_in(0.3)
            request.answer([msgpack.packb({"id": 1})])
            assert reply(second, 0.3) is None and reply(first) == {"id": 1}


def test_a_reply_to_who_has_gone_reaches_nobody_of_that_identity():
    with serving_front("tcp://127.0.0.1:*") as (front, taken_in):
        with peer(front.endpoint, IDENTITY=b"loop") as first:
            first.send(head("hello", 1))
            request, = taken_in()
            assert request.is_there()
        taken_in(0.3)
        assert not request.is_there()
        with peer(front.endpoint, IDENTITY=b"loop") as second:
            second.send(head("hello", 2))
            other, = taken_in()
            request.answer([msgpack.packb({"id": 1})])
            other.answer([msgpack.packb({"id": 2})])
            assert reply(second) == {"id": 2}


def test_the_connection_that_was_silent_longest_makes_room():
    with serving_front("tcp://127.0.0.1:*", max_connections=3) as (front, taken_in):
        host, _, port = front.endpoint.removeprefix("tcp://").rpartition(":")
        silent = [socket.create_connection((host, int(port))) for _ in range(6)]
        try:
            with peer(front.endpoint) as dealer:
                dealer.send(head("hello", 1))
                request, = taken_in(5.0)
                request.answer([msgpack.packb({"id": 1})])
                assert reply(dealer) == {"id": 1}
        finally:
            for connection in silent:
                connection.close()


def spoken_to(endpoint):
    """A socket that has shaken hands as a DEALER; ZMTP 3.0 (RFC 23) by hand, as a library sends only whole messages."""
    host, _, port = endpoint.removeprefix("tcp://").rpartition(":")
    raw = socket.create_connection((host, int(port)))
    raw.sendall(b"\xff" + bytes(8) + b"\x7f\x03\x00" + b"NULL".ljust(20, b"\0") + bytes(32))
    ready = b"\x05READY\x0bSocket-Type" + struct.pack(">I", 6) + b"DEALER"
    raw.sendall(bytes([4, len(ready)]) + ready)
    # A message that comes with the handshake is lost by libzmq: wait for its own, of 64 bytes and READY.
    with raw.makefile("rb") as theirs:
        theirs.read(64)
        theirs.read(theirs.read(2)[1])
    return raw


def test_who_never_ends_a_message_is_hung_up_on():
    """ZeroMQ keeps the parts of a message until its last has come, and bounds the size of each alone."""
    with serving_front("tcp://127.0.0.1:*") as (front, taken_in), peer(front.endpoint) as honest, \
            spoken_to(front.endpoint) as raw:
        honest.send(head("hello", 1))
        assert taken_in(5.0)
        one_mebibyte = b"\x03" + struct.pack(">Q", 2**20) + bytes(2**20)  # more will follow, long
        is_hung_up = threading.Event()

        def send():
            try:
                for _ in range(400):
                    raw.sendall(one_mebibyte)
            except OSError:
                is_hung_up.set()

        threading.Thread(target=send, daemon=True).start()
        deadline = time.monotonic() + 20.0
        while not is_hung_up.is_set() and time.monotonic() < deadline:
            taken_in(0.1)
        assert is_hung_up.is_set()
        honest.send(head("hello", 2))
        assert taken_in(), "the other is served"


def test_whole_requests_that_wait_while_the_loop_is_busy_cost_no_connection():
    """One client pipelines 40 MB, twenty 80 MB together: the loop reads nothing for a second, then little."""
    with serving_front("tcp://127.0.0.1:*") as (front, taken_in), contextlib.ExitStack() as stack:
        dealers = [stack.enter_context(peer(front.endpoint)) for _ in range(21)]
        for dealer, n_messages in zip(dealers, [40, *[4] * 20], strict=True):
            for number in range(n_messages):
                dealer.send(head("hello", number, ballast=bytes(10**6)))
        time.sleep(1.0)
        n_answered = 0
        while n_answered < 120:
            requests = taken_in(10.0)
            assert requests, "none is lost"
            n_answered += len(requests)
            for request in requests:
                request.answer([msgpack.packb(request.parts[0][:1])])
            time.sleep(0.02)
        assert all(reply(dealer) is not None for dealer in dealers for _ in range(4))
        assert all(reply(dealers[0]) is not None for _ in range(36))


def test_a_message_without_end_is_found_where_there_is_always_another_to_read(monkeypatch):
    monkeypatch.setattr(limits, "MAX_UNFINISHED_BYTES", 3000)
    with serving_front("tcp://127.0.0.1:*", max_part_bytes=1000) as (front, taken_in), \
            spoken_to(front.endpoint) as raw, peer(front.endpoint) as honest:
        monkeypatch.setattr(front._peers, "has_read_all", lambda: None)
        raw.sendall((bytes([3]) + struct.pack(">Q", 900) + bytes(900)) * 5)
        for _ in range(3):
            for number in range(150):
                honest.send(head("hello", number))
            assert len(taken_in(5.0, enough=150)) == 150
            time.sleep(0.1)
        taken_in(0.2)
        raw.settimeout(5.0)
        with contextlib.suppress(ConnectionResetError):
            assert not raw.recv(1)


def test_a_poll_says_nothing_of_the_bytes_of_a_later_mark():
    """A whole message that came between the two was counted as one without end until it was read."""
    with serving_front("tcp://127.0.0.1:*") as (front, _):
        for _ in range(2):
            front._peers._looked = 0.0
            assert not list(front.take_in({}))
            assert front._peers._n_messages < front._peers._n_to_settle, "the mark has still to be settled"


def test_heartbeats_are_no_message_without_end(monkeypatch):
    """ZMTP's PING (RFC 37) brings no message; a client that sends it for days is hung up on otherwise."""
    monkeypatch.setattr(limits, "MAX_UNFINISHED_BYTES", 1000)
    with serving_front("tcp://127.0.0.1:*", max_part_bytes=200) as (front, taken_in), spoken_to(front.endpoint) as raw:
        for _ in range(10):
            raw.sendall(b"\x04\x07\x04PING\0\0" * 25)
            taken_in(0.3)
        found, = front._peers._all()
        assert found.n_received_bytes > 2000 and found.is_there


@pytest.mark.parametrize("options", [{}, {"IDENTITY": bytes(range(1, 256))}])
def test_who_has_taken_its_replies_and_is_silent_is_not_hung_up_on(options, monkeypatch):
    """The name in a reply's envelope does not go over the wire."""
    monkeypatch.setattr(zmq_front, "_STALL_S", 0.3)
    with serving_front("tcp://127.0.0.1:*") as (front, taken_in), peer(front.endpoint, **options) as dealer:
        for parts in (*[[msgpack.packb(1), bytes(1 << 22)]] * 3, [msgpack.packb(1), bytes(186)]):
            dealer.send(head("hello", 1))
            request, = taken_in(5.0)
            request.answer(parts)
            assert reply(dealer) == 1
            taken_in(0.15)
        found, = front._peers._all()
        taken_in(1.0)
        assert found.is_there and not front._backlogs and not request.untaken_bytes()


def test_who_takes_nothing_is_hung_up_on(monkeypatch):
    monkeypatch.setattr(zmq_front, "_STALL_S", 0.5)
    with serving_front("tcp://127.0.0.1:*") as (front, taken_in), spoken_to(front.endpoint) as raw, \
            peer(front.endpoint) as honest:
        frame = head("hello", 1)
        raw.sendall(bytes([0, len(frame)]) + frame)
        request, = taken_in(5.0)
        for _ in range(20):
            request.answer([bytes(1 << 20)])
        serving.until(lambda: taken_in(0.1) or len(front._peers) == 1)
        honest.send(head("hello", 2))
        assert taken_in(5.0) and not request.untaken_bytes()


def test_a_message_of_some_parts_is_refused_by_name(tmp_path):
    """As on TCP: up to 16."""
    with serving.server(tmp_path) as (endpoint, _), peer(endpoint) as one:
        for n_parts in (2, 16):
            one.send_multipart([head("hello", 1)] + [b"x"] * (n_parts - 1))
            error = reply(one)["error"]
            assert error["code"] == "protocol"
            assert error["message"] == f"a request must have one part, the header, got {n_parts}"


def test_a_message_of_very_many_parts_is_hung_up_on_and_holds_up_nobody():
    """Each empty part has two bytes on the wire, and 64 in ZeroMQ."""
    with serving_front("tcp://127.0.0.1:*") as (front, taken_in), peer(front.endpoint) as honest, \
            spoken_to(front.endpoint) as raw:
        honest.send(head("hello", 1))
        assert taken_in(5.0)
        with contextlib.suppress(OSError):
            raw.sendall(b"\x01\x00" * 500_000 + b"\x00\x00")
        honest.send(head("hello", 2))
        began = time.monotonic()
        assert taken_in(5.0) and time.monotonic() - began < 1.0
        taken_in(2.0, enough=2)
        raw.settimeout(5.0)
        with contextlib.suppress(ConnectionResetError):
            while raw.recv(4096):
                pass


def test_who_has_gone_is_no_reason_to_hang_up_on_the_next(monkeypatch):
    """A message says a descriptor that may be another's when it is read."""
    with serving_front("tcp://127.0.0.1:*") as (front, taken_in), peer(front.endpoint) as honest:
        for number in range(20):
            with contextlib.closing(spoken_to(front.endpoint)) as raw:
                raw.sendall(b"\x01\x00" * 60 + b"\x00\x00")  # too many parts
            honest.send(head("hello", number))
            request, = taken_in(5.0)
            request.answer([msgpack.packb({"id": number})])
            assert reply(honest) == {"id": number}


def test_a_look_at_the_connections_leaves_no_descriptor_whatever_their_descriptors_are_by_now(tmp_path):
    with serving_front("tcp://127.0.0.1:*") as (front, taken_in), peer(front.endpoint) as one:
        one.send(head("hello", 1))
        taken_in(5.0)
        serving.until(lambda: taken_in(0.1) or len(front._peers) == 1)
        found, = front._peers._all()
        before = len(os.listdir("/proc/self/fd"))
        with open(tmp_path / "file", "w") as file:
            stale = peers.Peer(file.fileno(), os.fstat(file.fileno()).st_ino, front._peers._count_now)
            for each in (stale, peers.Peer(found.descriptor, found.inode + 1, front._peers._count_now)):
                each.queued_bytes()
                front._peers.hang_up(each)
                assert not front._peers._is_ours(each)
            file.write("still open")
        assert len(os.listdir("/proc/self/fd")) == before
        one.send(head("hello", 2))
        assert taken_in(5.0), "whose descriptor was meant by mistake is served on"


def test_all_connections_of_a_process_or_of_another_machine_are_one_account(tmp_path, monkeypatch):
    """A client with many connections was a new one with each."""
    elsewhere = ("import sys, zmq\ns = zmq.Context().socket(zmq.DEALER)\ns.connect(sys.argv[1])\n"
                 "s.send(b'x')\ns.poll(20_000)\n")
    with serving_front(f"ipc://{tmp_path}/z") as (front, taken_in), peer(front.endpoint) as one, \
            peer(front.endpoint) as two, subprocess.Popen([sys.executable, "-c", elsewhere, front.endpoint]) as other:
        others, = taken_in(20.0)
        one.send(b"x")
        two.send(b"x")
        ours = taken_in(5.0, enough=2)
        others.answer([b"y"])
        assert ours[0].sender != ours[1].sender and ours[0].account == ours[1].account != others.account
        assert ours[0].account and others.account and other.wait(20.0) == 0
    for is_loopback, account in ((True, None), (False, "127.0.0.1")):
        monkeypatch.setattr(peers.ipaddress, "ip_address", lambda text, is_it=is_loopback: SimpleNamespace(
            is_loopback=is_it))
        with serving_front("tcp://127.0.0.1:*") as (front, taken_in), peer(front.endpoint) as dealer:
            dealer.send(b"x")
            request, = taken_in(5.0)
            assert request.account == account


@pytest.mark.parametrize("pid", [0, 4711])
def test_a_process_that_another_namespace_hides_is_no_account(tmp_path, pid):
    """Its number is 0, as that of all such: several containers with one user were one client."""
    with serving_front(f"ipc://{tmp_path}/z") as (front, _):
        credentials = struct.pack("3i", pid, 1000, 1000)
        connection = SimpleNamespace(getsockname=lambda: f"{tmp_path}/z", getpeername=lambda: "",
                                     getsockopt=lambda *which: credentials)
        found = peers.Peer(-1, -1, None)
        front._peers._held = lambda peer: connection
        assert front._peers._is_ours(found) and found.account == (credentials if pid else None)


@pytest.mark.parametrize("endpoint", ["tcp://127.0.0.1:*", "ipc://{}/z"])
def test_a_socket_of_another_family_is_no_connection_and_ends_no_look(tmp_path, endpoint):
    """A library that asks for network interfaces keeps a netlink socket: its addresses are numbers (netlink(7))."""
    with serving_front(endpoint.format(tmp_path)) as (front, taken_in), peer(front.endpoint) as one, \
            socket.socket(socket.AF_NETLINK, socket.SOCK_RAW) as plain, \
            socket.socket(socket.AF_NETLINK, socket.SOCK_RAW) as alike:
        # Its groups stand where TCP has the port.
        alike.bind((0, front._peers._port or 1))
        one.send(b"x")
        assert taken_in(5.0)
        serving.until(lambda: taken_in(0.1) or len(front._peers) == 1)
        assert all(front._peers._peer(other.fileno()) is None for other in (plain, alike))


def test_where_no_descriptor_is_free_too_many_connections_are_closed_nevertheless():
    with serving_front("tcp://127.0.0.1:*", max_connections=4) as (front, taken_in):
        host, _, port = front.endpoint.removeprefix("tcp://").rpartition(":")
        held = [socket.create_connection((host, int(port))) for _ in range(8)]
        time.sleep(0.3)
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(map(int, os.listdir("/proc/self/fd"))) + 8, hard))
        taken = []
        try:
            with pytest.raises(OSError, match="Too many open files"):
                while True:
                    taken.append(os.dup(held[0].fileno()))
            serving.until(lambda: taken_in(0.1) or len(front._peers) == 4)
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
            for descriptor in taken:
                os.close(descriptor)
        for connection in held:
            connection.close()


def test_small_replies_that_nobody_takes_are_dropped_beyond_the_bound_and_frames_are_not(monkeypatch):
    """Replies to `hello` are replies too; a frame was let in by the bound before it was drawn."""
    monkeypatch.setattr(limits, "MAX_UNTAKEN_BYTES", 1 << 20)
    with serving_front("tcp://127.0.0.1:*") as (front, taken_in), spoken_to(front.endpoint) as raw:
        frame = head("hello", 1)
        raw.sendall(bytes([0, len(frame)]) + frame)
        request, = taken_in(5.0)
        name, large = request.sender, [bytes(100), bytes(1 << 20)]
        for _ in range(60):
            request.answer(large)
        backlog = front._backlogs[name]
        assert backlog.waiting_bytes > 8 << 20, "frames wait"
        before = len(backlog.replies)
        for _ in range(1000):
            request.answer([bytes(1000)])
        assert len(backlog.replies) <= before
        assert request.untaken_bytes() >= backlog.held_bytes >= backlog.waiting_bytes > 1 << 20


def test_zeromq_that_never_ends_does_not_keep_a_server_from_ending(monkeypatch, caplog):
    """Version 4.3.5 waits for ever now and then, where a client with replies on their way has just gone."""
    monkeypatch.setattr(zmq_front, "_END_S", 0.2)
    front, never = ZmqFront("tcp://127.0.0.1:*"), threading.Event()
    ends, front._context = front._context, SimpleNamespace(term=never.wait)
    begin = time.monotonic()
    front.close(0.1)
    assert 0.25 < time.monotonic() - begin < 5.0 and "ZeroMQ has not ended after 0.3 s" in caplog.text
    never.set()
    ends.term()


def test_connections_made_before_the_loop_starts_count_too():
    front, poller = ZmqFront("tcp://127.0.0.1:*", max_connections=4), zmq.Poller()
    host, _, port = front.endpoint.removeprefix("tcp://").rpartition(":")
    early = [socket.create_connection((host, int(port))) for _ in range(3)]
    try:
        front.start(poller)
        serving.until(lambda: list(front.take_in({})) or len(front._peers) == 3)
    finally:
        for connection in early:
            connection.close()
        front.close()


def test_nobody_can_know_what_zeromq_will_name_the_next_client():
    """It ends the process where a client has given itself that name."""
    code = ("import sys, time, zmq\nsys.path[:0] = sys.argv[1:]\nfrom glrender_server.zmq_front import ZmqFront\n"
            "front, poller = ZmqFront('tcp://127.0.0.1:*'), zmq.Poller()\nfront.start(poller)\n"
            "dealer = zmq.Context().socket(zmq.DEALER)\ndealer.connect(front.endpoint)\ndealer.send(b'x')\n"
            "requests = []\nwhile not requests:\n    requests = list(front.take_in(dict(poller.poll(100))))\n"
            "print(requests[0].sender.hex())\ndealer.close(0)\nfront.close()\n")
    names = {subprocess.run([sys.executable, "-c", code, *sys.path], capture_output=True, text=True, timeout=60,
                            check=True).stdout for _ in range(2)}
    assert len(names) == 2


@pytest.fixture
def folder(tmp_path):
    keys.generate(tmp_path / "keys", ["loop", "old"])
    return tmp_path / "keys"


def curve(folder, name):
    public, secret = zmq.auth.load_certificate(folder / f"{name}.key_secret") if name else zmq.curve_keypair()
    return {"CURVE_PUBLICKEY": public, "CURVE_SECRETKEY": secret,
            "CURVE_SERVERKEY": zmq.auth.load_certificate(folder / "server.key")[0]}


def test_requests_carry_the_name_of_their_key_and_take_turns_by_it(folder):
    with serving_front("tcp://127.0.0.1:*", folder) as (front, taken_in):
        with peer(front.endpoint, **curve(folder, "loop")) as one, peer(front.endpoint, **curve(folder, "loop")) as two:
            for dealer in (one, two):
                dealer.send(head("hello", 1))
            requests = taken_in(5.0, enough=2)
            assert [request.user for request in requests] == ["loop", "loop"]
            assert requests[0].sender == requests[1].sender
        with peer(front.endpoint, **curve(folder, None)) as stranger:
            stranger.send(head("hello", 1))
            assert not taken_in(0.5)


def test_a_key_that_is_taken_away_or_added_counts_without_a_restart(folder, monkeypatch):
    monkeypatch.setattr(keys, "_READ_AGAIN_S", 0.0)
    with serving_front("tcp://127.0.0.1:*", folder) as (front, taken_in), \
            peer(front.endpoint, **curve(folder, "old")) as old:
        old.send(head("hello", 1))
        assert taken_in()
        (folder / "clients" / "old.key").unlink()
        old.send(head("hello", 2))
        assert not taken_in(0.5), "a connection that stands is not served either"
        keys.generate(folder, ["new"])
        with peer(front.endpoint, **curve(folder, "new")) as new:
            new.send(head("hello", 1))
            assert [request.user for request in taken_in(5.0)] == ["new"]


def test_a_folder_that_others_may_write_to_by_now_admits_no_further_client(folder, monkeypatch):
    monkeypatch.setattr(keys, "_READ_AGAIN_S", 0.0)
    admission = keys.Admission(folder)
    known = set(admission._admitted().values())
    (folder / "clients").chmod(0o777)
    keys.generate(folder, ["intruder"])
    assert set(admission._admitted().values()) == known == {"loop", "old"}
    (folder / "clients").chmod(0o700)
    assert "intruder" in admission._admitted().values(), "its owner has looked at it"


def test_a_reload_reads_a_key_that_was_written_over(folder):
    """Its folder has not changed by that."""
    admission = keys.Admission(folder)
    admission._is_settled = True
    keys.generate(folder.parent / "others", ["loop"])
    (folder / "clients" / "loop.key").write_text((folder.parent / "others" / "clients" / "loop.key").read_text())
    public = zmq.auth.load_certificate(folder / "clients" / "loop.key")[0].decode()
    assert not admission.name_of(public)
    admission.reload()
    assert admission.name_of(public) == "loop"


def test_without_its_authenticator_a_server_with_keys_admits_nobody(folder):
    with serving_front("tcp://127.0.0.1:*", folder) as (front, taken_in):
        front._authenticator.stop()
        with peer(front.endpoint, **curve(folder, None)) as stranger:
            stranger.send(head("hello", 1))
            assert not taken_in(1.0)


@pytest.mark.parametrize("which", [".", "clients"])
def test_a_folder_of_keys_to_which_others_may_write_is_refused(folder, which):
    (folder / which).chmod(0o777)
    with pytest.raises(ValueError, match="writable by its owner alone"):
        ZmqFront("tcp://127.0.0.1:*", folder)


def test_with_keys_operators_alone_load_scenes_and_tcp_is_warned_of(folder, tmp_path):
    arguments = "--curve", folder, "--operator", "loop", "--tcp", "127.0.0.1:0"
    with serving.server(tmp_path, *map(str, arguments)) as (endpoint, process):
        assert "without a key" in (tmp_path / "server.log").read_text()
        for name, code in (("old", "forbidden"), ("loop", "config")):
            with peer(endpoint, **curve(folder, name)) as dealer:
                dealer.send(head("load_scene", 1, scene={}))
                assert reply(dealer, 30.0)["error"]["code"] == code
        with serving.Framed(serving.tcp_address(process)) as framed:
            assert msgpack.unpackb(framed.ask(head("load_scene", 1, scene={}))[0])["error"]["code"] == "forbidden"


@pytest.mark.slow
def test_a_stopped_worker_stops_nobody(tmp_path):
    """The request does not fit into what the system holds between server and worker."""
    with serving.server(tmp_path, "--deadline", "3") as (endpoint, process), peer(endpoint) as dealer, \
            peer(endpoint) as other:
        dealer.send(head("render", 1, state=STATE, camera="bare"))
        assert reply(dealer, 60.0)["ok"]
        worker, = children(process)
        os.kill(worker, signal.SIGSTOP)
        dealer.send(head("range", 2, state=STATE, camera="bare", directions_camera=[[0.0, 0.0, 1.0]] * 10_000))
        for number in range(5):
            other.send(head("status", number, "other"))
            assert reply(other, 2.0)["ok"]
        assert reply(dealer, 60.0)["ok"], "by the worker after it"
        process.terminate()
        assert process.wait(20.0) == 0
