// The panel "Ranking": which instances, meshes and materials the rays of the picture spend their work on,
// and what to do about it. The document is described in client/EXPLAIN.md.
import { latest } from "./documents.js";
import { element, field, fillSelect } from "./dom.js";
import { shortNumber } from "./histogram.js";
import { jobOf } from "./requests.js";
import { rankingOf } from "./selection.js";
import { sortableTable } from "./tables.js";

export const rankingPanel = { id: "ranking", title: "Ranking", build };

const TABLES = ["instances", "meshes", "materials"];
const percent = (share) => `${(100 * share).toFixed(1)} %`;

function build(app, place) {
  const { store, model, picture, selection } = app;
  const level = element("select", { id: "ranking-level" });
  const kind = element("select", { id: "ranking-table" });
  fillSelect(kind, TABLES.map((name) => [name, name]), "instances");
  const hint = element("p", { className: "hint", id: "ranking-hint" });
  const share = (title, key) => ({ title, number: true, value: (row) => row[key], text: (row) => percent(row[key]) });
  // Equal names have different numbers: paths of instances, objects of meshes.
  const numberIn = (row) => row.path ?? row.index ?? "";
  const table = sortableTable("Ranking by work", [share("Share", "share"), { title: "Name", value: (row) => row.name || "(unnamed)" },
    { title: "No.", number: true, ascending: true, value: (row) => Number(numberIn(row)), text: (row) => String(numberIn(row)) }, share("Wasted", "wasted"),
    { title: "Per ray", number: true, value: (row) => row.work_per_ray, text: (row) => shortNumber(Number(row.work_per_ray.toPrecision(3))) }], { choose },
  { "No.": "First path of an instance, number of an object or material: it tells equal names apart" });
  const rest = element("p", { className: "hint" });
  const findings = element("div", { id: "findings" });
  place.append(field("Table", kind), field("Group by", level), hint, table.node, rest, element("h2", {}, "Diagnosis"), findings);

  let document = null;
  function choose(row) {
    if (kind.value === "instances") {
      selection.choose({ kind: "placements", first: BigInt(row.path), count: BigInt(row.placements), name: row.name });
    } else {
      chooseNumbered(kind.value === "meshes" ? "object" : "material", row.index, row.name);
    }
  }
  function chooseNumbered(kind, index, name) {
    if (typeof index === "number") selection.choose({ kind, [kind]: index, name });
  }
  function mark() {
    table.mark((row) => {
      if (kind.value === "instances") return selection.hasPath(BigInt(row.path), BigInt(row.placements));
      if (kind.value === "meshes") return selection.hasObject(row.index);
      return selection.hasMaterial(row.index);
    });
  }
  function show() {
    if (!document) return;
    const { rows, others, remainder } = document[kind.value];
    table.show(rows);
    mark();
    rest.textContent = [others.rows ? `${others.rows} others: ${percent(others.share)}.` : "",
                        `${kind.value === "materials" ? "Boxes" : "Trees above them"}: ${percent(remainder.share)}.`].join(" ");
    hint.textContent = `${document.size.join(" x ")} rays, ${shortNumber(document.total.work)} boxes and primitives tested. ` +
      "Wasted is the part spent on rays that hit nothing in it.";
    findings.replaceChildren(...document.findings.length === 0 ? [element("p", { className: "hint" }, "Nothing stands out.")]
      : document.findings.map((finding) => element("button", { type: "button", className: "finding", onclick: () =>
          chooseNumbered(...numberOf(finding), finding.subject) },
        element("strong", {}, `${capital(finding.finding.replaceAll("_", " "))}: ${finding.subject || "(unnamed)"}${numberText(finding)}`),
        element("span", {}, `${Number(finding.figure.toPrecision(3))} ${finding.unit}, ${finding.side} ${finding.threshold}; ${percent(finding.share)} of all work.`),
        element("span", {}, `Remedy: ${finding.remedy}.`))));
  }

  const run = latest((error) => { hint.textContent = error.message; });
  let shown = "";
  function ask() {
    const state = store.values;
    if (!picture.image?.complete || state.panel !== "ranking" || !state.camera) return;
    const key = JSON.stringify([jobOf(state), state.camera, picture.image.width, picture.image.height, level.value]);
    if (key === shown) return;
    shown = key;
    hint.textContent = "Counting.";
    run(async (signal) => {
      document = await rankingOf(app, Number(level.value), signal);
      show();
    });
  }
  function levels() {
    const count = Number(model.info?.levels ?? 1);
    fillSelect(level, [["0", "innermost instance"], ...Array.from({ length: Math.max(count - 1, 0) }, (_, i) => [String(i + 1), `instance at level ${i + 1}`])], level.value || "0");
    if (level.selectedIndex < 0) level.value = "0";
  }
  level.onchange = ask;
  kind.onchange = show;
  selection.addEventListener("change", mark);
  model.addEventListener("change", levels);
  picture.addEventListener("image", ask);
  store.on(["panel"], ask);
  levels();
  ask();
}

/** The kind and number of a finding's subject: ["object", 3]. */
const numberOf = (finding) => (finding.material === undefined ? ["object", finding.object] : ["material", finding.material]);
export const numberText = (finding) => {
  const [kind, index] = numberOf(finding);
  return typeof index === "number" ? ` (${kind} ${index})` : "";
};

const capital = (text) => text[0].toUpperCase() + text.slice(1);
