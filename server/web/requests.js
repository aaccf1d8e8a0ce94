// What the page asks the daemon for, from what it shows: used by pictures, hovering and "copy as command".
import { generator } from "./camera.js";
import { viewOf } from "./views.js";

/** Returns the Job table; `other` is one of the settings of "difference with". */
export function jobOf(state, other = "") {
  const [kind, ...rest] = other.split(":");
  const value = rest.join(":");
  const job = { scene: state.scene, intersector: state.intersector, mask: parseInt(state.mask, 16),
                settings: Object.entries(state.settings).map(([name, text]) => `${name}=${text}`) };
  if (kind === "intersector") return { ...job, intersector: value, settings: [] };
  if (kind === "scene") return { ...job, scene: value };
  if (kind === "mask") return { ...job, mask: parseInt(value, 16) || 0 };
  if (kind === "set") return { ...job, settings: [...job.settings.filter((text) => text.split("=")[0] !== value.split("=")[0]), value] };
  return job;
}

/** True if the state asks for a difference, which only views of values have. */
export const compares = (state) => state.compare !== "" && Boolean(viewOf(state.view).value);

/** Returns the requests of a picture: one, or two for a difference. */
export function pictureRequests(state, width, height) {
  const view = viewOf(state.view);
  const { camera } = state;
  const vec = ([x, y, z]) => ({ x, y, z });
  if (view.render && camera.projection !== "orthographic") {
    return [{ type: "Render", message: { job: jobOf(state), width, height, integrator: "primary",
      camera: { look_at: true, eye: vec(camera.eye), at: vec(camera.at), up: vec(camera.up), fov_degrees: camera.fov } } }];
  }
  // The normal shades the surface behind a heat map; kind `any` has none.
  const needed = view.fields(state);
  const fields = state.kind === "any" && view.counter ? [...needed, "hit"] : [...new Set([...needed, "ng"])];
  const query = (job) => ({ type: "Query", message: { job, kind: view.counter ? state.kind : "closest", fields,
    generator: generator(camera, width, height) } });
  const both = [query(jobOf(state))];
  if (compares(state)) both.push(query(jobOf(state, state.compare)));
  return both;
}
