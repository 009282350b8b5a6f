// What would other settings do? A record replayed, responses to steps, Ms: worked out here, with no server.
// whatIf(place, what, options) fills an element; what: of report/what_if.py, which says what every number is.
"use strict";
const CONTROLLERS = /*CONTROLLERS*/{};

// A process from sample to sample under a held output (adaptive/loop/simulate.py).
function heldInput(m) {
  const n = m.c.length, inputs = new Float64Array(m.delay);
  let x = new Float64Array(n), next = new Float64Array(n), at = 0;
  return (co) => {
    const old = inputs[at];
    inputs[at] = co;
    at = (at + 1) % m.delay;
    const now = inputs[at];
    let out = m.d * now;
    for (let i = 0; i < n; i++) {
      let sum = m.g1[i] * old + m.g0[i] * now;
      for (let j = 0; j < n; j++) sum += m.phi[i][j] * x[j];
      next[i] = sum;
      out += m.c[i] * sum;
    }
    [x, next] = [next, x];
    return out;
  };
}

// The PID law of schedule/pid.py: integral held at the limits, derivative on pv, filtered.
function pidLaw([kp, ki, kd], low, high, sp, pv, co) {
  const filter = kp ? Math.abs(kd / kp) / 10 : 0;
  let integral = Math.min(Math.max(co, low), high) - kp * (sp - pv), last = pv, rate = 0;
  return (sp_, pv_, dt) => {
    rate = (filter * rate + pv_ - last) / (filter + dt);
    last = pv_;
    const wish = kp * (sp_ - pv_) + integral - kd * rate;
    let more = ki * (sp_ - pv_) * dt;
    const out = Math.min(Math.max(wish, low), high);
    if (more > 0) more = wish > out ? 0 : wish + more <= high ? more : high - wish;
    else more = wish < out ? 0 : wish + more >= low ? more : low - wish;
    integral += more;
    return out;
  };
}

// The record with other gains: pv = v + G co, v = what the controller has no part in (adaptive/loop/replayed.py).
function replay(what, model, gains) {
  const { sp, pv, co, dt } = what, co0 = co[0], was = heldInput(model), will = heldInput(model);
  const [low, high] = what.limits, free = [pv[0]], found = { pv: [], co: [] };
  for (let i = 0; i + 1 < pv.length; i++) free.push(pv[i + 1] - was(co[i] - co0));
  const kicked = what.active ? (gains[0] - what.active[0]) * (sp[0] - free[0]) : 0;
  const law = pidLaw(gains, low, high, sp[0], free[0], co0 + kicked), far = 100 * what.range;
  let moved = 0;
  for (let i = 0; i < pv.length; i++) {
    if (!(Math.abs(moved) < far)) return null;
    found.pv.push(moved + free[i]);
    found.co.push(law(sp[i], moved + free[i], dt));
    moved = will(found.co[i] - co0);
  }
  return found;
}

// A unit step of setpoint or load from rest.
function stepped(step, model, gains, load) {
  const plant = heldInput(model), law = pidLaw(gains, -1e9, 1e9, 0, 0, 0), found = { pv: [], co: [] };
  let pv = 0;
  for (let i = 0; i <= step.n; i++) {
    const co = law(load ? 0 : 1, pv, step.dt);
    found.pv.push(pv);
    found.co.push(co);
    pv = plant(co + (load ? 1 : 0));
    if (!(Math.abs(pv) < 1e9)) return null;
  }
  return found;
}

// Ms and stability from G(jw): 1 + L turns by a quarter for each pole at the origin, or it encircles -1 (Nyquist).
function robustness({ w, re, im }, integrators, [kp, ki, kd]) {
  const filter = kp ? Math.abs(kd / kp) / 10 : 0;
  let ms = 0, turned = 0, last = null;
  for (let i = 0; i < w.length; i++) {
    const size = 1 + (filter * w[i]) ** 2, cr = kp + (kd * filter * w[i] * w[i]) / size, ci = (kd * w[i]) / size - ki / w[i];
    const a = 1 + re[i] * cr - im[i] * ci, b = re[i] * ci + im[i] * cr, angle = Math.atan2(b, a);
    ms = Math.max(ms, 1 / Math.hypot(a, b));
    if (last !== null) {
      const by = angle - last;
      turned += by - 2 * Math.PI * Math.round(by / (2 * Math.PI));
    }
    last = angle;
  }
  const poles = integrators + (ki ? 1 : 0);
  return { ms, stable: Math.abs(turned - (poles * Math.PI) / 2) < Math.PI / 2 };
}

