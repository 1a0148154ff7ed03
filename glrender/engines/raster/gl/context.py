"""An OpenGL context without a display: EGL (a GPU, or Mesa's software rasteriser), then OSMesa."""

from __future__ import annotations

import logging
import re
import threading
from typing import Any

import moderngl

from ....base.errors import ConfigError, DeviceError, ShaderError
from ....base.own_process import OwnProcess
from ....shaders import Source
from .osmesa import OSMesaContext
from .owner import ResourceOwner

log = logging.getLogger(__name__)

BACKENDS = ("egl", "osmesa")
INSTALL_HINT = ("install Mesa: `apt-get install libegl1 libegl-mesa0 libgl1 libgl1-mesa-dri` for EGL, "
                "or `apt-get install libosmesa6` for OSMesa; with a GPU, its driver's EGL library")
# EGL devices that are looked at; an error about one beyond says how many there are.
_MOST_DEVICES = 16
_LIMITS = {"max_texture_px": "GL_MAX_TEXTURE_SIZE", "max_color_attachments": "GL_MAX_COLOR_ATTACHMENTS",
           "max_uniform_block_bytes": "GL_MAX_UNIFORM_BLOCK_SIZE"}


class Context(ResourceOwner):
    """A current OpenGL 3.3 context, the programs compiled in it, and its thread.

    Parameters
    ----------
    backend : {"auto", "egl", "osmesa"}
        "auto" takes the first of EGL and OSMesa that works.
    device_index : int, optional
        Which EGL device; default is the first that works (GPUs come before Mesa's software device).

    Raises
    ------
    ConfigError
        An unknown backend, or a device index that is no such number or not EGL's.
    DeviceError
        Nothing works; the message says why each failed and what to install.
    """

    def __init__(self, backend: str = "auto", device_index: int | None = None):
        super().__init__(self)
        if backend not in ("auto", *BACKENDS):
            raise ConfigError("backend", "must be one of 'auto', 'egl', 'osmesa'", backend)
        if device_index is not None:
            if isinstance(device_index, bool) or not isinstance(device_index, int) or device_index < 0:
                raise ConfigError("device_index", "must be an integer >= 0", device_index)
            if backend == "osmesa":
                raise ConfigError("device_index", "belongs to EGL, osmesa has no devices", device_index)
            backend = "egl"  # a device asked for is not another one
        failures = []
        for name in BACKENDS if backend == "auto" else (backend,):
            try:
                self.gl = _create(name, device_index)
            except Exception as error:  # the drivers raise bare Exception
                failures.append(f"{name}: {error}")
                continue
            self.backend = name
            break
        else:
            raise DeviceError(f"no OpenGL 3.3 context ({'; '.join(failures)}); {INSTALL_HINT}")
        self._is_closed = False
        self.callback(setattr, self, "_is_closed", True)
        self.callback(self.gl.release)
        self._own, self.thread = OwnProcess(), threading.get_ident()
        self._programs: dict[tuple[str, str], moderngl.Program] = {}
        self.surface_programs: dict[tuple, moderngl.Program] = {}
        info = self.gl.info
        self.info: dict[str, Any] = {
            "backend": self.backend, "gl_renderer": info["GL_RENDERER"], "gl_version": info["GL_VERSION"],
            "gl_vendor": info["GL_VENDOR"], **{key: info[name] for key, name in _LIMITS.items()}}
        self.is_software = bool(re.search(r"llvmpipe|softpipe|swrast", info["GL_RENDERER"], re.IGNORECASE))
        log.info("OpenGL by %s: %s, %s", self.backend, info["GL_RENDERER"], info["GL_VERSION"])

    def make_current(self) -> None:
        """Bind the context to this thread; several renderers may share one."""
        if self._is_closed:
            raise DeviceError("this renderer is closed")
        self._own.check()
        if threading.get_ident() != self.thread:
            raise DeviceError("this renderer belongs to another thread; make one renderer per thread")
        self.gl.__enter__()

    def program(self, vertex: Source, fragment: Source) -> moderngl.Program:
        """Compile and link, once per text; owned by the context.

        Raises
        ------
        ShaderError
            The driver's message, in terms of shader files and lines.
        """
        key = (vertex.text, fragment.text)
        if key not in self._programs:
            try:
                program = self.gl.program(vertex_shader=vertex.text, fragment_shader=fragment.text)
            except moderngl.Error as error:
                message = str(error)
                stage = vertex if "vertex_shader" in message else fragment
                raise ShaderError(stage.explain(message)) from None
            self._programs[key] = self.own(program)
        return self._programs[key]


def _create(backend: str, device_index: int | None) -> moderngl.Context:
    if backend == "osmesa":
        return moderngl.create_context(standalone=True, require=330, context=OSMesaContext())
    if device_index is not None:
        return _create_egl(device_index)
    index = 0
    while True:
        try:
            return _create_egl(index)
        except Exception as error:
            found = re.search(r"found (\d+) devices", str(error))
            is_last = index >= (int(found[1]) if found else _MOST_DEVICES)
            if is_last or not re.search(r"0x3|egl", str(error), re.I):
                raise
            log.debug("EGL device %d: %s", index, error)
            index += 1


def _create_egl(index: int) -> moderngl.Context:
    try:
        return moderngl.create_context(standalone=True, require=330, backend="egl", device_index=index)
    except Exception as error:
        # A GPU driver without the old libGL still has the vendor-neutral libOpenGL.
        if "libGL" not in str(error):
            raise
        return moderngl.create_context(standalone=True, require=330, backend="egl", device_index=index,
                                       libgl="libOpenGL.so.0")


def egl_devices() -> list[dict[str, Any]]:
    """The `info` of each EGL device, in the order of `device_index`, or its `error`; empty without EGL."""
    counted = None
    try:
        Context("egl", _MOST_DEVICES).close()
    except DeviceError as error:
        counted = re.search(r"found (\d+) devices", str(error))
    found = []
    for index in range(int(counted[1]) if counted else 0):
        try:
            with Context("egl", index) as context:
                found.append(context.info)
        except DeviceError as error:
            found.append({"backend": "egl", "error": str(error)})
    return found


def probe() -> list[dict[str, Any]]:
    """Open and close one context of each backend, and return its `info`, or its `error`."""
    found = []
    for backend in BACKENDS:
        try:
            with Context(backend) as context:
                found.append(context.info)
        except DeviceError as error:
            found.append({"backend": backend, "error": str(error)})
    return found
