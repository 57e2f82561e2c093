"use strict";
// The page of `tsa dashboard`: shows what the daemon says, and asks for nothing that was not confirmed here.

const token = new URLSearchParams(location.search).get("token") || "";
const SECONDS = 20; // of the charts
const STALE = 0.5; // s without news from the loop
const CHARTS = {
  torque: [["tau_j_des", "wanted", "#888"], ["tau_j", "delivered", "#1f6fc4"], ["tau_m_cmd", "command (motor)", "#d35400"]],
  motion: [["omega_j", "joint speed, rad/s", "#2e7d32"], ["friction_term", "friction term, N·m", "#8e44ad"]],
};
const $ = (id) => document.getElementById(id);
const axes = new Map(); // name -> what is shown of it
const changes = []; // {name, before, value, unit}, the last one is undone first


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
  const shown = { article, charts: {}, data: {}, sliders: new Map() };
  for (const [kind, lines] of Object.entries(CHARTS)) {
    const target = article.querySelector(`.${kind}`);
    shown.data[kind] = [[], ...lines.map(() => [])];
    shown.charts[kind] = new uPlot(
      {
        width: target.clientWidth || 900,
        height: kind === "torque" ? 260 : 160,
        scales: { x: { time: false } },
        axes: [{ label: "s" }, { label: kind === "torque" ? "N·m" : "" }],
        series: [{ label: "t" }, ...lines.map(([, label, stroke]) => ({ label, stroke, width: 1.5, spanGaps: false, points: { show: false } }))],
      },
      shown.data[kind],
      target,
    );
  }
  axes.set(axis.name, shown);
  addParameters(axis, shown);
}

function addParameters(axis, shown) {
  const table = shown.article.querySelector(".parameters");
  for (const [name, figures] of Object.entries(axis.parameters)) {
    if (figures.low === null) continue;
    const full = `${axis.name}.${name}`;
    const slider = element("input", { type: "range", min: figures.low, max: figures.high, step: "any", value: figures.value });
    slider.setAttribute("aria-label", full);
    const now = element("td", { className: "number" });
    const wanted = element("output");
    const apply = element("button", { textContent: "apply" });
    const cancel = element("button", { textContent: "cancel" });
    const row = element(
      "tr", {},
      element("th", { textContent: name }),
      now,
      element("td", { textContent: figures.unit }),
      element("td", {}, slider),
      element("td", { className: "decide" }, wanted, " ", apply, " ", cancel),
    );
    row.dataset.parameter = full;
    slider.addEventListener("input", () => {
      row.classList.add("pending");
      wanted.textContent = `${number(Number(slider.value))} ${figures.unit}`;
    });
    cancel.addEventListener("click", () => row.classList.remove("pending"));
    apply.addEventListener("click", () => {
      row.classList.remove("pending");
      change(full, Number(slider.value), true);
    });
    table.append(row);
    shown.sliders.set(name, { row, slider, now });
  }
}

async function change(name, value, remember) {
  try {
    const answer = await ask("set", { name, value });
    if (remember) changes.push({ name, before: answer.before, value: answer.value, unit: answer.unit });
    say(`${name}: ${number(answer.before)} → ${number(answer.value)} ${answer.unit}`);
  } catch (error) {
    say(String(error.message), true);
  }
  showChanges();
}

function showChanges() {
  const last = changes[changes.length - 1];
  $("changes").hidden = !last;
  if (last) $("last-change").textContent = `${last.name}: back from ${number(last.value)} to ${number(last.before)} ${last.unit}`;
}

$("undo").addEventListener("click", () => {
  const last = changes.pop();
  if (last) change(last.name, last.before, false);
});

$("stop").addEventListener("click", async () => {
  const button = $("stop");
  if (button.dataset.sure !== "yes") { // a second click within 3 s
    button.dataset.sure = "yes";
    button.textContent = "really stop?";
    setTimeout(() => { button.dataset.sure = ""; button.textContent = "stop"; }, 3000);
    return;
  }
  try {
    await ask("stop");
    say("stopping: the torque ramps to 0");
  } catch (error) {
    say(String(error.message), true);
  }
});

function showAxis(axis) {
  if (!axes.has(axis.name)) addAxis(axis);
  const shown = axes.get(axis.name);
  shown.article.querySelector(".title").textContent = axis.name;
  shown.article.querySelector(".figures").textContent =
    `${axis.state.replaceAll("_", " ")}; limiter: ${axis.limit_reason.replaceAll("_", " ")}; ` +
    `estimate: ${axis.estimate_state}; x ${number(axis.friction_angle)}, T_p ${number(axis.pretension)} N; ` +
    `${axis.missed} cycles without answer`;
  for (const [kind, lines] of Object.entries(CHARTS)) {
    const data = shown.data[kind];
    if (data[0].length && axis.t < data[0][data[0].length - 1]) data.forEach((column) => (column.length = 0)); // a new run
    if (!data[0].length || axis.t > data[0][data[0].length - 1]) {
      data[0].push(axis.t);
      lines.forEach(([field], i) => data[i + 1].push(axis[field]));
    }
    while (data[0].length && data[0][0] < axis.t - SECONDS) data.forEach((column) => column.shift());
    shown.charts[kind].setData(data);
  }
  for (const [name, { row, slider, now }] of shown.sliders) {
    const value = axis.parameters[name].value;
    now.textContent = number(value);
    if (!row.classList.contains("pending") && document.activeElement !== slider) slider.value = value;
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
  const lines = [...status.events, ...status.faults].sort((a, b) => b.number - a.number).slice(0, 12);
  $("events").replaceChildren(
    element("li", { textContent: `${cycles.cycles} cycles, ${cycles.skipped} skipped, ${cycles.dropped} frames dropped, ${cycles.log_lost} records lost` }),
    ...lines.map((event) => element("li", {
      className: event.fault ? "fault" : "",
      textContent: `${event.t.toFixed(3)} s  ${event.axis ? event.axis + ": " : ""}${event.text}`,
    })),
  );
}

const source = new EventSource(`events?token=${encodeURIComponent(token)}`);
source.onmessage = (event) => show(JSON.parse(event.data));
source.onerror = () => show({ error: "the dashboard's own server does not answer; start `tsa dashboard` again" });
