"use strict";
// The page of `tsa dashboard`: shows the daemon's measurements and status, and changes nothing without a confirmation.

const token = new URLSearchParams(location.search).get("token") || "";
const SECONDS = 20; // of the charts and of the errors
const STALE = 0.5; // s without news from the loop
const REFRESH = 1000 / 30; // ms between two drawings
const DRAWING = 3; // times the duration of a drawing until the next one, so that a slow machine still receives every point
const TENFOLD = 10; // of the smallest step of a number field per press of an arrow
const REVERSAL = 0.02; // s on either side of a reversal; as `tsa calibrate` and `tsa tune` separate the errors
const DECIMALS = 3; // of the newest values
const COLOURS = ["#1f77d4", "#888", "#12a594", "#d35400", "#8e44ad", "#2e9d38", "#c2185b"]; // of the lines of a chart
const EDGE = "55"; // opacity of the ends of a band
const ERROR = "tracking error"; // chart
const FILL = "33"; // and of the area between them
const $ = (id) => document.getElementById(id);
const SIGNALS = JSON.parse($("signals").textContent); // of an axis: name, unit, doc, chart, band
const CHARTS = charts(); // by title
const SPEED = SIGNALS.find((signal) => signal.name === "omega_j").chart;
let rested = 0; // ms, when the next drawing may begin
const axes = new Map(); // name -> what is shown of it
const changes = []; // {name, before, value, unit}, the last one is undone first
const incoming = []; // status and measurements in the order of their arrival, not drawn yet
let latest = null; // the newest status of a daemon
let start = null; // s, time of the loop's first cycle on the clock of the measurements

function charts() { // unit, lines (field or function of the axis, label, colour), bands (labels of the upper and the lower line)
  const found = {};
  for (const { name, unit, doc, chart, band } of SIGNALS.filter((signal) => signal.chart)) {
    const { lines, bands } = (found[chart] ??= { unit: spelled(unit), lines: [], bands: [] });
    const colour = COLOURS[lines.filter(([field]) => typeof field === "string").length % COLOURS.length];
    lines.push([name, doc, colour]);
    if (!band) continue;
    const ends = [`${name}, upper`, `${name}, lower`];
    lines.push([(axis) => axis.bands[name]?.high ?? null, ends[0], colour + EDGE], [(axis) => axis.bands[name]?.low ?? null, ends[1], colour + EDGE]);
    bands.push({ ends, fill: colour + FILL });
  }
  found[ERROR] = { unit: "N·m", lines: [[(axis) => difference(delivered(axis), axis.tau_j_des), "delivered less desired joint torque", "#c62828"]], bands: [] };
  found.power = { unit: "W", lines: [[(axis) => product(delivered(axis), axis.omega_j), "power to the joint", COLOURS[0]]], bands: [] };
  return Object.fromEntries(Object.entries(found).sort(([name, a], [other, b]) =>
    b.bands.length - a.bands.length || (other === ERROR) - (name === ERROR)));
}

function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

function say(text, error = false) {
  $("message").textContent = text;
  $("message").classList.toggle("error", error);
}

function number(value, digits = 4) {
  return value === null || value === undefined ? "–" : Number(value.toPrecision(digits)).toString();
}

function fixed(value, decimals) { // always as wide
  return value === null || value === undefined ? "–" : value.toFixed(decimals).replace("-", "−");
}

function spelledOut(word) { // of a state; a dash while it is not known
  return word === null ? "–" : word.replaceAll("_", " ");
}

function product(a, b) {
  return a === null || a === undefined || b === null || b === undefined ? null : a * b;
}

function difference(a, b) {
  return product(a, 1) === null || product(b, 1) === null ? null : a - b;
}

function delivered(axis) { // N·m, measured by the torque sensor, else from the tendon elongation
  return axis.tau_j ?? value_of(axis, "tau_j_stretch");
}

function value_of(axis, field) {
  const found = typeof field === "function" ? field(axis) : axis[field];
  return found?.value ?? found ?? null; // of a quantity its value
}

function rms(values) {
  return values.length ? Math.sqrt(values.reduce((sum, value) => sum + value * value, 0) / values.length) : null;
}

