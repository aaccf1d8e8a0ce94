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

/** Returns how the drawn picture differs from a PNG, or ""; runs in the page. */
export async function differences(png) {
  const image = await createImageBitmap(new Blob([Uint8Array.from(atob(png), (c) => c.charCodeAt(0))]));
  const drawn = document.getElementById("picture");
  const bytes = (source) => {
    const canvas = new OffscreenCanvas(drawn.width, drawn.height), context = canvas.getContext("2d");
    // The page's background, where a picture is transparent.
    context.fillStyle = "rgb(46 46 46)";
    context.fillRect(0, 0, drawn.width, drawn.height);
    context.drawImage(source, 0, 0);
    return context.getImageData(0, 0, drawn.width, drawn.height).data;
  };
  if (image.width < drawn.width || image.height < drawn.height) return `size ${image.width}x${image.height}`;
  const [a, b] = [bytes(drawn), bytes(image)];
  let count = 0, first = -1;
  for (let i = 0; i < a.length; ++i) if (Math.abs(a[i] - b[i]) > 2) { ++count; if (first < 0) first = i; }
  return count ? `${count} bytes differ, the first at pixel ${first >> 2}: ${a.slice(first, first + 4)} and ${b.slice(first, first + 4)}` : "";
}
