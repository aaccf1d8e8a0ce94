// Decides which pictures are traced. A change first gives a coarse picture of at most 1/16 of the rays, then
// the fine one. A camera or a time that moves cancels the fine picture, which it makes useless, and lets a coarse one
// end, so that there is something to see while it moves; every other change cancels both.
import { Image } from "./image.js";
import { pictureRequests } from "./requests.js";
import { lightOf } from "./light.js";
import { SETTINGS } from "./lists.js";
import { traceHeat, traceLit, traceQuery, traceRender } from "./tracer.js";
import { viewOf } from "./views.js";
import { DEFAULTS, RAY_KEYS, TIME_KEYS } from "./store.js";

const COARSE_SHARE = 4;  // for each side: 1/16 of the rays
const COARSE_LEAST = [160, 90];
const SLOW_MS = 50;  // a coarse picture that takes longer gets fewer rays next time
// Without a movement before the fine picture begins: twice the time between movements, within bounds. A busy
// browser reports them seldom, and a fine picture that the next one cancels makes it busier.
const SETTLE_MS = [120, 400];

export class Picture extends EventTarget {
  #daemon;
  #store;
  #size;
  #running = null;
  #again = false;
  #moved = 0;
  #settle = SETTLE_MS[0];
  #divisor = COARSE_SHARE;
  image = null;
  counts = { coarse: 0, fine: 0, cancelled: 0, rays: 0 };

  /** `size()` gives the pixels of the fine picture. */
  constructor(daemon, store, size) {
    super();
    this.#daemon = daemon;
    this.#store = store;
    this.#size = size;
    const others = RAY_KEYS.filter((key) => !TIME_KEYS.includes(key));
    store.on(["camera", ...TIME_KEYS], () => this.moved());
    store.on(["scene", "view", "level", "compare", "kind", ...others], () => this.restart());
    store.on(["integrator", "samples", "seed", ...Object.keys(SETTINGS), "env", "sun"], ({ view }) => { if (viewOf(view).lit) this.restart(); });
  }

