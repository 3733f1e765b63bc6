"use strict";
// Plays what `semloc_core.report.replay.page.Content` holds. Lengths are metres, north is up: y is turned over when drawn.
(async () => {
const $ = (id) => document.getElementById(id);
const SVG = "http://www.w3.org/2000/svg";
const BLUE = "#0072B2", ORANGE = "#E69F00", GREEN = "#009E73", VERMILLION = "#D55E00", PURPLE = "#CC79A7", SKY = "#56B4E9";
const COLOURS = [BLUE, ORANGE, GREEN, PURPLE, SKY, VERMILLION, "#F0E442"];
const STATUS = { match: [BLUE, 1, "accepted"], ambiguous: [ORANGE, 0.66, "could be elsewhere"],
  unknown: ["#8C8C8C", 0.33, "nothing to go by, or not in this map"], no_graph: ["#8C8C8C", 0.1, "updates missing"] };
const KIND = { match: "listed", rival: "rival", alike: "looks alike" };

async function unpacked() {
  const text = $("data").textContent.trim();
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return JSON.parse(await new Response(stream).text());
}
function trouble(line) { $("trouble").textContent = line; $("trouble").hidden = !line; }
if (typeof DecompressionStream === "undefined") return trouble("This browser is too old to unpack the page's data (Chrome 80, Firefox 113, Safari 16.4 or newer do).");

const D = await unpacked();
const look = new Map(D.classes.map((name, i) => [name, i]));
const at = { frame: 0, playing: false, rival: null, building: null, storey: null, follow: true, metres: 20, pan: [0, 0] };
const narrow = () => innerWidth < 640;
let whole = !narrow();

// -- small helpers ----------------------------------------------------------------------------------------------
function tag(name, attributes, ...inside) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes || {})) {
    if (key === "style") made.style.cssText = value;
    else if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (key.startsWith("aria-")) made.setAttribute(key, value);
    else if (value !== null && value !== false) made.setAttribute(key, value === true ? "" : value);
  }
  made.append(...inside.filter((each) => each !== null && each !== undefined));
  return made;
}
function draw(name, attributes, ...inside) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes || {})) if (value !== null && value !== undefined) made.setAttribute(key, value);
  made.append(...inside);
  return made;
}
// Keeps the keyboard's focus on what bears the same number when it is drawn anew.
function redrawn(name, make) {
  const held = document.activeElement && document.activeElement.dataset && document.activeElement.dataset[name];
  make();
  const again = held && document.querySelector(`[data-${name}="${held}"]`);
  if (again) again.focus({ preventScroll: true });
}
const percent = (p) => (p > 0 && p < 0.005 ? "<1%" : p < 1 && p >= 0.995 ? ">99%" : `${Math.round(100 * p)}%`);
const signed = (v) => (Math.abs(v) < 0.005 ? "0" : `${v > 0 ? "+" : "−"}${Math.abs(v).toFixed(Math.abs(v) < 10 ? 2 : 1)}`);
const clock = (s) => { const t = Math.max(0, s); return `${Math.floor(t / 60)}:${(t % 60).toFixed(1).padStart(4, "0")}`; };
const title = (text) => draw("title", {}, document.createTextNode(text));
// As the command line has it: p86 of a 64-bit id with a letter, which --place takes.
const short = (id) => {
  const [letter, number] = /^\d{15,20}$/.test(id) ? [BigInt(id) >> 56n, BigInt(id) & ((1n << 56n) - 1n)] : [0n, 0n];
  const name = String.fromCharCode(Number(letter));
  return /^[A-Za-z]$/.test(name) ? `${name}${number}` : id.length > 8 ? `…${id.slice(-5)}` : id;
};
const turned = ([x, y, , yaw], p) => [x + Math.cos(yaw) * p[0] - Math.sin(yaw) * p[1], y + Math.sin(yaw) * p[0] + Math.cos(yaw) * p[1]];

// Shapes of radius 1, y down.
const SHAPES = ["M-1,0A1,1,0,1,0,1,0A1,1,0,1,0,-1,0Z", "M-.9-.9H.9V.9H-.9Z", "M0-1.1L1.05,.8H-1.05Z", "M0-1.2L1.2,0 0,1.2-1.2,0Z",
  "M0,1.1L1.05-.8H-1.05Z", "M-.35-1H.35V-.35H1V.35H.35V1H-.35V.35H-1V-.35H-.35Z", "M0-1.2L.35-.4 1.2-.35 .55,.2 .75,1 0,.55-.75,1-.55,.2-1.2-.35-.35-.4Z"];
function classLook(name) {
  const i = look.has(name) ? look.get(name) : -1;
  if (i < 0) return ["#8C8C8C", SHAPES[0]];
  return [COLOURS[i % 7], SHAPES[((i % 7) + Math.floor(i / 7)) % 7]];
}
function sample(name, seen = true) {
  const [colour, shape] = classLook(name);
  return draw("svg", { width: 16, height: 16, viewBox: "-1.6 -1.6 3.2 3.2", "aria-hidden": "true" },
    draw("path", { d: shape, fill: colour, "fill-opacity": seen ? 1 : 0.3, stroke: "currentColor", "stroke-width": 0.2 }));
}

