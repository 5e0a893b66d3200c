// Draws Gaussians with WebGL 2 and the formulas of the server's renderer.

import { matrixOf } from "./camera.js";
import { GEOMETRY, SceneError, harmonicsRow } from "./ply.js";
import { BLENDING, COVERING, SHOWING, projecting } from "./shaders.js";

/** Splats nearer than this are left out, world units, as in src/core/splat/uniform.rs. */
export const NEAR = 0.01;
/** Texels in a row of a texture, at most. */
const WIDEST = 4096;

/** A renderer on this canvas; `null` without WebGL 2. */
export function renderer(canvas) {
  // The picture persists: it is drawn only on changes, and can be saved.
  const gl = canvas.getContext("webgl2", {
    alpha: false, antialias: false, depth: false, preserveDrawingBuffer: true,
    powerPreference: "high-performance",
  });
  return gl && new Renderer(gl);
}

class Renderer {
  #gl;
  #scene = null;
  #count = 0;
  #target = null;
  #programs = new Map();

  constructor(gl) {
    this.#gl = gl;
    // With 8 bits a channel, rounding would erase hundreds of layers.
    this.#target = gl.getExtension("EXT_color_buffer_float")
      || gl.getExtension("EXT_color_buffer_half_float") ? new Target(gl) : null;
    this.order = gl.createBuffer();
    gl.disable(gl.DEPTH_TEST);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  /** Replaces the scene. */
  load({ count, degree, geometry, harmonics }) {
    const gl = this.#gl;
    this.#forget();
    const textures = [
      texture(gl, gl.RGBA32F, geometry, GEOMETRY / 4, count),
      texture(gl, gl.RGBA16F, harmonics, harmonicsRow(degree) / 4, count),
    ];
    this.#scene = { textures, program: this.#program(projecting(degree), BLENDING) };
    this.#count = 0;
  }

  /** Takes the indexes of the Gaussians to draw, farthest first. */
  sort(order) {
    const gl = this.#gl;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    gl.bufferData(gl.ARRAY_BUFFER, order, gl.STREAM_DRAW);
    this.#count = order.length;
  }

  /** Whether exposure can change, which needs values above white. */
  get exposes() {
    return this.#target !== null;
  }

  /**
   * Draws the scene from `pose`, with intrinsics `k` of the canvas's size, at `part` of its pixels
   * a side, `ev` stops brighter; with a `crop` as drawn, only what is inside.
   */
  draw(pose, k, part = 1, ev = 0, crop = null) {
    const gl = this.#gl;
    const [width, height] = [k.width, k.height].map((side) => Math.max(1, Math.round(side * part)));
    const target = this.#target?.bind(width, height) ? this.#target : null;
    if (!target) gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    /** @type {[number, number]} */
    const size = target ? [width, height] : [k.width, k.height];
    gl.viewport(0, 0, ...size);
    gl.clearColor(0, 0, 0, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    if (this.#scene && this.#count > 0) this.#blend(pose, k, size, crop);
    if (target) this.#show(k, ev);
  }

  #blend(pose, k, [width, height], crop) {
    const gl = this.#gl;
    const { program, textures } = this.#scene;
    const at = program.use();
    const [x, y] = [width / k.width, height / k.height];
    const rows = matrixOf(pose);
    [at.row_x, at.row_y, at.row_z].forEach((place, i) => gl.uniform4fv(place, rows[i]));
    gl.uniform3fv(at.position, pose.eye);
    gl.uniform2f(at.focal, k.fx * x, k.fy * y);
    gl.uniform2f(at.centre, k.cx * x, k.cy * y);
    gl.uniform2f(at.size, width, height);
    gl.uniform1i(at.crop_shape, crop ? (crop.isBox ? 2 : 1) : 0);
    gl.uniform3fv(at.crop_centre, crop?.centre ?? [0, 0, 0]);
    gl.uniform3fv(at.crop_half, crop?.half ?? [1, 1, 1]);
    gl.uniform2i(at.in_row, textures[0].inRow, textures[1].inRow);
    ["geometry", "harmonics"].forEach((name, unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, textures[unit].texture);
      gl.uniform1i(at[name], unit);
    });
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    const index = gl.getAttribLocation(program.linked, "index");
    gl.enableVertexAttribArray(index);
    gl.vertexAttribIPointer(index, 1, gl.UNSIGNED_INT, 0, 0);
    gl.vertexAttribDivisor(index, 1);
    gl.enable(gl.BLEND);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.#count);
    gl.disable(gl.BLEND);
    gl.disableVertexAttribArray(index);
  }

  #show(k, ev) {
    const gl = this.#gl;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, k.width, k.height);
    const at = this.#program(COVERING, SHOWING).use();
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.#target.texture);
    gl.uniform1i(at.image, 0);
    gl.uniform2f(at.size, k.width, k.height);
    gl.uniform1f(at.gain, 2 ** ev);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  #program(vertex, fragment) {
    if (!this.#programs.has(vertex)) {
      this.#programs.set(vertex, new Program(this.#gl, vertex, fragment));
    }
    return this.#programs.get(vertex);
  }

