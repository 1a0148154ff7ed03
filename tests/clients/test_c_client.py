"""The C client and the C S-function, under the address and undefined-behaviour sanitizers, against live servers."""

from __future__ import annotations

import json
import re
import socket
import subprocess
import threading
from pathlib import Path

import msgpack
import numpy as np
import pytest
import serving
import views
from glrender_client import Client
from octave_runner import REPOSITORY, SCENE, SIMULINK, compiler

STATE = views.state().to_dict()
GOLDEN = {name: [bytes.fromhex(part) for part in parts] for name, parts in json.loads(
    (REPOSITORY / "tests" / "data" / "golden.json").read_text(encoding="ascii")).items()}
HERE = Path(__file__).parent / "c"


@pytest.fixture(scope="module")
def build(tmp_path_factory):
    folder = tmp_path_factory.mktemp("c")
    library = sorted(SIMULINK.glob("glr_*.c"))
    flags = ["-std=c99", "-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-Wall", "-Wextra",
             "-Wno-unused-function", "-Werror", f"-I{SIMULINK}", f"-I{HERE}", "-DMATLAB_MEX_FILE"]

    def built(source):
        program = folder / source.stem
        if not program.exists():
            run = subprocess.run([compiler(), *flags, source, *library, "-o", program, "-lm"], capture_output=True,
                                 text=True)
            assert run.returncode == 0, run.stderr
        return program

    return built


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    with serving.server(tmp_path_factory.mktemp("live"), "--tcp", "127.0.0.1:0", scene=SCENE) as (endpoint, process):
        yield endpoint, serving.tcp_address(process)


def simulate(build, address, out, *, camera="navcam", bodies="body", kind="uint16", size=(64, 96), exposure="0.02",
             seed="7", sample_time="0.5", timeout="20", deadline="0", n_steps=3, state=STATE):
    """Runs the S-function; (exit code, what it said)."""
    host, port = address
    pose = lambda p: [*p["r_inertial_m"], *p["q_from_inertial"]]  # noqa: E731
    numbers = np.array([*state["r_sun_inertial_m"], *pose(state["spacecraft"]),
                        *(x for name in bodies.split(",") for x in pose(state["bodies"][name]))], "<f8")
    run = subprocess.run([build(SIMULINK / "sfun_glrender_c.c"), host, str(port), camera, bodies, kind,
                          *map(str, size), exposure, seed, sample_time, timeout, deadline, str(n_steps), out],
                         input=numbers.tobytes(), capture_output=True, timeout=60)
    assert b"Sanitizer" not in run.stderr and b"runtime error" not in run.stderr, run.stderr.decode()
    return run.returncode, run.stdout.decode() + run.stderr.decode()


@pytest.mark.parametrize("camera, kind, size", [("navcam", "uint16", (64, 96)), ("byte", "uint8", (40, 48)),
                                                ("navcam", "single", (64, 96))])
def test_the_c_s_function_gives_pythons_pixels(build, live, tmp_path, camera, kind, size):
    endpoint, address = live
    code, said = simulate(build, address, tmp_path / "out", camera=camera, kind=kind, size=size)
    assert code == 0
    dtype = {"uint8": np.uint8, "uint16": np.uint16, "single": np.float32}[kind]
    written = np.fromfile(tmp_path / "out", [("image", dtype, size[::-1]), ("facts", float, 4)])
    frames = written["image"]
    assert frames.max() > 0
    with Client(endpoint) as client:
        for k, frame in enumerate(frames):
            options = {} if kind == "single" else {"output": "dn", "exposure_s": 0.02, "seed": 7 * 2**32 + k}
            reply = client.render({**STATE, "t_s": 0.5 * k}, camera, **options)
            np.testing.assert_array_equal(frame.T, reply.pixels)
            np.testing.assert_array_equal(written["facts"][k], [
                reply.header["plan"]["predicted_error"], reply.header.get("exposure_s", np.nan), 0.0,
                len(reply.warnings)])
            assert [f"warning: glrender:{each.code}: {each.message}" for each in reply.warnings] == said.splitlines()


