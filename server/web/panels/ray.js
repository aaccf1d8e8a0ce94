// The panel "Ray": the hit record of the pixel under the pointer, or of the pixel that was clicked.
import { pixelGenerator } from "../camera.js";
import { element, pairs } from "../dom.js";
import { COUNTERS } from "../lists.js";
import { countText, placeText, valueText, vectorText } from "../numbers.js";
import { explanation } from "./explain.js";
import { lightPath } from "./path.js";
import { jobOf } from "../requests.js";
import { viewOf } from "../views.js";

const FIELDS = ["t", "prim", "geom", "path", "inst", "uid", "uv", "ng", "front", "position", "material", "flags", "object", "mask", "box_share", "tree_depth", "origin", "direction"];
const MISS = 0xffffffffffffffffn;
const NONE = 0xffffffff;

// Eager: a click explains its ray whichever panel is shown.
export const rayPanel = { id: "ray", title: "Ray", eager: true, build };

/** Asks for everything about one pixel's ray: {x, y, hit, columns, path}. */
export async function askPixel({ daemon, store, model, canvas }, x, y, signal) {
  const state = store.values, { width, height } = canvas;
  const counted = Object.keys(COUNTERS);
  const columns = {};
  // The work is that of the picture's kind; only a closest hit has a record.
  const asked = viewOf(state.view).counter && state.kind === "any" ? [["closest", FIELDS], ["any", counted]] : [["closest", [...FIELDS, ...counted]]];
  for (const [kind, fields] of asked) {
    for await (const { type, columns: found } of daemon.request("Query", {
      job: jobOf(state), kind, fields, generator: pixelGenerator(state.camera, x, y, width, height),
    }, { signal })) if (type === "Chunk") Object.assign(columns, found);
  }
  const hit = columns.path[0] !== MISS;
  const path = hit ? await pathName(daemon, state.scene, model.version, columns.path[0], signal) : null;
  return { x, y, hit, columns, path };
}

const names = new Map();
export async function pathName(daemon, scene, version, path, signal) {
  const key = `${version} ${path}`;
  if (!names.has(key)) {
    if (names.size > 2000) names.clear();
    names.set(key, await daemon.ask("Path", { scene, path: String(path) }, { signal }));
  }
  return names.get(key);
}

/** A thing by its name, where the file names it, and its number: names may be equal. */
const named = (list, index) => (index === NONE ? "none" : list[index]?.name ? `${list[index].name} (${index})` : String(index));

/** Rows of a hit record: [name, text]. `model` has the names of objects and materials. */
export function recordRows({ x, y, hit, columns, path }, { origin = [0, 0, 0], objects = [], materials = [] } = {}) {
  const number = (value) => (value === NONE ? "none" : String(value));
  const rows = [["Pixel", `${x}, ${y}`], ["Hit", hit ? "yes" : "miss"]];
  if (hit) {
    rows.push(["Instance path", path.name || "(the root)"], ["Path id", String(columns.path[0])], ["t", valueText(columns.t[0], 7)],
      ["Primitive", number(columns.prim[0])], ["Geometry", number(columns.geom[0])], ["Material", named(materials, columns.material[0])],
      ["Instance", number(columns.inst[0])], ["uid", number(columns.uid[0])], ["Object", named(objects, columns.object[0])],
      ["Mask", columns.mask[0].toString(16)], ["Box share", valueText(columns.box_share[0], 4)], ["Tree depth", number(columns.tree_depth[0])], ["u, v", vectorText(columns.uv)],
      ["Normal", vectorText(columns.ng)], ["Side", columns.front[0] ? "front" : "back"],
      ["Position", placeText(columns.position, origin)]);
  }
  return rows;
}

export const counterRows = (columns) => Object.keys(COUNTERS).filter((name) => columns[name]).map((name) => [name, countText(columns[name][0])]);

function build(app, place) {
  const { hover, model } = app;
  const record = element("div", { id: "record" }), counters = element("div", { id: "counters" });
  const hint = element("p", { className: "hint", id: "ray-hint" });
  place.append(hint);
  lightPath(app, place);
  const facts = element("div", {}, element("h2", {}, "Hit record"), record, element("h2", {}, "Work"), counters);
  place.append(facts);
  explanation(app, place);
  const show = () => {
    const found = hover.pinned ?? hover.found;
    facts.hidden = !found;
    record.replaceChildren(found ? pairs(recordRows(found, model)) : "");
    counters.replaceChildren(found ? pairs(counterRows(found.columns)) : "");
    const lost = hover.moved ? "The view has changed, and the ray that was kept is no longer one of its pixels. " : "";
    hint.textContent = hover.pinned ? "This ray is kept. Press Escape to follow the pointer again."
      : found ? "Click to keep this ray." : `${lost}Point at the picture to see what its ray hits; click to keep it.`;
  };
  hover.addEventListener("found", show);
  show();
}
