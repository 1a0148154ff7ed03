"""The ROS 2 package: messages by rosbags' own serialiser, and the node with a stand-in for rclpy.

rclpy is on no package index, so of the node only its imports and its wiring are tried; its server is a real one.
"""

from __future__ import annotations

import importlib
import re
import sys
import types
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
import serving
from glrender_client import Client
from missing import needed_module
from scipy.spatial.transform import Rotation

ROS2 = Path(__file__).parents[2] / "clients" / "ros2"
STAMP = (1_700_000_000, 123_456_789)
LENS = {"k1": -0.1, "k2": 0.02, "k3": 0.003, "k4": 0.0, "k5": 0.0, "k6": 0.0, "p1": 1e-3, "p2": -2e-3}
CAMERA = {"width_px": 6, "height_px": 4, "focal_length_px": 50.0, "principal_point_px": [2.25, 1.5], "distortion": None}


@pytest.fixture(scope="module")
def conversion():
    sys.path.insert(0, str(ROS2))
    yield importlib.import_module("glrender_ros.conversion")
    sys.path.remove(str(ROS2))


@pytest.fixture(scope="module")
def store():
    """Message types of a ROS 2 distribution."""
    typesys = needed_module("rosbags.typesys", "pip install rosbags")
    return typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)


def made(store, name, fields):
    """A message of plain fields: lists of numbers as the arrays that rosbags wants."""
    inner = {"header": "std_msgs/msg/Header", "stamp": "builtin_interfaces/msg/Time",
             "roi": "sensor_msgs/msg/RegionOfInterest"}
    values = {}
    for key, value in fields.items():
        if key in inner:
            value = made(store, inner[key], value)
        elif key == "data":
            value = np.frombuffer(value, np.uint8)
        elif isinstance(value, list):
            value = np.array(value, float)
        values[key] = value
    return store.types[name](**values)


def through_a_bag(store, folder, name, fields):
    """What a reader finds in a bag that has one message."""
    rosbag2 = needed_module("rosbags.rosbag2", "pip install rosbags")
    with rosbag2.Writer(folder, version=9) as bag:
        connection = bag.add_connection("/topic", name, typestore=store)
        bag.write(connection, STAMP[0] * 10**9, store.serialize_cdr(made(store, name, fields), name))
    with rosbag2.Reader(folder) as bag:
        ((connection, _, data),) = bag.messages()
        return store.deserialize_cdr(data, connection.msgtype)


@pytest.mark.parametrize("dtype, encoding", [("u1", "mono8"), ("<u2", "mono16"), (">u2", "mono16"), ("<f4", "32FC1")])
def test_an_image_survives_a_bag(conversion, store, tmp_path, dtype, encoding):
    """Its pixels are read as sensor_msgs/Image says: rows of `step` bytes, in the byte order of `is_bigendian`."""
    pixels = np.random.default_rng(1).integers(0, 250, (4, 6)).astype(dtype)[:, ::-1]
    found = through_a_bag(store, tmp_path / "bag", "sensor_msgs/msg/Image",
                          conversion.image(STAMP, "optical", pixels))
    assert (found.header.stamp.sec, found.header.stamp.nanosec, found.header.frame_id) == (*STAMP, "optical")
    assert (found.height, found.width, found.encoding, found.is_bigendian) == (4, 6, encoding, 0)
    rows = np.asarray(found.data).reshape(4, found.step)
    kind = {"mono8": "u1", "mono16": "<u2", "32FC1": "<f4"}[encoding]
    np.testing.assert_array_equal(rows.view(kind), pixels)


@pytest.mark.parametrize("pixels", [np.zeros((2, 2)), np.zeros((2, 2, 3), np.uint8)])
def test_other_arrays_are_refused(conversion, pixels):
    with pytest.raises(ValueError, match="must be"):
        conversion.image(STAMP, "", pixels)


@pytest.mark.parametrize("lens, model, d", [
    (None, "plumb_bob", [0.0] * 5), (LENS, "plumb_bob", [-0.1, 0.02, 1e-3, -2e-3, 0.003]),
    ({**LENS, "k5": 0.4}, "rational_polynomial", [-0.1, 0.02, 1e-3, -2e-3, 0.003, 0.0, 0.4, 0.0])])
