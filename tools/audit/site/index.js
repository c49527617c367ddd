const filters = { cause: "", policy: "", from: "", to: "", end: "" };
let order = { key: "started_at", down: true };

function readAddress() {
  const asked = new URLSearchParams(location.hash.slice(1));
  for (const key of Object.keys(filters)) filters[key] = asked.get(key) || "";
}

function writeAddress() {
  const set = Object.entries(filters).filter(([, value]) => value);
  history.replaceState(null, "", `#${new URLSearchParams(set)}`);
}

function chosen() {
  return data.episodes.filter((e) =>
    (!filters.cause || e.causes.includes(filters.cause) || (e.action_causes[filters.cause] || 0) > 0) &&
    (!filters.policy || e.policy === filters.policy) &&
    (!filters.end || (e.reason || "truncated") === filters.end) &&
    (!filters.from || day(e.started_at) >= filters.from) &&
    (!filters.to || day(e.started_at) <= filters.to));
}

// --- figures -----------------------------------------------------------------------------------

function figureCard(name) {
  const [value, low, high] = data.figures[name];
  const scale = name === "motions" ? 1 : 100;
  const text = (v) => (v === null ? "–" : (scale * v).toFixed(1));
  const top = Math.max(scale === 100 ? 1 : 0, high || 0, value || 0) || 1;
  const x = (v) => 2 + (196 * (v || 0)) / top;
  const completed = data.figures[`${name}, completed`];
  return el("section", { class: "card figure" },
    el("h2", {}, name),
    el("b", {}, text(value)), scale === 100 ? " %" : "",
    svg("svg", { class: "interval", viewBox: "0 0 200 14", preserveAspectRatio: "none", "aria-hidden": "true" },
      svg("line", { x1: 2, x2: 198, y1: 7, y2: 7, stroke: "var(--edge)", "stroke-width": 2 }),
      svg("line", { x1: x(low), x2: x(high), y1: 7, y2: 7, stroke: "var(--accent)", "stroke-width": 4 }),
      svg("line", { x1: x(value), x2: x(value), y1: 1, y2: 13, stroke: "var(--ink)", "stroke-width": 2 })),
    el("span", { class: "faded small" }, `95 %: ${text(low)} to ${text(high)}`,
      completed ? el("span", { style: "display:block" }, `of completed episodes: ${text(completed[0])}`) : null));
}

// --- trend -------------------------------------------------------------------------------------

function trend(episodes) {
  const width = 620, height = 190, left = 40, bottom = 24, top = 10;
  const line = [...episodes].sort((a, b) => (a.started_at < b.started_at ? -1 : 1));
  const x = (i) => left + ((width - left - 12) * (i + 0.5)) / Math.max(line.length, 1);
  const y = (share) => top + (height - top - bottom) * (1 - share);
  const picture = svg("svg", { viewBox: `0 0 ${width} ${height}`, class: "chart", role: "img", "aria-label": "grasp success of each episode, in order of time" });
  for (const share of [0, 0.5, 1]) {
    picture.append(
      svg("line", { class: "axis", x1: left, x2: width - 8, y1: y(share), y2: y(share) }),
      svg("text", { x: left - 6, y: y(share) + 4, "text-anchor": "end" }, `${100 * share} %`));
  }
  const span = Math.max(3, Math.round(line.length / 12));
  const points = [];
  line.forEach((e, i) => {
    const near = line.slice(Math.max(0, i - span + 1), i + 1);
    const grasps = near.reduce((sum, n) => sum + n.grasps, 0);
    const held = near.reduce((sum, n) => sum + n.grasp_successes, 0);
    if (grasps) points.push(`${x(i).toFixed(1)},${y(held / grasps).toFixed(1)}`);
  });
  line.forEach((e, i) => {
    if (!e.grasps) return;
    const dot = svg("circle", { cx: x(i), cy: y(e.grasp_successes / e.grasps), r: line.length > 120 ? 2.5 : 4, fill: `var(--${tone(e)})`, "fill-opacity": 0.75 },
      svg("title", {}, `${e.episode}: ${e.grasp_successes} of ${e.grasps} grasps, ${e.reason || "truncated"}`));
    picture.append(svg("a", { href: `episodes/${e.slug}.html`, tabindex: -1 }, dot));
  });
  picture.append(svg("polyline", { class: "line", points: points.join(" ") }));
  if (line.length) {
    picture.append(
      svg("text", { x: left, y: height - 6 }, time(line[0].started_at)),
      svg("text", { x: width - 8, y: height - 6, "text-anchor": "end" }, time(line[line.length - 1].started_at)));
  }
  return [picture, el("p", { class: "faded small" }, `each dot an episode; the line: grasps of the last ${span} episodes together`)];
}

// --- causes ------------------------------------------------------------------------------------

function causeBars(counts) {
  const most = Math.max(1, ...counts.map(([, n]) => n));
  return el("div", { class: "bars" }, counts.map(([cause, n]) => [
    el("button", {
      "aria-pressed": String(filters.cause === cause), title: "show the episodes with it",
      onclick: () => set("cause", filters.cause === cause ? "" : cause),
    }, cause),
    el("div", { class: "bar", style: `width:${(100 * n) / most}%` }),
    el("span", { class: "count" }, String(n)),
    el("span", { class: "change" }, data.changes[cause]),
  ]));
}

