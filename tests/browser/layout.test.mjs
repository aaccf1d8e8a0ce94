// How the page looks: at 400, 800 and 1400 pixels nothing overlaps, is cut, or scrolls sideways; tables, numbers, words
// for what is empty, and colours that mean what the legend says.
import assert from "node:assert/strict";
import { execFile, spawn } from "node:child_process";
import { readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { promisify } from "node:util";
import { browser, browserTest, daemonWith, fine, pixel, raynest, raynestd, until, windowPoint } from "./harness.mjs";

const daemon = await daemonWith("builtin:forest?trees=40");
const LONG = "a_very_long_name_of_a_mesh_that_no_column_can_hold_as_it_is";
await daemon.loadMeshes("names", [{ name: LONG, node: LONG, points: [[-1, -1, 0], [1, -1, 0], [0, 1, 0]] },
                                  { name: "second", node: "second", points: [[1, -1, 0], [3, -1, 0], [2, 1, 0]] }]);
const app = (page, run, argument) => page.evaluate(`(${run})(globalThis.raynest, ${JSON.stringify(argument ?? null)})`);

/** What is wrong with the layout, as lines of text; runs in the page. */
function faults() {
  const found = [], root = document.documentElement;
  const brokenWords = (node) => {
    const broken = [], texts = document.createTreeWalker(node, NodeFilter.SHOW_TEXT), range = document.createRange();
    while (texts.nextNode()) {
      for (const { index, 0: word } of texts.currentNode.data.matchAll(/[\p{L}\d_]+/gu)) {
        range.setStart(texts.currentNode, index);
        range.setEnd(texts.currentNode, index + word.length);
        if (new Set([...range.getClientRects()].map(({ top }) => Math.round(top))).size > 1) broken.push(`"${word}" is broken into lines`);
      }
    }
    return broken;
  };
  if (root.scrollWidth > innerWidth) found.push(`the page is ${root.scrollWidth} wide`);
  const visible = (node) => node.checkVisibility() && node.getBoundingClientRect().width > 0;
  for (const node of document.querySelectorAll("body *")) {
    if (!visible(node) || node.closest("canvas, dialog, option")) continue;
    const box = node.getBoundingClientRect();
    if (box.right > innerWidth + 1 || box.left < -1) found.push(`<${node.localName} id="${node.id}"> reaches from ${box.left} to ${box.right}`);
    if (node.matches("[role=tabpanel], .table, aside, header, .legend") && node.scrollWidth > node.clientWidth + 1) found.push(`<${node.localName} class="${node.className}"> scrolls sideways`);
    // Text that does not fit its element has an ellipsis, and the whole of it in a title.
    if (node.matches("td, th button, button, p, dd, dt, label, h2") && !node.closest("#message, #notice") && node.scrollWidth > node.clientWidth + 1
        && !(getComputedStyle(node).textOverflow === "ellipsis" && node.title)) found.push(`"${node.textContent.slice(0, 30)}" is cut`);
    if (node.matches(".table td") && box.height > 30) found.push(`a row is ${box.height} high: ${node.textContent}`);
    if (node.matches("h1, h2, label, td, th button, dt, [role=tab]")) found.push(...brokenWords(node));
  }
  // Controls and texts do not lie over each other.
  const parts = [...document.querySelectorAll("header .field > *, header button, #state, .legend .row > *, .legend canvas, [role=tab], .field > *, .pairs > *, .hint, h2, .sorted > *, #frame")].filter(visible);
  // Panels scroll inside of their box, so that only what can be seen counts.
  const seen = (node) => {
    const box = node.getBoundingClientRect(), panel = node.closest("[role=tabpanel]")?.getBoundingClientRect();
    return panel ? { left: box.left, right: box.right, top: Math.max(box.top, panel.top), bottom: Math.min(box.bottom, panel.bottom) } : box;
  };
  for (let i = 0; i < parts.length; ++i) {
    for (let j = i + 1; j < parts.length; ++j) {
      if (parts[i].contains(parts[j]) || parts[j].contains(parts[i])) continue;
      const a = seen(parts[i]), b = seen(parts[j]);
      if (Math.min(a.right, b.right) - Math.max(a.left, b.left) > 1.5 && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 1.5) {
        found.push(`"${parts[i].id || parts[i].textContent.slice(0, 20)}" lies over "${parts[j].id || parts[j].textContent.slice(0, 20)}"`);
      }
    }
  }
  return found;
}

browserTest("nothing overlaps, is cut, or scrolls sideways at 400, 800 and 1400 pixels", async ({ open }) => {
  const page = await open(daemon, { scene: "names", samples: "1" });
  await fine(page);
  for (const width of [400, 800, 1400]) {
    await page.setViewportSize({ width, height: 800 });
    for (const view of ["total", "lit", "opacity"]) {
      await page.selectOption("#view", view);
      for (const tab of ["setup", "ray", "ranking", "objects", "area"]) {
        await page.click(`#tab-${tab}`);
        await fine(page);
        if (tab === "ranking") await page.waitForFunction(() => document.querySelectorAll("#panel-ranking tbody tr").length > 0);
        if (tab === "objects") await page.waitForFunction(() => document.querySelectorAll("#panel-objects table")[1].querySelectorAll("tbody tr").length > 0);
        assert.deepEqual(await page.evaluate(faults), [], `${view}, ${tab} at ${width}`);
      }
    }
  }
});

browserTest("columns that do not fit are left out until they are asked for, and a width can be changed", async ({ open }) => {
  const page = await open(daemon, { scene: "names", size: "160x90", panel: "objects" });
  await fine(page);
  const heads = () => page.locator("#panel-objects table").first().locator("th button").allTextContents();
  const width = () => page.evaluate(() => document.querySelector("#panel-objects th").offsetWidth);
  await until(async () => (await heads()).length, "the table");
  const few = await heads();
  assert.deepEqual(few.slice(0, 3), ["Name", "Triangles", "Instances"]);
  await page.locator("#panel-objects .more").first().click();
  assert.deepEqual(await heads(), ["Name", "Triangles", "Instances", "Memory", "SAH", "EPO", "Fill", "Depth", "No."]);
  assert.ok(few.length < 7);
  // A value that was not measured is no 0.
  const epos = () => page.evaluate(() => [...document.querySelectorAll("#panel-objects table")[0].querySelectorAll("tbody tr")].map((row) => row.cells[5].textContent));
  assert.ok((await epos()).every((text) => /^[0-9]/.test(text)), String(await epos()));
  await page.evaluate(() => {
    const { model } = globalThis.raynest;
    for (const row of model.objects) row.epo = null;
    model.dispatchEvent(new Event("change"));
  });
  assert.ok((await epos()).every((text) => text === "–"), String(await epos()));
  await page.locator("#panel-objects .more").first().click();
  const before = await width(), grip = await page.locator("#panel-objects th .grip").first().boundingBox();
  await page.mouse.move(grip.x + 3, grip.y + 5);
  await page.mouse.down();
  await page.mouse.move(grip.x + 43, grip.y + 5, { steps: 4 });
  await page.mouse.up();
  assert.ok(Math.abs(await width() - before - 40) < 3, `${before} and ${await width()}`);
  await page.focus("#panel-objects th button");
  await page.keyboard.press("Shift+ArrowLeft");
  assert.ok(Math.abs(await width() - before - 28) < 3);
  assert.equal(await page.locator("#panel-objects td").first().getAttribute("title"), LONG);
});

browserTest("the end of a long name is seen, as it tells it from others, and the name is read as one", async ({ open }) => {
  const wanted = ["oak", "ash", "elm"].map((word) => `stklib_jungleTree_a_long_way_down_the_tree_of_names_${word}_LOD0`);
  await daemon.loadMeshes("tree names", wanted.map((name, i) => ({ name, node: name, points: [[i, 0, 0], [i + 1, 0, 0], [i, 1, 0]] })));
  const page = await open(daemon, { scene: "tree names", size: "160x90", panel: "ranking" });
  for (const width of [400, 800, 1400]) {
    await page.setViewportSize({ width, height: 800 });
    for (const tab of ["ranking", "objects"]) {
      await page.click(`#tab-${tab}`);
      await fine(page);
      await page.waitForFunction((id) => document.querySelectorAll(`#${id} tbody tr`).length >= 3, `panel-${tab}`);
      const found = await page.evaluate((id) => [...document.querySelector(`#${id} .table`).querySelectorAll("td")].filter((cell) => cell.title.startsWith("stklib")).map((cell) => {
        const tail = cell.lastChild, range = document.createRange(), box = cell.getBoundingClientRect();
        range.setStart(tail, Math.max(tail.length - "oak_LOD0".length, 0));
        range.setEnd(tail, tail.length);
        const { left, right, top } = range.getBoundingClientRect();
        return { name: cell.textContent, seen: left > box.left && right <= box.right && top < box.bottom };
      }), `panel-${tab}`);
      assert.deepEqual(found.map(({ name }) => name).sort(), [...wanted].sort());
      assert.ok(found.every(({ seen }) => seen), `${tab} at ${width}`);
    }
  }
});

browserTest("a long note lies beside the picture where that is small, and its names break behind signs", async ({ open }) => {
  const page = await open(daemon, { scene: "names", size: "160x90", [`SM_Level_Main_Persistent_Lighting_Scenario`]: "1" });
  await page.setViewportSize({ width: 400, height: 800 });
  await fine(page);
  const { note, frame } = await page.evaluate(() => Object.fromEntries(["notice", "frame"].map((id) => [id === "notice" ? "note" : id, document.getElementById(id).getBoundingClientRect()])));
  assert.ok(note.height > 0 && (note.top >= frame.bottom || note.bottom <= frame.top), JSON.stringify([note, frame]));
  assert.ok(await page.locator("#notice wbr").count() > 3);
});

browserTest("a size that is not in the list is one of its entries", async ({ open }) => {
  const page = await open(daemon, { scene: "names", size: "320x240" });
  await fine(page);
  assert.equal(await page.locator("#size option:checked").textContent(), "320 x 240");
  await page.selectOption("#size", "320x180");
  assert.equal(await page.locator("#size option", { hasText: "320 x 240" }).count(), 0);
});

browserTest("the fields of the range show their numbers whole", async ({ open }) => {
  const page = await open(daemon, { scene: "names", size: "160x90", range: "-0.00012346,123456789" });
  await fine(page);
  const cut = await page.evaluate(() => ["range-low", "range-high"].filter((id) => { const field = document.getElementById(id); return field.scrollWidth > field.clientWidth; }));
  assert.deepEqual(cut, []);
});

browserTest("depth begins where the nearest hit is", async ({ open }) => {
  const page = await open(daemon, { scene: "names", size: "160x90", view: "depth", camera: "150,0,150,1,0,0,0,1,0,2" });
  await fine(page);
  const { min, low } = await app(page, ({ legend }) => ({ min: legend.statistics.min, low: legend.scale.low }));
  assert.ok(min > 180);
  assert.equal(low, min);
});

browserTest("columns fit as well in a panel that is opened after its table was filled", async ({ open }) => {
  const widths = async (panel) => {
    const page = await open(daemon, { scene: "names", size: "160x90", panel });
    await fine(page);
    await page.click("#tab-objects");
    await until(() => page.locator("#panel-objects td").count(), "the table");
    await until(() => page.evaluate(() => document.querySelector("#panel-objects th")?.offsetWidth), "the widths");
    return page.evaluate(() => [...document.querySelectorAll("#panel-objects th")].map((head) => head.offsetWidth));
  };
  assert.deepEqual(await widths("setup"), await widths("objects"));
});

test("columns are fitted by their importance", async () => {
  globalThis.document ??= { createElement: () => ({ getContext: () => ({}) }) };
  const { fitColumns } = await import("../../server/web/panels/tables.js");
  const columns = { natural: [300, 50, 60, 70], least: [96, 50, 60, 70], chosen: [], grows: 0 };
  assert.deepEqual(fitColumns(columns, 1000, false), [820, 50, 60, 70]);
  assert.deepEqual(fitColumns(columns, 220, false), [110, 50, 60]);
  assert.deepEqual(fitColumns(columns, 100, false), [96, 50]);
  assert.deepEqual(fitColumns(columns, 100, true), [96, 50, 60, 70]);
  assert.deepEqual(fitColumns({ ...columns, chosen: [200] }, 220, false), [200, 50, 60]);
});

test("numbers are written as people write them", async () => {
  const { bytesText, countText, timeText, valueText, vectorText } = await import("../../server/web/numbers.js");
  assert.deepEqual([85937, 12, 1234567890123n, "4000", undefined].map(countText), ["85,937", "12", "1,234,567,890,123", "4,000", "0"]);
  assert.deepEqual([0, -0, 1.5, 0.1 + 0.2, 1234567.89, 1.2e-7, 93.5 / 3].map((x) => valueText(x)), ["0", "0", "1.5", "0.3", "1,234,568", "1.2e-7", "31.1667"]);
  assert.deepEqual([0, 1023, 1024, 3 * 2 ** 20, 5.5 * 2 ** 30].map(bytesText), ["0 B", "1023 B", "1.0 KiB", "3.0 MiB", "5.5 GiB"]);
  assert.equal(vectorText([1, -0.5, 12345.678]), "1, -0.5, 12345.7");
  assert.deepEqual([0.42, 12.3, 3210].map(timeText), ["0.4 ms", "12 ms", "3.2 s"]);
});

browserTest("sizes are in MiB as the command line's, and auto names what it takes", async ({ open }) => {
  const page = await open(daemon, { scene: "forest", size: "160x90" });
  await fine(page);
  const { bytes } = await daemon.json("info", "forest");
  assert.ok((await page.textContent("#panel-setup")).includes(`Memory${(bytes / 2 ** 20).toFixed(1)} MiB`));
  assert.equal(await page.locator("#intersector option").first().textContent(), "auto (alpha_mask)");
  await page.selectOption("#view", "lit");
  assert.equal(await page.locator("#tonemap option").first().textContent(), "default (agx)");
  await page.selectOption("#integrator", "ao");
  assert.equal(await page.locator("#tonemap option").first().textContent(), "default (none)");
});

browserTest("the same everywhere has the middle of the palette, in the page and in a PNG of the command line", async ({ open }) => {
  const page = await open(daemon, { scene: "names", size: "160x90", view: "instances", camera: "0,50,0,0,100,0,0,0,1,40" });
  await fine(page);
  const { statistics, scale } = await app(page, ({ legend: { statistics: s, scale: c } }) => ({ statistics: s, scale: c }));
  assert.equal(statistics.min, statistics.max);
  await page.selectOption("#view", "nodes");
  await fine(page);
  const nodes = await app(page, ({ legend: { statistics: s, scale: c } }) => ({ ...s, ...c }));
  assert.equal(nodes.min, nodes.max);
  if (nodes.max > 0) assert.equal(nodes.high, 2 * nodes.max);
  assert.ok(scale.high > 0);
  const told = await daemon.json("heatmap", "names", "--lookat", "0,50,0,0,100,0,0,0,1", "--fov", "40", "--size", "160x90", "--metric", "nodes", "-o", `${daemon.folder}/same.png`);
  assert.deepEqual([told.range_low, told.range_high], [nodes.low, nodes.high]);
  const [red, green] = await pixel(page, 80, 45);
  assert.ok(nodes.max === 0 || green > red, `not dark red: ${red}, ${green}`);
});

browserTest("what is selected keeps its colours, and so does everything else but a line around it", async ({ open }) => {
  const page = await open(daemon, { scene: "forest", size: "160x90", camera: "0.5,2,13,0,3,0,0,1,0,50" });
  await fine(page);
  await page.mouse.click(...await windowPoint(page, 80, 60));
  const clicked = await until(() => app(page, ({ selection }) => selection.chosen && String(selection.chosen.first)), "a selection");
  const alphas = () => page.evaluate(() => {
    const canvas = document.getElementById("overlay"), { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    return { covered: data.filter((value, i) => i % 4 === 3 && value > 0).length, all: data.length / 4 };
  });
  /** The overlay's largest alpha within a pixel of the picture. */
  const alphaAt = (x, y) => page.evaluate(([px, py]) => {
    const picture = document.getElementById("picture"), canvas = document.getElementById("overlay");
    const sides = [canvas.width / picture.width, canvas.height / picture.height];
    const [left, top, width, height] = [px * sides[0], py * sides[1], ...sides].map(Math.ceil);
    return Math.max(...canvas.getContext("2d").getImageData(left, top, Math.max(width - 1, 1), Math.max(height - 1, 1)).data.filter((_, i) => i % 4 === 3));
  }, [x, y]);
  await page.click("#tab-ranking");
  await page.waitForFunction(() => document.querySelectorAll("#panel-ranking tbody tr").length > 0);
  await page.keyboard.press("Escape");
  await page.locator("#panel-ranking tbody tr").first().click();
  await until(async () => (await alphas()).covered > 0, "an outline");
  const { covered, all } = await alphas();
  assert.ok(covered < 0.4 * all, `${covered} of ${all} pixels are covered`);
  // The selected pixels themselves are free.
  await page.keyboard.press("Escape");
  await until(async () => (await alphas()).covered === 0, "nothing is selected");
  await app(page, ({ selection }, first) => selection.choose({ kind: "placements", first: BigInt(first), count: 1n, name: "" }), clicked);
  await until(async () => (await alphas()).covered > 0, "an outline");
  assert.equal(await alphaAt(80, 60), 0);
});

/** Saves the page's PNG: its size, and what it holds below the picture. */
async function png(page) {
  await page.click("#share");
  const [download] = await Promise.all([page.waitForEvent("download"), page.getByRole("button", { name: "PNG" }).click()]);
  const text = readFileSync(await download.path()).toString("base64");
  await page.keyboard.press("Escape");
  return page.evaluate(async (base64) => {
    const image = await createImageBitmap(new Blob([Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0))]));
    const context = new OffscreenCanvas(image.width, image.height).getContext("2d");
    context.drawImage(image, 0, 0);
    const { width, height } = document.getElementById("picture"), part = (x, y, w, h) => [...context.getImageData(x, y, w, h).data].join();
    const texts = height + Math.round(62 * Math.max(width / document.getElementById("frame").clientWidth, 1));
    return { picture: part(0, 0, width, height), caption: part(0, texts, image.width, image.height - texts),
             border: new Set([0, 1, 2].map((x) => part(x, texts - 15, 1, 15))).size };
  }, text);
}

