// Follows the pointer: one request at a time, for the latest pixel.
import { askPixel } from "./ray.js";

export class Hover extends EventTarget {
  #app;
  #wanted = null;
  #busy = false;
  found = null;
  pinned = null;

  constructor(app) {
    super();
    this.#app = app;
    app.store.on(["scene", "camera", "intersector", "settings", "mask", "hidden", "isolated"], () => this.unpin());
  }

  at(x, y) {
    this.#wanted = [x, y];
    this.#next();
  }

  leave() { this.#wanted = null; }

  async pin(x, y) {
    try {
      this.pinned = await askPixel(this.#app, x, y);
      this.dispatchEvent(new Event("found"));
    } catch (error) {
      this.#app.failed(error);
    }
  }

  unpin() {
    if (!this.pinned) return;
    this.pinned = null;
    this.dispatchEvent(new Event("found"));
  }

  async #next() {
    if (this.#busy || !this.#wanted || !this.#app.picture.image) return;
    const [x, y] = this.#wanted;
    this.#wanted = null;
    this.#busy = true;
    try {
      this.found = await askPixel(this.#app, x, y);
      this.dispatchEvent(new Event("found"));
    } catch (error) {
      if (error.name !== "CONNECTION_LOST") this.#app.failed(error);
    } finally {
      this.#busy = false;
    }
    this.#next();
  }
}
