"""A closed loop of Basilisk's own modules that steers by images, as scenario_OpNavPointLimb does.

camera -> limbFinding -> horizonOpNav -> opNavPoint -> mrpFeedback -> torque on the hub. That scenario itself is in no
package: its files come from Basilisk's repository, and its planets from SPICE's kernels. JSON in, one JSON line out.
"""

from __future__ import annotations

import json
import sys

import numpy as np
from Basilisk.architecture import messaging
from Basilisk.fswAlgorithms import horizonOpNav, limbFinding, mrpFeedback, opNavPoint
from Basilisk.simulation import camera, extForceTorque, simpleNav, spacecraft
from Basilisk.utilities import RigidBodyKinematics as rbk
from Basilisk.utilities import SimulationBaseClass, macros, orbitalMotion, simIncludeGravBody, vizSupport

ASKED = {"port": 5556, "minutes": 6.0, "period_s": 20.0, "side_px": 512, "off_deg": 9.0} | json.load(sys.stdin)
MU, RADIUS_M, INERTIA = 4.28283100e13, 3396190.0, [900.0, 0.0, 0.0, 0.0, 800.0, 0.0, 0.0, 0.0, 600.0]

simulation = SimulationBaseClass.SimBaseClass()
step = macros.sec2nano(1.0)
process = simulation.CreateNewProcess("process")
for name, priority in (("dynamics", 3), ("vision", 2), ("control", 1)):
    process.addTask(simulation.CreateNewTask(name, step), priority)
craft = spacecraft.Spacecraft()
craft.ModelTag, craft.hub.mHub = "bskSat", 750.0
craft.hub.IHubPntBc_B = np.reshape(INERTIA, (3, 3)).tolist()
factory = simIncludeGravBody.gravBodyFactory()
planet = factory.createCustomGravObject("mars barycenter", MU, radEquator=RADIUS_M, radiusRatio=3376.2 / 3396.19)
planet.isCentralBody = True
kept = []
for body, place in ((factory.createSun(), [1.2e11, 9.0e10, 1.5e10]), (planet, [0.0, 0.0, 0.0])):
    payload = messaging.SpicePlanetStateMsgPayload()
    payload.PositionVector, payload.PlanetName, payload.J20002Pfix = place, body.planetName, np.identity(3).tolist()
    kept.append(messaging.SpicePlanetStateMsg().write(payload))
    body.planetBodyInMsg.subscribeTo(kept[-1])
factory.addBodiesTo(craft)
elements = orbitalMotion.ClassicElements()
elements.a, elements.e, elements.i = 18.0e6, 0.0, np.radians(20.0)
elements.Omega, elements.omega, elements.f = np.radians(25.0), np.radians(190.0), np.radians(180.0)
r_m, v_m_s = orbitalMotion.elem2rv(MU, elements)
craft.hub.r_CN_NInit, craft.hub.v_CN_NInit = r_m.tolist(), v_m_s.tolist()
z = -r_m / np.linalg.norm(r_m)
x = np.cross([0.0, 0.0, 1.0], z) / np.linalg.norm(np.cross([0.0, 0.0, 1.0], z))
off = rbk.euler3212C(np.radians([20.0, ASKED["off_deg"], 0.5 * ASKED["off_deg"]]))
craft.hub.sigma_BNInit = rbk.C2MRP(off @ np.array([x, np.cross(z, x), z])).tolist()
torque = extForceTorque.ExtForceTorque()
craft.addDynamicEffector(torque)
navigation = simpleNav.SimpleNav()
navigation.scStateInMsg.subscribeTo(craft.scStateOutMsg)
for module, priority in ((craft, 10), (torque, 12), (navigation, 9)):
    simulation.AddModelToTask("dynamics", module, priority)

eye = camera.Camera()
eye.ModelTag, eye.cameraIsOn, eye.cameraID, eye.parentName = "eye", 1, 1, "bskSat"
eye.renderRate, eye.resolution = macros.sec2nano(ASKED["period_s"]), [ASKED["side_px"]] * 2
eye.fieldOfView, eye.skyBox, eye.blurParam = np.radians(55.0), "black", 3
viz = vizSupport.enableUnityVisualization(simulation, "dynamics", [craft])
viz.reqPortNumber, viz.noDisplay = str(ASKED["port"]), True
viz.addCamMsgToModule(eye.cameraConfigOutMsg)
eye.imageInMsg.subscribeTo(viz.opnavImageOutMsgs[0])
limb = limbFinding.LimbFinding()
limb.cannyThreshLow, limb.cannyThreshHigh, limb.blurrSize, limb.limbNumThresh = 50, 100, 5, 10
limb.imageInMsg.subscribeTo(eye.imageOutMsg)
horizon = horizonOpNav.horizonOpNav()
horizon.planetTarget, horizon.noiseSF = 2, 20.0
horizon.cameraConfigInMsg.subscribeTo(eye.cameraConfigOutMsg)
horizon.limbInMsg.subscribeTo(limb.opnavLimbOutMsg)
horizon.attInMsg.subscribeTo(navigation.attOutMsg)
point = opNavPoint.opNavPoint()
point.minUnitMag, point.smallAngle, point.timeOut = 0.001, 0.001 * np.pi / 180.0, 1000
point.omega_RN_B, point.opNavAxisSpinRate, point.alignAxis_C = [0.0, 0.0, 0.0], 0.0, [0.0, 0.0, 1.0]
point.opnavDataInMsg.subscribeTo(horizon.opNavOutMsg)
point.imuInMsg.subscribeTo(navigation.attOutMsg)
point.cameraConfigInMsg.subscribeTo(eye.cameraConfigOutMsg)
feedback = mrpFeedback.mrpFeedback()
feedback.K, feedback.Ki, feedback.P, feedback.integralLimit = 3.5, -1.0, 60.0, 0.2
feedback.guidInMsg.subscribeTo(point.attGuidanceOutMsg)
vehicle = messaging.VehicleConfigMsg().write(messaging.VehicleConfigMsgPayload(ISCPntB_B=INERTIA))
feedback.vehConfigInMsg.subscribeTo(vehicle)
torque.cmdTorqueInMsg.subscribeTo(feedback.cmdTorqueOutMsg)
for task, modules in (("vision", (eye, limb, horizon)), ("control", (point, feedback))):
    for priority, module in enumerate(reversed(modules)):
        simulation.AddModelToTask(task, module, priority + 1)


def off_deg():
    """Angle between the camera's boresight and the planet."""
    state = craft.scStateOutMsg.read()
    to_planet = rbk.MRP2C(np.array(state.sigma_BN)) @ -np.array(state.r_BN_N)
    return float(np.degrees(np.arctan2(np.linalg.norm(to_planet[:2]), to_planet[2])))


simulation.InitializeSimulation()
found = []
for minute in range(1, round(ASKED["minutes"]) + 1):
    simulation.ConfigureStopTime(macros.min2nano(minute))
    simulation.ExecuteSimulation()
    found.append({"off_deg": off_deg(), "n_limb": int(limb.opnavLimbOutMsg.read().numLimbPoints)})
sys.stdout.write("FLIGHT " + json.dumps({"images": found}) + "\n")
