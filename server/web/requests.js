// The requests of the page, made from what it shows: used by pictures, hovering and "copy as command".
import { cameraTable, generator } from "./camera.js";
import { lightOf } from "./light.js";
import { viewOf } from "./views.js";

/** The fields of a request that name the moment which the page shows. */
export const momentOf = (state) => state.time === "" ? {} : { timed: true, time: state.time, animation: String(state.animation) };

/** Returns the Job table; `other` is one of the settings of "difference with". */
export function jobOf(state, other = "") {
  const [kind, ...rest] = other.split(":");
  const value = rest.join(":");
  const chosen = (list, letter) => list.filter((id) => id[0] === letter).map((id) => Number(id.slice(1)));
  const shown = { hidden_instances: chosen(state.hidden, "i"), hidden_objects: chosen(state.hidden, "o"),
                  only_instances: chosen(state.isolated, "i"), only_objects: chosen(state.isolated, "o") };
  for (const name of Object.keys(shown)) if (shown[name].length === 0) delete shown[name];
  if (state.skipHiddenBoxes && Object.keys(shown).length) shown.skip_hidden_boxes = true;
  Object.assign(shown, momentOf(state));
  const job = { ...shown, scene: state.scene, intersector: state.intersector, mask: parseInt(state.mask, 16),
                settings: Object.entries(state.settings).map(([name, text]) => `${name}=${text}`) };
  if (kind === "intersector") return { ...job, intersector: value, settings: [] };
  // Numbers of instances and objects mean others in another scene.
  if (kind === "scene") return { ...job, scene: value, ...Object.fromEntries(Object.keys(shown).map((name) => [name, undefined])) };
  if (kind === "mask") return { ...job, mask: parseInt(value, 16) || 0 };
  if (kind === "set") return { ...job, settings: [...job.settings.filter((text) => text.split("=")[0] !== value.split("=")[0]), value] };
  return job;
}

/** True if the state asks for a difference, which only views of values have. */
export const compares = (state) => state.compare !== "" && Boolean(viewOf(state.view).value);

/** What a difference is taken of, in words: "opaque", "scene b", "mask 1", "cutoff=0.3"; "" where the state asks for none. */
export function otherOf(state) {
  const [, kind, value] = /^(\w+):(.*)$/s.exec(compares(state) ? state.compare : "") ?? ["", "", ""];
  return ["scene", "mask"].includes(kind) ? `${kind} ${value}` : value;
}

/**
 * Returns the requests of a picture: one, or two for a difference. A lit picture is refined to all of its
 * samples where it is `fine`, and has one else.
 */
export function pictureRequests(state, width, height, fine = true) {
  const view = viewOf(state.view);
  const { camera } = state;
  if (view.lit && camera.projection !== "orthographic") {
    const light = lightOf(state), job = jobOf(state);
    if (light.integrator === "primary") return [{ type: "Render", message: { job, width, height, integrator: "primary", camera: cameraTable(camera) } }];
    return [{ type: "Render", message: { job, width, height, camera: cameraTable(camera), ...light,
      samples: fine ? state.samples : 1, progressive: fine, encode: "linear" } }];
  }
  if (view.render && camera.projection !== "orthographic") {
    return [{ type: "Render", message: { job: jobOf(state), width, height, integrator: "primary",
      camera: cameraTable(camera) } }];
  }
  if (view.measured && camera.projection !== "orthographic") {
    const normals = { job: jobOf(state), kind: "closest", fields: ["ng"], generator: generator(camera, width, height) };
    // The daemon subtracts: two maps that are measured at the same time would disturb each other.
    const other = compares(state) ? { other: jobOf(state, state.compare) } : {};
    return [{ type: "Heatmap", message: { job: jobOf(state), ...other, width, height, camera: cameraTable(camera), metric: view.id }, normals }];
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
