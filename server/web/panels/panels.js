// The panels beside the picture, as tabs. To add one, import it and add it to PANELS; a panel is
// {id, title, eager, build(app, place)}, and is built when it is first shown, or at once where it is eager.
import { element } from "../dom.js";
import { setupPanel } from "./setup.js";
import { rayPanel } from "./ray.js";
import { areaPanel } from "./area.js";
import { objectsPanel } from "./objects.js";
import { rankingPanel } from "./ranking.js";

const PANELS = [setupPanel, rayPanel, rankingPanel, objectsPanel, areaPanel];

export function buildPanels(app, tabs, place) {
  const made = PANELS.map((panel) => {
    const tab = element("button", { type: "button", role: "tab", id: `tab-${panel.id}`, "aria-controls": `panel-${panel.id}`,
      onclick: () => app.store.set({ panel: panel.id }) }, panel.title);
    const body = element("div", { role: "tabpanel", id: `panel-${panel.id}`, "aria-labelledby": tab.id, tabIndex: 0 });
    if (panel.eager) panel.build(app, body);
    return { panel, tab, body, built: Boolean(panel.eager) };
  });
  tabs.append(...made.map(({ tab }) => tab));
  place.append(...made.map(({ body }) => body));
  tabs.addEventListener("keydown", (event) => {
    const by = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!by) return;
    const at = made.findIndex(({ tab }) => tab === document.activeElement);
    const next = made[(at + by + made.length) % made.length];
    app.store.set({ panel: next.panel.id });
    next.tab.focus();
  });
  app.store.on(["panel"], ({ panel }) => {
    const shown = made.find((entry) => entry.panel.id === panel) ?? made[0];
    for (const entry of made) {
      const selected = entry === shown;
      entry.tab.setAttribute("aria-selected", selected);
      entry.tab.tabIndex = selected ? 0 : -1;
      entry.body.hidden = !selected;
    }
    if (!shown.built) shown.panel.build(app, shown.body);
    shown.built = true;
  }, true);
}
