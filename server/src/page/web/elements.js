// Small pieces of the page. What the server says becomes text, never markup.
export const $ = id => document.getElementById(id);

export function make(tag, text, attributes = {}) {
  const element = document.createElement(tag);
  if (text !== undefined && text !== null) element.textContent = text;
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  return element;
}

export function button(text, act, attributes = {}) {
  const element = make("button", text, { type: "button", ...attributes });
  element.addEventListener("click", act);
  return element;
}

// Rows of a name and a value, which is text or an element.
export function rows(table, list) {
  table.replaceChildren(...list.map(([name, value]) => {
    const row = make("tr"), cell = make("td");
    cell.append(value);
    row.append(make("th", name, { scope: "row" }), cell);
    return row;
  }));
}

export function bar(share, text, color) {
  const out = document.createDocumentFragment(), track = make("span", null, { class: "bar", "aria-hidden": "true" }), fill = make("i");
  fill.style.width = Math.round(100 * Math.min(Math.max(share, 0), 1)) + "%";
  if (color) fill.style.background = color;
  track.append(fill);
  out.append(track, make("span", text, { class: "number" }));
  return out;
}

export const words = text => text.replaceAll("_", " ");
export const mm = x => (1000 * x).toFixed(1) + " mm";
export const ms = s => s < 0.0995 ? (1000 * s).toFixed(1) + " ms" : s < 0.9995 ? (1000 * s).toFixed(0) + " ms" : s.toFixed(2) + " s";
