// Elements are made here and nowhere else: text becomes text nodes, never HTML.
const SVG = "http://www.w3.org/2000/svg";
const data = JSON.parse(document.getElementById("data").textContent);

function fill(node, attributes, children) {
  for (const [key, value] of Object.entries(attributes || {})) {
    if (value === null || value === undefined || value === false) continue;
    if (key.startsWith("on")) node.addEventListener(key.slice(2), value);
    else node.setAttribute(key, value === true ? "" : value);
  }
  node.append(...children.flat(3).filter((child) => child !== null && child !== undefined));
  return node;
}
const el = (tag, attributes, ...children) => fill(document.createElement(tag), attributes, children);
const svg = (tag, attributes, ...children) => fill(document.createElementNS(SVG, tag), attributes, children);
const card = (title, ...children) => el("section", { class: "card" }, title && el("h2", {}, title), ...children);
const badge = (kind, text) => el("span", { class: `badge ${kind}` }, text);
const percent = (value, digits = 0) => (value === null ? "–" : `${(100 * value).toFixed(digits)} %`);
const day = (iso) => iso.slice(0, 10);
const time = (iso) => iso.slice(0, 16).replace("T", " ");
const tone = (episode) => (episode.completed ? (episode.cause ? "unknown" : "yes") : "no");
const ended = (episode) => badge(tone(episode), episode.reason || "truncated");
