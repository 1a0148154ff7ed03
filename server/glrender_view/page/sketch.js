// Sun, body and camera in the plane that they span, the Sun to the right: the phase angle is seen as it is.

const MAX_TRAIL = 600, MAX_TRAILS = 16;

export class Sketch {
  constructor(canvas) {
    this.canvas = canvas;
    this.trails = new Map();
    this.trail = [];
    new ResizeObserver(() => this.draw()).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  /** Remember where a stream's camera is. */
  follow(geometry, stream) {
    const key = `${stream} ${geometry.body}`, trail = this.trails.get(key) ?? [];
    this.trails.delete(key);
    this.trails.set(key, trail);
    if (this.trails.size > MAX_TRAILS) this.trails.delete(this.trails.keys().next().value);
    const last = trail.at(-1), now = geometry.r_camera_m;
    if (!last || last.some((value, k) => value !== now[k])) trail.push(now);
    if (trail.length > MAX_TRAIL) trail.shift();
  }

  show(geometry, stream) {
    this.trail = this.trails.get(`${stream} ${geometry.body}`) ?? [];
    this.geometry = geometry;
    this.draw();
  }

  draw() {
    const {canvas, geometry: g} = this, ratio = window.devicePixelRatio || 1, box = canvas.getBoundingClientRect();
    canvas.width = Math.max(1, Math.round(box.width * ratio));
    canvas.height = Math.max(1, Math.round(box.height * ratio));
    const c = canvas.getContext("2d"), style = getComputedStyle(document.documentElement);
    const colour = name => style.getPropertyValue(name).trim();
    c.scale(ratio, ratio);
    if (!g) return;
    const {width, height} = box;
    const flat = this.trail.map(r => g.plane.map(axis => axis[0] * r[0] + axis[1] * r[1] + axis[2] * r[2]));
    // All that is shown fills the room beside the Sun.
    const places = [[-g.radius_m, -g.radius_m], [g.radius_m, g.radius_m], g.camera, ...flat,
                    ...g.others.map(other => other.place)];
    const [low, high] = [Math.min, Math.max].map(pick => [0, 1].map(k => pick(...places.map(place => place[k]))));
    const reach = Math.max((high[0] - low[0]) / (width - 130), (high[1] - low[1]) / (height - 52), 1e-9);
    const at = ([x, y]) => [(width - 60) / 2 + (x - (low[0] + high[0]) / 2) / reach,
                            height / 2 - (y - (low[1] + high[1]) / 2) / reach];
    const ink = colour("--ink"), quiet = colour("--quiet");
    c.lineWidth = 1.25;
    c.font = getComputedStyle(document.body).font.replace("13px", "11px");
    // Sunlight comes from the right.
    c.strokeStyle = c.fillStyle = colour("--sun");
    for (const y of [0.25, 0.5, 0.75]) arrow(c, [width - 4, y * height], [width - 24, y * height]);
    c.fillText("Sun", width - 24, 0.25 * height - 7);
    // The way of the camera.
    c.strokeStyle = quiet;
    c.globalAlpha = 0.6;
    c.beginPath();
    flat.forEach((place, k) => c[k ? "lineTo" : "moveTo"](...at(place)));
    c.stroke();
    c.globalAlpha = 1;
    for (const other of g.others) {
      const [x, y] = at(other.place);
      disc(c, x, y, Math.max(2, other.radius_m / reach), colour("--day"), colour("--night"));
      label(c, other.name, x + 6, y + 14, quiet, width);
    }
    const [x0, y0] = at([0, 0]), radius = Math.max(4, g.radius_m / reach), [x, y] = at(g.camera);
    disc(c, x0, y0, radius, colour("--day"), colour("--night"));
    // Line of sight, and the phase angle at the body.
    c.setLineDash([3, 3]);
    c.strokeStyle = quiet;
    c.beginPath();
    c.moveTo(x, y);
    c.lineTo(x0, y0);
    c.lineTo(Math.min(x0 + radius + 60, width - 34), y0);
    c.stroke();
    c.setLineDash([]);
    c.beginPath();
    c.arc(x0, y0, radius + 9, -Math.atan2(g.camera[1], g.camera[0]), 0);
    c.stroke();
    // The field of view about the boresight; shorter where it leaves the plane.
    const angle = Math.atan2(-g.boresight[1], g.boresight[0]), long = Math.hypot(...g.boresight);
    const half = g.fov_deg * Math.PI / 360, far = Math.max(30, Math.min(Math.hypot(x - x0, y - y0), 0.6 * width));
    c.fillStyle = c.strokeStyle = colour("--accent");
    c.globalAlpha = 0.16;
    c.beginPath();
    c.moveTo(x, y);
    for (const side of [-half, half]) {
      c.lineTo(x + far * long * Math.cos(angle + side), y + far * long * Math.sin(angle + side));
    }
    c.fill();
    c.globalAlpha = 1;
    if (long > 0.05) arrow(c, [x, y], [x + 26 * long * Math.cos(angle), y + 26 * long * Math.sin(angle)]);
    c.beginPath();
    c.arc(x, y, 3.5, 0, 2 * Math.PI);
    c.fill();
    label(c, "camera", x + 8, y - 7, ink, width);
    label(c, g.body, x0 - 8, y0 + radius + 14, ink, width);
  }
}

function disc(c, x, y, radius, day, night) {
  c.fillStyle = night;
  c.beginPath();
  c.arc(x, y, radius, 0, 2 * Math.PI);
  c.fill();
  c.fillStyle = day;
  c.beginPath();
  c.arc(x, y, radius, -Math.PI / 2, Math.PI / 2);
  c.fill();
}

function arrow(c, from, to) {
  const angle = Math.atan2(to[1] - from[1], to[0] - from[0]);
  c.beginPath();
  c.moveTo(...from);
  c.lineTo(...to);
  c.stroke();
  c.beginPath();
  c.moveTo(...to);
  for (const side of [-0.45, 0.45]) c.lineTo(to[0] - 6 * Math.cos(angle + side), to[1] - 6 * Math.sin(angle + side));
  c.fill();
}

function label(c, text, x, y, colour, width) {
  c.fillStyle = colour;
  const size = c.measureText(text).width;
  c.fillText(text, Math.max(2, Math.min(x, width - size - 36)), y);
}
