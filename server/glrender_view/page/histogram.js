// The histogram of the frame, counts in logarithms, with the white point on it to be moved.

export class Histogram {
  constructor(canvas, picture, onWhite) {
    Object.assign(this, {canvas, picture, onWhite});
    const move = event => {
      const box = canvas.getBoundingClientRect();
      this.set((event.clientX - box.left) / box.width);
    };
    canvas.addEventListener("pointerdown", event => { canvas.setPointerCapture(event.pointerId); move(event); });
    canvas.addEventListener("pointermove", event => { if (event.buttons) move(event); });
    canvas.addEventListener("keydown", event => {
      const step = {ArrowLeft: 0.98, ArrowRight: 1 / 0.98, PageDown: 0.8, PageUp: 1.25}[event.key];
      if (!step || !picture.head) return;
      event.preventDefault();
      onWhite(picture.white * step);
    });
    new ResizeObserver(() => this.draw()).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  // The axis ends a little beyond the brightest pixel.
  get most() { return 1.04 * this.picture.top_value; }

  set(share) {
    if (!this.picture.head || !(this.most > 0)) return;
    this.onWhite(Math.max(share, 1e-3) * this.most);
  }

  draw() {
    const {canvas, picture} = this, ratio = window.devicePixelRatio || 1, box = canvas.getBoundingClientRect();
    canvas.width = Math.max(1, Math.round(box.width * ratio));
    canvas.height = Math.max(1, Math.round(box.height * ratio));
    const context = canvas.getContext("2d"), style = getComputedStyle(document.documentElement);
    const colour = name => style.getPropertyValue(name).trim();
    context.scale(ratio, ratio);
    const width = box.width, base = box.height - 1;
    context.fillStyle = colour("--line");
    context.fillRect(0, base, width, 1);
    if (!picture.head || !(this.most > 0)) return;
    const bins = picture.bins, tallest = Math.log1p(Math.max(...bins)), step = width / 1.04 / bins.length;
    context.fillStyle = colour("--bars");
    for (let k = 0; k < bins.length; k++) {
      if (!bins[k]) continue;
      const height = Math.max(1, (base - 4) * Math.log1p(bins[k]) / tallest);
      context.fillRect(k * step, base - height, Math.max(step, 1), height);
    }
    const at = Math.min(width - 1.5, width * picture.white / this.most);
    context.fillStyle = colour("--accent");
    context.fillRect(at - 0.75, 0, 1.5, base);
    context.beginPath();
    context.moveTo(at - 5, 0);
    context.lineTo(at + 5, 0);
    context.lineTo(at, 7);
    context.fill();
    canvas.setAttribute("aria-valuenow", String(Math.round(100 * picture.white / this.most)));
  }
}
