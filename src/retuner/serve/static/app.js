// The page: overview and loop, kept up to date by one stream; acting through a dialog that asks once.
import { Charts, MARKS, ageTone, clock, msTone, spark } from "/drawing.js";

const $ = (id) => document.getElementById(id);
const state = { page: null, stream: null, acting: false, readOnly: false, tail: new Map(), lost: false };
const KEPT = 20000;

// Elements are made of text: what comes from a configuration or a ledger is never read as HTML.
function el(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key === "class") made.className = value;
    else if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (value !== false && value !== null && value !== undefined) made.setAttribute(key, value === true ? "" : value);
  }
  made.append(...children.flat(Infinity).filter((c) => c !== null && c !== undefined && c !== false));
  return made;
}

async function get(path) {
  const answer = await fetch(path, { credentials: "same-origin" });
  if (!answer.ok) throw new Error((await answer.text()).trim() || `status ${answer.status}`);
  return answer.json();
}

async function post(path, body) {
  const answer = await fetch(path, {
    method: "POST", credentials: "same-origin", headers: { "content-type": "application/json" }, body: JSON.stringify(body),
  });
  if (!answer.ok) throw Object.assign(new Error((await answer.text()).trim()), { status: answer.status });
  return answer.json();
}

let noticeTimer = 0;
function notice(text, bad = false, lasting = false) {
  clearTimeout(noticeTimer);
  $("notice").textContent = text;
  $("notice").className = bad ? "bad" : "";
  $("notice").hidden = !text;
  if (text && !lasting) noticeTimer = setTimeout(() => notice(""), 9000);
}

const words = (v, digits = 4) => (v === null || v === undefined || !Number.isFinite(v) ? "-" : String(Number(v.toPrecision(digits))));
const msWords = (r) => (!r ? "-" : r.unstable ? "unstable" : r.ms === null ? "not known yet" : r.ms.toFixed(2));

// ---- the stream: samples, states, new ledger rows; it comes back by itself and fills what was missed from the trend

function listen(keys) {
  state.stream?.close();
  const query = keys.map((k) => `loop=${encodeURIComponent(k)}`).join("&");
  const stream = (state.stream = new EventSource(`/api/stream?${query}`));
  stream.onopen = () => {
    $("link").textContent = "live";
    $("link").className = "";
    if (state.page?.over) $("link").textContent = "ended";
    if (state.lost) { state.lost = false; state.page?.again(); }
  };
  stream.onerror = () => {
    if (state.page?.over) { // the run is over, and its page went with it
      stream.close();
      $("link").textContent = "ended";
      $("link").className = "";
      return;
    }
    state.lost = true;
    $("link").textContent = "connection lost; trying again";
    $("link").className = "lost";
    state.page?.told?.();
  };
  stream.addEventListener("gap", () => state.page?.again());
  stream.onmessage = (event) => {
    const told = JSON.parse(event.data);
    state.page?.moved(told);
  };
}

// ---- overview

class Overview {
  constructor() { this.cards = new Map(); this.start(); }

  async start() {
    document.title = "retuner: overview";
    const found = await get("/api/overview");
    if (state.page !== this) return;
    this.sessions = found.sessions;
    const loops = found.sessions.flatMap((s) => s.loops.map((l) => ({ ...l, broken: s.broken })));
    loops.sort((a, b) => b.waiting.length - a.waiting.length || a.key.localeCompare(b.key));
    this.cards.clear();
    const cards = loops.map((l) => this.card(l));
    const refused = Object.entries(found.refused).map(([name, why]) => el("p", { class: "bad" }, `${name}: ${why}`));
    const needs = loops.filter((l) => l.waiting.length).length;
    $("main").replaceChildren(
      el("h1", {}, `${loops.length} ${loops.length === 1 ? "loop" : "loops"}`),
      el("p", { class: needs ? "bad" : "muted" }, needs ? `${needs} wait for you: marked, and first.` : "Nothing waits for an operator."),
      ...found.sessions.filter((s) => s.outcome).map((s) => el("p", { class: "outcome" }, outcomeOf(s.outcome))),
      ...found.sessions.filter((s) => s.broken).map((s) => el("p", { class: "bad" }, `${s.name}: ${s.broken}`)),
      el("div", { class: "cards" }, cards), ...refused,
      loops.length ? "" : el("p", {}, "No loop has been seen yet: the session waits for its controller, or was made by an earlier release."));
    $("hold").hidden = !found.sessions.some((s) => !s.ended);
    for (const card of this.cards.values()) card.draw();
    listen(loops.map((l) => l.key));
    for (const l of loops) this.fill(l);
  }

