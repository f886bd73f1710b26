// The page: what is asked, what is answered, and what a person does about it.
import { $, button, make, ms, rows } from "./elements.js";
import { CallError, handGeometry, planHands, readScene, serverInfo, token } from "./call.js";
import { allHands, drawHands, firstChoice } from "./hands_panel.js";
import { CENTER, CENTROID, CONTACT, PAD, css, handColor, ramp } from "./colors.js";
import { PRESETS, depthFrame, lens, lensFile, pngSize, setLens } from "./frame.js";
import { LAYERS, View } from "./view.js";
import { drawAnswer } from "./grasp_panel.js";
import { handModel } from "./hand.js";
import { plans, question } from "./mcap.js";
import { seconds } from "./wire.js";
import { watch } from "./status.js";
import { xyz } from "./matrix.js";

const POINTS = 120000;
const CALL_SECONDS = 60;
const MOMENTS = ["pre-grasp", "contact", "squeeze"];
const state = {
  hands: [], chosen: new Set(), selected: null, rank: 0, moment: 1, playing: false,
  // Answers by the hand's name; frames that were asked about; what is known of a dropped PNG.
  answers: new Map(), frames: null, options: null, png: null, pose: null, recording: null, running: null,
};
const models = new Map();
let view = null, look = () => {};

// === What is said
const say = text => { $("said").textContent = text; };
function fail(error) {
  $("failed").textContent = error ? (error.code ? error.code.toLowerCase().replaceAll("_", " ") + ": " : "") + error.message : "";
}

// Does something that may fail; asks for a token where that is why.
async function attempt(work) {
  fail(null);
  try {
    await work();
  } catch (error) {
    if (error instanceof CallError && error.code === "UNAUTHENTICATED") { askToken(error.message, work); return; }
    if (!(error instanceof CallError && error.code === "CANCELLED")) fail(error);
    if (!(error instanceof Error)) throw error;
  }
}

function askToken(why, then) {
  const dialog = $("token-dialog");
  $("token-why").textContent = why;
  if (dialog.open) return;
  dialog.returnValue = "";
  dialog.onclose = () => {
    const text = $("token").value.trim();
    $("token").value = "";
    if (dialog.returnValue !== "ok" || !text) { fail(new Error("without a token this server shows nothing")); return; }
    token.set(text);
    attempt(then);
    look();
  };
  dialog.showModal();
  $("token").focus();
}

// === Drawing
const handOf = name => state.hands.find(hand => hand.name === name);
const answerOf = name => state.answers.get(name);
const graspsOf = name => (answerOf(name) && answerOf(name).response ? answerOf(name).response.grasps : []);

async function model(hand) {
  const known = models.get(hand.name);
  if (known && known.revision === hand.revision) return known;
  const made = handModel(await handGeometry(hand.name), view.graphics);
  models.set(hand.name, made);
  return made;
}

async function drawGrasp() {
  if (!view) return;
  const hand = handOf(state.selected);
  if (!hand) { view.setGrasp(null); return; }
  const shape = await model(hand), grasps = graspsOf(hand.name), grasp = grasps[state.rank];
  // Another hand may have been selected while this one's shape came.
  if (state.selected !== hand.name) return;
  const rest = { approach: xyz(hand.approach), tool: xyz(hand.tool_point), joints: new Map(hand.joints.map(j => [j.name, Math.min(Math.max(0, j.min_position), j.max_position)])) };
  // A recorded grasp may be of another revision of the hand, whose joints are not these.
  const fits = !grasp || shape.bodies.every(b => !b.joint || grasp.joints.names.includes(b.joint));
  if (!fits) say("The recorded grasp is of another revision of this hand: the hand is not drawn.");
  view.setGrasp(fits ? { model: shape, grasp, moment: state.moment, color: handColor(state.hands.indexOf(hand)), rest, others: grasps.filter((_, i) => i !== state.rank) } : null);
}

function drawPanels() {
  drawHands(state, { choose, select });
  drawAnswer(handOf(state.selected), answerOf(state.selected), state.rank, rank => select(state.selected, rank));
  const hasGrasp = graspsOf(state.selected).length > 0;
  for (const id of ["play", "moment"]) $(id).disabled = !hasGrasp;
  document.querySelectorAll("[data-moment]").forEach(b => { b.disabled = !hasGrasp; b.setAttribute("aria-pressed", Number(b.dataset.moment) === state.moment); });
  $("play").setAttribute("aria-pressed", state.playing);
  $("play").textContent = state.playing ? "Stop" : "Play";
  $("plan").disabled = !state.frames || !state.chosen.size || Boolean(state.running);
}