  /** True while a picture is traced and what it shows is not yet its own, in all pixels. */
  get waiting() { return Boolean(this.#running) && !(this.image?.fine && this.image.linear && this.image.samples > 0 && this.#running.fine); }

  /** True if the fine picture of what the page shows now is complete. */
  get current() {
    const { image } = this, [width, height] = this.#size();
    return !this.#again && Boolean(image?.complete) && image.width === width && image.height === height
      && JSON.stringify(image.wanted) === JSON.stringify(wantedOf(this.#store.values));
  }

  restart() {
    this.#cancel();
    this.#again = true;
    this.#next();
  }

  moved() {
    const now = performance.now(), [least, most] = SETTLE_MS, since = now - this.#moved;
    if (since < most) this.#settle = Math.min(Math.max((this.#settle + 2 * since) / 2, least), most);
    this.#moved = now;
    this.#again = true;
    if (this.#running?.fine) this.#cancel();
    this.#next();
  }

  #cancel() {
    if (!this.#running) return;
    this.counts.cancelled += 1;
    this.#running.controller.abort(new DOMException("a newer picture is wanted", "AbortError"));
    this.#running = null;
  }

  async #next() {
    if (this.#running || this.#daemon.state !== "open") return;
    const state = this.#store.values;
    if (!state.camera || !state.scene) return;
    const [width, height] = this.#size();
    const coarse = this.#again;
    if (!coarse && this.current) return;
    this.#again = false;
    const running = { fine: !coarse, controller: new AbortController() };
    this.#running = running;
    const start = performance.now();
    try {
      if (coarse) {
        const [w, h] = this.#coarseSize(width, height);
        await this.#trace(state, w, h, running, false);
        this.#adapt(performance.now() - start, width, height);
      } else {
        const rest = this.#settle - (performance.now() - this.#moved);
        if (this.#moved && rest > 0) await pause(rest, running.controller.signal);
        await this.#trace(state, width, height, running, true);
      }
      this.#ended(running);
    } catch (error) {
      this.#ended(running, error);
    }
  }

  #ended(running, error) {
    const current = this.#running === running;
    if (current) this.#running = null;
    if (error && error.name !== "AbortError") {
      this.dispatchEvent(Object.assign(new Event("failed"), { error }));
      if (!this.#again) return;
    }
    if (current) this.#next();
  }

  #coarseSize(width, height) {
    return [Math.max(Math.floor(width / this.#divisor), 1), Math.max(Math.floor(height / this.#divisor), 1)];
  }

  #adapt(ms, width, height) {
    const most = Math.max(Math.min(Math.floor(width / COARSE_LEAST[0]), Math.floor(height / COARSE_LEAST[1])), COARSE_SHARE);
    if (ms > SLOW_MS) this.#divisor = Math.min(this.#divisor + 1, most);
    else if (ms < SLOW_MS / 3) this.#divisor = Math.max(this.#divisor - 1, COARSE_SHARE);
    this.#divisor = Math.min(this.#divisor, most);
  }

  async #trace(state, width, height, running, fine) {
    const { signal } = running.controller;
    const image = new Image(state, width, height);
    image.wanted = wantedOf(state);
    image.fine = fine;
    if (fine && this.image) image.startFrom(this.image);
    const requests = pictureRequests(state, width, height, fine);
    if (requests[0].message.encode === "linear") return this.#refine(image, requests[0].message, running, fine);
    const show = () => this.#show(image, signal);
    const begun = performance.now();
    let drawn = begun;
    const onRows = requests.length > 1 || !fine ? undefined : (columns, first, end) => {
      image.fill(columns, first, end);
      if (performance.now() - drawn < 60) return;
      drawn = performance.now();
      show();
    };
    const traced = await Promise.all(requests.map(({ type, message, normals }) =>
      normals ? traceHeat(this.#daemon, message, normals, width * height, { signal, onRows })
        : (type === "Render" ? traceRender : traceQuery)(this.#daemon, message, width * height, { signal, onRows })));
    if (!onRows) image.fill(traced[0].columns, 0, width * height, traced[1]?.columns);
    Object.assign(image, { started: traced[0].started, done: traced[0].done, complete: fine,
                           ms: performance.now() - begun });
    this.counts[fine ? "fine" : "coarse"] += 1;
    this.counts.rays += width * height * requests.length;
    show();
  }

  #show(image, signal) {
    if (signal.aborted) return;
    this.image = image;
    this.dispatchEvent(new Event("image"));
  }

  /** Traces a lit picture: it is shown after each pass over all pixels. */
  async #refine(image, message, running, fine) {
    const { signal } = running.controller;
    const begun = performance.now();
    const traced = await traceLit(this.#daemon, message, image.width * image.height, { signal,
      onPass: (linear, samples, stops) => {
        Object.assign(image, { linear, samples, stops });
        this.#show(image, signal);
      },
      onProgress: ({ samples = 0, noise = 0 }) => {
        image.error = { samples, noise };
        this.dispatchEvent(new Event("progress"));
      } });
    const { samples = 0, noise = 0 } = traced.done ?? {};
    Object.assign(image, { error: { samples, noise }, started: traced.started, done: traced.done, complete: fine, ms: performance.now() - begun });
    this.counts[fine ? "fine" : "coarse"] += 1;
    this.counts.rays += Number(traced.done?.rays ?? 0);
    this.#show(image, signal);
  }
}

/** Says why a picture may be empty; "" for one that is not. */
export function nothingHit({ complete, done, state: { hidden, isolated, mask } }) {
  if (!complete || Number(done?.hits ?? 1) > 0) return "";
  return hidden.length || isolated.length ? "No ray hits anything: J shows what is hidden or isolated."
    : mask !== DEFAULTS.mask ? "No ray hits anything: look elsewhere (0 shows the whole scene), or set the mask to ffffffff."
      : "No ray hits anything: look elsewhere (0 shows the whole scene). If that is empty, too, an edit has hidden all of it.";
}

/** The state that a picture depends on. */
const wantedOf = (state) => {
  const { scene, camera, view, level, compare, kind } = state;
  const light = viewOf(view).lit ? { ...lightOf(state), samples: state.samples } : null;
  return { scene, camera, view, level, compare, kind, ...Object.fromEntries(RAY_KEYS.map((key) => [key, state[key]])), light };
};

const pause = (ms, signal) => new Promise((resolve, reject) => {
  const timer = setTimeout(resolve, ms);
  signal.addEventListener("abort", () => { clearTimeout(timer); reject(signal.reason); }, { once: true });
});