def test_a_camera_survives_a_bag(conversion, store, tmp_path, lens, model, d):
    found = through_a_bag(store, tmp_path / "bag", "sensor_msgs/msg/CameraInfo",
                          conversion.camera_info(STAMP, "optical", {**CAMERA, "distortion": lens}))
    assert (found.height, found.width, found.distortion_model) == (4, 6, model)
    np.testing.assert_array_equal(found.d, d)
    np.testing.assert_array_equal(np.reshape(found.k, (3, 3)), [[50.0, 0.0, 2.25], [0.0, 50.0, 1.5], [0.0, 0.0, 1.0]])
    np.testing.assert_array_equal(np.reshape(found.p, (3, 4))[:, :3], np.reshape(found.k, (3, 3)))
    np.testing.assert_array_equal(np.reshape(found.r, (3, 3)), np.eye(3))


def test_its_pixels_are_opencvs(conversion):
    """OpenCV, which ROS's image pipeline undistorts by, puts points where glrender's own lens does."""
    import cv2
    from glrender_camera.distortion import BrownConrady

    lens = {**LENS, "k4": 0.01, "k5": -0.02}
    info = conversion.camera_info(STAMP, "", {**CAMERA, "distortion": lens})
    points = np.random.default_rng(2).uniform(-0.3, 0.3, (20, 3)) + [0.0, 0.0, 1.0]
    opencv, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.reshape(info["k"], (3, 3)), np.array(info["d"]))
    ours = 50.0 * BrownConrady(**lens).distort(points[:, :2] / points[:, 2:]) + CAMERA["principal_point_px"]
    np.testing.assert_allclose(opencv[:, 0], ours, atol=1e-9)


def test_a_pose_is_turned_into_a_states(conversion):
    """ROS: the orientation takes the frame's axes, in its own components, to where they are in the parent."""
    turned = Rotation.random(random_state=4)
    pose = conversion.pose_of((1.0, 2.0, 3.0), turned.as_quat())
    ours = Rotation.from_quat(pose["q_from_inertial"], scalar_first=True)
    np.testing.assert_allclose(ours.apply(turned.apply([0.0, 0.0, 1.0])), [0.0, 0.0, 1.0], atol=1e-12)
    state = conversion.state_of((5, 250_000_000), (1, 0, 0), pose, {"a": pose})
    assert state["t_s"] == 5.25 and state["bodies"]["a"]["r_inertial_m"] == [1.0, 2.0, 3.0]


def test_epochs_are_whole(conversion):
    """In any order; one that lacks a message is given up when a later one is whole; memory is bounded."""
    epochs = conversion.Epochs(["a", "b"])
    assert epochs.put("a", (1, 0), 1) is None and epochs.put("b", (2, 0), 2) is None
    assert epochs.put("a", (2, 0), 3) == {"a": 3, "b": 2} and epochs.n_lost == 1
    for k in range(10, 1000):
        assert epochs.put("a", (k, 0), k) is None
    assert 850 < epochs.n_lost < 1000 and epochs.put("b", (999, 0), 0) == {"a": 999, "b": 0}


@pytest.mark.parametrize("name, path", [("itokawa", "itokawa"), ("2nd moon", "_2nd_moon"), ("Bénnu", "B_nnu")])
def test_topics_are_ros_names(conversion, name, path):
    assert conversion.topic(name) == path and re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", path)


class Thing:
    """A message of the stand-in: fields as deep as they are set."""

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return self.__dict__.setdefault(name, Thing())


@pytest.fixture
def node_module(monkeypatch, conversion):
    """The node's module, imported with a stand-in for ROS that keeps what is published and logged."""
    class Node:
        given = {}

        def __init__(self, name):
            self.name, self.subscribed, self.published, self.logged = name, {}, {}, []

        def declare_parameter(self, name, start):
            return types.SimpleNamespace(value=self.given.get(name, start))

        def create_publisher(self, kind, name, depth):
            self.published[name] = []
            return types.SimpleNamespace(publish=self.published[name].append)

        def create_subscription(self, kind, name, callback, depth):
            self.subscribed[name] = callback

        def get_logger(self):
            return types.SimpleNamespace(error=self.logged.append, warning=self.logged.append)

        def destroy_node(self):
            self.published = None

    modules = {"rclpy": {"init": lambda args: None, "try_shutdown": lambda: None}, "rclpy.node": {"Node": Node},
               "geometry_msgs": {}, "geometry_msgs.msg": {"PoseStamped": Thing, "Vector3Stamped": Thing},
               "sensor_msgs": {}, "sensor_msgs.msg": {"Image": Thing, "CameraInfo": Thing}}
    for name, members in modules.items():
        module = types.ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.delitem(sys.modules, "glrender_ros.node", raising=False)
    yield importlib.import_module("glrender_ros.node")
    del sys.modules["glrender_ros.node"]


