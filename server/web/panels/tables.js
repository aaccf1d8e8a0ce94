// A table whose columns sort, whose rows are chosen with the mouse or the keys, and whose rows have one line each.
// Columns stand in the order of their importance: those that do not fit are left out until a button shows them all.
// The edge of a heading is dragged to change its column's width.
import { element } from "../dom.js";

const PADDING = 11, GRIP_STEP = 12, LEAST = 24;
const MEASURED_ROWS = 400;
const TAIL = 12;  // letters of a name that stay: its end tells it from others

const pen = document.createElement("canvas").getContext("2d");
const widthOf = (text, font) => {
  pen.font = font;
  return Math.ceil(pen.measureText(text).width);
};

const isLong = (text) => text.length > TAIL + 2;

/** A text whose head is cut where it does not fit. It is one line, and reads as the text alone. */
const cuttable = (text) => (isLong(text) ? [element("span", { className: "head" }, text.slice(0, -TAIL)), text.slice(-TAIL)] : [text]);

/**
 * Returns the widths of the columns that are shown: `natural` are the widths of their texts, `least` those below which
 * a column is left out, and `chosen` those that a user has set. What is left over goes to `grows`, a column's index.
 */
export function fitColumns({ natural, least, chosen, grows }, room, all) {
  let count = 0;
  for (let sum = 0; count < natural.length && (all || count < 2 || sum + least[count] <= room); ++count) sum += least[count];
  const widths = least.slice(0, count).map((width, i) => chosen[i] ?? width);
  let rest = room - widths.reduce((a, b) => a + b, 0);
  for (let i = 0; i < count && rest > 0; ++i) {
    if (chosen[i]) continue;
    const more = Math.min(rest, Math.max(natural[i] - widths[i], 0));
    widths[i] += more;
    rest -= more;
  }
  if (rest > 0) widths[Math.min(grows, count - 1)] += rest;
  return widths;
}

/**
 * `columns` are {title, value(row), text(row), number, ascending, least}; `on` has choose(row); `options` are titles that
 * explain columns, `by` the column that sorts at first, and `empty` what stands in place of no rows.
 * Returns {node, show(rows, empty), mark(test)}: mark() selects the rows that pass, and scrolls to the first.
 */
