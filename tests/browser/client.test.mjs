// The module that talks to the daemon, alone in Node: the program of server/web/README.md runs as it stands there.
import assert from "node:assert/strict";
import { execFile } from "node:child_process";
import { readFileSync, writeFileSync } from "node:fs";
import { test } from "node:test";
import { promisify } from "node:util";
import { join } from "node:path";
import { daemonWith } from "./harness.mjs";

const daemon = await daemonWith();
const web = new URL("../../server/web/", import.meta.url);

/** Runs a program in a Node of its own, with these modules of the client beside it; returns what it prints. */
async function printed(program) {
  const file = join(daemon.folder, "program.mjs");
  writeFileSync(file, program.replaceAll("127.0.0.1:31061", new URL(daemon.http).host).replace(/"\.\/(\w+\.js)"/g, (_, name) => `"${new URL(name, web).href}"`));
  const flags = Number(process.versions.node.split(".")[0]) < 22 ? ["--experimental-websocket"] : [];
  return (await promisify(execFile)(process.execPath, [...flags, file], { timeout: 60000 })).stdout;
}

test("the program of the README runs in Node", async () => {
  const [, program] = /```js\n([\s\S]*?)```/.exec(readFileSync(new URL("README.md", web), "utf8"));
  assert.ok(program.trim().split("\n").length <= 22, "it is short");
  const lines = (await printed(program)).trim().split("\n");
  assert.equal(lines[0], "open");
  const [, hits, rays, most] = /^(\d+) of (\d+) rays hit; the most expensive one tests (\d+) boxes and primitives$/.exec(lines[1]).map(Number);
  const told = await daemon.json("heatmap", "forest", "--size", "320x180", "-o", join(daemon.folder, "forest.npy"));
  assert.deepEqual([rays, hits, most], [told.rays, told.hits, told.max]);
  assert.match(lines[2], /^a ray of my own: t \d/);
  assert.equal(lines[3], "true SCENE_UNKNOWN");
});

test("parts of rays and tiles of pictures have the bytes of the whole", async () => {
  await printed(`import assert from "node:assert/strict";
import { Daemon, part, tile } from "./raynest.js";
import { traceQuery, traceRender } from "./tracer.js";
const client = new Daemon("ws://127.0.0.1:31061/v1/stream", { headers: { origin: "http://127.0.0.1:31061" } });
await client.ready();
const { info } = await client.ask("Load", { name: "woods", source: "builtin:forest?trees=20" });
const width = 64, height = 48, all = width * height, job = { scene: info.name };
const query = { job, fields: ["t", "direction"], generator: { kind: "camera", settings: ["size=64x48"] } };
const { columns } = await traceQuery(client, query, all);
assert.ok(columns.t.some(Number.isFinite));
for (const [first, count] of [[0, 1000], [1000, 2072]]) {
  const { columns: some, done } = await traceQuery(client, { ...query, ...part(first, count) }, count);
  assert.equal(Number(done.rays), count);
  assert.deepEqual(some.t, columns.t.slice(first, first + count));
  assert.deepEqual(some.direction, columns.direction.slice(3 * first, 3 * (first + count)));
}
const [x, y, wide, high] = [8, 16, 32, 8], picture = { job, width, height, integrator: "primary" };
const { columns: { rgba } } = await traceRender(client, picture, all);
assert.ok(new Set(rgba).size > 9);
const { columns: piece } = await traceRender(client, { ...picture, ...tile(x, y, wide, high) }, wide * high);
for (let row = 0; row < high; ++row)
  assert.deepEqual(piece.rgba.slice(4 * row * wide, 4 * (row + 1) * wide), rgba.slice(4 * ((y + row) * width + x), 4 * ((y + row) * width + x + wide)));
client.close();
`);
});
