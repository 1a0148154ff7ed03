"""Basilisk's limb finder and horizonOpNav on pictures in files, run by Basilisk's own Python; no simulation flies.

The settings are those of basilisk_flight.py; the camera's axes are the spacecraft's. JSON in, one JSON line out: the
place of Mars in camera axes [m], or null.
"""

from __future__ import annotations

import json
import sys

import numpy as np
from Basilisk.architecture import messaging
from Basilisk.fswAlgorithms import horizonOpNav, limbFinding
from Basilisk.utilities import SimulationBaseClass, macros

ASKED = json.load(sys.stdin)
found = []
for path in ASKED["pictures"]:
    simulation = SimulationBaseClass.SimBaseClass()
    process = simulation.CreateNewProcess("process")
    process.addTask(simulation.CreateNewTask("vision", macros.sec2nano(1.0)))
    config = messaging.CameraConfigMsgPayload()
    config.cameraID, config.fieldOfView = 1, float(np.radians(ASKED["fov_deg"]))
    config.resolution, config.sigma_CB = [ASKED["side_px"]] * 2, [0.0, 0.0, 0.0]
    attitude = messaging.NavAttMsgPayload()
    attitude.sigma_BN = ASKED["sigma_BN"]
    written = messaging.CameraConfigMsg().write(config), messaging.NavAttMsg().write(attitude)
    image = messaging.CameraImageMsg().write(messaging.CameraImageMsgPayload())
    limb = limbFinding.LimbFinding()
    limb.ModelTag, limb.filename = "limb", path
    limb.cannyThreshLow, limb.cannyThreshHigh, limb.blurrSize, limb.limbNumThresh = 50, 100, 5, 10
    limb.imageInMsg.subscribeTo(image)
    horizon = horizonOpNav.horizonOpNav()
    horizon.ModelTag, horizon.planetTarget, horizon.noiseSF = "horizon", 2, 20.0
    horizon.cameraConfigInMsg.subscribeTo(written[0])
    horizon.attInMsg.subscribeTo(written[1])
    horizon.limbInMsg.subscribeTo(limb.opnavLimbOutMsg)
    simulation.AddModelToTask("vision", limb, 2)
    simulation.AddModelToTask("vision", horizon, 1)
    simulation.InitializeSimulation()
    simulation.ConfigureStopTime(0)
    simulation.ExecuteSimulation()
    measured = horizon.opNavOutMsg.read()
    found.append((-np.array(measured.r_BN_C)).tolist() if measured.valid else None)
sys.stdout.write("FLIGHT " + json.dumps({"images": found}) + "\n")
