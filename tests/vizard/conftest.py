"""One adapter for the tests that leave it as they find it, and real Basilisk."""

from __future__ import annotations

import json
import os
import re
import subprocess
import urllib.request
from pathlib import Path

import pytest
import vizard_peer as peer
from glrender.base.disk_cache import cache_folder
from missing import missing

FLIGHT = Path(__file__).parents[1] / "support" / "basilisk_flight.py"


class Adapter:
    """A running adapter: its endpoint, process, log and metrics."""

    def __init__(self, folder, endpoint, process):
        self.folder, self.endpoint, self.process = folder, endpoint, process
        self.port = int(endpoint.rpartition(":")[2])

    @property
    def log(self):
        return (self.folder / "vizard.log").read_text()

    def count(self, kind):
        """Messages of a kind since the adapter began."""
        url = self.process.ready_line.split("metrics on ")[1].rstrip(")")
        with urllib.request.urlopen(url, timeout=10) as page:
            found = re.search(rf'messages_total{{kind="{kind}"}} (\d+)', page.read().decode())
        return int(found[1]) if found else 0


@pytest.fixture(scope="package")
def adapter(tmp_path_factory):
    folder = tmp_path_factory.mktemp("adapter")
    with peer.adapter(folder, "--metrics", "0") as (endpoint, process):
        yield Adapter(folder, endpoint, process)


@pytest.fixture
def basilisk():
    """Start a flight in Basilisk's own Python: ``basilisk(port=..., **settings)`` gives the process."""
    python = os.environ.get("GLRENDER_BASILISK") or cache_folder() / "basilisk" / "bin" / "python"
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    try:
        probe = subprocess.run([python, "-c", "from Basilisk.fswAlgorithms import limbFinding"], capture_output=True,
                               text=True, timeout=120, env=environment)
    except FileNotFoundError as error:
        missing(f"BASILISK ({error})", "make basilisk")
    if probe.returncode:
        missing(f"BASILISK'S OPNAV ({probe.stderr.strip().splitlines()[-1]})", "make basilisk")
    began = []

    def start(script=FLIGHT, arguments=(), **settings):
        process = subprocess.Popen([python, str(script), *map(str, arguments)], stdin=subprocess.PIPE,
                                   stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=environment, text=True)
        began.append(process)
        process.stdin.write(json.dumps(settings))
        process.stdin.close()
        return process

    yield start
    for process in began:
        process.kill()
        process.wait()
        process.stdout.close()


@pytest.fixture
def flown(basilisk):
    """What flights found, all at once: ``flown({...}, {...})`` gives each one's images."""
    def fly(*asked):
        processes, found = [basilisk(**each) for each in asked], []
        for process in processes:
            process.stdin = None
            output = process.communicate(timeout=180)[0]
            lines = [line for line in output.splitlines() if line.startswith("FLIGHT ")]
            assert process.returncode == 0 and len(lines) == 1, output[-3000:]
            found.append(json.loads(lines[0].removeprefix("FLIGHT "))["images"])
        return found

    return fly
