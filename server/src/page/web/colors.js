// Colours of the picture, linear red, green, blue; the same in every theme, so that a colour has one meaning.
export const HANDS = [
  [0.85, 0.30, 0.08], [0.05, 0.42, 0.72], [0.10, 0.52, 0.22], [0.62, 0.16, 0.52], [0.78, 0.50, 0.04], [0.03, 0.52, 0.52],
  [0.76, 0.13, 0.20], [0.28, 0.25, 0.78], [0.44, 0.52, 0.05], [0.78, 0.22, 0.44], [0.14, 0.50, 0.40], [0.50, 0.32, 0.16]];
export const PALM = [0.095, 0.105, 0.12];
export const CONTACT = [0.98, 0.85, 0.12];
export const CENTROID = [0.10, 0.75, 0.95];
export const CENTER = [1, 1, 1];
export const PAD = [0.12, 0.85, 0.42];
export const handColor = index => HANDS[index % HANDS.length];

// From unsure to sure.
const STOPS = [[0.07, 0.02, 0.30], [0.52, 0.04, 0.36], [0.90, 0.24, 0.08], [0.98, 0.82, 0.14]];
export function ramp(t) {
  const x = Math.min(Math.max(t, 0), 1) * 3, i = Math.min(Math.floor(x), 2), f = x - i;
  return [0, 1, 2].map(k => STOPS[i][k] + (STOPS[i + 1][k] - STOPS[i][k]) * f);
}

// Grey for the table, then by height.
const mix = (a, b, t) => a.map((x, k) => x + (b[k] - x) * Math.min(Math.max(t, 0), 1));
export const heightColor = h => mix([.36, .37, .38], mix([.42, .53, .62], [.80, .72, .55], (h - .02) / .11), (h - .004) / .006);

export const css = c => "rgb(" + c.map(x => Math.round(255 * Math.pow(Math.min(x, 1), 1 / 2.2))).join(",") + ")";
