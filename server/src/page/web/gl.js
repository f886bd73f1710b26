// WebGL 2: two programs (lit surfaces, and marks of a size), and buffers.
import { IDENTITY } from "./matrix.js";

const LIT = [`
  in vec3 position, normal, color; uniform mat4 model, clip; uniform float size, scale; out vec3 at, n, c;
  void main() { vec4 w = model * vec4(position, 1.0); at = w.xyz; n = mat3(model) * normal; c = color; gl_Position = clip * w;
    gl_PointSize = clamp(size * scale / gl_Position.w, 1.5, 24.0); }`, `
  in vec3 at, n, c; uniform vec3 eye, light, up, tint; uniform float flatness, alpha; out vec4 o;
  void main() {
    vec3 v = normalize(eye - at);
    vec3 m = flatness > 0.5 ? normalize(cross(dFdx(at), dFdy(at))) : normalize(n + 1e-6 * v);
    if (dot(m, v) < 0.0) m = -m;
    vec3 base = c * tint;
    float sky = 0.5 + 0.5 * dot(m, up), key = max(dot(m, light), 0.0), back = max(dot(m, -light), 0.0);
    float gloss = pow(max(dot(m, normalize(light + v)), 0.0), 40.0) * 0.16;
    vec3 l = base * (0.26 + 0.30 * sky + 0.62 * key + 0.10 * back) + gloss + base * 0.25 * pow(1.0 - dot(m, v), 3.0);
    o = vec4(pow(min(l, vec3(1.0)), vec3(1.0 / 2.2)), alpha);
  }`];
const MARK = [`
  in vec3 position, color; uniform mat4 model, clip; uniform float size, scale; out vec3 c;
  void main() { gl_Position = clip * model * vec4(position, 1.0); c = color; gl_PointSize = max(size * scale / gl_Position.w, 3.0); }`, `
  in vec3 c; uniform float round, alpha, edge; out vec4 o;
  void main() {
    float r = round > 0.5 ? length(gl_PointCoord - 0.5) * 2.0 : 0.0;
    if (r > 1.0) discard;
    o = vec4(pow(r > 1.0 - edge ? vec3(0.01) : c, vec3(1.0 / 2.2)), alpha);
  }`];

export class Graphics {
  // Throws where there is no WebGL 2.
  constructor(canvas) {
    // Kept between frames, so that a picture of the page has what a person sees.
    this.gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
    if (!this.gl) throw new Error("this browser has no WebGL 2");
    this.lit = this.program(LIT);
    this.mark = this.program(MARK);
  }

  program([vertex, fragment]) {
    const gl = this.gl, p = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, "#version 300 es\nprecision highp float;\n" + source);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(p, shader);
    }
    ["position", "normal", "color"].forEach((name, i) => gl.bindAttribLocation(p, i, name));
    gl.linkProgram(p);
    if (!gl.getProgramParameter(p, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(p));
    const uniforms = {};
    for (let i = 0; i < gl.getProgramParameter(p, gl.ACTIVE_UNIFORMS); i++) {
      const { name } = gl.getActiveUniform(p, i);
      uniforms[name] = gl.getUniformLocation(p, name);
    }
    return { p, uniforms };
  }

  // Buffers of positions, and of what else is given.
  object(positions, { normals, colors, indices } = {}) {
    const gl = this.gl, vao = gl.createVertexArray(), buffers = [];
    gl.bindVertexArray(vao);
    [positions, normals, colors].forEach((array, i) => {
      if (!array) return;
      buffers.push(gl.createBuffer());
      gl.bindBuffer(gl.ARRAY_BUFFER, buffers.at(-1));
      gl.bufferData(gl.ARRAY_BUFFER, array, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(i);
      gl.vertexAttribPointer(i, 3, gl.FLOAT, false, 0, 0);
    });
    if (indices) {
      buffers.push(gl.createBuffer());
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers.at(-1));
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, indices, gl.STATIC_DRAW);
    }
    gl.bindVertexArray(null);
    return { vao, buffers, count: indices ? indices.length : positions.length / 3, indexed: Boolean(indices) };
  }

  free(object) {
    if (!object) return;
    object.buffers.forEach(buffer => this.gl.deleteBuffer(buffer));
    this.gl.deleteVertexArray(object.vao);
  }

  draw(object, mode) {
    if (!object || !object.count) return;
    const gl = this.gl;
    gl.bindVertexArray(object.vao);
    gl.vertexAttrib3f(1, 0, 0, 0);
    gl.vertexAttrib3f(2, 1, 1, 1);
    if (object.indexed) gl.drawElements(mode, object.count, gl.UNSIGNED_INT, 0);
    else gl.drawArrays(mode, 0, object.count);
  }

  // From here on surfaces with light; `view` says from where.
  useLit(view, { model = IDENTITY, tint = [1, 1, 1], flat = false, alpha = 1, size = 0.002 } = {}) {
    const gl = this.gl, u = this.lit.uniforms;
    gl.useProgram(this.lit.p);
    gl.uniformMatrix4fv(u.model, false, model);
    gl.uniformMatrix4fv(u.clip, false, view.clip);
    gl.uniform3fv(u.eye, view.eye);
    gl.uniform3fv(u.light, view.light);
    gl.uniform3fv(u.up, view.up);
    gl.uniform3fv(u.tint, tint);
    gl.uniform1f(u.flatness, flat ? 1 : 0);
    gl.uniform1f(u.alpha, alpha);
    gl.uniform1f(u.size, size);
    gl.uniform1f(u.scale, view.scale);
  }

  // From here on lines, and discs of a size in metres.
  useMark(view, { model = IDENTITY, size = 0.004, round = true, edge = 0, alpha = 1 } = {}) {
    const gl = this.gl, u = this.mark.uniforms;
    gl.useProgram(this.mark.p);
    gl.uniformMatrix4fv(u.model, false, model);
    gl.uniformMatrix4fv(u.clip, false, view.clip);
    gl.uniform1f(u.size, size);
    gl.uniform1f(u.scale, view.scale);
    gl.uniform1f(u.round, round ? 1 : 0);
    gl.uniform1f(u.edge, edge);
    gl.uniform1f(u.alpha, alpha);
  }
}
