// Boxes of the scene's trees as wireframes: a range of tree depths of the trees at one nesting level.
import { levelColour } from "./explain.js";
import { askDocument, latest } from "../documents.js";
import { element, field, fillSelect } from "../dom.js";
import { counted } from "../numbers.js";
import { momentOf } from "../requests.js";

const BOXES_MAX = 1200;

/** "level:least:most:one" as the link has it, or null. */
export function parseBoxes(text) {
  const match = /^(\d{1,2}):(\d{1,2}):(\d{1,2}):([01])$/.exec(text);
  return match ? { level: Number(match[1]), least: Number(match[2]), most: Number(match[3]), one: match[4] === "1" } : null;
}

/** A box moved by a 3x4 matrix that ends in the world; the page's places are relative to the scene's origin. */
function placed(tree, [depth, , ...box], origin) {
  const matrix = tree.to_world.map((x, i) => (i % 4 === 3 ? x - origin[Math.floor(i / 4)] : x));
  return { low: box.slice(0, 3), high: box.slice(3), matrix, colour: levelColour(depth), width: 1 };
}

export function boxesSection(app) {
  const { store, model, daemon, overlay, selection } = app;
  const level = element("select", { id: "boxes-level" });
  const least = element("input", { type: "number", min: 0, max: 47, value: 0, id: "boxes-least" });
  const most = element("input", { type: "number", min: 0, max: 47, value: 2, id: "boxes-most" });
  const one = element("input", { type: "checkbox", id: "boxes-one" });
  const hint = element("p", { className: "hint", id: "boxes-hint" });
  const set = () => store.set({ boxes: level.value === "" ? "" : [level.value, least.value, Math.max(Number(least.value), Number(most.value)), one.checked ? 1 : 0].join(":") });
  for (const control of [level, least, most, one]) control.onchange = () => { if (least.reportValidity() && most.reportValidity()) set(); };

  function levels() {
    const count = Number(model.info?.levels ?? 1);
    const chosen = parseBoxes(store.values.boxes);
    fillSelect(level, [["", "none"], ...Array.from({ length: count }, (_, i) => [String(i), i === 0 ? "0 (root)" : String(i)])], chosen ? String(chosen.level) : "");
    if (chosen) [least.value, most.value, one.checked] = [chosen.least, chosen.most, chosen.one];
  }
  const run = latest((error) => { hint.textContent = error.message; });
  function show() {
    const chosen = parseBoxes(store.values.boxes);
    const path = selection.chosen?.kind === "placements" ? selection.chosen.first : null;
    if (!chosen || !model.info) {
      hint.textContent = "";
      overlay.boxes("trees", []);
      return undefined;
    }
    if (chosen.one && path === null) {
      hint.textContent = "Select an instance: click it in the picture.";
      return overlay.boxes("trees", []);
    }
    return run(async (signal) => {
      const document = await askDocument(daemon, "Structure", { scene: store.values.scene, ...momentOf(store.values), kind: "boxes", level: chosen.level, count: BOXES_MAX,
        depth_min: chosen.least, depth_max: chosen.most, ...(chosen.one ? { one: true, first: String(path) } : {}) }, { signal });
      const boxes = document.trees.flatMap((tree) => tree.boxes.map((box) => placed(tree, box, model.origin)));
      overlay.boxes("trees", boxes);
      hint.textContent = `${counted(boxes.length, "box", "boxes")} of ${counted(document.trees.length, "tree", "trees")}${document.complete ? "" : "; more are left out: choose fewer depths, or one instance"}.`;
    });
  }
  store.on(["boxes", "scene", "time", "animation"], () => { levels(); show(); });
  selection.addEventListener("change", () => { if (parseBoxes(store.values.boxes)?.one) show(); });
  model.addEventListener("change", () => { levels(); show(); });
  levels();
  show();
  return element("div", {}, field("Level", level), field("From depth", least), field("To depth", most), field("Selected one only", one), hint);
}
