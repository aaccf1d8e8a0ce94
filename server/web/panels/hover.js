// The hit record: that of the pixel under the pointer, or of one that was clicked. It is always one of the picture that
// is shown: a record of another camera, scene or setting is dropped, and a kept ray asked for again where its pixel still
// shows the same place.
import { askPixel } from "./ray.js";
import { jobOf } from "../requests.js";
import { RAY_KEYS } from "../store.js";

export class Hover extends EventTarget {
  #app;
  #wanted = null;
  #busy = false;
  found = null;
  pinned = null;
  moved = false;  // true if a kept ray was let go because the camera moved

  constructor(app) {
    super();
    this.#app = app;
    app.store.on(["scene", "camera", "size"], () => this.#drop(Boolean(this.pinned)));
    app.store.on(RAY_KEYS, () => this.again());
  }

  at(x, y) {
    this.#wanted = [x, y];
    this.#next();
  }

  leave() { this.#wanted = null; }

  /** The picture has another size. */
  resized() { this.#drop(Boolean(this.pinned)); }

  /** Keeps the ray of a pixel, and chooses what it hits. */
  pin(x, y, chooses = true) {
    return this.#ask(x, y, (record) => {
      this.pinned = record;
      this.#tell({ chooses });
    });
  }

  unpin() {
    if (this.pinned) this.#drop(false);
  }

  /** Asks for the kept ray again, because what it meets may have changed; without one the record goes. */
  again(chooses = false) {
    const { pinned } = this;
    this.#drop(false);
    if (pinned) this.pin(pinned.x, pinned.y, chooses);
  }

  #drop(moved) {
    if (!this.pinned && !this.found) return;
    this.pinned = this.found = null;
    this.moved = moved;
    this.#tell({});
  }

  #tell({ chooses = false }) {
    this.dispatchEvent(Object.assign(new Event("found"), { chooses }));
  }

  /** What a record is of: its answer is dropped where this has changed meanwhile. */
  #subject() {
    const { store, model, canvas } = this.#app;
    return JSON.stringify([jobOf(store.values), store.values.camera, canvas.width, canvas.height, model.version]);
  }

  async #ask(x, y, done) {
    const subject = this.#subject();
    try {
      const record = await askPixel(this.#app, x, y);
      if (subject !== this.#subject()) return;
      this.moved = false;
      done(record);
    } catch (error) {
      if (error.name !== "CONNECTION_LOST" && subject === this.#subject()) this.#app.failed(error);
    }
  }

  async #next() {
    if (this.#busy || !this.#wanted || !this.#app.picture.image) return;
    const [x, y] = this.#wanted;
    this.#wanted = null;
    this.#busy = true;
    await this.#ask(x, y, (record) => {
      this.found = record;
      this.#tell({});
    });
    this.#busy = false;
    this.#next();
  }
}