  async fill(loop) {
    const span = 600 * loop.head.sample_time_s, to = loop.newest ? loop.newest[0] : 0;
    const part = loop.ended ? "" : `from=${to - span}&to=${to}&`; // of a run that is over, the whole
    const { columns } = await get(`/api/trend/${loop.key}?${part}points=160`);
    const card = state.page === this ? this.cards.get(loop.key) : null;
    if (card) { card.pv = columns.pv; card.sp = columns.sp; card.draw(); }
  }

  card(loop) {
    const fields = Object.fromEntries(["sp", "pv", "co", "region", "gains", "ms", "waits", "badge"].map((k) => [k, el("span")]));
    const canvas = el("canvas", { class: "spark", role: "img", "aria-label": "trend of pv and sp" });
    const box = el("a", { class: "panel card", href: `#/loop/${loop.key}` },
      el("h2", {}, loop.head.loop, " ", el("span", { class: "muted" }, loop.session), " ", fields.badge),
      el("div", { class: "values" }, valueBox("sp", fields.sp, loop.head.unit), valueBox("pv", fields.pv, loop.head.unit), valueBox("co", fields.co, "%")),
      canvas,
      el("div", {}, "region ", fields.region, ", ", fields.gains),
      el("div", {}, "Ms ", fields.ms, loop.cause && !loop.ended ? `; last cause: ${loop.cause}` : ""),
      el("div", { class: "muted" }, "waits for ", fields.waits));
    const card = { pv: [], sp: [], loop, canvas,
      draw: () => spark(canvas, card.pv.slice(-300), card.sp.slice(-300), loop.state.band || 0),
      told: (told) => {
        if (told.state) loop.state = told.state;
        const s = told.samples?.at(-1) ?? loop.newest;
        const here = loop.state.regions?.[loop.state.region];
        if (s) [fields.sp.textContent, fields.pv.textContent, fields.co.textContent] = [words(s[1]), words(s[2]), words(s[3], 3)];
        fields.region.textContent = here?.name ?? "not known";
        fields.gains.textContent = loop.state.running ?? "gains not known yet";
        fields.ms.textContent = msWords(here);
        fields.waits.textContent = loop.ended ? "nothing: the session has ended" : loop.state.waits_for ?? "-";
        const [text, tone] = badge(loop, here);
        fields.badge.textContent = text;
        fields.badge.className = `badge ${tone}`;
        box.classList.toggle("needs", loop.waiting.length > 0);
      } };
    card.told({});
    this.cards.set(loop.key, card);
    return box;
  }

  moved(told) {
    for (const [key, moved] of Object.entries(told.loops)) {
      const card = this.cards.get(key);
      if (!card) continue;
      for (const s of moved.samples) { card.sp.push(s[1]); card.pv.push(s[2]); }
      if (card.pv.length > 600) { card.pv.splice(0, card.pv.length - 400); card.sp.splice(0, card.sp.length - 400); }
      card.told(moved);
      card.draw();
    }
    if (Object.keys(told.rows).length) this.later();
  }

  later(ms = 700) {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.refresh(), ms);
  }

  get over() { return Boolean(this.sessions?.length && this.sessions.every((s) => s.ended)); }
  told() { for (const card of this.cards.values()) card.told({}); }

  async refresh() {
    const found = await get("/api/overview").catch(() => null);
    if (!found || state.page !== this) return;
    const loops = found.sessions.flatMap((s) => s.loops);
    const ended = found.sessions.some((s) => s.outcome && !this.sessions.find((o) => o.name === s.name)?.outcome);
    if (ended || loops.some((l) => !this.cards.has(l.key))) return this.start();
    if (found.sessions.some((s) => s.ended && !s.outcome)) this.later(2000);
    for (const l of loops) { Object.assign(this.cards.get(l.key).loop, { waiting: l.waiting, ended: l.ended, cause: l.cause, silent_s: l.silent_s }); this.cards.get(l.key).told({}); }
  }

  again() { this.start(); }
  key() { return false; }
  end() { clearTimeout(this.timer); }
}

