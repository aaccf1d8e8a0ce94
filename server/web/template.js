// Fills the text of the report, protocol/report.html, by the rules and filters of client/output/template.h: the command line fills
// the same text, and a test compares the two.

const escaped = (text) => String(text).replace(/[&<>"']/g, (c) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "'": "&#39;" })[c]);
const isShown = (value) => (Array.isArray(value) ? value.length > 0 : !(value === null || value === undefined || value === false || value === ""));
const grouped = (value) => BigInt(value).toLocaleString("en");

/** The rectangles of a histogram of 1200 x 160. */
function barsOf(counts) {
  const most = counts.reduce((a, b) => Math.max(a, b), 1), step = 1200 / counts.length;
  return counts.flatMap((count, i) => {
    if (count === 0) return [];
    const tall = Math.max(2, (160 * Math.log1p(count)) / Math.log1p(most));
    return [{ x: (i * step).toFixed(2), y: (160 - tall).toFixed(1), width: (step - 1).toFixed(2), height: tall.toFixed(1) }];
  });
}

/** "77" or "77..80": the paths of an instance; the number of an object or material. */
function numberOf({ path, placements, index }) {
  if (path === undefined) return typeof index === "number" ? String(index) : "";
  return BigInt(placements) < 2n ? String(path) : `${path}..${BigInt(path) + BigInt(placements) - 1n}`;
}

function aboutOf(finding) {
  const kind = ["object", "material"].find((name) => typeof finding[name] === "number");
  return kind ? ` (${kind} ${finding[kind]})` : "";
}

const signed = (text, value, differs) => (differs && value > 0 ? `+${text}` : text);
const FILTERS = {
  any: (value) => isShown(value), positive: (value) => Number(value) > 0, count: grouped,
  delta: (value, differs) => signed(grouped(value), value, differs), before: (value) => value - 1,
  percent: (value) => `${(100 * value).toFixed(1)} %`, one: (value) => value.toFixed(1), two: (value, differs) => signed(value.toFixed(2), value, differs),
  three: (value) => (Math.abs(value) >= 100 ? value.toFixed(0) : String(Number(value.toPrecision(3)))),
  bars: barsOf, number: numberOf, about: aboutOf, words: (value) => value.replaceAll("_", " "),
  name: (row) => (row.name === null ? "(none)" : row.name || (row.index === undefined ? "(without a name)" : `#${row.index}`)),
  of_mesh: ({ mesh, name }) => (mesh === name ? null : mesh), entries: (value) => Object.entries(value).map(([key, entry]) => ({ key, value: entry })),
};

/** `bytes` is the filter of that name. Sections of the text must be closed, and its filters known. */
export function fillTemplate(text, values, bytes) {
  const stack = [values], filters = { ...FILTERS, bytes };
  const below = (value, path) => path.split(".").reduce((at, key) => (at === null || typeof at !== "object" ? undefined : at[key]), value);
  const find = (path) => {
    if (path === ".") return stack.at(-1);
    for (let i = stack.length; i-- > 0;) {
      const found = below(stack[i], path);
      if (found !== undefined) return found;
    }
    return null;
  };
  const valueOf = (word) => {
    const [path, ...names] = word.split("|");
    const differs = isShown(find("heat.other"));
    return names.reduce((value, name) => (name.startsWith("is:") ? value === name.slice(3)
      : value === null && !["any", "positive"].includes(name) ? null : filters[name](value, differs)), find(path));
  };
  const fill = (part) => {
    let made = "";
    for (;;) {
      const begin = part.indexOf("{{");
      if (begin < 0) return made + part;
      const end = part.indexOf("}}", begin);
      made += part.slice(0, begin);
      const word = part.slice(begin + 2, end);
      part = part.slice(end + 2);
      if (!"#^".includes(word[0])) {
        made += escaped(valueOf(word) ?? "");
        continue;
      }
      const closing = `{{/${word.slice(1)}}}`, close = part.indexOf(closing), inside = part.slice(0, close);
      part = part.slice(close + closing.length);
      const value = valueOf(word.slice(1));
      if ((word[0] === "^") === isShown(value)) continue;
      for (const one of Array.isArray(value) && word[0] === "#" ? value : [value]) {
        stack.push(one);
        made += fill(inside);
        stack.pop();
      }
    }
  };
  return fill(text);
}