browserTest("the page's PNG says scene and camera, and no number touches its border", async ({ open }) => {
  await daemon.loadMeshes("twin", [{ name: "one", points: [[-1, -1, 0], [1, -1, 0], [0, 1, 0]] }]);
  await daemon.loadMeshes("other twin", [{ name: "one", points: [[-1, -1, 0], [1, -1, 0], [0, 1, 0]] }]);
  const made = async (view) => {
    const page = await open(daemon, { scene: "twin", size: "320x180", view: "boxes", camera: "0,0,5,0,0,0,0,1,0,40", ...view });
    await fine(page);
    return png(page);
  };
  const first = await made({});
  assert.deepEqual(await made({}), first);
  assert.equal(first.border, 1, "the first number of the legend stands beside the border");
  const other = await made({ scene: "other twin" });
  assert.equal(other.picture, first.picture);
  assert.notEqual(other.caption, first.caption);
  // A camera that looks at a point further ahead has the same picture.
  const moved = await made({ camera: "0,0,5,0,0,-1,0,1,0,40" });
  assert.equal(moved.picture, first.picture);
  assert.notEqual(moved.caption, first.caption);
});

browserTest("a difference says of what it is: legend, PNG and the file's name", async ({ open }) => {
  const page = await open(daemon, { scene: "forest", size: "320x180", compare: "intersector:opaque", hidden: "i3" });
  await fine(page);
  assert.match(await page.textContent("#legend .title"), /^Total per ray .* less that of opaque: red is more, blue less$/);
  await page.evaluate(() => {
    globalThis.drawn = [];
    const { fillText } = CanvasRenderingContext2D.prototype;
    CanvasRenderingContext2D.prototype.fillText = function told(text, ...place) { globalThis.drawn.push(text); return fillText.call(this, text, ...place); };
  });
  await page.click("#share");
  const [download] = await Promise.all([page.waitForEvent("download"), page.getByRole("button", { name: "PNG" }).click()]);
  assert.equal(download.suggestedFilename(), "forest-total-less-opaque.png");
  const words = (await page.evaluate(() => globalThis.drawn)).join(" ");
  assert.match(words, /forest, alpha_mask: Total per ray \(boxes \+ primitives\) less that of opaque \(1 hidden\)/);
});