// What a run came to, with the way to its report.
function outcomeOf(outcome) {
  return [el("b", {}, outcome.text), "; ", el("a", { href: outcome.report, target: "_blank", rel: "noopener" }, "open the report")];
}

function valueBox(name, field, unit) {
  const b = el("b", {}, field);
  return el("div", { class: name }, el("span", { class: "k" }, `${name} [${unit}]`), b);
}

function badge(loop, here) {
  if (loop.broken) return ["ledger broken", "bad"];
  if (loop.waiting.length) return ["needs you", "bad"];
  if (loop.ended) return ["ended", "warn"];
  if (state.lost) return ["not connected", "bad"];
  if (loop.silent_s) return [`no sample for ${clock(loop.silent_s, 5000)}`, "bad"];
  if (here && here.trial !== "idle") return [here.trial, "warn"];
  if (here?.mode === "off") return ["off", "warn"];
  return ["watching", "good live"];
}

// ---- one loop

class Loop {
  constructor(key) {
    this.key_ = key;
    this.session = key.split("/")[0];
    this.live = true;
    this.columns = { t: [], sp: [], pv: [], co: [], region: [], limited: [] };
    this.doc = null;
    this.colourBy = "ms";
    this.filter = "";
    this.start().catch((error) => { if (state.page === this) $("main").replaceChildren(el("p", { class: "bad" }, error.message), el("p", {}, el("a", { href: "#/" }, "to the overview"))); });
  }

  get peaks() {
    if (this.live || !this.doc) return this.doc?.state.peaks ?? [];
    return [];
  }

  async start() {
    this.doc = await get(`/api/loop/${this.key_}`);
    if (state.page !== this) return;
    document.title = `${this.doc.head.loop}: retuner`;
    this.span = 1200 * this.doc.head.sample_time_s;
    if (this.doc.ended) { this.live = false; }
    this.build();
    await this.window(this.doc.ended);
    if (state.page !== this) return;
    this.charts = new Charts(this.parts.charts, () => ({
      columns: this.columns, names: this.doc.head.regions, decisions: this.doc.decisions, peaks: this.peaks, unit: this.doc.head.unit,
      band: this.doc.state.band,
    }), (a, b) => this.zoom(a, b), (t) => this.openNear(t));
    this.draw();
    this.fill();
    listen([this.key_]);
    this.ledger();
  }

  build() {
    const p = (this.parts = Object.fromEntries(["charts", "values", "face", "needs", "map", "trial", "decisions", "page", "rows", "title", "now", "tried"]
      .map((name) => [name, el("div", { class: name === "charts" ? "chart" : "" })])));
    const button = (text, title, act) => el("button", { type: "button", title, onclick: act }, text);
    this.liveButton = button("Follow", "Follow the newest samples (key: L)", () => this.follow());
    const bar = el("div", { class: "bar" }, this.liveButton,
      button("◀", "Back in time (key: left)", () => this.pan(-0.5)), button("▶", "Forward (key: right)", () => this.pan(0.5)),
      button("+", "Zoom in (key: +)", () => this.scale(0.5)), button("−", "Zoom out (key: -)", () => this.scale(2)),
      button("Show whole session", "From its beginning (key: W)", () => this.whole()),
      button("Try settings", "What would other settings do? Nothing is written", () => this.try()),
      el("span", { class: "muted" }, "Drag to zoom; double click on a mark opens its decision."));
    const legend = el("p", { class: "muted" }, Object.values(MARKS).map((m) => `${m.symbol} ${m.name}`).join("   "), "   E1 E2 E3 peaks as they are found");
    this.search = el("input", { type: "search", placeholder: "filter: words that a row holds", "aria-label": "filter the ledger", oninput: () => { this.filter = this.search.value; this.ledger(); } });
    this.export_ = el("a", { href: "#", download: "ledger.csv" }, "export as CSV");
    $("main").replaceChildren(el("div", {}, p.title, p.now),
      el("div", { class: "loop" },
        el("div", { class: "wide" },
          el("section", { class: "panel charts" }, p.values, bar, p.charts, legend),
          p.page, p.tried,
          el("section", { class: "panel" }, el("h2", {}, "Decisions"), p.decisions)),
        el("div", { class: "side" }, p.needs,
          el("section", { class: "panel" }, el("h2", {}, "Active"), p.face),
          el("section", { class: "panel" }, el("h2", {}, "Regions"), p.map),
          p.trial)),
      el("section", { class: "panel" }, el("h2", {}, "Ledger"), el("div", { class: "bar" }, this.search, this.export_), p.rows));
    $("hold").hidden = this.doc.ended;
  }

