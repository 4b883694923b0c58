/** Elements and figures: the small helpers that every part of the page uses. */

const SVG = "http://www.w3.org/2000/svg";

/**
 * Make an element: `el("p.small.quiet", { title }, "text", el("br"))`.
 *
 * Properties, if any, come first, in a plain object. `style` and `dataset` are objects, `on…` is a listener; what the element
 * has as a property is set as one (`value`, `disabled`, `htmlFor`), anything else becomes an attribute (`aria-label`). A value
 * of null, undefined or false leaves it out, as it does of children. Children may be arrays of children.
 *
 * @param {string} selector Tag and classes.
 * @param {...any} content
 * @returns {any} The element.
 */
export function el(selector, ...content) {
  const [tag, ...classes] = selector.split(".");
  return build(document.createElement(tag), classes, content, (element, name, value) => {
    if (name === "style" || name === "dataset") Object.assign(element[name], value);
    else if (name in element && !name.includes("-") && name !== "list" && name !== "form") element[name] = value;
    else element.setAttribute(name, value === true ? "" : String(value));
  });
}

/** Make an SVG element; all properties are attributes but `on…`. @param {string} selector @param {...any} content */
export function svg(selector, ...content) {
  const [tag, ...classes] = selector.split(".");
  const set = (/** @type {Element} */ element, /** @type {string} */ name, /** @type {any} */ value) =>
    element.setAttribute(name, String(value));
  return build(document.createElementNS(SVG, tag), classes, content, set);
}

/**
 * @param {Element} element
 * @param {string[]} classes
 * @param {any[]} content
 * @param {(element: any, name: string, value: any) => void} set
 * @returns {any}
 */
function build(element, classes, content, set) {
  const props = content[0]?.constructor === Object ? content.shift() : {};
  for (const [name, value] of Object.entries(props)) {
    if (value === null || value === undefined || value === false) continue;
    if (name === "class") classes.push(value);
    else if (name.startsWith("on")) element.addEventListener(name.slice(2).toLowerCase(), value);
    else set(element, name, value);
  }
  if (classes.length) element.setAttribute("class", classes.join(" "));
  append(element, content);
  return element;
}

/** @param {Element} parent @param {any[]} children */
function append(parent, children) {
  for (const child of children) {
    if (child === null || child === undefined || child === false) continue;
    if (Array.isArray(child)) append(parent, child);
    else parent.append(child instanceof Node ? child : String(child));
  }
}

/** Put new children in the place of the old ones; what has the focus keeps it, else the panel gets it. @param {Element} parent @param {...any} children */
export function fill(parent, ...children) {
  const nameOf = (/** @type {any} */ each) =>
    each.dataset.key || each.id || each.getAttribute("aria-label") || each.textContent;
  const focused = document.activeElement;
  const name = focused && focused !== parent && parent.contains(focused) ? nameOf(focused) : null;
  parent.replaceChildren();
  append(parent, children);
  if (!name) return;
  const stops = /** @type {HTMLElement[]} */ ([...parent.querySelectorAll("a, button, input, select, summary")]);
  const next = stops.find((each) => nameOf(each) === name) ?? parent.closest("[tabindex]");
  /** @type {HTMLElement|null} */ (next ?? document.getElementById("panel"))?.focus({ preventScroll: true });
}

/** An icon of `icons.svg`, drawn in the colour of the text: decoration. @param {string} name */
export function icon(name) {
  const use = svg("use", { href: new URL(`../icons.svg#${name}`, import.meta.url).href });
  return svg("svg.icon", { "aria-hidden": "true" }, use);
}

/** Announce something to screen readers, at the next pause. @param {string} text */
export function announce(text) {
  const region = document.getElementById("announcer");
  if (region && region.textContent !== text) region.textContent = text;
}

/** @template T, K @param {Iterable<T>} items @param {(item: T) => K} keyOf @returns {Map<K, T[]>} In their order. */
export function groupBy(items, keyOf) {
  const groups = new Map();
  for (const each of items) {
    const group = groups.get(keyOf(each));
    if (group) group.push(each);
    else groups.set(keyOf(each), [each]);
  }
  return groups;
}

