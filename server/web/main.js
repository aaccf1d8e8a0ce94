// Puts the page together: the daemon, what is shown, the picture, and the panels.
import { asCommand, asPython, inWorld, isHeatMap, shellWord } from "./commands.js";
import { cameraOfRays, frame as frameBox, rounded } from "./camera.js";
import { steer } from "./controls.js";
import { breakable, byId, element, fillSelect } from "./dom.js";
import { changesText, Follower, sameAnimation, sameCamera, versionOf, wasEdited } from "./follow.js";
import { downloadPng, downloadReport } from "./panels/download.js";
import { Hover } from "./panels/hover.js";
import { showDialog, startKeys } from "./keys.js";
import { Legend } from "./legend.js";
import { lightRow } from "./light.js";
import { boxOf, Model } from "./model.js";
import { Overlay } from "./overlay.js";
import { buildPanels } from "./panels/panels.js";
import { nothingHit, Picture } from "./picture.js";
import { Daemon } from "./raynest.js";
import { compares, momentOf } from "./requests.js";
import { logOut, redeemCode, whoAmI } from "./session.js";
import { keepView, keptView } from "./settings.js";
import { Selection } from "./panels/selection.js";
import { Store, TIME_KEYS } from "./store.js";
import { Surface } from "./surface.js";
import { startTheme } from "./theme.js";
import { lookOf } from "./tonemap.js";
import { fitted, readFragment, toFragment } from "./url.js";
import { viewOf, viewOptions } from "./views.js";
import { visibility } from "./panels/visibility.js";

const PIXELS_MAX = 2560 * 1600;
const notLoggedIn = await redeemCode();  // before the view is read from the address
const LEGEND_MS = 250;  // the histogram follows coarse pictures at this interval
const frame = byId("frame"), canvas = byId("picture");
const link = readFragment(location.hash);
const store = new Store({ ...keptView(), ...link.state });
const daemon = new Daemon(`${location.origin.replace(/^http/, "ws")}/v1/stream`, { client: "page" });
const model = new Model(daemon);
const picture = new Picture(daemon, store, tracedSize);
const legend = new Legend(store, byId("legend"));
const area = Object.assign(new EventTarget(), { rectangle: null });
byId("legend").append(lightRow({ store, picture }));
const app = { daemon, store, model, picture, legend, area, canvas, frame, failed, inform, showCamera, showMoment };
app.hover = new Hover(app);
app.overlay = new Overlay(app, byId("overlay"));
app.selection = new Selection(app);
app.actions = visibility(app);
app.hover.addEventListener("found", ({ chooses }) => { if (chooses) app.selection.chooseHit(app.hover.pinned); });
let surface = null;
try {
  surface = new Surface(canvas);
} catch (error) {
  say(error.message, true);
}

/** Pixels of the fine picture: as chosen, or one for each pixel of the device, up to a limit. */
function tracedSize() {
  const chosen = /^(\d{1,5})x(\d{1,5})$/.exec(store.values.size);
  if (chosen) return [Math.min(Math.max(Number(chosen[1]), 8), 4096), Math.min(Math.max(Number(chosen[2]), 8), 4096)];
  const dpr = globalThis.devicePixelRatio || 1, [w, h] = [frame.clientWidth * dpr, frame.clientHeight * dpr];
  const shrink = Math.min(1, Math.sqrt(PIXELS_MAX / Math.max(w * h, 1)));
  return [Math.max(Math.floor(w * shrink), 16), Math.max(Math.floor(h * shrink), 16)];
}

// ---- the picture ------------------------------------------------------------------------------

function fit() {
  const [width, height] = tracedSize();
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  const zoom = Math.min(frame.clientWidth / width, frame.clientHeight / height);
  canvas.style.width = `${width * zoom}px`;
  canvas.style.height = `${height * zoom}px`;
  draw();
}

