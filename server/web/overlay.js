// Lines over the picture: the chosen rectangle, boxes of the scene as wireframes, and rays.
import { add, basis, dot, projector, scale, sub } from "./camera.js";

const HALO = "rgb(0 0 0 / .55)";
const RINGS = [[255, 255, 255, 255], [0, 0, 0, 200]];  // around what is marked, from the inside outwards
const EDGES = [[0, 1], [2, 3], [4, 5], [6, 7], [0, 2], [1, 3], [4, 6], [5, 7], [0, 4], [1, 5], [2, 6], [3, 7]];

/** The corners of a box, moved to the world by a 3x4 matrix (row by row) where one is given. */
export function corners({ low, high, matrix }) {
  return Array.from({ length: 8 }, (_, i) => {
    const p = [i & 1 ? high[0] : low[0], i & 2 ? high[1] : low[1], i & 4 ? high[2] : low[2]];
    return matrix ? [0, 4, 8].map((row) => matrix[row] * p[0] + matrix[row + 1] * p[1] + matrix[row + 2] * p[2] + matrix[row + 3]) : p;
  });
}

export class Overlay {
  #app;
  #canvas;
  #layers = new Map();
  #lines = new Map();
  #mask = null;
  #asked = false;
  #empty = true;

  constructor(app, canvas) {
    this.#app = app;
    this.#canvas = canvas;
    app.store.on(["camera"], () => this.draw());
  }

  /** Shows boxes {low, high, matrix, colour} under a name; an empty list removes them. */
  boxes(name, list) {
    this.#layers.set(name, list);
    this.draw();
  }

  /** Shows lines {from, to, colour, width, dash, mark} under a name; `mark` puts a dot at the end. */
  lines(name, list) {
    this.#lines.set(name, list);
    this.draw();
  }

