"""CURVE on the client's side."""

from __future__ import annotations

from pathlib import Path

import zmq
import zmq.auth

Keys = tuple[bytes, bytes, bytes]
"""The client's public and secret keys, and the server's public key."""


def curve_keys(key: Path | None, server_key: Path | None) -> Keys | None:
    """The keys of the two files, or None for a server without CURVE.

    Raises
    ------
    ValueError
        One without the other, or no key file.
    """
    if (key is None) != (server_key is None):
        raise ValueError("key and server_key belong together: this client's secret file, the server's public file")
    if key is None or server_key is None:
        return None
    public, secret = zmq.auth.load_certificate(key)
    server, _ = zmq.auth.load_certificate(server_key)
    if secret is None:
        raise ValueError(f"{key} holds no secret key; `glrender keygen` made it as NAME.key_secret")
    return public, secret, server


def set_curve(socket: zmq.Socket, keys: Keys | None) -> None:
    """Encrypt the messages of this socket."""
    if keys is not None:
        socket.curve_publickey, socket.curve_secretkey, socket.curve_serverkey = keys