def test_the_c_s_function_says_once_what_is_odd_and_each_time_what_is_late(build, live, tmp_path):
    code, said = simulate(build, live[1], tmp_path / "out", exposure="10", deadline="1e-6")
    assert code == 0 and said.count("warning: ") == said.count("warning: glrender:") == len(set(said.splitlines()))
    assert said.count("warning: glrender:saturated: ") == 1
    facts = np.fromfile(tmp_path / "out", [("image", np.uint16, (96, 64)), ("facts", float, 4)])["facts"]
    np.testing.assert_array_equal(facts[:, 1:3], [[10.0, 1.0]] * 3)
    np.testing.assert_array_equal(facts[:, 3] >= said.count("warning: "), True)


@pytest.mark.parametrize("changes, where, message", [
    ({"camera": "wac"}, "mdlOutputs", "glrender:scene: camera: unknown camera"),
    ({"kind": "uint8"}, "mdlOutputs", "camera navcam gives 64 x 96 uint16, the block expects 64 x 96 uint8"),
    ({"size": (64, 64)}, "mdlOutputs", "the block expects 64 x 64 uint16"),
    ({"state": {**STATE, "r_sun_inertial_m": [float("nan"), 0, 0]}}, "mdlOutputs", "glrender:config: state.r_sun"),
    ({"kind": "double"}, "mdlInitializeSizes", "PixelClass must be"),
    ({"sample_time": "0"}, "mdlInitializeSizes", "SampleTime and Timeout must be > 0"),
    ({"sample_time": "nan"}, "mdlInitializeSizes", "SampleTime and Timeout must be > 0"),
    ({"size": (0, 96)}, "mdlInitializeSizes", "ImageSize must be"),
    ({"size": (64.5, 96)}, "mdlInitializeSizes", "ImageSize must be"),
    ({"size": (64, 1e300)}, "mdlInitializeSizes", "ImageSize must be"),
    *(({"seed": seed}, "mdlInitializeSizes", f"Seed must be an integer from 0 to 2^32 - 1, got {seed}")
      for seed in ("4294967296", "9007199254740992", "-1", "0.5", "nan")),
    ({"exposure": "-1"}, "mdlInitializeSizes", "Exposure_s must be >= 0"),
    ({"deadline": "-1"}, "mdlInitializeSizes", "Deadline_s must be >= 0"),
    ({"deadline": "nan"}, "mdlInitializeSizes", "Deadline_s must be >= 0"),
])
def test_the_c_s_function_says_what_is_wrong_and_frees_all(build, live, tmp_path, changes, where, message):
    code, said = simulate(build, live[1], tmp_path / "out", **changes)
    assert code == 3 and said.startswith(where) and message in said


def test_without_a_server_the_c_s_function_says_how_to_start_one(build, tmp_path):
    code, said = simulate(build, ("127.0.0.1", 1), tmp_path / "out")
    assert code == 3 and "glrender:connection" in said and "glrender-server scene.toml" in said


@pytest.mark.parametrize("shape, size, gives", [
    ([64, 96, 3], 6 * 64 * 96, "64 x 96 x 3"), ([64, 96, 2], 4 * 64 * 96, "64 x 96 x 2"),
    ([96, 64], 2 * 64 * 96, "96 x 64"), ([64, 97], 2 * 64 * 97, "64 x 97")])
def test_an_image_of_other_sizes_never_reaches_the_blocks_output(build, tmp_path, shape, size, gives):
    """The output has 12 KiB, to the byte; three numbers a pixel would write 24 KiB beyond it."""
    def reply(request):
        return array_reply(request, [("image", "uint16", shape, 0, bytes(size))]), True

    with FakeServer(reply) as fake:
        code, said = simulate(build, ("127.0.0.1", fake.port), tmp_path / "out")
    assert code == 3
    assert f"camera navcam gives {gives} uint16, the block expects 64 x 96 uint16" in said


def array_reply(request, arrays):
    """The TCP frame of a sound reply with arrays (name, dtype, shape, frame, bytes)."""
    described = [{"name": name, "dtype": dtype, "shape": shape, "order": "F", "unit": "", "part": k, "frame": frame}
                 for k, (name, dtype, shape, frame, _) in enumerate(arrays, 1)]
    header = msgpack.packb({"v": 1, "op": "render", "id": request["id"], "client": "", "ok": True, "arrays": described})
    return serving.Framed.frame(header, *(data for *_, data in arrays))


