// All text comes in as text nodes: names from files never become HTML.

const byId = (id) => document.getElementById(id);

function make(tag, given = {}, ...children) {
  const node = document.createElement(tag);
  for (const [key, value] of Object.entries(given)) {
    if (key.startsWith("on")) node.addEventListener(key.slice(2), value);
    else if (key in node && key !== "list") node[key] = value;
    else node.setAttribute(key, value);
  }
  node.append(...children);
  return node;
}

function svg(tag, given = {}, ...children) {
  const node = document.createElementNS(byId("vector").namespaceURI, tag);
  for (const [key, value] of Object.entries(given)) node.setAttribute(key, value);
  node.append(...children);
  return node;
}

function options(select, names, chosen) {
  select.replaceChildren(...names.map(([value, text]) => make("option", { value: String(value) }, text)));
  select.value = String(chosen);
}

const short = (value) => (Math.abs(value) < 100 ? value.toFixed(2) : value.toFixed(0));
