// Frames that a person brings: a 16-bit depth PNG, its lens from the fields or from a JSON file beside it.
import { $ } from "./elements.js";

export const PNG_U16 = 3;
const SIGNATURE = [0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a];

// What cameras of these kinds have, roughly; the own device's figures are better.
export const PRESETS = {
  "Kinect, 640 × 480": { fx: 585, fy: 585, cx: 319.5, cy: 239.5, scale: 0.001 },
  "Azure Kinect NFOV, 640 × 576": { fx: 504, fy: 504, cx: 320, cy: 288, scale: 0.001 },
  "RealSense D435, 848 × 480": { fx: 425, fy: 425, cx: 424, cy: 240, scale: 0.001 },
  "RealSense D435, 640 × 480": { fx: 386, fy: 386, cx: 320, cy: 240, scale: 0.001 },
};
const FIELDS = ["fx", "fy", "cx", "cy", "scale"];

export function setLens(lens) {
  for (const field of FIELDS) if (lens[field] !== undefined) $("lens-" + field).value = lens[field];
}

// The fields' numbers; throws where one is none.
export function lens() {
  const out = {};
  for (const field of FIELDS) {
    const element = $("lens-" + field);
    out[field] = Number(element.value);
    if (!element.value.trim() || !Number.isFinite(out[field])) throw new Error(element.labels[0].textContent + ": expected a number");
  }
  return out;
}

// Size of a 16-bit grey PNG; throws for any other file.
export function pngSize(bytes, name) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  if (bytes.length < 26 || SIGNATURE.some((byte, i) => bytes[i] !== byte)) throw new Error(name + ": expected a PNG file");
  if (bytes[24] !== 16 || bytes[25] !== 0) throw new Error(name + ": expected 16-bit grey pixels, found " + bytes[24] + " bits of colour type " + bytes[25]);
  return [view.getUint32(16), view.getUint32(20)];
}

// Rows of a 4 x 4 matrix as a pose.
function pose(rows) {
  const m = rows, trace = m[0][0] + m[1][1] + m[2][2];
  let w, x, y, z;
  if (trace > 0) {
    const s = 2 * Math.sqrt(trace + 1);
    [w, x, y, z] = [s / 4, (m[2][1] - m[1][2]) / s, (m[0][2] - m[2][0]) / s, (m[1][0] - m[0][1]) / s];
  } else {
    const i = m[0][0] > m[1][1] ? (m[0][0] > m[2][2] ? 0 : 2) : m[1][1] > m[2][2] ? 1 : 2, j = (i + 1) % 3, k = (i + 2) % 3;
    const s = 2 * Math.sqrt(1 + m[i][i] - m[j][j] - m[k][k]), v = [0, 0, 0];
    v[i] = s / 4;
    v[j] = (m[j][i] + m[i][j]) / s;
    v[k] = (m[k][i] + m[i][k]) / s;
    [w, [x, y, z]] = [(m[k][j] - m[j][k]) / s, v];
  }
  return { position: { x: m[0][3], y: m[1][3], z: m[2][3] }, orientation: { x, y, z, w } };
}

// A lens file, as `graspd plan --intrinsics` takes it; throws for what is none.
export function lensFile(text, name) {
  let file;
  try { file = JSON.parse(text); } catch { throw new Error(name + ": expected JSON"); }
  const number = key => {
    if (typeof file[key] !== "number") throw new Error(name + ": expected a number as " + key);
    return file[key];
  };
  const out = { fx: number("fx"), fy: number("fy"), cx: number("cx"), cy: number("cy"), scale: file.depth_scale === undefined ? 0.001 : number("depth_scale") };
  const rows = file.camera_to_world;
  if (rows !== undefined) {
    if (!Array.isArray(rows) || rows.length !== 4 || rows.some(r => !Array.isArray(r) || r.length !== 4 || r.some(x => typeof x !== "number")))
      throw new Error(name + ": expected 4 rows of 4 numbers as camera_to_world");
    out.pose = pose(rows);
  }
  return out;
}

// A DepthFrame of a PNG file.
export const depthFrame = (png, { fx, fy, cx, cy, scale }, cameraPose) => ({
  encoding: PNG_U16, depth_scale_m: scale, data: png,
  intrinsics: { fx_px: fx, fy_px: fy, cx_px: cx, cy_px: cy },
  camera_pose: cameraPose ? { frame_id: "world", pose: cameraPose } : null,
});
