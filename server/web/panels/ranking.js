// The panel "Ranking": which instances, meshes and materials the rays of the picture spend their work on,
// and what to do about it. The document is described in client/EXPLAIN.md.
import { latest } from "../documents.js";
import { element, field, fillSelect } from "../dom.js";
import { countText, fixedText, percentText, valueText } from "../numbers.js";
import { jobOf } from "../requests.js";
import { rankingOf } from "./selection.js";
import { sortableTable } from "./tables.js";
import { RAY_KEYS } from "../store.js";

export const rankingPanel = { id: "ranking", title: "Ranking", build };

/** The tables, and what the work that belongs to none of their rows is. */
const TABLES = { instances: "Trees above them", meshes: "Trees of instances alone", materials: "Boxes" };
const FIRST_PIXELS = 120 * 68;  // for a first ranking, which comes at once; the other one refines it

function build(app, place) {
  const { store, model, picture, selection, canvas } = app;
  const level = element("select", { id: "ranking-level" });
  const kind = element("select", { id: "ranking-table" });
  const hint = element("p", { className: "hint", id: "ranking-hint", role: "status" });
  const share = (title, key) => ({ title, number: true, value: (row) => row[key], text: (row) => percentText(row[key]) });
  // Equal names have different numbers: paths of instances, objects of meshes.
  const numberIn = (row) => row.path ?? row.index ?? "";
  const table = sortableTable("Ranking by work", [share("Share", "share"), { title: "Name", value: (row) => row.name || "(unnamed)", least: 72 },
    { title: "No.", number: true, ascending: true, value: (row) => Number(numberIn(row)), text: (row) => String(numberIn(row)) }, share("Wasted", "wasted"),
    { title: "Per ray", number: true, value: (row) => row.work_per_ray, text: (row) => fixedText(row.work_per_ray, 1) }], { choose },
  { titles: { "No.": "First path of an instance, number of an object or material: it tells equal names apart", Wasted: "Part of its work on rays that hit nothing in it" } });
  const rest = element("p", { className: "hint" });
  const findings = element("div", { id: "findings" });
  const grouping = field("Group by", level);
  place.append(field("Table", kind), grouping, hint, table.node, rest, element("h2", {}, "Diagnosis"), findings);

  let document = null, wished = "instances";

  /** Offers the tables that have rows: a scene without instances has work in its meshes. */
  function offer() {
    const names = Object.keys(TABLES), filled = names.filter((name) => document?.[name].rows.length), offered = filled.length ? filled : names;
    if (offered.join() !== [...kind.options].map(({ value }) => value).join()) fillSelect(kind, offered.map((name) => [name, name]));
    kind.value = offered.includes(wished) ? wished : offered[0];
    grouping.hidden = !offered.includes("instances");
  }
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

  /** Shows words in place of everything that the ranking says. */
  function say(words) {
    document = null;
    offer();
    hint.textContent = words;
    table.show([], "There is no ranking yet.");
    rest.textContent = "";
    findings.replaceChildren(element("p", { className: "hint" }, "It follows the ranking."));
  }

  function show(refining = false) {
    if (!document) return;
    offer();
    const { rows, others, remainder } = document[kind.value];
    table.show(rows, "No ray enters any of them.");
    mark();
    rest.textContent = [others.rows ? `${countText(others.rows)} others: ${percentText(others.share)}.` : "",
                        `${TABLES[kind.value]}: ${percentText(remainder.share)}.`].join(" ");
    hint.textContent = `${document.size.join(" x ")} rays, ${countText(document.total.work)} boxes and primitives tested. ` +
      `Wasted is the part spent on rays that hit nothing in it.${store.values.kind === "any" ? " They look for closest hits, also where the picture is of any." : ""}${refining ? " More rays refine it." : ""}`;
    findings.replaceChildren(...document.findings.length === 0 ? [element("p", { className: "hint" }, "Nothing stands out.")]
      : document.findings.map((finding) => element("button", { type: "button", className: "finding", onclick: () =>
          chooseNumbered(...numberOf(finding), finding.subject) },
        element("strong", {}, `${capital(finding.finding.replaceAll("_", " "))}: ${finding.subject || "(unnamed)"}${numberText(finding)}`),
        element("span", {}, `${valueText(finding.figure, 3)} ${finding.unit}, ${finding.side} ${finding.threshold}; ${percentText(finding.share)} of all work.`),
        element("span", {}, `Remedy: ${finding.remedy}.`))));
  }

  const run = latest((error) => say(error.message));
  let wanted = "";
  const keyNow = () => JSON.stringify([jobOf(store.values), store.values.camera, canvas.width, canvas.height, level.value, model.version]);

  /** What was counted for another view or scene goes at once: it says nothing about this one. */
  function forget() {
    if (wanted === keyNow()) return;
    wanted = "";
    say(model.info ? "Counting." : "No scene is shown.");
  }

  /** Counts as soon as a picture has any pixel of its own: with few rays, then with more. */
  function ask() {
    const state = store.values, { image } = picture;
    forget();
    if (!model.info || !image?.fine || state.panel !== "ranking" || !state.camera || wanted) return;
    const key = wanted = keyNow();
    run(async (signal) => {
      for (const pixels of [FIRST_PIXELS, undefined]) {
        const found = await rankingOf(app, { level: Number(level.value), signal, pixels });
        if (key !== keyNow()) return;
        document = found;
        show(Boolean(pixels));
      }
    });
  }
  function levels() {
    const count = Number(model.info?.levels ?? 1);
    fillSelect(level, [["0", "innermost instance"], ...Array.from({ length: Math.max(count - 1, 0) }, (_, i) => [String(i + 1), `instance at level ${i + 1}`])], level.value || "0");
    if (level.selectedIndex < 0) level.value = "0";
    ask();
  }
  level.onchange = ask;
  kind.onchange = () => { wished = kind.value; show(); };
  selection.addEventListener("change", mark);
  model.addEventListener("change", levels);
  picture.addEventListener("image", ask);
  store.on(["panel", "camera", "scene", ...RAY_KEYS, "size"], ask);
  store.on(["kind"], () => show());
  say("Counting.");
  levels();
}

/** The kind and number of a finding's subject: ["object", 3]. */
const numberOf = (finding) => (finding.material === undefined ? ["object", finding.object] : ["material", finding.material]);
export const numberText = (finding) => {
  const [kind, index] = numberOf(finding);
  return typeof index === "number" ? ` (${kind} ${index})` : "";
};

const capital = (text) => text[0].toUpperCase() + text.slice(1);
