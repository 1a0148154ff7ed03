"""Embree's C interface (version 4), from the library that embreex brings.

embreex's own loop over rays holds the interpreter's lock, and takes twice as long.
"""

from __future__ import annotations

import ctypes
import weakref
from ctypes import c_char_p, c_int, c_size_t, c_ssize_t, c_uint, c_void_p
from functools import cache

import numpy as np

from ...base.errors import DeviceError

# Constants of rtcore_common.h, rtcore_device.h, rtcore_buffer.h, rtcore_geometry.h.
_VERSION_MAJOR, _TRIANGLES, _INDEX, _VERTEX, _UINT3, _FLOAT3, _FILTERED = (
    1, 0, 0, 1, 0x5003, 0x9003, 1 << 3)
_FUNCTIONS = {
    "rtcNewDevice": (c_void_p, c_char_p), "rtcGetDeviceProperty": (c_ssize_t, c_void_p, c_int),
    "rtcGetDeviceError": (c_int, c_void_p), "rtcNewScene": (c_void_p, c_void_p),
    "rtcSetSceneFlags": (None, c_void_p, c_int),
    "rtcNewGeometry": (c_void_p, c_void_p, c_int), "rtcAttachGeometry": (c_uint, c_void_p, c_void_p),
    "rtcSetNewGeometryBuffer": (c_void_p, c_void_p, c_int, c_uint, c_int, c_size_t, c_size_t),
    "rtcCommitGeometry": (None, c_void_p), "rtcReleaseGeometry": (None, c_void_p),
    "rtcCommitScene": (None, c_void_p), "rtcReleaseScene": (None, c_void_p),
    "rtcIntersect8": (None, *[c_void_p] * 4), "rtcOccluded8": (None, *[c_void_p] * 4)}


class EmbreeMesh:
    """Triangles in a scene of their own; released with the object.

    Parameters
    ----------
    vertices : (V, 3)
    facets : (F, 3) int
    has_sides : bool
        Rays may meet facets of one side alone.

    Attributes
    ----------
    scene : int
        The RTCScene.

    Raises
    ------
    DeviceError
        embreex is not installed, not of Embree 4, or has no memory.
    """

    def __init__(self, vertices: np.ndarray, facets: np.ndarray, has_sides: bool = False):
        embree, device = library(), _device()
        self.scene = embree.rtcNewScene(device)
        embree.rtcSetSceneFlags(self.scene, _FILTERED if has_sides else 0)
        self._release = weakref.finalize(self, embree.rtcReleaseScene, self.scene)
        geometry = embree.rtcNewGeometry(device, _TRIANGLES)
        for kind, form, values in ((_VERTEX, _FLOAT3, np.ascontiguousarray(vertices, np.float32)),
                                   (_INDEX, _UINT3, np.ascontiguousarray(facets, np.uint32))):
            memory = embree.rtcSetNewGeometryBuffer(geometry, kind, 0, form, 12, len(values))
            if not memory:
                raise DeviceError(f"Embree has no memory for {len(values)} rows")
            ctypes.memmove(memory, values.ctypes.data, values.nbytes)
        embree.rtcCommitGeometry(geometry)
        embree.rtcAttachGeometry(self.scene, geometry)
        embree.rtcReleaseGeometry(geometry)
        embree.rtcCommitScene(self.scene)
        if (error := embree.rtcGetDeviceError(device)) != 0:
            raise DeviceError(f"Embree failed with error {error} for {len(facets)} facets")


@cache
def library() -> ctypes.CDLL:
    """Embree with its functions declared."""
    try:
        from embreex import rtcore_scene
    except ImportError as error:
        raise DeviceError("rays need embreex, which has no wheel for every machine: pip install embreex") from error
    # A library's symbols are found through those that it needs too.
    embree = ctypes.CDLL(rtcore_scene.__file__)
    try:
        for name, (result, *arguments) in _FUNCTIONS.items():
            function = getattr(embree, name)
            function.restype, function.argtypes = result, arguments
    except AttributeError as error:
        raise DeviceError(f"rays need embreex of Embree 4: pip install -U embreex ({error})") from error
    return embree


@cache
def _device() -> int:
    embree = library()
    device = embree.rtcNewDevice(None)
    if not device or embree.rtcGetDeviceProperty(device, _VERSION_MAJOR) != 4:
        raise DeviceError("rays need embreex of Embree 4: pip install -U embreex")
    return device
