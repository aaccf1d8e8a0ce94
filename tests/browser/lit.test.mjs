// The lit view: its pixels are those of `raynest render`, it refines while the camera rests, and a click shows the path of light.
import assert from "node:assert/strict";
import { browserTest, countSent, daemonWith, fine, until, windowPoint } from "./harness.mjs";
import { differences, runCommand } from "./images.mjs";

const daemon = await daemonWith("builtin:forest?trees=40");
const VIEW = { scene: "forest", view: "lit", size: "160x90", camera: "0.5,2,13,0,3,0,0,1,0,50" };
const app = (page, run, argument) => page.evaluate(`(${run})(globalThis.raynest, ${JSON.stringify(argument ?? null)})`);

browserTest("after all samples the pixels are the command line's", async ({ open }) => {
  for (const light of [{ samples: "4" }, { integrator: "direct", samples: "3", seed: "7", sun: "200,30", env: "sky", tonemap: "aces", exposure: "-1.5" },
                       { integrator: "ao", samples: "2", aoDistance: "2" }, { samples: "2", depth: "2", tonemap: "reinhard" }]) {
    const page = await open(daemon, { ...VIEW, ...light });
    await fine(page);
    assert.equal(await app(page, ({ picture }) => picture.image.samples), Number(light.samples));
    assert.equal(await page.evaluate(differences, await runCommand(page, daemon)), "", JSON.stringify(light));
    await page.close();
  }
});

browserTest("the panel has the settings that the integrator reads, and no others", async ({ open }) => {
  const page = await open(daemon, { ...VIEW, samples: "1" });
  for (const [integrator, expected] of [["ao", ["ao-distance"]], ["direct", ["environment", "sun"]], ["path", ["environment", "sun", "depth"]]]) {
    await page.selectOption("#integrator", integrator);
    const shown = await page.evaluate(() => ["environment", "sun", "depth", "ao-distance"].filter((id) => document.getElementById(id).checkVisibility()));
    assert.deepEqual(shown, expected, integrator);
  }
});

browserTest("it refines while the camera rests: noise falls, and a move cancels", async ({ open }) => {
  const page = await open(daemon, { ...VIEW, samples: "1" });
  await fine(page);
  // Every picture that is shown from here on; the number of samples changes after the listener stands.
  await page.evaluate(() => {
    const { picture } = globalThis.raynest;
    globalThis.seen = [];
    picture.addEventListener("image", () => {
      const { fine: isFine, samples, width, linear, complete, wanted } = picture.image;
      if (linear && linear !== globalThis.seen.at(-1)?.linear) globalThis.seen.push({ fine: isFine, samples, width, linear, wanted: wanted.light.samples });
      if (complete && globalThis.seen.length) globalThis.seen.at(-1).complete = true;
    });
  });
  await page.selectOption("#samples", "64");
  const told = await page.waitForFunction(() => {
    const { seen } = globalThis, last = seen.at(-1);
    if (!last?.complete) return null;
    const error = (linear) => Math.sqrt(linear.reduce((sum, x, i) => sum + (i % 4 === 3 ? 0 : (x - last.linear[i]) ** 2), 0) / linear.length);
    return seen.map(({ fine: isFine, samples, width, linear }) => ({ fine: isFine, samples, width, error: linear.length === last.linear.length ? error(linear) : null }));
  }).then((handle) => handle.jsonValue());
  assert.deepEqual([told[0].fine, told[0].width], [false, 40], "coarse first");
  const passes = told.filter(({ fine: isFine }) => isFine);
  assert.deepEqual(passes.map(({ samples }) => samples), [1, 2, 4, 8, 16, 32, 64]);
  const errors = passes.slice(0, 6).map(({ error }) => error);
  for (let i = 1; i < errors.length; ++i) assert.ok(errors[i] < errors[i - 1], String(errors));
  assert.ok(errors[5] < 0.4 * errors[0], String(errors));
  // The noise is that of the finished picture, whatever the last look at it was.
  const facts = await page.textContent("#samples-so-far");
  const noise = 100 * await app(page, ({ picture }) => picture.image.done.noise);
  assert.ok(noise > 0);
  assert.equal(facts, `64 of 64 samples, noise ${Number(noise.toPrecision(2))}\u00a0%`);
  const shown = await app(page, ({ picture, store }) => {
    picture.image.error.samples = 32;
    store.set({ exposure: "1" });
    const text = document.getElementById("samples-so-far").textContent;
    store.set({ exposure: "" });
    return text;
  });
  assert.equal(shown, "64 of 64 samples", "an estimate of fewer samples is not beside it");

  // Hours of work, which a move ends; the picture then begins anew.
  await page.selectOption("#samples", "4096");
  await page.waitForFunction(() => globalThis.seen.some(({ wanted, fine: isFine, samples }) => wanted === 4096 && isFine && samples >= 2));
  const { cancelled } = await app(page, ({ picture }) => picture.counts);
  await page.evaluate(() => { globalThis.seen = []; });
  await page.focus("#frame");
  await page.keyboard.press("ArrowLeft");
  await page.waitForFunction((before) => globalThis.raynest.picture.counts.cancelled > before, cancelled);
  await page.waitForFunction(() => globalThis.seen.some(({ fine: isFine }) => !isFine));
  await page.selectOption("#samples", "1");
  await fine(page);
  await until(async () => {
    const { jobs_started: started, jobs_ended: ended } = await daemon.json("stats");
    return started === ended;
  }, "no job is left over");
});