function milli(value) { // a torque error
  return value === null ? "–" : `${number(1000 * value, 3)} mN·m`;
}

function spelled(unit) { // as people read it
  return unit === "1" ? "" : unit.replaceAll("*", "·");
}

function band(found) { // a value between its ends
  return found ? `${fixed(found.value, 3)} (${fixed(found.low, 3)} to ${fixed(found.high, 3)}) ${spelled(found.unit)}` : "–";
}

function figure(value, signal) { // as text: of a code its name, of a value with a band its ends
  if (signal.band) return band(value);
  return typeof value === "number" ? `${number(value)} ${spelled(signal.unit)}`.trim() : spelledOut(value === null ? null : String(value));
}

async function ask(path, body) {
  const response = await fetch(path, {
    method: "POST",
    headers: { "Content-Type": "application/json", "X-Token": token },
    body: JSON.stringify(body || {}),
  });
  const answer = response.headers.get("content-type")?.includes("json") ? await response.json() : {};
  if (!response.ok) throw new Error(answer.error || `rejected (${response.status})`);
  return answer;
}

function addAxis(axis) {
  const article = $("axis").content.firstElementChild.cloneNode(true);
  $("axes").append(article);
  const shown = { article, charts: {}, data: {}, lines: {}, controls: new Map() };
  const colour = getComputedStyle(document.documentElement).getPropertyValue("--plain");
  const style = { stroke: colour, grid: { stroke: "#8884", width: 1 }, ticks: { stroke: "#8884", width: 1 } };
  for (const [kind, { unit, lines, bands }] of Object.entries(CHARTS)) {
    const target = article.querySelector(".charts").appendChild(element("div", { className: `chart${bands.length ? " wide" : ""}` }));
    target.dataset.chart = kind;
    const known = lines.filter(([field]) => typeof field === "function" || field in axis);
    shown.lines[kind] = known;
    shown.data[kind] = [[], ...known.map(() => [])];
    const filled = bands.map(({ ends, fill }) => ({ series: ends.map((end) => 1 + known.findIndex(([, label]) => label === end)), fill }));
    const edges = new Set(bands.flatMap(({ ends }) => ends));
    const value = (_, found) => `${fixed(found, DECIMALS)} ${unit}`;
    shown.charts[kind] = new uPlot(
      {
        width: target.clientWidth || 900,
        height: heightOf(kind),
        scales: { x: { time: false } },
        axes: [{ ...style, label: "time (s)", labelSize: 18, size: 32 }, { ...style, label: `${kind} (${unit})`, size: 64, space: 18 }],
        series: [{ label: "time", value: (_, found) => `${fixed(found, 2)} s` },
          ...known.map(([, label, stroke]) => ({ label, stroke, value, class: edges.has(label) ? "edge" : null, width: 1.5, spanGaps: false, points: { show: false } }))],
        cursor: { sync: { key: axis.name } },
        bands: filled,
      },
      shown.data[kind],
      target,
    );
  }
  axes.set(axis.name, shown);
  addParameters(axis, shown);
}

function heightOf(kind) { // px; a chart with bands is taller
  return CHARTS[kind].bands.length ? 290 : 190;
}

function fit() { // the charts to the width that there is
  for (const { charts } of axes.values()) {
    for (const [kind, chart] of Object.entries(charts)) {
      const width = chart.root.parentElement.clientWidth;
      if (width && width !== chart.width) chart.setSize({ width, height: heightOf(kind) });
    }
  }
}
addEventListener("resize", fit);

function step(low, high) { // a round one, about a hundredth of the range
  return 10 ** Math.floor(Math.log10((high - low) / TENFOLD ** 2));
}

