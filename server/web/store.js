// The state of the page, as one object of plain values. set() names only the values that become different;
// listeners of a part are called when that part has changed.

import { SETTINGS } from "./lists.js";

const initialSettings = Object.fromEntries(Object.entries(SETTINGS).map(([key, { initial }]) => [key, initial]));

export const DEFAULTS = {
  scene: "", camera: null, cameraName: "",
  view: "total", level: "", compare: "",
  intersector: "auto", settings: {}, mask: "ffffffff", kind: "closest",
  palette: "turbo", range: "p99", log: false, opacity: 1, size: "fit",
  control: "orbit", upAxis: "y", panel: "setup", hidden: [], isolated: [], skipHiddenBoxes: false, boxes: "",
  // Seconds within an animation of the scene, by its number; no time: the scene as it is.
  time: "", animation: 0,
  // The lit view. Empty texts stand for what the daemon does by itself.
  integrator: "path", samples: 64, seed: 0, ...initialSettings, env: "auto", sun: "", exposure: "", tonemap: "", sample: 0,
};

/** The moment that is shown. */
export const TIME_KEYS = ["time", "animation"];

/** What decides which rays hit what, beside scene and camera. */
export const RAY_KEYS = ["intersector", "settings", "mask", "hidden", "isolated", "skipHiddenBoxes", ...TIME_KEYS];

const same = (a, b) => a === b || JSON.stringify(a) === JSON.stringify(b);

export class Store {
  #values;
  #listeners = [];

  constructor(values = {}) { this.#values = { ...DEFAULTS, ...values }; }

  get values() { return this.#values; }

  set(patch) {
    const changed = Object.keys(patch).filter((key) => !same(patch[key], this.#values[key]));
    if (changed.length === 0) return;
    this.#values = { ...this.#values, ...patch };
    for (const { keys, call } of [...this.#listeners]) {
      if (keys.some((key) => changed.includes(key))) call(this.#values);
    }
  }

  /** Calls `call` whenever one of `keys` has changed; at once with `now`. */
  on(keys, call, now = false) {
    this.#listeners.push({ keys, call });
    if (now) call(this.#values);
  }
}
