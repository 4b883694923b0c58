/**
 * The service as the page uses it: requests with the token, errors in the server's words, events, downloads.
 *
 * Paths are relative to `/api/v1/` ("drives", `jobs/${id}/report`). Works in workers too, except for the dialog for a token.
 */
import { news } from "./news.js";
import { keep, recall } from "./storage.js";

/**
 * Where the page is served, with a slash at the end; right behind a reverse proxy with a path prefix too. This module is
 * `static/js/api.js` or a file of `static/bundle/`, with the version of the page behind `static/` as it is served.
 */
export const ROOT = new URL(import.meta.url.replace(/static\/(@\w+\/)?(js|bundle)\/[^/]*$/, ""));
const API = new URL("api/v1/", ROOT);
const TOKEN_KEY = "interloc.token";

/** What went wrong, in the words of the server's problem document. */
export class ApiError extends Error {
  /**
   * @param {number} status HTTP status; 0 when the server was not reached.
   * @param {{title?: string, detail?: string, problems?: Array<FileProblem>|null, [more: string]: any}} problem
   * @param {number|null} [retryAfter] Seconds.
   */
  constructor(status, problem, retryAfter = null) {
    super(problem.detail || problem.title || `The server answered ${status}.`);
    this.name = "ApiError";
    this.status = status;
    this.title = problem.title || (status ? `Error ${status}` : "Server not reached");
    /** @type {Array<FileProblem>} */
    this.problems = problem.problems ?? [];
    this.retryAfter = retryAfter;
  }

  /** True where the same request may succeed in a moment. */
  get isPassing() {
    return [0, 429, 502, 503, 504].includes(this.status);
  }
}

/** @typedef {{severity: string, path: string, message: string}} FileProblem */

export function getToken() {
  return recall(TOKEN_KEY, "sessionStorage");
}

const tokens = news();
export const onTokenChange = tokens.hear;

/** @param {string|null} token Kept until the tab is closed; null forgets it. */
export function setToken(token) {
  askAgain();
  keep(TOKEN_KEY, token, "sessionStorage");
  tokens.tell();
}

/** @type {((wrong: boolean) => Promise<string|null>)|null} */
let askToken = null;
/** The question; its answer is kept where the person gave up, so that nobody asks again by itself. @type {Promise<boolean>|null} */
let asking = null;
export const askAgain = () => void (asking = null);

/**
 * Set who asks the person for a token when the server requires one.
 * @param {(wrong: boolean) => Promise<string|null>} ask Its argument: whether a token was refused. null: the person gave up.
 */
export function onTokenNeeded(ask) {
  askToken = ask;
}

/** @param {string|null} used @returns {Promise<boolean>} True where the request is worth another try. */
function renewToken(used) {
  if (getToken() !== used) return Promise.resolve(true); // another request was faster
  if (!askToken) return Promise.resolve(false);
  asking ??= askToken(used !== null).then((token) => {
    if (token) setToken(token);
    return Boolean(token);
  });
  return asking;
}

/** @param {string} path @returns {string} Address of a path of the API. */
export function address(path) {
  return new URL(path, API).href;
}

/**
 * SHA-256 of what is sent, where the browser offers it (https, or this machine).
 * @param {BufferSource} bytes
 * @returns {Promise<string | null>} Base64; null where the browser cannot compute it.
 */
export async function sha256(bytes) {
  if (!globalThis.crypto?.subtle) return null;
  return btoa(String.fromCharCode(...new Uint8Array(await crypto.subtle.digest("SHA-256", bytes))));
}

/** @param {string} path @returns {string} A path of a drive, each part encoded: "a b/ü.bin" -> "a%20b/%C3%BC.bin". */
export function encodePath(path) {
  return path.split("/").map(encodeURIComponent).join("/");
}

/** @returns {string} A key that no other request has. */
export const newKey = () =>
  [...crypto.getRandomValues(new Uint8Array(16))].map((byte) => byte.toString(16).padStart(2, "0")).join("");

