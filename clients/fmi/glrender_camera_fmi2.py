"""The camera as a co-simulation unit of FMI 2.0, for pythonfmu."""

from xml.etree.ElementTree import Element, SubElement

from glrender_fmi.camera_unit import ERRORS, CameraUnit, Kinds
from pythonfmu import Boolean, Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Integer, Real, String
from pythonfmu.enums import Fmi2Status


class GlrenderCameraFmi2(Fmi2Slave):
    """A camera whose frames come from a glrender server."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.description = "A camera: frames of a glrender server, measured"
        self.unit = CameraUnit(self.resources)
        self.unit.declare(self, Kinds(Real, Integer, String, Boolean, Fmi2Causality, Fmi2Variability, Fmi2Initial))

    def to_xml(self, *options):
        """pythonfmu leaves out that outputs are unknown before the first step."""
        root = super().to_xml(*options)
        structure = root.find("ModelStructure")
        SubElement(structure, "InitialUnknowns").extend(
            Element("Unknown", index=each.get("index")) for each in structure.findall("Outputs/Unknown"))
        return root

    def do_step(self, current_time, step_size):
        try:
            for warning in self.unit.step(current_time):
                self.log(f"glrender: {warning}", Fmi2Status.warning)
        except ERRORS as error:
            self.log(f"glrender: {error}", Fmi2Status.error)
            raise  # pythonfmu knows no milder status with which every master stops
        return True

    def terminate(self):
        self.unit.close()