  /** Draws an outline around the pixels `inside` of {width, height, inside}, which keep their colours; null: none. */
  mask(marked) {
    if (!marked && !this.#mask) return;
    this.#mask = marked && maskCanvas(marked);
    this.draw();
  }

  /** Draws with the next frame of the browser. */
  draw() {
    if (this.#asked) return;
    this.#asked = true;
    requestAnimationFrame(() => {
      this.#asked = false;
      this.#paint();
    });
  }

  #paint() {
    const { canvas: picture, area, store } = this.#app;
    const canvas = this.#canvas, dpr = globalThis.devicePixelRatio || 1;
    const [width, height] = [picture.clientWidth, picture.clientHeight];
    canvas.style.width = picture.style.width;
    canvas.style.height = picture.style.height;
    if (canvas.width !== Math.round(width * dpr)) canvas.width = Math.round(width * dpr);
    if (canvas.height !== Math.round(height * dpr)) canvas.height = Math.round(height * dpr);
    // A canvas that is touched is composed anew, which an orbit would pay for with every picture.
    const empty = !area.rectangle && !this.#mask && ![...this.#layers.values(), ...this.#lines.values()].some(({ length }) => length);
    if (empty && this.#empty) return;
    this.#empty = empty;
    // Thousands of thin lines are drawn faster without the GPU.
    const context = canvas.getContext("2d", { willReadFrequently: true });
    context.setTransform(dpr, 0, 0, dpr, 0, 0);
    context.clearRect(0, 0, width, height);
    const { camera } = store.values;
    context.imageSmoothingEnabled = false;
    if (this.#mask) context.drawImage(this.#mask, 0, 0, width, height);
    if (camera) {
      const view = viewBy(camera, width, height);
      drawBoxes(context, view, [...this.#layers.values()].flat());
      drawLines(context, view, [...this.#lines.values()].flat());
    }
    if (!area.rectangle) return;
    const zoom = width / picture.width;
    const [[x0, y0], [x1, y1]] = area.rectangle;
    const rect = [Math.min(x0, x1) * zoom, Math.min(y0, y1) * zoom, (Math.abs(x1 - x0) + 1) * zoom, (Math.abs(y1 - y0) + 1) * zoom];
    for (const [colour, dash] of [["#000", []], ["#fff", [4, 4]]]) {
      context.strokeStyle = colour;
      context.setLineDash(dash);
      context.strokeRect(...rect);
    }
    context.setLineDash([]);
  }
}

/** The rings lie outside of what is marked: colours of a legend stay true, also where that is one pixel wide. */
function maskCanvas({ width, height, inside }) {
  const canvas = new OffscreenCanvas(width, height), context = canvas.getContext("2d");
  const pixels = context.createImageData(width, height);
  let grown = inside;
  for (const colour of RINGS) {
    const next = grown.slice();
    for (let i = 0; i < grown.length; ++i) {
      const x = i % width;
      if (grown[i] || !((x > 0 && grown[i - 1]) || (x < width - 1 && grown[i + 1]) || grown[i - width] || grown[i + width])) continue;
      next[i] = 1;
      pixels.data.set(colour, 4 * i);
    }
    grown = next;
  }
  context.putImageData(pixels, 0, 0);
  return canvas;
}

function viewBy(camera, width, height) {
  const { back } = basis(camera);
  return { see: projector(camera, width, height), near: camera.projection === "orthographic" ? -Infinity : 1e-4, width, height,
           depth: (p) => -dot(sub(p, camera.eye), back) };
}

function drawBoxes(context, view, boxes) {
  for (const box of boxes) {
    const points = corners(box), path = new Path2D();
    for (const [a, b] of EDGES) addLine(path, view, points[a], points[b]);
    // A dark edge keeps thin lines visible on bright pixels; many faint boxes go without.
    const strong = (box.width ?? 1.2) > 1;
    context.globalAlpha = box.alpha ?? 1;
    if (strong) stroke(context, path, HALO, (box.width ?? 1.2) + 1.5);
    stroke(context, path, box.colour ?? "#ffffff", box.width ?? 1.2);
  }
  context.globalAlpha = 1;
}

function drawLines(context, view, lines) {
  for (const { from, to, colour, width = 2, dash = [], mark = false } of lines) {
    const path = new Path2D();
    addLine(path, view, from, to);
    stroke(context, path, HALO, width + 2);
    context.setLineDash(dash);
    stroke(context, path, colour, width);
    context.setLineDash([]);
    if (!mark || view.depth(to) < view.near) continue;
    const dot = new Path2D();
    dot.arc(...view.see(to).slice(0, 2), width + 2, 0, 2 * Math.PI);
    context.fillStyle = colour;
    context.fill(dot);
    stroke(context, dot, HALO, 1);
  }
}

function stroke(context, path, colour, width) {
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.stroke(path);
}

/** Adds a line between two points of the scene, where it can be seen. */
function addLine(path, { see, near, depth, width, height }, from, to) {
  let [p, q] = [from, to];
  const [dp, dq] = [depth(p), depth(q)];
  if (dp < near && dq < near) return;
  // Cut the line where it passes behind the eye.
  if (dp < near) p = add(p, scale(sub(q, p), (near - dp) / (dq - dp)));
  if (dq < near) q = add(q, scale(sub(p, q), (near - dq) / (dp - dq)));
  const line = clipped(see(p), see(q), width, height);
  if (!line) return;
  path.moveTo(...line[0]);
  path.lineTo(...line[1]);
}

/** Returns the part of a line inside the canvas, or null. Lines of millions of pixels take seconds to draw. */
function clipped([x0, y0], [x1, y1], width, height) {
  let from = 0, to = 1;
  for (const [start, by, most] of [[x0, x1 - x0, width], [y0, y1 - y0, height]]) {
    if (by === 0) {
      if (start < 0 || start > most) return null;
      continue;
    }
    const [a, b] = [-start / by, (most - start) / by];
    from = Math.max(from, Math.min(a, b));
    to = Math.min(to, Math.max(a, b));
  }
  const at = (t) => [x0 + t * (x1 - x0), y0 + t * (y1 - y0)];
  return from < to ? [at(from), at(to)] : null;
}