class FakeServer:
    """Answers each connection with what `reply` makes of a request, then hangs up or serves on as it says.

    `serve`, if given, writes to the connection whatever it wants instead."""

    def __init__(self, reply, serve=None):
        self.requests, self._reply, self._serve_at_will = [], reply, serve
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *exception):
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join(10.0)

    def _serve(self):
        while True:
            try:
                peer, _ = self._listener.accept()
            except OSError:
                return
            framed = serving.Framed.__new__(serving.Framed)
            framed.socket = peer
            try:
                with peer:
                    peer.settimeout(10.0)
                    while True:
                        (request,) = framed.receive()
                        self.requests.append(msgpack.unpackb(request))
                        if self._serve_at_will:
                            self._serve_at_will(self.requests[-1], peer)
                        data, stays = self._reply(self.requests[-1])
                        peer.sendall(data)
                        if not stays:
                            break
            except (EOFError, OSError):
                pass


def run_many(program, port, count, *more, timeout_s=5.0):
    run = subprocess.run([program, "127.0.0.1", str(port), str(timeout_s), str(count), *map(str, more)],
                         capture_output=True, text=True, errors="replace", timeout=120)
    assert run.returncode == 0, run.stderr
    return run.stdout.splitlines()


def test_the_c_client_reads_and_writes_the_golden_messages(build):
    """Golden replies carry id 7: the client's seventh request."""
    early = serving.Framed.frame(GOLDEN["reply_error"][0].replace(b"\xa2id\x07", b"\xa2id\x00"))
    with FakeServer(lambda r: (early if r["id"] < 7 else GOLDEN["tcp_reply_frame_F"][0], True)) as fake:
        said = run_many(build(HERE / "render_many.c"), fake.port, 7)
    assert said[0] == "error config: state.gamma: unknown key"
    pixels = GOLDEN["reply_frame_F"][1]
    assert said[6] == f"image 2 3 uint16 {sum(pixels)}"
    golden = msgpack.unpackb(GOLDEN["request_render"][0])
    golden.pop("products")
    assert fake.requests[6] == {**golden, "client": fake.requests[6]["client"]}


def test_the_c_client_reads_a_golden_frame_with_warnings(build):
    early = serving.Framed.frame(GOLDEN["reply_error"][0].replace(b"\xa2id\x07", b"\xa2id\x00"))
    with FakeServer(lambda r: (early if r["id"] < 7 else GOLDEN["tcp_reply_warned"][0], True)) as fake:
        said = run_many(build(HERE / "render_many.c"), fake.port, 7)
    assert said[6] == f"image 2 3 float32 {sum(GOLDEN['reply_warned'][1])}"


def test_a_golden_frame_in_shared_memory_is_no_reply_for_the_c_client(build):
    """It never asks for one: an error, not a frame without pixels."""
    reply = GOLDEN["tcp_reply_shared"][0].replace(b"\xa2id\x07", b"\xa2id\x00")
    with FakeServer(lambda r: (reply, True)) as fake:
        said = run_many(build(HERE / "render_many.c"), fake.port, 1)
    assert said[0].startswith("error protocol"), said
    assert "shared" not in fake.requests[0]


WAC = ("wac", "range", 8, 4, 11, 6)
"""Second camera, product of the first and region of the second of the golden request for two frames."""


def test_the_c_client_reads_and_writes_the_golden_messages_of_two_frames(build, tmp_path):
    early = serving.Framed.frame(GOLDEN["reply_error"][0].replace(b"\xa2id\x07", b"\xa2id\x00"))
    with FakeServer(lambda r: (early if r["id"] < 7 else GOLDEN["tcp_reply_frames_F"][0], True)) as fake:
        said = run_many(build(HERE / "render_frames.c"), fake.port, 7, *WAC, tmp_path / "out")
    assert said[0] == "error config: state.gamma: unknown key"
    image, ranges, region = GOLDEN["reply_frames_F"][1:]
    assert said[6] == (f"images | 0 image 2 3 1 uint16 {sum(image)} | 0 range 2 3 1 float64 {sum(ranges)} | "
                       f"1 image 2 3 1 float32 {sum(region)}")
    assert (tmp_path / "out").read_bytes() == image + ranges + region
    assert fake.requests[6] == {**msgpack.unpackb(GOLDEN["request_frames"][0]), "client": fake.requests[6]["client"]}


