// What the page waits for in Chromium: the time to the first coarse picture, pictures per second while orbiting, and how
// soon it shows a scene that was replaced. It prints figures and judges none of them: a busy machine is slow.
// RAYNEST_MOTION_S is the time of motion (default 30).
//
//   node figures.mjs build/bin/raynestd build/bin/raynest build/browser
import assert from "node:assert/strict";
import { browserTest, daemonWith, fine, windowPoint } from "../../browser/harness.mjs";

const MOTION_S = Number(process.env.RAYNEST_MOTION_S ?? 30);
const daemon = await daemonWith("builtin:forest");

browserTest("the first coarse picture comes early", async ({ open }) => {
  const page = await open(daemon, { scene: "forest", size: "960x540" });
  await fine(page);
  const measured = [];
  for (let i = 0; i < 5; ++i) {
    measured.push(await page.evaluate(async () => {
      const { picture } = globalThis.raynest, begun = performance.now();
      let coarse = 0;
      await new Promise((resolve) => {
        picture.addEventListener("image", function seen() {
          coarse ||= performance.now() - begun;
          if (!picture.image.complete) return;
          picture.removeEventListener("image", seen);
          resolve();
        });
        picture.restart();
      });
      return { coarse, full: picture.image.ms };
    }));
  }
  const ratios = measured.map(({ coarse, full }) => coarse / (full / 10 + 30)).sort((a, b) => a - b);
  console.log(`first coarse picture over (full / 10 + 30 ms): ${ratios.map((ratio) => ratio.toFixed(2)).join(" ")}; full ${measured[2].full.toFixed(0)} ms`);
});

browserTest("pictures per second while orbiting", async ({ open }) => {
  const page = await open(daemon, { scene: "forest", size: "960x540" });
  await fine(page);
  const [x, y] = await windowPoint(page, 480, 270);
  await page.evaluate(() => {
    globalThis.frames = [];
    const { picture } = globalThis.raynest;
    picture.addEventListener("image", () => globalThis.frames.push([performance.now(), picture.image.width * picture.image.height]));
  });
  await page.mouse.move(x, y);
  await page.mouse.down();
  for (let i = 0, end = Date.now() + 1000 * MOTION_S; Date.now() < end; ++i) {
    await page.mouse.move(x + 150 * Math.sin(i / 20), y + 40 * Math.sin(i / 31));
    await page.waitForTimeout(i % 200 === 199 ? 400 : 15);
  }
  await page.mouse.up();
  const rate = await page.evaluate(() => {
    const { frames } = globalThis, seconds = (frames.at(-1)[0] - frames[0][0]) / 1000;
    return { fps: frames.length / seconds, least: Math.min(...frames.map(([, rays]) => rays)) };
  });
  console.log(`${MOTION_S} s of orbiting: ${rate.fps.toFixed(1)} pictures per second of at least ${rate.least} rays`);
  assert.ok(rate.least >= 160 * 90, "coarse pictures show something");
});

browserTest("a replaced scene is shown", async ({ open }) => {
  const card = (size) => [{ name: "card", node: "card", points: [[-size, -1, 0], [size, -1, 0], [0, 1, 0]] }];
  await daemon.loadMeshes("replaced", card(1));
  const page = await open(daemon, { scene: "replaced", size: "960x540" });
  await fine(page);
  const seconds = [];
  for (let i = 2; i < 12; ++i) {
    const version = await page.evaluate(() => globalThis.raynest.model.version);
    await daemon.loadMeshes("replaced", card(i), "--replace");
    const begun = performance.now();
    await page.waitForFunction((before) => globalThis.raynest.model.version !== before, version);
    await fine(page);
    seconds.push((performance.now() - begun) / 1000);
  }
  seconds.sort((a, b) => a - b);
  console.log(`a replaced scene over 2 s, until its whole picture is shown: median ${(seconds[5] / 2).toFixed(2)}, most ${(seconds.at(-1) / 2).toFixed(2)}`);
});
