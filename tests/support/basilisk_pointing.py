"""A closed loop of Basilisk's own modules that steers by images, with the numbers of its scenario_OpNavPointLimb.

camera -> limbFinding -> horizonOpNav -> opNavPoint -> mrpFeedback -> rwMotorTorque -> four reaction wheels, after five
minutes of hillPoint. That scenario itself is in no package. As there: orbit, steps, camera, a second camera, gains,
wheels, limits, search rate, and vizInterface twice in its task. Other than there: places of Sun and Mars are written
down for its epoch (SPICE's kernels come from the network), navigation has no noise, Mars is a point mass, and hillPoint
leaves the camera `off_deg` beside the planet, so that the images have something to do. JSON in, one JSON line out.
"""

from __future__ import annotations

import json
import sys

import numpy as np
from Basilisk.architecture import messaging
from Basilisk.fswAlgorithms import (
    attTrackingError,
    hillPoint,
    horizonOpNav,
    limbFinding,
    mrpFeedback,
    opNavPoint,
    rwMotorTorque,
)
from Basilisk.simulation import camera, reactionWheelStateEffector, simpleNav, spacecraft
from Basilisk.utilities import RigidBodyKinematics as rbk
from Basilisk.utilities import (
    SimulationBaseClass,
    fswSetupRW,
    macros,
    orbitalMotion,
    simIncludeGravBody,
    simIncludeRW,
    vizSupport,
)

ASKED = {"port": 5556, "minutes": 15, "prepared_minutes": 5, "off_deg": 9.0} | json.load(sys.stdin)
MU, RADIUS_M, INERTIA = 4.28283100e13, 3396190.0, [900.0, 0.0, 0.0, 0.0, 800.0, 0.0, 0.0, 0.0, 600.0]
# The Sun on 2019-12-12 18:00, from Mars' mean elements, in equatorial axes.
SUN_M = [2.19e11, 0.92e11, 0.40e11]

simulation = SimulationBaseClass.SimBaseClass()
process = simulation.CreateNewProcess("process")
for name, priority, seconds in (("dynamics", 1000, 0.5), ("camera", 999, 60.0), ("hill", 20, 0.5), ("limb", 20, 0.5),
                                ("control", 15, 0.5)):
    process.addTask(simulation.CreateNewTask(name, macros.sec2nano(seconds)), priority)
craft = spacecraft.Spacecraft()
craft.ModelTag, craft.hub.mHub = "bskSat", 750.0
craft.hub.IHubPntBc_B = np.reshape(INERTIA, (3, 3)).tolist()
factory = simIncludeGravBody.gravBodyFactory()
planet = factory.createCustomGravObject("mars barycenter", MU, radEquator=RADIUS_M, radiusRatio=3376.2 / 3396.19)
planet.isCentralBody = True
kept = []
for body, place in ((factory.createSun(), SUN_M), (planet, [0.0, 0.0, 0.0])):
    payload = messaging.SpicePlanetStateMsgPayload()
    payload.PositionVector, payload.PlanetName, payload.J20002Pfix = place, body.planetName, np.identity(3).tolist()
    kept.append(messaging.SpicePlanetStateMsg().write(payload))
    body.planetBodyInMsg.subscribeTo(kept[-1])
factory.addBodiesTo(craft)
elements = orbitalMotion.ClassicElements()
elements.a, elements.e, elements.i = 18.0e6, 0.0, np.radians(20.0)
elements.Omega, elements.omega, elements.f = np.radians(25.0), np.radians(190.0), np.radians(100.0)
r_m, v_m_s = orbitalMotion.elem2rv(MU, elements)
craft.hub.r_CN_NInit, craft.hub.v_CN_NInit, craft.hub.sigma_BNInit = r_m.tolist(), v_m_s.tolist(), [0.0, 0.0, 0.0]
wheels, fitted = reactionWheelStateEffector.ReactionWheelStateEffector(), simIncludeRW.rwFactory()
fswSetupRW.clearSetup()
for azimuth, place in zip(np.radians([45.0, 135.0, 225.0, 315.0]), (
        [0.8, 0.8, 1.79070], [0.8, -0.8, 1.79070], [-0.8, -0.8, 1.79070], [-0.8, 0.8, 1.79070]), strict=True):
    spin = rbk.Mi(-azimuth, 3) @ rbk.Mi(np.radians(40.0), 2) @ [1.0, 0.0, 0.0]
    fitted.create("Honeywell_HR16", spin, maxMomentum=50.0, rWB_B=place)
    fswSetupRW.create(spin, 50.0 / (6000.0 * 2.0 * np.pi / 60.0), 0.2)
fitted.addToSpacecraft("wheels", wheels, craft)
wheels_known = fswSetupRW.writeConfigMessage()
navigation = simpleNav.SimpleNav()
navigation.scStateInMsg.subscribeTo(craft.scStateOutMsg)
for module, priority in ((wheels, 301), (craft, 201), (navigation, 109)):
    simulation.AddModelToTask("dynamics", module, priority)

