// Settings that are kept between visits. Where the browser keeps nothing, they last as long as the page.
const KEY = "raynest";
const KEPT = ["palette", "log", "size", "control", "upAxis", "panel"];

export function kept() {
  try {
    const found = JSON.parse(localStorage.getItem(KEY) ?? "{}");
    return found && typeof found === "object" ? found : {};
  } catch {
    return {};
  }
}

export function keep(patch) {
  try {
    localStorage.setItem(KEY, JSON.stringify({ ...kept(), ...patch }));
  } catch {
    // A private window may refuse.
  }
}

/** Returns those of the kept values that are part of the view. */
export function keptView() {
  const found = kept();
  return Object.fromEntries(KEPT.filter((key) => typeof found[key] === "string" || typeof found[key] === "boolean")
    .map((key) => [key, found[key]]));
}

export const keepView = (store) =>
  store.on(KEPT, (state) => keep(Object.fromEntries(KEPT.map((key) => [key, state[key]]))));