/** @param {Record<string, string>} headers @returns {Record<string, string>} With the token, if there is one. */
function authHeaders(headers) {
  const token = getToken();
  return token ? { Authorization: `Bearer ${token}`, ...headers } : headers;
}

const OF_A_PROXY = {
  title: "Too large for a proxy",
  detail:
    "A reverse proxy between this browser and the service takes no request of this size. Its operator can raise the " +
    "limit: client_max_body_size 0 in nginx, as docs/service.md has it.",
};

const NO_TOKEN = {
  title: "This server requires a token",
  detail: "Press “Set token”, the button with the key at the top, and enter the token that the operator gave you.",
};

/** @param {number} status @param {string} text @param {string|null} retryAfter */
function errorOf(status, text, retryAfter) {
  /** @type {any} */
  let problem = {};
  try {
    problem = JSON.parse(text);
  } catch {
    problem = { detail: text.length < 300 && !text.startsWith("<") ? text : "" };
    if (status === 413) problem = OF_A_PROXY; // the service itself says more
  }
  if (status === 401) problem = NO_TOKEN; // the service tells programs how to send it
  const seconds = retryAfter === null ? NaN : Number(retryAfter);
  return new ApiError(status, problem, Number.isFinite(seconds) ? seconds : null);
}

/** @param {unknown} cause @returns {Error} */
function unreachable(cause) {
  if (cause instanceof DOMException && cause.name === "AbortError") return cause;
  return new ApiError(0, {
    title: "Server not reached",
    detail: "The server does not answer. Is it still running, and is this machine connected to it?",
  });
}

/**
 * Send a request; anything but success is thrown.
 *
 * @param {string} path
 * @param {{method?: string, json?: any, body?: BodyInit|null, headers?: Record<string, string>, signal?: AbortSignal,
 *   cache?: RequestCache, keepalive?: boolean}} [options] `json` is sent as such.
 * @throws {ApiError}
 */
export async function request(path, { json, headers = {}, ...options } = {}) {
  if (json !== undefined) {
    headers = { ...headers, "Content-Type": "application/json" };
    options.body = JSON.stringify(json);
  }
  return withToken(async () => {
    let response;
    try {
      response = await fetch(address(path), { ...options, headers: authHeaders(headers) });
    } catch (cause) {
      throw unreachable(cause);
    }
    if (response.ok) return response;
    throw errorOf(response.status, await response.text(), response.headers.get("Retry-After"));
  });
}

/** Send again with another token where the server refuses that of now. @template T @param {() => Promise<T>} send */
async function withToken(send) {
  for (;;) {
    const used = getToken();
    try {
      return await send();
    } catch (error) {
      if (!(error instanceof ApiError && error.status === 401 && (await renewToken(used)))) throw error;
    }
  }
}

/** @param {string} path @param {{signal?: AbortSignal, headers?: Record<string, string>}} [options] */
export async function getJson(path, { headers, signal } = {}) {
  const response = await request(path, { headers: { Accept: "application/json", ...headers }, signal });
  return response.json();
}

/**
 * @param {"POST"|"PUT"|"PATCH"|"DELETE"} method
 * @param {string} path
 * @param {any} [json]
 * @param {{headers?: Record<string, string>, signal?: AbortSignal}} [options]
 * @returns {Promise<any>} The answer, null where it is empty.
 */
export async function sendJson(method, path, json, options = {}) {
  const response = await request(path, { method, json, ...options });
  const text = await response.text();
  return text ? JSON.parse(text) : null;
}

/**
 * Send a file, with progress.
 *
 * @param {string} path
 * @param {Blob|ArrayBuffer|Uint8Array} data
 * @param {{digest?: string|null, onProgress?: (sent: number) => void, signal?: AbortSignal, method?: string,
 *   type?: string}} [options] `digest`: SHA-256 in Base64, checked by the server.
 * @returns {Promise<any>} The answer as JSON.
 * @throws {ApiError}
 */