browserTest("the ranking comes with the first samples of a lit picture, and what is empty has words", async ({ open }) => {
  const page = await open(daemon, { scene: "forest", size: "320x180", view: "lit", samples: "4096", panel: "ranking" });
  await page.waitForFunction(() => document.querySelectorAll("#panel-ranking tbody tr").length > 0);
  assert.equal(await app(page, ({ picture }) => picture.image.complete), false);
  await page.waitForFunction(() => document.getElementById("ranking-hint").textContent.startsWith("320 x 180 rays"));
  assert.equal(await app(page, ({ picture }) => picture.image.complete), false);
  // A camera that sees nothing.
  await page.selectOption("#samples", "1");
  await app(page, ({ showCamera }) => showCamera({ eye: [0, 500, 0], at: [0, 1000, 0], up: [0, 0, 1], fov: 40, projection: "perspective" }));
  await fine(page);
  await page.waitForFunction(() => document.querySelector("#panel-ranking .none")?.checkVisibility());
  await until(async () => (await page.textContent("#panel-ranking .none")) === "No ray enters any of them.", "words");
});

browserTest("a scene without instances has its work in meshes", async ({ open }) => {
  const file = join(daemon.folder, "points.ply");
  writeFileSync(file, "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n1 0 0\n0 1 0\n");
  await daemon.json("load", file, "--radius", "0.4", "--name", "points");
  const page = await open(daemon, { scene: "points", size: "160x90", panel: "ranking" });
  await fine(page);
  await page.waitForFunction(() => document.querySelectorAll("#panel-ranking tbody tr").length > 0);
  assert.equal(await page.inputValue("#ranking-table"), "meshes");
  assert.equal(await page.locator('#ranking-table option[value="instances"]').count(), 0);
  assert.doesNotMatch(await page.innerText("#panel-ranking"), /No ray enters|Trees above/);
  // What was chosen comes back with a scene that has it.
  await page.selectOption("#scene", "forest");
  await page.waitForFunction(() => document.getElementById("ranking-table").value === "instances" && document.querySelectorAll("#panel-ranking tbody tr").length > 3);
});

