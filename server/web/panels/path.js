// The path of light through a pixel of the lit view: its rays as a list, and as lines over the picture. The lines
// stay while the camera moves, so that the path can be seen from the side. client/EXPLAIN.md describes the document.
import { add, cameraTable, length, scale, sub, unit } from "../camera.js";
import { askDocument, latest } from "../documents.js";
import { element } from "../dom.js";
import { lightOf } from "../light.js";
import { SETTINGS } from "../lists.js";
import { jobOf } from "../requests.js";
import { viewOf } from "../views.js";
import { RAY_KEYS } from "../store.js";

const COLOURS = { camera: "#ffffff", bounce: "#4cc9f0", reached: "#ffd166", blocked: "#ff5d5d" };
const kindOf = ({ kind, blocked }) => (kind === "shadow" ? (blocked ? "blocked" : "reached") : kind);

/** Says a ray in words, as `raynest explain` does. */
export function pathRayText(ray) {
  const { kind, blocked, bounce, hit } = ray;
  const met = hit && `${hit.name || "(the root)"}${hit.material === null ? "" : `, material ${hit.material}`}, t ${Number(hit.t).toPrecision(5)}`;
  if (kind === "shadow") return blocked ? `Shadow ray: blocked${met ? ` by ${met}` : ""}` : "Shadow ray: reaches the light";
  const who = kind === "camera" ? "Camera ray" : `Bounce ${bounce}`;
  return met ? `${who}: hits ${met}` : `${who}: leaves the scene`;
}

/** Returns the lines {from, to, colour, dash, mark} of rays; those that meet nothing are as long as `far`. */
export function pathLines(rays, origin, far) {
  return rays.map((ray) => {
    const start = sub(ray.origin, origin), kind = kindOf(ray);
    // Near the eye a camera ray is seen from its end: rounding would turn it there.
    const from = kind === "camera" && ray.hit ? add(start, scale(sub(sub(ray.hit.position, origin), start), 0.02)) : start;
    const ends = ray.hit ? sub(ray.hit.position, origin)
      : ray.tmax === null ? add(from, scale(unit(ray.direction), far)) : add(from, scale(ray.direction, ray.tmax));
    return { from, to: ends, colour: COLOURS[kind], dash: ray.kind === "shadow" ? [6, 4] : [], width: { shadow: 1.5, camera: 1.5 }[ray.kind] ?? 2.5,
             mark: Boolean(ray.hit) && kind !== "reached" };
  });
}

export function lightPath(app, place) {
  const { daemon, hover, overlay, model, store, canvas } = app;
  const summary = element("p", { className: "hint", id: "path-summary" });
  const earlier = element("p", { className: "hint", hidden: true }, "The pixel is that of the view in which it was clicked.");
  const list = element("ol", { className: "tree", id: "path-rays", ariaLabel: "Rays of the path" });
  const step = (text, title, by) => element("button", { type: "button", title, onclick: () => store.set({ sample: Math.max(store.values.sample + by, 0) }) }, text);
  const buttons = element("div", { className: "buttons" }, step("Previous sample", "The path of the sample before", -1), step("Next sample", "The path of the next sample", 1));
  const section = element("section", { hidden: true, ariaLabel: "Path of light" }, element("h2", {}, "Path of light"), buttons, earlier, summary, list);
  place.append(section);
  const run = latest((error) => app.failed(error));
  let asked = null;

  function show(document) {
    const { rays, radiance, sample, integrator } = document;
    const { low, high } = model.box, far = 2 * length(sub(high, low));
    const lines = pathLines(rays, model.origin, far);
    summary.textContent = `Sample ${sample} of pixel ${document.pixel.join(", ")} by ${integrator}: ${rays.length} rays bring ${radiance.map((x) => Number(x).toPrecision(3)).join("  ")} of red, green and blue.`;
    list.replaceChildren(...rays.map((ray, i) => {
      const row = element("button", { type: "button", className: `step${kindOf(ray) === "blocked" ? " refused" : ""}` },
        element("span", { className: `ray ${kindOf(ray)}`, ariaHidden: "true" }), pathRayText(ray));
      row.style.paddingLeft = `${4 + 10 * Math.min(ray.bounce, 12)}px`;
      row.onfocus = row.onmouseenter = () => overlay.lines("ray", [{ ...lines[i], width: 5, dash: [] }]);
      row.onblur = row.onmouseleave = () => overlay.lines("ray", []);
      return element("li", {}, row);
    }));
    overlay.lines("path", lines);
  }
  function clear() {
    section.hidden = true;
    asked = app.path = null;
    overlay.lines("path", []);
    overlay.lines("ray", []);
  }
  function ask() {
    const mine = asked;
    return run(async (signal) => {
      const document = await askDocument(daemon, "Render", { ...mine, samples: store.values.sample + 1 }, { signal });
      if (asked !== mine) return;
      section.hidden = false;
      earlier.hidden = JSON.stringify(asked.camera) === JSON.stringify(cameraTable(store.values.camera));
      app.path = { document, clear };
      show(document);
    });
  }
  hover.addEventListener("found", () => {
    const state = store.values, { pinned } = hover;
    if (!pinned || !viewOf(state.view).lit || state.integrator === "primary" || state.camera.projection === "orthographic") return;
    const { width, height } = canvas;
    asked = { job: jobOf(state), camera: cameraTable(state.camera), width, height, ...lightOf(state), encode: `path+${pinned.x},${pinned.y}` };
    ask();
  });
  /** Follows the same ray again where the scene, or how light is followed, has changed. */
  function again() {
    if (!asked) return;
    asked = { ...asked, job: jobOf(store.values), ...lightOf(store.values) };
    ask();
  }
  store.on(["sample"], () => { if (asked) ask(); });
  store.on(["camera"], () => { earlier.hidden = !asked || JSON.stringify(asked.camera) === JSON.stringify(cameraTable(store.values.camera)); });
  store.on([...RAY_KEYS, "seed", ...Object.keys(SETTINGS), "env", "sun"], again);
  let version = model.version;
  model.addEventListener("change", () => {
    if (version !== model.version && model.info) again();
    version = model.version;
  });
  store.on(["scene", "view", "integrator"], clear);
}
