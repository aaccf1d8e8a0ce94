// Focus, hide, isolate and show all: what is selected, and which instances rays enter. Hidden instances are
// hidden in the daemon, so that every count is that of the scene without them.
import { frame } from "../camera.js";
import { element, field } from "../dom.js";

const HIDDEN_MAX = 256;

export function visibility(app) {
  const { store, selection, model, showCamera, inform, failed } = app;

  /** The names that a job has for what is selected: "i12" is an outermost instance, "o3" an object. */
  async function ids() {
    const { chosen } = selection;
    if (!chosen) {
      inform("Nothing is selected: click in the picture or a table");
      return [];
    }
    if (chosen.kind === "material") {
      inform("A material cannot be hidden: choose an object or an instance");
      return [];
    }
    if (chosen.kind === "object") {
      if (model.objects.find(({ object }) => object === chosen.object)?.triangles !== 0) return [`o${chosen.object}`];
      inform("It has no triangles of its own: choose one of its instances, or an object in it");
      return [];
    }
    const rows = await selection.placements();
    const found = [...new Set(rows.map(({ instance }) => instance).filter((instance) => instance !== null))].map((instance) => `i${instance}`);
    if (found.length === 0) inform("It lies in no instance, so it cannot be hidden");
    return found;
  }
  const guarded = (run) => async () => {
    try { await run(); } catch (error) { failed(error); }
  };
  return {
    focus: guarded(async () => {
      const boxes = (await selection.placements()).map(({ box }) => box).filter(Boolean);
      if (boxes.length === 0) return inform(selection.chosen ? "No pixel shows it: choose one of its instances" : "Nothing is selected: click in the picture or a table");
      const bound = (end, pick) => [0, 1, 2].map((axis) => pick(...boxes.map((box) => box[end][axis])) - model.origin[axis]);
      return showCamera(frame(store.values.camera, bound(0, Math.min), bound(1, Math.max)));
    }),
    hide: guarded(async () => {
      const found = await ids();
      if (found.length === 0) return;
      store.set({ hidden: [...new Set([...store.values.hidden, ...found])].slice(0, HIDDEN_MAX), isolated: store.values.isolated.filter((id) => !found.includes(id)) });
      selection.choose(null);
    }),
    isolate: guarded(async () => {
      const found = await ids();
      if (found.length) store.set({ isolated: found.slice(0, HIDDEN_MAX), hidden: [] });
    }),
    showAll: () => store.set({ hidden: [], isolated: [] }),
  };
}

/** Buttons for these four, and what is selected and hidden now. */
export function visibilityBar(app) {
  const { store, selection, actions } = app;
  const name = element("p", { className: "selected", id: "selected" });
  const state = element("p", { className: "hint", id: "hidden-count" });
  const buttons = [["Focus", "F", actions.focus], ["Hide", "H", actions.hide], ["Isolate", "I", actions.isolate], ["Show all", "J", actions.showAll]]
    .map(([text, key, onclick]) => element("button", { type: "button", title: `${text} (${key})`, onclick }, text));
  const skip = element("input", { type: "checkbox", id: "skip-hidden-boxes", onchange: () => store.set({ skipHiddenBoxes: skip.checked }) });
  const boxes = field("Leave out their boxes", skip, "Boxes that lead to hidden instances alone are tested and counted unless they are left out");
  const show = () => {
    name.textContent = selection.chosen ? selection.chosen.name || "(unnamed)" : "Nothing is selected.";
    const { hidden, isolated, skipHiddenBoxes } = store.values;
    state.textContent = [hidden.length ? `${hidden.length} hidden.` : "", isolated.length ? `${isolated.length} isolated.` : "",
      !hidden.length && !isolated.length ? "" : skipHiddenBoxes ? "Boxes of what is hidden are not counted." : "Boxes of what is hidden are still counted."].filter(Boolean).join(" ");
    skip.checked = skipHiddenBoxes;
    boxes.hidden = !hidden.length && !isolated.length;
  };
  selection.addEventListener("change", show);
  store.on(["hidden", "isolated", "skipHiddenBoxes"], show);
  show();
  return element("div", {}, name, element("div", { className: "buttons" }, buttons), state, boxes);
}
