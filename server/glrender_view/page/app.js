// The page: what is asked, what is shown, what keys and pointers do.

import {Histogram} from "./histogram.js";
import {Link} from "./link.js";
import {digits, unitText} from "./numbers.js";
import {fill, frameRows, geometryRows, pixelRows, planRows, serverRows, set, stageRows, strip} from "./panels.js";
import {Picture} from "./picture.js";
import {Sketch} from "./sketch.js";

const find = id => document.getElementById(id);
const PIXEL_PAUSE_MS = 120, STATUS_MS = 1000, MAX_WARNINGS = 4;
const HINT = "drag to turn, wheel or + − to approach; drawn while no client waits";

const picture = new Picture(find("picture"));
const histogram = new Histogram(find("histogram"), picture, white => setWhite(white));
const sketch = new Sketch(find("sketch"));
const link = new Link(new URLSearchParams(location.search).get("token") ?? "");

let isFree = false, stream = null, after = 0, live = null, server = null, pixel = null, answer = null;
let isWaiting = false, pixelTimer = 0;
const free = {azimuth_deg: 30, elevation_deg: 20, range_m: 0, body: "", camera: "", isAsking: false, isStale: false};

// Frames: the next is asked for when the last has been drawn.

link.on("open", () => {
  light("good", "connected");
  after = 0;  // another view counts anew
  askFrame();
  link.ask("status");
});
link.on("close", reason => {
  light("bad", reason || "the view is gone; trying again");
  isWaiting = free.isAsking = false;
  document.body.dataset.frame = "";
});
link.on("frame", (head, values) => {
  isWaiting = false;
  requestAnimationFrame(() => {
    after = head.number;
    live = {head, values};
    sketch.follow(head.geometry, head.stream);
    if (!isFree) show(head, values);
    askFrame();
  });
});
link.on("free", (head, values) => {
  free.isAsking = false;
  if (values && isFree) show(head, values);
  if (isFree) note(head.trouble ?? HINT);
  if (values && free.isStale) askFree();
});

function askFrame() {
  if (isWaiting) return;
  isWaiting = true;
  link.ask("frame", {after, stream});
}

function show(head, values) {
  picture.show(head, values);
  find("empty").hidden = true;
  for (const section of document.querySelectorAll("aside section[hidden]")) section.hidden = false;
  find("save").disabled = false;
  fill(find("frame"), frameRows(head));
  fill(find("plan"), planRows(head.plan));
  fill(find("stages"), stageRows(head));
  fill(find("geometry"), geometryRows(head.geometry));
  sketch.show(head.geometry, head.stream);
  warn(head.warnings ?? []);
  told();
  readOut();
  document.body.dataset.frame = head.number;  // for tests
}

function warn(warnings) {
  const list = find("warnings"), text = JSON.stringify(warnings);
  if (list.dataset.text === text) return;
  list.dataset.text = text;
  list.replaceChildren(...warnings.slice(0, MAX_WARNINGS).map(({code, message}) => {
    const item = document.createElement("li"), name = document.createElement("b");
    name.textContent = code.replaceAll("_", " ");
    item.append(name, message);
    return item;
  }));
}

function note(text) {
  find("note").hidden = !text;
  set(find("note"), text);
}

function light(kind, text) {
  find("light").className = `light ${kind}`;
  set(find("light"), text);
}

// The server's numbers.

link.on("status", told => {
  server = told;
  if (told.trouble) light("bad", "no answer from the server");
  else if (told.not_shown) light("bad", "some frames cannot be shown");
  else light("good", "connected");
  if (!live) {
    find("empty").replaceChildren(told.trouble ? "The server does not answer" : "No frame yet");
    const small = document.createElement("small");
    small.textContent = told.trouble || told.not_shown || "The first frame that a client asks for appears here. " +
      "Free camera shows the scene meanwhile.";
    find("empty").append(small);
  }
  fill(find("server"), serverRows(told));
  const figures = strip(told.status.renders, told.status.waiting);
  for (const [id, text] of Object.entries(figures)) set(find(id), text);
  listStreams(told.streams);
  const bodies = told.status.bodies ?? [];
  find("free").disabled = !bodies.length;
  if (bodies.length && !bodies.some(body => body.name === free.body)) {
    const camera = told.status.cameras[0];
    free.body = bodies[0].name;
    free.camera = camera.name;
    free.range_m = 4 * bodies[0].radius_m * camera.focal_length_px / Math.min(camera.width_px, camera.height_px);
  }
});
setInterval(() => { if (!document.hidden) link.ask("status"); }, STATUS_MS);

