// The whole view in the fragment of the address, so that a link shows a colleague the same. What has its
// default is left out. A link comes from outside: parts that say nothing are named, and have their default.
import { DEFAULTS } from "./store.js";
import { rounded } from "./camera.js";
import { ENVIRONMENTS, sunOf } from "./light.js";
import { INTEGRATORS, PALETTES, SETTINGS } from "./lists.js";
import { TONEMAP_NAMES } from "./tonemap.js";
import { VIEWS } from "./views.js";

const TEXT_MAX = 300;
const clean = (text) => text.slice(0, TEXT_MAX).replace(/[\p{Cc}]/gu, "");
const numbers = (text, count) => {
  const found = text.split(",").map((word) => (word.trim() === "" ? NaN : Number(word)));
  return found.length === count && found.every(Number.isFinite) ? found : null;
};
const among = (...words) => (text) => words.includes(text);
const any = () => true;

/** Texts of a link, and what they may be. Levels, scenes and intersectors are known later: see fitted(). */
const TEXTS = {
  scene: any, view: among(...VIEWS.map(({ id }) => id)), level: (text) => /^\d{1,2}$/.test(text), compare: (text) => /^(intersector|scene|mask|set):./.test(text),
  intersector: any, mask: (text) => /^[0-9a-f]{1,8}$/i.test(text), kind: among("closest", "any"), palette: among(...Object.keys(PALETTES)),
  size: (text) => text === "fit" || /^\d{1,5}x\d{1,5}$/.test(text), control: among("orbit", "first", "free"), upAxis: among("x", "y", "z"),
  panel: among("setup", "ray", "ranking", "objects", "area"), cameraName: any, boxes: (text) => /^\d{1,2}:\d{1,2}:\d{1,2}:[01]$/.test(text),
  integrator: among(...Object.keys(INTEGRATORS)), env: among(...ENVIRONMENTS.map(([name]) => name)), sun: (text) => sunOf(text) !== null,
  tonemap: among(...TONEMAP_NAMES), exposure: (text) => text === "auto" || (numbers(text, 1) !== null && Math.abs(Number(text)) <= 64),
};
/** Whole numbers and lengths of a link: least, most, whether it must be whole. */
const NUMBERS = { samples: [1, 65536, true], seed: [0, Number.MAX_SAFE_INTEGER, true], sample: [0, 65535, true],
                  ...Object.fromEntries(Object.entries(SETTINGS).map(([key, { least, most, whole }]) => [key, [least, most, whole]])),
                  time: [0, 1e6, false], animation: [0, 4095, true] };

export function toFragment(state) {
  const parts = new URLSearchParams();
  for (const key of [...Object.keys(TEXTS), ...Object.keys(NUMBERS)]) if (state[key] !== DEFAULTS[key]) parts.set(key, state[key]);
  const { camera } = state;
  if (camera) {
    parts.set("camera", [...camera.eye, ...camera.at, ...camera.up, camera.fov].join(","));
    if (camera.projection === "orthographic") parts.set("projection", "orthographic");
  }
  for (const [name, value] of Object.entries(state.settings)) parts.append("set", `${name}=${value}`);
  if (state.range !== DEFAULTS.range) parts.set("range", [state.range].flat().join(","));
  if (state.log) parts.set("log", "1");
  if (state.skipHiddenBoxes) parts.set("skipHiddenBoxes", "1");
  if (state.opacity !== 1) parts.set("opacity", state.opacity);
  if (state.hidden.length) parts.set("hidden", state.hidden.join(","));
  if (state.isolated.length) parts.set("isolated", state.isolated.join(","));
  return parts.toString().replaceAll("%2C", ",").replaceAll("%3D", "=");
}

