// Numbers as people write them: thousands apart, sizes in MiB, and no digits that mean nothing.

/** "85,940": a whole number in full; BigInt and text, too. */
export const countText = (value) => (typeof value === "number" && !Number.isInteger(value) ? valueText(value) : BigInt(value ?? 0).toLocaleString("en"));

/** "1 tree", "2 trees" */
export const counted = (count, one, many) => `${countText(count)} ${count === 1 ? one : many}`;

/** A measured number in at most `digits` digits; "1.2e-7" where it is tiny or huge, never "-0". */
export function valueText(value, digits = 6) {
  if (!Number.isFinite(value)) return String(value);
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-4 || size >= 1e15)) return String(Number(value.toPrecision(digits)));
  return (value || 0).toLocaleString("en", { maximumSignificantDigits: Math.max(digits, size >= 1 ? Math.min(Math.ceil(Math.log10(size + 1)), 15) : 1) });
}

/** A number of a column, all of which have as many decimals: "31.2", "11.0", and "<0.1" for what is not quite nothing. */
export function fixedText(value, decimals) {
  const least = 10 ** -decimals, shown = value > 0 && value < least / 2 ? least : value;
  return `${shown === value ? "" : "<"}${shown.toLocaleString("en", { minimumFractionDigits: decimals, maximumFractionDigits: decimals })}`;
}

/** As fixedText(); a dash for what was not measured. */
export const measuredText = (value, decimals) => (value === null || value === undefined ? "–" : fixedText(Number(value), decimals));

/** A point or a direction. */
export const vectorText = (values, digits = 6) => [...values].map((value) => valueText(value, digits).replaceAll(",", "")).join(", ");

/** A point that is relative to `origin`, in the world, with the digits that it has there. */
export function placeText(values, origin, digits = 6) {
  const whole = (x) => Math.ceil(Math.log10(Math.abs(x) + 1));
  return [...values].map((x, i) => valueText(x + origin[i], digits + Math.max(0, whole(x + origin[i]) - whole(x))).replaceAll(",", "")).join(", ");
}

/** As the command line has it: "17 B", "32.8 MiB". */
export function bytesText(bytes) {
  const units = ["B", "KiB", "MiB", "GiB", "TiB"];
  let value = Number(bytes), unit = 0;
  for (; value >= 1024 && unit + 1 < units.length; ++unit) value /= 1024;
  return `${value.toFixed(unit === 0 ? 0 : 1)} ${units[unit]}`;
}

/** "15.2 %", in one word: a line never begins with the sign. */
export const percentText = (share, digits = 1) => `${(100 * share).toFixed(digits)}\u00a0%`;

/** "0.4 ms", "12 ms", "3.2 s" */
export const timeText = (ms) => (ms >= 1000 ? `${(ms / 1000).toFixed(1)} s` : `${ms < 10 ? ms.toFixed(1) : ms.toFixed(0)} ms`);