eyes = []
for number, sigma_CB in ((1, [0.0, 0.0, 0.0]), (3, [0.0, 0.5, 0.0])):
    eye = camera.Camera()
    eye.ModelTag, eye.cameraIsOn, eye.cameraID, eye.parentName = f"eye{number}", 1, number, "bskSat"
    eye.renderRate, eye.resolution, eye.sigma_CB = macros.sec2nano(60.0), [512, 512], sigma_CB
    eye.fieldOfView, eye.cameraPos_B, eye.skyBox, eye.blurParam = np.radians(55.0), [0.0, 0.2, 2.2], "black", 3
    eyes.append(eye)
viz = vizSupport.enableUnityVisualization(simulation, "dynamics", [craft], rwEffectorList=[wheels])
viz.reqPortNumber, viz.noDisplay, viz.settings.ambient = str(ASKED["port"]), True, 0.5
for number, eye in enumerate(eyes):
    viz.addCamMsgToModule(eye.cameraConfigOutMsg)
    eye.imageInMsg.subscribeTo(viz.opnavImageOutMsgs[number])
    simulation.AddModelToTask("camera", eye, 99)
simulation.AddModelToTask("dynamics", viz, 100)

guidance = messaging.AttGuidMsg_C()
guidance.write(messaging.AttGuidMsgPayload())
hill = hillPoint.hillPoint()
hill.transNavInMsg.subscribeTo(navigation.transOutMsg)
kept.append(messaging.EphemerisMsg().write(messaging.EphemerisMsgPayload()))
hill.celBodyInMsg.subscribeTo(kept[-1])
tracking = attTrackingError.attTrackingError()
tracking.attRefInMsg.subscribeTo(hill.attRefOutMsg)
tracking.attNavInMsg.subscribeTo(navigation.attOutMsg)
beside = rbk.euler2(np.radians(ASKED["off_deg"])) @ rbk.euler1(np.pi / 2.0) @ rbk.euler2(np.pi / 2.0)
tracking.sigma_R0R = rbk.C2MRP(beside).tolist()
messaging.AttGuidMsg_C_addAuthor(tracking.attGuidOutMsg, guidance)
limb = limbFinding.LimbFinding()
limb.cannyThreshLow, limb.cannyThreshHigh, limb.blurrSize, limb.limbNumThresh = 50, 100, 5, 0
limb.imageInMsg.subscribeTo(eyes[0].imageOutMsg)
horizon = horizonOpNav.horizonOpNav()
horizon.planetTarget, horizon.noiseSF = 2, 1
horizon.cameraConfigInMsg.subscribeTo(eyes[0].cameraConfigOutMsg)
horizon.limbInMsg.subscribeTo(limb.opnavLimbOutMsg)
horizon.attInMsg.subscribeTo(navigation.attOutMsg)
point = opNavPoint.opNavPoint()
point.smallAngle, point.timeOut, point.omega_RN_B = np.radians(0.001), 1000, [0.001, 0.0, -0.001]
point.alignAxis_C = [0.0, 0.0, 1.0]
point.opnavDataInMsg.subscribeTo(horizon.opNavOutMsg)
point.imuInMsg.subscribeTo(navigation.attOutMsg)
point.cameraConfigInMsg.subscribeTo(eyes[0].cameraConfigOutMsg)
messaging.AttGuidMsg_C_addAuthor(point.attGuidanceOutMsg, guidance)
feedback, shared = mrpFeedback.mrpFeedback(), rwMotorTorque.rwMotorTorque()
feedback.K, feedback.Ki, feedback.P, feedback.integralLimit = 3.5, -1.0, 30.0, -0.2
kept.append(messaging.VehicleConfigMsg().write(messaging.VehicleConfigMsgPayload(ISCPntB_B=INERTIA)))
feedback.vehConfigInMsg.subscribeTo(kept[-1])
feedback.guidInMsg.subscribeTo(guidance)
feedback.rwParamsInMsg.subscribeTo(wheels_known)
feedback.rwSpeedsInMsg.subscribeTo(wheels.rwSpeedOutMsg)
shared.controlAxes_B = np.identity(3).ravel().tolist()
shared.vehControlInMsg.subscribeTo(feedback.cmdTorqueOutMsg)
shared.rwParamsInMsg.subscribeTo(wheels_known)
wheels.rwMotorCmdInMsg.subscribeTo(shared.rwMotorTorqueOutMsg)
for task, modules in (("hill", (hill, tracking)), ("limb", (limb, horizon, point)), ("control", (feedback, shared))):
    for priority, module in enumerate(reversed(modules)):
        simulation.AddModelToTask(task, module, priority + 8)


def off_deg():
    """Angle between the camera's boresight and the planet."""
    state = craft.scStateOutMsg.read()
    to_planet = rbk.MRP2C(np.array(state.sigma_BN)) @ -np.array(state.r_BN_N)
    return float(np.degrees(np.arctan2(np.linalg.norm(to_planet[:2]), to_planet[2])))


simulation.disableTask("limb")
simulation.InitializeSimulation()
found = []
for minute in range(1, ASKED["minutes"] + 1):
    if minute == ASKED["prepared_minutes"] + 1:
        simulation.disableTask("hill")
        simulation.enableTask("limb")
    simulation.ConfigureStopTime(macros.min2nano(minute))
    simulation.ExecuteSimulation()
    found.append({"off_deg": off_deg(), "n_limb": int(limb.opnavLimbOutMsg.read().numLimbPoints)})
sys.stdout.write("FLIGHT " + json.dumps({"images": found}) + "\n")