let asked = false;
function draw() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(() => {
    asked = false;
    app.overlay.draw();
    if (!surface || !picture.image) return;
    if (picture.image !== draw.uploaded || !picture.image.complete) surface.upload(picture.image);
    draw.uploaded = picture.image.complete ? picture.image : null;
    surface.draw({ byValue: Boolean(picture.image.view.value), opacity: store.values.opacity, ...legend.scale,
                   look: picture.image.linear ? lookOf(store.values, picture.image) : null });
    frame.dataset.shown = picture.image.fine ? (picture.image.complete ? "fine" : "partial") : "coarse";
  });
}

/** Returns the pixel of the traced picture below a point of the window. */
app.pixelAt = (x, y) => {
  const box = canvas.getBoundingClientRect(), { image } = picture;
  const [px, py] = [Math.floor(((x - box.left) / box.width) * canvas.width), Math.floor(((y - box.top) / box.height) * canvas.height)];
  return image?.fine && px >= 0 && py >= 0 && px < canvas.width && py < canvas.height ? [px, py] : null;
};

function showCamera(camera) { store.set({ camera: rounded(camera), cameraName: "" }); }

let pointer = null;
function hoverAt(x, y) {
  pointer = x === null ? null : [x, y];
  const pixel = pointer && app.pixelAt(x, y);
  if (pixel) app.hover.at(...pixel); else app.hover.leave();
}

steer(frame, store, {
  change: showCamera,
  hover: hoverAt,
  click: (x, y) => {
    const pixel = app.pixelAt(x, y);
    if (pixel) keepRay(pixel);
  },
  rectangle: (from, to, done) => {
    const [a, b] = [app.pixelAt(...from), app.pixelAt(...to)];
    if (!a || !b) return;
    area.rectangle = [a, b];
    app.overlay.draw();
    if (done) {
      area.dispatchEvent(new Event("change"));
      store.set({ panel: "area" });
    }
  },
});

function keepRay(pixel) {
  // Tables stay, and mark the row; the other panels give way to the ray's.
  if (!["ranking", "objects"].includes(store.values.panel)) store.set({ panel: "ray" });
  app.hover.pin(...pixel);
}
frame.addEventListener("keydown", (event) => {
  if (event.key === "Enter" && picture.image?.fine) keepRay([canvas.width >> 1, canvas.height >> 1]);
});

picture.addEventListener("image", () => {
  if (!picture.image.fine) waitingSince = null;  // what moves is not waited for
  // The record under a pointer that rests is that of the new picture.
  if (picture.image.complete && pointer && !app.hover.found) hoverAt(...pointer);
  // The daemon traces what is loaded now, which may be newer than what the page has been told.
  // At a moment of an animation its content is of that moment; its epoch is the scene's.
  const { started } = picture.image, kind = store.values.time === "" ? "hash" : "epoch";
  if (started && model.info && String(started[kind]) !== String(model.info[kind])) follower.look();
  if (picture.image.complete || !picture.image.fine || picture.image.linear) legend.show(picture.image, picture.image.fine ? 0 : LEGEND_MS);
  say(model.isEmpty ? "This scene holds nothing that a ray can hit." : nothingHit(picture.image));
  draw();
});
picture.addEventListener("failed", ({ error }) => {
  const { hidden, isolated } = store.values;
  // A link may hide what the scene lacks, and the page what the scene had before it was replaced.
  const [, what, count] = /there is no (outermost instance|object) \d+: the scene has (\d+)/.exec(error.name === "INVALID_FIELD" ? error.message : "") ?? [];
  const isThere = (id) => (id[0] === "i") !== (what === "outermost instance") || Number(id.slice(1)) < Number(count);
  const patch = { hidden: hidden.filter(isThere), isolated: isolated.filter(isThere) };
  if (count !== undefined && patch.hidden.length + patch.isolated.length < hidden.length + isolated.length) {
    const gone = [["hidden", hidden], ["isolated", isolated]].map(([key, ids]) => [key, ids.filter((id) => !isThere(id))]).filter(([, ids]) => ids.length);
    if (followed) notice(`${followed} What was hidden or isolated and is not in the scene any more is left out.`);
    else notUnderstood(gone.map(([key, ids]) => `${key}=${ids}`));
    store.set(patch);
    return;
  }
  failed(error);
});
store.on(["palette", "range", "log", "opacity", "exposure", "tonemap"], draw);
store.on(["size"], () => { fit(); picture.restart(); });
function clearRectangle() {
  area.rectangle = null;
  area.dispatchEvent(new Event("change"));
  draw();
}
store.on(["scene", "camera", "view"], clearRectangle);
new ResizeObserver(() => {
  const before = [canvas.width, canvas.height];
  fit();
  if (before[0] === canvas.width && before[1] === canvas.height) return;
  // Its pixels show other places now.
  app.hover.resized();
  clearRectangle();
  picture.moved();
}).observe(frame);

