"""Drawings of the flow, the detector and the service, as SVG: `python docs/img/concept_figures.py [FOLDER]`."""

from __future__ import annotations

import sys
from html import escape
from pathlib import Path

FOLDER = Path(__file__).parent
BLUE, GREEN, RED, GREY = "#2b6cb0", "#2f855a", "#b0562b", "#555"
_LINE_PX, _EDGE_PX = 17, 9


class Drawing:
    """Boxes of text and arrows between them.

    Parameters
    ----------
    width, height : int [px]
    """

    def __init__(self, width: int, height: int):
        self.size, self.parts = (width, height), []

    def box(self, x: float, y: float, width: float, title: str, lines: tuple[str, ...] = (),
            colour: str = BLUE) -> tuple:
        """A box with a title and lines; returns its edges (x0, y0, x1, y1)."""
        height = _LINE_PX * (1 + len(lines)) + 2 * _EDGE_PX
        self.parts.append(f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="5" fill="{colour}" '
                          f'fill-opacity=".08" stroke="{colour}" stroke-width="1.5"/>')
        self.text(x + width / 2, y + _EDGE_PX + 13, title, colour, bold=True)
        for number, line in enumerate(lines, 1):
            self.text(x + width / 2, y + _EDGE_PX + 13 + _LINE_PX * number, line, "#333")
        return x, y, x + width, y + height

    def text(self, x: float, y: float, words: str, colour: str = "#333", bold: bool = False,
             anchor: str = "middle") -> None:
        """A line of words about, or from, a place."""
        weight = ' font-weight="bold"' if bold else ""
        self.parts.append(f'<text x="{x}" y="{y}" text-anchor="{anchor}" fill="{colour}"{weight}>{escape(words)}'
                          '</text>')

    def arrow(self, *places: tuple[float, float], both: bool = False) -> None:
        """An arrow along places."""
        path = "L".join(f"{x} {y}" for x, y in places)
        start = ' marker-start="url(#a)"' if both else ""
        self.parts.append(f'<path d="M{path}" fill="none" stroke="{GREY}" stroke-width="1.5" marker-end="url(#a)"'
                          f'{start}/>')

    def save(self, path: Path) -> None:
        """Write the SVG."""
        width, height = self.size
        path.write_text(
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" '
            'font-size="13">\n<defs><marker id="a" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" '
            'markerHeight="7" orient="auto-start-reverse"><path d="M0 0L10 5L0 10z" fill="#555"/></marker></defs>\n'
            f'<rect width="{width}" height="{height}" fill="white"/>\n' + "\n".join(self.parts) + "\n</svg>\n",
            encoding="utf-8")


def flow() -> Drawing:
    """From the state vector to the frame."""
    drawing = Drawing(960, 250)
    rows = [("State", ("Sun, spacecraft,", "bodies, time"), GREY),
            ("View", ("geometry in float64,", "regions in sight"), BLUE),
            ("Plan", ("engine, samples,", "predicted error"), BLUE),
            ("Irradiance", ("W/m² of each pixel,", "with range, angles"), BLUE),
            ("Camera", ("optics, detector,", "exposure"), RED), ("Frame", ("digital numbers,", "warnings"), GREEN)]
    edges = [drawing.box(10 + 158 * k, 20, 140, title, lines, colour) for k, (title, lines, colour) in enumerate(rows)]
    for k, (before, after) in enumerate(zip(edges, edges[1:], strict=False)):
        if k != 2:
            drawing.arrow((before[2], 50), (after[0], 50))
    engines = [drawing.box(60 + 290 * k, 150, 260, title, lines) for k, (title, lines) in enumerate((
        ("exact area coverage", ("flat facets in closed form:", "no samples, no aliasing")),
        ("rays", ("2 x 2 a pixel and the Sun's disc,", "more where the contrast asks")),
        ("OpenGL with shadow maps", ("all that a scene can hold;", "uses a GPU where there is one"))))]
    plan, light = edges[2], edges[3]
    for x0, y0, x1, _ in engines:
        middle = (x0 + x1) / 2
        drawing.arrow((plan[0] + 70, plan[3]), (middle - 15, y0))
        drawing.arrow((middle + 15, y0), (light[0] + 70, light[3]))
    drawing.text(480, 240, "the plan chooses an engine for each region of the image, by scene and tolerance alone")
    return drawing


def detector() -> Drawing:
    """From the irradiance to digital numbers, in the order of the light."""
    drawing = Drawing(960, 262)
    rows = [
        [("irradiance", ("bodies, stars, the Sun",), BLUE), ("lens", ("distortion, cosine of", "the field angle"), RED),
         ("spread", ("PSF over each pixel,", "stray light"), RED),
         ("electrons", ("aperture, band,", "quantum efficiency"), RED),
         ("signal", ("smear, pixel response",), GREEN)],
        [("dark current", ("hot and dead pixels",), GREEN), ("shot noise", ("one Poisson draw,", "cosmic rays"), GREEN),
         ("full well", ("clips the charge",), GREEN), ("read noise", ("and fixed offsets",), GREEN),
         ("ADC", ("gain, non-linearity,", "rounding to DN"), GREEN)]]
    for level, row in enumerate(rows):
        edges = [drawing.box(15 + 190 * k, 20 + 110 * level, 165, title, lines, colour)
                 for k, (title, lines, colour) in enumerate(row)]
        for before, after in zip(edges, edges[1:], strict=False):
            drawing.arrow((before[2], before[1] + 25), (after[0], after[1] + 25))
    drawing.arrow((857, 72), (857, 108), (97, 108), (97, 130))
    drawing.text(480, 232, "linear up to the full well; each seed has its own noise, fixed patterns are the detector's")
    drawing.text(480, 250, "frame.stages tells for every step what was modelled and what was skipped, with why")
    return drawing


def service() -> Drawing:
    """Clients, the server's process, its workers, and the way of the pixels."""
    drawing = Drawing(960, 330)
    clients = [drawing.box(15, 20 + 72 * k, 190, title, lines, GREY) for k, (title, lines) in enumerate((
        ("Python client", ("ZeroMQ, CURVE",)), ("MATLAB, Simulink, C", ("framed TCP",)),
        ("browser", ("glrender view, read-only",))))]
    front = drawing.box(330, 56, 170, "front ends", ("header: msgpack", "pixels: raw parts"), BLUE)
    dispatcher = drawing.box(330, 180, 170, "dispatcher", ("queue, deadlines,", "retries, a reply", "to each request"))
    workers = [drawing.box(690, 20 + 88 * k, 200, f"worker {k + 1}", ("renderer, own context,", "copy of the scene"),
                           GREEN) for k in range(3)]
    for _, y0, x1, y1 in clients[:2]:
        drawing.arrow((x1, (y0 + y1) / 2), (front[0], 92), both=True)
    for _, y0, x1, y1 in clients[2:]:
        drawing.arrow((x1, (y0 + y1) / 2), (front[0], 105), both=True)
    drawing.arrow((415, front[3]), (415, dispatcher[1]), both=True)
    for x0, y0, _, y1 in workers:
        drawing.arrow((dispatcher[2], 220), (x0, (y0 + y1) / 2), both=True)
    memory = drawing.box(560, 284, 330, "frames in shared memory", (), RED)
    drawing.arrow((790, workers[2][3]), (790, memory[1]))
    drawing.arrow((memory[0], 301), (285, 301), (285, 120), (330, 120))
    drawing.text(300, 318, "sent without a copy", anchor="start")
    return drawing


if __name__ == "__main__":
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
    for make in (flow, detector, service):
        make().save(out / f"concept_{make.__name__}.svg")