browserTest("exposure and tone map send nothing, and are in the link", async ({ open }) => {
  const page = await open(daemon, { ...VIEW, samples: "2" });
  await fine(page);
  await countSent(page);
  const light = () => page.evaluate(() => {
    const gl = document.getElementById("picture").getContext("webgl2"), bytes = new Uint8Array(4 * 160 * 90);
    gl.readPixels(0, 0, 160, 90, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    return bytes.reduce((a, b) => a + b, 0);
  });
  const before = await light();
  await page.fill("#exposure", "3");
  await page.press("#exposure", "Enter");
  await until(async () => await light() !== before, "the exposure is seen");
  const exposed = await light();
  await page.selectOption("#tonemap", "none");
  await until(async () => await light() !== exposed, "the tone map is seen");
  await page.click("#exposure-auto");
  await page.selectOption("#tonemap", "");
  await until(async () => await light() === before, "the automatic exposure is back");
  assert.equal(await page.evaluate(() => globalThis.sent), 0);
  await page.selectOption("#integrator", "direct");
  await page.selectOption("#environment", "sky");
  await page.waitForFunction(() => /integrator=direct/.test(location.hash) && /env=sky/.test(location.hash) && /samples=2/.test(location.hash));
});

browserTest("a click shows the path of light, as the command line tells it", async ({ open }) => {
  const page = await open(daemon, { ...VIEW, samples: "1", seed: "5" });
  await fine(page);
  await page.mouse.click(...await windowPoint(page, 80, 70));
  const shown = async (sample) => {
    await page.waitForFunction((number) => globalThis.raynest.path?.document.sample === number, sample);
    return app(page, ({ path }) => path.document);
  };
  const told = (sample) => daemon.json("explain", "forest", "--lookat", "0.5,2,13,0,3,0", "--fov", "50", "--size", "160x90", "--pixel", "80,70",
    "--integrator", "path", "--seed", "5", "--sample", String(sample));
  assert.deepEqual(await shown(0), await told(0));
  const rows = await page.locator("#path-rays li").allTextContents();
  assert.equal(rows.length, (await told(0)).rays.length);
  assert.ok(rows[0].startsWith("Camera ray: hits ") && rows.slice(1).every((text) => /^(Shadow ray|Bounce \d+): /.test(text)), rows.join("\n"));
  assert.equal(await page.locator("#explain-tree").isVisible(), false);
  const drawn = () => page.evaluate(() => {
    const canvas = document.getElementById("overlay"), { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    return data.reduce((count, value, i) => count + (i % 4 === 3 && value > 200 ? 1 : 0), 0);
  });
  assert.ok(await drawn() > 50, "rays lie over the picture");
  await page.click("text=Next sample");
  assert.deepEqual(await shown(1), await told(1));
  // The lines stay while the camera moves, and go with Escape.
  await page.focus("#frame");
  await page.keyboard.press("ArrowLeft");
  await fine(page);
  assert.ok(await app(page, ({ path }) => path !== null));
  await page.keyboard.press("Escape");
  await page.waitForFunction(() => globalThis.raynest.path === null && document.querySelector("#path-rays").closest("section").hidden);
});