// ---- scene, camera, view ----------------------------------------------------------------------

let followed = "";  // what was said last about a scene that changed
let missing = "";   // the scene that was shown and is not loaded now

async function open() {
  try {
    await model.refresh();
    if (!store.values.scene && !chooseFirst()) return say("No scene is loaded that this page may see. Load one, for example: raynest load builtin:forest; then raynest open shows what is yours");
    await chooseScene(store.values.camera);
  } catch (error) {
    if (error.name === "SCENE_UNKNOWN") return sceneIsGone(store.values.scene);
    failed(error);
  }
}

/** Chooses the first scene of the daemon; false where it has none. */
function chooseFirst() {
  if (model.scenes.length === 0) return false;
  store.set({ scene: model.scenes[0] });
  return true;
}

function howToLoad(scene) {
  const [, owner, name] = /^(.*)\/([^/]*)$/.exec(scene) ?? [];
  return owner === undefined ? `load it: raynest load FILE --name ${shellWord(scene)}. If another user has loaded it, have that user load it with --share public.`
    : `have ${owner} load it: raynest load FILE --name ${shellWord(name)} --share public.`;
}

/** Offers the loaded scenes in place of one that a link names, or that has been unloaded. */
function sceneIsGone(scene) {
  missing = scene;
  followed = "";
  byId("notice").replaceChildren();  // what was said about it before
  const was = lastScene === scene;
  model.forget();
  listScenes();
  const shows = was ? " any more; the picture is the last one of it" : lastInfo ? `; the picture is of "${lastScene}"` : "";
  say(`The scene "${scene}" is not loaded${shows}. Choose another one, or ${howToLoad(scene)} The page shows it as soon as it is there.`, true);
}

/** Fills the list of scenes where it is not what it was: one that is open loses its place. */
function listScenes() {
  const { scene } = store.values, shown = [...byId("scene").options].map(({ value }) => value).filter(Boolean);
  const names = [...new Set([...model.scenes.filter((name) => name !== model.info?.name), ...scene && model.info ? [scene] : []])].filter((name) => name !== missing).sort();
  if (names.join("\n") === shown.join("\n") && byId("scene").value === (missing ? "" : scene)) return;
  fillSelect(byId("scene"), [...missing ? [["", "choose"]] : [], ...names.map((name) => [name, name])], missing ? "" : scene);
}
for (const event of ["change", "scenes"]) model.addEventListener(event, listScenes);

const follower = new Follower(app, {
  gone: async (scene) => {
    await model.refresh().catch(() => {});
    sceneIsGone(scene);
  },
  loaded: async () => {
    await model.refresh();
    if (chooseFirst()) await chooseScene(null);
  },
  changed: (info) => chooseScene(store.values.camera, info),
});

// Answers that take longer than this have a sign that they are on their way.
const SLOW_MS = 400;
let waitingSince = null;
setInterval(() => {
  const waits = picture.waiting || (!picture.image?.linear && daemon.pending > 0) || daemon.state === "connecting";
  waitingSince = waits ? waitingSince ?? performance.now() : null;
  byId("busy").hidden = !waits || performance.now() - waitingSince < SLOW_MS;
}, 100);

/** Shows a line over the picture, until it is closed or another one comes. */
function notice(text) {
  byId("notice").replaceChildren(element("span", {}, breakable(text)),
    element("button", { type: "button", ariaLabel: "Close this note", onclick: () => byId("notice").replaceChildren() }, "×"));
}