test("pixels are those of the device", async () => {
  const context = await browser.newContext({ viewport: { width: 900, height: 600 }, deviceScaleFactor: 2 });
  try {
    const page = await context.newPage();
    await page.goto(`${daemon.page}#scene=forest&size=fit`);
    await fine(page);
    const found = await page.evaluate(() => {
      const { width, height, clientWidth, clientHeight } = document.getElementById("picture");
      return { width, height, clientWidth, clientHeight };
    });
    assert.ok(Math.abs(found.width - 2 * found.clientWidth) <= 1 && Math.abs(found.height - 2 * found.clientHeight) <= 1, JSON.stringify(found));
  } finally {
    await context.close();
  }
});

browserTest("what takes long has a sign that it is on its way", async ({ open }) => {
  const page = await open(daemon, { scene: "forest", size: "160x90" });
  await fine(page);
  assert.equal(await page.locator("#busy").isVisible(), false);
  // A line on which nothing comes for a while.
  await page.evaluate(() => {
    const { send } = WebSocket.prototype;
    WebSocket.prototype.send = function late(data) { setTimeout(() => send.call(this, data), 1500); };
  });
  await page.selectOption("#view", "prims");
  await page.locator("#busy").waitFor({ state: "visible" });
  await fine(page);
  await page.locator("#busy").waitFor({ state: "hidden" });
});

