// Mouse, wheel and keys on the picture: orbit, first person and free camera. Shift-drag selects a rectangle.
import { distance, dolly, halfHeight, look, move, orbit, roll, rounded } from "./camera.js";

const TURN = 0.006;  // radians per pixel
const CLICK_PIXELS = 4;
const STEP = 0.06;   // a share of the distance, for each press of a key

/** `on` has change(camera), hover(x, y) or hover(null), click(x, y), rectangle(from, to, done). */
export function steer(frame, store, on) {
  let drag = null;
  const camera = () => store.values.camera;
  const apply = (next) => on.change(rounded(next));

  frame.addEventListener("pointerdown", (event) => {
    if (!camera()) return;
    frame.focus({ preventScroll: true });
    frame.setPointerCapture(event.pointerId);
    const kind = event.shiftKey && event.button === 0 ? "rectangle" : event.button === 0 ? "turn" : "pan";
    drag = { kind, x: event.clientX, y: event.clientY, from: [event.clientX, event.clientY], moved: false };
  });
  frame.addEventListener("pointermove", (event) => {
    if (!drag) return on.hover(event.clientX, event.clientY);
    const dx = event.clientX - drag.x, dy = event.clientY - drag.y;
    drag.moved ||= Math.hypot(event.clientX - drag.from[0], event.clientY - drag.from[1]) > CLICK_PIXELS;
    if (!drag.moved) return;
    [drag.x, drag.y] = [event.clientX, event.clientY];
    if (drag.kind === "rectangle") on.rectangle(drag.from, [drag.x, drag.y], false);
    else if (drag.kind === "pan") pan(dx, dy);
    else turn(dx * TURN, dy * TURN);
  });
  frame.addEventListener("pointerup", (event) => {
    const ended = drag;
    drag = null;
    if (!ended) return;
    if (!ended.moved) { if (event.button === 0) on.click(event.clientX, event.clientY); }
    else if (ended.kind === "rectangle") on.rectangle(ended.from, [event.clientX, event.clientY], true);
  });
  frame.addEventListener("pointercancel", () => { drag = null; });
  frame.addEventListener("pointerleave", () => on.hover(null));
  frame.addEventListener("contextmenu", (event) => event.preventDefault());
  frame.addEventListener("wheel", (event) => {
    event.preventDefault();
    if (camera()) nearer(Math.exp(Math.min(Math.max(event.deltaY, -300), 300) * 0.0012));
  }, { passive: false });
  frame.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || !camera()) return;
    const action = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    event.preventDefault();
    action(event.shiftKey ? 4 : 1);
  });

  function turn(across, down) {
    const { control } = store.values;
    if (control === "orbit") apply(orbit(camera(), across, down));
    else apply(look(camera(), across, down, control === "free"));
  }
  function pan(dx, dy) {
    const size = (2 * halfHeight(camera())) / frame.clientHeight;
    apply(move(camera(), -dx * size, dy * size, 0));
  }
  function nearer(factor) {
    const { control } = store.values;
    if (control === "orbit" || camera().projection === "orthographic") apply(dolly(camera(), factor));
    else apply(move(camera(), 0, 0, (1 - factor) * distance(camera())));
  }
  const walk = (x, y, z) => (times) => {
    const step = times * STEP * distance(camera());
    apply(move(camera(), x * step, y * step, z * step));
  };
  const rolled = (angle) => () => { if (store.values.control === "free") apply(roll(camera(), angle)); };
  const keys = {
    ArrowLeft: (n) => turn(-0.08 * n, 0), ArrowRight: (n) => turn(0.08 * n, 0),
    ArrowUp: (n) => turn(0, -0.08 * n), ArrowDown: (n) => turn(0, 0.08 * n),
    "+": (n) => nearer(0.9 ** n), "=": (n) => nearer(0.9 ** n), "-": (n) => nearer(1.1 ** n), "_": (n) => nearer(1.1 ** n),
    w: walk(0, 0, 1), s: walk(0, 0, -1), a: walk(-1, 0, 0), d: walk(1, 0, 0), e: walk(0, 1, 0), q: walk(0, -1, 0),
    ",": rolled(0.05), ".": rolled(-0.05),
  };
}
