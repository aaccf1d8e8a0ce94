// Statistics and histogram of the values of a picture. Values that are not a number are left out.
import { valueAt } from "./palette.js";

const finite = (values) => values.filter(Number.isFinite).sort();

const percentile = (sorted, percent) => sorted[Math.max(Math.ceil((sorted.length * percent) / 100), 1) - 1];

/** Returns {count, min, mean, p50, p90, p99, max}; percentiles by nearest rank, as the daemon's. And {end, endSize}: where the range p99 ends, of a difference on both sides. */
export function statistics(values) {
  const sorted = finite(values);  // a typed array: sort() is numeric
  const count = sorted.length;
  if (count === 0) return { count, min: 0, mean: 0, p50: 0, p90: 0, p99: 0, max: 0, end: 0, endSize: 0 };
  let sum = 0;
  for (const value of sorted) sum += value;
  const [p50, p90, p99] = [50, 90, 99].map((percent) => percentile(sorted, percent)), min = sorted[0], max = sorted[count - 1];
  // Values without their signs: those of a difference lie on both sides of 0.
  let sizes = min < 0 ? sorted.map(Math.abs).sort() : sorted;
  // Where few pixels differ, the range is theirs.
  if (percentile(sizes, 99) < 0.01 * sizes[count - 1]) sizes = sizes.filter((size) => size !== 0);
  return { count, min, mean: sum / count, p50, p90, p99, max, end: endOfMost(sorted, min), endSize: endOfMost(sizes, 0) };
}

/** The 99th percentile; the largest value where many pixels have the percentile: a range that ended there would draw them as all that exceed them. The daemon's rule, too. */
function endOfMost(sorted, least) {
  const end = percentile(sorted, 99);
  const [atEnd, above] = [sorted.filter((value) => value === end).length, sorted.filter((value) => value > least).length];
  return 20 * atEnd < above ? end : sorted[sorted.length - 1];
}

/** Returns the range that a setting stands for: p99, auto or [low, high]. It begins at 0, or `fromLeast` at the least value. */
export function rangeOf(setting, stats, diverging, fromLeast = false) {
  // Both sides of a difference are as long.
  if (Array.isArray(setting) && diverging) setting = [-1, 1].map((sign) => sign * Math.max(...setting.map(Math.abs)));
  if (Array.isArray(setting)) return { low: setting[0], high: setting[1] };
  if (diverging) {
    const largest = setting === "auto" ? Math.max(Math.abs(stats.min), Math.abs(stats.max)) : stats.endSize;
    const most = Math.max(largest, Number.isInteger(largest) ? 1 : 1e-9);
    return { low: -most, high: most };
  }
  let high = setting === "auto" ? stats.max : stats.end;
  const low = fromLeast && high > stats.min ? stats.min : Math.min(0, stats.min);
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
