// Makes elements. Every text goes in as text: names of a scene can never become HTML.

/** element("button", {type: "button", onclick: f, ariaLabel: "…"}, "text", child, …) */
export function element(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (value === undefined) continue;
    if (name.startsWith("data-") || name.startsWith("aria-") || ["role", "for", "list"].includes(name)) made.setAttribute(name, value);
    else made[name] = value;
  }
  made.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return made;
}

/** A text whose names may break behind a sign, and not in the middle of a word. */
export const breakable = (text) => text.split(/(?<=[_/.#-])/).flatMap((part, i) => (i ? [element("wbr"), part] : [part]));

export const byId = (id) => document.getElementById(id);

/** A select of [value, label] pairs, or of {group, options} of such pairs. */
export function fillSelect(select, options, value) {
  const option = ([key, label]) => element("option", { value: key }, label);
  select.replaceChildren(...options.map((entry) => entry.group
    ? element("optgroup", { label: entry.group }, entry.options.map(option)) : option(entry)));
  select.value = value;
}

let labels = 0;
/** A label and its control, in a row. */
export function field(label, control, title) {
  control.id ||= `field-${++labels}`;
  return element("div", { className: "field", title }, element("label", { for: control.id }, label), control);
}

/** A table of [name, value] rows. */
export function pairs(rows) {
  return element("dl", { className: "pairs" }, rows.flatMap(([name, value]) =>
    [element("dt", {}, name), element("dd", {}, typeof value === "string" ? breakable(value) : value)]));
}
