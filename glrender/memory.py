"""Memory that one frame's arrays leave to the next one's."""

from __future__ import annotations

import numpy as np

# Less than what glibc learns from at most: 32 MiB.
_LARGEST_BYTES = 31 << 20


def keep_freed() -> None:
    """Have the C library keep what is freed.

    glibc hands back what is free beyond twice the largest block that it has seen freed, to take it anew page by page:
    where frames are smaller than what they are made of, each of them (500 px of 49k facets: 8.5 ms for 3.7). It is
    shown a large one. Other libraries do not mind.
    """
    np.empty(_LARGEST_BYTES, np.uint8)