export function putFile(
  path,
  data,
  { digest = null, onProgress, signal, method = "PUT", type = "application/octet-stream" } = {},
) {
  /** @type {Record<string, string>} */
  const headers = { "Content-Type": type };
  if (digest) headers["Content-Digest"] = `sha-256=:${digest}:`;
  return withToken(
    () =>
      new Promise((resolve, reject) => {
        signal?.throwIfAborted();
        const xhr = new XMLHttpRequest();
        const abort = () => xhr.abort();
        xhr.open(method, address(path));
        for (const [name, value] of Object.entries(authHeaders(headers))) xhr.setRequestHeader(name, value);
        if (onProgress) xhr.upload.onprogress = (event) => onProgress(event.loaded);
        xhr.onload = () => {
          const { status, responseText: text } = xhr;
          if (status >= 200 && status < 300)
            resolve(new Response(text || "null").json()); // rejects what is none
          else reject(errorOf(status, text, xhr.getResponseHeader("Retry-After")));
        };
        xhr.onerror = () => reject(unreachable(null));
        xhr.onabort = () => reject(new DOMException("The upload was stopped.", "AbortError"));
        xhr.onloadend = () => signal?.removeEventListener("abort", abort);
        signal?.addEventListener("abort", abort);
        xhr.send(/** @type {any} */ (data));
      }),
  );
}

/**
 * Follow server-sent events until `onEvent` has had enough; connects again where the stream ends or breaks.
 *
 * @param {string} path
 * @param {{onEvent: (data: any) => boolean|void, signal?: AbortSignal}} options `onEvent` gets the data parsed as JSON;
 *   returning true says that nothing more is to come.
 * @returns {Promise<void>} Resolves at the end; rejects with an `ApiError` where the server refuses.
 */
export async function follow(path, { onEvent, signal }) {
  /** @type {string|null} */
  let lastId = null;
  let wait = 1000;
  while (!signal?.aborted) {
    try {
      /** @type {Record<string, string>} */
      const headers = { Accept: "text/event-stream" };
      if (lastId !== null) headers["Last-Event-ID"] = lastId;
      const response = await request(path, { headers, signal, cache: "no-store" });
      wait = 1000;
      for await (const event of parseEvents(response)) {
        if (event.id !== null) lastId = event.id;
        if (event.data && onEvent(JSON.parse(event.data))) return;
      }
    } catch (error) {
      if (signal?.aborted) return;
      if (error instanceof ApiError && !error.isPassing) throw error;
      // A broken connection or a restarting server: go on where it stopped.
    }
    if (signal?.aborted) return;
    await sleep(wait, signal);
    wait = Math.min(15000, 1.7 * wait);
  }
}

/** @param {Response} response @returns {AsyncGenerator<{id: string|null, data: string}>} */
async function* parseEvents(response) {
  if (!response.body) return;
  const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    rest += value.replace(/\r\n?/g, "\n");
    let end = rest.indexOf("\n\n");
    while (end >= 0) {
      const event = { id: /** @type {string|null} */ (null), data: "" };
      const data = [];
      for (const line of rest.slice(0, end).split("\n")) {
        const [, field, text] = /^([^:]*):? ?(.*)$/s.exec(line) ?? [];
        if (field === "data") data.push(text);
        else if (field === "id") event.id = text;
      }
      event.data = data.join("\n");
      if (event.data) yield event;
      rest = rest.slice(end + 2);
      end = rest.indexOf("\n\n");
    }
  }
}

/** @param {number} ms @param {AbortSignal} [signal] Wakes up at once. @returns {Promise<void>} */
export function sleep(ms, signal) {
  return new Promise((resolve) => {
    const timer = setTimeout(resolve, ms);
    signal?.addEventListener("abort", () => (clearTimeout(timer), resolve()), { once: true });
  });
}

/**
 * Look again and again, while somebody looks at the page; at once when they come back to it.
 * @param {number | (() => number)} wait Milliseconds between two looks.
 * @param {() => Promise<void>} look May fail: the next one may not. Where a token is asked for, none follows by itself.
 * @returns {() => void} Begins to wait anew.
 */
