// The page as a whole: the record under the pointer, links, names from a scene, restarts of the daemon, accessibility.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { axePath, browserTest, daemonWith, fine, pixel, TestDaemon, until, windowPoint } from "./harness.mjs";

const daemon = await daemonWith("builtin:forest");
const FOREST = { scene: "forest", size: "320x180" };

/** The rows of a list of names and values in the page. */
const rows = (page, place) => page.evaluate((selector) => Object.fromEntries([...document.querySelectorAll(`${selector} dt`)]
  .map((name) => [name.textContent, name.nextElementSibling.textContent])), place);

browserTest("the record under the pointer is that of a query of the pixel", async ({ open }) => {
  const page = await open(daemon, { ...FOREST, panel: "ray", camera: "0.5,2,13,0,3,0,0,1,0,50" });
  await fine(page);
  const records = await daemon.jsonLines("query", "forest", "--generate", "camera", "size=320x180", "lookat=0.5,2,13,0,3,0,0,1,0", "fov=50",
    "--fields", "t,path,prim,material,object,nodes,boxes,prims,instances,total");
  for (const [x, y] of [[40, 90], [160, 120], [300, 60]]) {
    await page.mouse.move(...await windowPoint(page, x, y));
    await page.waitForFunction((text) => document.querySelector("#record dd")?.textContent === text, `${x}, ${y}`);
    const shown = { ...await rows(page, "#record"), ...await rows(page, "#counters") };
    const { hits: [hit], ...counters } = records[y * 320 + x];
    assert.equal(shown.Hit, hit ? "yes" : "miss");
    for (const name of ["nodes", "boxes", "prims", "instances", "total"]) assert.equal(shown[name], String(counters[name]), `${name} at ${x}, ${y}`);
    if (!hit) continue;
    assert.deepEqual([shown["Path id"], shown.Primitive], [hit.path, hit.prim].map(String));
    // Things have their names, and their numbers, which equal names do not share.
    const { materials, objects } = await page.evaluate(() => globalThis.raynest.model);
    assert.equal(shown.Material, `${materials[hit.material].name} (${hit.material})`);
    assert.equal(shown.Object, `${objects[hit.object].name} (${hit.object})`);
    assert.ok(materials[hit.material].name && objects[hit.object].name);
    assert.ok(Math.abs(Number(shown.t) - hit.t) < 1e-5 * hit.t, `${shown.t} and ${hit.t}`);
    assert.equal(shown["Instance path"], (await daemon.json("path", "forest", String(hit.path))).name);
  }
});

browserTest("a link shows the same view again", async ({ open, context }) => {
  const page = await open(daemon, { ...FOREST, view: "prims", palette: "inferno", log: "1" });
  await fine(page);
  await page.focus("#frame");
  await page.keyboard.press("ArrowLeft");
  await page.keyboard.press("w");
  await fine(page);
  await page.waitForFunction(() => location.hash.includes("camera="));
  await page.waitForTimeout(300);
  const again = await context.newPage();
  await again.goto(page.url());
  await fine(again);
  const values = (of) => of.evaluate(() => {
    const { cameraName, ...state } = globalThis.raynest.store.values;
    return { state, sum: globalThis.raynest.picture.image.values.reduce((a, b) => a + b, 0) };
  });
  assert.deepEqual(await values(again), await values(page));
  assert.deepEqual(await pixel(again, 100, 100), await pixel(page, 100, 100));
});