  // Take the shown span of time out of the trend.
  async window(whole = false) {
    const last = this.doc.newest ? this.doc.newest[0] : 0;
    if (this.live && !whole) { this.to = last; this.from = Math.max(last - this.span, 0); }
    const query = whole ? "points=2500" : `from=${this.from}&to=${this.to}&points=2500`;
    const found = await get(`/api/trend/${this.key_}?${query}`);
    this.columns = found.columns;
    this.whole_ = found.whole;
    if (whole) { [this.from, this.to] = found.whole; this.span = Math.max(this.to - this.from, 1); }
  }

  moved(told) {
    const moved = told.loops[this.key_];
    if (moved && this.doc) {
      if (moved.state) this.doc.state = moved.state;
      this.doc.newest = moved.samples.at(-1);
      const c = this.columns, last = c.t.at(-1) ?? -Infinity;
      if (this.live) {
        for (const s of moved.samples) {
          if (s[0] <= last) continue;
          c.t.push(s[0]); c.sp.push(s[1]); c.pv.push(s[2]); c.co.push(s[3]); c.region.push(s[4]); c.limited.push(s[5]);
        }
        this.to = this.doc.newest[0];
        this.from = Math.max(this.to - this.span, this.whole_?.[0] ?? 0);
        let old = 0;
        while (old < c.t.length && (c.t[old] < this.from - this.span || c.t.length - old > KEPT)) old++;
        if (old > 500) for (const name of Object.keys(c)) c[name].splice(0, old);
      }
      this.soon();
    }
    if (told.rows[this.session] !== undefined) this.later();
  }

  soon() {
    if (this.frame) return;
    this.frame = requestAnimationFrame(() => { this.frame = 0; this.draw(); this.values(); if (this.doc.state !== this.shown) this.fill(); });
  }

  get over() { return Boolean(this.doc?.ended); }
  told() { if (this.doc) this.fill(); }

  later(ms = 400) {
    clearTimeout(this.timer);
    this.timer = setTimeout(async () => {
      const doc = await get(`/api/loop/${this.key_}`).catch(() => null);
      if (!doc || state.page !== this) return;
      doc.newest = doc.newest ?? this.doc.newest;
      const ends = doc.ended && !this.doc.ended;
      this.doc = doc;
      if (ends) { // the whole run, in place of its last minutes at rest
        this.live = false;
        $("hold").hidden = true;
        $("link").textContent = "ended";
        await this.window(true).catch(() => null);
      }
      if (doc.ended && !doc.outcome) this.later(2000); // its report is being written
      this.fill();
      this.draw();
      this.ledger();
    }, 400);
  }

  draw() {
    this.charts?.draw(this.from, Math.max(this.to, this.from + 1e-3));
    this.liveButton.classList.toggle("primary", this.live);
    this.liveButton.setAttribute("aria-pressed", this.live);
  }

  values() {
    const s = this.doc.newest, unit = this.doc.head.unit;
    if (!s) return;
    if (!this.boxes) {
      this.boxes = Object.fromEntries(["sp", "pv", "co", "t"].map((k) => [k, el("span")]));
      this.parts.values.replaceChildren(el("div", { class: "values" }, valueBox("sp", this.boxes.sp, unit), valueBox("pv", this.boxes.pv, unit),
        valueBox("co", this.boxes.co, "%"), el("div", {}, el("span", { class: "k" }, "time"), el("b", {}, this.boxes.t))));
    }
    this.boxes.sp.textContent = words(s[1]);
    this.boxes.pv.textContent = words(s[2]);
    this.boxes.co.textContent = words(s[3], 3) + (s[5] ? " at its limit" : "");
    this.boxes.t.textContent = clock(s[0], 5000);
  }

