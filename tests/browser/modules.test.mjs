// Modules of the page, alone in Node: their arithmetic, and answers that no daemon gives.
import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { test } from "node:test";

const web = new URL("../../server/web/", import.meta.url);

test("percentiles are nearest ranks, as the daemon's", async () => {
  const { statistics } = await import(new URL("histogram.js", web));
  const { p50, p90, p99 } = statistics(Float32Array.from({ length: 150 }, (_, i) => i + 1));
  assert.deepEqual([p50, p90, p99], [75, 135, 149]);
});

test("ranges of a heat map end where the daemon's do", async () => {
  const { rangeOf, statistics } = await import(new URL("histogram.js", web));
  const { cases } = JSON.parse(await readFile(new URL("../golden/heat_ranges.json", import.meta.url)));
  for (const { what, values, difference = false, ...ends } of cases) {
    const stats = statistics(Float32Array.from(values.flatMap(([value, pixels]) => Array(pixels).fill(value))));
    for (const setting of ["auto", "p99"])
      assert.deepEqual(rangeOf(setting, stats, difference), { low: difference ? -ends[setting] : 0, high: ends[setting] }, `${what}, ${setting}`);
  }
});

test("what was not measured is a dash", async () => {
  const { measuredText } = await import(new URL("numbers.js", web));
  assert.deepEqual([null, undefined, 0, 0.12345].map((value) => measuredText(value, 3)), ["–", "–", "0.000", "0.123"]);
});

test("numbers of a column have as many decimals each", async () => {
  const { fixedText } = await import(new URL("numbers.js", web));
  assert.deepEqual([31.2, 11, 9.78, 1234.5, 0.02, 0].map((value) => fixedText(value, 1)), ["31.2", "11.0", "9.8", "1,234.5", "<0.1", "0.0"]);
});

test("numbers of what is hidden stay with their scene", async () => {
  const { jobOf } = await import(new URL("requests.js", web));
  const state = { hidden: ["i3", "o1"], isolated: ["i4"], skipHiddenBoxes: true, time: "", scene: "a", intersector: "opaque",
                  mask: "FF", settings: {} };
  const lists = ["hidden_instances", "hidden_objects", "only_instances"];
  assert.deepEqual(lists.map((name) => jobOf(state)[name]), [[3], [1], [4]]);
  const other = jobOf(state, "scene:b");
  assert.equal(other.scene, "b");
  assert.deepEqual(lists.map((name) => other[name]), [undefined, undefined, undefined]);
});

test("ticks of a logarithmic scale are round, whatever the range begins with", async () => {
  const { ticks } = await import(new URL("histogram.js", web));
  assert.deepEqual(ticks({ low: 1.4659, high: 40, log: true }, 9), [1.4659, 3, 10, 30]);
  assert.deepEqual(ticks({ low: 0, high: 100, log: true }, 9), [0, 1, 3, 10, 30, 100]);
  assert.ok(ticks({ low: 0, high: 0.5, log: true }, 5).length > 2, "below 1, too");
});

test("a camera far from zero can come back from where it went near", async () => {
  const { distance, dolly, rounded } = await import(new URL("camera.js", web));
  let camera = { eye: [563.5, 10, 20], at: [563.5, 10, 0], up: [0, 1, 0], fov: 45 };
  for (let i = 0; i < 400; ++i) camera = rounded(dolly(camera, 0.9));
  for (let i = 0; i < 400; ++i) camera = rounded(dolly(camera, 1.1));
  assert.ok(distance(camera) > 20, String(distance(camera)));
});

test("what the rays of a camera look at has no digits of noise", async () => {
  const { cameraOfRays } = await import(new URL("camera.js", web));
  const at = [-2.6e-8, 5.3e-8, 0], eye = [3, 4, 5], ahead = eye.map((x, i) => at[i] - x);
  const right = [0.005, 0, -0.003], up = [-0.002, 0.005, -0.003];
  const turned = (s, t) => ahead.map((x, i) => x + s * right[i] + t * up[i]);
  const rays = { origin: [eye, eye, eye, eye].flat(), direction: [turned(-1, 1), turned(1, 1), turned(-1, -1), turned(1, -1)].flat() };
  for (const x of cameraOfRays(rays, { center: [0, 0, 0], radius: 2 }).at) assert.ok(x === 0 || Math.abs(x) > 1e-6, String(x));
});

