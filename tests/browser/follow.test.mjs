// Edit, replace, look: an open page follows scenes that are replaced, unloaded and loaded again, and restarts of the
// daemon; and no record, table or message of an earlier view stands beside a new picture.
import assert from "node:assert/strict";
import { browserTest, daemonWith, fine, TestDaemon, until, windowPoint } from "./harness.mjs";

const daemon = await daemonWith("builtin:forest?trees=40");
const SIZE = "160x90";
const card = (x, z = 0) => [[x, -1, z], [x + 1, -1, z], [x, 1, z]];
const LEFT = { name: "old", node: "old", points: card(-1) }, RIGHT = { name: "new", node: "new", points: card(0) };
const WIDE = { name: "wide", node: "wide", points: [[-3, -3, -1], [3, -3, -1], [0, 3, -1]] };

const app = (page, run, argument) => page.evaluate(`(${run})(globalThis.raynest, ${JSON.stringify(argument ?? null)})`);
const record = (page) => page.evaluate(() => Object.fromEntries([...document.querySelectorAll("#record dt")].map((name) => [name.textContent, name.nextElementSibling.textContent])));
const names = (page) => page.locator("#panel-objects table").first().locator("tbody tr td:first-child").allTextContents()
  .then((found) => found.filter((name) => name !== "scene").sort().join());
const says = (page, id, text) => page.waitForFunction(([place, part]) => document.getElementById(place).textContent.includes(part), [id, text]);

browserTest("a replaced scene is shown, with its tables, camera and the kept ray, and the page says what changed", async ({ open }) => {
  const name = `hero${Math.random()}`.replace(".", "");
  await daemon.loadMeshes(name, [LEFT]);
  const page = await open(daemon, { scene: name, size: SIZE, panel: "objects", view: "picture" });
  await fine(page);
  await until(async () => await names(page) === "old", "the table of objects");
  const before = await app(page, ({ store, model }) => ({ camera: store.values.camera, version: model.version }));
  await page.click("#tab-ray");
  await page.mouse.click(...await windowPoint(page, 80, 50));
  await page.waitForFunction(() => globalThis.raynest.hover.pinned && globalThis.raynest.selection.chosen);
  assert.equal((await record(page)).Object, "old (0)");

  await daemon.loadMeshes(name, [RIGHT, WIDE], "--replace");
  await page.waitForFunction((version) => globalThis.raynest.model.version !== version, before.version);
  await says(page, "notice", `"${name}" was replaced: triangles 1 → 2; instances 1 → 2; materials 1 → 2.`);
  await fine(page);
  await page.waitForFunction(() => /new|wide/.test(document.querySelector("#record")?.textContent));
  // The whole scene is larger, and so is what its camera sees; the ray is that of the same pixel.
  assert.notDeepEqual((await app(page, ({ store }) => store.values.camera)).eye, before.camera.eye);
  assert.ok(["new (0)", "wide (1)"].includes((await record(page)).Object));
  await page.click("#tab-objects");
  await until(async () => await names(page) === "new,wide", "the new table of objects");
  assert.doesNotMatch(await page.textContent("#notice"), /link/);
});

browserTest("an edited scene is shown, and the page says that it was edited", async ({ open }) => {
  const name = `moved${Math.random()}`.replace(".", "");
  await daemon.loadMeshes(name, [LEFT, RIGHT]);
  const page = await open(daemon, { scene: name, size: SIZE, camera: "0,0,4,0,0,0,0,1,0,45" });
  await fine(page);
  await page.mouse.click(...await windowPoint(page, 62, 50));
  await page.waitForFunction(() => globalThis.raynest.selection.chosen);
  assert.equal((await record(page)).Hit, "yes");
  await daemon.json("edit", name, "--move", "inst=0=0,500,0", "--hide", "inst=1");
  await says(page, "notice", `"${name}" was edited: changed the mask of new; moved old.`);
  await page.waitForFunction(() => document.querySelector("#record")?.textContent.includes("miss"));
  // An edit that hides all of it.
  await daemon.json("edit", name, "--hide", "*");
  await says(page, "message", "No ray hits anything: look elsewhere");
  await daemon.json("edit", name, "--show", "*");
  await page.waitForFunction(() => document.getElementById("message").textContent === "");
});

browserTest("the list of scenes follows loads and unloads", async ({ open }) => {
  const page = await open(daemon, { scene: "forest", size: SIZE });
  await fine(page);
  const name = `come${Math.random()}`.replace(".", "");
  const listed = () => page.evaluate(() => [...document.querySelectorAll("#scene option")].map(({ value }) => value));
  await daemon.loadMeshes(name, [LEFT]);
  await until(async () => (await listed()).includes(name), "the new scene");
  await daemon.json("unload", name);
  await until(async () => !(await listed()).includes(name), "the scene that went");
  assert.equal(await page.inputValue("#scene"), "forest");
});

