// The legend: palette, range, scale and opacity, and the histogram of the picture above its colours.
// Dragging on the histogram sets the range; a double click brings the automatic range back.
import { element } from "./dom.js";
import { histogram, rangeOf, statistics, ticks } from "./histogram.js";
import { valueText } from "./numbers.js";
import { PALETTE_NAMES, paletteBytes, position, valueAt } from "./palette.js";
import { otherOf } from "./requests.js";

const BINS = 128;
const HEIGHT = 62, BAR = 12, TICKS = 16, EDGE = 4;

export class Legend {
  #store;
  #canvas = element("canvas", { height: HEIGHT, role: "img" });
  #title = element("span", { className: "title" });
  #key = element("span", { className: "key", id: "key" });
  #stats = element("span", { className: "stats", id: "statistics" });
  #low = element("input", { type: "number", step: "any", id: "range-low" });
  #high = element("input", { type: "number", step: "any", id: "range-high" });
  #values = new Float32Array(0);
  #statistics = statistics(this.#values);
  #palette;
  #log;
  #image = null;
  #drag = null;
  #drawn = 0;
  #timer = 0;

  constructor(store, place) {
    this.#store = store;
    const palette = this.#palette = element("select", { id: "palette" }, PALETTE_NAMES.map((name) => element("option", { value: name }, name)));
    palette.onchange = () => store.set({ palette: palette.value });
    const button = (id, text, title, click) => element("button", { type: "button", id, title, onclick: click }, text);
    const p99 = button("range-p99", "p99", "Range up to the 99th percentile; where many pixels have exactly that, up to the largest value", () => store.set({ range: "p99" }));
    const auto = button("range-auto", "max", "Range up to the largest value", () => store.set({ range: "auto" }));
    const log = this.#log = button("log", "log", "Logarithmic scale (L)", () => store.set({ log: !store.values.log }));
    const opacity = element("input", { type: "range", min: 0, max: 1, step: 0.05, id: "opacity" });
    opacity.oninput = () => store.set({ opacity: Number(opacity.value) });
    for (const input of [this.#low, this.#high]) input.onchange = () => this.#typed();
    const label = (text, control) => element("label", {}, text, control);
    this.controls = element("div", { className: "row" }, this.#title, label("Palette", palette), label("Range", this.#low),
      label("to", this.#high), p99, auto, log, label("Opacity", opacity), this.#key, this.#stats);
    place.append(this.controls, this.#canvas);
    store.on(["palette", "range", "log", "opacity"], (state) => {
      palette.value = state.palette;
      opacity.value = state.opacity;
      log.setAttribute("aria-pressed", state.log);
      p99.setAttribute("aria-pressed", state.range === "p99");
      auto.setAttribute("aria-pressed", state.range === "auto");
      this.draw();
    }, true);
    this.#canvas.onpointerdown = (event) => this.#begin(event);
    this.#canvas.onpointermove = (event) => this.#move(event);
    this.#canvas.onpointerup = () => { this.#drag = null; };
    this.#canvas.ondblclick = () => store.set({ range: "p99" });
    new ResizeObserver(() => this.draw()).observe(this.#canvas);
  }

  /** Takes a picture's values, and draws them at once or `ms` after the last drawing. */
  show(image, ms = 0) {
    this.#image = image;
    this.#values = image.view.value ? image.values : new Float32Array(0);
    this.#statistics = statistics(this.#values);
    const rest = this.#drawn + ms - performance.now();
    if (rest <= 0) this.draw();
    else this.#timer ||= setTimeout(() => this.draw(), rest);
  }

  get statistics() { return this.#statistics; }

  /** Returns what the shader needs: {low, high, log, palette}. */
  get scale() {
    const { range, log, palette } = this.#store.values;
    const diverging = Boolean(this.#image?.diverging);
    return { ...rangeOf(range, this.#statistics, diverging, this.#image?.view.fromLeast), log: log && !diverging,
             palette: diverging ? "diverging" : palette };
  }

  draw() {
    const image = this.#image;
    clearTimeout(this.#timer);
    this.#timer = 0;
    this.#drawn = performance.now();
    const byValue = Boolean(image?.view.value);
    const dpr = globalThis.devicePixelRatio || 1;
    const wide = this.#canvas.clientWidth;
    this.#canvas.width = Math.max(Math.round(wide * dpr), 1);
    this.#canvas.height = HEIGHT * dpr;
    this.#canvas.hidden = this.controls.hidden = !image || Boolean(image.view.lit);
    if (!image || image.view.lit) return;
    this.#title.textContent = image.diverging ? `${image.view.label} less that of ${otherOf(image.state)}: red is more, blue less` : image.view.label;
    for (const control of this.controls.children) {
      control.hidden = !byValue && control !== this.#title && !control.querySelector?.("#opacity");
    }
    this.#key.hidden = !image.view.key;
    this.#key.replaceChildren(...(image.view.key ?? []).map(([word, colour]) =>
      element("span", {}, element("i", { style: `background: rgb(${colour.join(" ")})` }), word.toLowerCase())));
    this.#canvas.hidden = !byValue;
    if (!byValue) return;
    const scale = this.scale, s = this.#statistics;
    // A difference has a palette of its own, and a scale on both sides of 0.
    this.#palette.value = scale.palette;
    this.#palette.disabled = this.#log.disabled = image.diverging;
    this.#palette.title = image.diverging ? "A difference is drawn with diverging" : "";
    if (document.activeElement !== this.#low) this.#low.value = Number(scale.low.toPrecision(5));
    if (document.activeElement !== this.#high) this.#high.value = Number(scale.high.toPrecision(5));
    this.#stats.textContent = ["min", "mean", "p50", "p99", "max"].map((name) => `${name} ${valueText(s[name], 4)}`).join(" · ");
    this.#canvas.setAttribute("aria-label", `Histogram of ${image.view.label}: ${this.#stats.textContent}. Set the range with the fields above.`);
    this.#paint(this.#canvas.getContext("2d"), dpr, wide, scale);
  }

  /** Returns the histogram and its colours as a canvas of `width` pixels, `dpr` for each of the text's; null where the picture has none. */
  painted(width, dpr) {
    if (!this.#image?.view.value) return null;
    const canvas = element("canvas", { width, height: Math.round(HEIGHT * dpr) });
    this.#paint(canvas.getContext("2d"), dpr, width / dpr, this.scale);
    return canvas;
  }

  #paint(context, dpr, wide, scale) {
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(name);
    context.setTransform(dpr, 0, 0, dpr, 0, 0);
    context.clearRect(0, 0, wide, HEIGHT);
    const axis = this.#axis();
    const bins = histogram(this.#values, axis, BINS);
    const most = Math.max(...bins, 1);
    const top = HEIGHT - BAR - TICKS;
    context.fillStyle = colour("--bar");
    // Square roots, so that few expensive pixels can be seen beside many cheap ones.
    bins.forEach((count, i) => {
      const high = count ? Math.max(Math.sqrt(count / most) * (top - 2), 1) : 0;
      context.fillRect((i * wide) / BINS, top - high, wide / BINS - 0.5, high);
    });
    const bytes = paletteBytes(scale.palette);
    for (let x = 0; x < wide; ++x) {
      const step = 4 * Math.round(255 * position(valueAt((x + 0.5) / wide, axis), scale));
      context.fillStyle = `rgb(${bytes[step]} ${bytes[step + 1]} ${bytes[step + 2]})`;
      context.fillRect(x, top, 1, BAR);
    }
    context.fillStyle = colour("--accent");
    for (const end of [scale.low, scale.high]) context.fillRect(Math.min(Math.max(position(end, axis) * wide - 1, 0), wide - 2), 0, 2, top + BAR);
    context.fillStyle = colour("--faint");
    context.font = "11px system-ui, sans-serif";
    let free = -Infinity;
    for (const value of ticks(axis, Math.max(wide / 90, 2))) {
      // A digit that touches the border of a PNG looks cut.
      const text = valueText(value), half = context.measureText(text).width / 2, aside = half + EDGE;
      const x = Math.min(Math.max(position(value, axis) * wide, aside), wide - aside);
      if (x - half < free) continue;
      context.fillText(text, x - half, HEIGHT - 3);
      free = x + half + 8;
    }
  }

  /** The histogram shows all values, at least the range. */
  #axis() {
    const s = this.#statistics, { low, high, log } = this.scale;
    return { low: Math.min(low, s.min), high: Math.max(high, s.max), log };
  }

  #typed() {
    const low = Number(this.#low.value), high = Number(this.#high.value);
    const good = this.#low.value !== "" && this.#high.value !== "" && low < high && Number.isFinite(low) && Number.isFinite(high);
    if (good) this.#store.set({ range: [low, high] });
    for (const input of [this.#low, this.#high]) input.setCustomValidity(good ? "" : "The range needs two numbers, the lower one first.");
    this.#high.reportValidity();
  }

  #valueAt(event) {
    const box = this.#canvas.getBoundingClientRect();
    return valueAt(Math.min(Math.max((event.clientX - box.left) / box.width, 0), 1), this.#drag?.axis ?? this.#axis());
  }

  #begin(event) {
    this.#canvas.setPointerCapture(event.pointerId);
    this.#drag = { axis: this.#axis(), from: 0 };
    this.#drag.from = this.#valueAt(event);
  }

  #move(event) {
    if (!this.#drag) return;
    const to = this.#valueAt(event);
    const [low, high] = [Math.min(this.#drag.from, to), Math.max(this.#drag.from, to)];
    if (high > low) this.#store.set({ range: [low, high].map((x) => Number(x.toPrecision(5))) });
  }
}
