// Pictures: the trends of a loop with region bands, marks of decisions and peaks; small traces; the region map's colours.
const BANDS = 5;

export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

// Seconds as people read them, for an axis of a given span.
export function clock(seconds, span) {
  if (!Number.isFinite(seconds)) return "";
  const sign = seconds < 0 ? "-" : "";
  const s = Math.abs(seconds);
  if (span < 300) return `${sign}${Number(s.toFixed(span < 10 ? 1 : 0))} s`;
  const h = Math.floor(s / 3600), m = Math.floor((s % 3600) / 60), r = Math.floor(s % 60);
  const two = (n) => String(n).padStart(2, "0");
  return span < 7200 ? `${sign}${h}:${two(m)}:${two(r)}` : `${sign}${h}:${two(m)}`;
}

export const MARKS = {
  commit: { symbol: "✓", name: "written", dash: [] },
  advise: { symbol: "?", name: "proposed", dash: [6, 4] },
  restore: { symbol: "↩", name: "rolled back", dash: [2, 3] },
  none: { symbol: "·", name: "nothing changed", dash: [1, 6] },
};

const TONES = { commit: "good", advise: "warn", restore: "bad", none: "faint" };

function bands(u, columns, names) {
  const { ctx, bbox } = u;
  const t = columns.t, region = columns.region;
  if (!t.length) return;
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  ctx.font = `${12 * devicePixelRatio}px system-ui, sans-serif`;
  ctx.textAlign = "left";
  let start = 0;
  for (let i = 1; i <= t.length; i++) {
    if (i < t.length && region[i] === region[start]) continue;
    const end = Math.min(i, t.length - 1), r = region[start];
    const from = u.valToPos(t[start], "x", true), to = u.valToPos(t[end], "x", true);
    if (r >= 0) {
      ctx.fillStyle = colour(`band${r % BANDS}`);
      ctx.fillRect(from, bbox.top, to - from, bbox.height);
      const name = names[r] ?? "", left = Math.max(from, bbox.left) + 4 * devicePixelRatio;
      if (to - left > ctx.measureText(name).width + 6) {
        ctx.fillStyle = colour("faint");
        ctx.fillText(name, left, bbox.top + bbox.height - 5 * devicePixelRatio);
      }
    }
    start = i;
  }
  ctx.restore();
}

function marks(u, decisions, labelled) {
  const { ctx, bbox } = u;
  ctx.save();
  ctx.font = `bold ${12 * devicePixelRatio}px system-ui, sans-serif`;
  ctx.textAlign = "center";
  const told = [];
  for (const d of [...decisions].sort((a, b) => (a.action === "none") - (b.action === "none"))) {
    if (d.t_s === null || d.t_s < u.scales.x.min || d.t_s > u.scales.x.max) continue;
    const kind = MARKS[d.action] ?? MARKS.none, x = u.valToPos(d.t_s, "x", true);
    ctx.strokeStyle = ctx.fillStyle = colour(TONES[d.action] ?? "faint");
    ctx.lineWidth = (d.action === "none" ? 1 : 2) * devicePixelRatio;
    ctx.setLineDash(kind.dash.map((n) => n * devicePixelRatio));
    ctx.beginPath();
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
    if (!labelled || told.some((other) => Math.abs(other - x) < 30 * devicePixelRatio)) continue;
    told.push(x);
    ctx.fillText(`${kind.symbol}${d.number}`, x, bbox.top - 4 * devicePixelRatio);
  }
  ctx.restore();
}

function peaks(u, found, sp) {
  const { ctx } = u;
  ctx.save();
  ctx.strokeStyle = ctx.fillStyle = colour("bad");
  ctx.lineWidth = 2 * devicePixelRatio;
  ctx.font = `bold ${12 * devicePixelRatio}px system-ui, sans-serif`;
  found.forEach(([t, e], i) => {
    if (t < u.scales.x.min || t > u.scales.x.max) return;
    const x = u.valToPos(t, "x", true), y = u.valToPos(sp(t) - e, "y", true);
    ctx.beginPath();
    ctx.arc(x, y, 5 * devicePixelRatio, 0, 7);
    ctx.stroke();
    ctx.fillText(`E${i + 1}`, x + 8 * devicePixelRatio, y - 6 * devicePixelRatio);
  });
  ctx.restore();
}

// Room for values on an axis that is never shorter than its floor: a loop at rest looks at rest.
export function floored(low, high, floor) {
  if (low === null || high === null || low === undefined || high === undefined) return [0, 1];
  const room = Math.max(1.16 * (high - low), floor || 1e-9), middle = (low + high) / 2;
  return [middle - room / 2, middle + room / 2];
}
const NOISE_BANDS = 8, CO_FLOOR = 10; // least heights: noise bands of pv, per cent of co