browserTest("a picture of another size has no record and no rectangle of the former one", async ({ open }) => {
  const page = await open(daemon, { scene: "forest", size: "fit" });
  await fine(page);
  await page.mouse.click(400, 300);
  await page.waitForFunction(() => globalThis.raynest.hover.pinned);
  await app(page, ({ area }) => { area.rectangle = [[1, 1], [5, 5]]; });
  await page.setViewportSize({ width: 900, height: 600 });
  await page.waitForFunction(() => !globalThis.raynest.hover.pinned && !globalThis.raynest.area.rectangle);
  await says(page, "ray-hint", "The view has changed");
});

browserTest("a scene without anything to hit says so", async ({ open }) => {
  await daemon.loadMeshes("nothing", []);
  const page = await open(daemon, { scene: "nothing", size: SIZE });
  await says(page, "message", "nothing that a ray can hit");
});

browserTest("what was hidden and is gone is shown, and no link is blamed", async ({ open }) => {
  const name = `hide${Math.random()}`.replace(".", "");
  await daemon.loadMeshes(name, [LEFT, RIGHT, WIDE]);
  const page = await open(daemon, { scene: name, size: SIZE, camera: "0,0,4,0,0,0,0,1,0,45" });
  await fine(page);
  await page.mouse.click(...await windowPoint(page, 80, 8));
  await page.waitForFunction(() => globalThis.raynest.selection.chosen?.name === "wide");
  await page.focus("#frame");
  await page.keyboard.press("h");
  await page.waitForFunction(() => globalThis.raynest.store.values.hidden.join() === "i2");
  await fine(page);
  await daemon.loadMeshes(name, [LEFT], "--replace");
  await says(page, "notice", "What was hidden or isolated has other numbers now: all of it is shown.");
  await fine(page);
  assert.doesNotMatch(await page.textContent("#notice"), /link/);
  assert.deepEqual(await app(page, ({ store }) => store.values.hidden), []);
});

browserTest("what was hidden is shown where an edit takes one part away and brings another", async ({ open }) => {
  const name = `swap${Math.random()}`.replace(".", "");
  await daemon.loadMeshes(name, [LEFT, RIGHT, WIDE]);
  await daemon.loadMeshes(`${name}-part`, [LEFT]);
  const page = await open(daemon, { scene: name, size: SIZE, camera: "0,0,4,0,0,0,0,1,0,45" });
  await fine(page);
  await app(page, ({ store }) => store.set({ hidden: ["i2"] }));
  await fine(page);
  const hidden = () => app(page, ({ store }) => store.values.hidden);
  assert.deepEqual(await hidden(), ["i2"]);
  // Parts that only move keep their numbers.
  await daemon.json("edit", name, "--move", "new=0,0.1,0");
  await says(page, "notice", "was edited");
  assert.deepEqual(await hidden(), ["i2"]);
  const { instances } = await daemon.json("info", name);
  await daemon.json("edit", name, "--remove", "old", "--add", `${name}-part=0,0,0`);
  assert.equal((await daemon.json("info", name)).instances, instances);
  await says(page, "notice", "What was hidden or isolated has other numbers now: all of it is shown.");
  assert.deepEqual(await hidden(), []);
});

browserTest("a scene that is unloaded and comes back is shown again, and so is the first one of an empty daemon", async ({ open }) => {
  const own = new TestDaemon();
  try {
    await own.start();
    const page = await open(own, { size: SIZE });
    await says(page, "message", "No scene is loaded");
    await own.loadMeshes("card", [LEFT]);
    await fine(page);
    assert.equal(await page.inputValue("#scene"), "card");
    assert.equal(await page.textContent("#message"), "");
    // A restart without the scene, and with another content of that name.
    await own.stop();
    await says(page, "state", "away");
    await own.start();
    await says(page, "message", '"card" is not loaded any more');
    await own.loadMeshes("card", [RIGHT, WIDE]);
    await says(page, "notice", '"card" is loaded again: triangles 1 → 2');
    await fine(page);
    assert.equal(await page.textContent("#message"), "");
    assert.equal(await page.inputValue("#scene"), "card");
    await page.click("#tab-objects");
    await until(async () => await names(page) === "new,wide", "the new table of objects");
    // An unload, after which the name is free for another content.
    await own.json("unload", "card");
    await says(page, "message", '"card" is not loaded any more; the picture is the last one of it');
    assert.equal(await page.textContent("#notice"), "", "what was said about it before is gone");
    assert.equal(await page.textContent("#panel-objects .none"), "No scene is shown.");
    await own.loadMeshes("card", [LEFT]);
    await says(page, "notice", '"card" is loaded again: triangles 2 → 1');
    await fine(page);
    await until(async () => await names(page) === "old", "the table of the scene that came back");
  } finally {
    await own.end();
  }
});

