// The operator's page: shows what the server tells, sends back which button was pressed. Text goes in as text only.
"use strict";

const $ = (id) => document.getElementById(id);
const SVG = "http://www.w3.org/2000/svg";
const here = location.pathname;
const DEAF_MS = 6000; // the server says something every two seconds
const PHASES = {
  idle: "Ready", capturing: "Capturing", paused: "Paused", stopping: "Stopping", complete: "Complete",
  stopped: "Stopped", interrupted: "Interrupted", serving: "Showing",
};
const ENDED = ["complete", "stopped", "interrupted"];

let socket = null;
let heard = 0;
let last = null;

function make(tag, className, ...children) {
  const element = document.createElement(tag);
  if (className) element.className = className;
  element.append(...children); // strings become text nodes
  return element;
}

function send(what) {
  if (socket !== null && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify({ do: what }));
}

function duration(seconds) {
  const minutes = Math.round(seconds / 60);
  if (seconds < 90) return `${Math.round(seconds)} s left`;
  return minutes < 90 ? `${minutes} min left` : `${Math.floor(minutes / 60)} h ${minutes % 60} min left`;
}

function render(state) {
  const running = ["capturing", "paused", "stopping"].includes(state.phase);
  $("phase").textContent = PHASES[state.phase] || state.phase;
  $("phase").dataset.phase = state.phase;
  document.title = state.total ? `${state.done}/${state.total} ${PHASES[state.phase]} – labkit` : "labkit";
  $("doing").textContent = state.doing;
  $("left").textContent = state.left_s === null ? "" : duration(state.left_s);
  $("count").textContent = state.total ? `${state.done} of ${state.total}` : "";
  $("bar").hidden = !state.total;
  $("bar").setAttribute("aria-valuemax", state.total);
  $("bar").setAttribute("aria-valuenow", state.done);
  $("fill").style.width = state.total ? `${(100 * state.done) / state.total}%` : "0";
  $("actions").hidden = !running;
  $("pause").textContent = state.phase === "paused" ? "Go on" : "Pause";
  $("pause").disabled = $("abort").disabled = state.phase === "stopping";
  if (state.phase === "stopping" || !running) askAgain(false);
  renderChoices(state);
  renderFrame(state.frame);
  renderSharpness(state.sharpness, state.frame);
  renderDevices(state);
  renderLog(state.log);
}

function renderChoices(state) {
  if (JSON.stringify([state.choices, state.picked]) === $("choices").dataset.now) return;
  $("choices").dataset.now = JSON.stringify([state.choices, state.picked]);
  $("choices").replaceChildren(...state.choices.map((name) => {
    const button = make("button", "", name);
    button.type = "button";
    button.setAttribute("aria-pressed", name === state.picked);
    button.addEventListener("click", () => send(name));
    return button;
  }));
}

function renderFrame(frame) {
  $("empty").hidden = frame !== null;
  if (frame === null || (last !== null && last.frame !== null && last.frame.number === frame.number)) return;
  const where = frame.range_mm === null ? "" : ` · ${frame.range_mm} mm`;
  $("frame-name").textContent = `${frame.name}${where}`;
  $("preview").src = `${here}/frame?${frame.number}`;
  $("preview").hidden = false;
  $("clipped").textContent = `${frame.clipped_percent.toFixed(frame.clipped_percent < 10 ? 2 : 0)} %`;
  $("median").textContent = `middle value ${frame.median_percent.toFixed(0)} %`;
  const most = Math.max(...frame.histogram.map(Math.sqrt)) || 1;
  const width = 256 / frame.histogram.length;
  $("histogram").replaceChildren(...frame.histogram.map((share, i) => {
    const bar = document.createElementNS(SVG, "rect");
    const height = (64 * Math.sqrt(share)) / most; // the root: a few pixels of the target stay visible beside black
    for (const [key, value] of [["x", i * width], ["y", 64 - height], ["width", width * 0.9], ["height", height]]) {
      bar.setAttribute(key, value);
    }
    if (i === frame.histogram.length - 1) bar.setAttribute("class", "full");
    return bar;
  }));
}

function renderSharpness(points, frame) {
  $("sharpness").textContent = frame === null ? "–" : frame.sharpness.toPrecision(3);
  const values = points.map((point) => point.value);
  $("trend").replaceChildren();
  if (values.length < 2) return;
  const low = Math.min(...values), span = Math.max(...values) - low || 1;
  const at = (v, i) => `${((200 * i) / (values.length - 1)).toFixed(1)},${(36 - (32 * (v - low)) / span).toFixed(1)}`;
  const line = document.createElementNS(SVG, "path");
  line.setAttribute("d", `M${values.map(at).join(" L")}`);
  $("trend").append(line);
  const best = points[values.indexOf(Math.max(...values))];
  $("best").textContent = `best ${best.value.toPrecision(3)}, ${best.name}`;
}

function renderDevices(state) {
  // a web display speaks for itself, below
  const rows = state.devices.filter((d) => d.device !== "display" || state.displays.length === 0).map((d) => [d.device, d.state === "good", d.text]);
  for (const d of state.displays) rows.push([d.name === "screen" ? "display" : `display ${d.name}`, d.problem === null, d.problem || "ready"]);
  $("device-list").replaceChildren(...rows.map(([name, good, text]) =>
    make("li", good ? "" : "bad", make("span", "soft", name), make("span", "", text))));
}

function renderLog(lines) {
  const list = $("log-list");
  list.replaceChildren(...lines.slice().reverse().map((line) => {
    const bad = /^(trouble|stopped|rejected)/.test(line.text);
    return make("li", bad ? "trouble" : "", make("span", "soft", line.time), make("span", "", line.text));
  }));
}

function askAgain(asking) {
  $("sure").hidden = !asking;
  $("pause").hidden = $("abort").hidden = asking;
}

function offline() {
  if (last !== null && ENDED.includes(last.phase)) {
    $("doing").textContent = "labkit has ended";
  } else {
    $("phase").textContent = "No connection";
    $("phase").dataset.phase = "offline";
    $("left").textContent = "";
    $("doing").textContent = "trying again by itself";
  }
  $("actions").hidden = true;
}

function connect() {
  heard = Date.now();
  const connection = new WebSocket(`ws://${location.host}${here}/socket`);
  socket = connection;
  connection.onmessage = (event) => {
    if (socket !== connection) return;
    heard = Date.now();
    const state = JSON.parse(event.data);
    render(state);
    last = state;
  };
  connection.onclose = () => {
    if (socket !== connection) return;
    socket = null;
    offline();
    setTimeout(connect, 1000);
  };
}

setInterval(() => {
  if (socket !== null && Date.now() - heard > DEAF_MS) {
    const dead = socket;
    socket = null;
    dead.onclose = dead.onmessage = null;
    dead.close();
    offline();
    connect();
  }
}, 1000);

$("pause").addEventListener("click", () => send(last !== null && last.phase === "paused" ? "resume" : "pause"));
$("abort").addEventListener("click", () => askAgain(true));
$("yes").addEventListener("click", () => { askAgain(false); send("abort"); });
$("no").addEventListener("click", () => askAgain(false));
askAgain(false);
$("actions").hidden = true;
$("bar").hidden = true;
connect();