function countCauses(episodes) {
  const counts = {};
  for (const e of episodes) {
    for (const [cause, n] of Object.entries(e.action_causes)) counts[cause] = (counts[cause] || 0) + n;
  }
  return Object.entries(counts).sort((a, b) => b[1] - a[1]);
}

function countEnds(episodes) {
  const counts = {};
  for (const e of episodes) if (e.cause) counts[e.cause] = (counts[e.cause] || 0) + 1;
  return Object.entries(counts).sort((a, b) => b[1] - a[1]);
}

// --- list --------------------------------------------------------------------------------------

const COLUMNS = [
  ["episode", "episode"], ["started_at", "started"], ["policy", "policy"], ["reason", "ended"],
  ["cause", "cause"], ["grasp_successes", "grasps", true], ["pushes", "pushes", true],
  ["refused", "refused", true], ["seconds", "s", true],
];

function list(episodes) {
  const sorted = [...episodes].sort((a, b) => {
    const [p, q] = [a[order.key], b[order.key]];
    const sign = p === q ? 0 : p === null ? 1 : q === null ? -1 : p < q ? -1 : 1;
    return order.down ? -sign : sign;
  });
  return el("div", { class: "scroll" }, el("table", { id: "episodes" },
    el("thead", {}, el("tr", {}, COLUMNS.map(([key, name, isNumber]) =>
      el("th", { class: isNumber ? "n" : "", "aria-sort": order.key === key ? (order.down ? "descending" : "ascending") : "none" },
        el("button", { tabindex: 0, onclick: () => { order = { key, down: order.key === key ? !order.down : true }; draw(); } },
          name, order.key === key ? (order.down ? " ↓" : " ↑") : ""))))),
    el("tbody", {}, sorted.map((e) => el("tr", {},
      el("td", {}, el("a", { href: `episodes/${e.slug}.html` }, e.episode)),
      el("td", { class: "faded when" }, time(e.started_at)),
      el("td", {}, e.policy),
      el("td", {}, ended(e)),
      el("td", { title: e.evidence || "" }, e.cause || el("span", { class: "faded" }, onTheWay(e))),
      el("td", { class: "n" }, `${e.grasp_successes}/${e.grasps}`),
      el("td", { class: "n" }, String(e.pushes)),
      el("td", { class: "n" }, String(e.refused)),
      el("td", { class: "n" }, e.seconds === null ? "–" : e.seconds.toFixed(0)))))));
}

// An episode that was completed has no cause; some of its actions may have failed all the same.
const onTheWay = (e) => Object.entries(e.action_causes).map(([cause, n]) => (n > 1 ? `${n} × ${cause}` : cause)).join(", ");

function select(key, name, values) {
  return el("label", {}, name, el("select", { id: key, onchange: (event) => set(key, event.target.value) },
    el("option", { value: "" }, "all"),
    values.map((value) => el("option", { value, selected: filters[key] === value }, value))));
}

const date = (key, name) => el("label", {}, name,
  el("input", { id: key, type: "date", value: filters[key], onchange: (event) => set(key, event.target.value) }));
const distinct = (values) => [...new Set(values)].sort();

function set(key, value) {
  filters[key] = value;
  writeAddress();
  draw();
  const again = document.getElementById(key);
  if (again) again.focus();
}

function draw() {
  const shown = chosen();
  const all = data.episodes;
  const causes = distinct(all.flatMap((e) => [...e.causes, ...Object.keys(e.action_causes)]));
  const failed = shown.reduce((sum, e) => sum + Object.values(e.action_causes).reduce((a, b) => a + b, 0), 0);
  const actions = shown.reduce((sum, e) => sum + e.tried, 0);
  const first = all.length ? day(all.reduce((a, e) => (e.started_at < a ? e.started_at : a), all[0].started_at)) : "";
  document.body.replaceChildren(el("main", {},
    el("h1", {}, `${all.length} episodes, ${data.actions} actions`),
    el("p", { class: "faded" }, first ? `since ${first}` : "", data.unreadable.length ? `; not read: ${data.unreadable.length}` : ""),
    el("div", { class: "grid figures" }, Object.keys(data.figures).filter((name) => !name.includes(",")).map(figureCard)),
    el("div", { class: "row", style: "margin-top:22px" },
      select("cause", "cause", causes),
      select("policy", "policy", distinct(all.map((e) => e.policy))),
      select("end", "ended", distinct(all.map((e) => e.reason || "truncated"))),
      date("from", "from"), date("to", "to"),
      el("button", { class: "plain", id: "clear", onclick: () => { for (const key of Object.keys(filters)) filters[key] = ""; writeAddress(); draw(); } }, "clear"),
      el("span", { class: "faded small", id: "count" }, `${shown.length} of ${all.length} episodes`)),
    el("div", { class: "grid two" },
      card("grasp success", ...trend(shown)),
      el("div", { class: "side" },
        card(`why ${failed} of ${actions} actions failed, and what to change`, causeBars(countCauses(shown))),
        countEnds(shown).length ? card("why episodes failed, and what to change", causeBars(countEnds(shown))) : null)),
    el("div", { class: "grid" }, card("episodes", list(shown))),
    data.unreadable.length ? el("div", { class: "grid" }, card("not read", el("ul", {}, data.unreadable.map((why) => el("li", { class: "mono" }, why))))) : null));
}

addEventListener("hashchange", () => { readAddress(); draw(); });
readAddress();
draw();
