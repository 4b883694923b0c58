/** The drives that are under way, to be watched. */
import { getJson, keepLooking } from "../api.js";
import { mapIsSeen } from "../data/lists.js";
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
  let said = "";
  const look = async () => {
    if (getState().panel !== "drives") return;
    const { sessions } = await getJson("live");
    const now = JSON.stringify([sessions, getState().live]);
    if (now === said) return; // a row that is made anew while it is pressed does nothing
    said = now;
    section.hidden = !sessions.length;
    if (sessions.length) fill(section, el("h3", "Live"), el("div.drive", el("ul.jobs", sessions.map(row))));
  };
  keepLooking(LOOK_MS, look);
  subscribe(["panel", "live"], () => void look().catch(() => {})); // the lists say what is wrong
  void mapIsSeen.then(look).catch(() => {});
  return section;
}

/** @param {any} session */
function row({ id, name, state, keyframes, intersections }) {
  const onClick = () => setState({ live: id, drive: null, job: null, view: null });
  const button = el("button", { "aria-current": String(getState().live === id), onClick }, [
    el("span.cut", { title: name }, name),
    el("span.small", `${WORDS[state]} · ${plural(keyframes, "keyframe")} · ${plural(intersections, "intersection")}`),
  ]);
  return el("li", button);
}
