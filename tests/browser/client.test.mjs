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

test("the program of the README runs in Node", async () => {
  const [, program] = /```js\n([\s\S]*?)```/.exec(readFileSync(new URL("README.md", web), "utf8"));
  assert.ok(program.trim().split("\n").length <= 22, "it is short");
  const file = join(daemon.folder, "program.mjs");
  writeFileSync(file, program.replaceAll("127.0.0.1:31061", new URL(daemon.http).host).replace("./raynest.js", new URL("raynest.js", web).href));
  const flags = Number(process.versions.node.split(".")[0]) < 22 ? ["--experimental-websocket"] : [];
  const { stdout } = await promisify(execFile)(process.execPath, [...flags, file], { timeout: 60000 });
  const lines = stdout.trim().split("\n");
  assert.equal(lines[0], "open");
  const [, hits, rays, most] = /^(\d+) of (\d+) rays hit; the most expensive one tests (\d+) boxes and primitives$/.exec(lines[1]).map(Number);
  const told = await daemon.json("heatmap", "forest", "--size", "320x180", "-o", join(daemon.folder, "forest.npy"));
  assert.deepEqual([rays, hits, most], [told.rays, told.hits, told.max]);
  assert.match(lines[2], /^a ray of my own: t \d/);
  assert.equal(lines[3], "true SCENE_UNKNOWN");
});
