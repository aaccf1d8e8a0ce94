// The request of the picture as a command line and as Python.
import { add, generator, halfHeight } from "./camera.js";
import { rangeOf } from "./histogram.js";
import { compares } from "./requests.js";
import { reads, sunOf } from "./light.js";
import { SETTINGS } from "./lists.js";
import { DEFAULTS } from "./store.js";
import { viewOf } from "./views.js";

/** Quotes a word for a shell; in single quotes nothing has a meaning. */
export const shellWord = (text) => (/^[\w./:=,@%+-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`);

/** A string literal of Python; JSON's escapes are Python's. */
const literal = (text) => JSON.stringify(text);

/** The range as requests and programs have it: p99, auto or [low, high], of a difference as long on both sides. */
export function chosenRange(state) {
  if (!Array.isArray(state.range)) return state.range;
  const { low, high } = rangeOf(state.range, {}, compares(state));
  return [low, high];
}

function parts(state, [width, height]) {
  const view = viewOf(state.view), { camera } = state;
  const lookat = [...camera.eye, ...camera.at, ...camera.up].join(",");
  const range = chosenRange(state);
  return { view, camera, lookat, range, size: `${width}x${height}`, mask: state.mask,
           metric: state.level === "" || view.measured ? view.id : `${view.id}.${state.level}` };
}

/** True for a picture that is a heat map of the command line. */
export const isHeatMap = (view, { kind, camera }) => camera.projection !== "orthographic" && Boolean(view.measured || (view.counter && kind === "closest"));

/** The state with its camera in the world; the page's is relative to the scene's origin. */
export const inWorld = (state, origin) => ({ ...state, camera: { ...state.camera,
  eye: add(state.camera.eye, origin), at: add(state.camera.at, origin) } });

/** What is hidden and isolated, as --hide and --only take it: "i12" is inst=12, "o3" is object=3. */
const selected = (ids) => ids.map((id) => `${id[0] === "i" ? "inst" : "object"}=${id.slice(1)}`);

/** Options and arguments of a lit picture, without those that have their default: [option, argument, value]. */
function lightOptions(state) {
  const all = [["--integrator", "integrator", state.integrator]];
  if (state.integrator === "primary") return all;
  all.push(["--spp", "spp", state.samples]);
  if (state.seed !== DEFAULTS.seed) all.push(["--seed", "seed", state.seed]);
  for (const [key, { field, option, initial }] of Object.entries(SETTINGS))
    if (reads(state.integrator, field) && state[key] !== initial) all.push([option, field, state[key]]);
  if (reads(state.integrator, "environment") && state.env !== DEFAULTS.env) all.push(["--env", "environment", state.env]);
  if (reads(state.integrator, "sun") && sunOf(state.sun) && state.env !== "none") all.push(["--sun", "sun", sunOf(state.sun)]);
  if (state.tonemap !== "") all.push(["--tonemap", "tonemap", state.tonemap]);
  if (state.exposure !== "") all.push(["--exposure", "exposure", state.exposure]);
  return all;
}

/** Returns the command that gives the same picture, or its columns where a view is not a picture of the CLI. */
export function asCommand(state, size) {
  const p = parts(state, size);
  const common = [];
  if (state.intersector !== "auto") common.push("--intersector", state.intersector);
  for (const [name, value] of Object.entries(state.settings)) common.push("--set", `${name}=${value}`);
  if (parseInt(p.mask, 16) !== 0xffffffff) common.push("--mask", p.mask);
  for (const text of selected(state.hidden)) common.push("--hide", text);
  for (const text of selected(state.isolated)) common.push("--only", text);
  if (state.skipHiddenBoxes && state.hidden.length + state.isolated.length) common.push("--skip-hidden-boxes");
  if (state.time !== "") common.push("--time", String(state.time), "--animation", String(state.animation));
  const orthographic = p.camera.projection === "orthographic";
  const camera = [`--lookat=${p.lookat}`, "--fov", String(p.camera.fov), "--size", p.size];
  let words;
  if (isHeatMap(p.view, state)) {
    words = ["heatmap", state.scene, "-o", "heat.png", "--metric", p.metric, "--palette", state.palette, "--range", [p.range].flat().join(":"),
             "--scale", state.log ? "log" : "linear", ...camera, ...common];
    if (compares(state)) words.push("--diff", state.compare.replace(/^(intersector|mask):/, "$1=").replace(/^(scene|set):/, ""));
  } else if (p.view.lit && !orthographic) {
    words = ["render", state.scene, "-o", "lit.png", ...camera, ...lightOptions(state).map(([option, , value]) => `${option}=${value}`), ...common];
  } else if (p.view.render && !orthographic) {
    words = ["render", state.scene, "-o", "picture.png", ...camera, ...common];
  } else {
    words = ["query", state.scene, "--generate", ...generatorWords(state, size), "--fields", p.view.fields(state).join(","), "-o", "columns.npz",
             ...(p.view.counter ? ["--kind", state.kind] : []), ...common];
  }
  return ["raynest", ...words].map(shellWord).join(" ");
}

function generatorWords(state, [width, height]) {
  const { kind, settings } = generator(state.camera, width, height);
  return [kind, ...settings];
}

/** What a heat map is compared with, as Python's `diff` takes it. */
function pythonDiff(compare) {
  const [, kind, value] = /^(\w+):(.*)$/s.exec(compare);
  if (kind === "scene") return `client.scene(${literal(value)})`;
  if (kind === "mask") return `{"mask": 0x${value}}`;
  if (kind === "intersector") return `{"intersector": ${literal(value)}}`;
  const [name, ...rest] = value.split("=");
  return `{"params": ${JSON.stringify({ [name]: rest.join("=") })}}`;
}

/** Returns a Python program that gives the same counts, picture or columns. */
export function asPython(state, size) {
  const { view, camera, metric, range } = parts(state, size);
  const point = (v) => `(${v.join(", ")})`;
  const orthographic = camera.projection === "orthographic";
  const where = [`look_at=(${[camera.eye, camera.at, camera.up].map(point).join(", ")})`, `size=(${size.join(", ")})`];
  const job = [];
  if (state.intersector !== "auto") job.push(`intersector=${literal(state.intersector)}`);
  if (Object.keys(state.settings).length) job.push(`params=${JSON.stringify(state.settings)}`);
  if (parseInt(state.mask, 16) !== 0xffffffff) job.push(`mask=0x${state.mask}`);
  if (state.hidden.length) job.push(`hide=${JSON.stringify(selected(state.hidden))}`);
  if (state.isolated.length) job.push(`only=${JSON.stringify(selected(state.isolated))}`);
  if (state.skipHiddenBoxes && state.hidden.length + state.isolated.length) job.push("skip_hidden_boxes=True");
  if (state.time !== "") job.push(`time=${state.time}`, `animation="${state.animation}"`);
  let lines;
  if (isHeatMap(view, state)) {
    const span = Array.isArray(range) ? point(range) : literal(range);
    const colours = [...(state.palette === DEFAULTS.palette ? [] : [`palette=${literal(state.palette)}`]), ...(state.log ? ['scale="log"'] : []),
                     ...(compares(state) ? [`diff=${pythonDiff(state.compare)}`] : [])];
    lines = [`counts = scene.heatmap(${[...where, `fov=${camera.fov}`, `metric=${literal(metric)}`, `range=${span}`, ...colours, ...job].join(",\n                       ")})`];
  } else if (view.lit && !orthographic) {
    const light = lightOptions(state).map(([, name, value]) => `${name}=${Array.isArray(value) ? point(value) : JSON.stringify(value)}`);
    lines = [`pixels = scene.render(${[...where, `fov=${camera.fov}`, ...light, 'encode="raw"', ...job].join(",\n                      ")})`];
  } else if (view.render && !orthographic) {
    lines = [`pixels = scene.render(${[...where, `fov=${camera.fov}`, ...job].join(",\n                      ")})`];
  } else {
    const high = (2 * halfHeight(camera)).toPrecision(7);
    const sensor = orthographic ? `orthographic((${(high * size[0]) / size[1]}, ${Number(high)}), ` : `camera(fov=${camera.fov}, `;
    const kind = view.counter && state.kind !== "closest" ? [`kind=${literal(state.kind)}`] : [];
    lines = [`rays = raynest.generators.${sensor}${where.join(", ")})`,
             `columns = scene.trace(${["rays", `fields=${JSON.stringify(view.fields(state))}`, ...kind, ...job].join(", ")})`];
  }
  return ["import raynest", "import raynest.generators", "", "client = raynest.connect()", `scene = client.scene(${literal(state.scene)})`, ...lines, ""].join("\n");
}
