/**
 * One canvas under the map on which everything of a result is drawn at once: ten thousand symbols cost a few
 * milliseconds per frame at rest and nothing while the map is dragged, since the canvas is larger than what is seen.
 * Leaflet's own canvas keeps an object per symbol: ten thousand take ten times as long to make, and twice as long to zoom.
 */
import { Browser, DomUtil, Renderer } from "../leaflet.js";

/**
 * Draws by a callback: `paint(context, view)` with `view.x(x), view.y(y)` from positions projected at zoom 0 to pixels.
 *
 * Built on Leaflet's own base of canvas and SVG renderers, which knows when to redraw and how to follow a zoom.
 */
export const Surface = Renderer.extend({
  options: { padding: 0.35, pane: "overlayPane" },

  /** @param {(context: CanvasRenderingContext2D, view: View) => void} paint @param {any} options */
  initialize(paint, options) {
    Renderer.prototype.initialize.call(this, options);
    this._paint = paint;
  },

  /** Draw again at the next frame. */
  redraw() {
    if (!this._map || this._request) return;
    this._request = requestAnimationFrame(() => {
      this._request = null;
      if (this._map) this._draw();
    });
  },

  _initContainer() {
    this._container = document.createElement("canvas");
    this._context = this._container.getContext("2d");
  },

  _destroyContainer() {
    cancelAnimationFrame(this._request);
    this._request = null;
    this._container.remove();
    delete this._context;
  },

  _update() {
    if (this._map._animatingZoom && this._bounds) return;
    Renderer.prototype._update.call(this);
    const { min } = this._bounds;
    const size = this._bounds.getSize();
    const ratio = Browser.retina ? 2 : 1;
    DomUtil.setPosition(this._container, min);
    if (this._container.width !== ratio * size.x || this._container.height !== ratio * size.y) {
      this._container.width = ratio * size.x;
      this._container.height = ratio * size.y;
      this._container.style.width = `${size.x}px`;
      this._container.style.height = `${size.y}px`;
    }
    this._ratio = ratio;
    this._draw();
  },

  _draw() {
    const size = this._bounds.getSize();
    this._context.setTransform(this._ratio, 0, 0, this._ratio, 0, 0);
    this._context.clearRect(0, 0, size.x, size.y);
    this._paint(this._context, new View(this._map, this._map.getPixelOrigin().add(this._bounds.min), size));
  },

  _onZoomEnd() {},
  _updatePaths() {},
});

/** Where things are on a canvas. */
export class View {
  /**
   * @param {any} map
   * @param {{x: number, y: number}} origin Of the canvas, in pixels of the world at the zoom of the map.
   * @param {{x: number, y: number}} size
   */
  constructor(map, origin, size) {
    const zoom = map.getZoom();
    const { crs } = map.options;
    this.zoom = zoom;
    this.scale = crs.scale(zoom) / crs.scale(0);
    this.origin = origin;
    this.size = size;
    const world = crs.code === "EPSG:3857" ? 40075016.686 * Math.cos((map.getCenter().lat * Math.PI) / 180) : 1; // metres
    /** Pixels per metre in the middle of the map. */
    this.perMetre = crs.scale(zoom) / world;
  }

  /** @param {number} x Projected at zoom 0. @returns {number} Pixels. */
  x(x) {
    return x * this.scale - this.origin.x;
  }

  /** @param {number} y */
  y(y) {
    return y * this.scale - this.origin.y;
  }

  /** @param {number} x Pixels. @param {number} y @param {number} [margin] */
  shows(x, y, margin = 20) {
    return x > -margin && y > -margin && x < this.size.x + margin && y < this.size.y + margin;
  }
}
