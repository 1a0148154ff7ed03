"""The ament_python package of the camera node."""

from setuptools import setup

setup(
    name="glrender_ros",
    version="0.1.0",
    packages=["glrender_ros"],
    data_files=[("share/ament_index/resource_index/packages", ["resource/glrender_ros"]),
                ("share/glrender_ros", ["package.xml"])],
    install_requires=["setuptools", "numpy", "pyzmq", "msgpack"],
    license="MIT",
    entry_points={"console_scripts": ["glrender_camera_node = glrender_ros.node:main"]},
)