def message(conversion, stamp, **fields):
    return conversion.filled(Thing(), {"header": conversion.header(stamp, ""), **fields})


def pose(conversion, stamp, r_m, w=1.0):
    return message(conversion, stamp, pose={
        "position": dict(zip("xyz", r_m, strict=True)), "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": w}})


def test_the_node_publishes_what_the_server_draws(node_module, conversion, store, tmp_path):
    """A frame for each whole epoch, with its stamp; what is refused is logged, and the node goes on."""
    with serving.server(tmp_path) as (endpoint, _):
        node_module.CameraNode.given = {"endpoint": endpoint, "camera": "navcam", "seed": 3}
        node = node_module.CameraNode()
        assert set(node.subscribed) == {"sun/position", "spacecraft/pose", "body/pose"}
        for second, w in ((5, 1.0), (6, 2.0), (7, 1.0)):
            stamp = second, 500_000_000
            node.subscribed["body/pose"](pose(conversion, stamp, (0.0, 0.0, 0.0)))
            node.subscribed["spacecraft/pose"](pose(conversion, stamp, (0.0, 0.0, -1500.0), w))
            node.subscribed["sun/position"](message(conversion, stamp, vector={"x": 1e11, "y": 0.0, "z": -1e11}))
        images, infos = node.published["image_raw"], node.published["camera_info"]
        assert [each.header.stamp.sec for each in images] == [each.header.stamp.sec for each in infos] == [5, 7]
        refused, *warned = sorted(node.logged, key=lambda text: "no image" not in text)
        assert "norm must be 1" in refused and "6.5 s" in refused
        assert len(warned) == 1 and "are saturated" in warned[0] and "5.5 s: " in warned[0], "each kind once"
        state = conversion.state_of((5, 500_000_000), (1e11, 0.0, -1e11), conversion.pose_of(
            (0.0, 0.0, -1500.0), (0.0, 0.0, 0.0, 1.0)), {"body": conversion.pose_of((0, 0, 0), (0.0, 0.0, 0.0, 1.0))})
        with Client(endpoint) as client:
            expected = client.render(state, "navcam", output="dn", seed=3 * 2**32).pixels
        pixels = np.frombuffer(images[0].data, "<u2").reshape(images[0].height, images[0].width)
        np.testing.assert_array_equal(pixels, expected)
        assert pixels.max() > 100 and images[0].encoding == "mono16"
        node.destroy_node()


def test_a_node_without_a_server_ends_with_its_reason(node_module):
    node_module.CameraNode.given = {"endpoint": "tcp://127.0.0.1:9", "timeout_s": 0.1}
    with pytest.raises(SystemExit, match="nothing listens there"):
        node_module.main()


@pytest.mark.parametrize("seed", [-1, 2**32, 2**63 - 1])
def test_a_seed_whose_frames_would_have_anothers_noise_is_refused(node_module, seed):
    node_module.CameraNode.given = {"endpoint": "tcp://127.0.0.1:9", "timeout_s": 0.1, "seed": seed}
    with pytest.raises(SystemExit, match=f"seed: must be from 0 to 4294967295, got {seed}"):
        node_module.main()


def test_the_package_is_an_ament_package(monkeypatch):
    """package.xml, setup.py and the node agree on names and version; the marker of ament's index is there."""
    given = {}
    monkeypatch.setitem(sys.modules, "setuptools", types.SimpleNamespace(setup=given.update))
    exec(compile((ROS2 / "setup.py").read_text(), "setup.py", "exec"), {})
    root = ElementTree.parse(ROS2 / "package.xml").getroot()  # noqa: S314 - our own file
    assert root.get("format") == "3" and root.findtext("export/build_type") == "ament_python"
    assert (given["name"], given["version"]) == (root.findtext("name"), root.findtext("version"))
    assert all((ROS2 / path).is_file() for _, paths in given["data_files"] for path in paths)
    assert (ROS2 / given["packages"][0] / "node.py").is_file() and "def main(" in (
        ROS2 / given["packages"][0] / "node.py").read_text()
    assert given["entry_points"]["console_scripts"] == ["glrender_camera_node = glrender_ros.node:main"]
    assert f"$base/lib/{given['name']}" in (ROS2 / "setup.cfg").read_text()