let fitLink = true;
const listed = (parts) => {
  const short = parts.slice(0, 4).map((text) => (text.length > 30 ? `${text.slice(0, 30)}…` : text));
  return [...short, ...parts.length > 4 ? [`${parts.length - 4} more`] : []].join(", ");
};

const misread = new Set();  // parts of the link: some are found when a picture is traced

/** Says in one line which parts of the link have their default in the picture. */
function notUnderstood(parts) {
  for (const part of parts) misread.add(part);
  if (parts.length) notice(`Not understood in this link: ${listed([...misread])}. Defaults are shown.`);
}

let lastInfo = null, lastScene = "";  // the scene that was shown last

/** Asks for everything about the scene, and says what is not as it was when the page showed it last. */
async function chooseScene(camera) {
  const { scene: asked, cameraName } = store.values;
  const info = await model.choose(asked);
  if (store.values.scene !== asked) return;
  // A short name of another's scene becomes the one that it has here. A full name stays: a link is for others, too.
  const scene = asked.includes("/") ? asked : info.name || asked;
  store.set({ scene });
  const before = lastScene === scene ? lastInfo : null;
  [lastInfo, lastScene] = [info, scene];
  const came = missing === asked;
  missing = "";
  listScenes();
  fillSelect(byId("camera"), [["", "own"], ...info.cameras?.length ? info.cameras.map((name, i) => [String(i), name || `camera ${i}`]) : [["automatic", "whole scene"]]], cameraName);
  const levels = Array.from({ length: info.levels }, (_, level) => [String(level), level === 0 ? "0 (root)" : String(level)]);
  fillSelect(byId("level"), [["", "all"], ...levels], store.values.level);
  const moving = before && store.values.time !== "" ? sameAnimation(store.values.animation, before, info) : store.values.animation;
  if (moving === null) store.set({ time: "", animation: 0 });
  else store.set({ animation: moving });
  const { patch, ignored } = fitted(store.values, model);
  store.set(patch);
  if (fitLink) notUnderstood([...link.ignored, ...ignored]);
  const linked = fitLink && cameraName !== "" && info.cameras?.[Number(cameraName)] !== undefined;
  fitLink = false;
  const changed = before && versionOf(before) !== versionOf(info);
  let again = cameraName;
  if (changed || (before && came)) {
    again = sameCamera(cameraName, before, info);
    const gone = `${cameraName && !again ? " Its camera is gone: the view stays." : ""}${moving === null ? " Its animation is gone: no moment of one is shown." : ""}`;
    // Parts that come and go in one edit leave their number as it is, but build the tree anew.
    const isSame = wasEdited(info) && !came && ["instances", "rebuilds"].every((count) => Number(before[count] ?? 0) === Number(info[count] ?? 0));
    const shown = !isSame && (store.values.hidden.length || store.values.isolated.length) ? " What was hidden or isolated has other numbers now: all of it is shown." : "";
    if (shown) store.set({ hidden: [], isolated: [] });
    followed = `"${scene}" ${came ? "is loaded again" : wasEdited(info) ? "was edited" : "was replaced"}: ${changesText(before, info)}.${gone}${shown}${ignored.length ? ` Not in it: ${listed(ignored)}.` : ""}`;
    notice(followed);
    if (cameraName !== again) store.set({ cameraName: again });
    app.selection.follow();
  }
  // A camera of the file, and the one that sees the whole scene, are as the new content has them.
  if (!camera) await chooseCamera(linked ? cameraName : info.cameras?.length ? "0" : "automatic");
  else if (changed && again) await chooseCamera(again);
  if (camera) picture.restart();
}

/** Returns the pose of a camera of the file, at the moment of a state, from the rays that it makes. */
async function poseOf(name, state) {
  const { low, high } = model.box;
  const target = { center: low.map((x, i) => (x + high[i]) / 2), radius: Math.max(Math.hypot(...high.map((x, i) => x - low[i])) / 2, 1e-6) };
  const settings = ["size=2x2", ...(name === "automatic" ? [] : [`camera=${name}`])];
  let pose = null;
  for await (const { type, columns } of daemon.request("Query", { job: { scene: state.scene, ...momentOf(state) }, kind: "null",
    fields: ["origin", "direction"], generator: { kind: "camera", settings } })) if (type === "Chunk") pose = cameraOfRays(columns, target);
  return pose;
}