browserTest("a file's camera that moves is followed, and one that is gone leaves the view", async () => {
  const { sameCamera, changesText } = await import("../../server/web/follow.js");
  const cameras = (...list) => ({ cameras: list });
  assert.equal(sameCamera("1", cameras("a", "b"), cameras("b", "c")), "0");
  assert.equal(sameCamera("0", cameras("a", "b"), cameras("b", "c")), "");
  assert.equal(sameCamera("1", cameras("", ""), cameras("", "")), "1");
  assert.equal(sameCamera("", cameras("a"), cameras("a")), "");
  assert.equal(sameCamera("automatic", cameras(), cameras()), "automatic");
  assert.equal(changesText({ hash: "1", cameras: ["a"] }, { hash: "2", cameras: ["b"] }), "cameras gone: a; new cameras: b");
  assert.equal(changesText({ hash: "1" }, { hash: "2" }), "other content with the same counts");
  const edited = (epoch, last) => ({ hash: String(epoch), epoch, refits: 1, last_edit: last });
  assert.equal(changesText(edited(1, ""), edited(2, "moved a")), "moved a");
  assert.equal(changesText(edited(1, ""), { ...edited(4, "removed b"), instances: 2 }), "3 edits, the last one removed b; instances 0 → 2");
  assert.equal(changesText(edited(1, ""), edited(2, "")), "parts of it stand elsewhere, or have other shapes or masks");
});

browserTest("no hit record stays beside a picture that it is not of", async ({ open }) => {
  const page = await open(daemon, { scene: "forest", size: SIZE, panel: "ray", camera: "0.5,2,13,0,3,0,0,1,0,50" });
  await fine(page);
  const pick = async () => {
    await page.mouse.click(...await windowPoint(page, 80, 60));
    await page.waitForFunction(() => globalThis.raynest.hover.pinned && globalThis.raynest.selection.chosen);
    await page.mouse.move(5, 5);
    await page.focus("#frame");
  };
  await pick();
  const first = await record(page);
  // H: the same pixel is asked for again, and shows what lies behind.
  await page.keyboard.press("h");
  await fine(page);
  await page.waitForFunction((path) => {
    const { pinned } = globalThis.raynest.hover;
    return pinned && document.getElementById("record").textContent && String(pinned.columns.path[0]) !== path;
  }, first["Path id"]);
  const ask = async () => (await daemon.jsonLines("query", "forest", "--generate", "camera", `size=${SIZE}`, "lookat=0.5,2,13,0,3,0,0,1,0", "fov=50",
    "--fields", "t,path", "--hide", `inst=${(await app(page, ({ store }) => store.values.hidden))[0].slice(1)}`))[60 * 160 + 80].hits[0];
  assert.equal((await record(page))["Path id"], String((await ask())?.path ?? "undefined"));
  await page.keyboard.press("j");
  await fine(page);
  // A view from elsewhere: the record goes, and the panel says why.
  for (const key of ["f", "0", "ArrowLeft"]) {
    await page.keyboard.press("Escape");
    await pick();
    await page.keyboard.press(key);
    await page.waitForFunction(() => !document.getElementById("record").textContent);
    await fine(page);
    assert.deepEqual(await record(page), {}, key);
    assert.match(await page.textContent("#ray-hint"), /The view has changed/);
    assert.equal(await page.locator("#explain-tree").isVisible(), false);
    await app(page, ({ showCamera }) => showCamera({ eye: [0.5, 2, 13], at: [0, 3, 0], up: [0, 1, 0], fov: 50, projection: "perspective" }));
    await fine(page);
  }
  // A pointer that rests over the picture has the record of the new one.
  const there = await windowPoint(page, 80, 60);
  await page.mouse.move(...there);
  await page.waitForFunction(() => document.querySelector("#record dd"));
  const before = await record(page);
  await page.focus("#frame");
  await page.keyboard.press("Shift+D");
  await fine(page);
  await page.waitForFunction((old) => document.querySelector("#record")?.textContent && globalThis.raynest.hover.found
    && String(Number(globalThis.raynest.hover.found.columns.t[0].toPrecision(7))) !== old, before.t);
  // Another scene.
  await pick();
  await daemon.loadMeshes("other", [LEFT], "--replace");
  await page.reload();
  await fine(page);
  await pick();
  await page.selectOption("#scene", "other");
  await page.waitForFunction(() => !document.getElementById("record").textContent);
});
