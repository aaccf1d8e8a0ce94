// The page over https: it asks for the token once, and `raynest open` logs in without asking.
import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after } from "node:test";
import { axePath, browserTest, fine, raynest, raynestd, TestDaemon, until } from "./harness.mjs";

const folder = mkdtempSync(join(tmpdir(), "raynest-login-"));
const tokens = join(folder, "tokens"), tls = join(folder, "tls");
const said = (program, args, env = {}) => execFileSync(program, args, { encoding: "utf8", env: { ...process.env, ...env } });
const token = (act, name, ...more) => said(raynestd, ["token", act, name, "--tokens", tokens, ...more]).trim().split("\n").at(-1);
said(raynestd, ["tls", "init", tls]);
const alice = token("add", "alice"), bob = token("add", "bob");

const daemon = new TestDaemon("--tls-cert", join(tls, "cert.pem"), "--tls-key", join(tls, "key.pem"), "--tokens", tokens);
daemon.http = "https://127.0.0.1:0";
daemon.listen = "tls://127.0.0.1:0";
const known = { RAYNEST_CA: join(tls, "ca.pem"), RAYNEST_TOKEN: alice };
Object.assign(process.env, known);  // for the command line of the harness
await daemon.start();
after(async () => {
  await daemon.end();
  rmSync(folder, { recursive: true, force: true });
});
await daemon.json("load", "builtin:forest", "--share", "public");
const FOREST = { scene: "alice/forest", size: "320x180" };

/** Waits for the form, and writes a token into it. */
async function logIn(page, secret) {
  await page.waitForSelector("#login");
  await page.fill("#token", secret);
  await page.keyboard.press("Enter");
}

browserTest("the page asks for the token once", async ({ open, context, errors }) => {
  const page = await open(daemon, FOREST);
  await page.waitForSelector("#login");
  assert.equal(await page.evaluate(() => document.activeElement.id), "token");
  await page.evaluate(readFileSync(axePath(), "utf8"));
  assert.deepEqual(await page.evaluate(async () => (await globalThis.axe.run()).violations.map(({ id }) => id)), []);
  await logIn(page, alice.slice(0, 40));
  await page.waitForFunction(() => document.getElementById("message").textContent.includes("unknown here"));
  assert.equal(await page.evaluate(() => document.activeElement.id), "token");
  await logIn(page, alice);
  await fine(page);
  assert.match(page.url(), /#scene=alice/);
  assert.match(await page.getAttribute("#state", "title"), /as alice \(user\)/);
  // Scripts do not see the cookie; it is sent to this site alone, and over TLS.
  assert.equal(await page.evaluate(() => document.cookie), "");
  const cookies = await context.cookies();
  assert.deepEqual(cookies.map(({ httpOnly, secure, sameSite }) => [httpOnly, secure, sameSite]), [[true, true, "Strict"]]);
  assert.match(cookies[0].name, /^__Host-raynest-\d+$/);
  const second = await open(daemon, FOREST);
  await fine(second);
  await page.click("#log-out");
  await page.waitForSelector("#login");
  await second.waitForSelector("#login");
  errors.length = 0;  // the browser reports each 401
});

browserTest("raynest open logs in as its caller, once", async ({ context, errors }) => {
  const address = JSON.parse(said(raynest, ["--server", daemon.listen, "--json", "open", "alice/forest"], { DISPLAY: "", WAYLAND_DISPLAY: "" })).address;
  assert.match(address, /#scene=alice%2Fforest&code=[0-9a-f]{64}$/);
  const page = await context.newPage();
  page.on("dialog", (dialog) => dialog.accept());
  await page.goto(address);
  await fine(page);
  assert.ok(!page.url().includes("code="));
  assert.match(await page.getAttribute("#state", "title"), /as alice/);
  await context.clearCookies();
  const again = await context.newPage();
  await again.goto(address);
  await again.waitForFunction(() => document.getElementById("message").textContent.includes("was used"));
  await logIn(again, alice);
  await fine(again);
  errors.length = 0;
});

browserTest("a link logs nobody in before it has asked", async ({ context, errors }) => {
  const address = JSON.parse(said(raynest, ["--server", daemon.listen, "--json", "open", "alice/forest"], { DISPLAY: "", WAYLAND_DISPLAY: "" })).address;
  const page = await context.newPage();
  const asked = [];
  page.on("dialog", (dialog) => { asked.push(dialog.message()); dialog.dismiss(); });
  await page.goto(address);
  await page.waitForFunction(() => !location.hash.includes("code="));
  await until(() => asked.length === 1, "a question");
  assert.match(asked[0], /not logged in, and the address logs it in as alice. Agree only if you made this address yourself/);
  await page.waitForSelector("#login");
  assert.deepEqual(await context.cookies(), []);
  await logIn(page, bob);
  await fine(page);
  assert.match(await page.getAttribute("#state", "title"), /as bob/);
  errors.length = 0;
});

browserTest("a link that logs in as another asks first", async ({ open, context, errors }) => {
  const page = await open(daemon, FOREST);
  await logIn(page, bob);
  await fine(page);
  const address = () => JSON.parse(said(raynest, ["--server", daemon.listen, "--json", "open", "alice/forest"], { DISPLAY: "", WAYLAND_DISPLAY: "" })).address;
  for (const agrees of [false, true]) {
    const other = await context.newPage();
    const asked = [];
    other.on("dialog", (dialog) => { asked.push(dialog.message()); agrees ? dialog.accept() : dialog.dismiss(); });
    await other.goto(address());
    await fine(other);
    assert.equal(asked.length, 1);
    assert.match(asked[0], /logged in as bob, and the address logs it in as alice/);
    assert.match(await other.getAttribute("#state", "title"), agrees ? /as alice/ : /as bob/);
    await other.close();
  }
  errors.length = 0;
});

browserTest("a revoked token ends the open page", async ({ open, errors }) => {
  const mallory = token("add", "mallory");
  try {
    const page = await open(daemon, FOREST);
    await logIn(page, mallory);
    await fine(page);
    token("revoke", "mallory");
    await page.waitForSelector("#login");  // page_login_test.py measures how soon
    await logIn(page, mallory);
    await page.waitForFunction(() => document.getElementById("message").textContent.includes("unknown here"));
  } finally {
    errors.length = 0;
    try { token("revoke", "mallory"); } catch { /* it is revoked */ }
  }
});

browserTest("a daemon that starts anew asks again", async ({ open, errors }) => {
  const page = await open(daemon, FOREST);
  await logIn(page, alice);
  await fine(page);
  await daemon.stop();
  await page.waitForFunction(() => document.getElementById("state").textContent.includes("away"));
  await daemon.start();
  await daemon.json("load", "builtin:forest", "--share", "public");
  await page.waitForSelector("#login");
  await logIn(page, alice);
  await fine(page);
  assert.ok(await until(() => page.url().includes("scene=alice"), "the view is kept"));
  errors.length = 0;
});
