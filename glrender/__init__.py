"""glrender: headless OpenGL frames for closed-loop navigation around small bodies."""


def __getattr__(name):  # temporary while rooms are being built
    import importlib

    homes = {"Renderer": "renderer", "Image": "renderer", "Body": "scene", "Scene": "scene", "load_scene": "scene",
             "State": "state", "Pose": "state", "Shape": "shape"}
    if name == "PinholeCamera":
        return importlib.import_module("glrender_camera.projection").PinholeCamera
    if name in homes:
        return getattr(importlib.import_module(f"glrender.{homes[name]}"), name)
    if name.endswith("Error"):
        return getattr(importlib.import_module("glrender.errors"), name)
    raise AttributeError(name)