browserTest("a selection says whether hidden boxes are charged, and can leave them out", async ({ open }) => {
  const page = await open(daemon, { scene: "forest", size: "160x90", panel: "objects", isolated: "i3", camera: "0.5,2,13,0,3,0,0,1,0,50" });
  await fine(page);
  const boxes = () => app(page, ({ picture }) => picture.image.values.reduce((a, b) => a + b, 0));
  assert.match(await page.textContent("#hidden-count"), /still counted/);
  const charged = await boxes();
  await page.check("#skip-hidden-boxes");
  await fine(page);
  assert.match(await page.textContent("#hidden-count"), /are not counted/);
  const rest = await boxes();
  assert.ok(rest < charged, `${rest} of ${charged}`);
  const camera = ["--lookat", "0.5,2,13,0,3,0,0,1,0", "--fov", "50", "--size", "160x90", "--only", "inst=3", "-o", `${daemon.folder}/only.npy`];
  const { mean } = await daemon.json("heatmap", "forest", ...camera, "--skip-hidden-boxes");
  assert.ok(Math.abs(mean * 160 * 90 - rest) < 1e-3 * rest, `${mean * 160 * 90} and ${rest}`);
});

/** Saves the page's report; the command line's is the same. Returns it. */
async function report(page) {
  await page.click("#share");
  const [download] = await Promise.all([page.waitForEvent("download"), page.click("text=Report")]);
  const made = readFileSync(await download.path(), "utf8");
  const command = (await page.textContent("#command")).replace("heat.png", "told.html");
  await promisify(execFile)("sh", ["-c", `raynest() { '${raynest}' --server '${daemon.listen}' "$@"; }; ${command}`], { cwd: daemon.folder });
  const told = readFileSync(join(daemon.folder, "told.html"), "utf8");
  // The commands and the link are the reader's own.
  const common = (text) => text.replace(/<p class="command">.*?<\/p>\n/gs, "").replace(/<dt>View.*\n/, "").split("\n");
  assert.deepEqual(common(made), common(told));
  return made;
}

