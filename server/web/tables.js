// A table whose columns sort, and whose rows are chosen with the mouse or the keys.
import { element } from "./dom.js";

/**
 * `columns` are {title, value(row), text(row), number, ascending}; `on` has choose(row); `titles` explain columns.
 * Returns {node, show(rows), mark(test)}: mark() selects the rows that pass, and scrolls to the first.
 */
export function sortableTable(caption, columns, on, titles = {}) {
  let rows = [], by = 0, down = Boolean(columns[0].number) && !columns[0].ascending, chosen = () => false;
  const body = element("tbody");
  const heads = columns.map((column, i) => element("th", { scope: "col", className: column.number ? "number" : "", title: titles[column.title] },
    element("button", { type: "button", onclick: () => { down = by === i ? !down : Boolean(column.number); by = i; draw(); } }, column.title)));
  const node = element("div", { className: "table" },
    element("table", { ariaLabel: caption }, element("thead", {}, element("tr", {}, heads)), body));

  function draw() {
    heads.forEach((head, i) => head.setAttribute("aria-sort", i !== by ? "none" : down ? "descending" : "ascending"));
    const { value } = columns[by];
    const order = [...rows].sort((a, b) => {
      const [x, y] = [value(a), value(b)];
      const less = typeof x === "string" ? x.localeCompare(y) : x - y;
      return down ? -less : less;
    });
    body.replaceChildren(...order.map((row) => {
      const line = element("tr", { tabIndex: 0, onclick: () => on.choose(row) },
        columns.map((column) => element("td", { className: column.number ? "number" : "" }, (column.text ?? ((r) => String(column.value(r))))(row))));
      line.onkeydown = (event) => {
        if (event.key === "Enter" || event.key === " ") { event.preventDefault(); on.choose(row); }
        if (event.key === "ArrowDown") { event.preventDefault(); line.nextElementSibling?.focus(); }
        if (event.key === "ArrowUp") { event.preventDefault(); line.previousElementSibling?.focus(); }
      };
      line.setAttribute("aria-selected", chosen(row));
      line.row = row;
      return line;
    }));
  }
  return { node, show: (found) => { rows = found; draw(); },
           mark: (test) => {
             chosen = test;
             for (const line of body.children) line.setAttribute("aria-selected", test(line.row));
             const first = body.querySelector('[aria-selected="true"]');
             // Scroll the table alone: the panel around it stays where it is.
             if (first && !node.contains(document.activeElement)) node.scrollTop = Math.max(first.offsetTop - node.clientHeight / 2, 0);
           } };
}
