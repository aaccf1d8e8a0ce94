// The section "Time": moments of the scene's animations, one by one or played. It is there where the scene has any.
import { element, field, fillSelect } from "../dom.js";

export function timeSection({ store, model, picture, showMoment }) {
  const place = element("section", { id: "time-section", hidden: true });
  const animation = element("select", { id: "animation" });
  const slider = element("input", { type: "range", id: "time", min: 0, step: "any", ariaLabel: "Time in seconds" });
  const text = element("output", { id: "time-text" });
  const stop = element("button", { type: "button", id: "time-off", onclick: () => { begin(false); store.set({ time: "", animation: 0 }); } }, "As it was loaded");
  const play = element("button", { type: "button", id: "time-play", onclick: () => begin(!started) });
  const seconds = () => model.info?.animation_seconds?.[store.values.animation] ?? 0;
  animation.onchange = () => {
    store.set({ animation: Number(animation.value), time: 0 });
    if (started) begin(true);
  };
  let started = null;  // {at, from}: since when it plays, and from which moment
  function begin(plays) {
    started = plays ? { at: performance.now(), from: Number(store.values.time) } : null;
    play.textContent = started ? "Stop" : "Play";
    if (started) advance();
  }
  /** Shows the moment that is due. The next one follows the picture of this one, so that no picture is skipped. */
  function advance() {
    const end = Number(seconds());
    if (!started || !(end > 0)) return begin(false);
    const due = (started.from + (performance.now() - started.at) / 1000) % end;
    const time = Math.min(end, Number(due.toPrecision(9)));
    // The same moment has no other picture to wait for.
    return time === store.values.time ? requestAnimationFrame(advance) : showMoment({ time });
  }
  picture.addEventListener("image", () => { if (started) requestAnimationFrame(() => { if (started) advance(); }); });
  store.on(["scene", "time"], ({ time }) => { if (time === "") begin(false); });
  begin(false);
  slider.oninput = () => {
    begin(false);
    const value = Number(slider.value), end = Number(seconds());
    showMoment({ time: Math.min(end, Number(value.toPrecision(6))) });
  };
  const show = () => {
    const names = model.info?.animations ?? [], { time } = store.values;
    place.hidden = names.length === 0;
    fillSelect(animation, names.map((name, i) => [String(i), name || `animation ${i}`]), String(store.values.animation));
    slider.max = seconds();
    slider.value = time === "" ? 0 : time;
    text.textContent = time === "" ? "as it was loaded and edited" : `${Number(time).toFixed(2)} s of ${Number(seconds()).toFixed(2)} s`;
    stop.disabled = time === "";
  };
  store.on(["time", "animation", "scene"], show);
  model.addEventListener("change", show);
  place.append(element("h2", {}, "Time"), field("Animation", animation), field("Moment", slider), text, " ", play, " ", stop);
  show();
  return place;
}