// -- data -------------------------------------------------------------------------------------------------------
const asked = new Set();
function building(name) {
  if (D.buildings[name] || !D.live || asked.has(name)) return D.buildings[name];
  asked.add(name);
  fetch(`building?name=${encodeURIComponent(name)}`).then((r) => r.json()).then((b) => { D.buildings[name] = b; show(); });
  return undefined;
}
const frame = () => D.frames[at.frame];
const knowsTruth = () => D.frames.some((f) => f.right !== null && f.right !== undefined);
function bad(f) {
  if (f.right === true || f.right === false) return f.right === false && f.candidates.length > 0;
  return !knowsTruth() && f.status !== "match";
}
function rivalNow(f) {
  if (!at.rival) return 0;
  let best = 0, near = 6;
  f.candidates.forEach((c, i) => {
    if (i === 0 || c.map !== at.rival.map || c.storey !== at.rival.storey) return;
    const off = Math.hypot(c.position[0] - at.rival.position[0], c.position[1] - at.rival.position[1]);
    if (off < near) { near = off; best = i; }
  });
  return best;
}

// -- the time line ----------------------------------------------------------------------------------------------
const MARGIN = 9;
function timeline() {
  const svg = $("line"), width = svg.clientWidth, frames = D.frames;
  svg.replaceChildren();
  if (!width || !frames.length) return;
  svg.setAttribute("viewBox", `0 0 ${width} 96`);
  const x = (i) => MARGIN + (frames.length > 1 ? i / (frames.length - 1) : 0) * (width - 2 * MARGIN);
  const step = frames.length > 1 ? x(1) - x(0) : width - 2 * MARGIN;
  for (const p of [0, 1]) svg.append(draw("path", { d: `M${MARGIN},${58 - 38 * p}H${width - MARGIN}`, stroke: "currentColor", "stroke-opacity": 0.2 }));
  let d = "", open = false;
  frames.forEach((f, i) => {
    if (!f.candidates.length) { open = false; return; }
    d += `${open ? "L" : "M"}${x(i).toFixed(1)},${(58 - 38 * f.candidates[0].probability).toFixed(1)}`;
    open = true;
  });
  svg.append(draw("path", { d, fill: "none", stroke: "currentColor", "stroke-width": 1.5, "stroke-linejoin": "round" }));
  svg.append(Object.assign(draw("text", { x: MARGIN, y: 12, "font-size": 13 }), { textContent: "probability" }));
  const runs = (of, paint) => {
    for (let i = 0; i < frames.length;) {
      let end = i;
      while (end + 1 < frames.length && of(frames[end + 1]) === of(frames[i])) end++;
      paint(of(frames[i]), Math.max(MARGIN - 1, x(i) - step / 2), Math.min(width - MARGIN + 1, x(end) + step / 2), i);
      i = end + 1;
    }
  };
  runs((f) => f.status, (status, from, to) => {
    const [colour, height] = STATUS[status];
    svg.append(draw("rect", { x: from, y: 78 - 14 * height, width: Math.max(1, to - from), height: 14 * height, fill: colour }, title(status)));
  });
  runs((f) => (f.right === true ? "right" : bad(f) && f.right === false ? "wrong" : ""), (verdict, from, to) => {
    if (!verdict) return;
    const wrong = verdict === "wrong";
    svg.append(draw("rect", { x: from, y: wrong ? 82 : 84, width: Math.max(1.5, to - from), height: wrong ? 12 : 4, fill: wrong ? VERMILLION : GREEN }, title(verdict)));
  });
  svg.append(draw("path", { id: "now", stroke: "currentColor", "stroke-width": 2.5 }));
  here();
}
function here() {
  const now = $("now"), width = $("line").clientWidth, last = D.frames.length - 1;
  if (!now || last < 0) return;
  const x = MARGIN + (last ? at.frame / last : 0) * (width - 2 * MARGIN);
  now.setAttribute("d", `M${x},14V95`);
}
function chips() {
  const counts = D.live ? D.frames.reduce((all, f) => ({ ...all, [f.status]: (all[f.status] || 0) + 1 }), {}) : D.statuses;
  const made = Object.entries(STATUS).filter(([name]) => counts[name]).map(([name, [colour, height, words]]) => tag("span", { title: words },
    draw("svg", { width: 14, height: 14, "aria-hidden": "true" }, draw("rect", { y: 14 - 14 * height, width: 14, height: 14 * height, fill: colour })), `${name} ${counts[name].toLocaleString("en")}`));
  if (knowsTruth()) made.push(
    tag("span", {}, draw("svg", { width: 14, height: 14, "aria-hidden": "true" }, draw("rect", { y: 5, width: 14, height: 4, fill: GREEN })), "right"),
    tag("span", {}, draw("svg", { width: 14, height: 14, "aria-hidden": "true" }, draw("rect", { width: 14, height: 14, fill: VERMILLION })), "wrong"));
  $("statuses").replaceChildren(...made);
}

