"""CURVE keys: `glrender keygen` makes them, the server admits the clients whose public keys lie in its folder.

    FOLDER/server.key           public: for the clients
    FOLDER/server.key_secret    the server's own
    FOLDER/clients/NAME.key     public: who may ask
    FOLDER/NAME.key_secret      the client's own, to be carried to it by a safe way
"""

from __future__ import annotations

import os
import re
import stat
from pathlib import Path

import zmq.auth
from glrender import ConfigError
from zmq.auth.thread import ThreadAuthenticator


def generate(folder: Path, clients: list[str]) -> list[Path]:
    """Make what is missing of the server's pair and of the clients' pairs; the files written.

    Raises
    ------
    ConfigError
        A name that is no plain word, or a pair of which only one file is there.
    """
    for index, name in enumerate(clients):
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}", name) or name == "server":
            raise ConfigError(f"--client[{index}]", "must be 1 to 64 letters, digits, - and _, and not 'server'", name)
    written = []
    # Secrets must never be readable by others, not even while they are written.
    before = os.umask(0o077)
    try:
        (folder / "clients").mkdir(parents=True, exist_ok=True)
        for name in ["server", *clients]:
            public = folder / "server.key" if name == "server" else folder / "clients" / f"{name}.key"
            secret = folder / f"{name}.key_secret"
            if public.exists() != secret.exists():
                raise ConfigError(str(public if public.exists() else secret), "is one half of a pair",
                                  hint="remove it to make a new pair, or bring the other half back")
            if public.exists():
                continue
            made, made_secret = map(Path, zmq.auth.create_certificates(folder, name))
            made.replace(public)
            made_secret.replace(secret)
            written += [public, secret]
    finally:
        os.umask(before)
    return written


def load_secret(path: Path) -> tuple[bytes, bytes]:
    """Public and secret key of a `.key_secret` file that nobody else can read.

    Raises
    ------
    ConfigError
    """
    try:
        if stat.S_IMODE(path.stat().st_mode) & 0o077:
            raise ConfigError(str(path), "must be readable by its owner alone", hint=f"chmod 600 {path}")
        public, secret = zmq.auth.load_certificate(path)
    except (OSError, ValueError) as error:
        raise ConfigError(str(path), f"is no key file: {error}", hint="glrender keygen makes them") from None
    if secret is None:
        raise ConfigError(str(path), "holds no secret key")
    return public, secret


def protect(socket: zmq.Socket, folder: Path) -> ThreadAuthenticator:
    """Make a socket answer only the clients of a folder, encrypted; stop the authenticator at the end.

    Without an authenticator CURVE encrypts for anyone: it must never be left out.

    Raises
    ------
    ConfigError
        No server key, or no client at all.
    """
    public, secret = load_secret(folder / "server.key_secret")
    if not list((folder / "clients").glob("*.key")):
        raise ConfigError(str(folder / "clients"), "admits no client", hint=f"glrender keygen {folder} --client NAME")
    authenticator = ThreadAuthenticator(socket.context)
    authenticator.start()
    authenticator.configure_curve(domain="*", location=str(folder / "clients"))
    socket.curve_publickey, socket.curve_secretkey = public, secret
    socket.curve_server = True
    return authenticator
