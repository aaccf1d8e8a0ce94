// The panel "Scene": its objects, instances and materials as tables that are linked with the picture, and
// boxes of its trees.
import { boxesSection } from "./boxes.js";
import { askDocument, latest } from "../documents.js";
import { element } from "../dom.js";
import { bytesText, countText, measuredText, vectorText } from "../numbers.js";
import { momentOf } from "../requests.js";
import { sortableTable } from "./tables.js";
import { visibilityBar } from "./visibility.js";

export const objectsPanel = { id: "objects", title: "Scene", build };

const PAGE = 200n;
const number = (title, value, text = countText) => ({ title, number: true, value, text: (row) => text(value(row)) });
/** A column of numbers that are not measured everywhere; those that are not come last. */
const measured = (title, key) => ({ title, number: true, value: (row) => row[key] ?? -1, text: (row) => measuredText(row[key], 2) });
const WAITING = "Asking the daemon.", NO_SCENE = "No scene is shown.";

function build(app, place) {
  place.append(visibilityBar(app), element("h2", {}, "Objects"), objects(app), element("h2", {}, "Instances"), ...instances(app),
               element("h2", {}, "Materials"), materials(app), element("h2", {}, "Boxes of trees"), boxesSection(app));
}

function objects({ model, selection }) {
  const table = sortableTable("Objects", [
    { title: "Name", value: (row) => row.name || `(${row.object})` }, number("Triangles", (row) => row.triangles),
    number("Instances", (row) => Number(row.placements)), number("Memory", (row) => row.bytes, bytesText), measured("SAH", "sah_cost"),
    measured("EPO", "epo"), measured("Fill", "box_share"), number("Depth", (row) => row.height), number("No.", (row) => row.object, String)],
  { choose: (row) => selection.choose({ kind: "object", object: row.object, name: row.name }) },
  { titles: { SAH: "Node visits that a ray through its box is expected to need", EPO: "Node visits where a ray ends, in trees that do not hold what it hits", Fill: "Area of its triangles over half that of their boxes: 1 is good, 0 is bad",
    Depth: "Nodes on the longest path of its tree" }, empty: WAITING });
  const show = () => { table.show(model.objects, model.info ? WAITING : NO_SCENE); mark(); };
  const mark = () => table.mark((row) => selection.hasObject(row.object));
  model.addEventListener("change", show);
  selection.addEventListener("change", mark);
  show();
  return table.node;
}

function materials({ store, model, selection }) {
  const table = sortableTable("Materials", [{ title: "Name", value: (row) => row.name || `(${row.index})` }, { title: "Alpha", value: (row) => row.alpha },
    number("Triangles", (row) => row.triangles), number("No.", (row) => row.index, String)], { choose: (row) => selection.choose({ kind: "material", material: row.index, name: row.name }) });
  const show = () => { table.show(model.materials, !model.info ? NO_SCENE : model.info.materials ? WAITING : "The scene has no materials."); mark(); };
  const mark = () => table.mark((row) => selection.hasMaterial(row.index));
  model.addEventListener("change", show);
  selection.addEventListener("change", mark);
  store.on(["scene"], show);
  show();
  return table.node;
}

function instances(app) {
  const { daemon, store, model, selection, failed } = app;
  const place = (row) => vectorText(row.box ? row.box[0].map((x, i) => (x + row.box[1][i]) / 2) : [], 4);
  const table = sortableTable("Instances", [
    { title: "Name", value: (row) => row.name || "(the root)" }, { ...number("Path", (row) => Number(row.path), String), ascending: true },
    { title: "Object", value: (row) => row.mesh, least: 84 }, { title: "Centre", value: place, least: 400 }, { title: "Mask", value: (row) => row.mask.toString(16) }],
  { choose: (row) => selection.choose({ kind: "placements", first: BigInt(row.path), count: 1n, object: row.object, name: row.name }) }, { by: 1, empty: WAITING });
  const range = element("span", { className: "hint" });
  let first = 0n, total = 0n, moment = "";
  const momentNow = () => JSON.stringify(momentOf(store.values));
  const step = (text, by) => element("button", { type: "button", onclick: () => load(first + by * PAGE) }, text);
  const [before, after] = [step("Previous", -1n), step("Next", 1n)];
  const run = latest(failed);
  function load(from) {
    first = from < 0n ? 0n : from;
    moment = momentNow();
    return run(async (signal) => {
      const document = await askDocument(daemon, "Structure", { scene: store.values.scene, ...momentOf(store.values), kind: "placements",
        first: String(first), count: Number(PAGE) }, { signal });
      total = BigInt(document.total);
      table.show(document.rows, "The scene has no instances.");
      mark();
      const last = first + BigInt(document.rows.length);
      range.textContent = total <= PAGE ? `${countText(total)} in all` : `Paths ${countText(first)} to ${countText(last - 1n)} of ${countText(total)}`;
      before.disabled = first === 0n;
      after.disabled = last >= total;
    });
  }
  const mark = () => table.mark((row) => selection.hasPath(BigInt(row.path)));
  selection.addEventListener("change", () => {
    const { chosen } = selection;
    if (chosen?.kind === "placements" && (chosen.first < first || chosen.first >= first + PAGE)) load((chosen.first / PAGE) * PAGE);
    else mark();
  });
  let shown = "";
  const change = () => {
    if (model.version === shown) return;
    shown = model.version;
    table.show([], model.info ? WAITING : NO_SCENE);
    range.textContent = "";
    if (model.info) load(0n);
  };
  model.addEventListener("change", change);
  // Another moment has other places, which nobody asks for while the panel is hidden.
  store.on(["time", "animation", "panel"], () => { if (model.info && store.values.panel === "objects" && moment !== momentNow()) load(first); });
  change();
  return [table.node, element("div", { className: "buttons" }, before, after, range)];
}
