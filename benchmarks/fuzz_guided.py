"""Bytes without end for the readers of a stranger's bytes: a value or a GlrenderError, in bounded time and memory.

    python benchmarks/fuzz_guided.py codec --seconds 3600 --corpus out/codec      # also framing, scene, shape, texture

With Atheris (pip install atheris: Linux, Python 3.11 and later) coverage guides what is tried; without it the seeds are
changed blindly. Never RecursionError, MemoryError or another exception, never an error whose text is longer than it may
be. An input that takes longer than 20 s, or memory beyond 2 GiB, ends the run, too. Exit code 0: nothing was found;
else the input lies in the corpus' folder, and `fuzz_guided.py TARGET --input FILE` repeats it.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import logging
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import warnings
from pathlib import Path

try:
    import atheris
except ImportError:
    atheris = None

OURS = ["glrender.scene", "glrender_server.codec", "glrender_server.framing", "glrender_camera.validate",
        "glrender_camera.errors", "glrender_camera.projection", "glrender.emission.tables",
        "glrender.emission.grid_files", "trimesh.exchange"]
SLOWEST_S, MEMORY_BYTES, LONGEST_BYTES = 20, 2 << 30, 1 << 16
MAX_ERROR_CHARACTERS = 4000
TARGETS = ("codec", "framing", "scene", "shape", "texture")


def _packages() -> set[str]:
    return {name.partition(".")[0] for name in OURS}


def _not_ours() -> list[str]:
    """Atheris takes packages as a whole: all their modules but those above. Compiled loops must be left alone."""
    others = []
    for package in _packages():
        folder = Path(importlib.util.find_spec(package).origin).parent
        for path in folder.rglob("*.py"):
            name = ".".join([package, *path.relative_to(folder).with_suffix("").parts]).removesuffix(".__init__")
            if not any(name == ours or name.startswith(f"{ours}.") for ours in OURS):
                others.append(name)
    return others


def bounded_memory() -> None:
    """Limit the memory to what the process has, and 2 GiB: more raises MemoryError."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + MEMORY_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


def blindly(target, seeds: list[bytes], seconds: float, seed: int, folder: Path) -> int:
    """Seeds with bytes changed, cut and joined, without a guide; how many were tried."""
    rng, count, end = random.Random(seed), 0, time.monotonic() + seconds

    def late(*_):
        raise TimeoutError(f"an input took longer than {SLOWEST_S} s")

    signal.signal(signal.SIGALRM, late)
    while time.monotonic() < end:
        data = bytearray(rng.choice(seeds))
        for _ in range(rng.randrange(6)):
            at = rng.randrange(len(data) + 1)
            kind = rng.random()
            if kind < 0.6 and at < len(data):
                data[at] = rng.choice([0, 1, 0x7f, 0x80, 0xff, rng.randrange(256)])
            elif kind < 0.8:
                del data[at:at + rng.randrange(20)]
            else:
                other = rng.choice(seeds)
                start = rng.randrange(len(other) + 1)
                data[at:at] = other[start:start + rng.randrange(200)]
        data = bytes(data[:LONGEST_BYTES])
        signal.alarm(SLOWEST_S)
        try:
            target(data)
        except BaseException:
            (folder / "crash-blind").write_bytes(data)
            raise
        finally:
            signal.alarm(0)
        count += 1
    return count


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("target", choices=TARGETS)
    parser.add_argument("--seconds", type=int, default=60, help="of processor time, guided; else by the clock")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--corpus", type=Path, help="kept between runs; by default a temporary folder")
    parser.add_argument("--input", type=Path, help="one input again")
    parser.add_argument("--blind", action="store_true", help="without Atheris, if it is installed")
    arguments = parser.parse_args()
    guided = atheris is not None and not arguments.blind and not arguments.input
    if guided:
        with atheris.instrument_imports(include=list(_packages()), exclude=_not_ours()):
            import fuzz_targets
    else:
        import fuzz_targets
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as scratch:
        corpus = arguments.corpus or Path(scratch) / "corpus"
        corpus.mkdir(parents=True, exist_ok=True)
        target, seeds = fuzz_targets.made(arguments.target, Path(scratch))

        def demanded(data: bytes) -> None:
            try:
                target(data)
            except fuzz_targets.GlrenderError as error:
                said = str(error)
                if len(said) > MAX_ERROR_CHARACTERS:
                    raise AssertionError(f"an error of {len(said)} characters: {said[:200]}") from None

        if arguments.input:
            demanded(arguments.input.read_bytes())
            return 0
        # Loops are compiled, caches filled, before memory is counted.
        for data in seeds:
            demanded(data)
        bounded_memory()
        if not guided:
            count = blindly(demanded, seeds, arguments.seconds, arguments.seed, corpus)
            sys.stdout.write(json.dumps({"target": arguments.target, "inputs": count, "guided": False}) + "\n")
            return 0
        for number, data in enumerate(seeds):
            (corpus / f"seed-{number}").write_bytes(data)
        count, began = 0, time.process_time()

        def one(data: bytes) -> None:
            nonlocal count
            count += 1
            demanded(data)
            if time.process_time() - began > arguments.seconds:
                # Atheris ends the process and runs nothing behind Fuzz().
                sys.stdout.write(json.dumps({"target": arguments.target, "inputs": count, "guided": True}) + "\n")
                sys.stdout.flush()
                shutil.rmtree(scratch, ignore_errors=True)
                os._exit(0)

        atheris.Setup([sys.argv[0], f"-max_total_time={10 * arguments.seconds + 60}", f"-seed={arguments.seed}",
                       "-verbosity=0", f"-timeout={SLOWEST_S}", f"-max_len={LONGEST_BYTES}",
                       f"-artifact_prefix={corpus}/", f"-rss_limit_mb={MEMORY_BYTES >> 19}", str(corpus)], one)
        atheris.Fuzz()
    return 0


if __name__ == "__main__":
    sys.exit(main())