// -- the plan ---------------------------------------------------------------------------------------------------
let fixed = "", scale = 0.05;
function shown(f) {
  const rival = f ? rivalNow(f) : 0, best = f && f.candidates[rival];
  const name = at.building || (best && best.map) || (f && f.truth && f.truth.map) || Object.keys(D.buildings)[0];
  const b = name && building(name);
  if (!b) return null;
  let storey = at.storey;
  if (storey === null || storey >= b.storeys) storey = best && best.map === name ? best.storey : f && f.truth && f.truth.map === name ? f.truth.storey : 0;
  return { b, name, storey };
}
function bounds(b, storey) {
  const points = [...b.places.filter((p) => p[2] === storey), ...b.objects.filter((o) => o[4] === storey).map((o) => [o[2], o[3]])];
  if (!points.length) return [0, 0, 1, 1];
  const xs = points.map((p) => p[0]), ys = points.map((p) => p[1]);
  const low = (v) => v.reduce((a, c) => Math.min(a, c)), high = (v) => v.reduce((a, c) => Math.max(a, c));
  return [low(xs), low(ys), high(xs), high(ys)];
}
function middle(f, v) {
  const c = f && f.candidates[rivalNow(f)];
  if (c && c.map === v.name && c.storey === v.storey) return c.pose || c.position;
  if (f && f.truth && f.truth.map === v.name && f.truth.storey === v.storey) return f.truth.position;
  const [x0, y0, x1, y1] = bounds(v.b, v.storey);
  return [(x0 + x1) / 2, (y0 + y1) / 2];
}
function view(f, v) {
  const svg = $("plan"), w = Math.max(1, svg.clientWidth), [x0, y0, x1, y1] = bounds(v.b, v.storey);
  // As high as the storey needs, if the screen has room.
  const fit = (w * (y1 - y0 + 4)) / (x1 - x0 + 4);
  svg.style.height = `${Math.round(Math.min(Math.max(narrow() ? 300 : 340, fit), 0.7 * Math.max(innerHeight, 500)))}px`;
  const h = Math.max(1, svg.clientHeight);
  let cx, cy;
  if (whole) {
    scale = Math.max((x1 - x0 + 4) / w, (y1 - y0 + 4) / h, 0.008);
    [cx, cy] = [(x0 + x1) / 2, (y0 + y1) / 2];
  } else {
    scale = Math.min(at.metres, Math.max(x1 - x0, y1 - y0) + 4) / Math.min(w, h);
    [cx, cy] = middle(f, v);
  }
  cx += at.pan[0]; cy += at.pan[1];
  svg.setAttribute("viewBox", `${cx - (w * scale) / 2} ${-cy - (h * scale) / 2} ${w * scale} ${h * scale}`);
  return [cx - (w * scale) / 2, -cy + (h * scale) / 2, w * scale];
}
function mark(x, y, path, size, attributes, ...inside) {
  return draw("path", { d: path, transform: `translate(${x.toFixed(3)},${(-y).toFixed(3)}) scale(${(size * scale).toFixed(5)})`, "stroke-width": 0.25, ...attributes }, ...inside);
}
function still(v) {
  const key = `${v.name}|${v.storey}|${scale.toFixed(5)}`;
  let layer = $("still");
  if (layer && fixed === key) return layer;
  fixed = key;
  layer = draw("g", { id: "still" });
  const { b, storey } = v;
  const on = (i) => b.places[i][2] === storey;
  const ways = b.edges.filter(([i, j]) => on(i) || on(j)).map(([i, j]) => `M${b.places[i][0]},${-b.places[i][1]}L${b.places[j][0]},${-b.places[j][1]}`).join("");
  layer.append(draw("path", { d: ways, fill: "none", stroke: "currentColor", "stroke-opacity": 0.16, "stroke-width": 1, "vector-effect": "non-scaling-stroke" }));
  const dots = b.places.filter((p) => p[2] === storey).map((p) => `M${p[0]},${-p[1]}h0`).join("");
  layer.append(draw("path", { d: dots, stroke: "currentColor", "stroke-opacity": 0.28, "stroke-width": 2.5, "stroke-linecap": "round", "vector-effect": "non-scaling-stroke" }));
  for (const [id, name, x, y, of] of b.objects) {
    if (of !== storey) continue;
    const [colour, shape] = classLook(name);
    layer.append(mark(x, y, shape, 4.5, { fill: colour, "fill-opacity": 0.25, stroke: colour, "stroke-opacity": 0.8 }, title(`${name} of the map (${id})`)));
  }
  return layer;
}
function ellipse([x, y], [xx, xy, yy], colour) {
  // 95 %: 2.45 standard deviations in two dimensions.
  const mean = (xx + yy) / 2, gap = Math.hypot((xx - yy) / 2, xy), turn = (-Math.atan2(2 * xy, xx - yy) / 2) * (180 / Math.PI);
  const [a, b] = [mean + gap, mean - gap].map((v) => 2.45 * Math.sqrt(Math.max(0, v)));
  return draw("ellipse", { rx: Math.max(a, 3 * scale), ry: Math.max(b, 3 * scale), transform: `translate(${x},${-y}) rotate(${turn})`, fill: colour, "fill-opacity": 0.18, stroke: colour, "stroke-width": 1.2, "vector-effect": "non-scaling-stroke" });
}
const ARROW = "M1.5,0L-1,1-.45,0-1-1Z", DOT = SHAPES[0];
function robot(x, y, yaw, size, attributes, ...inside) {
  const turn = yaw === null || yaw === undefined ? "" : ` rotate(${(-yaw * 180) / Math.PI})`;
  return draw("path", { d: turn ? ARROW : DOT, transform: `translate(${x},${-y})${turn} scale(${size * scale})`, "stroke-width": 0.2, "stroke-linejoin": "round", ...attributes }, ...inside);
}
function way(v, of, attributes) {
  let d = "", last = null;
  for (let i = Math.max(0, at.frame - 1500); i <= at.frame; i++) {
    const p = of(D.frames[i]);
    if (!p) { last = null; continue; }
    d += `${last && Math.hypot(p[0] - last[0], p[1] - last[1]) < 5 ? "L" : "M"}${p[0]},${-p[1]}`;
    last = p;
  }
  return draw("path", { d, fill: "none", "stroke-linejoin": "round", "stroke-linecap": "round", "vector-effect": "non-scaling-stroke", ...attributes });
}
function laid(f, c, v, layer) {
  const e = c.evidence;
  if (!e) return;
  const most = Math.max(1, ...e.nats);
  f.seen.forEach(([id, name, where], i) => {
    const mapped = e.mapped[i] >= 0 ? v.b.objects[e.mapped[i]] : null, nats = e.nats[i], wide = 1 + 5 * Math.min(1, Math.max(0, nats) / most);
    const p = where && c.laid ? turned(c.laid, where) : null;
    if (mapped) {
      layer.append(draw("circle", { cx: mapped[2], cy: -mapped[3], r: 9 * scale, fill: "none", stroke: BLUE, "stroke-width": wide / 2 + 0.5, "vector-effect": "non-scaling-stroke", class: "explains" }, title(`${name} of the map (${mapped[0]}) explains the ${name} seen (${id}): ${signed(nats)} nats`)));
      if (p) layer.append(draw("path", { d: `M${p[0]},${-p[1]}L${mapped[2]},${-mapped[3]}`, stroke: BLUE, "stroke-width": wide, "stroke-linecap": "round", "vector-effect": "non-scaling-stroke", class: "joined" }));
    }
    if (!p) return;
    const [colour, shape] = classLook(name);
    layer.append(mark(p[0], p[1], shape, 5.5, { fill: colour, stroke: "currentColor", class: "seen" }, title(`${name} seen (${id}): ${mapped ? `${signed(nats)} nats` : "a stranger, nothing mapped explains it"}`)));
    if (!mapped) layer.append(draw("circle", { cx: p[0], cy: -p[1], r: 9 * scale, fill: "none", stroke: VERMILLION, "stroke-width": 2, "stroke-dasharray": "3 2.5", "vector-effect": "non-scaling-stroke", class: "stranger" }));
  });
  for (const [number, nats] of e.missed) {
    const o = v.b.objects[number];
    if (o) layer.append(mark(o[2], o[3], "M-1-1L1,1M1-1L-1,1", 6 + 2 * Math.min(2, -nats), { stroke: "currentColor", "stroke-opacity": 0.75, "stroke-width": 0.35, fill: "none", class: "missed" }, title(`${o[1]} of the map (${o[0]}) should be seen from there and is not: ${signed(nats)} nats`)));
  }
}
function plan(f) {
  const svg = $("plan"), v = shown(f);
  if (!v) { svg.replaceChildren(); return; }
  const [left, bottom, wide] = view(f, v);
  const layer = draw("g", { id: "moving" }), rival = f ? rivalNow(f) : 0;
  const here = (c) => c.map === v.name && c.storey === v.storey;
  if (f) {
    layer.append(way(v, (g) => (g.truth && g.truth.map === v.name && g.truth.storey === v.storey ? g.truth.position : null), { stroke: "currentColor", "stroke-width": 5, "stroke-opacity": 0.18 }));
    layer.append(way(v, (g) => (g.status === "match" && here(g.candidates[0]) ? g.candidates[0].pose || g.candidates[0].position : null), { stroke: BLUE, "stroke-width": 2, "stroke-opacity": 0.8 }));
    const main = f.candidates[rival];
    if (main && here(main)) laid(f, main, v, layer);
    f.candidates.forEach((c, i) => {
      if (!here(c)) return;
      const [x, y, yaw] = c.pose || [c.position[0], c.position[1], null], chosen = i === rival;
      if (i === 0) {
        if (c.covariance) layer.append(ellipse([x, y], c.covariance, BLUE));
        layer.append(robot(x, y, yaw, 10, { fill: BLUE, stroke: "#fff", id: "robot" }, title(`the answer: ${c.place}`)));
        return;
      }
      const words = `${i}: ${KIND[c.kind]}, ${c.kind === "alike" ? `similarity ${c.similarity.toFixed(2)}` : percent(c.probability)}. Why not there?`;
      const ghost = draw("g", { class: "ghost", role: "button", tabindex: 0, "aria-label": words, "aria-pressed": chosen, "data-rival": i }, title(words),
        draw("circle", { cx: x, cy: -y, r: 17 * scale, fill: chosen ? ORANGE : "var(--card)", "fill-opacity": chosen ? 0.35 : 0.7, stroke: ORANGE, "stroke-width": chosen ? 3 : 2, "stroke-dasharray": chosen ? null : "4 3", "vector-effect": "non-scaling-stroke" }),
        robot(x, y, yaw, 7, { fill: ORANGE, "fill-opacity": 0.5, stroke: "currentColor" }),
        Object.assign(draw("text", { x: x + 19 * scale, y: -y - 9 * scale, "font-size": 15 * scale, "font-weight": 700 }), { textContent: i }));
      ghost.addEventListener("click", (e) => { e.stopPropagation(); choose(i); });
      ghost.addEventListener("keydown", (e) => { if (e.key === "Enter") { e.stopPropagation(); choose(i); } });
      layer.append(ghost);
    });
    const t = f.truth;
    if (t && t.map === v.name && t.storey === v.storey) layer.append(robot(t.position[0], t.position[1], t.yaw, 15, { fill: "none", stroke: "currentColor", "stroke-width": 0.18, id: "truth" }, title("where the robot truly is")));
  }
  const metres = [1, 2, 5, 10, 20, 50, 100, 200, 500].find((m) => m / scale > 60) || 1000, x = left + 12 * scale, y = bottom - 12 * scale;
  layer.append(draw("path", { d: `M${x},${y - 5 * scale}V${y}H${x + metres}V${y - 5 * scale}`, fill: "none", stroke: "currentColor", "stroke-width": 2, "vector-effect": "non-scaling-stroke" }),
    Object.assign(draw("text", { x: x + 4 * scale, y: y - 8 * scale, "font-size": 14 * scale }), { textContent: `${metres} m` }));
  redrawn("rival", () => svg.replaceChildren(still(v), layer));
  switches(v);
}
function switches(v) {
  const names = D.live ? [...new Set([...Object.keys(D.buildings), ...D.frames.flatMap((f) => f.candidates.map((c) => c.map))])].sort() : Object.keys(D.buildings);
  $("building-label").hidden = names.length < 2;
  const select = $("building"), wanted = ["", ...names].join("\n");
  if (select.dataset.names !== wanted) {
    select.dataset.names = wanted;
    select.replaceChildren(tag("option", { value: "" }, "the answer's"), ...names.map((name) => tag("option", { value: name }, name)));
    select.value = at.building || "";
  }
  const group = $("storeys");
  const state = `${v.b.storeys}|${v.storey}|${at.storey}`;
  if (group.dataset.state !== state) {
    group.dataset.state = state;
    group.replaceChildren(...(v.b.storeys < 2 ? [] : [tag("button", { "aria-pressed": at.storey === null, title: "the storey of the answer", onclick: () => { at.storey = null; show(); } }, "Follow"),
      ...Array.from({ length: v.b.storeys }, (_, i) => tag("button", { "aria-pressed": v.storey === i, onclick: () => { at.storey = i; show(); } }, `Storey ${i + 1}`))]));
  }
  $("whole").textContent = whole ? "Around the robot" : "Whole storey";
}
function key() {
  const icon = (...inside) => draw("svg", { width: 22, height: 16, viewBox: "-11 -8 22 16", "aria-hidden": "true" }, ...inside);
  const item = (words, ...inside) => tag("span", {}, icon(...inside), words);
  $("key").replaceChildren(
    item("robot, 95 % ellipse", draw("ellipse", { rx: 10, ry: 7, fill: BLUE, "fill-opacity": 0.2, stroke: BLUE }), draw("path", { d: ARROW, transform: "scale(5)", fill: BLUE })),
    ...(knowsTruth() ? [item("truth", draw("path", { d: ARROW, transform: "scale(6)", fill: "none", stroke: "currentColor", "stroke-width": 0.3 }))] : []),
    item("mapped", draw("path", { d: SHAPES[1], transform: "scale(4.5)", fill: "currentColor", "fill-opacity": 0.2, stroke: "currentColor", "stroke-width": 0.2 })),
    item("seen, joined to what explains it", draw("path", { d: "M-8,0H8", stroke: BLUE, "stroke-width": 4 }), draw("path", { d: SHAPES[1], transform: "translate(-6,0) scale(4.5)", fill: "currentColor" })),
    item("stranger", draw("circle", { r: 7, fill: "none", stroke: VERMILLION, "stroke-width": 2, "stroke-dasharray": "3 2.5" })),
    item("missed", draw("path", { d: "M-5-5L5,5M5-5L-5,5", stroke: "currentColor", "stroke-opacity": 0.75, "stroke-width": 2.2 })),
    item("elsewhere: click", draw("circle", { r: 7, fill: "none", stroke: ORANGE, "stroke-width": 2, "stroke-dasharray": "4 3" })));
}

