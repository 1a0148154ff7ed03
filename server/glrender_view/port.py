"""What a page needs before it is shown: its libraries, and a port."""

from __future__ import annotations

import importlib.util
import socket

from glrender import ConfigError

_NEEDED = ("starlette", "uvicorn", "websockets")


def check_installed(option: str) -> None:
    """Refuse to show a page that cannot be shown.

    Raises
    ------
    ConfigError
    """
    for name in _NEEDED:
        if importlib.util.find_spec(name) is None:
            raise ConfigError(option, f"needs {name}, which is not installed", hint="pip install 'glrender[view]'")


def listening(option: str, port: int) -> socket.socket:
    """A socket that listens on 127.0.0.1.

    Raises
    ------
    OSError
        The port cannot be had.
    """
    try:
        return socket.create_server(("127.0.0.1", port))
    except OSError as error:
        raise OSError(f"cannot listen on 127.0.0.1:{port}: {error.strerror}; choose another with {option}, e.g. "
                      f"{option} 0") from None