// A set as it stands on a controller of that name (schedule/dials.py): [label, unit, number].
function dialled(name, [kp, ki, kd], pvSpan) {
  const { form, dials } = CONTROLLERS[name], ratio = 100 / pvSpan;
  let kc = kp, ti = ki ? kp / ki : null, td = kp ? kd / kp : 0;
  if (form === "series" && td && ti) {
    if (4 * td > ti) return null;
    const half = (1 + Math.sqrt(1 - (4 * td) / ti)) / 2;
    [kc, ti, td] = [kc * half, ti * half, ti * (1 - half)];
  }
  const of = { kp: kc, xp: (100 * ratio) / kc, ki, "1/ki": ki ? 1 / ki : null, tn: ti, repeats: ti ? 60 / ti : 0, kd, tv: td };
  return dials.filter((dial) => dial.label).map(({ label, unit, quantity, scale, of_span }) => {
    const factor = !of_span || quantity === "xp" ? scale : quantity === "1/ki" ? scale / ratio : scale * ratio;
    return [label, unit, of[quantity] === null ? null : of[quantity] / factor];
  }).filter(([, , value], i) => value !== null && (value || i === 0));
}

const mean = (list) => list.reduce((sum, value) => sum + Math.abs(value), 0) / list.length;
const way = (list) => list.reduce((sum, value, i) => sum + (i ? Math.abs(value - list[i - 1]) : 0), 0);
const brief = (value) => Number(Number(value).toPrecision(3)).toString();
const WITHIN = 0.05; // of a step: settled

