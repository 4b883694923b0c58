/**
 * What is around the panels: the header, and the tabs, the steps from a drive to its files.
 */
import { getConfig, getJson, getToken, onTokenChange, ROOT, setToken } from "./api.js";
import { outLink } from "./controls.js";
import { lists, onListsChange, refreshLists, refreshOldLists, titleOf, watchLists } from "./data/lists.js";
import { onUploadsChange, ownUpload, percent } from "./data/uploads.js";
import { el, fill, icon } from "./dom.js";
import { askForToken, retryNote, showError } from "./messages.js";
import { listShortcuts } from "./shortcuts.js";
import { getState, setState, subscribe } from "./state.js";

/** Where the keyframe takes the place of the panel; see shell.css. */
const narrow = matchMedia("(max-width: 1279.98px)");

/** @param {HTMLElement} header */
export function mountHeader(header) {
  const home = (/** @type {Event} */ event) => (event.preventDefault(), setState({ panel: "drives" }));
  const token = el("button.plain", { onClick: () => changeToken().catch(showError) });
  const logo = el("img", { src: new URL("static/icon.svg", ROOT).href, alt: "", width: 22, height: 22 });
  const keys = { title: "Keyboard shortcuts (?)", "aria-label": "Keyboard shortcuts" };
  const about = el("span.cut.grow");
  fill(
    header,
    el("h1", el("a.brand.spread", { href: "#", onClick: home }, logo, "InterLoc")),
    about,
    token,
    el("button.square.plain.keys", { ...keys, onClick: listShortcuts }, "?"),
    outLink(new URL("docs", ROOT).href, "API", { class: "button plain" }),
    el("span.small.version", getConfig().version && `v${getConfig().version}`),
  );
  const update = () => {
    fill(about, showTitle());
    token.hidden = !getConfig().needs_token && !getToken();
    fill(token, icon("key"), getToken() ? "Token set" : "Set token");
  };
  subscribe(["drive", "job"], update);
  subscribe(["drive"], ({ drive }) => {
    const isNew = drive && lists.isLoaded && !lists.drives.some((each) => each.id === drive);
    if (isNew) refreshLists().catch(showError); // just uploaded
  });
  onListsChange(update);
  onUploadsChange(update);
  onTokenChange(update);
  update();
  refreshOldLists().catch(showError);
  watchLists();
}

/** Say in the title of the page what it sends and shows, the narrowest first. @returns {string} What it shows. */
function showTitle() {
  const sent = ownUpload()?.fraction ?? null;
  const drive = lists.drives.find((each) => each.id === getState().drive);
  const job = lists.jobs.find((each) => each.id === getState().job);
  const parts = [sent !== null && percent(sent), job && titleOf(job), drive?.name, "InterLoc"];
  document.title = parts.filter(Boolean).join(" – ");
  return [drive?.name, job && titleOf(job)].filter(Boolean).join(" / ");
}

async function changeToken() {
  const token = await askForToken(false);
  if (!token) return;
  setToken(token);
  await getJson("drives?limit=1");
  await refreshLists();
}

/**
 * Panels are made when they are first shown; one with a `tab` is reached from the panel of that tab, and leads back.
 * @param {Record<string, {title: string, tab?: string, mount: (container: HTMLElement) => void | Promise<void>}>} panels
 */
export function mountTabs(panels) {
  const list = /** @type {HTMLElement} */ (document.getElementById("tabs"));
  const panel = /** @type {HTMLElement} */ (document.getElementById("panel"));
  const all = Object.keys(panels);
  const names = all.filter((name) => !panels[name].tab);
  const uncover = () => narrow.matches && setState({ drawer: false });
  const choose = (/** @type {string} */ name) => (setState({ panel: name }), uncover());
  /** @type {Record<string, HTMLElement>} */
  const bodies = {};
  const tabs = names.map((name) => {
    const props = { role: "tab", id: `tab-${name}`, onClick: () => choose(name) };
    return el("button", props, panels[name].title);
  });
  fill(list, tabs);
  const uploading = el("span.tab-badge");
  tabs[names.indexOf("upload")]?.append(uploading);
  onUploadsChange(() => {
    const upload = ownUpload();
    uploading.textContent = upload ? (upload.fraction === null ? "…" : percent(upload.fraction)) : "";
  });
  list.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    const usable = names.filter((_, i) => !tabs[i].disabled);
    const next = usable[(usable.indexOf(tabOf(shown())) + step + usable.length) % usable.length];
    setState({ panel: next });
    document.getElementById(`tab-${next}`)?.focus();
    event.preventDefault();
  });

  const shown = () => (all.includes(getState().panel) ? getState().panel : names[0]);
  const tabOf = (/** @type {string} */ name) => panels[name].tab ?? name;
  const update = () => {
    const current = shown();
    const tab = tabOf(current);
    const leaves = all.some((name) => name !== current && bodies[name]?.contains(document.activeElement));
    names.forEach((name, i) => {
      tabs[i].disabled = name === "result" && !getState().job && name !== tab;
      tabs[i].setAttribute("aria-controls", `panel-${name === tab ? current : name}`);
      tabs[i].setAttribute("aria-selected", String(name === tab));
      tabs[i].tabIndex = name === tab ? 0 : -1;
    });
    for (const [name, body] of Object.entries(bodies)) body.hidden = name !== current;
    if (!bodies[current]) {
      const body = el("div.body", { role: "tabpanel", id: `panel-${current}`, "aria-labelledby": `tab-${tab}` });
      const inside = el("div");
      const back = () => setState({ panel: tab });
      if (tab !== current) body.append(el("button.link.back", { onClick: back }, icon("previous"), panels[tab].title));
      body.append(inside);
      bodies[current] = body;
      panel.append(body);
      const mounted = async () => panels[current].mount(inside);
      const mount = () => mounted().catch((error) => fill(inside, retryNote(error, mount)));
      void mount();
    }
    if (leaves) panel.focus(); // what had the focus is hidden now
    panel.scrollTop = 0;
  };
  subscribe(["panel", "job"], update);
  subscribe(["panel"], (now, before) => {
    if (now.panel !== before.panel && before.drawer) uncover(); // "back" to a keyframe leaves it open
  });
  update();
}
