// Fills the screen with the picture that labkit orders, pixel for pixel, and reports what became of it.
"use strict";

const $ = (id) => document.getElementById(id);
const canvas = $("glass");
const context = canvas.getContext("2d", { alpha: false, willReadFrequently: true });
const page = Array.from(crypto.getRandomValues(new Uint8Array(8)), (b) => b.toString(16).padStart(2, "0")).join("");
const here = location.pathname;

const BEAT_MS = 1000;
const ASLEEP_MS = 3000; // three beats missed: the page slept
const DEAF_MS = 6000; // the server says something every two seconds
const FETCH_MS = 30000;
const TAKEN_OVER = 4001;
const LOST = 1006; // no goodbye: the network; the picture stays

let socket = null;
let heard = 0;
let told = null; // the server's last message
let exact = false;
let shown = null; // the number of the picture on the glass
let crc = null;
let drawing = null;
let disturbed = 0;
let asked = 0;
let answering = 0;
let lastBeat = Date.now();
let lastFrame = Date.now();
let wakeLock = null;

// ---- the picture

const CRC_TABLE = Uint32Array.from({ length: 256 }, (_, n) => {
  for (let k = 0; k < 8; k++) n = n & 1 ? 0xedb88320 ^ (n >>> 1) : n >>> 1;
  return n;
});

// CRC-32 of the grey values on the canvas, row by row; null if any pixel is not grey.
function canvasCrc() {
  const data = context.getImageData(0, 0, canvas.width, canvas.height).data;
  let sum = 0xffffffff;
  for (let i = 0; i < data.length; i += 4) {
    if (data[i] !== data[i + 1] || data[i] !== data[i + 2]) return null;
    sum = CRC_TABLE[(sum ^ data[i]) & 255] ^ (sum >>> 8);
  }
  return (sum ^ 0xffffffff) >>> 0;
}

const frame = () => new Promise((done) => requestAnimationFrame(done));

async function draw(number) {
  drawing = number;
  try {
    const signal = AbortSignal.timeout ? AbortSignal.timeout(FETCH_MS) : undefined;
    const answer = await fetch(`${here}/picture?${number}`, { cache: "no-store", signal });
    if (!answer.ok) throw new Error(answer.status);
    const options = { colorSpaceConversion: "none", premultiplyAlpha: "none" };
    const bitmap = await createImageBitmap(await answer.blob(), options);
    if (drawing !== number) return;
    if (bitmap.width !== canvas.width || bitmap.height !== canvas.height) throw new Error("size");
    context.drawImage(bitmap, 0, 0);
    bitmap.close();
    document.body.classList.add("shown");
    await frame();
    await frame();
    if (drawing !== number) return;
    crc = canvasCrc();
    shown = number;
    drawing = null;
    report();
  } catch {
    if (drawing === number) setTimeout(() => { if (drawing === number) { drawing = null; refresh(); } }, BEAT_MS);
  }
}

function takeOff() {
  if (shown !== null || drawing !== null) disturbed += 1;
  shown = crc = drawing = null;
  context.fillRect(0, 0, canvas.width, canvas.height);
  document.body.classList.remove("shown");
}

// ---- what this page is

function resize(width, height, whole) {
  if (width === canvas.width && height === canvas.height && whole === exact) return;
  takeOff();
  exact = whole;
  canvas.width = width; // clears it
  canvas.height = height;
  refresh();
  report();
}

function watchSize() {
  const observer = new ResizeObserver(([entry]) => {
    const box = entry.devicePixelContentBoxSize;
    if (box) {
      resize(box[0].inlineSize, box[0].blockSize, true);
    } else { // Safari: whole pixels are to be had only if the product is whole
      const { width, height } = entry.contentRect;
      const across = width * devicePixelRatio, down = height * devicePixelRatio;
      const whole = [across, down].every((n) => Math.abs(n - Math.round(n)) < 1e-3);
      resize(Math.round(across), Math.round(down), whole);
    }
  });
  try {
    observer.observe(canvas, { box: "device-pixel-content-box" });
  } catch {
    observer.observe(canvas);
  }
}

const zoom = () => (window.visualViewport ? Math.round(visualViewport.scale * 1000) / 1000 : 1);
const visible = () => document.visibilityState === "visible";

