// The panel "Setup": what decides the rays and their hits, and what the scene holds.
import { AXES, add, cross, distance, dot, length, sub, unit, basis, scale, rounded } from "../camera.js";
import { element, field, fillSelect, pairs } from "../dom.js";
import { followsLight, lightSection } from "../light.js";
import { timeSection } from "./time.js";
import { bytesText, countText, placeText, timeText, valueText } from "../numbers.js";

const SIZES = [["fit", "As large as shown"], ["320x180", "320 x 180"], ["640x360", "640 x 360"], ["960x540", "960 x 540"],
               ["1280x720", "1280 x 720"], ["1920x1080", "1920 x 1080"]];

export const setupPanel = { id: "setup", title: "Setup", build };

function build(app, place) {
  place.append(lightSection(app.store), timeSection(app), element("h2", {}, "Intersector"), intersector(app), element("h2", {}, "Rays"), rays(app),
               element("h2", {}, "Difference with"), difference(app), element("h2", {}, "Camera"), cameraFields(app),
               element("h2", {}, "Scene"), sceneFacts(app), element("h2", {}, "This picture"), pictureFacts(app));
}

function intersector({ store, model }) {
  const select = element("select", { id: "intersector" });
  const text = element("p", { className: "hint" });
  const place = element("div", { id: "parameters" });
  select.onchange = () => store.set({ intersector: select.value, settings: {} });
  const show = (state) => {
    const variants = model.variants, auto = model.resolve("auto", followsLight(state));
    fillSelect(select, [["auto", `auto (${auto})`], ...variants.map(({ name }) => [name, name])], state.intersector);
    const ran = state.intersector === "auto" ? auto : state.intersector;
    const variant = variants.find(({ name }) => name === ran);
    text.textContent = variant ? `${state.intersector === "auto" ? `auto takes ${ran}: ` : ""}${variant.text}` : "";
    place.replaceChildren(...(variant?.params ?? []).map((param) => parameter(store, param)));
  };
  store.on(["intersector", "settings", "view", "integrator"], show);
  model.addEventListener("change", () => show(store.values));
  show(store.values);
  return element("div", {}, field("Intersector", select), text, place);
}

/** A select for choices, else a number; an empty field is the default. */
function parameter(store, param) {
  const given = store.values.settings[param.name];
  const set = (value) => {
    const settings = { ...store.values.settings };
    if (value === "") delete settings[param.name]; else settings[param.name] = value;
    store.set({ settings });
  };
  if (param.type === "table") return element("p", { className: "hint" }, `${param.name}: ${param.text}; a table, which raynest and Python bring`);
  if (param.type === "choice") {
    const select = element("select", {});
    const initial = param.choices[param.initial] ?? param.choices[0];
    fillSelect(select, param.choices.map((name) => [name === initial ? "" : name, name]), given ?? "");
    select.onchange = () => set(select.value);
    return field(param.name, select, param.text);
  }
  const limit = (x) => (Number.isFinite(Number(x)) ? Number(x) : undefined);
  const input = element("input", { type: "number", step: param.type === "u32" ? "1" : "any", value: given ?? "",
                                   placeholder: String(param.initial) });
  const [low, high] = [limit(param.minimum), limit(param.maximum)];
  if (low !== undefined) input.min = low;
  if (high !== undefined) input.max = high;
  input.onchange = () => { if (input.reportValidity()) set(input.value); };
  return field(param.name, input, param.text);
}

function rays({ store }) {
  const kind = element("select", { id: "kind" });
  fillSelect(kind, [["closest", "closest hit"], ["any", "any hit"]], store.values.kind);
  kind.onchange = () => store.set({ kind: kind.value });
  const mask = element("input", { type: "text", id: "mask", pattern: "[0-9a-fA-F]{1,8}", spellcheck: false, maxLength: 8 });
  mask.onchange = () => { if (mask.value && mask.reportValidity()) store.set({ mask: mask.value.toLowerCase() }); };
  const bits = element("div", { className: "buttons", role: "group", ariaLabel: "Mask bits 0 to 7" });
  for (let bit = 0; bit < 8; ++bit) {
    bits.append(element("button", { type: "button", title: `Mask bit ${bit}`, onclick: () =>
      store.set({ mask: ((parseInt(store.values.mask, 16) ^ (1 << bit)) >>> 0).toString(16).padStart(8, "0") }) }, String(bit)));
  }
  const size = element("select", { id: "size" });
  size.onchange = () => store.set({ size: size.value });
  store.on(["mask", "kind", "size"], (state) => {
    mask.value = state.mask;
    kind.value = state.kind;
    fillSelect(size, SIZES.some(([value]) => value === state.size) ? SIZES : [...SIZES, [state.size, state.size.replace("x", " x ")]], state.size);
    [...bits.children].forEach((button, bit) => button.setAttribute("aria-pressed", Boolean(parseInt(state.mask, 16) >>> bit & 1)));
  }, true);
  return element("div", {}, field("Kind", kind), field("Mask", mask, "Only instances with one of these bits, hexadecimal"), bits,
                 field("Resolution", size));
}