function listStreams(streams) {
  const select = find("stream"), names = streams.flatMap(({client, cameras}) =>
    [...new Set(cameras)].map(camera => [client, camera])).sort();
  const text = JSON.stringify(names);
  if (select.dataset.text === text) return;
  select.dataset.text = text;
  select.replaceChildren(new Option("newest of all", ""), ...names.map(name =>
    new Option(`${name[1]} · ${name[0]}`, JSON.stringify(name))));
  select.value = stream ? JSON.stringify(stream) : "";
  if (select.selectedIndex < 0) select.selectedIndex = 0;
}

find("stream").addEventListener("change", event => {
  stream = event.target.value ? JSON.parse(event.target.value) : null;
  after = 0;
  isWaiting = false;
  askFrame();
});

// Stretch and white.

for (const button of find("stretch").children) {
  button.addEventListener("click", () => {
    choose(find("stretch"), button);
    picture.setStretch(button.dataset.stretch);
  });
}

function choose(group, chosen) {
  for (const button of group.children) button.setAttribute("aria-checked", String(button === chosen));
}

function setWhite(white, isAuto = false) {
  if (!isAuto && !(white > 0)) return told();
  picture.setWhite(white, isAuto);
  told();
}

function told() {
  find("auto").setAttribute("aria-pressed", String(picture.isAuto));
  if (!picture.head) return;
  if (document.activeElement !== find("white")) find("white").value = plain(picture.white);
  set(find("white-unit"), unitText(picture.head.unit));
  histogram.draw();
}

const plain = value => value < 1e-3 ? value.toExponential(3) : String(Number(value.toPrecision(4)));

find("auto").addEventListener("click", () => setWhite(picture.white, !picture.isAuto));
find("white").addEventListener("change", event => setWhite(Number(event.target.value.replace(",", "."))));

// Zoom.

picture.onView = () => set(find("zoom"), `${digits(100 * picture.scale / picture.ratio, 3)} %`);
find("in").addEventListener("click", () => picture.zoomBy(1.5));
find("out").addEventListener("click", () => picture.zoomBy(1 / 1.5));
find("fit").addEventListener("click", () => picture.fit());
find("one").addEventListener("click", () => picture.head && picture.zoomBy(picture.ratio / picture.scale));
find("save").addEventListener("click", () => picture.store.toBlob(blob => {
  const anchor = document.createElement("a");
  anchor.href = URL.createObjectURL(blob);
  anchor.download = `${picture.head.stream[1]}-${picture.head.number}.png`;
  anchor.click();
  setTimeout(() => URL.revokeObjectURL(anchor.href), 1000);
}));

// The pixel below the pointer.

function point(place) {
  const isSame = place && pixel && place.x === pixel.x && place.y === pixel.y;
  if (isSame) return;
  pixel = picture.marked = place;
  answer = null;
  picture.draw();
  readOut();
  clearTimeout(pixelTimer);
  pixelTimer = setTimeout(askPixel, PIXEL_PAUSE_MS);
}

function askPixel() {
  if (pixel && picture.head?.kind === "frame") link.ask("pixel", {number: picture.head.number, ...pixel});
}

function readOut() {
  const list = find("pixel");
  if (!pixel || !picture.head) {
    set(find("place"), "");
    fill(list, [["point at the frame, or tap it", ""]]);
    return;
  }
  set(find("place"), `${pixel.x}, ${pixel.y}`);
  // What was drawn for another pixel is not this one's.
  const fits = answer && answer.x === pixel.x && answer.y === pixel.y ? answer : null;
  fill(list, pixelRows(picture.head, picture.valueAt(pixel), fits));
  list.dataset.number = fits ? fits.number : "";
  if (fits && fits.number !== picture.head.number && !pixelTimer) pixelTimer = setTimeout(askPixel, 500);
}
link.on("pixel", told => {
  pixelTimer = 0;
  answer = told.trouble ? null : told;
  readOut();
});

// Pointers: drag to pan, two fingers to zoom; with the free camera a drag turns it.

