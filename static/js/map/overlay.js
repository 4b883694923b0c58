/**
 * A picture laid on the map by its corners, turned as they are: Leaflet's own image overlay knows no rotation.
 * @module map/overlay
 */
import { DomUtil, Layer, Util } from "../leaflet.js";

/** Options: `opacity`, `pane`. `corners`: lat, lng of top left, top right and bottom left. */
export const TurnedImage = Layer.extend({
  options: { opacity: 1, pane: "pictures" },

  /** @param {string} url @param {Array<[number, number]>} corners @param {any} options */
  initialize(url, corners, options) {
    this._url = url;
    this._corners = corners;
    Util.setOptions(this, options);
  },

  onAdd() {
    this._image = DomUtil.create("img", "leaflet-image-layer turned-image leaflet-zoom-animated", this.getPane());
    this._image.alt = "";
    this._image.onload = () => this._place();
    this._image.src = this._url;
    this.setOpacity(this.options.opacity);
  },

  onRemove() {
    this._image.remove();
  },

  getEvents() {
    return { zoom: this._place, viewreset: this._place, zoomanim: this._animate };
  },

  /** @param {number} opacity */
  setOpacity(opacity) {
    this.options.opacity = opacity;
    if (this._image) this._image.style.opacity = String(opacity);
    return this;
  },

  _place() {
    this._transform((/** @type {any} */ corner) => this._map.latLngToLayerPoint(corner));
  },

  /** @param {any} event */
  _animate(event) {
    this._transform((/** @type {any} */ corner) =>
      this._map._latLngToNewLayerPoint({ lat: corner[0], lng: corner[1] }, event.zoom, event.center),
    );
  },

  /** @param {(corner: [number, number]) => {x: number, y: number}} at */
  _transform(at) {
    const { naturalWidth: w, naturalHeight: h } = this._image;
    if (!w || !this._map) return;
    const [origin, right, down] = this._corners.map(at);
    const matrix = [
      (right.x - origin.x) / w,
      (right.y - origin.y) / w,
      (down.x - origin.x) / h,
      (down.y - origin.y) / h,
      origin.x,
      origin.y,
    ];
    this._image.style.imageRendering = Math.hypot(matrix[0], matrix[1]) > 1 ? "pixelated" : "auto"; // cells stay cells
    this._image.style.transform = `matrix(${matrix.join(",")})`;
  },
});
