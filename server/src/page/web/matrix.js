// Vectors and 4 x 4 matrices (column major), as far as the page needs them.
export const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const scaled = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const unit = a => { const n = Math.hypot(...a) || 1; return [a[0] / n, a[1] / n, a[2] / n]; };
export const xyz = v => v ? [v.x, v.y, v.z] : [0, 0, 0];

export function mul(a, b) {
  const out = new Float32Array(16);
  for (let c = 0; c < 4; c++) for (let r = 0; r < 4; r++) {
    let sum = 0;
    for (let k = 0; k < 4; k++) sum += a[k * 4 + r] * b[c * 4 + k];
    out[c * 4 + r] = sum;
  }
  return out;
}

// Position and quaternion (x, y, z, w) as a matrix.
export function rigid([x, y, z, w], at) {
  return new Float32Array([
    1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w), 0,
    2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w), 0,
    2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y), 0,
    at[0], at[1], at[2], 1]);
}

export const IDENTITY = rigid([0, 0, 0, 1], [0, 0, 0]);
export const quaternion = q => q ? [q.x, q.y, q.z, q.w] : [0, 0, 0, 1];
export const fromPose = pose => pose ? rigid(quaternion(pose.orientation), xyz(pose.position)) : IDENTITY;
export const moved = v => rigid([0, 0, 0, 1], v);
export const turned = (axis, angle) => {
  const [x, y, z] = unit(axis), s = Math.sin(angle / 2);
  return rigid([x * s, y * s, z * s, Math.cos(angle / 2)], [0, 0, 0]);
};
export const place = (m, p) => [0, 1, 2].map(r => m[r] * p[0] + m[4 + r] * p[1] + m[8 + r] * p[2] + m[12 + r]);
export const turn = (m, d) => [0, 1, 2].map(r => m[r] * d[0] + m[4 + r] * d[1] + m[8 + r] * d[2]);

// Between two poses, `t` from 0 to 1: along the line, and the short way around.
export function between(a, b, t) {
  const qa = quaternion(a.orientation), qb = quaternion(b.orientation);
  const side = qa[0] * qb[0] + qa[1] * qb[1] + qa[2] * qb[2] + qa[3] * qb[3] < 0 ? -1 : 1;
  const q = qa.map((x, k) => x * (1 - t) + side * qb[k] * t), n = Math.hypot(...q) || 1;
  const pa = xyz(a.position), pb = xyz(b.position);
  return rigid(q.map(x => x / n), pa.map((x, k) => x * (1 - t) + pb[k] * t));
}

export function lookAt(eye, at, up) {
  const z = unit(sub(eye, at)), x = unit(cross(up, z)), y = cross(z, x);
  return new Float32Array([x[0], y[0], z[0], 0, x[1], y[1], z[1], 0, x[2], y[2], z[2], 0, -dot(x, eye), -dot(y, eye), -dot(z, eye), 1]);
}

export function perspective(angle, aspect, near, far) {
  const f = 1 / Math.tan(angle / 2);
  return new Float32Array([f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, 2 * far * near / (near - far), 0]);
}
