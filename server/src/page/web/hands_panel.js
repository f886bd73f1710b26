// The hands that the server has: which are planned for, which one is looked at, and what it is made of.
import { $, button, make } from "./elements.js";
import { css, handColor } from "./colors.js";
import { listHands } from "./call.js";

// Planned for at first, where the server has them.
const FIRST = ["hands/robotiq-2f85", "hands/robotiq-3f", "hands/leap"];

export async function allHands() {
  const hands = [];
  let page_token = "";
  do {
    const page = await listHands({ page_size: 200, page_token });
    hands.push(...page.hands);
    page_token = page.next_page_token;
  } while (page_token);
  return hands;
}

export const firstChoice = hands => {
  const known = FIRST.filter(name => hands.some(hand => hand.name === name));
  return new Set(known.length ? known : hands.slice(0, 1).map(hand => hand.name));
};

function about(hand) {
  const opening = hand.opening ? ", opens " + (1000 * hand.opening.max_m).toFixed(0) + " mm" : "";
  const parts = hand.fingers.length + " fingers, " + hand.joints.length + " joints, " + hand.actuators.length + " actuators" + opening;
  const pads = new Map();
  for (const pad of hand.pads) pads.set(pad.finger, [...(pads.get(pad.finger) || []), pad.name]);
  const box = make("div", null, { class: "about" });
  box.append(make("div", parts), make("div", hand.pads.length + " pads, " + hand.contact_candidate_count + " contact candidates: "
    + [...pads].map(([finger, names]) => names.length === 1 && names[0] === finger ? finger : finger + " (" + names.join(", ") + ")").join("; ")));
  for (const warning of hand.warnings) box.append(make("div", warning, { class: "warn" }));
  return box;
}

// Draws the list; `state` has the hands, the chosen names, the selected one and answers by name.
export function drawHands(state, { choose, select }) {
  $("hands").replaceChildren(...state.hands.map((hand, i) => {
    const item = make("li"), box = make("input", null, { type: "checkbox", "aria-label": "Plan for " + hand.display_name });
    box.checked = state.chosen.has(hand.name);
    box.addEventListener("change", () => choose(hand.name, box.checked));
    const answer = state.answers.get(hand.name), best = answer && answer.response && answer.response.grasps[0];
    const score = best ? best.score.toFixed(2) : answer ? (answer.error ? "failed" : "none") : "";
    const pick = button(null, () => select(hand.name), { class: "pick", "aria-pressed": hand.name === state.selected, "data-hand": hand.name });
    const swatch = make("span", null, { class: "swatch" });
    swatch.style.background = css(handColor(i));
    pick.append(swatch, make("span", hand.display_name, { class: "name" }), make("span", score, { class: "number" }));
    item.append(box, pick);
    if (hand.name === state.selected) item.append(about(hand));
    return item;
  }));
}
