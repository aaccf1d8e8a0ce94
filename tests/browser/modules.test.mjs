// Modules of the page, alone in Node: their arithmetic, and answers that no daemon gives.
import assert from "node:assert/strict";
import { test } from "node:test";

const web = new URL("../../server/web/", import.meta.url);

test("percentiles are nearest ranks, as the daemon's", async () => {
  const { statistics } = await import(new URL("histogram.js", web));
  const { p50, p90, p99 } = statistics(Float32Array.from({ length: 150 }, (_, i) => i + 1));
  assert.deepEqual([p50, p90, p99], [75, 135, 149]);
});

test("what was not measured is a dash", async () => {
  const { measuredText } = await import(new URL("numbers.js", web));
  assert.deepEqual([null, undefined, 0, 0.12345].map((value) => measuredText(value, 3)), ["–", "–", "0", "0.123"]);
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
