// The setting of every browser test: a daemon with scenes, a Chromium, and a page that is open.
//
//   node picture.test.mjs RAYNESTD RAYNEST MODULES
//
// MODULES is the folder in which npm installed playwright-core and axe-core. The exit code is 77 (skipped)
// where they, Chromium or WebGL2 are absent. A test that fails runs once more: a busy machine is no bug.
import { execFile, spawn } from "node:child_process";
import { existsSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { after, test } from "node:test";
import { promisify } from "node:util";

const run = promisify(execFile);
export const [raynestd, raynest, modules] = process.argv.slice(2).map((path) => resolve(path));
const PATIENCE_MS = 1000 * Number(process.env.RAYNEST_PATIENCE ?? 30);
const WINDOW = { width: 1280, height: 800 };
const FLAGS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox", "--disable-dev-shm-usage"];
const installed = createRequire(join(modules ?? ".", "package.json"));

function skip(why) {
  console.log(`skipped: ${why}`);
  process.exit(77);
}

/** Waits until `condition` returns or resolves to a true value, and returns that. */
export async function until(condition, what) {
  for (const end = Date.now() + PATIENCE_MS; ;) {
    const answer = await condition();
    if (answer) return answer;
    if (Date.now() > end) throw new Error(`it did not come true: ${what ?? condition}`);
    await new Promise((resolve) => setTimeout(resolve, 20));
  }
}

/** A daemon with a page, in a folder of its own. */
export class TestDaemon {
  #arguments;
  folder = mkdtempSync(join(tmpdir(), "raynest-browser-"));
  http = "127.0.0.1:0";
  listen = "tcp://127.0.0.1:0";

  constructor(...args) { this.#arguments = args; }

  async start() {
    const ready = join(this.folder, "ready.json");
    rmSync(ready, { force: true });
    this.process = spawn(raynestd, ["--listen", this.listen, "--http", this.http, "--cuda", "off", "--log-level", "warn",
      "--ready-file", ready, ...this.#arguments], { stdio: ["ignore", "ignore", "inherit"] });
    await until(() => existsSync(ready) || this.process.exitCode !== null, "the daemon starts");
    const { listen, http } = JSON.parse(readFileSync(ready, "utf8"));
    [this.listen] = listen;
    this.page = http;
    this.http = http;
  }

  async stop() {
    if (this.process.exitCode === null && this.process.signalCode === null) {
      const ended = new Promise((resolve) => this.process.once("exit", resolve));
      this.process.kill("SIGKILL");
      await ended;
    }
  }

  /** Stops the daemon for good. */
  async end() {
    await this.stop();
    rmSync(this.folder, { recursive: true, force: true });
  }

  /** Runs the command line and returns its JSON, one value per line. */
  async jsonLines(...args) {
    const { stdout } = await run(raynest, ["--server", this.listen, "--json", ...args], { maxBuffer: 1 << 28 });
    return stdout.trim().split("\n").map((line) => JSON.parse(line));
  }
  async json(...args) { return (await this.jsonLines(...args))[0]; }

  /** Loads a scene of triangles; see gltf(). */
  async loadMeshes(name, meshes, ...options) {
    const file = join(this.folder, `${name}.gltf`);
    writeFileSync(file, gltf(meshes));
    await this.json("load", file, "--name", name, ...options);
  }
}

/** Returns glTF of `meshes`: {name, node, points: [[x, y, z], …] (three for each triangle), colour, at}. */
export function gltf(meshes) {
  const floats = meshes.map(({ points }) => new Float32Array(points.flat()));
  const bytes = floats.map((values) => Buffer.from(values.buffer));
  let offset = 0;
  const bounds = (points, pick) => [0, 1, 2].map((axis) => pick(...points.map((point) => point[axis])));
  return JSON.stringify({
    asset: { version: "2.0" }, scene: 0, scenes: [{ nodes: meshes.map((_, i) => i) }],
    nodes: meshes.map(({ node, at = [0, 0, 0] }, i) => ({ name: node ?? `node-${i}`, mesh: i, translation: at })),
    meshes: meshes.map(({ name }, i) => ({ name, primitives: [{ attributes: { POSITION: i }, material: i }] })),
    materials: meshes.map(({ name, colour = [1, 1, 1, 1] }) => ({ name, doubleSided: true, alphaMode: colour[3] < 1 ? "BLEND" : "OPAQUE", pbrMetallicRoughness: { baseColorFactor: colour } })),
    accessors: meshes.map(({ points }, i) => ({ bufferView: i, componentType: 5126, count: points.length, type: "VEC3",
      min: bounds(points, Math.min), max: bounds(points, Math.max) })),
    bufferViews: bytes.map(({ length }) => ({ buffer: 0, byteLength: length, byteOffset: (offset += length) - length })),
    buffers: [{ byteLength: offset, uri: `data:application/octet-stream;base64,${Buffer.concat(bytes).toString("base64")}` }],
  });
}

async function launch() {
  if (!modules || !existsSync(modules)) skip(`${modules ?? "MODULES"} is absent: bash tests/run.sh --browser installs it`);
  const program = ["/usr/bin/chromium", "/usr/bin/google-chrome"].find(existsSync);
  if (!program) skip("no Chromium: bash tests/run.sh --browser installs it");
  const started = await installed("playwright-core").chromium.launch({ executablePath: program, args: FLAGS });
  const page = await started.newPage();
  const capable = await page.evaluate(() => Boolean(document.createElement("canvas").getContext("webgl2")));
  await page.close();
  if (!capable) {
    await started.close();
    skip("this Chromium has no WebGL2");
  }
  return started;
}
export const browser = await launch();
after(() => browser.close());

/** Returns a daemon that starts before the tests of a file and ends after them. */
export async function daemonWith(...sources) {
  const daemon = new TestDaemon();
  after(() => daemon.end());
  await daemon.start();
  for (const source of sources) await daemon.json("load", source);
  return daemon;
}

/** A test with a page of its own. It fails on an error of the page that it did not expect. */
export function browserTest(name, body) {
  test(name, async () => {
    try {
      await attempt(body);
    } catch (error) {
      console.log(`once more, because: ${error.message}`);
      await attempt(body);
    }
  });
}

async function attempt(body) {
  const context = await browser.newContext({ viewport: WINDOW, acceptDownloads: true, colorScheme: "light",
    ignoreHTTPSErrors: true });
  context.setDefaultTimeout(PATIENCE_MS);
  const errors = [];
  const watch = (page) => {
    page.on("pageerror", (error) => errors.push(error.message));
    page.on("console", (message) => {
      if (message.type() === "error" && !/ERR_CONNECTION_REFUSED|WebSocket connection/.test(message.text())) errors.push(message.text());
    });
  };
  context.on("page", watch);
  try {
    const open = async (daemon, view = {}) => {
      const page = await context.newPage();
      await page.goto(`${daemon.page}#${new URLSearchParams(view)}`);
      return page;
    };
    await body({ open, context, errors });
    if (errors.length) throw new Error(`the page reports: ${errors.join("; ")}`);
  } finally {
    await context.close();
  }
}

/** Waits for the fine picture of what the page shows now. */
export const fine = (page) => page.waitForFunction(() => {
  const { picture, daemon } = globalThis.raynest ?? {};
  return picture?.current && daemon.pending === 0 && document.getElementById("frame").dataset.shown === "fine";
});

/** Returns [r, g, b] of a pixel of the drawn picture, from its top left corner. */
export const pixel = (page, x, y) => page.evaluate(([px, py]) => {
  const canvas = document.getElementById("picture"), gl = canvas.getContext("webgl2");
  const bytes = new Uint8Array(4);
  gl.readPixels(px, canvas.height - 1 - py, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
  return [...bytes.subarray(0, 3)];
}, [x, y]);

/** Returns where a pixel of the picture lies in the window. */
export const windowPoint = (page, x, y) => page.evaluate(([px, py]) => {
  const canvas = document.getElementById("picture"), box = canvas.getBoundingClientRect();
  return [box.left + ((px + 0.5) * box.width) / canvas.width, box.top + ((py + 0.5) * box.height) / canvas.height];
}, [x, y]);

/** Counts into `sent` of the page what it asks the daemon, besides whether scenes are still the same: messages Info and Scenes. */
export const countSent = (page) => page.evaluate(() => {
  globalThis.sent = 0;
  const { send } = WebSocket.prototype;
  WebSocket.prototype.send = function count(data) { if (!/^(Info|Scenes) /.test(String(data))) ++globalThis.sent; send.call(this, data); };
});

export const axePath = () => installed.resolve("axe-core/axe.min.js");