function report() {
  $("measured").textContent = `${canvas.width} × ${canvas.height} pixels` + (exact ? "" : ", rounded");
  if (socket === null || socket.readyState !== WebSocket.OPEN) return;
  const size = [canvas.height, canvas.width];
  socket.send(JSON.stringify({ page, pixels: size, exact, zoom: zoom(), visible: visible(), shown, crc, disturbed, asked }));
}

// ---- what the server wants

function refresh() {
  if (told === null) return;
  $("name").textContent = told.name;
  $("panel").textContent = `${told.panel[1]} × ${told.panel[0]} pixels`;
  $("problem").textContent = told.problem || "";
  $("state").textContent = told.problem ? "Not right yet" : "Ready";
  const wanted = told.problem || !visible() || zoom() !== 1 ? null : told.picture;
  if (wanted === null) {
    if (shown !== null || drawing !== null) { takeOff(); report(); }
  } else if (wanted !== shown && wanted !== drawing) {
    draw(wanted);
  }
  if (told.ask > asked && told.ask !== answering) answer(told.ask);
}

async function answer(question) {
  answering = question;
  await frame();
  await frame();
  asked = Math.max(asked, question);
  report();
}

function connect() {
  heard = Date.now();
  const connection = new WebSocket(`ws://${location.host}${here}/socket`);
  socket = connection;
  connection.onopen = () => { heard = Date.now(); report(); };
  connection.onmessage = (event) => {
    if (socket !== connection) return;
    heard = Date.now();
    told = JSON.parse(event.data);
    refresh();
  };
  connection.onclose = (event) => {
    if (socket !== connection) return;
    socket = null;
    asked = 0;
    if (event.code === TAKEN_OVER) {
      told = null;
      takeOff();
      $("state").textContent = "Another page shows this display";
      $("problem").textContent = "Tap the button to show it here.";
    } else {
      if (event.code !== LOST) { told = null; takeOff(); }
      $("state").textContent = "Waiting for labkit";
      $("problem").textContent = "no connection: tried again every second, nothing needs to be done here";
      setTimeout(() => { if (socket === null) connect(); }, BEAT_MS);
    }
  };
}

// ---- sleep, zoom, touch

function disturb() {
  takeOff();
  refresh();
  report();
}

function beat() {
  const now = Date.now();
  if (now - lastBeat > ASLEEP_MS || (visible() && now - lastFrame > ASLEEP_MS)) disturb();
  lastBeat = now;
  requestAnimationFrame(() => { lastFrame = Date.now(); });
  if (socket !== null && now - heard > DEAF_MS) { // the network is gone without a word
    const dead = socket;
    socket = null;
    dead.onclose = dead.onmessage = null;
    dead.close();
    asked = 0;
    connect();
  }
  report();
}

async function stayAwake() {
  if (!("wakeLock" in navigator)) {
    $("awake").textContent = "set Auto-Lock to Never: the browser cannot";
    return;
  }
  try {
    wakeLock = await navigator.wakeLock.request("screen");
    $("awake").textContent = "yes";
    wakeLock.onrelease = () => { $("awake").textContent = "no"; };
  } catch {
    $("awake").textContent = "set Auto-Lock to Never: the browser will not";
  }
}

document.addEventListener("visibilitychange", () => {
  if (!visible()) { disturb(); return; }
  lastBeat = lastFrame = Date.now();
  stayAwake();
  refresh();
  report();
});
document.addEventListener("freeze", disturb);
if (window.visualViewport) {
  visualViewport.addEventListener("resize", () => { if (zoom() !== 1) disturb(); else { refresh(); report(); } });
}
for (const name of ["gesturestart", "contextmenu"]) document.addEventListener(name, (event) => event.preventDefault());

$("fill").addEventListener("click", async () => {
  stayAwake();
  if (socket === null) connect();
  const root = document.documentElement;
  const request = root.requestFullscreen || root.webkitRequestFullscreen;
  if (request) {
    try { await request.call(root, { navigationUI: "hide" }); } catch { /* the size tells whether it worked */ }
  } else {
    $("problem").textContent = "This browser has no full screen: add the page to the Home Screen.";
  }
});

watchSize();
setInterval(beat, BEAT_MS);
stayAwake();
connect();