browserTest("what a link says badly has its default, and is named", async ({ open }) => {
  const good = { ...FOREST, palette: "inferno" };
  const cases = [[{ view: "nosuch" }, "view=nosuch"], [{ view: "boxes", level: "9" }, "level=9"], [{ camera: "0,1,NaN,0,0,0,0,1,0,45" }, "camera=0,1,NaN"],
    [{ range: "5,5" }, "range=5,5"], [{ range: "9,2" }, "range=9,2"], [{ mask: "xyz" }, "mask=xyz"], [{ intersector: "nosuch" }, "intersector=nosuch"],
    [{ set: "cutoff=9e9" }, "set=cutoff=9e9"], [{ set: "nosuch=1" }, "set=nosuch=1"], [{ hidden: "i99999" }, "hidden=i99999"], [{ hidden: "x" }, "hidden=x"],
    [{ opacity: "2" }, "opacity=2"], [{ compare: "intersector:nosuch" }, "compare=intersector:nosuch"], [{ unheard: "1" }, "unheard"], [{ view: "lit", samples: "0" }, "samples=0"],
    [{ view: "lit", sun: "1,99" }, "sun=1,99"]];
  for (const [bad, says] of cases) {
    const page = await open(daemon, { ...good, ...bad, ...(bad.view === "lit" ? { integrator: "primary" } : {}) });
    await fine(page);
    const note = await page.textContent("#notice");
    assert.ok(note.startsWith("Not understood in this link: ") && note.includes(says), `${says}: ${note}`);
    assert.equal(await page.textContent("#message"), "", says);
    const [x, y] = [160, 120];
    assert.notDeepEqual(await pixel(page, x, y), [0, 0, 0], `${says} shows a picture`);
    assert.equal(await page.inputValue("#palette"), "inferno");
    await page.click("#notice button");
    assert.equal(await page.textContent("#notice"), "");
    await page.close();
  }
  // Its parts are named together, also those that are found when the picture is traced; good ones stay.
  const mixed = await open(daemon, { ...good, view: "nosuch", hidden: "i99999,i3" });
  await fine(mixed);
  await until(async () => { const note = await mixed.textContent("#notice"); return note.includes("view=nosuch") && note.includes("hidden=i99999."); }, "both are named");
  assert.deepEqual(await mixed.evaluate(() => globalThis.raynest.store.values.hidden), ["i3"]);
  await mixed.close();
  // A good link has nothing to say.
  const page = await open(daemon, { ...good, level: "1", view: "boxes", range: "1,50", set: "cutoff=0.3", hidden: "i3" });
  await fine(page);
  assert.equal(await page.textContent("#notice"), "");
});

browserTest("names from a scene are text", async ({ open, errors }) => {
  const evil = "<img src=x onerror=\"document.title='broken'\">";
  if (!(await daemon.json("scenes")).scenes.some(({ name }) => name === "hostile")) {
    await daemon.loadMeshes("hostile", [{ name: evil, node: evil, points: [[-1, -1, 0], [1, -1, 0], [0, 1, 0]] }]);
  }
  const page = await open(daemon, { scene: "hostile", size: "320x180", panel: "ray" });
  await fine(page);
  await page.mouse.move(...await windowPoint(page, 160, 95));
  await page.waitForFunction(() => document.querySelector("#record")?.textContent.includes("onerror"));
  await page.mouse.click(...await windowPoint(page, 160, 95));
  await page.waitForFunction(() => document.querySelector("#explain-tree")?.textContent.includes("onerror"));
  for (const tab of ["objects", "ranking"]) {
    await page.click(`#tab-${tab}`);
    await page.waitForFunction((panel) => document.querySelector(`#panel-${panel}`)?.textContent.includes("onerror"), tab);
  }
  assert.equal(await page.locator("img").count(), 0);
  assert.notEqual(await page.title(), "broken");
  // A hostile link, too.
  const other = await open(daemon, { scene: evil, view: evil, palette: evil, mask: evil, camera: evil });
  await other.waitForFunction(() => document.getElementById("message").textContent.includes("onerror"));
  assert.equal(await other.locator("img").count(), 0);
  errors.length = 0;
});

browserTest("a foreign script has no place", async ({ open, errors }) => {
  const page = await open(daemon, FOREST);
  await fine(page);
  const ran = await page.evaluate(() => new Promise((resolve) => {
    const script = document.createElement("script");
    script.textContent = "globalThis.broken = true";
    document.body.append(script);
    document.body.insertAdjacentHTML("beforeend", "<b onclick=\"globalThis.broken = true\"></b>");
    document.body.lastChild.click();
    const foreign = document.createElement("script");
    foreign.src = "https://example.com/x.js";
    foreign.onerror = () => resolve(globalThis.broken);
    document.body.append(foreign);
  }));
  assert.equal(ran, undefined);
  errors.length = 0;  // each refusal is reported
});

