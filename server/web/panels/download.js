// The picture as a PNG file with its legend, and a report of one self-contained HTML file.
import { cameraTable } from "../camera.js";
import { chosenRange } from "../commands.js";
import { askBytes, askDocument } from "../documents.js";
import { element } from "../dom.js";
import { bytesText, placeText, valueText } from "../numbers.js";
import { compares, jobOf, otherOf } from "../requests.js";
import { rankingOf } from "./selection.js";
import { DEFAULTS } from "../store.js";
import { fillTemplate } from "../template.js";
import { viewOf } from "../views.js";

function save(blob, name) {
  const url = URL.createObjectURL(blob);
  const link = element("a", { href: url, download: name });
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(url), 10000);
}

/** What a picture is of: scene, metric and camera. */
function captionOf({ store, model, picture }) {
  const { camera, cameraName, scene, time, animation, hidden, isolated, settings, mask } = store.values, other = otherOf(store.values);
  const named = cameraName === "" ? "" : cameraName === "automatic" ? "whole scene" : model.info?.cameras?.[Number(cameraName)] || `camera ${cameraName}`;
  const at = (point) => `(${placeText(point, model.origin, 4)})`;
  const lens = camera.projection === "orthographic" ? "orthographic" : `${valueText(camera.fov, 4)}°`;
  const moment = time === "" ? "" : ` at ${valueText(time, 4)} s of ${model.info?.animations?.[animation] || `animation ${animation}`}`;
  const parts = [hidden.length ? `${hidden.length} hidden` : "", isolated.length ? `${isolated.length} isolated` : ""].filter(Boolean);
  const by = [picture.image.started?.intersector, ...Object.entries(settings).map(([name, value]) => `${name}=${value}`), mask === DEFAULTS.mask ? "" : `mask ${mask}`].filter(Boolean);
  return { scene: `${scene}${moment}, ${by.join(" ")}`, metric: `${picture.image.view.label}${other ? ` less that of ${other}` : ""}${parts.length ? ` (${parts.join(", ")})` : ""}`,
    camera: `${named ? `${named}, ` : ""}from ${at(camera.eye)} to ${at(camera.at)}, ${lens}` };
}

const CAPTION = { line: 20, margin: 10, swatch: 10, font: "13px system-ui, sans-serif" };

/** Breaks words into lines that fit. */
function lines(context, text, width) {
  const made = [""];
  for (const word of text.split(" ")) {
    const longer = made.at(-1) ? `${made.at(-1)} ${word}` : word;
    if (made.at(-1) && context.measureText(longer).width > width) made.push(word); else made[made.length - 1] = longer;
  }
  return made;
}

/** Draws a key's colours and words in one line, with its base line at `y`. */
function drawKey(context, key, y) {
  let x = CAPTION.margin;
  for (const [word, colour] of key) {
    context.fillStyle = `rgb(${colour.join(" ")})`;
    context.fillRect(x, y - CAPTION.swatch + 1, CAPTION.swatch, CAPTION.swatch);
    context.fillStyle = inkOf("--ink");
    context.fillText(word.toLowerCase(), x + 1.5 * CAPTION.swatch, y);
    x += 1.5 * CAPTION.swatch + context.measureText(word.toLowerCase()).width + CAPTION.margin;
  }
}

/** Draws picture, legend and what it is of into one canvas. Its texts are as large as on the page, in a large picture larger. */
function composed(app) {
  const { canvas: picture, legend, frame } = app, { scene, metric, camera } = captionOf(app), { key } = app.picture.image.view;
  const grown = Math.max(picture.width / Math.max(frame.clientWidth, 1), 1), wide = picture.width / grown;
  const strip = legend.painted(picture.width, grown);
  const canvas = element("canvas", { width: picture.width, height: picture.height });
  const context = canvas.getContext("2d");
  context.font = CAPTION.font;
  const caption = [`${scene}: ${metric}`, `Camera: ${camera}`].flatMap((text) => lines(context, text, wide - 2 * CAPTION.margin));
  const rows = caption.length + (key ? 1 : 0), below = picture.height + (strip?.height ?? 0);
  canvas.height = below + Math.ceil(grown * (rows * CAPTION.line + CAPTION.margin));
  context.fillStyle = inkOf("--raised");
  context.fillRect(0, 0, canvas.width, canvas.height);
  context.drawImage(picture, 0, 0);
  if (strip) context.drawImage(strip, 0, picture.height);
  context.setTransform(grown, 0, 0, grown, 0, below);
  context.font = CAPTION.font;
  context.fillStyle = inkOf("--ink");
  caption.forEach((text, i) => context.fillText(text, CAPTION.margin, (i + 1) * CAPTION.line));
  if (key) drawKey(context, key, rows * CAPTION.line);
  return canvas;
}

const inkOf = (name) => getComputedStyle(document.documentElement).getPropertyValue(name);

/** "woods-total-less-opaque.png" */
export function fileName(state, extension) {
  const other = otherOf(state);
  return `${`${state.scene}-${state.view}${other ? `-less-${other}` : ""}`.replace(/[^\w.-]+/g, "_")}.${extension}`;
}

export function downloadPng(app) {
  composed(app).toBlob((blob) => save(blob, fileName(app.store.values, "png")), "image/png");
}

/** The bytes of an answer as base64. */
async function base64(blob) {
  const url = await new Promise((resolve) => {
    const reader = new FileReader();
    reader.onload = () => resolve(reader.result);
    reader.readAsDataURL(blob);
  });
  return url.slice(url.indexOf(",") + 1);
}

/**
 * Saves the report that `raynest heatmap -o report.html` makes: the same text, filled with the same documents. The heat map
 * is that of the view, or of the total where the view counts nothing; the picture beside it is what the page shows then.
 */
export async function downloadReport(app, commands) {
  const { store, daemon, canvas } = app, state = store.values, view = viewOf(state.view);
  if (state.camera.projection === "orthographic") return app.inform("A report needs a perspective camera: press P");
  app.inform("The report is being made");
  const lit = app.picture.image.linear && app.picture.image.started?.intersector;
  const { width, height } = canvas, job = jobOf(state), camera = cameraTable(state.camera);
  const costs = view.counter || view.measured, metric = costs ? view.fields(state)[0] : "total";
  const heatmap = { job, camera, width, height, metric, palette: state.palette, scale: state.log ? "log" : "linear", encode: "json+png",
    range: costs ? [chosenRange(state)].flat().join(":") : "p99", ...(compares(state) && costs ? { other: jobOf(state, state.compare) } : {}) };
  const [text, heat, ranking, shown] = await Promise.all([fetch("report.html").then((answer) => answer.text()), askDocument(daemon, "Heatmap", heatmap), rankingOf(app, { top: 0 }),
    costs ? askBytes(daemon, "Render", { job, camera, width, height, integrator: "primary", encode: "png" }).then((bytes) => new Blob([bytes]))
      : new Promise((resolve) => { canvas.toBlob(resolve, "image/png"); })]);
  const report = fillTemplate(text, { heat, ranking, lit_by: lit && lit !== heat.intersector ? lit : "", picture: await base64(shown), limits: false, checks: [], commands, camera: captionOf(app).camera,
    version: daemon.welcome.server.split(" ").at(-1), link: location.href }, bytesText);
  save(new Blob([report], { type: "text/html" }), fileName(state, "html"));
}