/** Shows the scene through a camera of the file, at the moment that is shown. */
async function chooseCamera(name) {
  const asked = store.values, camera = await poseOf(name, asked), now = store.values;
  if (camera && TIME_KEYS.concat("scene").every((key) => asked[key] === now[key])) store.set({ camera, cameraName: name });
}

const isOfFile = (name) => name !== "" && model.info?.cameras?.[Number(name)] !== undefined;
let posed = "";       // the moment whose camera is shown
let wanted = null;    // the next moment
let isPosing = false;
/** Shows another moment, through the camera of the file as it stands then. One that comes meanwhile takes its turn afterwards. */
async function showMoment(moment) {
  wanted = moment;
  if (isPosing) return;
  isPosing = true;
  try {
    while (wanted) {
      const patch = wanted, state = { ...store.values, ...patch };
      wanted = null;
      const camera = isOfFile(state.cameraName) ? await poseOf(state.cameraName, state) : null;
      const { scene, cameraName } = store.values;
      if (scene !== state.scene) return;
      posed = JSON.stringify(momentOf(state));
      store.set(camera && cameraName === state.cameraName ? { ...patch, camera } : patch);
    }
  } catch (error) {
    failed(error);
  } finally {
    isPosing = false;
  }
}

byId("scene").onchange = async ({ target }) => {
  if (!target.value) return;
  followed = missing = "";
  byId("notice").replaceChildren();
  store.set({ scene: target.value, camera: null, level: "", hidden: [], isolated: [], compare: "", time: "", animation: 0 });
  try { await chooseScene(null); } catch (error) { failed(error); }
};
byId("camera").onchange = async ({ target }) => {
  if (target.value === "") return;
  try { await chooseCamera(target.value); } catch (error) { failed(error); }
};
fillSelect(byId("view"), viewOptions(), store.values.view);
byId("view").onchange = ({ target }) => store.set({ view: target.value, range: "p99" });
byId("level").onchange = ({ target }) => store.set({ level: target.value });
// A camera of the file goes where the animation takes it, until somebody moves it.
store.on(TIME_KEYS, (state) => {
  const isPosed = posed === JSON.stringify(momentOf(state));
  posed = "";
  if (state.camera && !isPosed && isOfFile(state.cameraName)) chooseCamera(state.cameraName).catch(failed);
});
store.on(["cameraName"], ({ cameraName }) => { byId("camera").value = cameraName; });
store.on(["level"], ({ level }) => { byId("level").value = level; });
function showView({ view }) {
  byId("view").value = view;
  // Only counters have levels.
  byId("level-field").hidden = !viewOf(view).counter || Number(model.info?.levels ?? 1) < 2;
}
store.on(["view"], showView);
model.addEventListener("change", () => showView(store.values));

// ---- the daemon -------------------------------------------------------------------------------

function connection() {
  const { state } = daemon;
  byId("state").dataset.state = state;
  byId("state").textContent = { connecting: "Connecting", open: "Connected", lost: "The daemon is away: reconnecting" }[state];
  if (state !== "open") return;
  open();
  showSender();
}
daemon.addEventListener("state", connection);
// A login that has ended shows the form; a daemon that is away does not.
daemon.addEventListener("lost", () => whoAmI().then((sender) => { if (!sender) location.reload(); }, () => {}));
connection();

/** Shows as whom the page is connected, and the way out of its login. */
async function showSender() {
  try {
    const sender = await whoAmI();
    if (!sender) return;
    byId("state").title = `as ${sender.principal} (${sender.role})`;
    if (!sender.login || document.getElementById("log-out")) return;
    byId("tools").append(element("button", { type: "button", id: "log-out", title: `Log out ${sender.principal}`,
      onclick: async () => { await logOut(); location.reload(); } }, "Log out"));
  } catch {
    // The daemon is away again.
  }
}

function say(text, bad = false) {
  byId("message").replaceChildren(...breakable(text));
  byId("message").className = bad ? "bad" : "";
}