@pytest.mark.parametrize("product", ["range", "r_body", "facet_id", "sunlit"])
def test_two_cameras_products_and_a_region_are_pythons_pixels(build, live, tmp_path, product):
    endpoint, (_, port) = live
    state = {**msgpack.unpackb(GOLDEN["request_render"][0])["state"]}
    said = run_many(build(HERE / "render_frames.c"), port, 1, "byte", product, 10, 12, 37, 29, tmp_path / "out",
                    timeout_s=30.0)
    assert said[0].startswith("images | 0 image 64 96 1 uint16"), said
    with Client(endpoint) as client:
        whole = client.render(state, "navcam", output="dn", exposure_s=0.1, seed=7, products=[product])
        part = client.render(state, "byte", roi=[10, 12, 37, 29]).pixels
    assert part.max() > part.min()
    expected = [whole.pixels, whole.arrays[product], part]
    assert (tmp_path / "out").read_bytes() == b"".join(array.tobytes("F") for array in expected)


def compared(build, port, tmp_path, frame):
    """Lines of numbers that the C client prints of a frame that is compared."""
    (tmp_path / "frame").write_bytes(frame.astype("<u2").tobytes())
    run = subprocess.run([build(HERE / "compare.c"), "127.0.0.1", str(port), tmp_path / "frame",
                          *map(str, frame.shape)], capture_output=True, text=True, timeout=60)
    assert run.returncode == 0 and "Sanitizer" not in run.stderr, run.stderr
    return [line.split() for line in run.stdout.splitlines()]


def test_a_frame_is_compared_as_python_does_it(build, live, tmp_path):
    frame = np.arange(6, dtype="<u2").reshape(2, 3)
    reply = serving.Framed.frame(GOLDEN["reply_compared"][0].replace(b"\xa2id\x07", b"\xa2id\x00"))
    with FakeServer(lambda r: (reply, True)) as fake:
        lines = compared(build, fake.port, tmp_path, frame)
    assert fake.requests[0] == {**msgpack.unpackb(GOLDEN["request_compare"][0]), "id": 1,
                                "client": fake.requests[0]["client"]}
    assert lines == [["law.normal_albedo", "-1.5", "4", "0.5"], ["gain", "0.25", "0.5", "2"],
                     ["7.25", "6", "1.03125", "0"]]
    endpoint, (_, port) = live
    assert compared(build, port, tmp_path, frame)[0][:3] == ["error", "config:", "compare:"]
    frame = np.random.default_rng(1).integers(0, 3000, (64, 96))
    lines = compared(build, port, tmp_path, frame)
    with Client(endpoint) as client:
        found = client.render(msgpack.unpackb(GOLDEN["request_render"][0])["state"], "navcam", exposure_s=0.1,
                              compare=frame.astype(np.uint16), unknown=["gain"], blur_px=1.5, robust=True).comparison
    assert [line[0] for line in lines[:-1]] == list(found.names) and len(found.names) == 7
    assert np.array_equal(np.array([line[2:] for line in lines[:-1]], float), found.matrix) and found.matrix.all()
    assert np.array_equal([float(line[1]) for line in lines[:-1]], found.vector)
    assert list(map(float, lines[-1])) == [found.chi2, found.n_pixels, found.gain, found.offset_DN]