function addParameters(axis, shown) {
  const table = shown.article.querySelector(".parameters");
  for (const [name, figures] of Object.entries(axis.parameters)) {
    if (figures.low === null) continue;
    const full = `${axis.name}.${name}`;
    const control = figures.switch ? switchOf(full, figures) : sliderOf(full, figures);
    const now = element("td", { className: "number" });
    const apply = element("button", { textContent: "apply" });
    const cancel = element("button", { textContent: "cancel" });
    const row = element(
      "tr", {},
      element("th", { textContent: name.replaceAll("_", " "), title: figures.doc ?? "", scope: "row" }),
      now,
      element("td", { className: "unit", textContent: spelled(figures.unit) }),
      ...control.cells,
      element("td", { className: "decide" }, apply, " ", cancel),
    );
    row.dataset.parameter = full;
    const decide = () => {
      row.classList.remove("pending");
      change(full, control.value(), true);
    };
    row.addEventListener("input", (event) => {
      row.classList.add("pending");
      control.follow(event.target);
    });
    row.addEventListener("keydown", (event) => {
      if (event.key === "Enter" && row.classList.contains("pending")) decide();
    });
    cancel.addEventListener("click", () => row.classList.remove("pending"));
    apply.addEventListener("click", decide);
    table.append(row);
    shown.controls.set(name, { row, control, now });
  }
}

function sliderOf(full, { low, high, value }) { // and a field for the number
  const slider = element("input", { type: "range", min: low, max: high, step: "any", value });
  slider.setAttribute("aria-label", full);
  const field = element("input", { type: "number", min: low, max: high, step: step(low, high), value: number(value) });
  field.setAttribute("aria-label", `${full}, number`);
  return {
    cells: [element("td", { className: "slide" }, slider), element("td", {}, field)],
    value: () => Number(field.value),
    follow: (moved) => { if (moved === slider) field.value = number(Number(slider.value)); else slider.value = field.value; },
    show: (found) => { slider.value = found; field.value = number(found); },
    text: (found) => number(found),
    parts: [slider, field],
  };
}

function switchOf(full, { value }) {
  const box = element("input", { type: "checkbox", className: "switch", checked: value !== 0 });
  box.setAttribute("role", "switch");
  box.setAttribute("aria-label", full);
  return {
    cells: [element("td", { className: "slide" }, box), element("td", {})],
    value: () => Number(box.checked),
    follow: () => {},
    show: (found) => { box.checked = found !== 0; },
    text: (found) => found === null ? "–" : found === 0 ? "off" : "on",
    parts: [box],
  };
}

async function change(name, value, remember) {
  try {
    const answer = await ask("set", { name, value });
    if (remember) changes.push({ name, before: answer.before, value: answer.value, unit: answer.unit });
    say(`${name}: ${number(answer.before)} → ${number(answer.value)} ${spelled(answer.unit)}`);
  } catch (error) {
    say(String(error.message), true);
  }
  showChanges();
}

function showChanges() {
  const last = changes[changes.length - 1];
  $("changes").hidden = !last;
  if (last) $("last-change").textContent = `${last.name}: back from ${number(last.value)} to ${number(last.before)} ${spelled(last.unit)}`;
}

$("undo").addEventListener("click", () => {
  const last = changes.pop();
  if (last) change(last.name, last.before, false);
});

async function stop() {
  say("stop: request sent ...");
  try {
    const answer = await ask("stop");
    say(answer.signalled ? `the daemon's socket does not answer; SIGTERM was sent to process ${answer.signalled}. The torque ramps to 0` : "stopping: the torque ramps to 0");
  } catch (error) {
    const reason = error instanceof TypeError ? "the server of this page does not answer" : String(error.message);
    say(`NOT STOPPED from here: ${reason}. Use the emergency stop, or in a terminal: tsa stop`, true);
  }
}
$("stop").addEventListener("click", stop);
addEventListener("keydown", (event) => {
  if (event.key === "Escape" && !event.repeat) stop();
});

let confirmable = 0; // until when a second press on recover counts, ms
$("recover").addEventListener("click", async () => {
  if (performance.now() > confirmable) {
    confirmable = performance.now() + 5000;
    $("recover").textContent = "recover: keep clear of the joint, then press again";
    setTimeout(() => { $("recover").textContent = "recover"; }, 5000);
    return;
  }
  confirmable = 0;
  $("recover").textContent = "recover";
  try {
    await ask("recover");
    say("recovery requested; the events list its result");
  } catch (error) {
    say(String(error.message), true);
  }
});