  fill() {
    const d = this.doc, s = d.state, here = s.regions?.[s.region];
    this.shown = s;
    this.values();
    const [text, tone] = badge(d, here);
    this.parts.title.replaceChildren(el("h1", {}, d.head.loop, " ", el("span", { class: "muted" }, this.session), " ", el("span", { class: `badge ${tone}` }, text)));
    const newest = d.decisions.at(-1);
    const doing = d.outcome ? outcomeOf(d.outcome) : d.ended ? "The session has ended." : ["Waits for ", el("b", {}, s.waits_for ?? "the first sample"), "."];
    this.parts.now.className = "now";
    this.parts.now.replaceChildren(...[doing].flat(), d.outcome ? "" : newest ? ` Last: ${newest.cause}, ${newest.change || `nothing changed (${newest.reason})`}.` : " No decision yet.");
    if (d.broken) this.parts.now.append(el("p", { class: "bad" }, d.broken));
    this.face(here);
    this.needs();
    this.map();
    this.trial();
    this.decisions();
  }

  face(here) {
    const s = this.doc.state, limit = this.doc.head.ms_limit;
    const over = here && (here.unstable || (here.ms !== null && here.ms > limit));
    const row = (name, ...value) => el("tr", {}, el("th", {}, name), el("td", {}, value));
    this.parts.face.replaceChildren(el("table", {},
      row("region", here?.name ?? "not known"), row("active gains", s.running ?? "not known yet"),
      row("baseline gains", here?.commissioned ?? "-"),
      row("Ms on the identified process", el("span", { class: over ? "bad" : "" }, msWords(here)), ` (limit ${limit})`),
      row("trial", here?.trial ?? "-"), row("mode", this.modes(here)), row("output", s.manual ? el("span", { class: "bad" }, "MANUAL: the operator has control") : "automatic"),
      row("recogniser", `${s.recogniser ?? "-"}${s.peaks?.length ? `, ${s.peaks.length} peaks` : ""}`),
      row("noise band", `${words(s.band, 3)} ${this.doc.head.unit}`), row("ledger", `row ${this.doc.rows}, head ${this.doc.ledger_head.slice(0, 12)}`)));
  }

  modes(here) {
    if (!here) return "-";
    if (this.doc.ended) return here.mode;
    const select = el("select", { "aria-label": `mode of region ${here.name}`, onchange: () => {
      const mode = select.value;
      select.value = here.mode;
      this.act(`Region ${here.name}: mode ${mode}?`, MODES[mode], { order: "mode", region: here.name, mode });
    } }, Object.keys(MODES).map((m) => el("option", { value: m, selected: m === here.mode }, m === "off" ? "off (locked)" : m)));
    const everywhere = el("button", { type: "button", onclick: () => this.act(`All regions: mode ${here.mode}?`, MODES[here.mode], { order: "mode", region: "", mode: here.mode }) }, "for all regions");
    return [select, " ", everywhere];
  }

  needs() {
    const list = this.doc.ended ? [] : this.doc.waiting;
    if (!list.length) return this.parts.needs.replaceChildren();
    const act = (text, cls, what, why, order) => el("button", { type: "button", class: cls, onclick: () => this.act(what, why, order) }, text);
    this.parts.needs.replaceChildren(el("section", { class: "panel card needs" }, el("h2", { class: "bad" }, "Needs you"), list.map((w) => el("div", { class: "decision" },
      el("p", {}, el("b", {}, w.region), w.decision ? `, decision ${w.decision}` : "", `: ${w.text}`),
      el("div", { class: "bar" },
        w.what === "locked" ? act("Unlock", "primary", `Unlock ${w.region}?`, "The retuner may change this region again.", { order: "unlock", region: w.region }) : [
          w.what === "by hand" ? "" : act("Approve", "primary", `Approve ${w.region}?`, w.what === "tried" ? "The trial gains stay, and the region continues." : `The controller gets ${w.text}, on trial: rolled back when worse than predicted.`, { order: "approve", digest: w.digest }),
          act("Reject", "", `Reject ${w.region}?`, w.what === "tried" ? "The trial gains are rolled back." : "The proposal is closed.", { order: "reject", digest: w.digest }),
          w.decision ? el("button", { type: "button", onclick: () => this.open(w.decision) }, "why?") : ""])))));
  }

