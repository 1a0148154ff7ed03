// The frame on its canvas: stretch, zoom and pan; and the counts of its histogram.

const LEVELS = 4096, BINS = 256, AUTO_SHARE = 0.999;
const CURVES = {
  linear: x => x,
  log: x => Math.log1p(1000 * x) / Math.log1p(1000),
  asinh: x => Math.asinh(50 * x) / Math.asinh(50),
};
// What is saturated stands out in a colour that no grey has.
const SATURATED = 0xff2f6bff;

export class Picture {
  constructor(canvas) {
    this.canvas = canvas;
    this.store = document.createElement("canvas");
    this.stretch = "linear";
    this.isAuto = true;
    this.white = 1;
    this.isFitted = true;
    this.scale = 1;
    this.left = this.top = 0;
    this.table = new Uint32Array(LEVELS + 1);
    this.marked = null;
    this.onView = () => {};
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.resize();
  }

  resize() {
    const ratio = window.devicePixelRatio || 1, box = this.canvas.getBoundingClientRect();
    this.ratio = ratio;
    this.canvas.width = Math.max(1, Math.round(box.width * ratio));
    this.canvas.height = Math.max(1, Math.round(box.height * ratio));
    this.draw();
  }

  /** Take a frame: `head` as the view told it, `values` row by row. */
  show(head, values) {
    const isOther = !this.head || head.width !== this.head.width || head.height !== this.head.height;
    this.head = head;
    this.values = values;
    const detector = head.unit === "DN" ? head.camera.detector : null;
    this.black = detector ? detector.offset_DN : 0;
    this.full = detector ? saturation(detector) : Infinity;
    this.count();
    if (this.isAuto) this.white = this.autoWhite();
    if (isOther) {
      this.store.width = head.width;
      this.store.height = head.height;
      this.image = this.store.getContext("2d").createImageData(head.width, head.height);
      this.words = new Uint32Array(this.image.data.buffer);
    }
    this.paint();
  }

  /** Largest value, and counts of the values above black in equal bins up to it. */
  count() {
    const {values, black} = this;
    let most = -Infinity, least = Infinity;
    for (let k = 0; k < values.length; k++) {
      const value = values[k];
      if (value > most) most = value;
      if (value < least) least = value;
    }
    this.most = most;
    this.least = least;
    this.top_value = Math.max(most - black, 0);
    const bins = this.bins = new Float64Array(BINS), scale = this.top_value > 0 ? BINS / this.top_value : 0;
    this.n_lit = 0;
    for (let k = 0; k < values.length; k++) {
      const above = values[k] - black;
      if (above > 0) {
        bins[Math.min(BINS - 1, (above * scale) | 0)]++;
        this.n_lit++;
      }
    }
  }

  /** The value below which 99.9 % of the lit pixels are. */
  autoWhite() {
    if (!this.n_lit) return this.white || 1;
    let sum = 0;
    for (let k = 0; k < BINS; k++) {
      sum += this.bins[k];
      if (sum >= AUTO_SHARE * this.n_lit) return this.top_value * (k + 1) / BINS;
    }
    return this.top_value;
  }

  setStretch(name) { this.stretch = name; this.paint(); }

  setWhite(white, isAuto = false) {
    this.isAuto = isAuto;
    this.white = isAuto ? this.autoWhite() : white;
    this.paint();
  }

  paint() {
    if (!this.head) return;
    const {values, black, words, table, full} = this, curve = CURVES[this.stretch];
    for (let k = 0; k <= LEVELS; k++) {
      const grey = Math.round(255 * Math.min(1, curve(k / LEVELS)));
      table[k] = 0xff000000 | (grey << 16) | (grey << 8) | grey;
    }
    const scale = LEVELS / this.white;
    for (let k = 0; k < values.length; k++) {
      const value = values[k];
      if (value >= full) { words[k] = SATURATED; continue; }
      const level = (value - black) * scale;
      words[k] = table[level > 0 ? (level < LEVELS ? level | 0 : LEVELS) : 0];
    }
    this.store.getContext("2d").putImageData(this.image, 0, 0);
    this.draw();
  }

  /** Canvas pixels of one pixel of the image, where it is fitted. */
  fitScale() { return Math.min(this.canvas.width / this.head.width, this.canvas.height / this.head.height); }

  draw() {
    const context = this.canvas.getContext("2d");
    context.fillStyle = "#05070a";
    context.fillRect(0, 0, this.canvas.width, this.canvas.height);
    if (!this.head) return;
    const {width, height} = this.head;
    if (this.isFitted) this.scale = this.fitScale();
    const w = width * this.scale, h = height * this.scale;
    // The image stays in sight.
    const held = (at, size, room) => size <= room ? (room - size) / 2 : Math.min(0, Math.max(room - size, at));
    this.left = held(this.left, w, this.canvas.width);
    this.top = held(this.top, h, this.canvas.height);
    context.imageSmoothingEnabled = this.scale < 1;
    context.imageSmoothingQuality = "high";
    context.drawImage(this.store, this.left, this.top, w, h);
    if (this.marked) {
      const [x, y] = [this.marked.x - this.head.origin[0], this.marked.y - this.head.origin[1]];
      const size = Math.max(this.scale, 5 * this.ratio);
      context.strokeStyle = "#5cc8ff";
      context.lineWidth = Math.max(1, this.ratio);
      context.strokeRect(this.left + (x + 0.5) * this.scale - size / 2, this.top + (y + 0.5) * this.scale - size / 2,
                         size, size);
    }
    this.onView();
  }

  zoomBy(factor, x = this.canvas.width / 2, y = this.canvas.height / 2) {
    if (!this.head) return;
    const least = Math.min(1, this.fitScale()), scale = Math.min(64 * this.ratio, Math.max(least, this.scale * factor));
    this.left = x - (x - this.left) * scale / this.scale;
    this.top = y - (y - this.top) * scale / this.scale;
    this.scale = scale;
    this.isFitted = Math.abs(scale - this.fitScale()) < 1e-6 * scale;
    this.draw();
  }

  fit() { this.isFitted = true; this.draw(); }

  panBy(dx, dy) { this.left += dx * this.ratio; this.top += dy * this.ratio; this.draw(); }

  /** The camera's pixel below a point of the page [CSS px], or null beside the image. */
  pixelAt(event) {
    if (!this.head) return null;
    const box = this.canvas.getBoundingClientRect();
    const x = Math.floor(((event.clientX - box.left) * this.ratio - this.left) / this.scale);
    const y = Math.floor(((event.clientY - box.top) * this.ratio - this.top) / this.scale);
    if (x < 0 || y < 0 || x >= this.head.width || y >= this.head.height) return null;
    return {x: x + this.head.origin[0], y: y + this.head.origin[1]};
  }

  /** The frame's own value there; undefined beside it. */
  valueAt({x, y}) {
    const column = x - this.head.origin[0], row = y - this.head.origin[1];
    if (column < 0 || row < 0 || column >= this.head.width || row >= this.head.height) return undefined;
    return this.values[row * this.head.width + column];
  }
}

/** Digital number from which a pixel may be saturated: the wells are full, less the noise of reading them. */
function saturation(detector) {
  const well = detector.full_well_electrons - 4 * detector.read_noise_electrons;
  return Math.min(2 ** detector.bit_depth - 1, detector.offset_DN + well * detector.gain_DN_per_electron);
}
