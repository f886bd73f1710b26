// A scene's points in rows and columns as a surface: normals, and triangles between neighbours that belong together.
import { dot, sub } from "./matrix.js";
import { heightColor } from "./colors.js";

// Neighbours further apart than this do not belong together, metres.
const EDGE_M = 0.016;
// What is further from the middle of the table than this is left out, metres.
const REACH_M = 0.6;

// Points that are missing, as pin holes of a sensor are, where nearly all around them are there and agree; for drawing
// alone, and never a point that was seen.
function closed(points, width, height) {
  const out = points.slice();
  for (let v = 1; v < height - 1; v++) for (let u = 1; u < width - 1; u++) {
    const i = 3 * (v * width + u);
    if (!Number.isNaN(points[i])) continue;
    const near = [];
    for (let b = -1; b <= 1; b++) for (let a = -1; a <= 1; a++) {
      const j = i + 3 * (b * width + a);
      if (!Number.isNaN(points[j])) near.push([points[j], points[j + 1], points[j + 2]]);
    }
    const mean = [0, 1, 2].map(k => near.reduce((sum, p) => sum + p[k], 0) / near.length);
    if (near.length >= 6 && near.every(p => Math.hypot(...sub(p, mean)) < EDGE_M / 2)) out.set(mean, i);
  }
  return out;
}

// Mean over neighbours that belong together, which takes the sensor's grain out of the picture; only for drawing.
function smoothed(points, width, height) {
  const out = points.slice();
  for (let v = 0; v < height; v++) for (let u = 0; u < width; u++) {
    const i = 3 * (v * width + u);
    if (Number.isNaN(points[i])) continue;
    let n = 0, x = 0, y = 0, z = 0;
    for (let b = Math.max(v - 2, 0); b <= Math.min(v + 2, height - 1); b++) for (let a = Math.max(u - 2, 0); a <= Math.min(u + 2, width - 1); a++) {
      const j = 3 * (b * width + a);
      if (Number.isNaN(points[j])) continue;
      const d = Math.hypot(points[j] - points[i], points[j + 1] - points[i + 1], points[j + 2] - points[i + 2]);
      if (d > 0.007) continue;
      const weight = Math.exp(-d * d / 2e-5);
      n += weight; x += weight * points[j]; y += weight * points[j + 1]; z += weight * points[j + 2];
    }
    out[i] = x / n; out[i + 1] = y / n; out[i + 2] = z / n;
  }
  return out;
}

// Positions, normals and colours of the points that are kept, and triangles of their numbers. `middle` is of the table,
// `up` away from it.
export function surface({ width, height, points_m }, middle, up) {
  const points = smoothed(closed(points_m, width, height), width, height), slot = new Int32Array(width * height).fill(-1), kept = [];
  const at = i => [points[3 * i], points[3 * i + 1], points[3 * i + 2]];
  for (let i = 0; i < width * height; i++) {
    if (Number.isNaN(points[3 * i]) || Math.hypot(...sub(at(i), middle)) > REACH_M) continue;
    slot[i] = kept.length;
    kept.push(i);
  }
  const positions = new Float32Array(3 * kept.length), colors = new Float32Array(3 * kept.length), normals = new Float32Array(3 * kept.length);
  kept.forEach((i, k) => {
    const p = at(i);
    positions.set(p, 3 * k);
    colors.set(heightColor(dot(sub(p, middle), up)), 3 * k);
  });
  const gap = (a, b) => Math.hypot(positions[3 * a] - positions[3 * b], positions[3 * a + 1] - positions[3 * b + 1], positions[3 * a + 2] - positions[3 * b + 2]);
  const indices = [];
  for (let v = 1; v < height; v++) for (let u = 1; u < width; u++) {
    const d = slot[v * width + u], c = slot[v * width + u - 1], b = slot[(v - 1) * width + u], a = slot[(v - 1) * width + u - 1];
    for (const [p, q, r] of [[a, c, b], [b, c, d]]) {
      if (p < 0 || q < 0 || r < 0) continue;
      if (gap(p, q) > EDGE_M || gap(q, r) > EDGE_M || gap(r, p) > EDGE_M) continue;
      indices.push(p, q, r);
      const e = [0, 1, 2].map(k => positions[3 * q + k] - positions[3 * p + k]), f = [0, 1, 2].map(k => positions[3 * r + k] - positions[3 * p + k]);
      const n = [e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]];
      for (const corner of [p, q, r]) for (let k = 0; k < 3; k++) normals[3 * corner + k] += n[k];
    }
  }
  // A point without neighbours looks up.
  for (let k = 0; k < kept.length; k++) {
    const n = Math.hypot(normals[3 * k], normals[3 * k + 1], normals[3 * k + 2]);
    if (n > 0) for (let j = 0; j < 3; j++) normals[3 * k + j] /= n; else normals.set(up, 3 * k);
  }
  return { positions, normals, colors, indices: new Uint32Array(indices), count: kept.length };
}