browserTest("a report of a moment says it", async ({ open }) => {
  await daemon.json("load", "builtin:street?seconds=2&cars=2&length=50", "--name", "street");
  const page = await open(daemon, { scene: "street", size: "160x90", view: "boxes", time: "0.5", camera: "-25,6,12,0,1,0,0,1,0,50" });
  await fine(page);
  const made = await report(page);
  assert.match(made, /<dt>Moment<\/dt><dd>0\.5 s of [^<]+<\/dd>/);
  assert.match(made, /<caption>street at 0\.5 s of [^:]+: counters, from \(-25, 6, 12\) to \(0, 1, 0\), 50°</);
});

browserTest("the report of a lit picture says by what light goes, and by what costs are counted", async ({ open }) => {
  await daemon.loadMeshes("pane", [{ name: "pane", points: [[-1, -1, 0], [1, -1, 0], [0, 1, 0]], colour: [1, 0, 0, 0.5] }]);
  const page = await open(daemon, { scene: "pane", size: "160x90", view: "lit", samples: "1", camera: "0,0,5,0,0,0,0,1,0,40" });
  await fine(page);
  await page.click("#share");
  const [download] = await Promise.all([page.waitForEvent("download"), page.click("text=Report")]);
  assert.ok(readFileSync(await download.path(), "utf8").includes("; light follows alpha_blend, costs are counted with opaque<"));
});