// The two charts of a loop, one time axis. view: () => {columns, names, decisions, peaks, unit}; zoomed(from, to).
export class Charts {
  constructor(place, view, zoomed, chosen) {
    this.view = view;
    this.place = place;
    const sync = uPlot.sync("loop");
    const width = Math.max(place.clientWidth, 260);
    const axis = (label, size) => ({
      label, size, labelSize: 18, stroke: () => colour("ink"), grid: { stroke: () => colour("grid"), width: 1 },
      ticks: { stroke: () => colour("grid") },
    });
    const time = (shown) => ({
      ...axis(shown ? "time since the start" : "", shown ? 34 : 6),
      incrs: [0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 10800, 21600, 43200, 86400, 172800, 604800],
      values: (u, splits) => splits.map((s) => (shown ? clock(s, u.scales.x.max - u.scales.x.min) : "")),
    });
    const base = {
      width, cursor: { sync: { key: sync.key }, drag: { x: true, y: false, setScale: false } }, select: { show: true },
      scales: { x: { time: false } }, legend: { live: true, markers: { width: 2 } },
    };
    const selected = (u) => {
      if (u.select.width < 6) return;
      zoomed(u.posToVal(u.select.left, "x"), u.posToVal(u.select.left + u.select.width, "x"));
      u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
    };
    const label = (u, v) => (v === null || v === undefined ? "-" : clock(v, u.scales.x.max - u.scales.x.min));
    const value = (u, v) => (v === null || v === undefined ? "-" : Number(v.toPrecision(5)));
    const { unit } = view();
    this.top = new uPlot({
      ...base, height: 300, padding: [18, 24, 0, 0],
      scales: { ...base.scales, y: { range: (u, low, high) => floored(low, high, NOISE_BANDS * (view().band || 0)) } },
      axes: [time(false), axis(`pv, sp [${unit}]`, 52)],
      series: [{ label: "time", value: label },
        { label: `sp [${unit}]`, stroke: () => colour("sp"), dash: [6, 4], width: 1.3, value, paths: uPlot.paths.stepped({ align: 1 }) },
        { label: `pv [${unit}]`, stroke: () => colour("pv"), width: 1.8, value }],
      hooks: {
        drawClear: [(u) => bands(u, view().columns, view().names)],
        draw: [(u) => { marks(u, view().decisions, true); peaks(u, view().peaks, (t) => this.spAt(t)); }],
        setSelect: [selected],
        ready: [(u) => u.over.addEventListener("dblclick", () => chosen(u.posToVal(u.cursor.left, "x")))],
      },
    }, this.data().top, place);
    this.bottom = new uPlot({
      ...base, height: 150, padding: [8, 24, 0, 0], legend: { show: false },
      scales: { ...base.scales, y: { range: (u, low, high) => floored(low, high, CO_FLOOR) } },
      axes: [time(true), axis("co [%]", 52)],
      series: [{ label: "time", value: label }, { label: "co [%]", stroke: () => colour("co"), width: 1.4, value }],
      hooks: { drawClear: [(u) => bands(u, view().columns, [])], draw: [(u) => marks(u, view().decisions, false)], setSelect: [selected] },
    }, this.data().bottom, place);
    this.sized = new ResizeObserver(() => {
      const wide = Math.max(place.clientWidth, 260);
      const high = wide < 500 ? 220 : 300;
      this.top.setSize({ width: wide, height: high });
      this.bottom.setSize({ width: wide, height: high / 2 });
    });
    this.sized.observe(place);
  }

  data() {
    const c = this.view().columns;
    return { top: [c.t, c.sp, c.pv], bottom: [c.t, c.co] };
  }

  spAt(t) {
    const c = this.view().columns;
    let low = 0, high = c.t.length - 1;
    while (low < high) {
      const mid = (low + high + 1) >> 1;
      if (c.t[mid] <= t) low = mid; else high = mid - 1;
    }
    return c.sp[low] ?? 0;
  }

  draw(from, to) {
    const { top, bottom } = this.data();
    for (const [u, d] of [[this.top, top], [this.bottom, bottom]]) {
      u.batch(() => { u.setData(d, false); u.setScale("x", { min: from, max: to }); });
    }
  }

  end() {
    this.sized.disconnect();
    this.top.destroy();
    this.bottom.destroy();
  }
}

export function spark(canvas, values, reference, band = 0) {
  const box = canvas.getBoundingClientRect(), scale = devicePixelRatio;
  canvas.width = Math.max(box.width * scale, 10);
  canvas.height = Math.max(box.height * scale, 10);
  const ctx = canvas.getContext("2d"), all = values.concat(reference);
  if (values.length < 2) return;
  const [low, high] = floored(Math.min(...all), Math.max(...all), NOISE_BANDS * band), room = high - low;
  for (const [line, tone, dash] of [[reference, "sp", [4, 3]], [values, "pv", []]]) {
    ctx.strokeStyle = colour(tone);
    ctx.setLineDash(dash.map((n) => n * scale));
    ctx.lineWidth = 1.5 * scale;
    ctx.beginPath();
    line.forEach((v, i) => {
      const x = (i / (line.length - 1)) * canvas.width, y = canvas.height - 3 - ((v - low) / room) * (canvas.height - 6);
      if (i) ctx.lineTo(x, y); else ctx.moveTo(x, y);
    });
    ctx.stroke();
  }
}

// Light is good, dark is bad: readable without telling red from green; the number stands beside it.
const STEPS = ["#f3f8fb", "#cfe3ef", "#a6cbe0", "#e9b872", "#d9813d"];

export function msTone(ms, unstable, limit) {
  if (unstable) return "#e2604a";
  if (ms === null || ms === undefined) return "#e4e4e4";
  const at = ms <= 1.4 ? 0 : ms <= 1.6 ? 1 : ms <= limit ? 2 : ms <= 1.15 * limit ? 3 : 4;
  return STEPS[at];
}

export function ageTone(age, span) {
  if (age === null || age === undefined) return "#e4e4e4";
  const share = age / Math.max(span, 1);
  return STEPS[share < 0.1 ? 0 : share < 0.25 ? 1 : share < 0.5 ? 2 : share < 0.75 ? 3 : 4];
}
