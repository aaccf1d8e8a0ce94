// The daemon's scenes and intersectors, as it describes them.
import { askDocument } from "./documents.js";
import { versionOf } from "./follow.js";
import { facts } from "./views.js";

const OBJECTS_MAX = 4096;

export class Model extends EventTarget {
  scenes = [];
  variants = [];
  info = null;
  objects = [];    // rows of Structure's document `objects`; at most OBJECTS_MAX
  materials = [];  // {index, name, alpha, triangles}

  constructor(daemon) {
    super();
    this.daemon = daemon;
  }

  /** Asks for the names of scenes, which come and go. */
  async refreshScenes(options = {}) {
    const { names } = await this.daemon.askPages("Scenes", {}, ["names"], options);
    const differ = names.join("\n") !== this.scenes.join("\n");
    this.scenes = names;
    // What panels show of the scene stays as it is.
    if (differ) this.dispatchEvent(new Event("scenes"));
  }

  /** Asks for scenes and intersectors. */
  async refresh() {
    const [variants] = await Promise.all([this.daemon.askPages("Variants", {}, ["variants"]), this.refreshScenes()]);
    this.variants = variants.variants.filter(({ queries = [] }) => queries.includes("closest") || queries.length === 0);
    this.#changed();
  }

  /** Names the content that is shown: what was asked of another one is out of date. */
  get version() { return versionOf(this.info); }

  /** The scene is not loaded any more. */
  forget() {
    this.info = null;
    facts.objects = this.objects = [];
    facts.materials = this.materials = [];
    this.#changed();
  }

  /**
   * Asks about a scene. It is not held: a connection that holds one keeps its name for itself, and would not see
   * another content that is loaded under that name after an unload. Tables of other content go at once.
   */
  async choose(scene) {
    const info = await this.daemon.ask("Info", { scene });
    if (versionOf(info) !== this.version) this.objects = this.materials = [];
    this.info = info;
    this.#changed();
    const [objects, parts] = await Promise.all([
      askDocument(this.daemon, "Structure", { scene, kind: "objects", count: OBJECTS_MAX }),
      this.daemon.askPages("Parts", { scene, kind: "materials" }, ["names", "triangles", "alpha_modes"])]);
    if (this.version !== versionOf(info)) return info;  // another one was chosen meanwhile
    facts.objects = this.objects = objects.rows;
    facts.materials = this.materials = parts.names.map((name, index) =>
      ({ index, name, alpha: parts.alpha_modes[index], triangles: Number(parts.triangles[index]) }));
    this.#changed();
    return info;
  }

  /** Returns the intersector that `auto` stands for, `lit` in a picture that follows light. */
  resolve(intersector, lit = false) {
    if (intersector !== "auto") return intersector;
    if (lit && Number(this.info?.blend_materials) > 0 && this.variants.some(({ name }) => name === "alpha_blend")) return "alpha_blend";
    return this.info?.intersector ?? "opaque";
  }

  /** The world's point that places of the page are relative to. */
  get origin() {
    const { origin_x = 0, origin_y = 0, origin_z = 0 } = this.info ?? {};
    return [origin_x, origin_y, origin_z].map(Number);
  }

  get box() { return boxOf(this.info); }

  /** True for a scene without anything that a ray can hit. */
  get isEmpty() { return Boolean(this.info) && !hasBox(this.info); }

  #changed() { this.dispatchEvent(new Event("change")); }
}

const ends = ({ box_min: a, box_max: b }) => ({ low: [a.x, a.y, a.z].map(Number), high: [b.x, b.y, b.z].map(Number) });

function hasBox(info) {
  const { low, high } = ends(info);
  return low.every((x, i) => Number.isFinite(x) && Number.isFinite(high[i]) && x <= high[i]);
}

/** The box that an Info tells; one about zero for an empty scene. */
export const boxOf = (info) => (hasBox(info) ? ends(info) : { low: [-1, -1, -1], high: [1, 1, 1] });
