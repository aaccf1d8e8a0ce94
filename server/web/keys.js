// Shortcuts of the whole page, and the list of all of them under "?".
import { byId, element } from "./dom.js";

const OF_PICTURE = [["Drag, arrow keys", "Turn the camera"], ["Right drag", "Move the camera sideways"], ["Wheel, + and -", "Nearer, farther"],
  ["W A S D, Q E", "Walk, down and up (with Shift faster)"], [", and .", "Roll (free camera)"], ["Shift + drag", "Statistics of a rectangle"],
  ["Click, Enter", "Keep the ray under the pointer (Enter: in the middle)"]];

/** `actions` are {key, text, run}. */
export function startKeys(actions) {
  const help = () => showDialog("Shortcuts", element("table", {}, element("tbody", {}, [
    ...OF_PICTURE, ...actions.map(({ key, text }) => [key, text]), ["?", "This list"]].map(([key, text]) =>
      element("tr", {}, element("td", {}, element("kbd", {}, key)), element("td", {}, text))))));
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.closest("input, select, textarea, dialog")) return;
    if (event.key === "?") return help();
    actions.find(({ key }) => key.toLowerCase() === event.key.toLowerCase())?.run();
  });
  return help;
}

/** Shows a dialog with a title, any node, and a button that closes it. */
export function showDialog(title, content, ...buttons) {
  const dialog = byId("dialog");
  const close = element("button", { type: "button", className: "primary", onclick: () => dialog.close() }, "Close");
  dialog.replaceChildren(element("h2", { id: "dialog-title" }, title), content, element("p", { className: "buttons" }, ...buttons, close));
  if (!dialog.open) dialog.showModal();
}
