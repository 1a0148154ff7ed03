"""The process behind `glrender-server --view`: what it needs to know comes in one line on standard input."""

from __future__ import annotations

import json
import signal
import socket
import sys
import threading

from glrender_view.serving import serve


def main() -> None:
    """Show the page until standard input ends: the server is gone."""
    # The server ends it, after what it has to do on a signal to the group.
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    told = json.loads(sys.stdin.readline())
    ended = threading.Event()

    def wait_for_the_end() -> None:
        sys.stdin.read()
        ended.set()

    threading.Thread(target=wait_for_the_end, daemon=True).start()
    serve(socket.socket(fileno=told["socket"]), told["token"], told["endpoint"], told["keys"], told["password"], ended)


if __name__ == "__main__":
    main()
