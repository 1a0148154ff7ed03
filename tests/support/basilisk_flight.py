"""A Basilisk simulation as its users write them, run by Basilisk's own Python; it knows nothing of glrender.

A spacecraft flies around a planet that Basilisk measures in the images of its camera: its limb finder finds the edge,
`horizonOpNav` makes the planet's place of it. JSON in, one JSON line out.
"""

from __future__ import annotations

import json
import sys
import time

import numpy as np
from Basilisk.architecture import messaging
from Basilisk.fswAlgorithms import horizonOpNav, limbFinding
from Basilisk.simulation import camera, spacecraft
from Basilisk.utilities import RigidBodyKinematics as rbk
from Basilisk.utilities import SimulationBaseClass, macros, orbitalMotion, simIncludeGravBody, vizSupport

ASKED = {"port": 5556, "mode": "noDisplay", "n_images": 3, "period_s": 10.0, "side_px": 512, "fov_deg": 40.0,
         "f_deg": 60.0, "a_m": 12.0e6, "camera_id": 1, "save": None, "keep": None, "broadcast": None, "custom": None,
         # horizonOpNav takes Mars for an ellipsoid of these radii.
         "body": "mars barycenter", "radius_m": 3396190.0, "polar_ratio": 3376.2 / 3396.19,
         "mu": 4.28283100e13, "off_rad": [0.02, 0.04, 0.3],
         "pause_s": 0.0, "noise": {}, "sun_deg": 40.0, "second": None, "twice": False}
ASKED |= json.load(sys.stdin)


def placed(body, r_m):
    """Give a body a place without SPICE's kernels; the message must outlive this call."""
    payload = messaging.SpicePlanetStateMsgPayload()
    payload.PositionVector, payload.PlanetName = list(r_m), body.planetName
    payload.J20002Pfix = np.identity(3).tolist()
    message = messaging.SpicePlanetStateMsg().write(payload)
    body.planetBodyInMsg.subscribeTo(message)
    return message


simulation = SimulationBaseClass.SimBaseClass()
step = macros.sec2nano(1.0)
process = simulation.CreateNewProcess("process")
process.addTask(simulation.CreateNewTask("task", step), 2)
# After the images of the same step have come.
process.addTask(simulation.CreateNewTask("vision", step), 1)
craft = spacecraft.Spacecraft()
craft.ModelTag = "bskSat"
factory = simIncludeGravBody.gravBodyFactory()
planet = factory.createCustomGravObject(ASKED["body"], ASKED["mu"], radEquator=ASKED["radius_m"],
                                        radiusRatio=ASKED["polar_ratio"])
planet.isCentralBody = True
sun = factory.createSun()
angle = np.radians(ASKED["sun_deg"])
kept = [placed(sun, 1.5e11 * np.array([np.cos(angle), np.sin(angle), 0.1])), placed(planet, np.zeros(3))]
factory.addBodiesTo(craft)
elements = orbitalMotion.ClassicElements()
elements.a, elements.e, elements.i = ASKED["a_m"], 0.01, np.radians(20.0)
elements.Omega, elements.omega, elements.f = np.radians(5.0), np.radians(2.0), np.radians(ASKED["f_deg"])
r_m, v_m_s = orbitalMotion.elem2rv(ASKED["mu"], elements)
craft.hub.r_CN_NInit, craft.hub.v_CN_NInit = r_m.tolist(), v_m_s.tolist()
# The camera's z towards the planet, then off it, by angles that move the disc in the image and turn it.
z = -r_m / np.linalg.norm(r_m)
x = np.cross([0.0, 0.0, 1.0], z)
x /= np.linalg.norm(x)
pointing = np.array([x, np.cross(z, x), z])
sigma_CB = np.array([0.1, -0.2, 0.3])
off = rbk.euler3212C(ASKED["off_rad"][::-1])
craft.hub.sigma_BNInit = rbk.C2MRP(rbk.MRP2C(sigma_CB).T @ off @ pointing).tolist()
simulation.AddModelToTask("task", craft, 10)

