/** The choice of where longitude and latitude come from: the GNSS of the drive, or the roads of the map. */
import { getConfig } from "../api.js";
import { field } from "../controls.js";
import { el } from "../dom.js";

/** @typedef {{lat_deg: number, lon_deg: number, radius_km: number}} Near Where to search. */
/** @typedef {{georeference: "drive"|"map", near: Near | null}} Placing As a job has it. */

/** @param {Placing | null} before What was chosen before. @param {() => void} onChange */
export function placingField(before, onChange) {
  const wanted = before?.georeference === "map";
  let isTouched = before !== null;
  let isFetched = false;
  const change = () => {
    more.hidden = !box.checked;
    onChange();
  };
  const box = el("input", { type: "checkbox", checked: wanted, onChange: () => ((isTouched = true), change()) });
  const text = el("span", [
    "Place the drive on the map by its roads",
    el("small", "For a drive without GNSS: its shape and its intersections tell where it was, or it is refused."),
  ]);
  const at = before?.near ? `${before.near.lat_deg}, ${before.near.lon_deg}` : "";
  const near = el("input", { type: "text", placeholder: "anywhere on the map", value: at, onInput: onChange });
  const { minimum: min, maximum: max, default: usual } = getConfig().search_radius_km;
  const value = before?.near?.radius_km ?? usual;
  const radius = el("input", { type: "number", min, max, step: "any", required: true, value, onInput: onChange });
  const more = el("div.stack-s.more", { hidden: !wanted }, [
    field("Roughly where: latitude, longitude", near, "In degrees, for example 49.01, 8.43. Makes the search sure."),
    field("How far around [km]", radius),
  ]);
  const element = el("div.stack-s", el("label.check", box, text), more);

  /** @returns {Near | null | undefined} undefined: what stands there is no place. */
  function readNear() {
    if (!near.value.trim()) return null;
    const parts = near.value.split(/[\s,;]+/).filter(Boolean);
    const [lat, lon] = parts.map(Number);
    const isPlace = parts.length === 2 && Math.abs(lat) <= 89 && Math.abs(lon) <= 180;
    return isPlace ? { lat_deg: lat, lon_deg: lon, radius_km: Number(radius.value) } : undefined;
  }

  return {
    element,
    isOn: () => box.checked && !element.hidden,
    /** @param {"none"|"file"|"overpass"} map Which map there is: without one, there is nothing to place a drive on. */
    setMap(map) {
      element.hidden = map === "none";
      isFetched = map === "overpass";
    },
    /** Choose it where it is the only way to a place on earth, unless a person has chosen. @param {boolean} isNeeded */
    suggest(isNeeded) {
      if (isTouched || box.checked === isNeeded) return;
      box.checked = isNeeded;
      more.hidden = !isNeeded;
    },
    /** What has to be changed first, in words. @returns {string | null} */
    complaint() {
      if (!box.checked || element.hidden) return null;
      const place = readNear();
      if (place === undefined) return "Roughly where the drive was: give latitude and longitude, or nothing.";
      if (place === null && isFetched) return "Say roughly where the drive was: the map of which place is fetched?";
      return radius.validity.valid ? null : "How far around: 0.1 to 20 km.";
    },
    /** @returns {Placing} */
    read: () =>
      box.checked && !element.hidden
        ? { georeference: "map", near: readNear() ?? null }
        : { georeference: "drive", near: null },
  };
}
