// Pictures: their pixels, palette, legend and histogram, and that changing those asks the daemon for nothing.
import assert from "node:assert/strict";
import { readdirSync } from "node:fs";
import { browserTest, countSent, daemonWith, fine, pixel, until, windowPoint } from "./harness.mjs";
import { differences, runCommand } from "./images.mjs";

const SQUARES = { camera: "0,0,4,0,0,0,0,1,0,45", size: "320x180" };
const daemon = await daemonWith("builtin:forest");
const square = (x, z) => [[x, -1, z], [x + 1, -1, z], [x + 1, 1, z], [x, -1, z], [x + 1, 1, z], [x, 1, z]];
await daemon.loadMeshes("squares", [{ name: "left", points: square(-1, 0), colour: [1, 0, 0, 1] },
                                    { name: "right", points: square(0, 1), colour: [0, 0, 1, 1] }]);

browserTest("colours and depths of two squares", async ({ open }) => {
  const page = await open(daemon, { ...SQUARES, scene: "squares", view: "picture" });
  await fine(page);
  const [left, right, sky] = [await pixel(page, 130, 90), await pixel(page, 190, 90), await pixel(page, 5, 5)];
  assert.ok(left[0] > 150 && left[1] < 60 && left[2] < 60, `red, not ${left}`);
  assert.ok(right[2] > 150 && right[0] < 60 && right[1] < 60, `blue, not ${right}`);
  assert.notDeepEqual(sky, left);

  // Depths 4 and 3 are the ends of the range: the last and the first colour of turbo.
  await page.selectOption("#view", "depth");
  await fine(page);
  const depths = await page.evaluate(() => {
    const { width, values } = globalThis.raynest.picture.image;
    return [130, 190, 5].map((x) => values[90 * width + x]);
  });
  assert.ok(depths[0] >= 4 && depths[0] < 4.3 && depths[1] >= 3 && depths[1] < 3.3 && Number.isNaN(depths[2]), String(depths));
  await page.fill("#range-low", "3.5");
  await page.fill("#range-high", "3.6");
  await page.press("#range-high", "Enter");
  await page.waitForFunction(() => location.hash.includes("range=3.5,3.6"));
  assert.deepEqual(await pixel(page, 130, 90), [122, 4, 3]);
  assert.deepEqual(await pixel(page, 190, 90), [48, 18, 59]);
});

browserTest("a heat map has the pixels of the command line's", async ({ open }) => {
  for (const view of [{}, { palette: "viridis", range: "50,400", log: "1" }, { view: "instances", palette: "inferno", range: "auto" }]) {
    const page = await open(daemon, { scene: "forest", size: "320x180", ...view });
    await fine(page);
    const different = await page.evaluate(differences, await runCommand(page, daemon));
    assert.equal(different, "");
    await page.close();
  }
});

browserTest("palette, range, scale and opacity send nothing", async ({ open }) => {
  const page = await open(daemon, { scene: "forest", size: "320x180" });
  const sent = [];
  // Chromium may fetch the icon again when the address changes; it is no request of the page.
  page.on("request", (request) => { if (!request.url().endsWith("/icon.svg")) sent.push(request.url()); });
  await fine(page);
  await countSent(page);
  sent.length = 0;
  const before = await pixel(page, 160, 90);
  const seen = new Set([String(before)]);
  for (const change of [() => page.selectOption("#palette", "gray"), () => page.click("#log"), () => page.click("#range-auto"),
                        () => page.fill("#opacity", "0.5"), () => page.fill("#range-high", "100").then(() => page.press("#range-high", "Enter"))]) {
    await change();
    await until(async () => !seen.has(String(await pixel(page, 160, 90))), "the change is seen");
    seen.add(String(await pixel(page, 160, 90)));
  }
  assert.equal(seen.size, 6, "every change is seen");
  // The new ETag of the address is no request either.
  assert.deepEqual([sent, await page.evaluate(() => globalThis.sent)], [[], 0]);
  // The counter does count.
  await page.selectOption("#view", "prims");
  await fine(page);
  assert.ok(await page.evaluate(() => globalThis.sent) > 0);
});

