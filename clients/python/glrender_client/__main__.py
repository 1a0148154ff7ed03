"""Send the requests of a recording again, and compare the replies."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from .errors import GlrenderClientError
from .recording import replay


def main(argv: list[str] | None = None) -> int:
    """Replay a file; 1 if a reply differs."""
    parser = argparse.ArgumentParser(prog="python -m glrender_client", description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("endpoint", nargs="?", default="tcp://127.0.0.1:5555")
    arguments = parser.parse_args(argv)
    results = []
    try:
        for result in replay(arguments.file, arguments.endpoint):
            results.append(result)
            if result is not None:
                sys.stdout.write(f"exchange {result.index}, request {result.id}: {result.what}\n")
    except (GlrenderClientError, OSError) as error:
        sys.stderr.write(f"{error}\n")
        return 1
    n_different = sum(result is not None for result in results)
    sys.stdout.write(f"{len(results)} exchanges, {n_different} differ\n")
    return int(n_different > 0)


if __name__ == "__main__":
    sys.exit(main())
