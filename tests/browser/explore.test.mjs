// Finding what is slow, and why: a ray's traversal, the ranking, the tables and their links with the picture, hidden
// instances, colours by structure, and boxes of trees.
import assert from "node:assert/strict";
import { execFile } from "node:child_process";
import { promisify } from "node:util";
import { browserTest, daemonWith, fine, raynest, until, windowPoint } from "./harness.mjs";

const daemon = await daemonWith("builtin:forest");
const EYE = "0.5,2,13,0,3,0,0,1,0";
const FOREST = { scene: "forest", size: "320x180", camera: `${EYE},50` };
const CAMERA = ["--lookat", EYE, "--fov", "50", "--size", "320x180"];

const app = (page, run, argument) => page.evaluate(`(${run})(globalThis.raynest, ${JSON.stringify(argument ?? null)})`);
const clickPixel = async (page, x, y) => page.mouse.click(...await windowPoint(page, x, y));
/** A checksum of the fine picture's values. */
const sum = (page) => app(page, ({ picture }) => picture.image.values.reduce((a, b) => a + (Number.isFinite(b) ? b : 0), 0));
const chosen = (page) => app(page, ({ selection: { chosen: c } }) => c && { ...c, first: String(c.first), count: String(c.count) });

browserTest("a click explains its ray as the command line does, and draws the boxes", async ({ open }) => {
  const page = await open(daemon, { ...FOREST, panel: "ray" });
  await fine(page);
  for (const [x, y] of [[160, 120], [40, 90]]) {
    await clickPixel(page, x, y);
    await page.waitForFunction(([px, py]) => {
      const { explained } = globalThis.raynest;
      return explained?.document.pixel?.join() === `${px},${py}`;
    }, [x, y]);
    const shown = await app(page, ({ explained }) => explained.document);
    const told = await daemon.json("explain", "forest", ...CAMERA, "--pixel", `${x},${y}`, "--all");
    assert.deepEqual([shown.totals, shown.levels], [told.totals, told.levels]);
    assert.deepEqual(shown.steps, told.steps.slice(0, shown.steps.length));
    assert.equal(shown.steps.length + shown.left_out, told.steps.length);
    const texts = await page.locator("#explain-tree li").allTextContents();
    assert.equal(texts.length, shown.steps.length);
    assert.ok(texts.some((text) => /boxes entered/.test(text)) && (await page.textContent("#explain-summary")).startsWith(`${told.totals.total} = `));
  }
  const drawn = () => page.evaluate(() => {
    const canvas = document.getElementById("overlay"), { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    return data.some((value, i) => i % 4 === 3 && value > 0);
  });
  assert.ok(await drawn(), "boxes lie over the picture");
  // A step that has the focus shows its box; the arrow keys go from step to step.
  await page.focus("#explain-tree li:first-child button");
  await page.keyboard.press("ArrowDown");
  assert.equal(await page.evaluate(() => document.activeElement === document.querySelectorAll("#explain-tree button")[1]), true);
  await page.keyboard.press("Escape");
  await page.waitForFunction(() => document.querySelector("#explain-tree").closest("section").hidden);
  await until(async () => !await drawn(), "and go again");
});

browserTest("the ranking is the command line's, and is linked with the picture both ways", async ({ open }) => {
  const page = await open(daemon, { ...FOREST, panel: "ranking" });
  await fine(page);
  await page.waitForFunction(() => document.querySelectorAll("#panel-ranking tbody tr").length > 0);
  const told = await daemon.json("heatmap", "forest", ...CAMERA, "--top", "100");
  const rows = () => page.locator("#panel-ranking tbody tr").evaluateAll((all) => all.map((line) => [...line.children].map((cell) => cell.textContent)));
  assert.deepEqual((await rows()).slice(0, 5).map(([share]) => share), told.instances.rows.slice(0, 5).map(({ share }) => `${(100 * share).toFixed(1)}\u00a0%`));
  assert.ok((await rows()).slice(0, 5).every(([, name]) => told.instances.rows.some((row) => row.name === name)));
  assert.equal(await page.locator("#findings .finding").count(), told.findings.length);
  // From the table to the picture.
  await page.locator("#panel-ranking tbody tr").nth(1).click();
  const { name, path, placements } = told.instances.rows[1];
  await until(async () => (await chosen(page))?.name === name);
  assert.deepEqual(await chosen(page).then(({ first, count }) => [first, count]), [String(path), String(placements)]);
  // And back: a pixel of that instance selects its row.
  await clickPixel(page, 160, 120);
  await until(async () => (await chosen(page))?.count === "1");
  const clicked = BigInt((await chosen(page)).first);
  const expected = told.instances.rows.filter((row) => BigInt(row.path) <= clicked && clicked < BigInt(row.path) + BigInt(row.placements)).map((row) => row.name);
  const marked = await page.locator('#panel-ranking tr[aria-selected="true"]').evaluateAll((all) => all.map((line) => line.children[1].textContent));
  assert.deepEqual(marked, expected);
  // Sorted by name, both ways.
  await page.click("#panel-ranking th:nth-child(2) button");
  const up = (await rows()).map((row) => row[1]);
  assert.deepEqual(up, [...up].sort((a, b) => a.localeCompare(b)));
  await page.click("#panel-ranking th:nth-child(2) button");
  assert.deepEqual((await rows()).map((row) => row[1]), [...up].sort((a, b) => b.localeCompare(a)));
  await page.selectOption("#ranking-table", "materials");
  assert.deepEqual((await rows()).map((row) => row[1]).sort(), told.materials.rows.map(({ name }) => name || "(unnamed)").sort());
});

browserTest("equal names are told apart, and each is chosen by its number", async ({ open }) => {
  const quad = (x) => [[x, 0, 0], [x + 1, 0, 0], [x, 1, 0]];
  await daemon.loadMeshes("oaks", [{ name: "oak", node: "oak", points: quad(-1.2) }, { name: "oak", node: "oak", points: quad(0.2) }]);
  const page = await open(daemon, { scene: "oaks", size: "320x180", panel: "ranking", camera: "0,0.4,4,0,0.4,0,0,1,0,45" });
  await fine(page);
  for (const [table, kind] of [["meshes", "object"], ["materials", "material"]]) {
    await page.selectOption("#ranking-table", table);
    await page.waitForFunction(() => document.querySelectorAll("#panel-ranking tbody tr").length > 1);
    const rows = await page.locator("#panel-ranking tbody tr").evaluateAll((all) => all.map((line) => [...line.children].map((cell) => cell.textContent)));
    const oaks = rows.filter(([, name]) => name === "oak").map(([, , number]) => number);
    assert.equal(oaks.length, 2, String(rows));
    assert.notEqual(oaks[0], oaks[1]);
    for (const number of oaks) {
      await page.locator("#panel-ranking tbody tr", { has: page.locator(`td:nth-child(3):text-is("${number}")`) }).first().click();
      await until(() => app(page, ({ selection: { chosen: c } }, [name, wanted]) => c?.[name] === wanted, [kind, Number(number)]), `${kind} ${number}`);
    }
  }
});

browserTest("tables of the scene, and hide, isolate, show all, focus", async ({ open, context }) => {
  const page = await open(daemon, { ...FOREST, panel: "objects", view: "instances" });
  await fine(page);
  await page.waitForFunction(() => document.querySelectorAll("#panel-objects table")[1]?.querySelectorAll("tbody tr").length > 0);
  const info = await daemon.json("info", "forest");
  const objects = await app(page, ({ model }) => model.objects);
  assert.equal(objects.reduce((all, row) => all + row.triangles * row.placements, 0), info.instanced_triangles);
  assert.equal(await page.locator("#panel-objects table").first().locator("tbody tr").count(), objects.length);
  const whole = await sum(page);

  await clickPixel(page, 160, 120);
  await until(() => chosen(page));
  const before = await chosen(page);
  assert.equal(await page.locator("#selected").textContent(), before.name);
  // The table of instances turns to the page of what was clicked.
  await page.waitForFunction((path) => [...document.querySelectorAll('#panel-objects tr[aria-selected="true"]')]
    .some((line) => [...line.children].some((cell) => cell.textContent === path)), before.first);
  await page.focus("#frame");
  await page.keyboard.press("h");
  await page.waitForFunction(() => globalThis.raynest.store.values.hidden.length === 1);
  await fine(page);
  assert.ok(await sum(page) < whole, "fewer instances are entered");
  const hiddenThere = await app(page, ({ picture }) => picture.image.columns.ng.length);
  assert.ok(hiddenThere > 0);
  // So do the copied command and program.
  await page.click("#share");
  const [command, python] = [await page.textContent("#command"), await page.textContent("#python")];
  await page.keyboard.press("Escape");
  const instance = await app(page, ({ store }) => store.values.hidden[0].slice(1));
  assert.ok(command.includes(`--hide inst=${instance}`) && python.includes(`hide=["inst=${instance}"]`), `${command}\n${python}`);
  const { stdout } = await promisify(execFile)("sh", ["-c", `raynest() { '${raynest}' --server '${daemon.listen}' --json "$@"; }; ${command}`], { cwd: daemon.folder });
  const rays = 320 * 180, { mean } = JSON.parse(stdout);
  assert.ok(Math.abs(mean * rays - await sum(page)) < 1e-3 * mean * rays, String(mean));
  // A link shows the same.
  const again = await context.newPage();
  await page.waitForTimeout(300);
  await again.goto(page.url());
  await fine(again);
  assert.equal(await sum(again), await sum(page));
  await again.close();

  await page.keyboard.press("j");
  await fine(page);
  assert.equal(await sum(page), whole);
  await clickPixel(page, 160, 120);
  await until(async () => (await chosen(page))?.first === before.first);
  await page.focus("#frame");
  await page.keyboard.press("i");
  await page.waitForFunction(() => globalThis.raynest.store.values.isolated.length === 1);
  await fine(page);
  assert.ok(await sum(page) < 0.7 * whole);
  const camera = await app(page, ({ store }) => store.values.camera);
  await page.keyboard.press("f");
  await page.waitForFunction((old) => JSON.stringify(globalThis.raynest.store.values.camera) !== old, JSON.stringify(camera));
  await fine(page);
  // An object, from its table.
  await page.keyboard.press("j");
  const line = page.locator("#panel-objects table").first().locator("tbody tr").first();
  await line.focus();
  await page.keyboard.press("Enter");
  await until(async () => (await chosen(page))?.kind === "object");
  await page.keyboard.press("i");
  await page.waitForFunction(() => /^o\d+$/.test(globalThis.raynest.store.values.isolated[0]));
  await fine(page);
});

browserTest("colours by structure have the values of a query's columns", async ({ open }) => {
  const page = await open(daemon, { ...FOREST, view: "box_share" });
  await fine(page);
  const records = await daemon.jsonLines("query", "forest", "--generate", "camera", "size=320x180", `lookat=${EYE}`, "fov=50",
    "--fields", "t,box_share,tree_depth,object,material,mask");
  const values = () => app(page, ({ picture }) => [...picture.image.values].map((value) => (Number.isFinite(value) ? value : null)));
  const differ = async (value) => {
    const shown = await values();
    return records.filter(({ hits: [hit] }, i) => (hit ? Math.abs(shown[i] - value(hit)) > 1e-5 * Math.abs(value(hit)) : shown[i] !== null)).length;
  };
  assert.equal(await differ((hit) => hit.box_share), 0);
  await page.selectOption("#view", "tree_depth");
  await fine(page);
  assert.equal(await differ((hit) => hit.tree_depth), 0);
  const objects = await app(page, ({ model }) => model.objects);
  for (const [view, key] of [["object_triangles", "triangles"], ["object_instances", "placements"], ["object_depth", "height"]]) {
    await page.selectOption("#view", view);
    await fine(page);
    assert.equal(await differ((hit) => Number(objects[hit.object][key])), 0, view);
  }
  // Opacity: leaves are masked, trunks are not.
  await page.selectOption("#view", "opacity");
  await fine(page);
  const materials = await app(page, ({ model }) => model.materials);
  const colours = await app(page, ({ picture }) => [...picture.image.colours]);
  const colourOf = (alpha) => String(records.flatMap(({ hits: [hit] }, i) => (hit && materials[hit.material]?.alpha === alpha ? [colours.slice(4 * i, 4 * i + 3)] : []))[0]);
  assert.deepEqual([colourOf("OPAQUE"), colourOf("MASK")], ["86,130,170", "240,150,50"]);
  assert.equal(await page.textContent("#key"), "opaquemaskblend");
  assert.equal(await page.evaluate(() => document.querySelector("#key i").style.background), "rgb(86, 130, 170)");
  for (const view of ["object", "mask", "uid", "inst", "material", "placement"]) {
    await page.selectOption("#view", view);
    await fine(page);
  }
});

browserTest("boxes of a range of tree depths of a level", async ({ open }) => {
  const page = await open(daemon, { ...FOREST, panel: "objects", boxes: "0:1:2:0" });
  await fine(page);
  const text = () => page.textContent("#boxes-hint");
  await page.waitForFunction(() => /^[\d,]+ boxes? of 1 tree\b/.test(document.getElementById("boxes-hint").textContent));
  const count = Number.parseInt(await text(), 10);
  assert.ok(count >= 8 && count <= 72, await text());
  await page.selectOption("#boxes-level", "1");
  await page.waitForFunction(() => !/ 1 trees/.test(document.getElementById("boxes-hint").textContent));
  assert.ok(page.url().includes("boxes=") || await page.waitForFunction(() => location.hash.includes("boxes=1")));
  await page.check("#boxes-one");
  await page.waitForFunction(() => /Select an instance/.test(document.getElementById("boxes-hint").textContent));
  await clickPixel(page, 160, 120);
  await page.waitForFunction(() => /^[\d,]+ boxes? of 1 tree\b/.test(document.getElementById("boxes-hint").textContent));
  await page.fill("#boxes-most", "47");
  await page.press("#boxes-most", "Enter");
  await page.selectOption("#boxes-level", "");
  await page.waitForFunction(() => document.getElementById("boxes-hint").textContent === "");
});

browserTest("a level of a counter, and a rectangle's statistics", async ({ open }) => {
  const page = await open(daemon, { ...FOREST, view: "boxes", panel: "area" });
  await fine(page);
  const all = await sum(page);
  let levels = 0;
  const { levels: count } = await daemon.json("info", "forest");
  for (let level = 0; level < count; ++level) {
    await page.selectOption("#level", String(level));
    await fine(page);
    levels += await sum(page);
  }
  assert.equal(levels, all, "the levels add up to the total");
  await page.selectOption("#level", "");
  await fine(page);
  const [from, to] = [await windowPoint(page, 100, 60), await windowPoint(page, 139, 89)];
  await page.keyboard.down("Shift");
  await page.mouse.move(...from);
  await page.mouse.down();
  await page.mouse.move(...to, { steps: 5 });
  await page.mouse.up();
  await page.keyboard.up("Shift");
  await page.waitForFunction(() => document.querySelector("#area-statistics")?.textContent.includes("1,200"));
  const expected = await app(page, ({ picture: { image } }) => {
    const inside = [];
    for (let y = 60; y < 90; ++y) for (let x = 100; x < 140; ++x) inside.push(image.values[y * image.width + x]);
    return { max: Math.max(...inside), min: Math.min(...inside) };
  });
  const text = (await page.textContent("#area-statistics")).replaceAll(",", "");
  assert.ok(text.includes(`max${expected.max}`) && text.includes(`min${expected.min}`), text);
});

browserTest("the slider shows moments of an animation, and the link keeps them", async ({ open }) => {
  await daemon.json("load", "builtin:street?seconds=2&cars=8&length=60", "--name", "street");
  const view = { scene: "street", size: "320x180", camera: "-25,6,12,0,1,0,0,1,0,50" };
  const page = await open(daemon, view);
  await fine(page);
  assert.equal(await page.isVisible("#time-section"), true);
  const still = await sum(page);
  const counted = async (...time) => (await daemon.json("heatmap", "street", "--lookat=-25,6,12,0,1,0,0,1,0", "--fov", "50", "--size", "320x180",
    "-o", `${daemon.folder}/street.png`, ...time)).mean * 320 * 180;
  assert.ok(Math.abs(still - await counted()) < 1, "as the command line counts");
  await page.fill("#time", "1.5");
  await until(async () => await sum(page) !== still, "another picture");
  await fine(page);
  assert.ok(Math.abs(await sum(page) - await counted("--time", "1.5")) < 1);
  await page.waitForFunction(() => location.hash.includes("time=1.5"));
  // Tables and boxes of trees are of that moment, too. Only a wide page has room for the centres.
  await page.setViewportSize({ width: 1600, height: 900 });
  await page.getByRole("tab", { name: "Scene" }).click();
  await page.selectOption("#boxes-level", "0");
  const centres = () => page.evaluate(() => [...document.querySelectorAll("table")].map((table) => table.textContent)
    .find((text) => text.includes("Centre")) ?? "");
  const boxes = () => page.evaluate(() => document.querySelector("#overlay").toDataURL());
  await until(async () => (await centres()).includes("car-0"), "the cars");
  await until(async () => /boxes of/.test(await page.textContent("#boxes-hint")), "boxes");
  const seen = [await centres(), await boxes()];
  await app(page, ({ store }) => store.set({ time: 0.5 }));
  await until(async () => await centres() !== seen[0], "other centres");
  await until(async () => await boxes() !== seen[1], "other boxes");
  await page.getByRole("tab", { name: "Setup" }).click();
  // A coarse picture that has begun comes to its end while somebody drags.
  const coarse = () => app(page, ({ picture }) => picture.counts.coarse), drawn = await coarse();
  await page.evaluate(async () => {
    for (let i = 0; i < 20; ++i) {
      globalThis.raynest.store.set({ time: 1 + i / 50 });
      await Promise.resolve();
    }
  });
  await until(async () => await coarse() > drawn, "a coarse picture");
  await fine(page);
  // It plays until it is stopped.
  const time = () => app(page, ({ store }) => store.values.time);
  await page.click("#time-play");
  const moments = new Set();
  await until(async () => moments.add(await time()).size > 4, "moments");
  await page.click("#time-play");
  const stopped = await time();
  await fine(page);
  assert.equal(await time(), stopped);
  await page.click("#time-off");
  await until(async () => await sum(page) === still, "the scene as it was loaded");
  await page.selectOption("#scene", "forest");
  await until(() => page.isHidden("#time-section"), "a scene that does not move has no slider");
});
