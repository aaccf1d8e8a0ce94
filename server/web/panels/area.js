// The panel "Area": statistics of the pixels in a rectangle that was dragged over the picture.
import { element, pairs } from "../dom.js";
import { statistics } from "../histogram.js";
import { countText, percentText, valueText } from "../numbers.js";

export const areaPanel = { id: "area", title: "Area", build };

/** Returns the values inside a rectangle of pixels, ends included. */
export function valuesInside({ values, width, height }, [x0, y0], [x1, y1]) {
  const [left, right] = [Math.max(Math.min(x0, x1), 0), Math.min(Math.max(x0, x1), width - 1)];
  const [top, bottom] = [Math.max(Math.min(y0, y1), 0), Math.min(Math.max(y0, y1), height - 1)];
  const inside = new Float32Array(Math.max(right - left + 1, 0) * Math.max(bottom - top + 1, 0));
  let at = 0;
  for (let y = top; y <= bottom; ++y) for (let x = left; x <= right; ++x) inside[at++] = values[y * width + x];
  return inside;
}

function build({ store, picture, area }, place) {
  const hint = element("p", { className: "hint" }, "Drag with Shift over the picture to get the statistics of a rectangle.");
  const facts = element("div", { id: "area-statistics" });
  place.append(hint, facts);
  const show = () => {
    const { image } = picture;
    if (!image || store.values.panel !== "area") return;
    if (!image.view.value) {
      facts.replaceChildren(element("p", { className: "hint" }, "This view has colours, not values. Choose one of cost or depth."));
      return;
    }
    const [from, to] = area.rectangle ?? [[0, 0], [image.width - 1, image.height - 1]];
    const values = valuesInside(image, from, to), s = statistics(values);
    const total = values.reduce((sum, value) => sum + (Number.isFinite(value) ? value : 0), 0);
    const all = image.values.reduce((sum, value) => sum + (Number.isFinite(value) ? value : 0), 0);
    facts.replaceChildren(element("h2", {}, area.rectangle ? "Rectangle" : "Whole picture"), pairs([
      ["Metric", image.view.label], ["From", from.join(", ")], ["To", to.join(", ")], ["Pixels", countText(s.count)],
      ...["min", "mean", "p50", "p90", "p99", "max"].map((name) => [name, valueText(s[name])]),
      ["Sum", valueText(total)], ["Share of all", percentText(all ? total / all : 0, 2)]]));
  };
  area.addEventListener("change", show);
  picture.addEventListener("image", show);
  store.on(["panel"], show);
  show();
}
