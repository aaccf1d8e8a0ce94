// The panel "Scene": its objects, instances and materials as tables that are linked with the picture, and
// boxes of its trees.
import { boxesSection } from "./boxes.js";
import { askDocument, latest } from "./documents.js";
import { element } from "./dom.js";
import { shortNumber } from "./histogram.js";
import { sortableTable } from "./tables.js";
import { visibilityBar } from "./visibility.js";

export const objectsPanel = { id: "objects", title: "Scene", build };

const PAGE = 200n;
const number = (title, value, text = shortNumber) => ({ title, number: true, value, text: (row) => text(value(row)) });
const short = (value) => String(Number(Number(value).toPrecision(3)));

function build(app, place) {
  place.append(visibilityBar(app), element("h2", {}, "Objects"), objects(app), element("h2", {}, "Instances"), ...instances(app),
               element("h2", {}, "Materials"), materials(app), element("h2", {}, "Boxes of trees"), boxesSection(app));
}

function objects({ model, selection }) {
  const table = sortableTable("Objects", [
    { title: "Name", value: (row) => row.name || `(${row.object})` }, number("Triangles", (row) => row.triangles),
    number("Instances", (row) => Number(row.placements)), number("Bytes", (row) => row.bytes), number("Depth", (row) => row.height),
    number("SAH", (row) => row.sah_cost ?? 0, short), number("Fill", (row) => row.box_share ?? 0, short)],
  { choose: (row) => selection.choose({ kind: "object", object: row.object, name: row.name }) },
  { SAH: "Node visits that a ray through its box is expected to need", Fill: "Area of its triangles over half that of their boxes: 1 is good, 0 is bad",
    Depth: "Nodes on the longest path of its tree" });
  const show = () => { table.show(model.objects); mark(); };
  const mark = () => table.mark((row) => selection.hasObject(row.object));
  model.addEventListener("change", show);
  selection.addEventListener("change", mark);
  show();
  return table.node;
}

function materials({ store, model, selection }) {
  const table = sortableTable("Materials", [{ title: "Name", value: (row) => row.name || `(${row.index})` }, { title: "Alpha", value: (row) => row.alpha },
    number("Triangles", (row) => row.triangles)], { choose: (row) => selection.choose({ kind: "material", material: row.index, name: row.name }) });
  const show = () => { table.show(model.materials); mark(); };
  const mark = () => table.mark((row) => selection.hasMaterial(row.index));
  model.addEventListener("change", show);
  selection.addEventListener("change", mark);
  store.on(["scene"], show);
  show();
  return table.node;
}

function instances(app) {
  const { daemon, store, model, selection, failed } = app;
  const place = (row) => (row.box ? row.box[0].map((x, i) => short((x + row.box[1][i]) / 2)).join(" ") : "");
  const table = sortableTable("Instances", [
    { ...number("Path", (row) => Number(row.path), String), ascending: true }, { title: "Name", value: (row) => row.name || "(the root)" }, { title: "Object", value: (row) => row.mesh },
    { title: "Mask", value: (row) => row.mask.toString(16) }, { title: "Centre", value: place }],
  { choose: (row) => selection.choose({ kind: "placements", first: BigInt(row.path), count: 1n, object: row.object, name: row.name }) });
  const range = element("span", { className: "hint" });
  let first = 0n, total = 0n;
  const step = (text, by) => element("button", { type: "button", onclick: () => load(first + by * PAGE) }, text);
  const [before, after] = [step("Previous", -1n), step("Next", 1n)];
  const run = latest(failed);
  function load(from) {
    first = from < 0n ? 0n : from;
    return run(async (signal) => {
      const document = await askDocument(daemon, "Structure", { scene: store.values.scene, kind: "placements", first: String(first), count: Number(PAGE) }, { signal });
      total = BigInt(document.total);
      table.show(document.rows);
      mark();
      const last = first + BigInt(document.rows.length);
      range.textContent = total === 0n ? "none" : `${first} to ${last - 1n} of ${shortNumber(Number(total))}`;
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
    if (!model.info || `${model.info.name} ${model.info.epoch}` === shown) return;
    shown = `${model.info.name} ${model.info.epoch}`;
    load(0n);
  };
  model.addEventListener("change", change);
  change();
  return [table.node, element("div", { className: "buttons" }, before, after, range)];
}
