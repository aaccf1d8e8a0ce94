// One picture: the columns that have come, and the pixels made of them. `values` are what the palette
// colours (not a number: nothing there), `colours` are RGBA where the view gives colours itself, and
// `base` is the shaded surface behind.
import { ray } from "./camera.js";
import { compares } from "./requests.js";
import { viewOf } from "./views.js";

const SKY = [46, 46, 46];

export class Image {
  constructor(state, width, height) {
    Object.assign(this, { state, width, height, started: null, done: null, complete: false });
    this.view = viewOf(state.view);
    this.diverging = compares(state);
    const count = width * height;
    this.values = new Float32Array(count).fill(NaN);
    this.colours = new Uint8Array(4 * count);
    this.base = new Uint8Array(4 * count);
    this.columns = {};
    this.linear = null;  // for a lit picture: RGBA, premultiplied
    this.stops = 0;  // for a lit picture: exposure auto, as the daemon has measured it
    this.samples = 0;
    this.error = null;  // for a lit picture: {samples, noise}, its estimated relative error with so many samples
  }

  /** Begins with the pixels of a coarser picture, so that rows that have not come yet show something. */
  startFrom(other) {
    if (this.view.lit && other.linear) this.linear = new Float32Array(4 * this.width * this.height);
    const linear = other.linear && this.linear;
    this.stops = other.stops;
    for (let y = 0; y < this.height; ++y) {
      const row = Math.min(Math.floor((y * other.height) / this.height), other.height - 1) * other.width;
      for (let x = 0; x < this.width; ++x) {
        const from = row + Math.min(Math.floor((x * other.width) / this.width), other.width - 1);
        const to = y * this.width + x;
        this.values[to] = other.values[from];
        if (linear) for (let k = 0; k < 4; ++k) linear[4 * to + k] = other.linear[4 * from + k];
        for (let k = 0; k < 4; ++k) {
          this.colours[4 * to + k] = other.colours[4 * from + k];
          this.base[4 * to + k] = other.base[4 * from + k];
        }
      }
    }
  }

  /**
   * Makes the pixels [first, end) of the columns. `other` are those of a difference's second query,
   * which is subtracted: as in `raynest heatmap --diff`, red costs more than the other, blue less.
   */
  fill(columns, first, end, other = null) {
    const { view, state } = this;
    this.columns = columns;
    if (columns.ng) this.#shade(columns.ng, first, end);
    const field = view.fields(state)[0];
    for (let i = first; i < end; ++i) {
      if (view.value) {
        const value = view.value(columns, i, field);
        this.values[i] = other ? value - view.value(other, i, field) : value;
        continue;
      }
      const colour = columns.rgba ? columns.rgba.subarray(4 * i, 4 * i + 3) : view.colour(columns, i);
      if (!colour) this.colours.set(this.base.subarray(4 * i, 4 * i + 4), 4 * i);
      else this.colours.set([colour[0], colour[1], colour[2], 255], 4 * i);
    }
  }

  /** Shades like clay: the cosine between normal and ray. */
  #shade(ng, first, end) {
    const { width, height, state: { camera } } = this;
    const corner = ray(camera, 0.5, 0.5, width, height).direction;
    const across = ray(camera, 1.5, 0.5, width, height).direction.map((x, k) => x - corner[k]);
    const down = ray(camera, 0.5, 1.5, width, height).direction.map((x, k) => x - corner[k]);
    for (let i = first; i < end; ++i) {
      const x = i % width, y = Math.floor(i / width), at = 4 * i, n = 3 * i;
      this.base[at + 3] = 255;
      if (ng[n] === 0 && ng[n + 1] === 0 && ng[n + 2] === 0) {
        this.base.set(SKY, at);
        continue;
      }
      let cosine = 0, square = 0;
      for (let k = 0; k < 3; ++k) {
        const d = corner[k] + x * across[k] + y * down[k];
        cosine += d * ng[n + k];
        square += d * d;
      }
      this.base[at] = this.base[at + 1] = this.base[at + 2] = 40 + 200 * Math.abs(cosine) / Math.sqrt(square);
    }
  }
}