/** @param {KeyboardEvent} event @returns {boolean} Whether a key belongs to a field, a dialog or the browser. */
export function isTyping({ target, ctrlKey, metaKey, altKey }) {
  const fields = "input:not([type=range]):not([type=checkbox]):not([type=radio]), select, textarea, dialog";
  return ctrlKey || metaKey || altKey || Boolean(/** @type {HTMLElement} */ (target).closest(fields));
}

const thin = "\u00a0";

/** @param {number} count @returns {string} 12345 -> "12,345" */
export function formatCount(count) {
  return Math.round(count).toLocaleString("en");
}

/** @param {number} count @param {string} one @param {string} [many] @returns {string} "1 scan", "3 scans" */
export function plural(count, one, many = `${one}s`) {
  return `${formatCount(count)} ${Math.round(count) === 1 ? one : many}`;
}

/** @param {number} bytes @returns {string} 1536 -> "1.5 kB" (steps of 1,000, as file managers show) */
export function formatBytes(bytes) {
  const units = ["B", "kB", "MB", "GB", "TB"];
  let value = bytes;
  let unit = 0;
  while (value >= 999.5 && unit < units.length - 1) {
    value /= 1000;
    unit += 1;
  }
  return `${unit === 0 || value >= 99.95 ? Math.round(value) : value.toFixed(1)}${thin}${units[unit]}`;
}

/** @param {number|null|undefined} seconds @returns {string} 0.4 -> "0.4 s", 75 -> "1 min 15 s", 7300 -> "2 h 02 min" */
export function formatDuration(seconds) {
  if (seconds === null || seconds === undefined || !Number.isFinite(seconds)) return "–";
  if (seconds < 9.95) return `${seconds.toFixed(1)}${thin}s`;
  const whole = Math.round(seconds);
  if (whole < 60) return `${whole}${thin}s`;
  if (whole < 3600) return `${Math.floor(whole / 60)}${thin}min ${String(whole % 60).padStart(2, "0")}${thin}s`;
  const minutes = Math.round(whole / 60);
  return `${Math.floor(minutes / 60)}${thin}h ${String(minutes % 60).padStart(2, "0")}${thin}min`;
}

/** @param {number|null|undefined} metres @param {number} [digits] @returns {string} 1.157 -> "1.16 m", 5200 -> "5.2 km" */
export function formatMetres(metres, digits = 2) {
  if (metres === null || metres === undefined || !Number.isFinite(metres)) return "–";
  if (Math.abs(metres) >= 1000) return `${(metres / 1000).toFixed(1)}${thin}km`;
  return `${metres.toFixed(digits)}${thin}m`;
}

/** @param {number|null|undefined} share 0..1 @returns {string} 0.895 -> "89.5 %" */
export function formatPercent(share) {
  if (share === null || share === undefined || !Number.isFinite(share)) return "–";
  return `${(100 * share - 1e-9).toFixed(1).replace("-0.0", "0.0")}${thin}%`; // 6.25 is 6.2, as of the command line
}

/** @param {string|null|undefined} iso @returns {string} "just now", "5 min ago", "yesterday", "21 Nov 2026" */
export function formatAgo(iso) {
  if (!iso) return "–";
  const then = new Date(iso);
  const seconds = (Date.now() - then.getTime()) / 1000;
  if (seconds < 45) return "just now";
  if (seconds < 3600) return `${Math.max(1, Math.round(seconds / 60))} min ago`;
  if (seconds < 20 * 3600) return `${Math.round(seconds / 3600)} h ago`;
  if (seconds < 44 * 3600) return "yesterday";
  return formatDate(iso, Intl.DateTimeFormat().resolvedOptions().timeZone);
}

/**
 * @param {string} iso
 * @param {string} [timeZone] Of the day.
 * @returns {string} "2015-02-17T11:18:02Z" -> "17 Feb 2015"; what is not a date stays as it is.
 */
export function formatDate(iso, timeZone = "UTC") {
  const day = new Date(iso);
  if (Number.isNaN(day.getTime())) return iso;
  return day.toLocaleDateString("en-GB", { day: "numeric", month: "short", year: "numeric", timeZone });
}

/** @returns {boolean} Whether files can be dropped here: fingers alone cannot. */
export const takesDrops = () => matchMedia("(any-pointer: fine)").matches;