test("a camera is followed by its name, and edits are counted", async () => {
  const { changesText, sameCamera } = await import(new URL("follow.js", web));
  const before = { cameras: ["front", "top"], epoch: 1, hash: "1" };
  assert.equal(sameCamera("1", before, { cameras: ["top"] }), "0");
  assert.equal(sameCamera("1", { cameras: ["", ""] }, { cameras: [""] }), "");
  // A scene that has cameras now is seen by its own, not from where everything is seen.
  assert.equal(sameCamera("automatic", {}, { cameras: ["front"] }), "");
  assert.equal(sameCamera("automatic", {}, {}), "automatic");
  const after = { ...before, hash: "2", refits: 1, last_edit: "1 instance moved" };
  assert.equal(changesText(before, { ...after, epoch: 2 }), "1 instance moved");
  assert.equal(changesText(before, { ...after, epoch: 3 }), "2 edits, the last one 1 instance moved");
});

test("a request names the moment that is shown", async () => {
  const { momentOf } = await import(new URL("requests.js", web));
  assert.deepEqual(momentOf({ time: 0.5, animation: 1 }), { timed: true, time: 0.5, animation: "1" });
  assert.deepEqual(momentOf({ time: "", animation: 1 }), {});
});

test("an animation is followed by its name", async () => {
  const { changesText, sameAnimation } = await import(new URL("follow.js", web));
  const before = { animations: ["walk", "run"], hash: "1" };
  assert.equal(sameAnimation(1, before, { animations: ["run"] }), 0);
  assert.equal(sameAnimation(1, before, { animations: ["walk"] }), null);
  assert.equal(sameAnimation(1, { animations: ["", ""] }, { animations: ["", "", ""] }), 1);
  assert.equal(sameAnimation(0, before, {}), null);
  assert.equal(changesText(before, { animations: ["run", "jump"], hash: "2" }), "animations gone: walk; new animations: jump");
});

test("Python that is copied says what a heat map is compared with, and its colours", async () => {
  const { asPython } = await import(new URL("commands.js", web));
  const { DEFAULTS } = await import(new URL("store.js", web));
  const state = { ...DEFAULTS, scene: "a", camera: { eye: [0, 0, 5], at: [0, 0, 0], up: [0, 1, 0], fov: 45, projection: "perspective" } };
  assert.doesNotMatch(asPython(state, [8, 8]), /diff|palette|scale/);
  for (const [compare, diff] of [["mask:1", '{"mask": 0x1}'], ["scene:b", 'client.scene("b")'], ["intersector:opaque", '{"intersector": "opaque"}'],
    ["set:cutoff=0.9", '{"params": {"cutoff":"0.9"}}']]) assert.ok(asPython({ ...state, compare }, [8, 8]).includes(`diff=${diff})`), compare);
  // A range of a difference is as long on both sides, as the daemon wants it.
  assert.ok(asPython({ ...state, compare: "mask:1", range: [1, 20] }, [8, 8]).includes("range=(-20, 20)"));
  const coloured = asPython({ ...state, palette: "viridis", log: true }, [8, 8]);
  assert.ok(coloured.includes('palette="viridis"') && coloured.includes('scale="log"'), coloured);
});

test("a command that is copied has the options that its integrator reads, and no others", async () => {
  const { asCommand } = await import(new URL("commands.js", web));
  const { DEFAULTS } = await import(new URL("store.js", web));
  const { INTEGRATORS } = await import(new URL("lists.js", web));
  const state = { ...DEFAULTS, scene: "a", view: "lit", depth: 3, aoDistance: 2, env: "sky", sun: "130,35",
                  camera: { eye: [0, 0, 5], at: [0, 0, 0], up: [0, 1, 0], fov: 45, projection: "perspective" } };
  const options = { depth: "--depth", ao_distance: "--ao-distance", environment: "--env", sun: "--sun" };
  for (const [integrator, { settings }] of Object.entries(INTEGRATORS)) {
    const words = asCommand({ ...state, integrator }, [8, 8]).split(" ");
    for (const [setting, option] of Object.entries(options))
      assert.equal(words.some((word) => word.split("=")[0] === option), settings.includes(setting), `${integrator} ${option}`);
  }
});

test("a column outside its frame is refused", async () => {
  const { decodeFrame } = await import(new URL("frames.js", web));
  const frame = (block) => {
    const json = new TextEncoder().encode(JSON.stringify({ blocks: [{ name: "t", dtype: "f32", offset: 0, bytes: 8, ...block }] }));
    const buffer = new ArrayBuffer(32 + json.length + 8), view = new DataView(buffer);
    new Uint8Array(buffer).set(new TextEncoder().encode("RYN1"));
    view.setUint16(4, 153, true);
    view.setUint32(8, json.length, true);
    view.setBigUint64(16, 8n, true);
    new Uint8Array(buffer).set(json, 32);
    return decodeFrame(buffer);
  };
  assert.equal(frame({}).columns.t.length, 2);
  for (const block of [{ bytes: 12 }, { offset: 4 }, { offset: -4 }, { bytes: -4 }, { bytes: 6 }, { dtype: "f128" }, { offset: 1e9, bytes: 4 }])
    assert.throws(() => frame(block), /lies outside its frame/, JSON.stringify(block));
});
