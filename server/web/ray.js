// The panel "Ray": the hit record of the pixel under the pointer, or of the pixel that was clicked.
import { pixelGenerator } from "./camera.js";
import { element, pairs } from "./dom.js";
import { COUNTERS } from "./lists.js";
import { explanation } from "./explain.js";
import { lightPath } from "./path.js";
import { jobOf } from "./requests.js";

const FIELDS = ["t", "prim", "geom", "path", "inst", "uid", "uv", "ng", "front", "position", "material", "flags", "object", "mask", "box_share", "tree_depth", "origin", "direction"];
const MISS = 0xffffffffffffffffn;
const NONE = 0xffffffff;

// Eager: a click explains its ray whichever panel is shown.
export const rayPanel = { id: "ray", title: "Ray", eager: true, build };

/** Asks for everything about one pixel's ray: {x, y, hit, columns, path}. */
export async function askPixel({ daemon, store, model, picture }, x, y, signal) {
  const state = store.values, { width, height } = picture.image;
  const counted = Object.keys(COUNTERS);
  const columns = {};
  for await (const { type, columns: found } of daemon.request("Query", {
    job: jobOf(state), fields: [...FIELDS, ...counted], generator: pixelGenerator(state.camera, x, y, width, height),
  }, { signal })) if (type === "Chunk") Object.assign(columns, found);
  const hit = columns.path[0] !== MISS;
  const path = hit ? await pathName(daemon, state.scene, model.info?.epoch, columns.path[0], signal) : null;
  return { x, y, hit, columns, path };
}

const names = new Map();
export async function pathName(daemon, scene, epoch, path, signal) {
  const key = `${scene} ${epoch} ${path}`;
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
  const vector = (values) => [...values].map((v) => Number(v.toPrecision(6))).join("  ");
  const number = (value) => (value === NONE ? "none" : String(value));
  const rows = [["Pixel", `${x}, ${y}`], ["Hit", hit ? "yes" : "miss"]];
  if (hit) {
    rows.push(["Instance path", path.name || "(the root)"], ["Path id", String(columns.path[0])], ["t", String(Number(columns.t[0].toPrecision(7)))],
      ["Primitive", number(columns.prim[0])], ["Geometry", number(columns.geom[0])], ["Material", named(materials, columns.material[0])],
      ["Instance", number(columns.inst[0])], ["uid", number(columns.uid[0])], ["Object", named(objects, columns.object[0])],
      ["Mask", columns.mask[0].toString(16)], ["Box share", String(Number(columns.box_share[0].toPrecision(4)))], ["Tree depth", number(columns.tree_depth[0])], ["u, v", vector(columns.uv)],
      ["Normal", vector(columns.ng)], ["Side", columns.front[0] ? "front" : "back"],
      ["Position", vector(columns.position.map((v, i) => v + origin[i]))]);
  }
  return rows;
}

export const counterRows = (columns) => Object.keys(COUNTERS).filter((name) => columns[name]).map((name) => [name, String(columns[name][0])]);

function build(app, place) {
  const { hover, model } = app;
  const record = element("div", { id: "record" }), counters = element("div", { id: "counters" });
  const hint = element("p", { className: "hint" }, "Point at the picture to see what its ray hits; click to keep it.");
  place.append(hint);
  lightPath(app, place);
  place.append(element("h2", {}, "Hit record"), record, element("h2", {}, "Work"), counters);
  explanation(app, place);
  const show = () => {
    const found = hover.pinned ?? hover.found;
    if (!found) return;
    record.replaceChildren(pairs(recordRows(found, model)));
    counters.replaceChildren(pairs(counterRows(found.columns)));
    hint.textContent = hover.pinned ? "This ray is kept. Press Escape to follow the pointer again." : "Click to keep this ray.";
  };
  hover.addEventListener("found", show);
  show();
}
