// Statistics and histogram of the values of a picture. Values that are not a number are left out.
import { valueAt } from "./palette.js";

const finite = (values) => values.filter(Number.isFinite).sort();

/** Returns {count, min, mean, p50, p90, p99, max}; percentiles by nearest rank, as the daemon's. */
export function statistics(values) {
  const sorted = finite(values);  // a typed array: sort() is numeric
  const count = sorted.length;
  if (count === 0) return { count, min: 0, mean: 0, p50: 0, p90: 0, p99: 0, max: 0, p99Size: 0 };
  let sum = 0;
  for (const value of sorted) sum += value;
  const rank = (percent) => sorted[Math.max(Math.ceil((count * percent) / 100), 1) - 1];
  // Values without their signs: those of a difference lie on both sides of 0.
  const sizes = sorted[0] < 0 ? sorted.map(Math.abs).sort() : sorted;
  return { count, min: sorted[0], mean: sum / count, p50: rank(50), p90: rank(90), p99: rank(99),
           max: sorted[count - 1], p99Size: sizes[Math.max(Math.ceil((count * 99) / 100), 1) - 1] };
}

/** Returns the range that a setting stands for: p99, auto or [low, high]. */
export function rangeOf(setting, stats, diverging) {
  // Both sides of a difference are as long.
  if (Array.isArray(setting) && diverging) setting = [-1, 1].map((sign) => sign * Math.max(...setting.map(Math.abs)));
  if (Array.isArray(setting)) return { low: setting[0], high: setting[1] };
  if (diverging) {
    // Where few pixels differ, the range is theirs.
    const largest = setting === "auto" || stats.p99Size === 0 ? Math.max(Math.abs(stats.min), Math.abs(stats.max)) : stats.p99Size;
    const most = Math.max(largest, Number.isInteger(largest) ? 1 : 1e-9);
    return { low: -most, high: most };
  }
  const low = Math.min(0, stats.min);
  let high = setting === "auto" ? stats.max : stats.p99;
  // The same everywhere is not the most: it has the middle of the palette.
  if (high === stats.min && high > 0) high *= 2;
  return { low, high: Math.max(high, low + (Number.isInteger(high) ? 1 : 1e-9)) };
}

/** Returns how many values fall into each of `count` bins of equal width on the scale. */
export function histogram(values, scale, count) {
  const bins = new Float64Array(count);
  const edges = Float64Array.from({ length: count + 1 }, (_, i) => valueAt(i / count, scale));
  const width = (scale.high - scale.low) / count;
  for (const value of values) {
    if (!(value >= scale.low && value <= scale.high)) continue;
    let bin = 0;
    if (scale.log) {
      let last = count;
      while (last - bin > 1) {
        const middle = (bin + last) >> 1;
        if (edges[middle] <= value) bin = middle; else last = middle;
      }
    } else {
      bin = Math.min(Math.floor((value - scale.low) / width), count - 1);
    }
    ++bins[bin];
  }
  return bins;
}

/** Returns round values inside the scale for its ticks: 1, 2 or 5 times a power of ten; on a logarithmic one the low end, and 1 or 3 times. */
export function ticks(scale, count) {
  const found = [];
  if (scale.log && scale.high > 1) {
    for (let decade = 1; decade <= scale.high; decade *= 10) {
      for (const value of [decade, 3 * decade]) if (value > scale.low && value <= scale.high) found.push(value);
    }
    if (found.length > 1) return [scale.low, ...found.filter((_, i) => found.length <= count || i % Math.ceil(found.length / count) === 0)];
    found.length = 0;  // within one decade the scale is nearly linear
  }
  const wanted = (scale.high - scale.low) / count;
  const power = 10 ** Math.floor(Math.log10(wanted));
  const step = [1, 2, 5, 10].map((digit) => digit * power).find((size) => size >= wanted);
  for (let i = Math.ceil(scale.low / step - 1e-9); i * step <= scale.high * (1 + 1e-9); ++i) found.push(i * step);
  return found;
}