function failed(error) {
  if (["AbortError", "CONNECTION_LOST"].includes(error.name)) return;
  say(error.name === "Error" || error.name === "TypeError" ? error.message : `${error.message}`, true);
}

let toast = 0;
function inform(text) {
  byId("toast").textContent = text;
  clearTimeout(toast);
  toast = setTimeout(() => { byId("toast").textContent = ""; }, 2500);
}

// ---- tools and shortcuts ----------------------------------------------------------------------

const world = () => inWorld(store.values, model.origin);
const texts = () => [asCommand(world(), tracedSize()), asPython(world(), tracedSize())];

async function copy(text, what) {
  try {
    await navigator.clipboard.writeText(text);
    inform(`${what} copied`);
  } catch {
    showDialog(what, element("pre", { tabIndex: 0 }, text));
  }
}
const ready = (run) => () => { if (picture.image && model.info) run(); };
const switchTheme = startTheme(() => legend.draw());
/** The box of the scene at the moment that is shown. */
const boxNow = async () => (store.values.time === "" ? model.box
  : boxOf(await daemon.ask("Info", { scene: store.values.scene, ...momentOf(store.values) })));
const frameScene = ready(() => boxNow().then(({ low, high }) => showCamera(frameBox(store.values.camera, low, high)), failed));
const show = ready(() => showDialog("This view again", element("div", {}, element("h2", {}, "Command"), element("pre", { tabIndex: 0, id: "command" }, texts()[0]),
  element("h2", {}, "Python"), element("pre", { tabIndex: 0, id: "python" }, texts()[1]),
  compares(store.values) && !isHeatMap(viewOf(store.values.view), store.values) ? element("p", { className: "hint" }, "Both give the columns of one setting; the difference is left out.") : null),
  ...[["Copy as command", () => copy(texts()[0], "Command")], ["Copy as Python", () => copy(texts()[1], "Python")], ["Copy link", () => copy(location.href, "Link")],
      ["PNG", () => downloadPng(app)], ["Report", () => downloadReport(app, texts()).catch(failed)]]
    .map(([text, onclick]) => element("button", { type: "button", onclick }, text))));
const actions = [
  { key: "0", text: "Show the whole scene", run: frameScene },
  { key: "F", text: "Focus: look at what is selected", run: ready(app.actions.focus) },
  { key: "H", text: "Hide what is selected", run: ready(app.actions.hide) },
  { key: "I", text: "Isolate what is selected", run: ready(app.actions.isolate) },
  { key: "J", text: "Show all again", run: app.actions.showAll },
  { key: "L", text: "Logarithmic scale", run: () => store.set({ log: !store.values.log }) },
  { key: "P", text: "Perspective or orthographic", run: ready(() => showCamera({ ...store.values.camera,
      projection: store.values.camera.projection === "orthographic" ? "perspective" : "orthographic" })) },
  { key: "C", text: "This view as command, Python, link, PNG or report", run: show },
  { key: "T", text: "Light or dark", run: switchTheme },
  { key: "Escape", text: "Let go of the kept ray, selection and rectangle", run: () => { app.hover.unpin(); app.path?.clear(); app.selection.choose(null); clearRectangle(); } },
];
const help = startKeys(actions);
for (const [id, text, title, run] of [["share", "Share", "Copy as command, Python or link; PNG; report (C)", show],
  ["theme", "◐", "Light or dark (T)", switchTheme], ["help", "?", "Shortcuts (?)", help]]) {
  byId("tools").append(element("button", { type: "button", id, title, ariaLabel: text.length > 1 ? undefined : title, onclick: run }, text));
}

let written = location.hash;
store.on(Object.keys(store.values), (state) => {
  written = `#${toFragment(state)}`;
  clearTimeout(app.writing);
  // Browsers limit how often the address may change.
  app.writing = setTimeout(() => history.replaceState(null, "", written), 200);
});
addEventListener("hashchange", () => {
  if (location.hash !== written) location.reload();
});
keepView(store);
buildPanels(app, byId("tabs"), byId("panels"));
fit();
if (notLoggedIn) say(notLoggedIn, true);
globalThis.raynest = app;  // for the console, and for tests
