// The picture as a PNG file with its legend, and a report of one self-contained HTML file.
import { element } from "./dom.js";
import { shortNumber } from "./histogram.js";
import { numberText } from "./ranking.js";
import { rankingOf } from "./selection.js";

function save(blob, name) {
  const url = URL.createObjectURL(blob);
  const link = element("a", { href: url, download: name });
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(url), 10000);
}

/** Draws picture and legend into one canvas. */
function composed(picture, legend) {
  const strip = !legend || legend.hidden || !legend.width ? 0 : Math.round((legend.height * picture.width) / legend.width);
  const canvas = element("canvas", { width: picture.width, height: picture.height + strip });
  const context = canvas.getContext("2d");
  context.fillStyle = getComputedStyle(document.documentElement).getPropertyValue("--raised");
  context.fillRect(0, 0, canvas.width, canvas.height);
  context.drawImage(picture, 0, 0);
  if (strip) context.drawImage(legend, 0, picture.height, picture.width, strip);
  return canvas;
}

const fileName = (state, extension) => `${state.scene.replace(/[^\w.-]+/g, "_")}-${state.view}.${extension}`;

export function downloadPng(app) {
  const canvas = composed(app.canvas, document.querySelector("#legend canvas"));
  canvas.toBlob((blob) => save(blob, fileName(app.store.values, "png")), "image/png");
}

const escaped = (text) => String(text).replace(/[&<>"']/g, (c) => `&#${c.charCodeAt(0)};`);

/** Returns the text of the report: picture, statistics, scene, link and commands. All texts are escaped. */
export function reportText({ title, picture, rows, ranking, commands, link }) {
  const table = (list) => `<table>${list.map(([a, b]) => `<tr><th>${escaped(a)}</th><td>${escaped(b)}</td></tr>`).join("")}</table>`;
  return `<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>${escaped(title)}</title>
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<style>body{font:14px/1.5 system-ui,sans-serif;margin:24px auto;max-width:1000px;padding:0 16px;color:#1b2027}img{max-width:100%}
th{text-align:left;padding-right:24px;font-weight:600}pre{background:#f0f2f5;padding:12px;white-space:pre-wrap;overflow-wrap:anywhere}</style></head><body>
<h1>${escaped(title)}</h1><img alt="Picture with its legend" src="${escaped(picture)}">${table(rows)}${ranking ? rankingText(ranking) : ""}
<h2>The same again</h2>${commands.map((text) => `<pre>${escaped(text)}</pre>`).join("")}<p>View: <code>${escaped(link)}</code></p></body></html>`;
}

const percent = (share) => `${(100 * share).toFixed(1)} %`;

/** The tables and findings of a ranking (client/EXPLAIN.md), ten rows each. */
function rankingText(document) {
  const line = (tag, cells) => `<tr>${cells.map((cell) => `<${tag}>${escaped(cell)}</${tag}>`).join("")}</tr>`;
  const table = (name) => `<h2>Work by ${name}</h2><table>${line("th", ["Name", "No.", "Share", "Wasted", "Per ray"])}${document[name].rows.slice(0, 10)
    .map((row) => line("td", [row.name || "(unnamed)", row.path ?? row.index ?? "", percent(row.share), percent(row.wasted), Number(row.work_per_ray.toPrecision(3))])).join("")}</table>`;
  const findings = document.findings.map((finding) => `<li>${escaped(`${finding.finding.replaceAll("_", " ")}: ${finding.subject}${numberText(finding)}: ` +
    `${Number(finding.figure.toPrecision(3))} ${finding.unit}, ${finding.side} ${finding.threshold}. Remedy: ${finding.remedy}.`)}</li>`).join("");
  return `${["instances", "meshes", "materials"].map(table).join("")}<h2>Diagnosis</h2>${findings ? `<ul>${findings}</ul>` : "<p>Nothing stands out.</p>"}`;
}

export async function downloadReport(app, commands) {
  const { store, model, picture, legend } = app;
  const { info } = model, s = legend.statistics, { image } = picture;
  const rows = [["Scene", info.name], ["Digest", info.hash], ["Triangles", `${shortNumber(Number(info.instanced_triangles))}, ${shortNumber(Number(info.unique_triangles))} unique`],
    ["Instances", info.instances], ["Levels", info.levels], ["View", image.view.label], ["Size", `${image.width} x ${image.height}`],
    ["Ran", `${image.started?.intersector}, ${image.done?.traversal}`],
    ...(image.view.value ? ["min", "mean", "p50", "p90", "p99", "max"].map((name) => [name, Number(s[name].toPrecision(6))]) : [])];
  const ranking = await rankingOf(app).catch(() => null);  // an orthographic camera has none
  const text = reportText({ title: `${info.name}: ${image.view.label}`, rows, ranking, commands, link: location.href,
    picture: composed(app.canvas, document.querySelector("#legend canvas")).toDataURL("image/png") });
  save(new Blob([text], { type: "text/html" }), fileName(store.values, "html"));
}
