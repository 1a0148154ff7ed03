"""Mistakes that a type checker tells: one in each line that says which."""

from glrender import PinholeCamera, Pose, Renderer, Scene, State, load_scene, take_frame
from glrender.brdf import Lambert
from glrender.scenario import Times
from glrender_camera import Optics
from glrender_client import Client

pose = Pose(r_inertial_m=[0.0, 0.0, 0.0], q_from_inertia=[1.0, 0.0, 0.0, 0.0])  # expect: call-arg
Pose(r_inertial_m=None)  # expect: arg-type
State(r_sun_inertial_m=[1e11, 0.0, 0.0], spacecraft=pose)  # expect: call-arg
State(r_sun_inertial_m=[1e11, 0.0, 0.0], spacecraft=[0.0, 0.0, 0.0], bodies={})  # expect: arg-type
pose.r_inertial_m = [1.0, 0.0, 0.0]  # expect: misc  # expect: assignment
Lambert(normal_albedo="dark")  # expect: arg-type
PinholeCamera(name="navcam", width_px=512.5, height_px=512, focal_length_px=1e3)  # expect: arg-type
Optics(aperture_m=0.1)  # expect: call-arg
Times(times_s=1.0)  # expect: arg-type
scene = load_scene("scene.toml")
print(scene.camera("navcam").resolution)  # expect: attr-defined
Renderer("scene.toml")  # expect: arg-type
with Renderer(scene) as renderer:
    renderer.render(pose)  # expect: arg-type
    renderer.render(pose.after(1.0), seed=1)  # expect: arg-type  # expect: call-arg
    print(take_frame(renderer, pose).frame.dn)  # expect: arg-type
    image: Scene = renderer.render  # expect: assignment
with Client("tcp://127.0.0.1:5555", timeout="5 s") as client:  # expect: call-arg
    client.render(pose.to_dict(), camera=1)  # expect: arg-type
    print(client.render({}).pixel)  # expect: attr-defined