browserTest("measured time is a view: a heat map of the daemon's, as the command that it is copied as", async ({ open }) => {
  const page = await open(daemon, { scene: "forest", size: "160x90", view: "time", level: "1" });
  const shown = async () => {
    await fine(page);
    return page.evaluate(() => {
      const { values, done, columns, base } = globalThis.raynest.picture.image;
      return { values: [...values], metric: done.heat.metric, notes: done.notes, normals: columns.ng.length, base: base[3] };
    });
  };
  const { values, metric, notes, normals, base } = await shown();
  assert.deepEqual([metric, normals, base], ["time", 3 * values.length, 255]);
  assert.ok(values.every((value) => Number.isInteger(value) && value >= 0) && values.filter((value) => value > 0).length > values.length / 2);
  assert.match(notes.join(), /median of 5 runs/);
  await page.click("#share");
  const texts = [await page.textContent("#command"), await page.textContent("#python")];
  await page.keyboard.press("Escape");
  assert.match(texts[0], /^raynest heatmap forest .*--metric time /);
  assert.match(texts[1], /scene\.heatmap\([^]*metric="time"/);
  // A difference is below 0 somewhere.
  await page.selectOption("#compare", "intersector:opaque");
  const { values: change } = await shown();
  assert.ok(change.some((value) => value < 0) && change.every((value) => Math.abs(value) < 2 ** 30));
  await page.selectOption("#compare", "");
  await page.selectOption("#view", "time_noise");
  assert.equal((await shown()).metric, "time_noise");
  // An orthographic camera has none, and says nothing.
  await page.focus("#frame");
  await page.keyboard.press("p");
  await fine(page);
  assert.ok(await page.evaluate(() => globalThis.raynest.picture.image.values.every(Number.isNaN)));
});

browserTest("a difference has its own palette, and says so", async ({ open }) => {
  const page = await open(daemon, { scene: "forest", size: "320x180", palette: "viridis" });
  await fine(page);
  assert.equal(await page.inputValue("#palette"), "viridis");
  await page.selectOption("#compare", "intersector:opaque");
  await fine(page);
  assert.equal(await page.inputValue("#palette"), "diverging");
  assert.ok(await page.isDisabled("#palette") && await page.isDisabled("#log"));
  await page.selectOption("#compare", "");
  await fine(page);
  assert.equal(await page.inputValue("#palette"), "viridis");
  assert.ok(await page.isEnabled("#palette"));
});

browserTest("statistics are those of the command line, and dragging on the histogram sets the range", async ({ open }) => {
  const page = await open(daemon, { scene: "forest", size: "320x180" });
  await fine(page);
  const { max, p99, mean } = await daemon.json("heatmap", "forest", "--size", "320x180",
    "-o", `${daemon.folder}/forest.png`);
  const shown = await page.evaluate(() => globalThis.raynest.legend.statistics);
  assert.deepEqual([shown.max, shown.p99], [max, p99]);
  assert.ok(Math.abs(shown.mean - mean) < 1e-3 * mean, `${shown.mean} and ${mean}`);
  assert.equal(Number(await page.inputValue("#range-high")), p99);

  const box = await page.locator("#legend canvas").boundingBox();
  await page.mouse.move(box.x + 0.25 * box.width, box.y + 20);
  await page.mouse.down();
  await page.mouse.move(box.x + 0.5 * box.width, box.y + 20, { steps: 4 });
  await page.mouse.up();
  const [low, high] = await page.evaluate(() => globalThis.raynest.store.values.range);
  assert.ok(Math.abs(low - 0.25 * max) < 0.01 * max && Math.abs(high - 0.5 * max) < 0.01 * max, `${low} to ${high} of ${max}`);
  await page.dblclick("#legend canvas");
  assert.equal(await page.evaluate(() => globalThis.raynest.store.values.range), "p99");
});

browserTest("coarse first, then fine, at most 1.1 times the rays", async ({ open }) => {
  const page = await open(daemon, { scene: "forest", size: "960x540" });
  await fine(page);
  const counts = await page.evaluate(() => globalThis.raynest.picture.counts);
  assert.deepEqual([counts.coarse, counts.fine, counts.cancelled], [1, 1, 0]);
  assert.ok(counts.rays <= 1.1 * 960 * 540 && counts.rays > 960 * 540, String(counts.rays));
});

browserTest("moving the camera cancels the fine picture and leaves nothing behind", async ({ open }) => {
  const page = await open(daemon, { scene: "forest", size: "960x540" });
  await fine(page);
  const descriptors = () => readdirSync(`/proc/${daemon.process.pid}/fd`).length, files = descriptors();
  const [x, y] = await windowPoint(page, 480, 270);
  await page.mouse.move(x, y);
  await page.mouse.down();
  for (let i = 1; i <= 40; ++i) {
    await page.mouse.move(x + 4 * i, y);
    await page.waitForTimeout(i % 10 === 0 ? 250 : 10);  // pauses in which a fine picture begins
  }
  await page.mouse.up();
  await fine(page);
  const { counts, pending } = await page.evaluate(() => ({ counts: globalThis.raynest.picture.counts, pending: globalThis.raynest.daemon.pending }));
  assert.ok(counts.cancelled >= 1 && counts.coarse > 3, JSON.stringify(counts));
  assert.equal(pending, 0);
  const { jobs_started: started, jobs_ended: ended, connections_accepted: accepted } = await daemon.json("stats");
  assert.equal(started, ended);
  const { connections_accepted: later } = await daemon.json("stats");
  assert.equal(later - accepted, 1, "only the command line connected");
  await until(() => descriptors() <= files + 1, "no socket is left over");
  await page.close();
  await until(async () => (await daemon.json("stats")).connections_open <= 1, "its connection ends with the page");
});