export function keepLooking(wait, look) {
  let timer = 0;
  const plan = () => {
    clearTimeout(timer);
    timer = setTimeout(lookNow, typeof wait === "number" ? wait : wait());
  };
  const lookNow = async () => {
    if (document.hidden) return;
    try {
      await look();
    } catch (error) {
      if (error instanceof ApiError && error.status === 401) return; // the person was asked for one just now
    }
    plan();
  };
  document.addEventListener("visibilitychange", () => void lookNow());
  onTokenChange(plan);
  plan();
  return plan;
}

/**
 * Save what an address gives: the browser's own download where it may, through memory where a token is needed.
 *
 * @param {string} path
 * @param {string} name Of the file, where the server gives none.
 */
export async function download(path, name) {
  if (!getToken()) {
    save(address(path), name);
    return;
  }
  const response = await request(path);
  const named = /filename="?([^";]+)"?/.exec(response.headers.get("Content-Disposition") ?? "");
  const url = URL.createObjectURL(await response.blob());
  save(url, named ? named[1] : name);
  setTimeout(() => URL.revokeObjectURL(url), 60000);
}

const MAX_PICTURES = 200;
/** Pictures by their paths, the one used last at the end. @type {Map<string, string>} */
const pictures = new Map();

/** @param {string} path @param {AbortSignal} [signal] @returns {Promise<string>} Address of a picture within the page; the last ones are kept. */
export async function loadPicture(path, signal) {
  const url = pictures.get(path) ?? URL.createObjectURL(await (await request(path, { signal })).blob());
  pictures.delete(path);
  pictures.set(path, url);
  if (pictures.size > MAX_PICTURES) {
    const [oldest] = pictures;
    URL.revokeObjectURL(oldest[1]);
    pictures.delete(oldest[0]);
  }
  return url;
}

/** @param {string} url @param {string} name */
function save(url, name) {
  const link = document.createElement("a");
  link.href = url;
  link.download = name;
  document.body.append(link);
  link.click();
  link.remove();
}

/**
 * @typedef {object} PageConfig What the service reports about itself, `/config.json`.
 * @property {string} version
 * @property {string|null} tile_url
 * @property {string} tile_attribution
 * @property {boolean} overpass Whether jobs may fetch the map of today.
 * @property {boolean} needs_token
 * @property {number} trash_h For how long what is deleted can be restored.
 * @property {{name: string, title: string, description: string}[]} policies The first is the usual one.
 * @property {{name: string, description: string, is_osm: boolean}[]} layers Of a result.
 * @property {string[]} exports Endings of the formats that it writes: ".gpkg".
 * @property {{name: string, title: string, road: number[]}[]} label_schemes
 * @property {Record<"maps" | "archives" | "recordings" | "scans" | "small" | "beside", string[]>} file_kinds Endings of names.
 * @property {Record<string, string>} layouts Titles of the layouts of drives.
 * @property {any} reading_schema JSON Schema of the options of reading.
 * @property {string} simulator The generator of maps that are made up.
 * @property {string[]} drivable Values of `highway`.
 * @property {{default: number, minimum: number, maximum: number}} search_radius_km
 * @property {number} max_compared_jobs
 */

/** @type {PageConfig} */
let config;

/** As loaded at the start. */
export const getConfig = () => config;

export async function loadConfig() {
  setConfig(await getJson(new URL("config.json", ROOT).href));
}

/** @param {PageConfig} loaded */
export function setConfig(loaded) {
  config = loaded;
}

/** @param {string} name @param {string[]} endings */
const endsWith = (name, endings) => endings.some((ending) => name.toLowerCase().endsWith(ending));

/** @param {string} name @returns {boolean} Whether a file is an OSM file. */
export const isMap = (name) => endsWith(name, config.file_kinds.maps);

/** @param {string} name @returns {boolean} Whether a file is an archive that may hold a drive. */
export const isArchive = (name) => endsWith(name, config.file_kinds.archives);
