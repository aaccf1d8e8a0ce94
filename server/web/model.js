// The daemon's scenes and intersectors, as it describes them.
import { askDocument } from "./documents.js";
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

  /** Asks for scenes and intersectors. */
  async refresh() {
    const [scenes, variants] = await Promise.all([this.daemon.askPages("Scenes", {}, ["names"]),
                                                  this.daemon.askPages("Variants", {}, ["variants"])]);
    this.scenes = scenes.names;
    this.variants = variants.variants.filter(({ queries = [] }) => queries.includes("closest") || queries.length === 0);
    this.#changed();
  }

  /** Asks about a scene and holds it, so that it stays while it is watched. */
  async choose(scene) {
    this.info = await this.daemon.ask("Info", { scene, hold: true });
    this.#changed();
    const [objects, parts] = await Promise.all([
      askDocument(this.daemon, "Structure", { scene, kind: "objects", count: OBJECTS_MAX }),
      this.daemon.askPages("Parts", { scene, kind: "materials" }, ["names", "triangles", "alpha_modes"])]);
    if (this.info.name !== objects.scene) return this.info;
    facts.objects = this.objects = objects.rows;
    facts.materials = this.materials = parts.names.map((name, index) =>
      ({ index, name, alpha: parts.alpha_modes[index], triangles: Number(parts.triangles[index]) }));
    this.#changed();
    return this.info;
  }

  /** Returns the intersector that `auto` stands for, by the rule of PROTOCOL.md. */
  resolve(intersector) {
    if (intersector !== "auto") return intersector;
    return (this.info?.mask_materials ?? 0) + (this.info?.blend_materials ?? 0) > 0 ? "alpha_mask" : "opaque";
  }

  /** The world's point that places of the page are relative to. */
  get origin() {
    const { origin_x = 0, origin_y = 0, origin_z = 0 } = this.info ?? {};
    return [origin_x, origin_y, origin_z].map(Number);
  }

  get box() {
    const { box_min: a, box_max: b } = this.info;
    const low = [a.x, a.y, a.z].map(Number), high = [b.x, b.y, b.z].map(Number);
    return low.every((x, i) => Number.isFinite(x) && Number.isFinite(high[i]) && x <= high[i])
      ? { low, high } : { low: [-1, -1, -1], high: [1, 1, 1] };
  }

  #changed() { this.dispatchEvent(new Event("change")); }
}