def test_the_facts_of_a_reply_are_pythons(build, live, tmp_path, monkeypatch):
    """Seeds and lateness by frame, warnings with their frame: the second frame looks at a pixel's corner of nothing."""
    endpoint, (_, port) = live
    state = {**msgpack.unpackb(GOLDEN["request_render"][0])["state"]}
    monkeypatch.setenv("GLR_FACTS", "1")
    said = run_many(build(HERE / "render_frames.c"), port, 1, "byte", "range", 10, 12, 37, 29, tmp_path / "out",
                    timeout_s=30.0)
    with Client(endpoint) as client:
        first, second = client.render_frames(state, [{"camera": "navcam", "output": "dn", "exposure_s": 0.1, "seed": 7},
                                                     {"camera": "byte", "roi": [10, 12, 37, 29]}])
    assert [field.strip() for field in said[1].split("|")][1:3] == ["seed 7 late 1", "seed 0 late 0"]
    expected = [f"{k} {warning['code']}: {warning['message'][:255]}" for k, frame in enumerate((first, second))
                for warning in frame.header["warnings"] if warning["code"] != "tolerance"]
    assert expected and all(text in said[1] for text in expected), (said[1], expected)


def test_the_example_for_42_gives_pythons_pixels(build, live):
    """Its quaternion is scalar last and turns frames; of a state that is refused there is no picture."""
    endpoint, (_, port) = live
    pose, sun = STATE["spacecraft"], STATE["r_sun_inertial_m"]
    w, *xyz = pose["q_from_inertial"]
    line = " ".join(f"{number:.17g}" for number in (1.5, *pose["r_inertial_m"], *(-x for x in xyz), w, *sun))
    lines = f"{line}\n{line.replace(line.split()[1], '1e99')}\n{line}\n".encode()
    run = subprocess.run([build(REPOSITORY / "examples" / "fsw_camera.c"), str(port), "body", "byte"], input=lines,
                         timeout=60, capture_output=True)
    level = {"r_inertial_m": [0.0, 0.0, 0.0], "q_from_inertial": [1.0, 0.0, 0.0, 0.0]}
    with Client(endpoint) as client:
        expected = client.render({**STATE, "t_s": 1.5, "bodies": {"body": level}}, "byte", output="dn").pixels
    picture = b"P5\n48 40\n255\n" + expected.tobytes()
    assert run.returncode == 0 and run.stdout == 2 * picture and expected.max() > 0
    assert run.stderr.startswith(b"1.5 s: config: state.spacecraft.r_inertial_m"), run.stderr


def test_a_refused_frame_is_named(build, live, tmp_path):
    program = build(HERE / "render_frames.c")
    said = run_many(program, live[1][1], 2, "wac", "range", 0, 0, 1, 1, tmp_path / "out", timeout_s=30.0)
    assert len(said) == 2 and said[1].startswith("error scene: frames[1].camera: unknown camera, got 'wac'")
    said = run_many(program, live[1][1], 1, "byte", "range", 0, 0, 99, 1, tmp_path / "out", timeout_s=30.0)
    assert said[0].startswith("error config: frames[1].roi[2]: must be an integer between 0 and 48, got 99")


def test_a_frame_of_another_scene_than_the_one_that_is_meant_is_refused(build, live, tmp_path, monkeypatch):
    program, arguments = build(HERE / "render_frames.c"), ("byte", "range", 0, 0, 1, 1, tmp_path / "out")
    with Client(live[0]) as client:
        monkeypatch.setenv("GLR_SCENE", client.hello()["scene"])
    assert run_many(program, live[1][1], 1, *arguments, timeout_s=30.0)[0].startswith("images")
    monkeypatch.setenv("GLR_SCENE", "0" * 32)
    said = run_many(program, live[1][1], 1, *arguments, timeout_s=30.0)
    assert said[0].startswith("error scene: scene: another scene is served")


def test_a_lost_connection_is_made_anew_once_with_the_same_request(build):
    frame = GOLDEN["tcp_reply_frame_F"][0].replace(b"\xa2id\x07", b"\xa2id\x00")
    answers = iter([(b"GLR1\x01", False), (frame, True), (b"", False), (b"", False), (frame, True)])
    with FakeServer(lambda r: next(answers)) as fake:
        said = run_many(build(HERE / "render_many.c"), fake.port, 3)
    assert [line.split()[0] for line in said] == ["image", "error", "image"] and "connection" in said[1]
    assert fake.requests[0] == fake.requests[1] and fake.requests[2] == fake.requests[3]
    assert [r["id"] for r in fake.requests] == [1, 1, 2, 2, 3]


