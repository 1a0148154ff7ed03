"""Short runs of what `benchmarks/soak.py` and a fuzzer do for hours: nothing is lost, crossed or ended.

GLRENDER_FUZZ_MESSAGES=1000000 makes the fuzzer's run long.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import msgpack
import numpy as np
import pytest
import serving
import views
import zmq
from glrender_client import Client
from serving import Framed

REPOSITORY = Path(__file__).parent.parent
N_MESSAGES = int(os.environ.get("GLRENDER_FUZZ_MESSAGES", "3000"))
GOLDEN = {name: [bytes.fromhex(part) for part in parts] for name, parts in json.loads(
    (REPOSITORY / "tests" / "data" / "golden.json").read_text(encoding="ascii")).items()}
STATE = views.state().to_dict()
DEADLINE_S = 5.0


def test_killed_clients_and_workers_lose_no_request():
    soak = str(REPOSITORY / "benchmarks" / "soak.py")
    run = subprocess.run([sys.executable, soak, "--frames", "500", "--clients", "4", "--kill-client-every", "50",
                          "--kill-worker-every", "150"], capture_output=True, text=True, timeout=300)
    record = json.loads(run.stdout)
    assert record["is_sound"] and record["frames"] >= 500, run.stdout
    assert record["killed"]["clients"] >= 5 and record["restarts"] >= 1, run.stdout


def mutated(rng):
    """Random bytes, or a golden request with bytes changed, cut or added, or one with a wrong value inside."""
    kind = rng.integers(0, 4)
    if kind == 0:
        return rng.bytes(int(rng.integers(0, 400)))
    name = ("request_hello", "request_render", "request_refused")[rng.integers(0, 3)]
    data = bytearray(GOLDEN[name][0])
    if kind == 1:
        for _ in range(rng.integers(1, 6)):
            data[rng.integers(0, len(data))] = rng.integers(0, 256)
    elif kind == 2:
        data = data[:rng.integers(0, len(data))] + rng.bytes(int(rng.integers(0, 20)))
    else:
        header = msgpack.unpackb(bytes(data))
        wrong = [None, -1, 2**63, float("nan"), "", [], {}, "x" * 300, [[[]]], True, b"raw", 1e308]
        header[rng.choice([*header, "noise", "scene", "samples"])] = wrong[rng.integers(0, len(wrong))]
        data = msgpack.packb(header)
    return bytes(data)


@pytest.mark.parametrize("workers", ["1", "2"])
def test_a_fuzzer_on_both_transports_neither_ends_nor_holds_up_the_server(tmp_path, rng, workers):
    """Every so often a good request is answered within its deadline, and each bad one got exactly one reply."""
    with serving.server(tmp_path, "--tcp", "127.0.0.1:0", "--workers", workers) as (endpoint, process):
        address = serving.tcp_address(process)
        context = zmq.Context()
        raw = context.socket(zmq.DEALER)
        raw.set(zmq.LINGER, 0)
        raw.connect(endpoint)
        idle, fuzzed = [], None
        with Client(endpoint, timeout_s=DEADLINE_S, retries=0) as good:
            for count in range(N_MESSAGES // 2):
                raw.send(mutated(rng))
                assert raw.poll(int(1e3 * DEADLINE_S)), "a message without a reply"
                parts = raw.recv_multipart()
                # A message that begins with an empty part is a REQ socket's, and so is its reply.
                header = msgpack.unpackb(parts[1] if parts[0] == b"" else parts[0])
                assert header["ok"] or header["error"]["code"] in ("protocol", "config", "scene", "shape"), header

                # Over TCP: a sound frame around bad bytes keeps the connection, a bad frame ends it.
                if fuzzed is None:
                    fuzzed = Framed(address)
                data = bytearray(Framed.frame(mutated(rng)))
                is_sound = rng.random() < 0.7
                if not is_sound:
                    data[rng.integers(0, 12)] ^= int(rng.integers(1, 256))
                try:
                    fuzzed.socket.sendall(data)
                    if is_sound:
                        assert not msgpack.unpackb(fuzzed.receive()[0]).get("bug")
                    else:
                        fuzzed.socket.close()
                        fuzzed = None
                except (OSError, EOFError) as error:
                    raise AssertionError("a sound frame ended its connection") from error
                if count % 100 == 0:
                    # Half-open: connected, half a message, and silence.
                    half = Framed(address)
                    half.socket.sendall(Framed.frame(GOLDEN["request_render"][0])[:int(rng.integers(1, 300))])
                    idle.append(half)
                    # A slow reader: asks and does not read.
                    slow = Framed(address, receive_buffer=4096)
                    slow.send(msgpack.packb({"v": 1, "op": "render", "id": 1, "client": f"slow{count}", "state": STATE,
                                             "camera": "navcam", "products": ["r_body"]}))
                    idle.append(slow)
                    while len(idle) > 60:
                        idle.pop(0).socket.close()
                    began = time.monotonic()
                    assert good.render({**STATE, "t_s": float(count)}, "bare").header["t_s"] == count
                    assert time.monotonic() - began < DEADLINE_S
        for framed in idle:
            framed.socket.close()
        raw.close()
        context.term()
        assert process.poll() is None
        assert "Traceback" not in (tmp_path / "server.log").read_text(), "what is wrong is refused, not stumbled over"


def test_a_flood_of_connections_that_say_nothing_lets_a_good_one_in(tmp_path):
    with serving.server(tmp_path, "--tcp", "127.0.0.1:0") as (endpoint, process):
        address = serving.tcp_address(process)
        flood = [socket.create_connection(address) for _ in range(100)]
        with Framed(address) as framed, Client(endpoint) as client:
            header, pixels = framed.ask(msgpack.packb({
                "v": 1, "op": "render", "id": 1, "client": "f", "state": STATE, "camera": "bare"}))
            assert msgpack.unpackb(header)["ok"]
            np.testing.assert_array_equal(np.frombuffer(pixels, np.float32).reshape(32, 32),
                                          client.render(STATE, "bare").pixels)
        for peer in flood:
            peer.close()
