// What pages draw with: an orthographic camera that turns about the upward direction, packed arrays, marks on a canvas, a player of frames.
// Positions in metres.

const element = (id) => document.getElementById(id);
const embedded = (id) => JSON.parse(element(id).textContent);

// The canvas's context in CSS pixels, sharp on any screen.
function fitted(canvas) {
  const [width, height, ratio] = [canvas.clientWidth, canvas.clientHeight, window.devicePixelRatio || 1];
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}

const MISSING = 65535;

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const along = (a, s, b) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
const minus = (a, b) => along(a, -1, b);
const length = (a) => Math.hypot(a[0], a[1], a[2]);
const unit = (a) => { const size = length(a) || 1; return [a[0] / size, a[1] / size, a[2] / size]; };

// A packed array (T, n, 3) as a function (t, i) -> [x, y, z], or null where the value is missing.
function unpack(packed) {
  if (!packed) return null;
  const bytes = Uint8Array.from(atob(packed.data), (c) => c.charCodeAt(0));
  const codes = new DataView(bytes.buffer);
  const [frames, count] = packed.shape;
  const step = packed.high.map((high, k) => (high - packed.low[k]) / (MISSING - 1));
  const at = (t, i) => {
    const start = 6 * (t * count + i);
    if (codes.getUint16(start, true) === MISSING) return null;
    return [0, 1, 2].map((k) => packed.low[k] + step[k] * codes.getUint16(start + 2 * k, true));
  };
  return { at, frames, count };
}

class Camera {
  constructor(up) {
    this.up = unit(up);
    this.east = unit(cross(Math.abs(this.up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0], this.up));
    this.north = cross(this.up, this.east);
    this.reset();
  }

  reset() {
    this.azimuth = -0.6;
    this.elevation = 0.45;
    this.zoom = 1;
  }

  turn(dx, dy) {
    this.azimuth -= dx;
    this.elevation = Math.max(-1.5, Math.min(1.5, this.elevation + dy));
  }

  scale(factor) {
    this.zoom = Math.max(0.3, Math.min(30, this.zoom * factor));
  }

  // Looks at `centre` so that a ball of `radius` fills the box; project() gives [x, y, depth], larger depth being nearer.
  aim(centre, radius, box) {
    const [ca, sa, ce, se] = [Math.cos(this.azimuth), Math.sin(this.azimuth), Math.cos(this.elevation), Math.sin(this.elevation)];
    const forward = along([0, 0, 0], ca, this.north).map((x, k) => x - sa * this.east[k]);
    this.right = this.east.map((x, k) => ca * x + sa * this.north[k]);
    this.above = this.up.map((x, k) => ce * x + se * forward[k]);
    this.near = cross(this.right, this.above);
    this.pixels = (this.zoom * 0.5 * Math.min(box.width, 1.2 * box.height)) / radius;
    this.centre = centre;
    this.box = box;
  }

  project(point) {
    const from = minus(point, this.centre);
    const x = this.box.x + this.box.width / 2 + this.pixels * dot(from, this.right);
    return [x, this.box.y + this.box.height / 2 - this.pixels * dot(from, this.above), dot(from, this.near)];
  }
}

const SPEED = 30; // frames per second where the recording does not say

// Plays frames at their own pace, from where they are or, at the end, from the start. `state()` gives { frame, last, fps }, `seek` shows one.
class Player {
  constructor(button, state, seek) {
    Object.assign(this, { button, state, seek, timer: null });
    button.addEventListener("click", () => this.toggle());
  }

  toggle() {
    if (this.timer) this.stop();
    else this.play();
  }

  play() {
    this.stop();
    if (this.state().frame >= this.state().last) this.seek(0);
    this.label("Pause", true);
    const [{ frame: from, last, fps }, began] = [this.state(), performance.now()];
    const tick = (time) => {
      const frame = Math.min(last, from + Math.max(0, Math.floor(((time - began) / 1000) * (fps || SPEED))));
      if (frame !== this.state().frame) this.seek(frame);
      if (frame >= last) this.stop();
      else this.timer = requestAnimationFrame(tick);
    };
    this.timer = requestAnimationFrame(tick);
  }

  stop() {
    if (this.timer) cancelAnimationFrame(this.timer);
    this.timer = null;
    this.label("Play", false);
  }

  label(text, pressed) {
    this.button.textContent = text;
    this.button.setAttribute("aria-pressed", `${pressed}`);
  }
}

