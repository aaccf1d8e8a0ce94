// Tone maps: linear radiance as a screen shows it, by the daemon's own arithmetic (engine/integrators/tonemap.cpp),
// so that a picture of the page and one of `raynest render` have the same colours.
import { INTEGRATORS, TONEMAPS } from "./lists.js";

export const TONEMAP_NAMES = Object.keys(TONEMAPS);

/** Shader code: vec3 displayed(int tonemap, vec3 linear) gives sRGB; `tonemap` is an index in TONEMAP_NAMES. */
export const TONEMAP_SHADER = `
vec3 agx(vec3 c) {
  c = vec3(dot(c, vec3(0.842479062253094, 0.0784335999999992, 0.0792237451477643)),
           dot(c, vec3(0.0423282422610123, 0.878468636469772, 0.0791661274605434)),
           dot(c, vec3(0.0423756549057051, 0.0784336, 0.879142973793104)));
  vec3 x = clamp((log2(max(c, 1e-10)) + 12.47393) / (4.026069 + 12.47393), 0.0, 1.0);
  vec3 x2 = x * x, x4 = x2 * x2;
  c = 15.5 * x4 * x2 - 40.14 * x4 * x + 31.96 * x4 - 6.868 * x2 * x + 0.4298 * x2 + 0.1191 * x - 0.00232;
  c = vec3(dot(c, vec3(1.19687900512017, -0.0980208811401368, -0.0990297440797205)),
           dot(c, vec3(-0.0528968517574562, 1.15190312990417, -0.0989611768448433)),
           dot(c, vec3(-0.0529716355144438, -0.0980434501171241, 1.15107367264116)));
  return pow(clamp(c, 0.0, 1.0), vec3(2.2));
}
vec3 aces(vec3 c) {
  c = vec3(dot(c, vec3(0.59719, 0.35458, 0.04823)), dot(c, vec3(0.07600, 0.90834, 0.01566)), dot(c, vec3(0.02840, 0.13383, 0.83777)));
  c = (c * (c + 0.0245786) - 0.000090537) / (c * (0.983729 * c + 0.4329510) + 0.238081);
  return vec3(dot(c, vec3(1.60475, -0.53108, -0.07367)), dot(c, vec3(-0.10208, 1.10813, -0.00605)), dot(c, vec3(-0.00327, -0.07276, 1.07602)));
}
vec3 reinhard(vec3 c) { return c / (1.0 + max(dot(c, vec3(0.2126, 0.7152, 0.0722)), 0.0)); }
vec3 none(vec3 c) { return c; }
vec3 displayed(int tonemap, vec3 c) {
${TONEMAP_NAMES.map((name, i) => `  if (tonemap == ${i}) c = ${name}(c);`).join("\n")}
  c = clamp(c, 0.0, 1.0);
  return mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, greaterThan(c, vec3(0.0031308)));
}`;

/** Returns {tonemap, stops} of a picture; empty settings stand for the daemon's: agx and auto, or none and 0 where 1 is white. */
export function lookOf({ integrator, tonemap, exposure }, image) {
  const { lit } = INTEGRATORS[integrator];
  const name = TONEMAP_NAMES.includes(tonemap) ? tonemap : lit ? "agx" : "none";
  const automatic = exposure === "auto" || (exposure === "" && lit);
  return { tonemap: TONEMAP_NAMES.indexOf(name), stops: automatic ? image.stops : Number(exposure) || 0 };
}
