// A client of the RayNest daemon for web programs. It needs frames.js and lists.js, and nothing of the page.
//
//   const daemon = new Daemon("ws://127.0.0.1:31061/v1/stream");
//   daemon.addEventListener("state", () => console.log(daemon.state));   // connecting, open or lost
//   daemon.addEventListener("lost", () => {});                           // after each attempt that failed, too
//   await daemon.ready();
//   const { info } = await daemon.ask("Load", { source: "builtin:forest" });
//   for await (const { type, message, columns } of daemon.request("Query", {
//     job: { scene: info.name }, fields: ["t", "total"], generator: { kind: "camera", settings: ["size=320x180"] },
//   })) if (type === "Chunk") console.log(message.first_ray, columns.total);
//
// Leaving such a loop early, or aborting `signal`, cancels the request. Credit is granted as frames are
// taken out of the loop, so a slow reader slows only its own request.
import { decodeFrame, encodeFrame } from "./frames.js";

const RETRY_MS = [100, 200, 400, 800, 1500];
const LAST = new Set(["Done", "Detached", "Loaded", "SceneList", "SceneInfo", "PathName", "Unloaded",
                      "VariantList", "Statistics", "PartList", "JobList", "JobInfo", "PageAddress", "Pong"]);

/** Fields of a Query: of a generator's rays, or of the points of a hemisphere, these alone are traced. */
export const part = (first, count) => ({ part_first: first, part_count: count });

/** Fields of a Render or Heatmap: of the picture these pixels alone are made, as they are in the whole. */
export const tile = (x, y, width, height) => ({ tile_x: x, tile_y: y, tile_width: width, tile_height: height });

/** An Error message of the daemon, or a lost connection (name CONNECTION_LOST). */
export class DaemonError extends Error {
  constructor(name, message, retryAfterMs = 0) {
    super(message);
    this.name = name;
    this.retryAfterMs = retryAfterMs;
  }
}

export class Daemon extends EventTarget {
  #url;
  #options;
  #socket = null;
  #requests = new Map();
  #nextId = 1;
  #attempt = 0;
  #timer = 0;
  state = "connecting";
  welcome = null;

  /**
   * `options`: client (a name for the daemon's log), Socket (a WebSocket class), retryMs, and outside of browsers
   * headers, because the daemon wants its own address as Origin.
   */
  constructor(url, options = {}) {
    super();
    this.#url = url;
    this.#options = { client: "raynest.js", Socket: globalThis.WebSocket, retryMs: RETRY_MS, ...options };
    this.#connect();
  }

  /** Resolves when the daemon has answered, and after a loss when it has answered again. */
  async ready() {
    while (this.state !== "open") await new Promise((resolve) => this.addEventListener("state", resolve, { once: true }));
  }

  /** Sends a request; an async iterator of its frames, up to the last one. Throws DaemonError. */
  async *request(type, message = {}, { signal, columns, background = false } = {}) {
    signal?.throwIfAborted();
    if (this.state !== "open") throw new DaemonError("CONNECTION_LOST", "the daemon is away");
    const id = this.#nextId++;
    const request = { frames: [], wake: null, consumed: 0, background };
    this.#requests.set(id, request);
    const abort = () => { request.frames = [{ failed: signal.reason }]; request.wake?.(); };
    signal?.addEventListener("abort", abort, { once: true });
    let ended = false;
    try {
      this.#send(type, id, message);
      if (columns) this.#send("QueryRays", id, { first_ray: 0 }, columns);
      while (!ended) {
        while (request.frames.length === 0) await new Promise((resolve) => { request.wake = resolve; });
        const frame = request.frames.shift();
        ended = frame.lost || frame.type === "Error" || LAST.has(frame.type);
        if (frame.failed) throw frame.failed;
        if (frame.type === "Error") {
          throw new DaemonError(frame.message.name ?? "ERROR", frame.message.message ?? "",
                                frame.message.retry_after_ms);
        }
        yield frame;
        if (!ended) this.#grant(id, request, frame.bulkBytes);
      }
    } finally {
      signal?.removeEventListener("abort", abort);
      this.#requests.delete(id);
      if (!ended && this.state === "open") this.#send("Cancel", id, {});
    }
  }

  /** Sends a request and returns the message of its last frame. */
  async ask(type, message = {}, options = {}) {
    let last = null;
    for await (const frame of this.request(type, message, options)) last = frame.message;
    return last;
  }

  /** Asks for all pages of a list: `lists` names those of its answer's fields that are pages. */
  async askPages(type, message, lists, options = {}) {
    const all = Object.fromEntries(lists.map((name) => [name, []]));
    let first = 0;
    for (;;) {
      const page = await this.ask(type, { ...message, first }, options);
      const count = page[lists[0]]?.length ?? 0;
      for (const name of lists) all[name].push(...(page[name] ?? new Array(count).fill(0)));
      first += count;
      if (count === 0 || first >= page.total) return all;
    }
  }

  close() {
    clearTimeout(this.#timer);
    this.#options.retryMs = null;
    this.#socket?.close();
  }

  /** Number of requests whose end has not come, without those in the `background`. */
  get pending() { return [...this.#requests.values()].filter(({ background }) => !background).length; }

  #connect() {
    const { Socket, headers } = this.#options;
    const socket = headers ? new Socket(this.#url, { headers }) : new Socket(this.#url);
    let lost = false;
    // An error ends a WebSocket, but Node tells no close of one that never opened.
    const lose = () => { if (!lost) this.#lose(); lost = true; };
    this.#socket = socket;
    socket.binaryType = "arraybuffer";
    socket.onopen = () => this.#send("Hello", 0, { client: this.#options.client });
    socket.onmessage = ({ data }) => this.#receive(data);
    socket.onclose = socket.onerror = lose;
  }

  #receive(data) {
    let frame;
    try {
      frame = decodeFrame(data);
    } catch {
      this.#socket.close();
      return;
    }
    if (frame.type === "Welcome") {
      this.welcome = frame.message;
      this.#attempt = 0;
      this.#become("open");
    }
    const request = this.#requests.get(frame.id);
    if (!request) return;
    request.frames.push(frame);
    request.wake?.();
  }

  #lose() {
    for (const request of this.#requests.values()) {
      request.frames.push({ lost: true, failed: new DaemonError("CONNECTION_LOST", "the daemon has gone away") });
      request.wake?.();
    }
    this.#become("lost");
    this.dispatchEvent(new Event("lost"));
    const pauses = this.#options.retryMs;
    if (!pauses) return;
    this.#timer = setTimeout(() => this.#connect(), pauses[Math.min(this.#attempt++, pauses.length - 1)]);
  }

  #become(state) {
    if (this.state === state) return;
    this.state = state;
    this.dispatchEvent(new Event("state"));
  }

  #send(type, id, message, columns) {
    if (this.#socket.readyState === 1) this.#socket.send(encodeFrame(type, id, message, columns));
  }

  #grant(id, request, bytes) {
    request.consumed += bytes;
    if (request.consumed < 1 << 20) return;
    this.#send("Credit", id, { bytes: request.consumed });
    request.consumed = 0;
  }
}
