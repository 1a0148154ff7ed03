"""The camera as a co-simulation unit of FMI 3.0, for pythonfmu3."""

from glrender_fmi.camera_unit import ERRORS, CameraUnit, Kinds
from pythonfmu3 import (
    Boolean,
    CoSimulation,
    Float64,
    Fmi3Causality,
    Fmi3Initial,
    Fmi3Slave,
    Fmi3Status,
    Fmi3StepResult,
    Fmi3Variability,
    Int32,
    String,
)


class GlrenderCameraFmi3(Fmi3Slave, CoSimulation):
    """A camera whose frames come from a glrender server."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.description, self.time = "A camera: frames of a glrender server, measured", 0.0
        self.unit = CameraUnit(self.resources)
        self.register_variable(Float64("time", causality=Fmi3Causality.independent,
                                       variability=Fmi3Variability.continuous))
        self.unit.declare(self, Kinds(Float64, Int32, String, Boolean, Fmi3Causality, Fmi3Variability, Fmi3Initial))

    def do_step(self, current_time, step_size):
        self.time = current_time + step_size
        try:
            for warning in self.unit.step(current_time):
                self.log(f"glrender: {warning}", Fmi3Status.warning)
        except ERRORS as error:
            self.log(f"glrender: {error}", Fmi3Status.error)
            return Fmi3StepResult(status=Fmi3Status.error)
        return Fmi3StepResult()

    def terminate(self):
        self.unit.close()
