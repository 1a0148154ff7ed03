"""CURVE keys: `glrender keygen` makes them, the server admits the clients whose public keys lie in its folder.

    FOLDER/server.key           public: for the clients
    FOLDER/server.key_secret    the server's own
    FOLDER/clients/NAME.key     public: who may ask
    FOLDER/NAME.key_secret      the client's own, to be carried to it by a safe way
"""

from __future__ import annotations

import contextlib
import logging
import math
import os
import re
import stat
import time
from pathlib import Path

import zmq
import zmq.auth
from glrender import ConfigError
from zmq.auth.thread import ThreadAuthenticator

log = logging.getLogger(__name__)

# A key that is added or taken away counts after so long [s].
_READ_AGAIN_S = 1.0
# Domain of ZAP (RFC 27): a handler of another domain is not asked.
_DOMAIN = "glrender"


def generate(folder: Path, clients: list[str]) -> list[Path]:
    """Make the pairs that the server and the clients lack; the files written.

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


class Admission:
    """Admission of the clients whose public keys lie in a folder now, and no longer than they lie there.

    Parameters
    ----------
    folder : path

    Raises
    ------
    ConfigError
        No server key, no client at all, or a folder to which others may write.
    """

    def __init__(self, folder: Path):
        self._public, self._secret = load_secret(folder / "server.key_secret")
        self._folder = folder / "clients"
        for each in (folder, self._folder):
            _check_writers(each)
        self._looked_at, self._seen, self._is_settled, self._names = -math.inf, 0, False, {}
        if not self._admitted():
            raise ConfigError(str(self._folder), "admits no client", hint=f"glrender keygen {folder} --client NAME")

    def reload(self) -> None:
        """Read every file anew, also one that was written over."""
        self._looked_at, self._is_settled = -math.inf, False
        self._admitted()

    def callback(self, domain: str, key: bytes) -> bool:
        """Whether a public key (Z85) may connect; called in the authenticator's thread."""
        return key.decode() in self._admitted()

    def name_of(self, user_id: str) -> str:
        """The name of the key file of a message's `User-Id`, its public key; empty if it is not admitted (any more)."""
        return self._admitted().get(user_id, "")

    def protect(self, socket: zmq.Socket) -> ThreadAuthenticator:
        """Make a socket answer these clients alone, encrypted; stop the authenticator at the end.

        Without an authenticator CURVE would encrypt for anyone: where it has gone, ZeroMQ lets nobody in
        (ZMQ_ZAP_ENFORCE_DOMAIN).
        """
        authenticator = ThreadAuthenticator(socket.context)
        authenticator.start()
        authenticator.configure_curve_callback(domain=_DOMAIN, credentials_provider=self)
        socket.zap_domain = _DOMAIN.encode()
        socket.set(zmq.ZAP_ENFORCE_DOMAIN, 1)
        socket.curve_publickey, socket.curve_secretkey = self._public, self._secret
        socket.curve_server = True
        return authenticator

    def _admitted(self) -> dict[str, str]:
        """Names of the key files by `User-Id`, read anew when their folder has changed."""
        now = time.monotonic()
        if now - self._looked_at > _READ_AGAIN_S:
            self._looked_at = now
            try:
                _check_writers(self._folder)
                changed = self._folder.stat().st_mtime_ns
                # Twice: two files may be written within one tick of the clock of files.
                if changed != self._seen or not self._is_settled:
                    self._names = self._read()
                self._seen, self._is_settled = changed, changed == self._seen
            except ConfigError as error:
                log.error("the clients that were known stay, no further one is admitted: %s", error)
            except OSError:
                pass  # without a descriptor for the folder those that were known stay
        return self._names

    def _read(self) -> dict[str, str]:
        found = {}
        for name in sorted(os.listdir(self._folder)):
            # A file that is being written, or has just gone, admits nobody.
            with contextlib.suppress(FileNotFoundError, ValueError):
                if name.endswith(".key"):
                    found[zmq.auth.load_certificate(self._folder / name)[0].decode()] = name.removesuffix(".key")
        return found


def _check_writers(folder: Path) -> None:
    if folder.is_dir() and stat.S_IMODE(folder.stat().st_mode) & 0o022:
        raise ConfigError(str(folder), "must be writable by its owner alone: who writes there admits clients",
                          hint=f"chmod go-w {folder}")