function difference({ store, model }) {
  const select = element("select", { id: "compare" });
  select.onchange = () => store.set({ compare: select.value });
  const setting = element("input", { type: "text", placeholder: "cutoff=0.3", maxLength: 100, id: "compare-setting" });
  setting.onchange = () => store.set({ compare: setting.value ? `set:${setting.value}` : "" });
  const show = (state) => {
    const options = [["", "nothing"], { group: "Intersector", options: model.variants.map(({ name }) => [`intersector:${name}`, name]) },
      { group: "Scene", options: model.scenes.filter((name) => name !== state.scene).map((name) => [`scene:${name}`, name]) }];
    const known = options.flatMap((entry) => entry.options ?? [entry]).some(([value]) => value === state.compare);
    if (!known) options.push([state.compare, state.compare.replace(/^(set|mask):/, (_, kind) => (kind === "set" ? "" : "mask "))]);
    fillSelect(select, options, state.compare);
  };
  const showSetting = ({ compare }) => { setting.value = compare.startsWith("set:") ? compare.slice("set:".length) : ""; };
  store.on(["compare", "scene"], show);
  store.on(["compare"], showSetting, true);
  for (const event of ["change", "scenes"]) model.addEventListener(event, () => show(store.values));
  show(store.values);
  return element("div", {}, field("Compare", select), field("or a parameter", setting),
    element("p", { className: "hint" }, "Red pixels cost more than with the other setting, blue ones less. Views of cost and depth show it."));
}

function cameraFields({ store, model, showCamera }) {
  const control = element("select", { id: "control" });
  fillSelect(control, [["orbit", "orbit"], ["first", "first person"], ["free", "free"]], store.values.control);
  control.onchange = () => store.set({ control: control.value });
  const projection = element("select", { id: "projection" });
  fillSelect(projection, [["perspective", "perspective"], ["orthographic", "orthographic"]], "perspective");
  projection.onchange = () => showCamera({ ...store.values.camera, projection: projection.value });
  const axis = element("select", { id: "up-axis" });
  fillSelect(axis, Object.keys(AXES).map((name) => [name, `${name.toUpperCase()} up`]), store.values.upAxis);
  axis.onchange = () => {
    const { value } = axis;  // which the store's listener below sets to what the camera has
    store.set({ upAxis: value });
    showCamera(level(store.values.camera, AXES[value]));
  };
  const fov = element("input", { type: "number", min: 1, max: 170, step: "any", id: "fov" });
  fov.onchange = () => { if (fov.value && fov.reportValidity()) showCamera({ ...store.values.camera, fov: Number(fov.value) }); };
  const facts = element("div");
  const show = ({ camera, control: kind, upAxis }) => {
    if (!camera) return;
    const own = Object.keys(AXES).find((name) => AXES[name].every((x, i) => x === camera.up[i]));
    [control.value, axis.value, projection.value] = [kind, own ?? upAxis, camera.projection];
    if (document.activeElement !== fov) fov.value = camera.fov;
    const place = (point) => placeText(point, model.origin);
    facts.replaceChildren(pairs([["Eye", place(camera.eye)], ["Looks at", place(camera.at)]]));
  };
  store.on(["camera", "control", "upAxis"], show, true);
  model.addEventListener("change", () => show(store.values));
  return element("div", {}, field("Control", control), field("Projection", projection), field("Up axis", axis),
                 field("Angle of view", fov), facts);
}

/** The camera with another up; it moves off that axis where it looked straight along it. */
function level(camera, up) {
  const ahead = sub(camera.at, camera.eye);
  if (length(cross(unit(ahead), up)) > 0.03) return rounded({ ...camera, up });
  const aside = scale(basis({ ...camera, up }).up, 0.1 * distance(camera) * Math.sign(dot(ahead, up) || 1));
  return rounded({ ...camera, eye: add(camera.eye, aside), up });
}

function sceneFacts({ model }) {
  const place = element("div");
  const show = () => {
    const { info } = model;
    place.replaceChildren(info ? pairs([
      ["Triangles", `${countText(info.instanced_triangles)} (${countText(info.unique_triangles)} unique)`],
      ...(info.record_types ?? []).map((type, i) => ["Primitives", `${countText(info.record_counts[i])} ${type}`]),
      ["Intersector", info.intersector ? `auto is ${info.intersector}` : "none knows these primitives"],
      ["Instances", countText(info.instances)], ["Levels", info.levels], ["Materials", countText(info.materials ?? 0)],
      ...(Number(info.degenerate_triangles) ? [["Degenerate", `${countText(info.degenerate_triangles)} triangles, which nothing can hit`]] : []),
      ["Memory", bytesText(info.bytes)], ["Tree height", info.tree_height], ["SAH cost", valueText(info.sah_cost, 4)],
      ["Digest", info.hash.slice(0, 16)], ...(info.warnings ?? []).map((warning) => ["Warning", warning])]) : element("p", { className: "hint" }, "No scene is shown."));
  };
  model.addEventListener("change", show);
  show();
  return place;
}

function pictureFacts({ picture }) {
  const place = element("div");
  const show = () => {
    const { image } = picture;
    // Figures of an earlier picture say nothing about this one.
    if (!image?.complete) return place.replaceChildren(element("p", { className: "hint" }, image ? "It is being traced." : "There is none yet."));
    const { done, started } = image, notes = [...new Set([...started.notes ?? [], ...done.notes ?? []])];
    return place.replaceChildren(pairs([["Rays", `${image.width} x ${image.height}, ${countText(done.hits)} hit`],
      ["Traced in", timeText(1000 * done.seconds)], ["Arrived in", timeText(image.ms)],
      ["Ran", `${started.intersector}, ${done.traversal}, ${done.target}`], ...notes.map((note) => ["Note", note])]));
  };
  picture.addEventListener("image", show);
  show();
  return place;
}