eye = camera.Camera()
eye.ModelTag, eye.cameraIsOn, eye.cameraID, eye.parentName = "eye", 1, ASKED["camera_id"], "bskSat"
eye.renderRate, eye.sigma_CB, eye.cameraPos_B = macros.sec2nano(ASKED["period_s"]), sigma_CB.tolist(), [0.0, 0.2, 2.2]
eye.resolution, eye.fieldOfView, eye.skyBox = [ASKED["side_px"]] * 2, np.radians(ASKED["fov_deg"]), "black"
for name, value in ASKED["noise"].items():
    setattr(eye, name, value)
viz = vizSupport.enableUnityVisualization(
    simulation, "task", [craft], **({"saveFile": ASKED["save"]} if ASKED["save"] else {}),
    **({"broadcastStream": True} if ASKED["broadcast"] else {}))
viz.reqPortNumber = str(ASKED["port"])
if ASKED["broadcast"]:
    viz.pubPortNumber = str(ASKED["broadcast"])
viz.settings.ambient = 0.5
if ASKED["mode"]:
    setattr(viz, ASKED["mode"], True)
if ASKED["custom"]:
    vizSupport.createCustomModel(viz, modelPath=ASKED["custom"], simBodiesToModify=[ASKED["body"]])
viz.addCamMsgToModule(eye.cameraConfigOutMsg)
eye.imageInMsg.subscribeTo(viz.opnavImageOutMsgs[0])
if ASKED["twice"]:
    simulation.AddModelToTask("task", viz, 1)
limb = limbFinding.LimbFinding()
limb.ModelTag, limb.cannyThreshLow, limb.cannyThreshHigh, limb.blurrSize, limb.limbNumThresh = "limb", 50, 100, 5, 10
limb.imageInMsg.subscribeTo(eye.imageOutMsg)
horizon = horizonOpNav.horizonOpNav()
horizon.ModelTag, horizon.planetTarget, horizon.noiseSF = "horizon", 2, 20.0
horizon.cameraConfigInMsg.subscribeTo(eye.cameraConfigOutMsg)
horizon.limbInMsg.subscribeTo(limb.opnavLimbOutMsg)
attitude = messaging.NavAttMsg().write(messaging.NavAttMsgPayload())
horizon.attInMsg.subscribeTo(attitude)
for module, priority in ((eye, 5), (limb, 4), (horizon, 3)):
    simulation.AddModelToTask("vision", module, priority)

simulation.InitializeSimulation()
found, seconds = [], 0.0
for k in range(1, ASKED["n_images"] + 1):
    due = macros.sec2nano(k * ASKED["period_s"])
    if ASKED["pause_s"]:
        time.sleep(ASKED["pause_s"])
    began = time.perf_counter()
    # The attitude that the navigation message carries is that of the image.
    simulation.ConfigureStopTime(due - step)
    simulation.ExecuteSimulation()
    state = craft.scStateOutMsg.read()
    payload = messaging.NavAttMsgPayload()
    payload.sigma_BN = state.sigma_BN
    attitude.write(payload, simulation.TotalSim.CurrentNanos)
    simulation.ConfigureStopTime(due)
    simulation.ExecuteSimulation()
    seconds += time.perf_counter() - began
    state, image, measured = craft.scStateOutMsg.read(), eye.imageOutMsg.read(), horizon.opNavOutMsg.read()
    sent = viz.opnavImageOutMsgs[0].read()
    r_true_C = rbk.MRP2C(sigma_CB) @ rbk.MRP2C(np.array(state.sigma_BN)) @ -(
        np.array(state.r_BN_N) + rbk.MRP2C(np.array(state.sigma_BN)).T @ [0.0, 0.2, 2.2])
    r_seen_C = -rbk.MRP2C(sigma_CB) @ np.array(measured.r_BN_B)
    off_deg = np.degrees(np.arctan2(np.linalg.norm(np.cross(r_true_C, r_seen_C)), r_true_C @ r_seen_C))
    found.append({"valid": int(image.valid), "sent": int(sent.valid), "n_bytes": int(sent.imageBufferLength),
                  "measured": int(measured.valid), "n_limb": int(limb.opnavLimbOutMsg.read().numLimbPoints),
                  "off_deg": off_deg, "range_ratio": float(np.linalg.norm(r_seen_C) / np.linalg.norm(r_true_C)),
                  "t_ns": int(sent.timeTag)})
    sys.stdout.write(f"IMAGE {k}\n")
    sys.stdout.flush()
sys.stdout.write("FLIGHT " + json.dumps({"images": found, "seconds": seconds}) + "\n")