function showFaults(status) {
  const faulted = status.phase === "faulted" || status.axes.some((axis) => axis.state === "fault");
  $("faulted").hidden = !status.faults.length;
  $("recover").disabled = !faulted;
  $("recover-words").textContent = faulted ? "resets the fault and enables the drive again, with torque" : "the fault was reset and torque is on again";
  $("faults").replaceChildren(...status.faults.slice(0, 4).map((event) => element("li", { className: "fault", textContent: spoken(event) },
    ...(event.cure ? [element("span", { className: "cure", textContent: `remedy: ${event.cure}` })] : []))));
}

function spoken(event) {
  return `${event.t.toFixed(3)} s  ${event.axis ? event.axis + ": " : ""}${event.text}`;
}

function showAxis(axis) {
  if (!axes.has(axis.name)) addAxis(axis);
  const shown = axes.get(axis.name);
  shown.article.querySelector(".title").textContent = axis.name;
  shown.article.querySelector(".figures").replaceChildren(...SIGNALS.filter(({ chart, band: has }) => !chart || has).map((signal) =>
    element("span", { className: "figure", title: signal.doc }, `${signal.name.replaceAll("_", " ")} `, element("b", { textContent: figure(axis[signal.name], signal) }))));
  for (const [name, { row, control, now }] of shown.controls) {
    const value = axis.parameters[name].value;
    now.textContent = control.text(value);
    if (!row.classList.contains("pending") && !control.parts.includes(document.activeElement)) control.show(value);
  }
}

function takeSample(sample) { // one row of every chart; what only the status has is at most 20 ms old
  if (!latest || start === null) return;
  for (const measured of sample.axes) {
    const shown = axes.get(measured.name);
    if (!shown) continue;
    const status = latest.axes.find((axis) => axis.name === measured.name);
    const axis = { ...status, ...measured, bands: status };
    const t = sample.time - start;
    for (const [kind, lines] of Object.entries(shown.lines)) {
      const data = shown.data[kind];
      const last = data[0][data[0].length - 1];
      if (t < last) data.forEach((column) => (column.length = 0)); // a new run
      if (t === last) continue;
      data[0].push(t);
      lines.forEach(([field], i) => data[i + 1].push(value_of(axis, field)));
      const old = data[0].findIndex((time) => time >= t - SECONDS);
      if (old > 0) data.forEach((column) => column.splice(0, old));
    }
  }
}

function draw() {
  for (const shown of axes.values()) {
    for (const [kind, chart] of Object.entries(shown.charts)) {
      chart.setData(shown.data[kind]);
      const count = shown.data[kind][0].length;
      if (count && !(chart.cursor.left >= 0)) chart.setLegend({ idx: count - 1 }); // the newest values
    }
    showErrors(shown);
  }
}

function showErrors(shown) { // of the seconds in the charts
  const [times, errors] = shown.data[ERROR];
  const speed = shown.lines[SPEED].findIndex(([field]) => field === "omega_j");
  const speeds = shown.data[SPEED][speed + 1];
  const zone = latest?.axes.find((axis) => axes.get(axis.name) === shown)?.parameters.direction_zone?.value ?? 0;
  const direction = speeds.map((speed) => speed === null || Math.abs(speed) <= zone ? 0 : Math.sign(speed));
  let last = 0;
  const reversals = [];
  direction.forEach((sign, i) => {
    if (sign && last && sign !== last) reversals.push(times[i]);
    if (sign) last = sign;
  });
  const sliding = [], turning = [];
  let next = 0;
  errors.forEach((error, i) => {
    while (next < reversals.length && reversals[next] < times[i] - REVERSAL) next += 1;
    const near = next < reversals.length && reversals[next] <= times[i] + REVERSAL;
    if (error !== null) (near || !direction[i] ? turning : sliding).push(error);
  });
  const known = errors.filter((error) => error !== null);
  const peak = known.length ? Math.max(...known.map(Math.abs)) : null;
  const span = times.length ? Math.min(SECONDS, Math.round(times[times.length - 1] - times[0])) : 0;
  shown.article.querySelector(".errors").textContent = known.length
    ? `Tracking error of the last ${span} s: RMS ${milli(rms(known))}; while sliding ${milli(rms(sliding))}, ` +
      `at reversals and at rest ${milli(rms(turning))}; peak ${milli(peak)}`
    : "Tracking error: the delivered torque is not measured";
}

