// Particles and leg on a canvas, frame by frame; plots beside them follow.
function bytes(text) {
  const raw = atob(text);
  return Uint8Array.from(raw, (c) => c.charCodeAt(0));
}

class Player {
  constructor(place, data, follow) {
    this.data = data;
    this.follow = follow;
    this.canvas = place.querySelector("canvas");
    this.slider = place.querySelector("input");
    this.button = place.querySelector(".play");
    this.output = place.querySelector("output");
    this.place = new Uint16Array(bytes(data.positions).buffer);
    this.speed = bytes(data.speeds);
    this.frame = data.first;
    this.timer = null;
    this.slider.addEventListener("input", () => { this.stop(); this.show(Number(this.slider.value)); });
    this.button.addEventListener("click", () => (this.timer ? this.stop() : this.play()));
    new ResizeObserver(() => this.draw()).observe(this.canvas.parentElement);
    this.key(place);
    this.show(this.frame);
  }

  key(place) {
    const strip = place.querySelector(".ramp").getContext("2d");
    for (let i = 0; i < 256; i++) { strip.fillStyle = ramp(i / 255); strip.fillRect(i, 0, 1, 1); }
    place.querySelector(".low").textContent = "0";
    place.querySelector(".middle").textContent = "speed of the soil [mm/s]";
    place.querySelector(".high").textContent = `${this.data.fastest_mm_s} and more`;
  }

  play() {
    this.button.textContent = "❚❚";
    this.button.setAttribute("aria-label", "pause");
    this.timer = setInterval(() => this.show((this.frame + 1) % this.data.theta_deg.length), 90);
  }

  stop() {
    clearInterval(this.timer);
    this.timer = null;
    this.button.textContent = "▶";
    this.button.setAttribute("aria-label", "play");
  }

  show(frame) {
    this.frame = frame;
    this.slider.value = frame;
    const at = this.data.theta_deg[frame];
    this.output.textContent = `${this.data.symbol} = ${at.toFixed(this.data.unit === "°" ? 0 : 1)}${this.data.unit}`;
    this.slider.setAttribute("aria-valuetext", this.output.textContent);
    this.draw();
    this.follow(at);
  }

  draw() {
    const [width, height] = this.data.size_mm;
    const wide = this.canvas.clientWidth || 400;
    const scale = (wide * (window.devicePixelRatio || 1)) / width;
    this.canvas.width = Math.round(width * scale);
    this.canvas.height = Math.round(height * scale);
    const pen = this.canvas.getContext("2d");
    pen.fillStyle = colour("@card");
    pen.fillRect(0, 0, this.canvas.width, this.canvas.height);
    const y = (z) => (height - z) * scale;
    this.particles(pen, scale, y);
    this.room(pen, scale, y);
    this.leg(pen, scale, y);
  }

  room(pen, scale, y) {
    const { left, right, floor, surface } = this.data.bed_mm;
    pen.strokeStyle = colour("@grey");
    pen.lineWidth = 2 * (window.devicePixelRatio || 1);
    pen.beginPath();
    [[left, surface], [left, floor], [right, floor], [right, surface]].forEach(([x, z], i) =>
      pen[i ? "lineTo" : "moveTo"](x * scale, y(z)));
    pen.stroke();
  }

  particles(pen, scale, y) {
    const count = this.data.particles, [width, height] = this.data.size_mm;
    const size = Math.max(1, this.data.marker_mm * scale);
    const from = this.frame * count;
    // Fast ones last, lest slow neighbours hide them.
    const order = Array.from({ length: 64 }, () => []);
    for (let i = from; i < from + count; i++) order[this.speed[i] >> 2].push(i);
    order.forEach((members, level) => {
      pen.fillStyle = RAMP_COLOURS[level];
      for (const i of members) {
        const px = (this.place[2 * i] / 65535) * width * scale;
        const pz = y((this.place[2 * i + 1] / 65535) * height);
        pen.fillRect(px - size / 2, pz - size / 2, size, size);
      }
    });
  }

  leg(pen, scale, y) {
    pen.beginPath();
    this.data.leg_mm[this.frame].forEach(([x, z], i) => pen[i ? "lineTo" : "moveTo"](x * scale, y(z)));
    pen.closePath();
    pen.fillStyle = "#ffffff";
    pen.strokeStyle = "#000000";
    pen.lineWidth = 1.2 * (window.devicePixelRatio || 1);
    pen.fill();
    pen.stroke();
  }
}
