// The strip at the top: what runs and waits, and how long planning takes, from the server's metrics.
import { $, make, ms } from "./elements.js";
import { token } from "./call.js";

const EVERY_MS = 2000, KEPT = 60;
const SVG = "http://www.w3.org/2000/svg";
const PLANNING = ["PlanGrasps", "StreamGrasps", "PlanMultiHand"];

// Lines of the OpenMetrics format as [name, labels, value].
export function parse(text) {
  const found = [];
  for (const line of text.split("\n")) {
    const match = /^([a-z_]+)(?:\{(.*)\})? (\S+)/.exec(line);
    if (!match) continue;
    const labels = Object.fromEntries([...(match[2] || "").matchAll(/([a-z_]+)="([^"]*)"/g)].map(m => [m[1], m[2]]));
    found.push([match[1], labels, Number(match[3])]);
  }
  return found;
}

const sum = (all, name, keep = () => true) => all.filter(([n, labels]) => n === name && keep(labels)).reduce((s, [, , value]) => s + value, 0);

// Calls up to each bound, for the methods that plan.
function buckets(all) {
  const out = new Map();
  for (const [name, labels, value] of all) {
    if (name !== "graspd_call_duration_seconds_bucket" || !PLANNING.includes(labels.method)) continue;
    const bound = labels.le === "+Inf" ? Infinity : Number(labels.le);
    out.set(bound, (out.get(bound) || 0) + value);
  }
  return out;
}

// The time that a share of the calls between two looks took at most, within its bucket by a straight line.
export function quantile(before, now, share) {
  const bounds = [...now.keys()].sort((a, b) => a - b), counts = bounds.map(b => now.get(b) - (before.get(b) || 0)), total = counts.at(-1);
  if (!total) return null;
  const i = counts.findIndex(n => n >= share * total), low = i ? bounds[i - 1] : 0, under = i ? counts[i - 1] : 0;
  return bounds[i] === Infinity ? low : low + (bounds[i] - low) * (share * total - under) / Math.max(counts[i] - under, 1e-9);
}

function spark(history) {
  const most = Math.max(...history.map(h => h.p95 || 0), 0.01), x = i => 120 * i / (KEPT - 1), y = s => 26 - 24 * s / most;
  const line = document.createElementNS(SVG, "line");
  for (const [key, value] of [["x1", 0], ["x2", 120], ["y1", 26.5], ["y2", 26.5]]) line.setAttribute(key, value);
  const bars = history.flatMap((h, i) => {
    if (!h.p95) return [];
    const rect = document.createElementNS(SVG, "rect");
    for (const [key, value] of [["x", x(i + KEPT - history.length) - 1], ["width", 2], ["y", y(h.p95)], ["height", 26 - y(h.p95)]]) rect.setAttribute(key, value);
    return [rect];
  });
  const path = document.createElementNS(SVG, "path");
  const points = history.map((h, i) => [x(i + KEPT - history.length), h.p50]).filter(([, s]) => s);
  path.setAttribute("d", points.map(([a, s], i) => (i ? "L" : "M") + a.toFixed(1) + " " + y(s).toFixed(1)).join(""));
  $("spark").replaceChildren(line, ...bars, path);
}

function show(all, before, seen) {
  // Of the last two minutes, or of all calls where there were none in these.
  const now = buckets(all), since = quantile(before, now, 0.5) === null ? new Map() : before, p50 = quantile(since, now, 0.5), p95 = quantile(since, now, 0.95);
  const waiting = sum(all, "graspd_queue_depth"), refused = sum(all, "graspd_calls_refused_total");
  const items = [["running", sum(all, "graspd_jobs_running") + " of " + sum(all, "graspd_slots")], ["waiting", waiting], ["refused", refused],
    ["median", p50 === null ? "–" : ms(p50)], ["95 %", p95 === null ? "–" : ms(p95)], ["plans", sum(all, "graspd_plans_total")]];
  $("load").replaceChildren(...items.map(([name, value]) => {
    const item = make("div");
    item.append(make("dt", name), make("dd", value));
    return item;
  }));
  spark(seen);
}

// Looks every two seconds, and not at all while nobody sees the page.
export function watch() {
  const looks = [], history = [];
  const look = async () => {
    try {
      const response = await fetch("/metrics", { headers: token.header() });
      if (response.status === 401) throw new Error("load: a token is needed");
      if (!response.ok) throw new Error("no metrics: HTTP " + response.status);
      const all = parse(await response.text()), now = buckets(all), last = looks.at(-1) || new Map(now);
      looks.push(now);
      history.push({ p50: quantile(last, now, 0.5), p95: quantile(last, now, 0.95) });
      if (looks.length > KEPT) looks.shift();
      if (history.length > KEPT) history.shift();
      show(all, looks[0], history);
    } catch (error) {
      $("load").replaceChildren(make("div", error instanceof TypeError ? "the server does not answer" : error.message, { class: "quiet" }));
    }
  };
  setInterval(() => { if (!document.hidden) look(); }, EVERY_MS);
  look();
  return look;
}
