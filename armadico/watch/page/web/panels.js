// Lists with one node per row, which is reused so that the focus is kept.
export const $ = (id) => document.getElementById(id);

export function node(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name === "class") made.className = value;
    else if (name.startsWith("aria") || name === "role") made.setAttribute(name.replace("aria", "aria-").toLowerCase(), value);
    else made[name] = value;
  }
  made.append(...children.filter((c) => c !== null && c !== undefined && c !== ""));
  return made;
}

// One node per row, by its key; `draw(node, row)` fills it if the row has changed.
export function rows(list, found, key, draw, empty = "") {
  const known = new Map([...list.children].map((child) => [child.dataset.key, child]));
  let before = null;
  for (const row of found) {
    const name = `k${key(row)}`, text = JSON.stringify(row);
    let child = known.get(name);
    known.delete(name);
    if (!child) {
      child = node(list.tagName === "UL" || list.tagName === "OL" ? "li" : "div");
      child.dataset.key = name;
    }
    if (child.dataset.row !== text) {
      child.dataset.row = text;
      draw(child, row);
    }
    const place = before ? before.nextSibling : list.firstChild;
    if (place !== child) list.insertBefore(child, place);
    before = child;
  }
  for (const child of known.values()) child.remove();
  if (!found.length && empty) list.replaceChildren(node(list.tagName === "UL" ? "li" : "p", { class: "soft", textContent: empty }));
}

export function dot(colour, dead = false) {
  const made = node("span", { class: dead ? "dot dead" : "dot" });
  if (!dead) made.style.background = colour;
  return made;
}

export function put(element, text) {
  if (element.textContent !== text) element.textContent = text;
}
