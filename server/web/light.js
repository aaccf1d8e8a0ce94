// The settings of the lit view: how light is followed, and how it is shown. The first go into the request, the
// others only into the shader.
import { element, field, fillSelect } from "./dom.js";
import { INTEGRATORS, SETTINGS } from "./lists.js";
import { TONEMAP_NAMES, lookOf } from "./tonemap.js";

export const ENVIRONMENTS = [["auto", "sky, unless the file has lights"], ["sky", "sky"], ["none", "none"]];
const SAMPLES = [1, 4, 16, 64, 256, 1024, 4096];

/** Returns azimuth and elevation in degrees, or null. */
export function sunOf(text) {
  const [azimuth, elevation, more] = text.split(",").map((word) => (word.trim() === "" ? NaN : Number(word)));
  return more === undefined && Math.abs(azimuth) <= 360 && Math.abs(elevation) <= 90 ? [azimuth, elevation] : null;
}

/** True if the picture follows light, which is then stopped in part by blended surfaces. */
export const followsLight = ({ view, integrator }) => view === "lit" && integrator !== "primary";

/** True if the integrator uses a setting of Render. */
export const reads = (integrator, setting) => INTEGRATORS[integrator].settings.includes(setting);

/** Returns the fields of a Render that choose its paths. */
export function lightOf(state) {
  const { integrator, seed, env, sun } = state, angles = sunOf(sun);
  const settings = Object.entries(SETTINGS).map(([key, { field }]) => [field, state[key]]);
  return { integrator, seed, ...Object.fromEntries(settings), environment: env,
           ...(angles && env !== "none" ? { sun: true, sun_azimuth: angles[0], sun_elevation: angles[1] } : {}) };
}

const number = (store, key, properties) => {
  const input = element("input", { type: "number", ...properties });
  input.onchange = () => { if (input.value !== "" && input.reportValidity()) store.set({ [key]: Number(input.value) }); };
  store.on([key], (state) => { if (document.activeElement !== input) input.value = state[key]; }, true);
  return input;
};

/** The section "Light" of the panel "Setup". */
export function lightSection(store) {
  const env = element("select", { id: "environment" });
  env.onchange = () => store.set({ env: env.value });
  const sun = element("input", { type: "text", id: "sun", placeholder: "azimuth,elevation", maxLength: 40, spellcheck: false });
  sun.onchange = () => {
    const good = sun.value === "" || sunOf(sun.value);
    sun.setCustomValidity(good ? "" : "Degrees from the north eastwards, a comma, and degrees above the horizon: 135,40");
    if (sun.reportValidity()) store.set({ sun: sun.value });
  };
  store.on(["env", "sun"], (state) => {
    fillSelect(env, ENVIRONMENTS, state.env);
    // The sun is a part of the sky, which none has not.
    sun.disabled = state.env === "none";
    sun.value = sun.disabled ? "" : state.sun;
  }, true);
  const settings = Object.entries(SETTINGS).map(([key, { field: name, option, label, least, most, whole, text }]) => [name,
    field(label, number(store, key, { id: option.slice(2), min: least, max: most, step: whole ? 1 : "any" }), text)]);
  settings.unshift(["environment", field("Surroundings", env)], ["sun", field("Sun", sun, "Degrees from the north (-Z) eastwards, degrees above the horizon")]);
  const section = element("section", { ariaLabel: "Light" }, element("h2", {}, "Light"), ...settings.map(([, shown]) => shown), field("Seed", number(store, "seed", { id: "seed", min: 0, max: Number.MAX_SAFE_INTEGER, step: 1 })));
  store.on(["view", "integrator"], ({ view, integrator }) => {
    section.hidden = !followsLight({ view, integrator });
    for (const [name, shown] of settings) shown.hidden = !reads(integrator, name);
  }, true);
  return section;
}

/** The row below a lit picture: integrator, samples, exposure and tone map, and what there is so far. */
export function lightRow({ store, picture }) {
  const select = (id, key, options, value = (text) => text, others = []) => {
    const made = element("select", { id });
    made.onchange = () => store.set({ [key]: value(made.value) });
    store.on([key, ...others], (state) => fillSelect(made, options(state), String(state[key])), true);
    return made;
  };
  const integrator = select("integrator", "integrator", () => Object.keys(INTEGRATORS).map((name) => [name, name]));
  const samples = select("samples", "samples", (state) => [...new Set([...SAMPLES, state.samples])].sort((a, b) => a - b).map((n) => [String(n), String(n)]), Number);
  const tonemap = select("tonemap", "tonemap", ({ integrator: by }) => [["", `default (${INTEGRATORS[by].lit ? "agx" : "none"})`], ...TONEMAP_NAMES.map((name) => [name, name])], String, ["integrator"]);
  const exposure = element("input", { type: "number", id: "exposure", min: -64, max: 64, step: 0.5 });
  exposure.onchange = () => { if (exposure.reportValidity()) store.set({ exposure: exposure.value }); };
  const auto = element("button", { type: "button", id: "exposure-auto", title: "Exposure by the surfaces in the picture", onclick: () => store.set({ exposure: "" }) }, "auto");
  const facts = element("span", { className: "stats", id: "samples-so-far", role: "status" });
  const label = (text, control) => element("label", {}, text, control);
  const look = [label("Exposure", exposure), auto, label("Tone map", tonemap)];
  const row = element("div", { className: "row", id: "light-row" }, label("Light by", integrator), label("Samples", samples), ...look, facts);
  const show = () => {
    const { image } = picture, state = store.values;
    row.hidden = state.view !== "lit";
    if (row.hidden || !image) return;
    for (const control of [samples.parentElement, ...look]) control.hidden = state.integrator === "primary";
    auto.setAttribute("aria-pressed", state.exposure === "");
    if (document.activeElement !== exposure) exposure.value = state.exposure;
    if (image.linear) exposure.placeholder = lookOf(state, image).stops.toFixed(1);
    // An estimate says nothing about a picture of more samples.
    const { samples: count, noise: error } = image.error ?? {};
    const noise = error > 0 && count === image.samples ? `, noise ${Number((100 * error).toPrecision(2))}\u00a0%` : "";
    facts.textContent = state.camera?.projection === "orthographic" ? "Light needs a perspective camera: press P"
      : !image.view.lit || !image.linear ? "" : image.fine ? `${image.samples} of ${state.samples} samples${noise}` : "coarse";
  };
  for (const event of ["image", "progress"]) picture.addEventListener(event, show);
  store.on(["view", "integrator", "exposure", "tonemap", "samples", "camera"], show, true);
  return row;
}
