// Cameras: eye, the point looked at, up and a vertical angle. An orthographic camera shows as much as a
// perspective one sees at the point looked at, so that switching keeps the picture.
export const add = (a, b) => a.map((x, i) => x + b[i]);
export const sub = (a, b) => a.map((x, i) => x - b[i]);
export const scale = (a, s) => a.map((x) => x * s);
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const length = (a) => Math.hypot(...a);
export const unit = (a) => scale(a, 1 / (length(a) || 1));

export const AXES = { x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1] };
const POLE = 0.9995;  // cosine that an orbiting camera stays away from its up axis

/** Returns a camera whose numbers are float32 in few digits: as they travel, stand in links and are shown. */
export function rounded(camera) {
  const short = (a) => a.map((x) => Number(Number(x).toPrecision(7)));
  return { ...camera, eye: short(camera.eye), at: short(camera.at), up: short(camera.up),
           fov: Number(camera.fov.toPrecision(6)) };
}

/** Returns right, up and back: the axes of the picture, unit length. */
export function basis(camera) {
  const back = unit(sub(camera.eye, camera.at));
  let up = camera.up;
  // Straight along `up` any roll would do: take the daemon's.
  for (const other of [[0, 0, -1], [0, 1, 0]]) {
    if (length(cross(up, back)) > 1e-6 * length(up)) break;
    up = other;
  }
  const right = unit(cross(up, back));
  return { right, up: cross(back, right), back };
}

export const distance = (camera) => length(sub(camera.eye, camera.at));

/** Half the height that the camera sees at the point looked at. */
export const halfHeight = (camera) => distance(camera) * Math.tan((camera.fov * Math.PI) / 360);

function rotate(v, axis, angle) {
  const c = Math.cos(angle), s = Math.sin(angle), k = dot(axis, v) * (1 - c), x = cross(axis, v);
  return v.map((value, i) => value * c + x[i] * s + axis[i] * k);
}

/** Turns the eye around the point looked at, by angles in radians. */
export function orbit(camera, across, down) {
  const axis = unit(camera.up);
  let offset = rotate(sub(camera.eye, camera.at), axis, -across);
  const tilted = rotate(offset, unit(cross(axis, offset)), -down);
  if (Math.abs(dot(unit(tilted), axis)) < POLE) offset = tilted;
  return { ...camera, eye: add(camera.at, offset) };
}

/** Turns the view about the eye; `free` turns up, too, so that no direction is special. */
export function look(camera, across, down, free = false) {
  const { right, up } = basis(camera);
  const axis = free ? up : unit(camera.up);
  let ahead = rotate(sub(camera.at, camera.eye), axis, -across);
  const tilted = rotate(ahead, right, -down);
  if (free || Math.abs(dot(unit(tilted), axis)) < POLE) ahead = tilted;
  return { ...camera, at: add(camera.eye, ahead), up: free ? rotate(up, right, -down) : camera.up };
}

export const roll = (camera, angle) =>
  ({ ...camera, up: rotate(basis(camera).up, basis(camera).back, angle) });

/** Moves eye and point along the picture's axes, by lengths of the scene. */
export function move(camera, across, upward, ahead) {
  const { right, up, back } = basis(camera);
  const by = add(add(scale(right, across), scale(up, upward)), scale(back, -ahead));
  return { ...camera, eye: add(camera.eye, by), at: add(camera.at, by) };
}

/** Brings the eye nearer to the point looked at, or away from it; never so near that its digits end the way back. */
export function dolly(camera, factor) {
  const far = distance(camera), least = 1e-5 * Math.max(...camera.eye.map(Math.abs), ...camera.at.map(Math.abs));
  return { ...camera, eye: add(camera.at, scale(sub(camera.eye, camera.at), Math.max(far * factor, Math.min(far, least)) / far)) };
}

/** Returns the camera that sees a box whole from where this one looks. */
export function frame(camera, low, high) {
  const radius = Math.max(length(sub(high, low)) / 2, 1e-6);
  const at = scale(add(low, high), 0.5);
  const far = (1.1 * radius) / Math.sin((camera.fov * Math.PI) / 360);
  return { ...camera, at, eye: add(at, scale(basis(camera).back, far)) };
}