export function sortableTable(caption, columns, on, { titles = {}, by: first = 0, empty = "There are none." } = {}) {
  let rows = [], by = first, down = Boolean(columns[by].number) && !columns[by].ascending, marked = () => false, all = false;
  const chosen = [];
  const textOf = (column, row) => (column.text ?? ((r) => String(column.value(r))))(row);
  const body = element("tbody"), group = element("colgroup");
  const heads = columns.map((column, i) => {
    const grip = element("span", { className: "grip", title: "Drag to change the width; double click: as wide as fits" });
    const head = element("th", { scope: "col", className: column.number ? "number" : "", title: titles[column.title] },
      element("button", { type: "button", onclick: () => { down = by === i ? !down : Boolean(column.number) && !column.ascending; by = i; draw(); },
        onkeydown: (event) => { if (event.shiftKey && /^Arrow(Left|Right)$/.test(event.key)) widen(i, head.offsetWidth + (event.key === "ArrowLeft" ? -GRIP_STEP : GRIP_STEP)); } },
        column.title), grip);
    grip.onpointerdown = (event) => { grip.setPointerCapture(event.pointerId); grip.from = event.clientX - head.offsetWidth; };
    grip.onpointermove = (event) => { if (grip.hasPointerCapture(event.pointerId)) widen(i, event.clientX - grip.from); };
    grip.ondblclick = () => widen(i);
    return head;
  });
  const line = element("tr"), table = element("table", { ariaLabel: caption }, group, element("thead", {}, line), body);
  const none = element("p", { className: "hint none" }, empty);
  const scroller = element("div", { className: "table" }, table, none);
  const more = element("button", { type: "button", className: "more", onclick: () => { all = !all; draw(); } });
  const node = element("div", { className: "sorted" }, scroller, more);
  let shown = 0, measured;  // not yet: what is not shown has no font

  function widen(i, width) {
    if (width === undefined) delete chosen[i]; else chosen[i] = Math.max(width, LEAST);
    fit();
  }

  const fontOf = () => {
    const style = getComputedStyle(table);
    return `${style.fontSize} ${style.fontFamily}`;
  };

  function measure() {
    const font = fontOf();
    const natural = columns.map((column, i) => PADDING + Math.max(widthOf(heads[i].textContent, `600 ${font}`),
      ...rows.slice(0, MEASURED_ROWS).map((row) => widthOf(textOf(column, row), font))));
    const tails = columns.map((column) => Math.max(0, ...rows.slice(0, MEASURED_ROWS).map((row) => textOf(column, row)).filter(isLong).map((text) => widthOf(`…${text.slice(-TAIL)}`, font))));
    const least = natural.map((width, i) => (columns[i].number ? width : Math.min(width, Math.max(columns[i].least ?? 96, PADDING + tails[i], PADDING + widthOf(heads[i].textContent, `600 ${font}`)))));
    return { natural, least };
  }

  /** Gives the columns their widths; the cells are made anew where others are shown than before. */
  function fit() {
    if (!scroller.clientWidth || rows.length === 0) return;
    measured ??= measure();
    const widths = fitColumns({ ...measured, chosen, grows: columns.findIndex((column) => !column.number) }, scroller.clientWidth, all);
    if (widths.length !== shown) fill(widths.length);
    const font = fontOf();
    for (const head of body.querySelectorAll(".head:not([style])")) head.style.maxWidth = `calc(100% - ${widthOf(head.nextSibling.data, font)}px)`;
    group.replaceChildren(...widths.map((width) => element("col", { style: `width: ${width}px` })));
    table.style.width = `${widths.reduce((a, b) => a + b, 0)}px`;
    const left = columns.length - shown;
    more.hidden = left === 0 && !all;
    more.textContent = all ? "Only the columns that fit" : `${left} more column${left === 1 ? "" : "s"}: ${columns.slice(shown).map(({ title }) => title).join(", ")}`;
  }

  function fill(count) {
    shown = count;
    line.replaceChildren(...heads.slice(0, count));
    const { value } = columns[by];
    const order = [...rows].sort((a, b) => {
      const [x, y] = [value(a), value(b)];
      const less = typeof x === "string" ? x.localeCompare(y) : x - y;
      return down ? -less : less;
    });
    body.replaceChildren(...order.map((row) => {
      const made = element("tr", { tabIndex: 0, onclick: () => on.choose(row) },
        columns.slice(0, count).map((column) => {
          const text = textOf(column, row);
          return element("td", { className: column.number ? "number" : "", title: column.number ? undefined : text }, column.number ? text : cuttable(text));
        }));
      made.onkeydown = (event) => {
        if (event.key === "Enter" || event.key === " ") { event.preventDefault(); on.choose(row); }
        if (event.key === "ArrowDown") { event.preventDefault(); made.nextElementSibling?.focus(); }
        if (event.key === "ArrowUp") { event.preventDefault(); made.previousElementSibling?.focus(); }
      };
      made.setAttribute("aria-selected", marked(row));
      made.row = row;
      return made;
    }));
  }

  function draw() {
    none.hidden = rows.length > 0;
    table.hidden = rows.length === 0;
    if (rows.length === 0) more.hidden = true;
    heads.forEach((head, i) => head.setAttribute("aria-sort", i !== by ? "none" : down ? "descending" : "ascending"));
    fill(rows.length ? shown || columns.length : 0);
    measured = undefined;
    fit();
  }
  new ResizeObserver(() => fit()).observe(scroller);
  draw();

  return { node, show: (found, words = empty) => { rows = found; none.textContent = words; draw(); },
           mark: (test) => {
             marked = test;
             for (const made of body.children) made.setAttribute("aria-selected", test(made.row));
             const at = body.querySelector('[aria-selected="true"]');
             // Scroll the table alone: the panel around it stays where it is.
             if (at && !node.contains(document.activeElement)) scroller.scrollTop = Math.max(at.offsetTop - scroller.clientHeight / 2, 0);
           } };
}
