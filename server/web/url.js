// The whole view in the fragment of the address, so that a link shows a colleague the same. What has its
// default is left out. Unreadable parts of a link are ignored: a link comes from outside.
import { DEFAULTS } from "./store.js";
import { rounded } from "./camera.js";

const TEXTS = ["scene", "view", "level", "compare", "intersector", "mask", "kind", "palette", "size", "control",
               "upAxis", "panel", "cameraName", "boxes"];
const TEXT_MAX = 300;
const clean = (text) => text.slice(0, TEXT_MAX).replace(/[\p{Cc}]/gu, "");
const numbers = (text, count) => {
  const found = text.split(",").map(Number);
  return found.length === count && found.every(Number.isFinite) ? found : null;
};

export function toFragment(state) {
  const parts = new URLSearchParams();
  for (const key of TEXTS) if (state[key] !== DEFAULTS[key]) parts.set(key, state[key]);
  const { camera } = state;
  if (camera) {
    parts.set("camera", [...camera.eye, ...camera.at, ...camera.up, camera.fov].join(","));
    if (camera.projection === "orthographic") parts.set("projection", "orthographic");
  }
  for (const [name, value] of Object.entries(state.settings)) parts.append("set", `${name}=${value}`);
  if (state.range !== DEFAULTS.range) parts.set("range", [state.range].flat().join(","));
  if (state.log) parts.set("log", "1");
  if (state.opacity !== 1) parts.set("opacity", state.opacity);
  if (state.hidden.length) parts.set("hidden", state.hidden.join(","));
  if (state.isolated.length) parts.set("isolated", state.isolated.join(","));
  return parts.toString().replaceAll("%2C", ",").replaceAll("%3D", "=");
}

export function fromFragment(fragment) {
  const parts = new URLSearchParams(fragment.replace(/^#/, ""));
  const state = {};
  for (const key of TEXTS) if (parts.has(key)) state[key] = clean(parts.get(key));
  if (state.mask !== undefined && !/^[0-9a-f]{1,8}$/i.test(state.mask)) delete state.mask;
  const c = numbers(parts.get("camera") ?? "", 10);
  const differs = (a, b) => a.some((x, i) => x !== b[i]);
  if (c && differs(c.slice(0, 3), c.slice(3, 6)) && c.slice(6, 9).some((x) => x !== 0) && c[9] >= 0.01 && c[9] < 179) {
    state.camera = rounded({ eye: c.slice(0, 3), at: c.slice(3, 6), up: c.slice(6, 9), fov: c[9],
      projection: parts.get("projection") === "orthographic" ? "orthographic" : "perspective" });
  }
  const settings = parts.getAll("set").map((text) => /^(\w+)=(.*)$/s.exec(clean(text))).filter(Boolean);
  if (settings.length) state.settings = Object.fromEntries(settings.map((match) => [match[1], match[2]]));
  const range = parts.get("range");
  const limits = numbers(range ?? "", 2);
  if (range === "auto" || range === "p99") state.range = range;
  else if (limits && limits[0] < limits[1]) state.range = limits;
  if (parts.get("log") === "1") state.log = true;
  const opacity = Number(parts.get("opacity") ?? NaN);
  if (opacity >= 0 && opacity < 1) state.opacity = opacity;
  for (const key of ["hidden", "isolated"]) {
    const ids = (parts.get(key) ?? "").split(",").filter((id) => /^[io]\d{1,9}$/.test(id));
    if (ids.length) state[key] = ids.slice(0, 256);
  }
  return state;
}
