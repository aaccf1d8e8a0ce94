// The tree of one ray's traversal, below its hit record: each step is a row, and the boxes that were
// entered are drawn over the picture. The document is described in client/EXPLAIN.md.
import { cameraTable } from "../camera.js";
import { askDocument, latest } from "../documents.js";
import { element } from "../dom.js";
import { jobOf } from "../requests.js";
import { viewOf } from "../views.js";

const STEPS = 400;
const COLOURS = ["#ffd166", "#06d6a0", "#4cc9f0", "#f72585", "#b5e48c", "#ff9f1c"];
export const levelColour = (level) => COLOURS[level % COLOURS.length];

/** Asks for the traversal of the ray of a hit record. */
export function askExplanation({ daemon, store, canvas }, { x, y, columns }, signal) {
  const state = store.values, { width, height } = canvas;
  const vec = ([a, b, c]) => ({ x: a, y: b, z: c });
  const ray = state.camera.projection === "orthographic"
    ? { origin: vec(columns.origin), direction: vec(columns.direction) }
    : { camera: cameraTable(state.camera), width, height, pixel_x: x, pixel_y: y };
  return askDocument(daemon, "Explain", { job: jobOf(state), steps: STEPS, ...ray }, { signal });
}

const plural = (count, one, many = `${one}s`) => `${count} ${count === 1 ? one : many}`;

/** Says a step in words, as `raynest explain` does. */
export function stepText(step) {
  if (step.kind === "instance") {
    const where = step.outcome === "accepted" ? `, entered at t ${Number(step.near).toPrecision(4)}` : `: ${step.why}`;
    return `Instance ${step.name || "(unnamed)"} of mesh ${step.mesh || "(unnamed)"}, level ${step.level}${where}`;
  }
  if (step.kind === "node") {
    return `Node ${step.node}: ${step.entered} of ${plural(step.boxes, "box", "boxes")} entered${step.behind ? `, ${step.behind} of them behind the hit` : ""}`;
  }
  if (step.kind === "leaf") return `Leaf ${step.leaf}: ${plural(step.prims, "primitive")} tested, ${step.hits} hit${step.refused ? `, ${step.refused} refused` : ""}`;
  const what = `${step.type === "triangle" ? `Triangle ${step.prim} of geometry ${step.geom}` : `Primitive ${step.prim} (${step.type})`}${step.material === null ? "" : `, material ${step.material}`}, t ${Number(step.t).toPrecision(5)}`;
  return step.outcome === "accepted" ? what : `${what}: ${step.why}`;
}

/**
 * Returns {box, colour, width, alpha} of the steps that entered a box. Those on the way to the hit stand out;
 * the others are faint, the more of them the fainter, so that hundreds do not hide the picture.
 */
export function boxesOf({ hit, steps }) {
  const way = new Set();
  for (let at = hit?.step ?? null; at !== null; at = steps[at].parent) way.add(at);
  const entered = steps.map((step, i) => ({ step, i })).filter(({ step: { box, kind, outcome } }) => box && (kind !== "instance" || outcome === "accepted"));
  const faint = Math.min(0.5, 12 / Math.max(entered.length - way.size, 1));
  return entered.sort((a, b) => way.has(a.i) - way.has(b.i)).map(({ step, i }) => ({ box: step.box,
    colour: levelColour(step.kind === "instance" ? step.level - 1 : step.level),
    ...(way.has(i) ? { width: 1.6, alpha: 1 } : { width: 0.8, alpha: Math.max(faint, 0.12) }) }));
}

export function explanation(app, place) {
  const { hover, overlay, model, store } = app;
  const summary = element("p", { className: "hint", id: "explain-summary" });
  const tree = element("ol", { className: "tree", id: "explain-tree", ariaLabel: "Steps of the traversal" });
  const section = element("section", { hidden: true, ariaLabel: "Traversal" }, element("h2", {}, "Traversal"), summary, tree);
  place.append(section);
  const run = latest((error) => app.failed(error));
  const local = (box) => {
    const origin = model.origin, corner = (p) => p.map((x, i) => x - origin[i]);
    return { low: corner(box[0]), high: corner(box[1]) };
  };

  function show(document) {
    const { totals, steps } = document;
    summary.textContent = `${totals.total} = ${plural(totals.boxes, "box", "boxes")} of ${plural(totals.nodes, "node")} + ` +
      `${plural(totals.prims, "primitive")} of ${plural(totals.leaves, "leaf", "leaves")}; ` +
      `${plural(totals.instances, "instance")} entered, ${plural(totals.rejects, "candidate")} refused.` +
      (document.left_out ? ` Left out: ${plural(document.left_out, "step")}.` : "");
    const depth = [];
    tree.replaceChildren(...steps.map((step, i) => {
      depth.push(step.parent === null ? 0 : depth[step.parent] + 1);
      const isHit = document.hit?.step === i;
      const row = element("button", { type: "button", className: `step ${step.outcome && step.outcome !== "accepted" ? "refused" : ""}${isHit ? " hit" : ""}` },
        `${stepText(step)}${isHit ? ": the hit" : ""}`);
      row.style.paddingLeft = `${4 + 10 * Math.min(depth[i], 12)}px`;
      const mark = () => overlay.boxes("step", step.box ? [{ ...local(step.box), colour: "#ffffff", width: 2.5 }] : []);
      row.onfocus = row.onmouseenter = mark;
      row.onblur = row.onmouseleave = () => overlay.boxes("step", []);
      row.onkeydown = (event) => {
        const to = { ArrowDown: row.parentElement.nextElementSibling, ArrowUp: row.parentElement.previousElementSibling }[event.key];
        if (!to) return;
        event.preventDefault();
        to.firstChild.focus();
      };
      return element("li", {}, row);
    }));
    overlay.boxes("explain", boxesOf(document).map((box) => ({ ...box, ...local(box.box) })));
  }
  function clear() {
    section.hidden = true;
    app.explained = null;
    overlay.boxes("explain", []);
    overlay.boxes("step", []);
  }
  hover.addEventListener("found", () => {
    // In the lit view a click shows the path of light in place of a traversal.
    if (!hover.pinned || viewOf(store.values.view).lit) return clear();
    const { pinned } = hover;
    if (app.explained?.of === pinned) return undefined;
    return run(async (signal) => {
      const document = await askExplanation(app, pinned, signal);
      if (hover.pinned !== pinned) return;
      section.hidden = false;
      app.explained = { of: pinned, document };
      show(document);
    });
  });
  store.on(["scene"], clear);
}