  map() {
    const { axes, ms_limit: limit } = this.doc.head, regions = this.doc.state.regions ?? [], now = this.doc.newest?.[0] ?? 0;
    const columns = axes.length > 1 ? axes[1].bounds.length + 1 : regions.length;
    const grid = el("div", { class: "map" });
    grid.style.gridTemplateColumns = `repeat(${Math.min(columns, 8)}, minmax(0, 1fr))`;
    grid.append(...regions.map((r, i) => {
      const age = r.learned_s === null ? null : now - r.learned_s, by = this.colourBy === "ms";
      const cell = el("div", { class: `cell${i === this.doc.state.region ? " here" : ""}`, title: `${r.name}: ${r.settings}; baseline ${r.commissioned}; ${r.records} records; ${r.trial}; mode ${r.mode}` },
        el("b", {}, r.name), by ? `Ms ${msWords(r)}` : age === null ? "no model" : `${clock(age, 5000)} ago`, r.trial === "idle" ? "" : ` ${r.trial}`);
      cell.style.background = by ? msTone(r.ms, r.unstable, limit) : ageTone(age, now);
      return cell;
    }));
    const toggle = el("button", { type: "button", onclick: () => { this.colourBy = this.colourBy === "ms" ? "age" : "ms"; this.map(); } }, this.colourBy === "ms" ? "colour: Ms" : "colour: age of model");
    const axis = axes.map((a) => `${a.label} [${a.unit}]: ${a.bounds.map((b) => words(b)).join(", ") || "one region"}`).join("; ");
    this.parts.map.replaceChildren(grid, el("div", { class: "bar" }, toggle), el("p", { class: "axis" }, `boundaries on ${axis}`));
  }

  trial() {
    const t = this.doc.trial;
    if (!t) return this.parts.trial.replaceChildren();
    const head = el("tr", {}, ["", "predicted", "before"].map((h) => el("th", {}, h)));
    const names = { iae: "IAE per unit step", decay: "half-cycle decay ratio", overshoot: "overshoot", settle_s: "settling time [s]" };
    const upset = { setpoint: "setpoint step", load: "load step" };
    const figure = (name, value) => (name === "overshoot" && value !== null ? `${Math.round(100 * value)} %` : words(value, 3));
    const predicted = t.promise.map((p) => el("tr", {}, el("td", {}, `${upset[p.upset]}: ${names[p.name]}`),
      el("td", {}, `${figure(p.name, p.values[0])} (${figure(p.name, p.values[1])} to ${figure(p.name, p.values[2])})`), el("td", {}, figure(p.name, p.before))));
    const seen = t.seen.length ? t.seen.map((o) => el("p", {}, el("b", {}, `${o.number}: `), o.reason || o.finding.replaceAll("_", " "))) : el("p", { class: "muted" }, "No response has been judged yet.");
    this.parts.trial.replaceChildren(el("section", { class: "panel" }, el("h2", {}, `Trial: decision ${t.decision}, ${t.region}`), el("p", {}, t.change),
      t.promise.length ? el("table", {}, head, predicted) : "", el("h2", {}, "Seen so far"), seen,
      this.doc.state.predicted ? el("p", { class: "muted" }, `Predicted: ${this.doc.state.predicted}`) : ""));
  }

  decisions() {
    const list = this.doc.decisions.slice(-30).reverse();
    this.parts.decisions.className = "scroll";
    this.parts.decisions.replaceChildren(...(list.length ? list : []).map((d) => el("div", { class: `decision${d.action === "none" ? "" : " changes"}` },
      el("p", {}, el("b", {}, `${MARKS[d.action]?.symbol ?? ""}${d.number}`), ` ${clock(d.t_s, 5000)} ${d.region}: `, el("b", {}, d.cause), d.change ? `, ${d.change}` : ", nothing changed"),
      el("p", { class: "muted" }, [d.response, d.reason, d.judgement].filter(Boolean).join("; ")),
      el("div", { class: "bar" }, el("button", { type: "button", onclick: () => this.open(d.number) }, "Show full reasoning"),
        d.action === "commit" && !this.doc.ended ? el("button", { type: "button", onclick: () => this.act(`Roll back decision ${d.number}?`,
          `Region ${d.region} goes back to the gains before it.`, { order: "revert", decision: d.number }) }, "Roll back") : ""))));
    if (!list.length) this.parts.decisions.replaceChildren(el("p", { class: "muted" }, "No decision yet."));
  }

  open(number) {
    const close = el("button", { type: "button", onclick: () => this.parts.page.replaceChildren() }, "Close");
    const src = `/api/decision/${this.key_}/${number}`;
    this.parts.page.replaceChildren(el("section", { class: "panel" }, el("div", { class: "bar" }, el("h2", {}, `Decision ${number}`), close, el("a", { href: src, target: "_blank", rel: "noopener" }, "in a tab of its own")),
      el("iframe", { src, title: `decision ${number}`, sandbox: true })));
    this.parts.page.scrollIntoView({ block: "nearest" });
  }

