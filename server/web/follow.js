// Follows the scene that is shown: it is replaced, unloaded and loaded again while the page is open, and daemons
// are restarted. The daemon is asked twice a second while the page can be seen.

const LOOK_MS = 500;
const LOOKS_PER_LIST = 4;  // the list of scenes is asked for once in so many looks

/**
 * Calls `on.changed(info)` when the scene has other content or another epoch than `model.info`, `on.gone()` when it
 * is no longer loaded, and `on.loaded()` where nothing is shown and scenes may have come.
 */
export class Follower {
  #app;
  #on;
  #busy = false;
  #looks = 0;

  constructor(app, on) {
    this.#app = app;
    this.#on = on;
    setInterval(() => { if (!document.hidden) this.look(); }, LOOK_MS);
    document.addEventListener("visibilitychange", () => { if (!document.hidden) this.look(); });
  }

  /** Asks once; again only when the answer is there and has been dealt with. */
  async look() {
    const { daemon, model, store } = this.#app;
    if (this.#busy || daemon.state !== "open") return;
    this.#busy = true;
    const { scene } = store.values, shown = model.version;
    try {
      if (!scene) {
        await this.#on.loaded();
        return;
      }
      if (this.#looks++ % LOOKS_PER_LIST === 0) await model.refreshScenes({ background: true });
      const info = await daemon.ask("Info", { scene }, { background: true });
      // Another scene may have been chosen meanwhile.
      if (store.values.scene === scene && model.version === shown && versionOf(info) !== shown) await this.#on.changed(info);
    } catch (error) {
      if (error.name === "SCENE_UNKNOWN" && store.values.scene === scene && model.info) this.#on.gone(scene);
    } finally {
      this.#busy = false;
    }
  }
}

/** What tells one content of a name from another; "" for none. */
export const versionOf = (info) => (info ? `${info.name} ${info.epoch} ${info.hash}` : "");

/** True if the last change of the scene was an edit: a load begins without any. */
export const wasEdited = (info) => Number(info.refits ?? 0) + Number(info.rebuilds ?? 0) > 0;

const count = (value) => Number(value ?? 0).toLocaleString("en");

/** Says what the edits between two looks changed: of several the last. "" where that is not known. */
function editText(before, after) {
  if (!wasEdited(after) || !after.last_edit) return "";
  const edits = Number(after.epoch ?? 0) - Number(before.epoch ?? 0);
  return edits > 1 ? `${count(edits)} edits, the last one ${after.last_edit}` : after.last_edit;
}

/** Says in one sentence how a scene differs from what it was. */
export function changesText(before, after) {
  const edited = editText(before, after), differ = edited ? [edited] : [];
  differ.push(...[["triangles", "instanced_triangles"], ["instances", "instances"], ["levels", "levels"], ["materials", "materials"]]
    .filter(([, key]) => Number(before[key] ?? 0) !== Number(after[key] ?? 0)).map(([name, key]) => `${name} ${count(before[key])} → ${count(after[key])}`));
  for (const key of ["cameras", "animations"]) {
    const [old, now] = [before[key] ?? [], after[key] ?? []];
    const [gone, come] = [old.filter((name) => !now.includes(name)), now.filter((name) => !old.includes(name))];
    if (gone.length) differ.push(`${key} gone: ${gone.join(", ")}`);
    if (come.length) differ.push(`new ${key}: ${come.join(", ")}`);
  }
  if (before.hash === after.hash) return "the same content";
  if (differ.length) return differ.join("; ");
  return wasEdited(after) ? "parts of it stand elsewhere, or have other shapes or masks" : "other content with the same counts";
}

/** Returns the number that one of `before` has in `after`: that of its name, else its own; -1 where it is gone. */
function sameNumber(number, before = [], after = []) {
  if (before[number] && after[number] !== before[number]) return after.indexOf(before[number]);
  return number < after.length ? number : -1;
}

/** Returns the number of the animation that the new content has for the old one, null where it is gone. */
export function sameAnimation(number, before, after) {
  const at = sameNumber(number, before.animations, after.animations);
  return at < 0 ? null : at;
}

/** Returns the choice in the list of cameras that the new content has for the old one; "" where it is gone. */
export function sameCamera(chosen, before, after) {
  const names = after.cameras ?? [];
  if (!/^\d+$/.test(chosen)) return chosen === "automatic" && names.length ? "" : chosen;
  const at = sameNumber(Number(chosen), before.cameras, names);
  return at < 0 ? "" : String(at);
}
