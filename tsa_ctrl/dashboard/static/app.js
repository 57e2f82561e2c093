"use strict";
// The page of `tsa dashboard`: shows what the daemon says, and asks for nothing that was not confirmed here.

const token = new URLSearchParams(location.search).get("token") || "";
const SECONDS = 20; // of the charts
const STALE = 0.5; // s without news from the loop
const REFRESH = 1000 / 30; // ms between two looks of the charts
const TENFOLD = 10; // of the smallest step that a number field knows per press of an arrow
const COLOURS = ["#1f77d4", "#888", "#12a594", "#d35400", "#8e44ad", "#2e9d38", "#c2185b"]; // of the lines of a chart
const EDGE = "55"; // opacity of the ends of a band
const FILL = "33"; // and of the area between them
const $ = (id) => document.getElementById(id);
const SIGNALS = JSON.parse($("signals").textContent); // of an axis: name, unit, doc, chart, band
const CHARTS = charts(); // by title
const axes = new Map(); // name -> what is shown of it
const changes = []; // {name, before, value, unit}, the last one is undone first
let latest = null; // the newest status


function charts() { // unit, lines (field or function of the axis, label, colour), bands (labels of the upper and the lower line)
  const found = {};
  for (const { name, unit, doc, chart, band } of SIGNALS.filter((signal) => signal.chart)) {
    const { lines, bands } = (found[chart] ??= { unit: spelled(unit), lines: [], bands: [] });
    const colour = COLOURS[lines.filter(([field]) => typeof field === "string").length % COLOURS.length];
    lines.push([name, doc, colour]);
    if (!band) continue;
    const ends = [`${name}, upper`, `${name}, lower`];
    lines.push([(axis) => axis[name]?.high ?? null, ends[0], colour + EDGE], [(axis) => axis[name]?.low ?? null, ends[1], colour + EDGE]);
    bands.push({ ends, fill: colour + FILL });
  }
  found.power = { unit: "W", lines: [[(axis) => product(delivered(axis), axis.omega_j), "power to the joint", COLOURS[0]]], bands: [] };
  return Object.fromEntries(Object.entries(found).sort(([, a], [, b]) => b.bands.length - a.bands.length));
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

function spelledOut(word) { // of a state; a dash while it is not known
  return word === null ? "–" : word.replaceAll("_", " ");
}

function product(a, b) {
  return a === null || a === undefined || b === null || b === undefined ? null : a * b;
}

function delivered(axis) {
  return axis.tau_j ?? axis.tau_j_stretch?.value ?? null;
}

function value_of(axis, field) {
  const found = typeof field === "function" ? field(axis) : axis[field];
  return found?.value ?? found ?? null; // of a quantity its value
}

function spelled(unit) { // as people read it
  return unit === "1" ? "" : unit.replaceAll("*", "·");
}

function band(found) { // a value between its ends
  return found ? `${number(found.value, 3)} (${number(found.low, 3)} to ${number(found.high, 3)}) ${spelled(found.unit)}` : "–";
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
  if (!response.ok) throw new Error(answer.error || `refused (${response.status})`);
  return answer;
}

function addAxis(axis) {
  const article = $("axis").content.firstElementChild.cloneNode(true);
  $("axes").append(article);
  const shown = { article, charts: {}, data: {}, lines: {}, sliders: new Map() };
  const colour = getComputedStyle(document.documentElement).getPropertyValue("--plain");
  const style = { stroke: colour, grid: { stroke: "#8884", width: 1 }, ticks: { stroke: "#8884", width: 1 } };
  for (const [kind, { unit, lines, bands }] of Object.entries(CHARTS)) {
    const target = article.querySelector(".charts").appendChild(element("div", { className: `chart${bands.length ? " wide" : ""}` }));
    const known = lines.filter(([field]) => typeof field === "function" || field in axis);
    shown.lines[kind] = known;
    shown.data[kind] = [[], ...known.map(() => [])];
    const filled = bands.map(({ ends, fill }) => ({ series: ends.map((end) => 1 + known.findIndex(([, label]) => label === end)), fill }));
    shown.charts[kind] = new uPlot(
      {
        title: kind,
        width: target.clientWidth || 900,
        height: heightOf(kind),
        scales: { x: { time: false } },
        axes: [{ ...style, label: bands.length ? "s" : undefined }, { ...style, label: unit, size: 64, space: 18 }],
        series: [{ label: "s" }, ...known.map(([, label, stroke]) => ({ label, stroke, width: 1.5, spanGaps: false, points: { show: false } }))],
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
  return CHARTS[kind].bands.length ? 290 : 180;
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
    const slider = element("input", { type: "range", min: figures.low, max: figures.high, step: "any", value: figures.value });
    slider.setAttribute("aria-label", full);
    const now = element("td", { className: "number" });
    const wanted = element("input", { type: "number", min: figures.low, max: figures.high, step: step(figures.low, figures.high), value: number(figures.value) });
    wanted.setAttribute("aria-label", `${full}, number`);
    const apply = element("button", { textContent: "apply" });
    const cancel = element("button", { textContent: "cancel" });
    const row = element(
      "tr", {},
      element("th", { textContent: name }),
      now,
      element("td", { textContent: spelled(figures.unit) }),
      element("td", {}, slider),
      element("td", {}, wanted),
      element("td", { className: "decide" }, apply, " ", cancel),
    );
    row.dataset.parameter = full;
    const decide = () => {
      row.classList.remove("pending");
      change(full, Number(wanted.value), true);
    };
    slider.addEventListener("input", () => {
      row.classList.add("pending");
      wanted.value = number(Number(slider.value));
    });
    wanted.addEventListener("input", () => {
      row.classList.add("pending");
      slider.value = wanted.value;
    });
    wanted.addEventListener("keydown", (event) => {
      if (event.key === "Enter" && row.classList.contains("pending")) decide();
    });
    cancel.addEventListener("click", () => row.classList.remove("pending"));
    apply.addEventListener("click", decide);
    table.append(row);
    shown.sliders.set(name, { row, slider, wanted, now });
  }
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
  say("stop: asking ...");
  try {
    const answer = await ask("stop");
    say(answer.signalled ? `its socket does not answer: process ${answer.signalled} got SIGTERM instead; the torque ramps to 0` : "stopping: the torque ramps to 0");
  } catch (error) {
    const reason = error instanceof TypeError ? "this page's own server does not answer" : String(error.message);
    say(`NOT STOPPED from here: ${reason}. Use the emergency stop, or in a terminal: tsa stop`, true);
  }
}
$("stop").addEventListener("click", stop);
addEventListener("keydown", (event) => {
  if (event.key === "Escape" && !event.repeat) stop();
});

let sure = 0; // until when a second press on recover counts, ms
$("recover").addEventListener("click", async () => {
  if (performance.now() > sure) {
    sure = performance.now() + 5000;
    $("recover").textContent = "recover: press again, keep clear of the joint";
    setTimeout(() => { $("recover").textContent = "recover"; }, 5000);
    return;
  }
  sure = 0;
  $("recover").textContent = "recover";
  try {
    await ask("recover");
    say("recovery asked for; see events for how it ends");
  } catch (error) {
    say(String(error.message), true);
  }
});

function showFaults(status) {
  const faulted = status.phase === "faulted" || status.axes.some((axis) => axis.state === "fault");
  $("faulted").hidden = !status.faults.length;
  $("recover").disabled = !faulted;
  $("recover-words").textContent = faulted ? "resets the fault; the drive is enabled and torque comes back" : "over: torque is on again";
  $("faults").replaceChildren(...status.faults.slice(0, 4).map((event) => element("li", { className: "fault", textContent: spoken(event) },
    ...(event.cure ? [element("span", { className: "cure", textContent: `do: ${event.cure}` })] : []))));
}

function spoken(event) {
  return `${event.t.toFixed(3)} s  ${event.axis ? event.axis + ": " : ""}${event.text}`;
}

function showAxis(axis) {
  if (!axes.has(axis.name)) addAxis(axis);
  const shown = axes.get(axis.name);
  shown.article.querySelector(".title").textContent = axis.name;
  shown.article.querySelector(".figures").textContent =
    SIGNALS.filter(({ chart, band: has }) => !chart || has).map((signal) => `${signal.name} ${figure(axis[signal.name], signal)}`).join("; ");
  for (const [kind, lines] of Object.entries(shown.lines)) {
    const data = shown.data[kind];
    if (data[0].length && axis.t < data[0][data[0].length - 1]) data.forEach((column) => (column.length = 0)); // a new run
    if (!data[0].length || axis.t > data[0][data[0].length - 1]) {
      data[0].push(axis.t);
      lines.forEach(([field], i) => data[i + 1].push(value_of(axis, field)));
    }
    const old = data[0].findIndex((t) => t >= axis.t - SECONDS);
    if (old > 0) data.forEach((column) => column.splice(0, old));
    shown.charts[kind].setData(data);
  }
  for (const [name, { row, slider, wanted, now }] of shown.sliders) {
    const value = axis.parameters[name].value;
    now.textContent = number(value);
    if (!row.classList.contains("pending") && ![slider, wanted].includes(document.activeElement)) {
      slider.value = value;
      wanted.value = number(value);
    }
  }
}

function micros(seconds) {
  return seconds === null ? "above" : `${Math.round(1e6 * seconds)} µs`;
}

function showTimes(status) {
  const rows = [element("tr", {}, ...["", "p50", "p99", "p99.9"].map((text) => element("th", { textContent: text })))];
  for (const name of ["lateness", "work"]) {
    const found = status[name];
    rows.push(element("tr", {}, element("th", { textContent: name }),
      ...["p50", "p99", "p999"].map((key) => element("td", { className: "number", textContent: found[key] === null ? "–" : micros(found[key]) }))));
  }
  const most = Math.max(1, ...status.lateness.bins.map(([, samples]) => samples));
  for (const [edge, samples] of status.lateness.bins) {
    const bar = element("span", { className: "bar" });
    bar.style.width = `${(8 * Math.log1p(samples)) / Math.log1p(most)}rem`;
    const text = edge === null ? "later" : `up to ${micros(edge)}`;
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
    ? `since ${status.waiting.toFixed(1)} s: ${status.waiting_for}`
    : status.age > STALE ? `no news for ${status.age.toFixed(1)} s: the loop hangs or is gone` : "";
  status.axes.forEach(showAxis);
  showTimes(status);
  showFaults(status);
  fit();
  const lines = [...status.events, ...status.faults].sort((a, b) => b.number - a.number).slice(0, 12);
  $("events").replaceChildren(
    element("li", { textContent: `${cycles.cycles} cycles, ${cycles.skipped} skipped, ${cycles.dropped} frames dropped, ${cycles.log_lost} records lost` }),
    ...lines.map((event) => element("li", {
      className: event.fault ? "fault" : "",
      textContent: spoken(event),
    })),
  );
}

const source = new EventSource(`events?token=${encodeURIComponent(token)}`);
source.onmessage = (event) => { latest = JSON.parse(event.data); };
source.onerror = () => { latest = { error: "the dashboard's own server does not answer; start `tsa dashboard` again. To stop: emergency stop, or tsa stop" }; };
setInterval(() => { // what came since the last look, at most as often as the charts can be drawn
  if (latest === null) return;
  const status = latest;
  latest = null;
  show(status);
}, REFRESH);