// A drawing that is turned by dragging and by the arrow keys; `camera()` is what it is seen with, `keys` are further keys and what they do.
function turnable(canvas, camera, changed, keys = {}) {
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (!canvas.hasPointerCapture(event.pointerId)) return;
    camera().turn(event.movementX / 150, event.movementY / 150);
    changed();
  });
  canvas.addEventListener("dblclick", () => { camera().reset(); changed(); });
  const known = {
    ArrowLeft: () => camera().turn(-0.1, 0), ArrowRight: () => camera().turn(0.1, 0),
    ArrowUp: () => camera().turn(0, -0.1), ArrowDown: () => camera().turn(0, 0.1),
    "+": () => camera().scale(1.2), "=": () => camera().scale(1.2), "-": () => camera().scale(1 / 1.2), 0: () => camera().reset(),
    ...keys,
  };
  canvas.addEventListener("keydown", (event) => {
    if (!known[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    known[event.key]();
    changed();
  });
}

// The nearest 1, 2 or 5 times a power of ten that is not above `value`.
function round(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return power * [5, 2, 1].find((n) => n * power <= value * 1.000001);
}

function mixed(stops, share) {
  const place = Math.max(0, Math.min(1, share)) * (stops.length - 1);
  const k = Math.min(Math.floor(place), stops.length - 2);
  return `rgb(${stops[k].map((c, i) => Math.round(c + (place - k) * (stops[k + 1][i] - c))).join(",")})`;
}

const channels = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16));

function drawGround(context, camera, recording, ground, colours) {
  const normal = ground.slice(0, 3);
  const height = dot(recording.centre, normal) - ground[3];
  if (Math.abs(height) > 4 * recording.radius) return;
  const side = unit(cross(normal, Math.abs(dot(normal, camera.east)) < 0.9 ? camera.east : camera.north));
  const other = cross(normal, side);
  const origin = along(recording.centre, -height, normal);
  const step = round(recording.reach / 2);
  const reach = step * Math.ceil((1.5 * recording.radius) / step);
  for (let s = -reach; s <= reach + step / 2; s += step) {
    for (const [u, v] of [[side, other], [other, side]]) {
      const middle = along(origin, s, u);
      line(context, [-reach, reach].map((x) => camera.project(along(middle, x, v))), colours.grid, 1);
    }
  }
}

function drawScaleBar(context, camera, box, colours) {
  const metres = round((0.25 * box.width) / camera.pixels);
  const [x, y] = [box.x + 12, box.y + box.height - 14];
  line(context, [[x, y], [x + metres * camera.pixels, y]], colours.quiet, 2);
  context.fillStyle = colours.quiet;
  context.font = "12px system-ui, sans-serif";
  context.textAlign = "left";
  const text = metres >= 1 ? `${metres} m` : metres >= 0.01 ? `${+(100 * metres).toPrecision(1)} cm` : `${+(1000 * metres).toPrecision(1)} mm`;
  context.fillText(text, x, y - 6);
}

function drawAxes(context, camera, box, colours) {
  const start = [box.x + box.width - 40, box.y + box.height - 40];
  [[1, 0, 0], [0, 1, 0], [0, 0, 1]].forEach((axis, k) => {
    const way = [dot(axis, camera.right), -dot(axis, camera.above)];
    line(context, [start, [start[0] + 22 * way[0], start[1] + 22 * way[1]]], colours.quiet, 1.2);
    context.fillStyle = colours.quiet;
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "center";
    context.fillText("xyz"[k], start[0] + 31 * way[0], start[1] + 31 * way[1] + 4);
  });
}

function line(context, points, colour, width, dash = []) {
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.setLineDash(dash);
  context.beginPath();
  points.forEach((p, k) => (k ? context.lineTo(p[0], p[1]) : context.moveTo(p[0], p[1])));
  context.stroke();
  context.setLineDash([]);
}

function disc(context, at, radius, colour) {
  context.fillStyle = colour;
  context.beginPath();
  context.arc(at[0], at[1], radius, 0, 2 * Math.PI);
  context.fill();
}

function ring(context, at, radius, colour, width, dash = []) {
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.setLineDash(dash);
  context.beginPath();
  context.arc(at[0], at[1], radius, 0, 2 * Math.PI);
  context.stroke();
  context.setLineDash([]);
}

function square(context, at, half, colour) {
  context.fillStyle = colour;
  context.fillRect(at[0] - half, at[1] - half, 2 * half, 2 * half);
}

function arrow(context, from, to, colour) {
  const way = Math.atan2(to[1] - from[1], to[0] - from[0]);
  const head = Math.min(6, Math.hypot(to[0] - from[0], to[1] - from[1]));
  const wing = (turn) => [to[0] - head * Math.cos(way + turn), to[1] - head * Math.sin(way + turn)];
  line(context, [from, to], colour, 1.6);
  line(context, [wing(0.5), to, wing(-0.5)], colour, 1.6);
}