// Keeps the focus where it was: lists are made anew.
function draw() {
  const focused = document.activeElement, key = ["data-rank", "data-hand"].find(k => focused && focused.hasAttribute && focused.hasAttribute(k));
  const value = key && focused.getAttribute(key);
  drawPanels();
  if (key) {
    const again = document.querySelector("[" + key + "=\"" + CSS.escape(value) + "\"]");
    if (again) again.focus();
  }
  attempt(drawGrasp);
}

function choose(name, on) {
  if (on) state.chosen.add(name); else state.chosen.delete(name);
  drawPanels();
}

function select(name, rank = 0) {
  const count = graspsOf(name).length;
  state.selected = name;
  state.rank = count ? (rank + count) % count : 0;
  draw();
}

function selectHand(step) {
  const i = state.hands.findIndex(hand => hand.name === state.selected);
  if (state.hands.length) select(state.hands[(i + step + state.hands.length) % state.hands.length].name);
}

function setMoment(value) {
  state.moment = value;
  $("moment").value = value;
  const near = Math.round(value), word = Math.abs(value - near) < 0.02 ? MOMENTS[near] : "between " + MOMENTS[Math.floor(value)] + " and " + MOMENTS[Math.ceil(value)];
  $("moment").setAttribute("aria-valuetext", word);
  document.querySelectorAll("[data-moment]").forEach(b => b.setAttribute("aria-pressed", Number(b.dataset.moment) === value));
  if (view) view.setMoment(value);
}

function play() {
  state.playing = !state.playing;
  drawPanels();
  let last = performance.now(), rest = 0;
  if (state.playing) setMoment(0);
  const step = now => {
    if (!state.playing) return;
    const dt = Math.min((now - last) / 1000, 0.1);
    last = now;
    if (state.moment >= 2) { rest += dt; if (rest > 0.9) { rest = 0; setMoment(0); } } else setMoment(Math.min(state.moment + dt * 0.8, 2));
    requestAnimationFrame(step);
  };
  requestAnimationFrame(step);
}

// === Asking
function options() {
  const whole = (id, low, high) => {
    const n = Number($(id).value);
    if (!Number.isInteger(n) || n < low || n > high) throw new Error($(id).labels[0].textContent + ": expected a whole number, " + low + " to " + high);
    return n;
  };
  return { batch_size: whole("batch", 1, 4096), seed: whole("seed", 0, Number.MAX_SAFE_INTEGER), reaching: Number($("reaching").value) };
}

const cameraAt = frames => (frames[0].camera_pose ? xyz(frames[0].camera_pose.pose.position) : [0, 0, 0]);

async function showScene(frames, scene_options, signal) {
  const read = await readScene({ frames, scene_options, max_point_count: POINTS }, { signal, timeoutSeconds: CALL_SECONDS });
  if (view) view.setScene(read, cameraAt(frames));
}

// Plans for these tasks; each hand's answer is shown as it comes.
async function ask(frames, scene_options, tasks) {
  if (state.running) state.running.abort();
  const running = new AbortController(), began = performance.now();
  state.running = running;
  state.answers.clear();
  state.rank = 0;
  $("stop").hidden = false;
  say("Planning for " + tasks.length + (tasks.length === 1 ? " hand…" : " hands…"));
  draw();
  try {
    const byTask = new Map(tasks.map(task => [task.task_id, task.hand]));
    const scene = showScene(frames, scene_options, running.signal);
    const planned = planHands({ frames, scene_options, tasks }, message => {
      if (!message.result) return;
      const hand = byTask.get(message.result.task_id);
      state.answers.set(hand, message.result);
      if (!graspsOf(state.selected).length && graspsOf(hand).length && !tasks.some(t => t.hand === state.selected)) state.selected = hand;
      draw();
    }, { signal: running.signal, timeoutSeconds: CALL_SECONDS });
    // Both, or the first that fails; then the other is stopped.
    await Promise.all([scene, planned]);
    const count = tasks.reduce((sum, task) => sum + graspsOf(task.hand).length, 0);
    say(count + " grasps for " + tasks.length + (tasks.length === 1 ? " hand" : " hands") + " in " + ms((performance.now() - began) / 1000) + ".");
  } catch (error) {
    running.abort();
    say(error.code === "CANCELLED" ? "Stopped." : "");
    throw error;
  } finally {
    if (state.running === running) { state.running = null; $("stop").hidden = true; }
    draw();
    look();
  }
}

