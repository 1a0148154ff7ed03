"""A spacecraft circles an asteroid in Basilisk and takes images of it: first_images.py [PORT] [FOLDER]

Run it with Basilisk's Python (`pip install 'bsk[opnav]'`), beside `glrender-vizard examples/basilisk/map.toml`.
"""

import sys
from pathlib import Path

import numpy as np
from Basilisk.architecture import messaging
from Basilisk.simulation import camera, spacecraft
from Basilisk.utilities import RigidBodyKinematics as rbk
from Basilisk.utilities import SimulationBaseClass, macros, orbitalMotion, simIncludeGravBody, vizSupport

port = sys.argv[1] if len(sys.argv) > 1 else "5556"
folder = Path(sys.argv[2] if len(sys.argv) > 2 else "out/basilisk")
folder.mkdir(parents=True, exist_ok=True)

# A task for the flight, and one of lower priority that sees the images of the same step.
simulation = SimulationBaseClass.SimBaseClass()
process = simulation.CreateNewProcess("process")
process.addTask(simulation.CreateNewTask("flight", macros.sec2nano(10.0)), 2)
process.addTask(simulation.CreateNewTask("vision", macros.sec2nano(10.0)), 1)

# The asteroid at the origin and the Sun; Basilisk's messages place them.
factory = simIncludeGravBody.gravBodyFactory()
asteroid = factory.createCustomGravObject("asteroid", 2.36, radEquator=250.0)
asteroid.isCentralBody = True
sun = factory.createSun()
kept = []
for body, place in ((asteroid, [0.0, 0.0, 0.0]), (sun, [3.2e11, 2.4e11, 0.3e11])):
    payload = messaging.SpicePlanetStateMsgPayload()
    payload.PositionVector, payload.PlanetName, payload.J20002Pfix = place, body.planetName, np.identity(3).tolist()
    kept.append(messaging.SpicePlanetStateMsg().write(payload))
    body.planetBodyInMsg.subscribeTo(kept[-1])

# An orbit of 2.5 km, and an attitude whose +Z looks at the asteroid now.
craft = spacecraft.Spacecraft()
craft.ModelTag = "craft"
factory.addBodiesTo(craft)
elements = orbitalMotion.ClassicElements()
elements.a, elements.e, elements.i, elements.Omega, elements.omega, elements.f = 2500.0, 0.0, 0.3, 0.0, 0.0, 0.9
r_m, v_m_s = orbitalMotion.elem2rv(2.36, elements)
craft.hub.r_CN_NInit, craft.hub.v_CN_NInit = list(r_m), list(v_m_s)
z = -np.array(r_m) / np.linalg.norm(r_m)
x = np.cross([0.0, 0.0, 1.0], z) / np.linalg.norm(np.cross([0.0, 0.0, 1.0], z))
craft.hub.sigma_BNInit = rbk.C2MRP(np.array([x, np.cross(z, x), z])).tolist()
simulation.AddModelToTask("flight", craft)

# The camera, and the module that asks Vizard, here glrender-vizard, for its images.
eye = camera.Camera()
eye.ModelTag, eye.cameraIsOn, eye.cameraID, eye.parentName = "eye", 1, 1, craft.ModelTag
eye.resolution, eye.fieldOfView, eye.renderRate = [512, 512], np.radians(16.0), macros.sec2nano(300.0)
viz = vizSupport.enableUnityVisualization(simulation, "flight", [craft])
viz.noDisplay, viz.reqPortNumber = True, port
viz.addCamMsgToModule(eye.cameraConfigOutMsg)
eye.imageInMsg.subscribeTo(viz.opnavImageOutMsgs[0])
eye.saveImages, eye.saveDir = True, f"{folder}/"
simulation.AddModelToTask("vision", eye)

simulation.InitializeSimulation()                      # waits until the adapter answers
simulation.ConfigureStopTime(macros.sec2nano(900.0))
simulation.ExecuteSimulation()
print(f"valid: {eye.imageOutMsg.read().valid}, images: {', '.join(sorted(path.name for path in folder.iterdir()))}")
