// Palettes and scales, by the daemon's own arithmetic, so that a picture of the page and one of
// `raynest heatmap` have the same colours.
import { PALETTES } from "./lists.js";

export const STEPS = 256;
export const PALETTE_NAMES = Object.keys(PALETTES);

/** Returns 256 colours as RGBA bytes. */
export function paletteBytes(name) {
  const anchors = PALETTES[name] ?? PALETTES.turbo;
  const bytes = new Uint8Array(4 * STEPS);
  for (let i = 0; i < STEPS; ++i) {
    const scaled = i * (anchors.length - 1);
    const left = Math.min(Math.floor(scaled / (STEPS - 1)), anchors.length - 2);
    const weight = scaled - left * (STEPS - 1);
    [16, 8, 0].forEach((shift, channel) => {
      const a = (anchors[left] >> shift) & 0xff;
      const b = (anchors[left + 1] >> shift) & 0xff;
      bytes[4 * i + channel] = Math.floor((a * (STEPS - 1 - weight) + b * weight) / (STEPS - 1));
    });
    bytes[4 * i + 3] = 255;
  }
  return bytes;
}

/** Returns the place of `value` in a range, 0 to 1; values beyond an end stand at that end. */
export function position(value, { low, high, log }) {
  const inside = Math.min(Math.max(value, low), high) - low;
  if (!log) return inside / (high - low);
  const unit = logUnit(low);
  return Math.log1p(inside / unit) / Math.log1p((high - low) / unit);
}

/** The inverse of position(). */
export function valueAt(place, { low, high, log }) {
  if (!log) return low + place * (high - low);
  const unit = logUnit(low);
  return low + unit * Math.expm1(place * Math.log1p((high - low) / unit));
}

/** A logarithmic scale is log(1 + (value - low) / unit): from 1 on a true logarithm, below it defined at 0. */
export const logUnit = (low) => (low >= 1 ? low : 1);

/** Returns a colour per number, [r, g, b]: far apart for neighbours, and never near black. */
export function idColour(id) {
  let hash = Math.imul((Number(id) >>> 0) ^ 0x9e3779b9, 0x85ebca6b);
  hash = Math.imul(hash ^ (hash >>> 13), 0xc2b2ae35);
  hash ^= hash >>> 16;
  const hue = ((hash >>> 0) % 360) / 60;
  const value = 0.7 + 0.3 * (((hash >>> 9) & 0xff) / 255);
  const saturation = 0.45 + 0.4 * (((hash >>> 17) & 0xff) / 255);
  const channel = (n) => {
    const k = (n + hue) % 6;
    return Math.round(255 * value * (1 - saturation * Math.max(0, Math.min(k, 4 - k, 1))));
  };
  return [channel(5), channel(3), channel(1)];
}
