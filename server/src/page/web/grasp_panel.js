// One hand's answer: its grasps best first, what a score is made of, why candidates were rejected, where the time went.
import { $, bar, button, make, mm, ms, rows, words } from "./elements.js";
import { ENUMS } from "./schema.js";
import { seconds } from "./wire.js";

const PARTS = [["objective", "objective"], ["force_closure", "force closure"], ["clearance", "clearance"], ["certainty", "certainty"]];
const numbers = (v, digits = 3) => [v.x, v.y, v.z].map(x => x.toFixed(digits)).join(" ");

function ranks(grasps, rank, select) {
  $("ranks").replaceChildren(...grasps.map((grasp, i) => {
    const item = make("li"), label = "Grasp " + (i + 1) + ", score " + grasp.score.toFixed(2);
    const one = button(null, () => select(i), { "aria-pressed": i === rank, "aria-label": label, "data-rank": i });
    one.append(make("span", i + 1, { class: "rank" }), bar(grasp.score, grasp.score.toFixed(2)));
    item.append(one);
    return item;
  }));
}

function noGrasp(answer) {
  if (!answer || (answer.response && answer.response.grasps.length)) { $("none").replaceChildren(); return; }
  const box = make("div", null, { class: "note" }), { response, error } = answer;
  if (error) box.append(make("p", "Failed: " + (error.message || error.reason)));
  else if (response.no_grasp) {
    const reason = ENUMS.NoGraspReason[response.no_grasp.reason] || "unknown";
    box.append(make("p", "No grasp: " + words(reason.replace("NO_GRASP_REASON_", "").toLowerCase())), make("p", response.no_grasp.nearest_fix));
  }
  $("none").replaceChildren(box);
}

function score(grasp) {
  if (!grasp) { rows($("parts"), []); return; }
  const list = [["score", bar(grasp.score, grasp.score.toFixed(2))]];
  for (const [key, name] of PARTS) list.push([name, bar(grasp.score_parts[key], grasp.score_parts[key].toFixed(2))]);
  if (grasp.uncalibrated_score !== grasp.score) list.push(["before calibration", grasp.uncalibrated_score.toFixed(2)]);
  rows($("parts"), list);
  if (grasp.better_not) {
    const row = make("tr"), cell = make("td", "likelier lost than kept: look again from elsewhere", { class: "warn", colspan: 2 });
    row.append(cell);
    $("parts").append(row);
  }
}

function statistics(stats) {
  if (!stats) { rows($("rejected"), []); rows($("stages"), []); return; }
  const counts = [...stats.rejected_counts].sort((a, b) => b[1] - a[1]);
  rows($("rejected"), [...counts.map(([reason, n]) => [words(reason), bar(n / Math.max(stats.candidate_count, 1), n)]),
    ["candidates in all", stats.candidate_count], ["iterations of each", stats.iteration_count + (stats.budget_exhausted ? ", time was up" : "")]]);
  const total = Math.max(seconds(stats.total_duration), 1e-9);
  const stages = [["waited for a core", seconds(stats.queue_duration)], ...stats.stages.map(s => [s.name, seconds(s.duration)])];
  rows($("stages"), [...stages.map(([name, s]) => [words(name), bar(s / total, ms(s))]), ["in all", ms(total)]]);
}

function figures(grasp) {
  if (!grasp) { rows($("figures"), []); rows($("contacts"), []); return; }
  const { position: p, orientation: q } = grasp.wrist_pose.pose, a = grasp.actuators;
  rows($("figures"), [["frame, link", grasp.wrist_pose.frame_id + ", " + grasp.wrist_link], ["position, m", numbers(p)], ["x y z w", numbers(q) + " " + q.w.toFixed(3)],
    ["width", grasp.jaw_width_m === null ? "–" : mm(grasp.jaw_width_m)], ["clearance", mm(grasp.clearance_m)], ["epsilon", grasp.epsilon.toFixed(3)],
    ["objective", grasp.objective.total.toPrecision(4)], ...a.names.map((name, i) => [name, [a.open[i], a.contact[i], a.squeezed[i]].map(x => x.toFixed(3)).join(" → ")])]);
  rows($("contacts"), grasp.contacts.map(c => [c.pad + (c.finger && c.finger !== c.pad ? " (" + c.finger + ")" : ""), "certainty " + c.certainty.toFixed(2)]));
}

// Draws all of it; `answer` is of the hand, `rank` the grasp that is selected.
export function drawAnswer(hand, answer, rank, select) {
  const response = answer && answer.response, grasps = response ? response.grasps : [], grasp = grasps[rank];
  $("answer-title").textContent = hand ? hand.display_name : "Grasps";
  $("answer-about").textContent = !answer ? "Not planned yet." : response
    ? grasps.length + (grasps.length === 1 ? " grasp" : " grasps") + ", estimator " + response.stats.estimator + (response.recorded ? ", recorded" : "") : "";
  ranks(grasps, rank, select);
  noGrasp(answer);
  score(grasp);
  statistics(response && response.stats);
  figures(grasp);
}
