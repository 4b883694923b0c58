/** The drives that are under way, to be watched. */
import { getJson } from "../api.js";
import { el, fill, plural } from "../dom.js";
import { getState, setState, subscribe } from "../state.js";

const LOOK_MS = 5000;
const WORDS = /** @type {Record<string, string>} */ ({
  driving: "driving",
  waiting: "its sender is away",
  ended: "ended",
});

/** @returns {HTMLElement} Empty while nobody drives. */
export function liveSection() {
  const section = el("section.stack-s.live", { hidden: true });
  let timer = 0;
  const look = async () => {
    clearTimeout(timer);
    if (getState().panel !== "drives") return;
    if (document.visibilityState === "visible") {
      const { sessions } = await getJson("live").catch(() => ({ sessions: [] })); // the lists say what is wrong
      section.hidden = !sessions.length;
      const rows = el("div.drive", el("ul.jobs", sessions.map(row)));
      fill(section, ...(sessions.length ? [el("h3", "Live"), rows] : []));
    }
    timer = window.setTimeout(look, LOOK_MS);
  };
  subscribe(["panel", "live"], () => void look());
  void look();
  return section;
}

/** @param {any} session */
function row({ id, name, state, keyframes, intersections }) {
  const button = el(
    "button",
    {
      "aria-current": String(getState().live === id),
      onClick: () => setState({ live: id, drive: null, job: null, view: null }),
    },
    [
      el("span.cut", { title: name }, name),
      el("span.small", `${WORDS[state]} · ${plural(keyframes, "keyframe")} · ${plural(intersections, "intersection")}`),
    ],
  );
  return el("li", button);
}