  #forget() {
    for (const { texture } of this.#scene?.textures ?? []) this.#gl.deleteTexture(texture);
    this.#scene = null;
  }

  /** Frees the memory. */
  free() {
    this.#forget();
    this.#gl.getExtension("WEBGL_lose_context")?.loseContext();
  }
}

/** A row of texels per Gaussian, several of these in a row of the texture. */
function texture(gl, format, values, texels, count) {
  const widest = Math.min(WIDEST, gl.getParameter(gl.MAX_TEXTURE_SIZE));
  const inRow = Math.min(count, Math.floor(widest / texels));
  const rows = Math.floor(count / inRow);
  const rest = count - rows * inRow;
  if (rows + 1 > gl.getParameter(gl.MAX_TEXTURE_SIZE)) {
    throw new SceneError(`This graphics adapter cannot hold ${count} Gaussians.`);
  }
  const made = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, made);
  gl.texStorage2D(gl.TEXTURE_2D, 1, format, inRow * texels, rows + (rest > 0 ? 1 : 0));
  nearest(gl, gl.NEAREST);
  gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, inRow * texels, rows, gl.RGBA, gl.FLOAT, values);
  if (rest > 0) {
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, rows, rest * texels, 1, gl.RGBA, gl.FLOAT,
      values, rows * inRow * texels * 4);
  }
  return { texture: made, inRow };
}

function nearest(gl, filter) {
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, filter);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, filter);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
}

/** The half-float target of blending. */
class Target {
  constructor(gl) {
    this.gl = gl;
    this.framebuffer = gl.createFramebuffer();
    this.texture = null;
    this.size = "";
    this.isWhole = false;
  }

  /** Makes it the render target, if the adapter can. */
  bind(width, height) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
    if (this.size === `${width} ${height}`) return this.isWhole;
    this.size = `${width} ${height}`;
    gl.deleteTexture(this.texture);
    this.texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA16F, width, height);
    nearest(gl, gl.LINEAR);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.texture, 0);
    this.isWhole = gl.checkFramebufferStatus(gl.FRAMEBUFFER) === gl.FRAMEBUFFER_COMPLETE;
    return this.isWhole;
  }
}

class Program {
  constructor(gl, vertex, fragment) {
    this.gl = gl;
    this.linked = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(this.linked, shader);
      gl.deleteShader(shader);
    }
    gl.linkProgram(this.linked);
    if (!gl.getProgramParameter(this.linked, gl.LINK_STATUS) && !gl.isContextLost()) {
      const words = gl.getAttachedShaders(this.linked).map((one) => gl.getShaderInfoLog(one));
      throw new SceneError(`The graphics adapter rejected the shaders: ${words.join(" ")}`);
    }
    this.places = new Proxy({}, {
      get: (known, name) => (known[name] ??= gl.getUniformLocation(this.linked, name)),
    });
  }

  /** Makes it the current program and returns the locations of its uniforms. */
  use() {
    this.gl.useProgram(this.linked);
    return this.places;
  }
}