// -- what is said -----------------------------------------------------------------------------------------------
function answer(f) {
  const c = f.candidates[0], [colour, , words] = STATUS[f.status];
  const head = tag("div", { class: "answer-head" }, tag("span", { class: "badge", style: `border-color:${colour}`, title: words }, f.status));
  if (f.right === true) head.append(tag("b", {}, tag("span", { style: `color:${GREEN}` }, "✓"), " right"));
  if (f.right === false && c) head.append(tag("b", {}, tag("span", { style: `color:${VERMILLION}` }, "✗"), " wrong"));
  head.append(c ? `${c.map}, place ${short(c.place)}` : words);
  const made = [head], numbers = [];
  if (c) {
    made.push(tag("div", { class: "meter", role: "img", "aria-label": `probability ${percent(c.probability)}` }, tag("i", { style: `width:${100 * c.probability}%` })));
    numbers.push(["probability", percent(c.probability)], ["position, m", (c.pose || c.position).slice(0, 2).map((v) => v.toFixed(1)).join(", ")]);
    if (c.pose && c.pose[2] !== null) numbers.push(["heading", `${Math.round((c.pose[2] * 180) / Math.PI)}°`]);
    numbers.push(["similarity", c.similarity.toFixed(2)]);
    if (c.evidence) numbers.push(["evidence", `${signed(c.evidence.score)} nats`]);
  }
  if (f.off_m !== null && f.off_m !== undefined) numbers.push(["off the truth", f.off_m < 1 ? `${(100 * f.off_m).toFixed(0)} cm` : `${f.off_m.toFixed(1)} m`]);
  if (f.off_deg !== null && f.off_deg !== undefined) numbers.push(["heading off", `${f.off_deg.toFixed(f.off_deg < 10 ? 1 : 0)}°`]);
  if (f.truth && c && f.truth.map !== c.map) numbers.push(["truly in", f.truth.map]);
  else if (f.truth && c && f.truth.storey !== c.storey) numbers.push(["storey", `${c.storey + 1}, truly ${f.truth.storey + 1}`]);
  made.push(tag("dl", { class: "numbers" }, ...numbers.map(([name, value]) => tag("div", {}, tag("dt", {}, name), tag("dd", {}, value)))));
  $("answer").replaceChildren(...made);
}
function candidates(f) {
  const rival = rivalNow(f);
  const made = f.candidates.slice(1).map((c, n) => tag("button", { "aria-pressed": n + 1 === rival, "data-candidate": n + 1, onclick: () => choose(n + 1) },
    tag("b", {}, `${n + 1}`), tag("span", {}, `${KIND[c.kind]}: ${c.map}${D.buildings[c.map] && D.buildings[c.map].storeys > 1 ? `, storey ${c.storey + 1}` : ""} (${c.position.slice(0, 2).map((v) => v.toFixed(0)).join(", ")})`), tag("span", {}, c.kind === "alike" ? `s=${c.similarity.toFixed(2)}` : percent(c.probability))));
  redrawn("candidate", () => $("candidates").replaceChildren(made.length ? tag("div", { class: "list" }, ...made) : tag("p", {}, "This answer names no other place.")));
  whyNot(f, rival);
}
function whyNot(f, rival) {
  const panel = $("whynot");
  if (!rival) {
    panel.replaceChildren(at.rival ? tag("p", { class: "note" }, "At this moment the place chosen is not among those named.") : f.candidates.length > 1 ? tag("p", { class: "note" }, "Choose one, here or on the plan.") : "");
    return;
  }
  const best = f.candidates[0], other = f.candidates[rival], a = best.evidence, b = other.evidence;
  if (!a || !b) {
    panel.replaceChildren(tag("p", { class: "lacks" }, D.live || !D.lacks.length ? "This answer was not put to the test by layout." : "Its evidence is not known: this page was made without the run, or the answer was not tested."));
    return;
  }
  const objects = (c) => (building(c.map) ? D.buildings[c.map].objects : []);
  const rows = f.seen.map(([id, name], i) => ({ name, id, here: a.nats[i], there: b.nats[i], fits: [a.mapped[i] >= 0, b.mapped[i] >= 0] }));
  rows.sort((p, q) => Math.abs(q.here - q.there) - Math.abs(p.here - p.there) || (p.id < q.id ? -1 : 1));
  const missing = new Map();
  [[best, a], [other, b]].forEach(([c, e], side) => e.missed.forEach(([n, nats]) => {
    const [id, name] = objects(c)[n] || [`${n}`, "object"], key = `${c.map}/${id}`;
    if (!missing.has(key)) missing.set(key, { id, name, nats: [null, null] });
    missing.get(key).nats[side] = nats;
  }));
  const gap = (m) => (m.nats[0] || 0) - (m.nats[1] || 0);
  const lost = [...missing.values()].sort((p, q) => Math.abs(gap(q)) - Math.abs(gap(p)) || (p.id < q.id ? -1 : 1));
  const sum = (list) => list.reduce((s, v) => s + v, 0);
  const others = [a, b].map((e) => e.score - sum(e.nats) - e.walls - sum(e.missed.map((m) => m[1])));
  const gain = {};
  rows.forEach((r) => { gain[r.name] = (gain[r.name] || 0) + r.here - r.there; });
  lost.forEach((m) => { gain[m.name] = (gain[m.name] || 0) + gap(m); });
  const top = Object.entries(gain).sort((p, q) => Math.abs(q[1]) - Math.abs(p[1])).slice(0, 3).filter(([, v]) => Math.abs(v) >= 0.1).map(([n, v]) => `${n} ${signed(v)}`).join(", ");
  const ahead = a.score - b.score;
  const cell = (v, fits, more) => tag("td", { class: more ? "more" : null }, fits ? signed(v) : "stranger");
  const body = rows.map((r) => tag("tr", {}, tag("td", { title: r.id }, tag("span", { class: "name" }, sample(r.name), ` ${r.name} ${short(r.id)}`)), cell(r.here, r.fits[0], r.here > r.there + 0.05), cell(r.there, r.fits[1], r.there > r.here + 0.05)));
  const gone = lost.map((m) => tag("tr", {}, tag("td", { title: m.id }, tag("span", { class: "name" }, sample(m.name, false), ` missed: ${m.name} ${short(m.id)}`)), ...m.nats.map((v) => tag("td", {}, v === null ? "" : signed(v)))));
  const line = (name, p, q) => (Math.abs(p) + Math.abs(q) < 0.01 ? null : tag("tr", {}, tag("td", {}, name), tag("td", {}, signed(p)), tag("td", {}, signed(q))));
  panel.replaceChildren(
    tag("p", { class: "because" }, `The answer is ${Math.abs(ahead) < 0.005 ? "level with" : ahead > 0 ? `${ahead.toFixed(1)} nats ahead of` : `${(-ahead).toFixed(1)} nats behind`} place ${rival} by its evidence${top ? `; most by ${top}` : ""}.${ahead < 0 && D.weighed ? " Earlier answers, which weigh in too, put it first." : ""}`),
    tag("div", { class: "beside", tabindex: 0, role: "region", "aria-label": "Evidence object by object" }, tag("table", {},
      tag("thead", {}, tag("tr", {}, tag("th", {}, "object"), tag("th", {}, "answer"), tag("th", {}, `place ${rival}`))),
      tag("tbody", {}, ...body, ...gone, line("missed, each below 0.05, and rounding", others[0], others[1]), line("walls crossed", a.walls, b.walls)),
      tag("tfoot", {}, tag("tr", {}, tag("td", {}, "all, nats"), tag("td", {}, signed(a.score)), tag("td", {}, signed(b.score)))))));
}
function classes(f) {
  const evidence = new Map(f.because), attention = new Map(f.attention);
  const names = [...new Set([...evidence.keys(), ...attention.keys()])];
  const weight = (n) => Math.max(Math.abs(evidence.get(n) || 0), Math.abs(attention.get(n) || 0));
  names.sort((p, q) => Math.abs(evidence.get(q) || 0) - Math.abs(evidence.get(p) || 0) || weight(q) - weight(p) || (p < q ? -1 : 1));
  if (!names.length) return $("classes").replaceChildren(tag("p", { class: "note" }, f.candidates.length ? "This answer was recorded without reasons." : "No answer, no reasons."));
  const most = Math.max(0.01, ...names.map(weight));
  const bar = (value, colour) => tag("div", { class: "bar" }, value ? tag("i", { class: value < 0 ? "less" : null, style: `width:calc((100% - 3.4rem) * ${(Math.abs(value) / most).toFixed(4)});background:${colour}` }) : null, tag("em", {}, value ? `${value < 0 ? "−" : ""}${percent(Math.abs(value))}` : "–"));
  const rest = names.slice(10);
  const rows = names.slice(0, 10).flatMap((n) => [tag("span", { class: "name" }, sample(n), n), bar(evidence.get(n), classLook(n)[0]), bar(attention.get(n), classLook(n)[0])]);
  $("classes").replaceChildren(tag("div", { class: "bars" }, tag("b", {}, "class"), tag("b", { title: "what the decision rests on" }, "evidence"), tag("b", { title: "what the encoder looked at" }, f.method || "attention"), ...rows),
    rest.length ? tag("p", { class: "note" }, `and ${rest.length} more classes`) : "");
}
function scores() {
  if (!D.rows.length) return;
  const columns = [["metres", (r) => (r.scope === "all" ? "all" : `from ${r.scope.replace("m", "")}`)], ["answers", (r) => r.queries], ["success@1", (r) => r["success@1"].toFixed(3)], ["by chance", (r) => (r.chance === null ? "–" : r.chance.toFixed(3))],
    ["accepted", (r) => percent(r.accepted)], ["of these right", (r) => (r.precision === null ? "–" : percent(r.precision))], ["wrong storey", (r) => r.wrong_storey],
    ["off, m (median)", (r) => (r.position_error_m === null ? "–" : r.position_error_m.toFixed(2))], ["heading off, °", (r) => (r.heading_error_deg === null || r.heading_error_deg === undefined ? "–" : r.heading_error_deg.toFixed(1))]];
  $("rows").replaceChildren(tag("table", {}, tag("thead", {}, tag("tr", {}, ...columns.map(([n]) => tag("th", {}, n)))), tag("tbody", {}, ...D.rows.map((r) => tag("tr", {}, ...columns.map(([, of]) => tag("td", {}, `${of(r)}`)))))));
  $("score").hidden = false;
}

