// Pictures of the command line, for comparison.
import { execFile } from "node:child_process";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { promisify } from "node:util";
import { raynest } from "./harness.mjs";

/** Runs the text of "Copy as command" in a shell and returns its picture, a PNG in base64. */
export async function runCommand(page, daemon) {
  await page.click("#share");
  const command = await page.textContent("#command");
  await page.keyboard.press("Escape");
  const program = `raynest() { '${raynest}' --server '${daemon.listen}' "$@"; }; ${command}`;
  await promisify(execFile)("sh", ["-c", program], { cwd: daemon.folder });
  const [, file] = /-o (\S+)/.exec(command);
  return readFileSync(join(daemon.folder, file)).toString("base64");
}