  // Panels that try settings on the newest stay in each region; nothing leaves the page.
  async try() {
    const found = await get(`/api/what-if/${this.key_}`).catch((error) => { notice(error.message, true); return null; });
    if (!found || state.page !== this) return;
    const place = this.parts.tried;
    place.replaceChildren(el("div", { class: "bar" }, el("h2", {}, "What other settings would do"), el("button", { type: "button", onclick: () => place.replaceChildren() }, "Close")));
    const orders = !this.doc.ended && !state.readOnly;
    for (const { region, what } of found.panels) {
      const propose = orders ? ([kp, ki, kd], words) => this.act(`Propose ${words} for ${region}?`, "The guard checks them; what it accepts waits for approval above, and nothing is written before.", { order: "propose", region, gains: { kp, ki, kd } }) : null;
      window.whatIf(place, what, { name: region, propose, controller: found.controller, span: found.span, sets: ["proposed", "active"] });
    }
    if (!found.panels.length) place.append(el("p", { class: "muted" }, "Of no region is the process known yet."));
    place.scrollIntoView({ block: "nearest" });
  }

  openNear(t) {
    const near = this.doc.decisions.filter((d) => Math.abs(d.t_s - t) < 0.02 * (this.to - this.from));
    if (near.length) this.open(near.sort((a, b) => Math.abs(a.t_s - t) - Math.abs(b.t_s - t))[0].number);
  }

  async ledger() {
    const q = encodeURIComponent(this.filter);
    this.export_.setAttribute("href", `/api/ledger/${encodeURIComponent(this.session)}/csv?q=${q}`);
    const found = await get(`/api/ledger/${encodeURIComponent(this.session)}?q=${q}`).catch(() => null);
    if (!found || state.page !== this) return;
    const names = [["row", "row"], ["time", "when_s"], ["what", "kind"], ["who", "who"], ["loop", "loop"], ["region", "region"], ["why", "why"], ["old", "old"], ["new", "new"], ["verdict", "verdict"]];
    const body = found.rows.slice(-150).reverse().map((r) => el("tr", {}, names.map(([, k]) => el("td", {}, k === "when_s" ? clock(r[k], 5000) : String(r[k])))));
    this.parts.rows.className = "scroll";
    this.parts.rows.replaceChildren(el("table", {}, el("tr", {}, names.map(([n]) => el("th", {}, n))), body));
  }

  async show() { await this.window(); this.draw(); }
  zoom(a, b) { this.live = false; this.from = a; this.to = b; this.span = b - a; this.show(); }
  pan(share) { const d = share * this.span; this.zoom(this.from + d, this.to + d); }
  scale(by) {
    this.span *= by;
    if (this.live) this.show();
    else this.zoom((this.from + this.to - this.span) / 2, (this.from + this.to + this.span) / 2);
  }
  async whole() { this.live = false; await this.window(true); this.draw(); }
  follow() { this.live = true; this.span = Math.min(this.span, 1200 * this.doc.head.sample_time_s); this.show(); }
  async again() { const doc = await get(`/api/loop/${this.key_}`); this.doc = doc; await this.window(); this.fill(); this.draw(); this.ledger(); }

  act(title, text, order) { act(title, text, [{ loop: this.key_, ...order }]); }

  key(event) {
    const acts = { l: () => this.follow(), w: () => this.whole(), ArrowLeft: () => this.pan(-0.5), ArrowRight: () => this.pan(0.5), "+": () => this.scale(0.5), "-": () => this.scale(2) };
    const chosen = acts[event.key] ?? acts[event.key.toLowerCase()];
    if (!chosen) return false;
    chosen();
    return true;
  }

  end() { clearTimeout(this.timer); cancelAnimationFrame(this.frame); this.charts?.end(); }
}

const MODES = {
  off: "Nothing is decided or written there any more; what is on trial is rolled back. The schedule goes on.",
  advise: "Changes are proposed; an operator approves them.",
  trial: "One proved change is written and watched; it is rolled back when worse, and then waits for an operator.",
  auto: "Proved changes are written and watched, and rolled back when worse.",
};

// ---- acting: asks once, names who