/** Returns {origin, direction} of the ray through a point of the picture, x and y in pixels. */
export function ray(camera, x, y, width, height) {
  const { right, up, back } = basis(camera);
  const px = (2 * x - width) / height, py = (height - 2 * y) / height;
  if (camera.projection === "orthographic") {
    const half = halfHeight(camera);
    return { origin: add(camera.eye, add(scale(right, px * half), scale(up, py * half))), direction: scale(back, -1) };
  }
  const tangent = Math.tan((camera.fov * Math.PI) / 360);
  return { origin: camera.eye,
           direction: sub(add(scale(right, px * tangent), scale(up, py * tangent)), back) };
}

/** Returns a function of points of the scene to [x, y, depth]: pixels, and a depth not positive behind the eye. */
export function projector(camera, width, height) {
  const { right, up, back } = basis(camera), { eye } = camera;
  const flat = camera.projection === "orthographic" ? halfHeight(camera) : 0;
  const tangent = Math.tan((camera.fov * Math.PI) / 360);
  return (point) => {
    const v = sub(point, eye), depth = -dot(v, back);
    const half = flat || depth * tangent;
    return [width / 2 + (dot(v, right) / half) * (height / 2), height / 2 - (dot(v, up) / half) * (height / 2), depth];
  };
}

/** The same for one point. */
export const project = (camera, point, width, height) => projector(camera, width, height)(point);

/** Returns the camera whose 2x2 rays are given as columns `origin` and `direction`. */
export function cameraOfRays({ origin, direction }, target) {
  const o = (i) => [...origin.slice(3 * i, 3 * i + 3)], d = (i) => [...direction.slice(3 * i, 3 * i + 3)];
  const middle = (of) => scale(add(add(of(0), of(1)), add(of(2), of(3))), 0.25);
  const eye = middle(o), ahead = unit(middle(d));
  const span = length(sub(o(0), o(2)));  // pixels lie half the height apart
  const orthographic = span > 0;
  const up = unit(orthographic ? sub(o(0), o(2)) : sub(d(0), d(2)));
  const far = dot(sub(target.center, eye), ahead);
  const fov = orthographic ? 40 : (360 / Math.PI) * Math.atan(length(sub(d(0), d(2))));
  const reach = orthographic ? span / Math.tan((fov * Math.PI) / 360)
    : far > 0.05 * target.radius ? far : target.radius;
  // Keep the nearest axis as up, so that orbiting keeps the horizon level.
  const axis = Object.values(AXES).flatMap((a) => [a, scale(a, -1)]).sort((a, b) => dot(b, up) - dot(a, up))[0];
  const level = Math.abs(dot(cross(axis, ahead), up)) < 1e-4 && dot(axis, up) > 0.1;
  // What is nothing beside the distance is noise of the rays.
  const at = add(eye, scale(ahead, reach)).map((x) => (Math.abs(x) < 2e-7 * reach ? 0 : x));
  return rounded({ eye, at, up: level ? axis : up, fov,
                   projection: orthographic ? "orthographic" : "perspective" });
}

/** Returns the Camera table of a perspective camera. */
export function cameraTable({ eye, at, up, fov }) {
  const vec = ([x, y, z]) => ({ x, y, z });
  return { look_at: true, eye: vec(eye), at: vec(at), up: vec(up), fov_degrees: fov };
}

/** Returns the generator that makes this camera's rays in the daemon. */
export function generator(camera, width, height) {
  const lookat = `lookat=${[...camera.eye, ...camera.at, ...camera.up].join(",")}`;
  const size = `size=${width}x${height}`;
  if (camera.projection !== "orthographic") {
    return { kind: "camera", settings: [size, lookat, `fov=${camera.fov}`] };
  }
  const high = 2 * halfHeight(camera);
  const number = (x) => Number(x.toPrecision(7));
  return { kind: "orthographic", settings: [size, lookat, `window=${number((high * width) / height)}x${number(high)}`] };
}

/** Returns the generator of one pixel's ray of that picture. */
export function pixelGenerator(camera, x, y, width, height) {
  if (camera.projection !== "orthographic") {
    const focal = Number((height / 2 / Math.tan((camera.fov * Math.PI) / 360)).toPrecision(9));
    const lookat = `lookat=${[...camera.eye, ...camera.at, ...camera.up].join(",")}`;
    return { kind: "pinhole", settings: ["size=1x1", lookat, `fx=${focal}`, `cx=${width / 2 - x}`, `cy=${height / 2 - y}`] };
  }
  const { origin } = ray(camera, x + 0.5, y + 0.5, width, height);
  const by = sub(origin, camera.eye);
  return generator({ ...camera, eye: origin, at: add(camera.at, by) }, 1, 1);
}
