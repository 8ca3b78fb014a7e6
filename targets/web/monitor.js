// The operator's page: shows what the server tells, sends back which button was pressed. Text goes in as text only.
"use strict";

const $ = (id) => document.getElementById(id);
const SVG = "http://www.w3.org/2000/svg";
const here = location.pathname;
const DEAF_MS = 6000; // the server says something every two seconds
const PHASES = {
  idle: "Ready", capturing: "Capturing", asking: "Your turn", paused: "Paused", stopping: "Stopping", complete: "Complete",
  stopped: "Stopped", interrupted: "Interrupted", serving: "Showing", unshown: "Not shown yet", focusing: "Focusing",
};
const ENDED = ["complete", "stopped", "interrupted"];
const SAFE = "Every photograph so far is safe: go on with --resume.";
const LEAST_SPAN = 0.1; // of the sharpest: less is the noise of one frame and the next

let socket = null;
let heard = 0;
let last = null;

function make(tag, className, ...children) {
  const element = document.createElement(tag);
  if (className) element.className = className;
  element.append(...children); // strings become text nodes
  return element;
}

function send(message) {
  if (socket !== null && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

const press = (what) => send({ do: what });

function duration(seconds) {
  const minutes = Math.round(seconds / 60);
  if (seconds < 90) return `${Math.round(seconds)} s left`;
  if (seconds < 600) return `${Math.floor(seconds / 60)} min ${Math.round(seconds % 60)} s left`;
  return minutes < 90 ? `${minutes} min left` : `${Math.floor(minutes / 60)} h ${minutes % 60} min left`;
}

// An ISO 8601 time where the reader is, with the zone's name and without the day.
const clock = (time) => new Date(time).toLocaleTimeString("en-GB", { hour: "2-digit", minute: "2-digit", second: "2-digit", timeZoneName: "short" });

// A target counts as shown where its display says so; without photographs there is nothing to say of any.
function phaseOf(state) {
  return state.phase === "serving" && state.displays.some((display) => display.problem !== null) ? "unshown" : state.phase;
}

function render(state) {
  const phase = phaseOf(state);
  const running = ["capturing", "asking", "paused", "stopping"].includes(state.phase);
  $("phase").textContent = PHASES[phase] || phase;
  $("phase").dataset.phase = phase;
  $("frame").hidden = $("numbers").hidden = state.phase === "serving" && state.frame === null;
  document.title = state.total ? `${state.done}/${state.total} ${PHASES[phase]} – labkit` : "labkit";
  if (state.phase === "asking") document.title = `● ${document.title}`;
  $("doing").textContent = state.doing;
  $("doing").classList.toggle("wrong", state.phase === "stopped");
  $("safe").textContent = ["stopped", "interrupted"].includes(state.phase) ? SAFE : "";
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
  renderQuestion(state.question);
  renderChoices(state);
  renderFrame(state.frame);
  renderSharpness(state.sharpness);
  renderDevices(state);
  renderLog(state.log);
}

function renderQuestion(question) {
  const form = $("question");
  const number = question === null ? "" : String(question.number);
  if (form.dataset.number === number) return; // what is being typed stays
  form.dataset.number = number;
  form.hidden = question === null;
  if (question === null) return;
  const typed = question.wants === "number";
  $("asked").textContent = typed ? `${question.text}.` : `${question.text}, then touch Done.`;
  $("reply").value = $("slip").textContent = "";
  $("reply").hidden = $("unit").hidden = !typed;
  $("reply").inputMode = /-\d/.test(question.text) ? "text" : "decimal"; // a tablet's number pad has no minus
  $("send").textContent = typed ? "Send" : "Done";
  $("send").disabled = false;
  if (typed && document.activeElement === document.body && matchMedia("(pointer: fine)").matches) $("reply").focus();
}

function answer(event) {
  event.preventDefault();
  const question = last === null ? null : last.question;
  if (question === null) return;
  const text = question.wants === "number" ? $("reply").value.trim() : "";
  const plain = text.replace(/\s*mm$/, "").replace(",", ".");
  if (question.wants === "number" && (plain === "" || !Number.isFinite(Number(plain)) || !/^[ -~]*$/.test(text))) {
    $("slip").textContent = "Type a number, such as 150.25.";
    $("reply").select();
    return;
  }
  $("slip").textContent = "";
  if (socket === null || socket.readyState !== WebSocket.OPEN) {
    $("slip").textContent = "No connection: try again in a moment.";
    return;
  }
  $("send").disabled = true;
  send({ answer: question.number, text });
}

function renderChoices(state) {
  if (JSON.stringify([state.choices, state.picked]) === $("choices").dataset.now) return;
  $("choices").dataset.now = JSON.stringify([state.choices, state.picked]);
  $("choices").replaceChildren(...state.choices.map((name) => {
    const button = make("button", "", name);
    button.type = "button";
    button.setAttribute("aria-pressed", name === state.picked);
    button.addEventListener("click", () => press(name));
    return button;
  }));
}

function renderFrame(frame) {
  $("empty").hidden = frame !== null;
  $("light").hidden = frame === null;
  if (frame === null || (last !== null && last.frame !== null && last.frame.number === frame.number)) return;
  const where = frame.range_mm === null ? "" : ` · ${frame.range_mm} mm`;
  $("frame-name").textContent = `${frame.name}${where}`;
  $("note").textContent = frame.note;
  $("preview").src = `${here}/frame?${frame.number}-${Date.now()}`;
  $("preview").hidden = false;
  $("clipped").textContent = `${frame.clipped_percent.toFixed(frame.clipped_percent < 10 ? 2 : 0)} %`;
  $("median").textContent = `median ${frame.median_percent.toFixed(0)} %`;
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

function renderSharpness(points) {
  if (points.length === 0) return;
  const values = points.map((point) => point.edge_px);
  const least = Math.min(...values), span = Math.max(Math.max(...values) - least, LEAST_SPAN * least);
  $("sharpness").textContent = `${values[values.length - 1].toFixed(1)} px`;
  $("best").textContent = `edges rise over this, smaller is sharper; best ${least.toFixed(1)}, ${points[values.indexOf(least)].name}`;
  $("trend").replaceChildren();
  if (values.length < 2) return;
  // the line falls as the number does
  const at = (v, i) => `${((200 * i) / (values.length - 1)).toFixed(1)},${(36 - (32 * (v - least)) / span).toFixed(1)}`;
  const line = document.createElementNS(SVG, "path");
  line.setAttribute("d", `M${values.map(at).join(" L")}`);
  $("trend").append(line);
}

function renderDevices(state) {
  // a web display speaks for itself, below
  const rows = state.devices.filter((d) => d.device !== "display" || state.displays.length === 0).map((d) => [d.device, d.state === "good", d.text]);
  for (const d of state.displays) rows.push([d.name === "screen" ? "display" : `display ${d.name}`, d.problem === null, d.problem || "ready"]);
  $("no-devices").hidden = rows.length > 0;
  $("device-list").replaceChildren(...rows.map(([name, good, text]) =>
    make("li", good ? "" : "bad", make("span", "soft", name), make("span", "", text))));
}

function renderLog(lines) {
  const list = $("log-list");
  const now = JSON.stringify(lines);
  if (list.dataset.now === now) return; // whoever scrolls in it is left alone
  list.dataset.now = now;
  list.replaceChildren(...lines.slice().reverse().map((line) => {
    const bad = /^(trouble|stopped|put aside)/.test(line.text);
    const time = make("time", "soft", clock(line.time));
    time.dateTime = time.title = line.time;
    return make("li", bad ? "trouble" : "", time, make("span", "", line.text));
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
  renderQuestion(null);
}

function connect() {
  heard = Date.now();
  const connection = new WebSocket(`ws://${location.host}${here}/socket`);
  socket = connection;
  connection.onopen = () => { last = null; }; // maybe another session's
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

$("pause").addEventListener("click", () => press(last !== null && last.phase === "paused" ? "resume" : "pause"));
$("question").addEventListener("submit", answer);
$("abort").addEventListener("click", () => askAgain(true));
$("yes").addEventListener("click", () => { askAgain(false); press("abort"); });
$("no").addEventListener("click", () => askAgain(false));
askAgain(false);
$("actions").hidden = true;
$("bar").hidden = true;
connect();
