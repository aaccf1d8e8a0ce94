// The selection, in tables and picture alike: placements by their paths, an object, or a material. The
// pixels that show it have an outline.
import { cameraTable, generator } from "../camera.js";
import { askDocument, latest } from "../documents.js";
import { jobOf, momentOf } from "../requests.js";
import { traceQuery } from "../tracer.js";
import { RAY_KEYS } from "../store.js";

/** `chosen` is {kind: "placements", first, count} with BigInts, {kind: "object", object} or {kind: "material", material}; and a name. */
export class Selection extends EventTarget {
  #app;
  #columns = null;
  #key = "";
  #run;
  chosen = null;
  record = null;  // the hit record that it was chosen by

  constructor(app) {
    super();
    this.#app = app;
    this.#run = latest((error) => app.failed(error));
    app.picture.addEventListener("image", () => { if (app.picture.image.complete) this.#mark(); });
    app.store.on(["camera", "scene", ...RAY_KEYS, "size"], () => app.overlay?.mask(null));
    app.store.on(["scene"], () => this.choose(null));
  }

  choose(chosen) {
    this.chosen = chosen;
    this.dispatchEvent(new Event("change"));
    this.#mark();
  }

  /** Numbers mean others in new content: what a kept ray hits is chosen again, and anything else let go. */
  follow() {
    const had = Boolean(this.chosen);
    this.choose(null);
    this.#app.hover.again(had);
  }

  /** Chooses the placement of a hit record; a miss chooses nothing. */
  chooseHit({ hit, columns, path }) {
    this.choose(hit ? { kind: "placements", first: columns.path[0], count: 1n, object: columns.object[0],
                        material: columns.material[0], instance: columns.inst[0], name: path.name || "(the root)" } : null);
  }

  /** True if a placement, an object or a material is, or holds, what is chosen. */
  hasPath(first, count = 1n) {
    return this.chosen?.kind === "placements" && first < this.chosen.first + this.chosen.count && this.chosen.first < first + count;
  }
  hasObject(object) { return this.chosen?.object === object; }
  hasMaterial(material) { return this.chosen?.material === material; }

  /** Describes up to 256 of the chosen placements, or one of a chosen object's: rows of the document `placements`. */
  async placements() {
    const { store, daemon } = this.#app, { chosen } = this;
    if (!chosen) return [];
    const range = chosen.kind === "placements" ? chosen : await this.#shown();
    if (!range) return [];
    const document = await askDocument(daemon, "Structure", { scene: store.values.scene, ...momentOf(store.values), kind: "placements",
      first: String(range.first), count: Number(range.count > 256n ? 256n : range.count) });
    return document.rows;
  }

  /** The first placement in the picture that shows the chosen object or material. */
  async #shown() {
    const columns = await this.#ids();
    const at = columns.path.findIndex((_, i) => this.#matches(columns, i));
    return at < 0 ? null : { first: columns.path[at], count: 1n };
  }

  #matches(columns, i) {
    const { chosen } = this;
    if (chosen.kind === "placements") return columns.path[i] >= chosen.first && columns.path[i] - chosen.first < chosen.count;
    return chosen.kind === "object" ? columns.object[i] === chosen.object : columns.material[i] === chosen.material;
  }

  /** Which placement, object and material each pixel shows; asked for once for each picture. */
  async #ids(signal) {
    const { store, daemon, model, picture } = this.#app, { width, height } = picture.image;
    const job = jobOf(store.values), rays = generator(store.values.camera, width, height);
    const key = JSON.stringify([job, rays, model.version]);
    if (key !== this.#key) {
      const { columns } = await traceQuery(daemon, { job, fields: ["path", "object", "material"], generator: rays }, width * height, { signal });
      [this.#columns, this.#key] = [columns, key];
    }
    return this.#columns;
  }

  #mark() {
    const { overlay, picture, store } = this.#app;
    // Isolated placements stand alone.
    if (!this.chosen || !picture.image?.complete || store.values.isolated.length) return overlay?.mask(null);
    return this.#run(async (signal) => {
      const { width, height } = picture.image;
      const columns = await this.#ids(signal);
      if (!this.chosen || columns.path.length !== width * height) return;
      const inside = new Uint8Array(width * height);
      for (let i = 0; i < inside.length; ++i) inside[i] = this.#matches(columns, i) ? 1 : 0;
      overlay.mask({ width, height, inside });
    });
  }
}

const RANKED_PIXELS_MAX = 480 * 270;

/** Asks for the ranking of what the page shows, with at most `pixels` rays. Throws where the camera has none. */
export async function rankingOf({ daemon, store, canvas }, { level = 0, signal, pixels = RANKED_PIXELS_MAX, top = 100 } = {}) {
  const { camera } = store.values;
  if (camera.projection === "orthographic") throw new Error("The ranking needs a perspective camera: press P.");
  const { width, height } = canvas;
  const shrink = Math.min(1, Math.sqrt(pixels / (width * height)));
  const side = (length) => Math.max(Math.round(length * shrink), 1);
  return askDocument(daemon, "Blame", { job: jobOf(store.values), camera: cameraTable(camera), width: side(width), height: side(height), level, top }, { signal });
}
