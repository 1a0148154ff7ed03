"""Metrics for a Prometheus, on loopback: counters, gauges and histograms of one server."""

from __future__ import annotations

import bisect
import contextlib
import logging
import socket
import threading
from collections import defaultdict, deque
from collections.abc import Callable, Iterable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from .limits import MAX_METRICS_CONNECTIONS

log = logging.getLogger(__name__)

_BUCKETS_S = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0)
# Time over which the rate is averaged [s], and number of durations of which percentiles are computed.
_RATE_S, _N_RECENT = 5.0, 512
# A scrape that does not say within this time what it wants, or stands still, is closed [s].
_REQUEST_S = 1.0


class Histogram:
    """Counts of durations, by a label: written by one thread, read by another.

    Parameters
    ----------
    name : str
        With its unit, ``..._seconds``.
    label : str
    """

    def __init__(self, name: str, label: str):
        self._name, self._label = name, label
        self._counts: dict[str, list[int]] = defaultdict(lambda: [0] * (len(_BUCKETS_S) + 1))
        self._sums: dict[str, float] = defaultdict(float)

    def observe(self, value: str, seconds: float) -> None:
        """Count one duration [s] under a value of the label."""
        self._counts[value][bisect.bisect_left(_BUCKETS_S, seconds)] += 1
        self._sums[value] += seconds

    def lines(self) -> Iterable[str]:
        """In Prometheus' text form."""
        yield f"# TYPE {self._name} histogram"
        for value, counts in dict(self._counts).items():
            total = 0
            for bound, count in zip((*_BUCKETS_S, float("inf")), tuple(counts), strict=True):
                total += count
                text = "+Inf" if bound == float("inf") else f"{bound:g}"
                yield f'{self._name}_bucket{{{self._label}="{escaped(value)}",le="{text}"}} {total}'
            yield f'{self._name}_sum{{{self._label}="{escaped(value)}"}} {self._sums[value]:.9g}'
            yield f'{self._name}_count{{{self._label}="{escaped(value)}"}} {total}'


class Recent:
    """The last durations, and how many there are in a second."""

    def __init__(self):
        self._ended: deque[tuple[float, float]] = deque(maxlen=_N_RECENT)

    def observe(self, now_s: float, seconds: float) -> None:
        """Count one duration that ends now, by a monotonic clock."""
        self._ended.append((now_s, seconds))

    def described(self, now_s: float) -> dict[str, float]:
        """Rate in the last seconds [1/s], and percentiles of the last durations [ms]; empty if there is none."""
        if not self._ended:
            return {}
        since = now_s - _RATE_S
        n_since = sum(1 for ended, _ in self._ended if ended > since)
        # A fast loop has more in that time than are kept.
        span_s = now_s - self._ended[0][0] if n_since == _N_RECENT else _RATE_S
        ordered = sorted(seconds for _, seconds in self._ended)
        at = lambda share: 1e3 * ordered[min(len(ordered) - 1, int(share * len(ordered)))]  # noqa: E731
        return {"per_second": n_since / span_s, "p50_ms": at(0.5), "p95_ms": at(0.95), "p99_ms": at(0.99)}


def counter(name: str, label: str, counts: dict[str, int]) -> Iterable[str]:
    """Lines of a counter with one label."""
    yield f"# TYPE {name} counter"
    for value, count in counts.items():
        yield f'{name}{{{label}="{escaped(value)}"}} {count}'


def gauge(name: str, value: float, kind: str = "gauge") -> Iterable[str]:
    """Lines of one number."""
    yield f"# TYPE {name} {kind}"
    yield f"{name} {value:.9g}"


def escaped(text: str) -> str:
    """A label's value."""
    return text.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")


class _FewConnections(ThreadingHTTPServer):
    """A thread for each connection; of too many the oldest that has asked nothing goes, or else the oldest."""

    daemon_threads = True

    def __init__(self, *arguments: Any):
        self._open: dict[Any, None] = {}
        super().__init__(*arguments)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve one connection in a thread."""
        self._open[request] = None
        while len(self._open) > MAX_METRICS_CONNECTIONS:
            goes = next(filter(_is_silent, self._open), next(iter(self._open)))
            self._open.pop(goes, None)
            with contextlib.suppress(OSError):
                goes.shutdown(socket.SHUT_RDWR)  # its thread closes it
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        """Close a connection, in its thread."""
        self._open.pop(request, None)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say no more of a scrape that was broken off than of any other."""
        log.debug("a scrape was broken off", exc_info=True)


def _is_silent(connection: socket.socket) -> bool:
    """Whether nothing has come on a connection that is not answered yet."""
    try:
        return not connection.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
    except OSError:
        return True


class MetricsServer:
    """Answers `GET /metrics` on 127.0.0.1, in threads of its own.

    Parameters
    ----------
    port : int
        0 takes a free one.
    lines : callable
        The text's lines at this moment.

    Raises
    ------
    OSError
        The port cannot be bound.
    """

    def __init__(self, port: int, lines: Callable[[], Iterable[str]]):
        class Handler(BaseHTTPRequestHandler):
            timeout = _REQUEST_S

            def do_GET(self) -> None:
                # A page in a browser must not read them by a name that it lets point here.
                if self.headers.get("Host", "").partition(":")[0] not in ("127.0.0.1", "localhost"):
                    self.send_error(403)
                    return
                if self.path != "/metrics":
                    self.send_error(404)
                    return
                body = ("\n".join(lines()) + "\n").encode()
                self.send_response(200)
                self.send_header("Content-Type", "text/plain; version=0.0.4; charset=utf-8")
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, form: str, *values: object) -> None:
                log.debug(form, *values)

        try:
            self._server = _FewConnections(("127.0.0.1", port), Handler)
        except OSError as error:
            raise OSError(f"cannot listen on 127.0.0.1:{port}: {error.strerror}; choose another with --metrics, e.g. "
                          f"--metrics 0") from None
        self.endpoint = f"http://127.0.0.1:{self._server.server_address[1]}/metrics"
        self._thread = threading.Thread(target=self._server.serve_forever, name="metrics", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop answering."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