browserTest("the report is the command line's, and says scene, metric and camera", async ({ open }) => {
  const page = await open(daemon, { scene: "forest", size: "160x90", view: "boxes", hidden: "i3", camera: "0.5,2,13,0,3,0,0,1,0,50" });
  await fine(page);
  const made = await report(page);
  for (const words of ["<h1>Heat map of forest</h1>", "boxes per ray", "hide inst=3", "boxes of what is hidden counted", "forest: counters, from (0.5, 2, 13) to (0, 3, 0), 50°"]) {
    assert.ok(made.includes(words), words);
  }
});

browserTest("contradictions are named", async ({ open }) => {
  const says = async (message, ...args) => {
    await assert.rejects(daemon.json(...args), ({ stderr }) => message.test(stderr) || assert.fail(stderr));
  };
  await says(/--hide and --only both name outermost instance 3: leave it out of one of them/, "heatmap", "forest", "--hide", "inst=3", "--only", "inst=3", "-o", `${daemon.folder}/x.png`);
  await says(/--hide and --only both name object 1/, "heatmap", "forest", "--hide", "object=1", "--only", "object=1", "-o", `${daemon.folder}/x.png`);
  await says(/--env none has no sky, and --sun is a part of it/, "render", "forest", "--integrator", "path", "--env", "none", "--sun", "90,30", "-o", `${daemon.folder}/x.png`);
  // The page cannot ask for them: without a sky there is no sun to set.
  const page = await open(daemon, { scene: "forest", size: "160x90", view: "lit", samples: "1", env: "none", sun: "90,30" });
  await fine(page);
  assert.ok(await page.isDisabled("#sun"));
  assert.equal(await page.textContent("#message"), "");
});

test("the hint at the start names an address that works through the tunnel", async () => {
  const child = spawn(raynestd, ["--listen", "tcp://127.0.0.1:0", "--http", "127.0.0.1:0", "--cuda", "off"], { stdio: ["ignore", "ignore", "pipe"] });
  try {
    let log = "";
    child.stderr.on("data", (bytes) => { log += bytes; });
    await until(() => /hint="/.test(log), "the hint");
    const [, here, host, there, address] = /hint="from another machine: ssh -L (\d+):([\d.]+):(\d+) HOST, then open (\S+)"/.exec(log);
    // The page answers to its own port alone: the tunnel has it at both ends.
    assert.deepEqual([here, host, new URL(address).port], [there, "127.0.0.1", here]);
    await until(async () => (await fetch(address).catch(() => null))?.status === 200, address);
  } finally {
    child.kill("SIGKILL");
  }
});