const canvas = picture.canvas, pointers = new Map();
let pressed = null;
canvas.addEventListener("pointerdown", event => {
  canvas.setPointerCapture(event.pointerId);
  pointers.set(event.pointerId, event);
  pressed = event;
});
canvas.addEventListener("pointermove", event => {
  const before = pointers.get(event.pointerId);
  if (!before) return point(picture.pixelAt(event));
  const dx = event.clientX - before.clientX, dy = event.clientY - before.clientY;
  if (pointers.size === 2) {
    const [other] = [...pointers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
    const apart = place => Math.hypot(place.clientX - other.clientX, place.clientY - other.clientY);
    const box = canvas.getBoundingClientRect();
    zoomOrMove(apart(event) / Math.max(1, apart(before)),
               (0.5 * (event.clientX + other.clientX) - box.left) * picture.ratio,
               (0.5 * (event.clientY + other.clientY) - box.top) * picture.ratio);
  } else if (isFree) {
    turn(-0.4 * dx, 0.4 * dy);
  } else {
    picture.panBy(dx, dy);
  }
  pointers.set(event.pointerId, event);
});
for (const kind of ["pointerup", "pointercancel"]) {
  canvas.addEventListener(kind, event => {
    pointers.delete(event.pointerId);
    const isTap = Math.hypot(event.clientX - pressed.clientX, event.clientY - pressed.clientY) < 5;
    if (isTap && !isFree) point(picture.pixelAt(event));
  });
}
canvas.addEventListener("pointerleave", event => {
  if (event.pointerType === "mouse" && document.activeElement !== canvas) point(null);
});
canvas.addEventListener("wheel", event => {
  event.preventDefault();
  const box = canvas.getBoundingClientRect();
  zoomOrMove(Math.exp(-0.0015 * event.deltaY), (event.clientX - box.left) * picture.ratio,
             (event.clientY - box.top) * picture.ratio);
}, {passive: false});
canvas.addEventListener("dblclick", () => picture.fit());
canvas.addEventListener("keydown", event => {
  const step = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1]}[event.key];
  const far = event.shiftKey ? 10 : 1;
  if (step && isFree) turn(-3 * far * step[0], -3 * far * step[1]);
  else if (step && picture.head) {
    const {width, height, origin: [x0, y0]} = picture.head;
    const [x, y] = pixel ? [pixel.x, pixel.y] : [x0 + (width >> 1), y0 + (height >> 1)];
    const held = (value, low, size) => Math.min(low + size - 1, Math.max(low, value));
    point({x: held(x + far * step[0], x0, width), y: held(y + far * step[1], y0, height)});
  } else if (event.key === "+" || event.key === "=") zoomOrMove(1.25);
  else if (event.key === "-") zoomOrMove(1 / 1.25);
  else if (event.key === "0") picture.fit();
  else return;
  event.preventDefault();
});

function zoomOrMove(factor, x, y) {
  if (!isFree) return picture.zoomBy(factor, x, y);
  free.range_m /= factor;
  askFree();
}

// The free camera: one frame is asked for at a time, for where it was moved to meanwhile.

function turn(azimuth_deg, elevation_deg) {
  free.azimuth_deg = (free.azimuth_deg + azimuth_deg) % 360;
  free.elevation_deg = Math.min(89, Math.max(-89, free.elevation_deg + elevation_deg));
  askFree();
}

function askFree() {
  free.isStale = free.isAsking;
  if (free.isAsking) return;
  free.isAsking = true;
  const {azimuth_deg, elevation_deg, range_m, body, camera} = free;
  link.ask("free", {azimuth_deg, elevation_deg, range_m, body, camera});
}
function setFree(on) {
  isFree = on;
  choose(find("live").parentElement, find(on ? "free" : "live"));
  canvas.classList.toggle("grab", on);
  point(null);
  note(on ? HINT : "");
  warn([]);
  picture.fit();
  if (on) {
    const g = live?.head.geometry;
    if (g && !free.isPlaced) {
      // It begins where the client's camera is.
      const [x, y, z] = g.r_camera_m;
      Object.assign(free, {azimuth_deg: Math.atan2(y, x) * 180 / Math.PI, body: g.body, camera: live.head.camera.name,
                           elevation_deg: Math.asin(z / g.range_m) * 180 / Math.PI, range_m: g.range_m});
    }
    free.isPlaced = true;
    askFree();
  } else if (live) show(live.head, live.values);
}
find("live").addEventListener("click", () => setFree(false));
find("free").addEventListener("click", () => setFree(true));

readOut();
histogram.draw();
link.open();