function whatIf(place, what, { name: of = "", propose = null, span = null, controller = "", sets = ["recommended", "active"] } = {}) {
  const make = (kind, parent, text, given = {}) => {
    const made = document.createElement(kind);
    if (text) made.textContent = text;
    Object.assign(made, given);
    parent?.append(made);
    return made;
  };
  const box = make("section", place, "", { className: "whatif" }), best = what.models[0], active = what.active;
  make("h3", box, of ? `What if: ${of}` : "What if");
  let gains = [...(what.recommended ?? active)];
  const sliders = make("div", box, "", { className: "sliders" }), inputs = [];
  const slider = (name, read, write, low, high) => {
    const label = make("label", sliders, name), told = make("b", label);
    const input = make("input", label, "", { type: "range", min: low, max: high, step: "any" });
    input.setAttribute("aria-label", name);
    input.oninput = () => { gains = write(Number(input.value)); show(input); };
    inputs.push({ input, told, read });
  };
  const base = [...gains], sign = Math.sign(base[0] || base[1]) || 1, ti0 = base[1] ? base[0] / base[1] : what.slowest;
  if (what.speeds.length > 2) {
    const near = () => what.speeds.reduce((at, one, i) => Math.abs(Math.log(one[1] / gains[0])) < Math.abs(Math.log(what.speeds[at][1] / gains[0])) ? i : at, 0);
    slider("Speed: tau_c, lambda", () => [what.speeds.length - 1 - near(), `${brief(what.speeds[near()][0])} s`],
      (v) => what.speeds[what.speeds.length - 1 - Math.round(v)].slice(1), 0, what.speeds.length - 1);
  }
  if (base[0]) {
    const middle = Math.log(Math.abs(base[0])), wide = Math.log(10);
    slider("Gain Kc", () => [Math.log(Math.abs(gains[0]) || 1e-12), brief(gains[0])],
      (v) => { const by = (sign * Math.exp(v)) / gains[0]; return gains.map((one) => one * by); }, middle - wide, middle + wide);
    slider("Integral time tau_I", () => [Math.log(gains[1] ? gains[0] / gains[1] : 10 * ti0), gains[1] ? `${brief(gains[0] / gains[1])} s` : "none"],
      (v) => [gains[0], gains[0] / Math.exp(v), gains[2]], Math.log(ti0) - wide, Math.log(ti0) + wide);
  }
  const figures = make("div", box, "", { className: "figures" });
  const bar = make("div", box, "", { className: "bar" });
  const to = (text, set) => set && make("button", bar, text, { type: "button", onclick: () => { gains = [...set]; show(); } });
  to(`Use ${sets[0]}`, what.recommended);
  to(`Use ${sets[1]}`, active);
  const chosen = make("select", bar, "", { ariaLabel: "controller" });
  for (const name of Object.keys(CONTROLLERS)) make("option", chosen, name, { value: name });
  if (CONTROLLERS[controller]) chosen.value = controller;
  const spanned = make("label", bar, "span of pv "), spanInput = make("input", spanned, "", { type: "number", min: 0, step: "any", value: span ?? "" });
  const text = make("span", bar, "", { className: "dialled" });
  const copy = make("button", bar, "Copy", { type: "button", onclick: () => {
    const done = () => { copy.textContent = "Copied"; setTimeout(() => { copy.textContent = "Copy"; }, 1500); };
    navigator.clipboard?.writeText(text.textContent).then(done, () => getSelection().selectAllChildren(text)) ?? getSelection().selectAllChildren(text);
  } });
  if (propose) make("button", bar, "Propose", { type: "button", className: "primary", onclick: () => propose([...gains], text.textContent) });
  chosen.onchange = spanInput.oninput = () => show();
  const key = make("div", box, "", { className: "key" });
  for (const [name, colour] of [[`as recorded, or ${sets[1]}`, "before"], ["with these settings", "pv"], ["setpoint", "sp"]])
    make("i", key, `\u25a0 ${name}`).style.color = `var(--${colour})`;
  const charts = make("div", box, "", { className: "charts" }), panels = {};
  const recorded = what.pv.length > 2;
  for (const name of [...(recorded ? ["the record"] : []), "setpoint step of 1", "load step of 1 co"]) {
    const part = make("div", charts);
    make("b", part, name);
    panels[name] = make("div", part);
  }
  const before = active && { sp: stepped(what.step, best.step, active, false), load: stepped(what.step, best.step, active, true) };

  function told(name, value, tone = "") {
    const part = make("div", figures, "");
    make("span", part, name);
    make("b", part, value, { className: tone });
  }

  function settles(found) {
    if (!found) return "never";
    let last = found.pv.length;
    while (last && Math.abs(found.pv[last - 1] - 1) <= WITHIN) last--;
    return last >= found.pv.length ? `over ${brief(what.step.n * what.step.dt)} s` : `${brief(last * what.step.dt)} s`;
  }

  function show(moved = null) {
    for (const one of inputs) {
      const [value, words] = one.read();
      if (one.input !== moved) one.input.value = value;
      one.told.textContent = words;
    }
    const proof = robustness(what.curve, what.integrators, gains), spread = what.models.map((m) => robustness(m.curve ?? what.curve, what.integrators, gains));
    const held = spread.every((one) => one.stable), worst = Math.max(...spread.map((one) => one.ms));
    const sp = stepped(what.step, best.step, gains, false), load = stepped(what.step, best.step, gains, true);
    figures.replaceChildren();
    told("Ms", proof.stable ? proof.ms.toFixed(2) : "unstable", !proof.stable || proof.ms > what.ms_limit ? "bad" : "good");
    if (what.models.length > 1) told("at most, plausible models", held ? worst.toFixed(2) : "unstable", held ? "" : "bad");
    told("overshoot", sp && proof.stable ? `${Math.max(0, Math.round(100 * (Math.max(...sp.pv) - 1)))} %` : "without end");
    told("settles in", proof.stable ? settles(sp) : "never");
    if (recorded) {
      const found = replay(what, best.record, gains), error = mean(what.sp.map((v, i) => v - what.pv[i]));
      const others = what.models.slice(1).map((m) => replay(what, m.record, gains));
      const share = (value, of) => (of > 0 ? `${Math.round((100 * value) / of)} % of before` : brief(value));
      told("mean error of the record", found ? share(mean(what.sp.map((v, i) => v - found.pv[i])), error) : "runs away", found ? "" : "bad");
      told("travel of co", found ? share(way(found.co), way(what.co)) : "runs away", found ? "" : "bad");
      draw(panels["the record"], what.dt, 520, [
        [["sp", what.sp], ["before", what.pv], ...others.filter(Boolean).map((one) => ["pv thin", one.pv]), ["pv", found?.pv]], [["before", what.co], ["pv", found?.co]]], what.floor);
    }
    draw(panels["setpoint step of 1"], what.step.dt, 260, [[["sp", sp && sp.pv.map(() => 1)], ["before", before?.sp?.pv], ["pv", sp?.pv]], [["before", before?.sp?.co], ["pv", sp?.co]]]);
    draw(panels["load step of 1 co"], what.step.dt, 260, [[["before", before?.load?.pv], ["pv", load?.pv]], [["before", before?.load?.co], ["pv", load?.co]]]);
    const needs = CONTROLLERS[chosen.value].dials[0].of_span, width = Number(spanInput.value);
    spanned.hidden = !needs;
    const dials = needs && !(width > 0) ? undefined : dialled(chosen.value, gains, needs ? width : 100);
    text.textContent = dials === undefined ? "give the span of pv" : dials === null ? "these settings have no series form" : dials.map(([label, unit, value]) => `${label} ${brief(value)}${unit}`).join("  ");
  }

  // Two strips, pv above co, over one axis of time; the new settings keep the picture, an old swing may leave it.
  function draw(into, dt, usual, [upper, lower], floors = [0, 0]) {
    const width = Math.max(into.clientWidth || usual, 220), height = 230, left = 48, top = 6, parts = [[top, 130, upper, floors[0]], [148, 62, lower, floors[1]]], ns = "http://www.w3.org/2000/svg";
    const picture = document.createElementNS(ns, "svg");
    const put = (kind, given, words) => { const made = document.createElementNS(ns, kind); for (const [name, value] of Object.entries(given)) made.setAttribute(name, value); if (words) made.textContent = words; picture.append(made); };
    picture.setAttribute("viewBox", `0 0 ${width} ${height}`);
    const count = Math.max(...upper.map(([, values]) => values?.length ?? 0), 2);
    for (const [from, room, lines, floor] of parts) {
      const known = lines.filter(([, values]) => values), own = known.filter(([tone]) => tone !== "pv thin").map(([, values]) => values);
      if (!own.length) continue;
      const focus = own.at(-1), ends = (list) => [list.reduce((a, b) => Math.min(a, b)), list.reduce((a, b) => Math.max(a, b))];
      let [low, high] = ends(focus);
      for (const list of own) { const [a, b] = ends(list), size = Math.max(high - low, floor, 1e-12); low = Math.max(Math.min(low, a), low - size); high = Math.min(Math.max(high, b), high + size); }
      const least = Math.max(floor, 1e-9), middle = (low + high) / 2;
      if (high - low < least) { low = middle - least / 2; high = middle + least / 2; }
      const x = (i) => left + ((width - left - 4) * i) / (count - 1), y = (v) => from + room - (room * (Math.min(Math.max(v, low), high) - low)) / (high - low);
      put("rect", { x: left, y: from, width: width - left - 4, height: room, fill: "none", stroke: "var(--line)" });
      put("text", { x: left - 4, y: from + 9, "text-anchor": "end" }, brief(high));
      put("text", { x: left - 4, y: from + room, "text-anchor": "end" }, brief(low));
      for (const [tone, values] of known) {
        const [name, thin] = tone.split(" "), path = values.map((v, i) => `${i ? "L" : "M"}${x(i).toFixed(1)} ${y(v).toFixed(1)}`).join("");
        put("path", { d: path, fill: "none", stroke: `var(--${name})`, "stroke-width": thin ? 0.6 : 1.5, "stroke-opacity": thin ? 0.4 : 1, "stroke-dasharray": name === "sp" ? "5 3" : "none", "stroke-linejoin": "round" });
      }
    }
    put("text", { x: left, y: height - 6 }, "0");
    put("text", { x: width - 4, y: height - 6, "text-anchor": "end" }, `${brief(dt * (count - 1))} s`);
    into.replaceChildren(picture);
  }
  show();
  return box;
}
