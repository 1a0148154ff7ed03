"""OpenGL without EGL: a context of Mesa's off-screen library (libOSMesa) for moderngl.

Mesa ships it up to 25.0. The drawing buffer that OSMesa insists on is one pixel wide;
glrender draws into its own framebuffers.
"""

from __future__ import annotations

import ctypes
import ctypes.util

from ....base.errors import DeviceError

_OSMESA_FORMAT, _OSMESA_PROFILE, _OSMESA_CORE_PROFILE = 0x22, 0x33, 0x34
_OSMESA_DEPTH_BITS = 0x30
_OSMESA_MAJOR, _OSMESA_MINOR = 0x36, 0x37
_GL_RGBA, _GL_UNSIGNED_BYTE = 0x1908, 0x1401


def find_osmesa() -> str | None:
    """File name of libOSMesa, or None."""
    for name in (ctypes.util.find_library("OSMesa"), "libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so"):
        if name:
            try:
                ctypes.CDLL(name)
            except OSError:
                continue
            return name
    return None


class OSMesaContext:
    """The object that `moderngl.create_context(context=...)` asks for functions and a current context."""

    def __init__(self):
        name = find_osmesa()
        if name is None:
            raise DeviceError("libOSMesa was not found")
        library = ctypes.CDLL(name)
        library.OSMesaCreateContextAttribs.restype = ctypes.c_void_p
        library.OSMesaCreateContextAttribs.argtypes = [ctypes.POINTER(ctypes.c_int), ctypes.c_void_p]
        library.OSMesaMakeCurrent.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int,
                                              ctypes.c_int]
        library.OSMesaMakeCurrent.restype = ctypes.c_ubyte
        library.OSMesaDestroyContext.argtypes = [ctypes.c_void_p]
        library.OSMesaDestroyContext.restype = None
        library.OSMesaGetProcAddress.argtypes = [ctypes.c_char_p]
        library.OSMesaGetProcAddress.restype = ctypes.c_void_p
        attributes = [_OSMESA_FORMAT, _GL_RGBA, _OSMESA_DEPTH_BITS, 24, _OSMESA_PROFILE, _OSMESA_CORE_PROFILE,
                      _OSMESA_MAJOR, 3, _OSMESA_MINOR, 3, 0]
        self._library = library
        self._context = library.OSMesaCreateContextAttribs((ctypes.c_int * len(attributes))(*attributes), None)
        if not self._context:
            raise DeviceError("OSMesa refused an OpenGL 3.3 core context")
        self._pixel = (ctypes.c_ubyte * 4)()
        self.__enter__()

    def load_opengl_function(self, name: str) -> int:
        return self._library.OSMesaGetProcAddress(name.encode()) or 0

    load = load_opengl_function

    def __enter__(self):
        if not self._library.OSMesaMakeCurrent(self._context, self._pixel, _GL_UNSIGNED_BYTE, 1, 1):
            raise DeviceError("OSMesaMakeCurrent failed")
        return self

    def __exit__(self, *exception):
        return None

    def release(self):
        if self._context:
            self._library.OSMesaDestroyContext(self._context)
            self._context = None