// -- playing ----------------------------------------------------------------------------------------------------
function show() {
  const f = frame();
  plan(f);
  here();
  if (!f) { $("clock").textContent = "waiting for the first answer"; return; }
  const last = D.frames.length - 1;
  $("seek").max = last;
  $("seek").value = at.frame;
  $("seek").setAttribute("aria-valuetext", `${clock(f.t)}, ${f.status}`);
  $("clock").textContent = `${clock(f.t)} / ${clock(D.frames[last].t)} · ${at.frame + 1} of ${last + 1}`;
  answer(f);
  candidates(f);
  classes(f);
}
function go(to) {
  at.frame = Math.min(Math.max(0, to), D.frames.length - 1);
  at.follow = at.frame === D.frames.length - 1;
  show();
}
function choose(number) {
  const f = frame();
  at.rival = !number || rivalNow(f) === number ? null : f.candidates[number];
  at.building = null; at.storey = null; at.pan = [0, 0];
  show();
}
function jump(step) {
  for (let i = at.frame + step; i >= 0 && i < D.frames.length; i += step) {
    // To the first of a row of wrong ones.
    if (bad(D.frames[i]) && (step < 0 || !bad(D.frames[i - 1]) || i - 1 === at.frame)) { play(false); return go(i); }
  }
}
let timer = 0;
function play(on) {
  clearTimeout(timer);
  if (on && at.frame >= D.frames.length - 1 && !D.live) at.frame = 0;
  at.playing = on;
  $("play").textContent = on ? "❚❚ Pause" : "▶ Play";
  if (on) tick();
}
function tick() {
  const speed = Number($("speed").value), f = frame();
  let to = at.frame + 1, wait = 200;
  if (f && to < D.frames.length) {
    const gap = (i) => (1000 * (D.frames[i].t - f.t)) / speed;
    while (gap(to) < 40 && to + 1 < D.frames.length) to++;
    wait = Math.min(Math.max(gap(to), 40), 1500);
  }
  timer = setTimeout(() => {
    if (!at.playing) return;
    if (to < D.frames.length) go(to);
    else if (!D.live) return play(false);
    tick();
  }, wait);
}
$("play").onclick = () => play(!at.playing);
$("first").onclick = () => go(0);
$("last").onclick = () => go(D.frames.length - 1);
$("back").onclick = () => { play(false); go(at.frame - 1); };
$("next").onclick = () => { play(false); go(at.frame + 1); };
$("wrong").onclick = () => jump(1);
$("seek").oninput = (e) => go(Number(e.target.value));
$("building").onchange = (e) => { at.building = e.target.value || null; at.storey = null; at.pan = [0, 0]; show(); };
$("whole").onclick = () => { whole = !whole; at.pan = [0, 0]; show(); };
const zoom = (by) => { if (whole) { const svg = $("plan"); at.metres = scale * Math.min(svg.clientWidth, svg.clientHeight); whole = false; } at.metres = Math.min(500, Math.max(4, at.metres * by)); show(); };
$("in").onclick = () => zoom(0.7);
$("out").onclick = () => zoom(1.4);
const seekTo = (e) => { const box = $("line").getBoundingClientRect(); go(Math.round(((e.clientX - box.left - MARGIN) / (box.width - 2 * MARGIN)) * (D.frames.length - 1))); };
$("line").onpointerdown = (e) => seekTo(e);
$("line").onpointermove = (e) => { if (e.buttons) seekTo(e); };
let held = null;
$("plan").onpointerdown = (e) => { if (!e.target.closest(".ghost") && e.pointerType === "mouse") held = [e.clientX, e.clientY]; };
addEventListener("pointerup", () => { held = null; });
$("plan").onpointermove = (e) => {
  if (!held) return;
  at.pan = [at.pan[0] - (e.clientX - held[0]) * scale, at.pan[1] + (e.clientY - held[1]) * scale];
  held = [e.clientX, e.clientY];
  show();
};
addEventListener("keydown", (e) => {
  if (e.ctrlKey || e.metaKey || e.altKey || e.target.closest("select, summary, a")) return;
  const arrows = e.target.id !== "seek", far = e.shiftKey ? 10 : 1;
  const act = { ArrowLeft: arrows && (() => { play(false); go(at.frame - far); }), ArrowRight: arrows && (() => { play(false); go(at.frame + far); }), Home: arrows && (() => go(0)), End: arrows && (() => go(D.frames.length - 1)),
    w: () => jump(1), W: () => jump(-1), z: () => $("whole").click(), "+": () => zoom(0.7), "-": () => zoom(1.4), Escape: () => choose(0),
    r: () => { const f = frame(); if (f && f.candidates.length > 1) choose((rivalNow(f) % (f.candidates.length - 1)) + 1); },
    " ": !e.target.closest("button") && (() => play(!at.playing)) }[e.key];
  if (act) { e.preventDefault(); act(); }
});
addEventListener("resize", () => { timeline(); show(); });

// -- start ------------------------------------------------------------------------------------------------------
if (!knowsTruth() && !D.live) { $("wrong").textContent = "Next doubt"; $("wrong").title = "To the next answer that is no match (w; back: W)"; }
async function poll() {
  try {
    const said = await (await fetch(`frames?from=${D.frames.length}`)).json();
    trouble(said.error || "");
    if (said.frames.length) {
      const follow = at.follow && !at.playing;
      D.frames.push(...said.frames);
      if (follow) at.frame = D.frames.length - 1;
      timeline(); chips(); key(); show();
    }
    if (said.done) { D.rows = said.rows; scores(); $("lacks").append(tag("p", {}, "The run is over.")); return; }
  } catch (error) { trouble("The server is gone; what came so far stays."); return; }
  setTimeout(poll, 500);
}
$("wrong").disabled = !D.live && !D.frames.some(bad);
key(); chips(); scores(); timeline(); show();
if (D.live) poll();
document.body.dataset.ready = "yes";
})();