const plan = () => attempt(async () => {
  if (state.png) state.frames = [depthFrame(state.png, lens(), state.pose)];
  const wanted = options(), tasks = state.hands.filter(hand => state.chosen.has(hand.name)).map(hand => ({ task_id: hand.name, hand: hand.name, options: wanted }));
  if (!state.frames || !tasks.length) throw new Error("a frame and a hand are needed");
  if (!state.chosen.has(state.selected)) state.selected = tasks[0].hand;
  const estimator = $("estimator").value;
  await ask(state.frames, { ...state.options, ...(estimator ? { estimator } : {}) }, tasks);
});

// === Frames that a person brings
function setFrame(png, figures, name, [width, height]) {
  state.recording = null;
  state.options = null;
  $("replay").hidden = true;
  state.png = png;
  state.pose = figures ? figures.pose || null : null;
  if (figures) setLens(figures);
  state.frames = [];
  $("source").textContent = name + ", " + width + " × " + height + (state.pose ? ", camera pose known" : ", the camera is the world");
}

const loadExample = () => attempt(async () => {
  const [png, json] = await Promise.all(["/example/depth.png", "/example/frame.json"].map(path => fetch(path)));
  if (!png.ok || !json.ok) return;
  const bytes = new Uint8Array(await png.arrayBuffer());
  setFrame(bytes, lensFile(await json.text(), "the example's lens"), "The example frame", pngSize(bytes, "the example"));
  $("example").hidden = false;
  await plan();
});

const take = files => attempt(async () => {
  const list = [...files], of = ending => list.find(file => file.name.toLowerCase().endsWith(ending));
  const [png, json, mcap] = [of(".png"), of(".json"), of(".mcap")];
  if (mcap) { await openRecording(mcap); return; }
  const figures = json ? lensFile(await json.text(), json.name) : null;
  if (png) {
    const bytes = new Uint8Array(await png.arrayBuffer()), size = pngSize(bytes, png.name);
    // Without figures of its own it has those of the fields, which are then to be seen.
    setFrame(bytes, figures, png.name, size);
    if (!figures) $("lens").open = true;
  } else if (figures && state.png) {
    setLens(figures);
    state.pose = figures.pose || null;
  } else throw new Error("expected a depth PNG, its lens as JSON, or a recording (.mcap)");
  await plan();
});

// === Recordings
async function openRecording(file) {
  state.recording = { name: file.name, plans: plans(new Uint8Array(await file.arrayBuffer())), at: 0 };
  state.png = null;
  $("replay").hidden = false;
  await showRecorded(0);
}

async function showRecorded(at) {
  const { plans: all, name } = state.recording, count = all.length;
  state.recording.at = (at + count) % count;
  const record = all[state.recording.at], asked = question(record), byTask = new Map(asked.tasks.map(task => [task.task_id, task.hand]));
  state.frames = asked.frames;
  state.options = asked.scene_options;
  state.answers = new Map(record.results.map(result => [byTask.get(result.task_id) || asked.tasks[0].hand, result]));
  state.chosen = new Set(asked.tasks.map(task => task.hand).filter(handOf));
  const shown = [...state.answers.keys()].find(hand => handOf(hand) && graspsOf(hand).length) || [...state.answers.keys()].find(handOf);
  state.rank = 0;
  if (shown) state.selected = shown;
  $("source").textContent = name;
  $("replay-at").textContent = (state.recording.at + 1) + " of " + count;
  const time = record.receive_time ? new Date(1000 * seconds(record.receive_time)).toLocaleString() : "";
  $("replay-about").textContent = time + ", " + ms(seconds(record.total_duration)) + ", server " + record.server_version + ". Answers are the recorded ones.";
  draw();
  // The contact field is not in a recording: the server reads it from the recorded frames.
  await showScene(asked.frames, asked.scene_options);
}

const replayAgain = () => attempt(async () => {
  const asked = question(state.recording.plans[state.recording.at]);
  $("replay-about").textContent = "Planned again, by this server.";
  await ask(asked.frames, asked.scene_options, asked.tasks);
});

