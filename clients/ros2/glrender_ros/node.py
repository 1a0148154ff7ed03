"""`glrender_camera_node`: it draws a frame for each epoch whose poses have come, and publishes it with its camera."""

from __future__ import annotations

from functools import partial

import rclpy
from geometry_msgs.msg import PoseStamped, Vector3Stamped
from glrender_client import Client, GlrenderClientError
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image

from . import conversion

# Seeds of the service that one of ours takes: frames of two seeds never have the same.
_FRAMES_A_SEED = 2**32
_MOST_SEEDS = 2**64 // _FRAMES_A_SEED
_PARAMETERS = {"endpoint": "tcp://127.0.0.1:5555", "camera": "", "output": "dn", "exposure_s": 0.0, "seed": 0,
               "timeout_s": 5.0, "frame_id": "camera_optical_frame"}
_DEPTH = 10


class CameraNode(Node):
    """Poses in, `image_raw` and `camera_info` out; the server's scene names the bodies.

    Raises
    ------
    GlrenderClientError, ValueError
        No server, no such camera, or a seed out of range.
    """

    def __init__(self):
        super().__init__("glrender_camera_node")
        given = {name: self.declare_parameter(name, start).value for name, start in _PARAMETERS.items()}
        self._given, self._n_frames, self._told_lost, self._told_codes = given, 0, 0, set()
        if not 0 <= given["seed"] < _MOST_SEEDS:
            raise ValueError(f"seed: must be from 0 to {_MOST_SEEDS - 1}, got {given['seed']!r}")
        if given["output"] not in ("dn", "irradiance"):
            raise ValueError(f"output: must be 'dn' or 'irradiance', which are images, got {given['output']!r}")
        self._client = Client(given["endpoint"], timeout_s=given["timeout_s"])
        hello = self._client.hello()
        cameras = {each["name"]: each for each in hello["cameras"]}
        name = given["camera"] or (next(iter(cameras)) if len(cameras) == 1 else "")
        if name not in cameras:
            raise ValueError(f"camera: must be one of the server's, {', '.join(cameras)}, got {name!r}")
        self._camera, self._bodies = cameras[name], [each["name"] for each in hello["bodies"]]
        self._epochs = conversion.Epochs(["/sun", "/spacecraft", *self._bodies])
        self._image = self.create_publisher(Image, "image_raw", _DEPTH)
        self._info = self.create_publisher(CameraInfo, "camera_info", _DEPTH)
        self.create_subscription(Vector3Stamped, "sun/position", self._sun_came, _DEPTH)
        # Bodies may be called as they like: the two others' names have a slash.
        for name, path in (("/spacecraft", "spacecraft"), *((body, conversion.topic(body)) for body in self._bodies)):
            self.create_subscription(PoseStamped, f"{path}/pose", partial(self._pose_came, name), _DEPTH)

    def _sun_came(self, message):
        vector = message.vector
        self._came("/sun", message.header.stamp, [vector.x, vector.y, vector.z])

    def _pose_came(self, name, message):
        at, turned = message.pose.position, message.pose.orientation
        self._came(name, message.header.stamp,
                   conversion.pose_of([at.x, at.y, at.z], [turned.x, turned.y, turned.z, turned.w]))

    def _came(self, name, stamp, value):
        stamp = stamp.sec, stamp.nanosec
        epoch = self._epochs.put(name, stamp, value)
        if self._epochs.n_lost > self._told_lost:
            self._told_lost = self._epochs.n_lost
            self.get_logger().warning(f"{self._told_lost} epochs had no pose of each body: they have no image")
        if epoch is None:
            return
        state = conversion.state_of(stamp, epoch["/sun"], epoch["/spacecraft"],
                                    {body: epoch[body] for body in self._bodies})
        of_dn = {"exposure_s": self._given["exposure_s"] or None,
                  "seed": self._given["seed"] * _FRAMES_A_SEED + self._n_frames}
        self._n_frames += 1
        try:
            reply = self._client.render(state, self._camera["name"], output=self._given["output"],
                                        **(of_dn if self._given["output"] == "dn" else {}))
            fields = conversion.image(stamp, self._given["frame_id"], reply.pixels)
        except (GlrenderClientError, ValueError) as error:
            self.get_logger().error(f"no image of {state['t_s']} s: {error}")
            return
        for warning in reply.header["warnings"]:
            if warning["code"] not in self._told_codes:
                self._told_codes.add(warning["code"])
                self.get_logger().warning(f"{state['t_s']} s: {warning['message']} (once for {warning['code']})")
        self._info.publish(conversion.filled(CameraInfo(), conversion.camera_info(
            stamp, self._given["frame_id"], self._camera)))
        self._image.publish(conversion.filled(Image(), fields))

    def destroy_node(self):
        """Close the connection too."""
        self._client.close()
        super().destroy_node()


def main(args=None):
    """Entry point of the console script."""
    rclpy.init(args=args)
    try:
        node = CameraNode()
    except (GlrenderClientError, ValueError) as error:
        rclpy.try_shutdown()
        raise SystemExit(f"glrender_camera_node: {error}") from error
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
