"""What the map has painted, taken down at the canvas itself: every stroke and fill, and the pixels they left."""

import math
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.page.results import address_of

# Keeps, for each canvas, the paths that were stroked or filled since it was last cleared.
NOTE_PATHS = """(() => {
  const own = CanvasRenderingContext2D.prototype;
  const after = (name, note) => {
    const method = own[name];
    own[name] = function (...values) {
      method.apply(this, values);
      note(this, ...values);
    };
  };
  const start = (context, part) => context.noted.parts.push(part);
  after("clearRect", ({ canvas }) => (canvas.painted = []));
  after("beginPath", (context) => (context.noted = { parts: [], styles: [] }));
  after("moveTo", (context, x, y) => start(context, { points: [[x, y]], radius: null }));
  after("lineTo", (context, x, y) => context.noted.parts.at(-1).points.push([x, y]));
  after("rect", (context, x, y, w, h) => start(context, { points: [[x, y], [x + w, y + h]], radius: null }));
  after("arc", (context, x, y, radius) => Object.assign(context.noted.parts.at(-1), { points: [[x, y]], radius }));
  after("ellipse", (context, x, y, radius) =>
    Object.assign(context.noted.parts.at(-1), { points: [[x, y]], radius }));
  for (const [name, style] of [["stroke", "strokeStyle"], ["fill", "fillStyle"]]) {
    after(name, (context) => {
      const { canvas, noted } = context;
      if (!noted.styles.length) canvas.painted?.push(noted);
      noted.styles.push([name, context[style], context.lineWidth]);
    });
  }
})()"""

# Positions become those of the screen; `ink` is the strongest alpha of the canvas on the outline of a part.
_READ = """() => [...document.querySelectorAll(".leaflet-pane canvas")].flatMap((canvas) => {
  const { x: left, y: top, width } = canvas.getBoundingClientRect();
  const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", { willReadFrequently: true });
  copy.drawImage(canvas, 0, 0);
  const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
  const ratio = canvas.width / width;
  const alpha = (x, y) => {
    const [column, row] = [Math.floor(ratio * x), Math.floor(ratio * y)];
    const isInside = column >= 0 && row >= 0 && column < canvas.width && row < canvas.height;
    return isInside ? data[4 * (row * canvas.width + column) + 3] : null;
  };
  const outline = ({ points, radius }) => (radius ? [[points[0][0] + radius - 1, points[0][1]]] : points);
  return (canvas.painted ?? []).map(({ parts, styles }) => ({
    styles,
    parts: parts.map((part) => {
      const inks = outline(part).flatMap(([x, y]) =>
        [-1, 0, 1].flatMap((dx) => [-1, 0, 1].map((dy) => alpha(x + dx, y + dy))));
      const known = inks.filter((ink) => ink !== null);
      const points = part.points.map(([x, y]) => [x + left, y + top]);
      return { points, radius: part.radius, ink: known.length ? Math.max(...known) : null };
    }),
  }));
})"""


@dataclass(frozen=True)
class Part:
    """One line, ring or sign of a path.

    Attributes
    ----------
    points : ndarray
        (N, 2) on the screen: the corners, of a ring its middle.
    radius : float or None
        Of a ring; of an ellipse its longer semi-axis.
    ink : int or None
        Alpha of the canvas where it lies, None where it lies outside.
    """

    points: np.ndarray
    radius: float | None
    ink: int | None

    @property
    def middle(self) -> np.ndarray:
        return np.asarray((self.points.min(axis=0) + self.points.max(axis=0)) / 2)


@dataclass(frozen=True)
class Path:
    """What was stroked or filled at once: the parts, and each `("stroke" or "fill", colour, width)`."""

    parts: list[Part]
    styles: list[tuple[str, str, float]]


def painted(page: Any) -> list[Path]:
    """All that the canvases of the map show now; the page must have been opened with `NOTE_PATHS`."""
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return [
        Path(
            [Part(np.array(part["points"]), part["radius"], part["ink"]) for part in path["parts"]],
            [(kind, colour, width) for kind, colour, width in path["styles"]],
        )
        for path in page.evaluate(_READ)
        if path["parts"]
    ]


def screen_of(page: Any, lonlat: Any) -> np.ndarray:
    """Where places must be on the screen, from the address of the page alone: spherical Mercator of 256 px tiles."""
    found = re.search(r"view=([^&]+)", address_of(page))
    assert found, address_of(page)
    zoom, lat, lon = (float(each) for each in found[1].split("/"))
    box = page.locator("#map").bounding_box()
    middle = np.array([box["x"] + box["width"] / 2, box["y"] + box["height"] / 2])
    return middle + mercator(np.atleast_2d(lonlat), zoom) - mercator(np.array([[lon, lat]]), zoom)


def mercator(lonlat: np.ndarray, zoom: float) -> np.ndarray:
    """Pixels of the world at a zoom."""
    y = np.log(np.tan(math.pi / 4 + np.radians(lonlat[:, 1]) / 2)) / (2 * math.pi)
    return np.asarray(256 * 2**zoom * np.stack([lonlat[:, 0] / 360 + 0.5, 0.5 - y], axis=1))


def pixels_per_metre(page: Any) -> float:
    """The scale in the middle of the map."""
    zoom, lat, _ = (float(each) for each in re.search(r"view=([^&]+)", address_of(page))[1].split("/"))  # type: ignore[index]
    return float(256 * 2**zoom / (2 * math.pi * 6378137 * math.cos(math.radians(lat))))
