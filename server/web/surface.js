// Draws a picture with WebGL2. Values are a texture of floats; palette, range, scale and opacity are
// applied by the shader, so that changing them costs one draw and no request.
import { logUnit, paletteBytes } from "./palette.js";
import { TONEMAP_SHADER } from "./tonemap.js";

const VERTEX = `#version 300 es
void main() {
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1);
  gl_Position = vec4(4.0 * corner - 1.0, 0.0, 1.0);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
uniform highp sampler2D values, linear;
uniform sampler2D colours, base, palette;
uniform vec2 size;
uniform vec2 range;
uniform float opacity, unit, gain;
uniform int tonemap;
uniform bool logarithmic, by_value, lit;
out vec4 result;
${TONEMAP_SHADER}
void main() {
  // Row 0 of a picture is on top.
  ivec2 pixel = ivec2(gl_FragCoord.x / size.x * float(textureSize(base, 0).x),
                      (1.0 - gl_FragCoord.y / size.y) * float(textureSize(base, 0).y));
  vec4 behind = texelFetch(base, pixel, 0);
  vec4 front = texelFetch(colours, pixel, 0);
  if (lit) {
    vec4 light = texelFetch(linear, pixel, 0);
    vec3 colour = displayed(tonemap, gain / (light.a > 0.0 ? light.a : 1.0) * light.rgb);
    front.rgb = mix(vec3(46.0 / 255.0), colour, clamp(light.a, 0.0, 1.0));
  }
  if (by_value) {
    float value = texelFetch(values, pixel, 0).r;
    float inside = clamp(value - range.x, 0.0, range.y - range.x);
    float place = logarithmic ? log(1.0 + inside / unit) / log(1.0 + (range.y - range.x) / unit) : inside / (range.y - range.x);
    bool nothing = isnan(value);
    front = nothing ? behind : texelFetch(palette, ivec2(int(floor(place * 255.0 + 0.5)), 0), 0);
  }
  result = vec4(mix(behind.rgb, front.rgb, opacity), 1.0);
}`;

export class Surface {
  #gl;
  #uniforms = {};
  #textures = {};
  #palette = "";

  /** Throws where the browser has no WebGL2. */
  constructor(canvas) {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, preserveDrawingBuffer: true });
    if (!gl) throw new Error("This browser has no WebGL2, which the picture needs.");
    this.#gl = gl;
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => this.#prepare());
    this.#prepare();
  }

  #prepare() {
    const gl = this.#gl;
    const program = gl.createProgram();
    for (const [type, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program) ?? "no shader");
    gl.useProgram(program);
    ["values", "colours", "base", "palette", "linear"].forEach((name, unit) => {
      this.#textures[name] = gl.createTexture();
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, this.#textures[name]);
      for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
      gl.uniform1i(gl.getUniformLocation(program, name), unit);
    });
    for (const name of ["size", "range", "unit", "opacity", "logarithmic", "by_value", "lit", "gain", "tonemap"]) {
      this.#uniforms[name] = gl.getUniformLocation(program, name);
    }
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    this.#palette = "";
  }

  /** Takes the pixels of an image. */
  upload(image) {
    const gl = this.#gl;
    const put = (unit, internal, format, type, data) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.texImage2D(gl.TEXTURE_2D, 0, internal, image.width, image.height, 0, format, type, data);
    };
    put(0, gl.R32F, gl.RED, gl.FLOAT, image.values);
    put(1, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, image.colours);
    put(2, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, image.base);
    if (image.linear) put(4, gl.RGBA32F, gl.RGBA, gl.FLOAT, image.linear);
  }

  /** `look` is {tonemap, stops} of a lit picture. */
  draw({ byValue, low, high, log, opacity, palette, look = null }) {
    const gl = this.#gl;
    if (palette !== this.#palette) {
      this.#palette = palette;
      gl.activeTexture(gl.TEXTURE3);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, 256, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, paletteBytes(palette));
    }
    const { width, height } = gl.canvas;
    gl.viewport(0, 0, width, height);
    gl.uniform2f(this.#uniforms.size, width, height);
    gl.uniform2f(this.#uniforms.range, low, high);
    gl.uniform1f(this.#uniforms.unit, logUnit(low));
    gl.uniform1f(this.#uniforms.opacity, look ? 1 : opacity);
    gl.uniform1i(this.#uniforms.logarithmic, log ? 1 : 0);
    gl.uniform1i(this.#uniforms.by_value, byValue ? 1 : 0);
    gl.uniform1i(this.#uniforms.lit, look ? 1 : 0);
    gl.uniform1f(this.#uniforms.gain, look ? 2 ** look.stops : 1);
    gl.uniform1i(this.#uniforms.tonemap, look?.tonemap ?? 0);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}
