// The panel "Objects": meshes and materials of the scene.
import { element } from "./dom.js";
import { shortNumber } from "./histogram.js";
import { sortableTable } from "./tables.js";

export const objectsPanel = { id: "objects", title: "Objects", build };

const LISTS = { meshes: ["names", "triangles", "placements", "records"], materials: ["names", "triangles", "placements", "alpha_modes"] };

function build({ daemon, store, model, failed }, place) {
  const number = (title, key) => ({ title, number: true, value: (row) => Number(row[key]), text: (row) => shortNumber(Number(row[key])) });
  const name = { title: "Name", value: (row) => row.names || `(${row.index})` };
  const meshes = sortableTable("Meshes", [name, number("Triangles", "triangles"), number("Instances", "placements")], { choose() {} });
  const materials = sortableTable("Materials", [name, { title: "Alpha", value: (row) => row.alpha_modes }, number("Triangles", "triangles")], {
    choose: () => store.set({ view: "material" }) });
  place.append(element("h2", {}, "Meshes"), meshes.node, element("h2", {}, "Materials"), materials.node);
  const load = async () => {
    if (!model.info) return;
    try {
      for (const [kind, table] of [["meshes", meshes], ["materials", materials]]) {
        const lists = await daemon.askPages("Parts", { scene: model.info.name, kind }, LISTS[kind]);
        table.show(lists.names.map((_, index) => ({ index, ...Object.fromEntries(LISTS[kind].map((key) => [key, lists[key][index]])) })));
      }
    } catch (error) {
      failed(error);
    }
  };
  let shown = "";
  const change = () => {
    if (!model.info || `${model.info.name} ${model.info.epoch}` === shown) return;
    shown = `${model.info.name} ${model.info.epoch}`;
    load();
  };
  model.addEventListener("change", change);
  change();
}
