"""The gallery of real frames beside ours, of what `examples/real_frames/real_frames.py` left in a folder."""

from __future__ import annotations

import csv
import html
from pathlib import Path

_LAW = "Hapke"
# The pose of an image's label, where there is none that others refined on the image.
_POSES = ("refined", "SUM", "label")


def chosen(folder: Path) -> list[tuple[str, str, str, float]]:
    """Body, image, pose and NCC of each image by its best pose, in the order of the bodies and of time."""
    with open(folder / "ncc.csv", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["law"] == _LAW]
    best: dict[tuple[str, str], dict[str, str]] = {}
    for row in rows:
        key = row["body"], row["image"]
        if key not in best or _POSES.index(row["pose"]) < _POSES.index(best[key]["pose"]):
            best[key] = row
    return [(body, image, row["pose"], float(row["ncc"])) for (body, image), row in sorted(best.items())]


def page(folder: Path, home: str) -> str:
    """The section with the pictures, in Markdown; `home` leads from the page to the folder on the site."""
    found = chosen(folder)
    figures = "\n".join(
        f'<figure><img loading="lazy" width="1008" height="352" src="{home}/{html.escape(image)}_{pose}.png" '
        f'alt="{html.escape(image)}: real, rendered, residual"/></figure>' for _, image, pose, _ in found)
    return (f"\n## Gallery\n\nThese are the {len(found)} frames, drawn when the site was built: real, rendered with "
            f"Hapke's law at the best pose, and the residual.\n\n```{{raw}} html\n{figures}\n```\n")