browserTest("the page outlives its daemon", async ({ open, errors }) => {
  const own = new TestDaemon();
  try {
    await own.start();
    await own.json("load", "builtin:forest");
    const page = await open(own, FOREST);
    await fine(page);
    const before = await pixel(page, 160, 120);
    await own.stop();
    await page.waitForFunction(() => document.getElementById("state").textContent.includes("away"));
    assert.deepEqual(await pixel(page, 160, 120), before);
    await own.start();
    await page.waitForFunction(() => document.getElementById("state").textContent === "Connected");
    // The new daemon has no scene yet: the page says so, and works again once it has.
    await page.waitForFunction(() => /forest|scene/i.test(document.getElementById("message").textContent));
    await own.json("load", "builtin:forest");
    await page.selectOption("#view", "prims");
    await fine(page);
    await page.waitForFunction(() => globalThis.raynest.daemon.pending === 0);
    // What the page asks for while its daemon ends may be refused, or cut off.
    errors.splice(0, Infinity, ...errors.filter((text) => !text.includes("ERR_CONNECTION_RESET")));
  } finally {
    await own.end();
  }
});

browserTest("axe-core finds nothing serious, light and dark, wide and narrow", async ({ open }) => {
  const page = await open(daemon, { ...FOREST, samples: "1" });
  await fine(page);
  const axe = readFileSync(axePath(), "utf8");
  await page.evaluate(axe);
  const tabs = await page.locator("[role=tab]").evaluateAll((all) => all.map(({ id }) => id));
  for (const [size, view, some] of [[{ width: 1280, height: 800 }, "total", tabs], [{ width: 1024, height: 640 }, "total", tabs], [{ width: 1024, height: 640 }, "lit", ["tab-setup", "tab-ray"]]]) {
    await page.setViewportSize(size);
    await page.selectOption("#view", view);
    for (const tab of some) {
      await page.click(`#${tab}`);
      await page.waitForTimeout(150);
      const found = await page.evaluate(async () => (await globalThis.axe.run()).violations
        .filter(({ impact }) => ["serious", "critical"].includes(impact)).map(({ id, nodes }) => `${id}: ${nodes[0].html}`));
      assert.deepEqual(found, [], `${tab} at ${size.width}`);
      assert.ok(await page.evaluate(() => document.documentElement.scrollWidth <= innerWidth), `${tab} fits ${size.width}`);
    }
    await page.evaluate(() => document.activeElement.blur());
    await page.keyboard.press("t");
  }
});

browserTest("the keyboard alone is enough", async ({ open }) => {
  const page = await open(daemon, FOREST);
  await fine(page);
  const reached = new Set();
  for (let i = 0; i < 60; ++i) {
    await page.keyboard.press("Tab");
    reached.add(await page.evaluate(() => document.activeElement.id));
  }
  for (const id of ["scene", "camera", "view", "frame", "palette", "range-low", "log", "tab-setup", "intersector", "mask", "share", "help"]) {
    assert.ok(reached.has(id), `Tab reaches ${id}`);
  }
  await page.focus("#frame");
  const camera = () => page.evaluate(() => JSON.stringify(globalThis.raynest.store.values.camera));
  for (const key of ["ArrowRight", "ArrowUp", "+", "-", "w", "a", "p"]) {
    const before = await camera();
    await page.keyboard.press(key);
    assert.notEqual(await camera(), before, key);
  }
  await page.keyboard.press("?");
  assert.ok((await page.textContent("dialog")).includes("Turn the camera"));
  await page.keyboard.press("Escape");
  await until(async () => !await page.locator("dialog[open]").count());
});

browserTest("a link to a scene that is not loaded offers the others", async ({ open }) => {
  const page = await open(daemon, { scene: "nosuch" });
  await until(async () => /"nosuch" is not loaded/.test(await page.textContent("#message")), "the page says so");
  assert.match(await page.textContent("#message"), /raynest load FILE --name nosuch\. If another user has loaded it, .* --share public\. The page/);
  await page.selectOption("#scene", "forest");
  await fine(page);
  assert.equal(await page.textContent("#message"), "");
});