function ask({ title, text, yes, token }) {
  const dialog = $("ask");
  $("ask-title").textContent = title;
  $("ask-text").textContent = text;
  $("ask-yes").textContent = yes;
  for (const row of ["ask-name-row", "ask-note-row"]) $(row).hidden = token;
  $("ask-token-row").hidden = !token;
  $("ask-name").value = sessionStorage.getItem("name") ?? "";
  $("ask-note").value = $("ask-token").value = "";
  return new Promise((resolve) => {
    dialog.returnValue = "cancel";
    dialog.addEventListener("close", () => {
      const given = dialog.returnValue === "yes" ? { name: $("ask-name").value.trim(), note: $("ask-note").value.trim(), token: $("ask-token").value.trim() } : null;
      $("ask-token").value = "";
      resolve(given);
    }, { once: true });
    dialog.showModal();
    $(token ? "ask-token" : $("ask-name").value ? "ask-yes" : "ask-name").focus();
  });
}

async function login(token) {
  try {
    await post("/api/login", { token });
    setActing(true);
    notice("You may act from here now. This ends after 15 minutes without a request.");
    return true;
  } catch (error) {
    notice(error.message, true);
    return false;
  }
}

async function askToken() {
  if (state.readOnly) { notice("This page was started read-only.", true); return false; }
  const given = await ask({ title: "Give the token", text: "It was printed where the page was started.", yes: "Enter", token: true });
  return given !== null && login(given.token);
}

async function act(title, text, orders) {
  if (!state.acting && !(await askToken())) return;
  const given = await ask({ title, text: `${text} Your name goes into the ledger before it takes effect.`, yes: "Yes, do it", token: false });
  if (!given) return;
  if (!given.name) { notice("Your name is needed: nothing was done.", true); return; }
  sessionStorage.setItem("name", given.name);
  try {
    for (const order of orders) await post("/api/order", { ...order, by: given.name, note: given.note });
    notice("Requested: the session acts on it at its next sample, and the ledger shows the result.");
  } catch (error) {
    if (error.status === 401) setActing(false);
    notice(error.message, true);
  }
}

async function holdEverything() {
  const found = await get("/api/overview");
  const loops = found.sessions.filter((s) => !s.ended).flatMap((s) => s.loops);
  const orders = loops.map((l) => ({ loop: l.key, order: "mode", region: "", mode: "off" }));
  if (orders.length) await act(`Hold everything: ${orders.length === 1 ? loops[0].head.loop : `all ${orders.length} loops`}?`, MODES.off, orders);
}

function setActing(may) {
  state.acting = may;
  $("login").textContent = may ? "Stop control" : "Allow control";
  $("login").classList.toggle("primary", may);
  $("who").textContent = may ? "you may act" : "";
  $("who").className = may ? "badge good" : "";
}

// ---- where we are

function route() {
  const hash = decodeURIComponent(location.hash);
  if (hash.startsWith("#token=")) {
    history.replaceState(null, "", "#/"); // the token does not stay in the address
    login(hash.slice(7));
  }
  if (hash === "#main") return;
  const loop = /^#\/loop\/([^/]+\/[^/]+)$/.exec(decodeURIComponent(location.hash));
  state.page?.end();
  state.page = null;
  if (loop) { state.page = new Loop(loop[1]); } else { state.page = new Overview(); }
}

addEventListener("hashchange", route);
addEventListener("keydown", (event) => {
  if (event.target.matches("input, select, textarea") || $("ask").open || event.ctrlKey || event.metaKey || event.altKey) return;
  const acts = { o: () => { location.hash = "#/"; }, t: askToken, h: () => { if (!$("hold").hidden) holdEverything(); } };
  if (state.page?.key(event)) event.preventDefault();
  else if (acts[event.key]) { event.preventDefault(); acts[event.key](); }
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => state.page?.draw?.());
document.addEventListener("visibilitychange", () => { if (!document.hidden && state.lost) state.page?.again(); });
$("hold").addEventListener("click", holdEverything);
$("login").addEventListener("click", async () => {
  if (!state.acting) return askToken();
  await post("/api/logout", {}).catch(() => {});
  setActing(false);
});
get("/api/who").then((who) => { state.readOnly = who.read_only; setActing(who.acting); if (who.read_only) $("login").hidden = true; }).catch(() => {}).finally(route); // a token in the address counts after it