/** Returns {state, ignored}: `ignored` are the parts that say nothing, each as "name=value". */
export function readFragment(fragment) {
  const parts = new URLSearchParams(fragment.replace(/^#/, ""));
  const state = {}, ignored = [];
  /** Takes a part where `read` makes something of its text. */
  const take = (name, read) => {
    for (const text of parts.getAll(name).slice(0, 64).map(clean)) if (!read(text)) ignored.push(`${name}=${text}`);
  };
  const set = (key, value) => { state[key] = value; return true; };
  for (const [key, good] of Object.entries(TEXTS)) take(key, (text) => text === DEFAULTS[key] || (good(text) && set(key, text)));
  for (const [key, [least, most, whole]] of Object.entries(NUMBERS)) {
    take(key, (text) => {
      const [value] = numbers(text, 1) ?? [NaN];
      return value >= least && value <= most && (!whole || Number.isInteger(value)) && set(key, value);
    });
  }
  take("projection", among("perspective", "orthographic"));
  take("camera", (text) => {
    const c = numbers(text, 10);
    if (!c || c.slice(0, 3).every((x, i) => x === c[3 + i]) || c.slice(6, 9).every((x) => x === 0) || !(c[9] >= 0.01 && c[9] < 179)) return false;
    return set("camera", rounded({ eye: c.slice(0, 3), at: c.slice(3, 6), up: c.slice(6, 9), fov: c[9],
      projection: parts.get("projection") === "orthographic" ? "orthographic" : "perspective" }));
  });
  take("set", (text) => {
    const match = /^(\w+)=(.*)$/s.exec(text);
    return match && set("settings", { ...state.settings, [match[1]]: match[2] });
  });
  take("range", (text) => {
    const limits = numbers(text, 2);
    return text === "auto" || text === "p99" ? set("range", text) : limits && limits[0] < limits[1] && set("range", limits);
  });
  for (const key of ["log", "skipHiddenBoxes"]) take(key, (text) => text === "0" || (text === "1" && set(key, true)));
  take("opacity", (text) => {
    const [value] = numbers(text, 1) ?? [NaN];
    return value >= 0 && value <= 1 && set("opacity", value);
  });
  for (const key of ["hidden", "isolated"]) {
    if (!parts.has(key)) continue;
    const ids = parts.get(key).split(","), good = ids.filter((id) => /^[io]\d{1,9}$/.test(id)).slice(0, 256);
    if (good.length < ids.length) ignored.push(`${key}=${clean(ids.filter((id) => !good.includes(id)).join(","))}`);
    if (good.length) state[key] = good;
  }
  const known = new Set([...Object.keys(TEXTS), ...Object.keys(NUMBERS), "projection", "camera", "set", "range", "log", "skipHiddenBoxes", "opacity", "hidden", "isolated"]);
  for (const name of new Set(parts.keys())) if (!known.has(name)) ignored.push(clean(name));
  return { state, ignored };
}

/** Returns {patch, ignored}: what of a link's state the scene and the daemon lack, and the defaults in its place. */
export function fitted(state, model) {
  const patch = {}, ignored = [];
  const drop = (key, text) => {
    patch[key] = DEFAULTS[key];
    ignored.push(text);
  };
  if (state.level !== "" && Number(state.level) >= Number(model.info.levels)) drop("level", `level=${state.level}`);
  if (state.intersector !== "auto" && !model.variants.some(({ name }) => name === state.intersector)) drop("intersector", `intersector=${state.intersector}`);
  if (state.time !== "" && !(state.time <= Number(model.info.animation_seconds?.[state.animation] ?? -1))) {
    drop("time", `time=${state.time}`);
    if (state.animation >= (model.info.animations?.length ?? 0) && state.animation !== DEFAULTS.animation) drop("animation", `animation=${state.animation}`);
    else patch.animation = DEFAULTS.animation;
  }
  const ran = model.resolve(patch.intersector ?? state.intersector);
  const params = model.variants.find(({ name }) => name === ran)?.params ?? [];
  const good = Object.entries(state.settings).filter(([name, text]) => {
    const param = params.find((one) => one.name === name);
    if (!param) return false;
    return param.type === "choice" ? param.choices.includes(text) : text.trim() !== "" && !(Number(text) < Number(param.minimum)) && !(Number(text) > Number(param.maximum)) && Number.isFinite(Number(text));
  });
  if (good.length < Object.keys(state.settings).length) {
    patch.settings = Object.fromEntries(good);
    ignored.push(...Object.entries(state.settings).filter(([name]) => !(name in patch.settings)).map(([name, text]) => `set=${name}=${text}`));
  }
  const [kind, value] = state.compare.split(/:(.*)/s);
  if ((kind === "intersector" && !model.variants.some(({ name }) => name === value)) || (kind === "scene" && !model.scenes.includes(value))) drop("compare", `compare=${state.compare}`);
  return { patch, ignored };
}