@pytest.mark.parametrize("name, program, more", [("tcp_reply_frame_F", "render_many.c", ()),
                                                 ("tcp_reply_frames_F", "render_frames.c", (*WAC, "/dev/null"))])
def test_hostile_replies_are_refused_and_never_read_beyond(build, rng, name, program, more):
    """Golden replies with bytes changed, cut or added: a typed error or a sound image, and no sanitizer's word."""
    golden = GOLDEN[name][0].replace(b"\xa2id\x07", b"\xa2id\x00")

    def mutated(request):
        data = bytearray(golden)
        for _ in range(rng.integers(1, 4)):
            data[rng.integers(0, len(data))] = rng.choice([0, 0x7f, 0x80, 0xc1, 0xdd, 0xff, rng.integers(0, 256)])
        if rng.random() < 0.3:
            data = data[:rng.integers(0, len(data))]
        return bytes(data), False

    with FakeServer(mutated) as fake:
        said = run_many(build(HERE / program), fake.port, 300, *more, timeout_s=2.0)
    kinds = [next((kind for kind in ("image", "error connection", "error protocol") if line.startswith(kind)), "other")
             for line in said]
    assert len(said) >= 300 and min(map(kinds.count, ("image", "error connection", "error protocol"))) > 10


def test_a_client_for_one_image_takes_no_other_array(build):
    arrays = [("range", "float64", [1, 2], 0, bytes(16))]
    with FakeServer(lambda r: (array_reply(r, arrays), True)) as fake:
        said = run_many(build(HERE / "render_many.c"), fake.port, 1)
    assert said[0].startswith("error protocol: the first array is range, no image"), said


def test_sizes_beyond_32_bits_are_not_cut(build):
    """2^32 + 1 rows must not be taken for one."""
    arrays = [("image", "uint8", [2**32 + 1, 3], 0, bytes(3))]
    with FakeServer(lambda r: (array_reply(r, arrays), True)) as fake:
        said = run_many(build(HERE / "render_many.c"), fake.port, 1)
    assert said[0].startswith("error protocol: a reply's header"), said


def test_replies_to_others_without_a_pause_end_with_the_timeout(build):
    other = array_reply({"id": 99}, [("image", "uint8", [1, 1], 0, bytes(1))]) * 1000

    def flood(request, peer):
        while True:
            peer.sendall(other)

    with FakeServer(None, serve=flood) as fake:
        said = run_many(build(HERE / "render_many.c"), fake.port, 1, timeout_s=0.5)
    assert said[0].startswith("error timeout"), said


def mex_run(build, arrays):
    """What the MEX function, in a stand-in for MATLAB, says of a reply with these arrays."""
    with FakeServer(lambda r: (array_reply(r, arrays), True)) as fake:
        return run_many(build(HERE / "render_mex.c"), fake.port, 1)[0]


def test_the_mex_function_keeps_each_array_under_its_frame_and_name(build):
    arrays = [("image", "uint16", [2, 3], 0, bytes([1] * 12)), ("r_body", "float32", [2, 3, 3], 0, bytes([2] * 72)),
              ("image", "uint8", [1, 1], 1, bytes([9]))]
    said = mex_run(build, arrays)
    assert re.sub(r" \| header_bytes \d+ \d+", "", said) == "frames | image 6 12 | r_body 18 144 | image 1 9"
    assert said.count("header_bytes") == 2


@pytest.mark.parametrize("names", [("image", "image"), ("",), ("1st",), ("a b",), ("_x",), ("%n%s",),
                                   ("a" * 40, "a" * 40)])
def test_a_servers_names_that_are_no_fields_are_refused_by_the_mex_function(build, names):
    """MATLAB gives -1 for them; writing to field -1 ends it."""
    arrays = [(name, "uint8", [1, 1], 0, bytes(1)) for name in names]
    assert mex_run(build, arrays).startswith("error glrender:protocol: an array is named")


def test_an_array_of_a_frame_that_was_not_asked_for_is_refused_by_the_mex_function(build):
    assert "an image of frame 2 of 2" in mex_run(build, [("image", "uint8", [1, 1], 2, bytes(1))])