// === Keys
const KEYS = [["← →", "grasp before, next"], ["↑ ↓", "hand before, next"], ["1 2 3", "pre-grasp, contact, squeeze"], ["space", "play"], ["p", "plan"],
  ["arrows on the picture", "turn it"], ["+ −", "zoom, on the picture"], ["drag, wheel", "turn, zoom; shift or right drag moves"]];

function key(event) {
  const inField = event.target.closest && event.target.closest("input, select, textarea, dialog");
  if (inField || event.ctrlKey || event.altKey || event.metaKey) return;
  const act = { ArrowRight: () => select(state.selected, state.rank + 1), ArrowLeft: () => select(state.selected, state.rank - 1), ArrowDown: () => selectHand(1), ArrowUp: () => selectHand(-1),
    1: () => setMoment(0), 2: () => setMoment(1), 3: () => setMoment(2), p: plan }[event.key];
  if (act) { event.preventDefault(); act(); }
  if (event.key === " " && !event.target.closest("button, summary, a")) { event.preventDefault(); if (!$("play").disabled) play(); }
}

// === Beginning
function layers() {
  $("layers").replaceChildren(...LAYERS.map(([name, words]) => button(words, e => {
    view.layers[name] = !view.layers[name];
    e.currentTarget.setAttribute("aria-pressed", view.layers[name]);
    view.redraw();
  }, { "aria-pressed": view.layers[name], "data-layer": name })));
  const scale = make("span", "unsure"), track = make("i", null, { class: "ramp" });
  track.style.background = "linear-gradient(90deg," + [0, .33, .66, 1].map(t => css(ramp(t))).join(",") + ")";
  scale.append(track, "sure");
  const dots = [[CENTROID, "centroid"], [CONTACT, "expected contact"], [CENTER, "middle"], [PAD, "pad"]].map(([color, words]) => {
    const item = make("span"), dot = make("i", null, { class: "dot" });
    dot.style.background = css(color);
    item.append(dot, words);
    return item;
  });
  $("legend").replaceChildren(make("b", "contact field"), scale, ...dots);
}

function listen() {
  $("plan").addEventListener("click", plan);
  $("stop").addEventListener("click", () => state.running && state.running.abort());
  $("example").addEventListener("click", loadExample);
  $("choose").addEventListener("click", () => $("files").click());
  $("files").addEventListener("change", e => { take(e.target.files); e.target.value = ""; });
  $("moment").addEventListener("input", e => { state.playing = false; setMoment(Number(e.target.value)); drawPanels(); });
  $("play").addEventListener("click", play);
  document.querySelectorAll("[data-moment]").forEach(b => b.addEventListener("click", () => { state.playing = false; setMoment(Number(b.dataset.moment)); drawPanels(); }));
  $("replay-back").addEventListener("click", () => attempt(() => showRecorded(state.recording.at - 1)));
  $("replay-on").addEventListener("click", () => attempt(() => showRecorded(state.recording.at + 1)));
  $("replay-again").addEventListener("click", replayAgain);
  $("preset").append(...Object.keys(PRESETS).map(name => make("option", name, { value: name })));
  $("preset").addEventListener("change", e => { if (PRESETS[e.target.value]) setLens(PRESETS[e.target.value]); });
  document.querySelectorAll("#lens input").forEach(input => input.addEventListener("input", () => { $("preset").value = ""; }));
  addEventListener("keydown", key);
  let within = 0;
  addEventListener("dragenter", e => { e.preventDefault(); within++; $("drop").hidden = false; });
  addEventListener("dragleave", () => { within--; if (!within) $("drop").hidden = true; });
  addEventListener("dragover", e => e.preventDefault());
  addEventListener("drop", e => { e.preventDefault(); within = 0; $("drop").hidden = true; take(e.dataTransfer.files); });
  rows($("keys"), KEYS);
}

const begin = () => attempt(async () => {
  const [info, hands] = await Promise.all([serverInfo(), allHands()]);
  $("version").textContent = info.version;
  $("estimator").replaceChildren(...info.estimators.map(name => make("option", name, { value: name })));
  state.hands = hands;
  state.chosen = firstChoice(hands);
  state.selected = [...state.chosen][0] || null;
  draw();
  await loadExample();
});

listen();
try {
  view = new View($("view"));
  layers();
} catch (error) {
  // Everything but the picture works without it.
  $("view").replaceWith(make("p", "No picture: " + error.message + ".", { class: "quiet", id: "no-view" }));
}
look = watch();
begin();
