const { episode, steps } = data;
let current = 0;
const layers = { action: true, candidates: false, plan: false, path: true };

function readAddress() {
  const asked = Number((location.hash.match(/^#step-(\d+)$/) || [])[1]);
  current = Math.min(Math.max((asked || 1) - 1, 0), Math.max(steps.length - 1, 0));
}

function go(number) {
  if (number < 0 || number >= steps.length) return;
  current = number;
  history.replaceState(null, "", `#step-${number + 1}`);
  draw();
}

const decided = (index) => steps.slice(0, index + 1).filter((s) => s.kind !== "none").length - 1;
const picture = (names, kind) => (names && names[kind] ? `${data.folder}/${names[kind]}` : null);

// --- heightmap ---------------------------------------------------------------------------------

function actionMarks(step) {
  const [x, y] = step.action.at;
  const dx = -Math.sin(step.action.yaw), dy = -Math.cos(step.action.yaw);
  const strokes = [];
  if (step.kind === "push") {
    const [u, v] = [x + step.action.length * dx, y + step.action.length * dy];
    const wing = (turn) => {
      const [c, s] = [Math.cos(turn), Math.sin(turn)];
      return `M${u} ${v}L${u - 8 * (dx * c - dy * s)} ${v - 8 * (dx * s + dy * c)}`;
    };
    strokes.push(`M${x} ${y}L${u} ${v}${wing(0.5)}${wing(-0.5)}`);
  } else {
    const half = 42.5 / 2;
    strokes.push(`M${x - half * dx} ${y - half * dy}L${x + half * dx} ${y + half * dy}`);
    for (const side of [-1, 1]) {
      const [u, v] = [x + side * half * dx, y + side * half * dy];
      strokes.push(`M${u - 5.5 * dy} ${v + 5.5 * dx}L${u + 5.5 * dy} ${v - 5.5 * dx}`);
    }
  }
  const path = strokes.join("");
  return [
    svg("path", { d: path, fill: "none", stroke: "#000", "stroke-width": 4.2, "stroke-linecap": "round" }),
    svg("path", { d: path, fill: "none", stroke: "#fff", "stroke-width": 2, "stroke-linecap": "round" }),
  ];
}

function polyline(points, color, dashed) {
  const text = points.map(([x, y]) => `${x},${y}`).join(" ");
  return svg("polyline", { points: text, fill: "none", stroke: color, "stroke-width": 1.3, "stroke-dasharray": dashed ? "4 3" : null, "stroke-linejoin": "round" });
}

function heightmap(step) {
  const source = picture(data.looks[step.look], "map");
  if (!source) return el("div", { class: "missing" }, "no picture in the log");
  const marks = svg("svg", { viewBox: "0 0 224 224", role: "img", "aria-label": "the chosen action on the heightmap" });
  if (step.action) {
    if (layers.candidates) {
      for (const c of step.candidates) {
        marks.append(svg("circle", { cx: c.at[0], cy: c.at[1], r: 2.2, fill: c.kind === "push" ? "#ffb454" : "#5cc8ff", "fill-opacity": 0.85 },
          svg("title", {}, `${c.kind}, rotation ${c.rotation}: q ${c.q}`)));
      }
    }
    if (layers.plan) marks.append(polyline(step.plan.filter((w) => w.at).map((w) => w.at), "#ffd84d", true));
    if (layers.path) marks.append(polyline(step.path.at, "#ff5ca8", false));
    if (layers.action) marks.append(...actionMarks(step));
  }
  return el("div", { class: "map" }, el("img", { src: source, alt: "heightmap in colour, seen from above" }), marks);
}

const toggle = (name, text) => el("button", {
  class: "plain small", "aria-pressed": String(layers[name]),
  onclick: () => { layers[name] = !layers[name]; draw(); },
}, text);

function shot(source, caption) {
  return el("figure", {},
    source ? el("img", { class: "shot", src: source, alt: caption }) : el("div", { class: "missing" }, "no picture in the log"),
    el("figcaption", {}, caption));
}

// --- charts ------------------------------------------------------------------------------------

// What is measured at the end of a move is drawn as staying so until the next one.
function held(times, values, last) {
  const ends = [...times.slice(1), last];
  return times.flatMap((t, i) => [[t, values[i]], [ends[i], values[i]]]);
}

function chart(title, unit, times, values, options) {
  const width = 400, height = 170, left = 38, right = 8, top = 8, bottom = 22;
  const last = Math.max(...times, ...(options.until || []), 0.1);
  const limits = Object.entries(options.limits || {});
  const high = Math.max(...values, ...limits.map(([, v]) => v), options.least || 1) * 1.06;
  const low = Math.min(0, ...values);
  const x = (t) => left + ((width - left - right) * t) / last;
  const y = (v) => top + ((height - top - bottom) * (high - v)) / (high - low);
  const drawn = svg("svg", { class: "chart", viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": `${title} over time` });
  const power = 10 ** Math.floor(Math.log10(high / 2));
  const step = power * (high / power > 10 ? 5 : high / power > 5 ? 2 : 1);
  for (let v = 0; v <= high; v += step) {
    drawn.append(svg("line", { class: "axis", x1: left, x2: width - right, y1: y(v), y2: y(v) }),
      svg("text", { x: left - 5, y: y(v) + 4, "text-anchor": "end" }, String(Math.round(v))));
  }
  for (const [name, v] of limits) {
    drawn.append(svg("line", { class: "limit", x1: left, x2: width - right, y1: y(v), y2: y(v) }, svg("title", {}, `${name} stops at ${v} N`)));
  }
  for (const t of [0, last / 2, last]) {
    drawn.append(svg("text", { x: x(t), y: height - 6, "text-anchor": t === last ? "end" : t ? "middle" : "start" }, `${t.toFixed(1)} s`));
  }
  if (!values.length) {
    drawn.append(svg("text", { x: width / 2, y: height / 2, "text-anchor": "middle" }, "not measured"));
    return card(title, drawn);
  }
  const line = options.held ? held(times, values, last) : times.map((t, i) => [t, values[i]]);
  if (line.length > 1) drawn.append(svg("polyline", { class: "line", points: line.map(([t, v]) => `${x(t).toFixed(1)},${y(v).toFixed(1)}`).join(" ") }));
  if (options.held) times.forEach((t, i) => drawn.append(svg("circle", { class: "dot", cx: x(t), cy: y(values[i]), r: 4 }, svg("title", {}, `${values[i].toFixed(1)} ${unit} at ${t.toFixed(2)} s`))));
  const cursor = svg("line", { class: "cursor", x1: -9, x2: -9, y1: top, y2: height - bottom });
  const label = svg("text", { x: left + 6, y: top + 10 });
  drawn.append(cursor, label);
  drawn.addEventListener("pointermove", (event) => {
    const box = drawn.getBoundingClientRect();
    const t = (((event.clientX - box.left) / box.width) * width - left) * (last / (width - left - right));
    let best = 0;
    times.forEach((one, i) => { if (Math.abs(one - t) < Math.abs(times[best] - t)) best = i; });
    cursor.setAttribute("x1", x(times[best])); cursor.setAttribute("x2", x(times[best]));
    label.textContent = `${values[best].toFixed(1)} ${unit} at ${times[best].toFixed(2)} s`;
  });
  return card(title, drawn);
}

// --- Critic II ---------------------------------------------------------------------------------

const isOverruled = (step) => Boolean(step.verdict && step.verdict.overruled);

function critic(step) {
  if (!step.verdict) return card("Critic II", el("p", { class: "faded" }, "this policy has none"));
  const p = step.verdict.p;
  const width = 400, height = 120, apart = Math.min(39, (width - 8) / p.length);
  const bars = p.map((value, i) => svg("g", {},
    svg("rect", { x: 4 + i * apart, width: 0.77 * apart, y: 96 - 88 * (value || 0), height: 88 * (value || 0) + 1, rx: 3, fill: "var(--accent)" }),
    svg("text", { x: 4 + (i + 0.385) * apart, y: 112, "text-anchor": "middle" }, value === null ? "–" : value.toFixed(2))));
  return card("Critic II: success of the best grasps",
    svg("svg", { class: "chart", viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": "predicted success of the best grasps" },
      svg("line", { class: "axis", x1: 0, x2: width, y1: 97, y2: 97 }), bars),
    el("p", { class: "small" }, step.verdict.overruled ? overruled(step) : `agreed with Critic I: ${step.kind}`));
}

function overruled(step) {
  const other = step.kind === "push" ? "grasp" : "push";
  const best = Math.max(...step.candidates.filter((one) => one.kind === other).map((one) => one.q));
  const q = Number.isFinite(best) ? ` (q ${best.toFixed(2)})` : "";
  return `overruled Critic I, which preferred a ${other}${q}`;
}

// --- the page ----------------------------------------------------------------------------------

function findings(found, good) {
  if (!found.length) return el("section", { class: "card evidence good" }, good);
  return el("section", { class: "card evidence" }, el("ul", {}, found.map((one) =>
    el("li", {}, el("b", {}, one.cause), " — ", one.evidence, change(one.cause)))));
}

const change = (cause) => el("span", { class: "change" }, `What to change: ${data.changes[cause]}.`);

function facts(pairs) {
  return el("dl", {}, pairs.filter(([, value]) => value !== null && value !== undefined && value !== "").map(([name, value]) =>
    [el("dt", {}, name), el("dd", {}, String(value))]));
}

function stepView(step) {
  if (step.kind === "none") {
    return [
      el("div", { class: "grid two" },
        el("div", {}, heightmap(step)),
        shot(picture(data.looks[step.look], "camera"), "camera, before")),
      el("div", { class: "grid" }, card("every plan was refused", refusals(step))),
    ];
  }
  const q = data.q_maps[decided(current)];
  const outcome = step.outcome || {};
  const [x, y, z] = step.action.place;
  return [
    el("div", { class: "grid pictures" },
      el("figure", {}, heightmap(step), el("div", { class: "row", style: "margin-top:8px;gap:6px" },
        toggle("action", "action"), toggle("path", "measured path"), toggle("plan", "plan"), toggle("candidates", "candidates"))),
      el("div", { class: "side" },
        shot(picture(data.looks[step.look], "camera"), "camera, before"),
        shot(picture(data.looks[step.after], "camera"), "camera, after")),
      el("div", { class: "side", style: "grid-template-columns:1fr" },
        shot(picture(q, step.kind), `Q-map, ${step.kind}: the chosen kind`),
        el("details", {}, el("summary", { class: "small faded" }, "the other Q-map"),
          shot(picture(q, step.kind === "push" ? "grasp" : "push"), `Q-map, ${step.kind === "push" ? "grasp" : "push"}`)))),
    el("div", { class: "grid charts" },
      chart("force at the tool, N", "N", step.path.t, step.path.force, { limits: step.limits }),
      chart("height of the tool, mm", "mm", step.path.t, step.path.height, {}),
      chart("width between the pads, mm", "mm", step.widths.map((w) => w[0]), step.widths.map((w) => w[1]), { held: true, until: step.path.t, least: 85 })),
    el("div", { class: "grid charts" },
      card("decision", facts([
        ["action", `${step.kind} at (${x}, ${y}, ${z}) m`], ["direction", `${((step.action.yaw * 180) / Math.PI).toFixed(1)}°, rotation ${step.rotation}`],
        ["q", step.q], ["decided in", Object.entries(step.decided_in).map(([part, s]) => `${part.replace("_", " ")} ${s.toFixed(2)} s`).join(", ")],
        ["notes", step.notes.join("; ")]])),
      critic(step),
      card("outcome", facts([["success", step.success || "not known"], ...Object.entries(outcome)]))),
    el("div", { class: step.refusals.length ? "grid two" : "grid" },
      card("plan", el("div", { class: "scroll" }, el("table", {}, el("tbody", {}, step.plan.map((w) => el("tr", {},
        el("td", {}, w.name), el("td", { class: "n" }, w.at ? `${w.height.toFixed(0)} mm high` : `pads ${w.width} mm`),
        el("td", { class: "faded" }, step.limits[w.name] ? `stops at ${step.limits[w.name]} N` : ""))))))),
      step.refusals.length ? card(`${step.refusals.length} ${step.refusals.length === 1 ? "plan" : "plans"} refused before`, refusals(step)) : null),
  ];
}

const refusals = (step) => el("ul", { class: "small", style: "margin:0;padding-left:18px" },
  step.refusals.map((one) => el("li", {}, el("b", {}, one.cause), ": ", one.reason)));

function draw() {
  const step = steps[current];
  const where = scrollY;
  document.body.replaceChildren(el("main", {},
    el("div", { class: "row spread small" },
      el("a", { href: "../index.html", id: "overview" }, "← all episodes"),
      el("span", { class: "row" },
        data.earlier && el("a", { href: `${data.earlier}.html`, id: "earlier" }, "← earlier"),
        data.later && el("a", { href: `${data.later}.html`, id: "later" }, "later →"),
        el("span", { class: "faded" }, el("kbd", {}, "←"), " ", el("kbd", {}, "→"), " step  ", el("kbd", {}, "f"), " next failure  ", el("kbd", {}, "["), " ", el("kbd", {}, "]"), " episode"))),
    el("div", { class: "row", style: "margin-top:10px" }, el("h1", {}, episode.episode), ended(episode)),
    el("p", { class: "faded small" }, [
      time(episode.started_at), `${episode.cell} cell`, `policy ${episode.policy}`,
      episode.seed === null ? null : `seed ${episode.seed}`, `grasps ${episode.grasp_successes}/${episode.grasps}`,
      `pushes ${episode.pushes}`, `refused ${episode.refused}`, episode.commit && `commit ${episode.commit.slice(0, 10)}`,
    ].filter(Boolean).join(" · ")),
    el("div", { class: "grid" }, findings(data.findings, episode.completed && steps.every((one) => !one.findings.length) ? "Nothing failed." : "This episode was completed; the failures below did not keep it from that.")),
    el("nav", { class: "timeline", "aria-label": "steps" }, steps.map((one, i) => el("button", {
      class: `${one.success || "none"} ${one.kind}${isOverruled(one) ? " overruled" : ""}`, "aria-current": i === current ? "step" : null, tabindex: 0,
      title: `${i + 1}: ${one.kind}, ${one.findings.length ? one.findings[0].cause : one.success}${isOverruled(one) ? "; Critic II overruled Critic I" : ""}`, onclick: () => go(i),
    }, el("i", {}), String(i + 1)))),
    step ? [
      el("div", { class: "row", style: "margin-top:16px" },
        el("h1", { id: "step", style: "font-size:19px;margin:0" }, `Step ${current + 1} of ${steps.length}: ${step.kind === "none" ? "no action" : step.kind}`),
        badge(step.success || "none", step.success === "yes" ? "success" : step.success === "no" ? "failed" : step.success || "no outcome")),
      el("div", { class: "grid" }, findings(step.findings, "This action succeeded.")),
      stepView(step),
    ] : el("p", { class: "faded" }, "no step was logged")));
  scrollTo(0, where);
}

addEventListener("keydown", (event) => {
  if (event.altKey || event.ctrlKey || event.metaKey || /^(INPUT|SELECT)$/.test(event.target.tagName)) return;
  const failure = steps.findIndex((one, i) => i > current && one.findings.length);
  if (event.key === "ArrowRight" || event.key === "j") go(current + 1);
  else if (event.key === "ArrowLeft" || event.key === "k") go(current - 1);
  else if (event.key === "Home") go(0);
  else if (event.key === "End") go(steps.length - 1);
  else if (event.key === "f" && failure >= 0) go(failure);
  else if (event.key === "[" && data.earlier) location.href = `${data.earlier}.html`;
  else if (event.key === "]" && data.later) location.href = `${data.later}.html`;
  else return;
  event.preventDefault();
});
addEventListener("hashchange", () => { readAddress(); draw(); });
readAddress();
draw();