function micros(seconds) {
  return seconds === null ? "more" : `${Math.round(1e6 * seconds)} µs`;
}

function showTimes(status) {
  const rows = [element("tr", {}, ...["", "p50", "p99", "p99.9"].map((text) => element("th", { className: "number", textContent: text })))];
  for (const [key, name] of [["lateness", "wake-up latency"], ["work", "execution time"]]) {
    const found = status[key];
    rows.push(element("tr", {}, element("th", { textContent: name, scope: "row" }),
      ...["p50", "p99", "p999"].map((key) => element("td", { className: "number", textContent: found[key] === null ? "–" : micros(found[key]) }))));
  }
  rows.push(element("tr", {}, ...["wake-up latency", "cycles", "", ""].map((text, i) => element("th", { className: i === 1 ? "number" : "", textContent: text }))));
  const most = Math.max(1, ...status.lateness.bins.map(([, samples]) => samples));
  for (const [edge, samples] of status.lateness.bins) {
    const bar = element("span", { className: "bar" });
    bar.style.width = `${(8 * Math.log1p(samples)) / Math.log1p(most)}rem`;
    const text = edge === null ? "longer" : `up to ${micros(edge)}`;
    rows.push(element("tr", {}, element("td", { textContent: text }), element("td", { className: "number", textContent: samples }), element("td", { colSpan: 2 }, bar)));
  }
  $("times").replaceChildren(...rows);
}

function show(status) {
  if (status.error) {
    $("phase").textContent = "no daemon";
    $("phase").className = "badge gone";
    $("news").textContent = status.error;
    return;
  }
  document.title = `tsa: ${status.name}, ${status.phase}`;
  $("name").textContent = status.name;
  $("phase").textContent = status.phase;
  $("phase").className = `badge ${status.phase}`;
  const { cycles } = status;
  $("news").textContent = status.waiting_for
    ? `waiting since ${status.waiting.toFixed(1)} s: ${status.waiting_for}`
    : status.age > STALE ? `no data for ${status.age.toFixed(1)} s: the loop hangs or has ended` : "";
  status.axes.forEach(showAxis);
  showTimes(status);
  showFaults(status);
  fit();
  const lines = [...status.events, ...status.faults].sort((a, b) => b.number - a.number).slice(0, 12);
  $("events").replaceChildren(
    element("li", { textContent: `${cycles.cycles} cycles, ${cycles.skipped} skipped, ${cycles.dropped} frames dropped, ${cycles.log_lost} log records lost` }),
    ...lines.map((event) => element("li", {
      className: event.fault ? "fault" : "",
      textContent: spoken(event),
    })),
  );
}

const source = new EventSource(`events?token=${encodeURIComponent(token)}`);
source.onmessage = (event) => { incoming.push({ status: JSON.parse(event.data) }); };
source.addEventListener("sample", (event) => { incoming.push({ sample: JSON.parse(event.data) }); });
source.onerror = () => { incoming.push({ status: { error: "the server of this page does not answer; start `tsa dashboard` again. To stop: emergency stop, or tsa stop" } }); };
setInterval(() => { // draws the messages received since the last call
  let news = null;
  let measured = false;
  for (const { status, sample } of incoming.splice(0)) {
    news = status ?? news;
    if (status?.axes) {
      if (!latest) status.axes.forEach(showAxis); // the charts of the first status
      latest = status;
    }
    if (!sample) continue;
    const own = latest?.axes[0]?.t;
    if (own != null && (start === null || Math.abs(sample.time - own - start) > STALE)) start = sample.time - own;
    takeSample(sample);
    measured = true;
  }
  if (news) show(news);
  const now = performance.now();
  if (!measured || now < rested) return;
  draw();
  rested = now + DRAWING * (performance.now() - now);
}, REFRESH);
