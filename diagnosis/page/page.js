// Ties the view, the curve, the slider and the tables together.

function colours() {
  const style = getComputedStyle(document.documentElement);
  const get = (name) => style.getPropertyValue(`--${name}`).trim();
  const names = ["ink", "quiet", "line", "grid", "observed", "force", "hand", "ring", "window", "baseline", "extended", "floor"];
  return { ...Object.fromEntries(names.map((name) => [name, get(name)])), scale: [0, 1, 2].map((k) => get(`scale-${k}`)) };
}

const mm = (metres) => (metres === null || metres === undefined ? "not measured" : `${(1000 * metres).toFixed(metres < 0.01 ? 2 : 1)} mm`);
const ROLES = { case: "the case", transfer: "transfer", fitted_on: "fitted on", against: "compared with" };

class Page {
  constructor(diagnosis, scene) {
    const evidence = diagnosis.evidence || {};
    this.diagnosis = diagnosis;
    this.scene = scene;
    this.clusters = evidence.clusters || [];
    this.curves = evidence.curves || {};
    this.records = (evidence.recordings || []).map((record, index) => ({ ...record, view: scene.recordings[index] }));
    this.records = this.records.filter((record) => record.view || this.curves[record.name]);
    this.camera = new Camera(scene.up || [0, 0, 1]);
    this.mark = this.marked(diagnosis.where);
    this.twin = "baseline";
  }

  start() {
    if (!this.records.length) {
      element("no-view").hidden = false;
      element("viewer").hidden = true;
      document.querySelectorAll("[data-cluster]").forEach((button) => button.remove());
      return;
    }
    this.records.forEach((record, index) => {
      element("recording").append(new Option(`${record.name} (${ROLES[record.role] || record.role})`, index));
    });
    const first = Math.max(0, this.records.findIndex((record) => record.role === "case"));
    this.listen();
    this.choose(first);
    element("compare-line").hidden = !this.records.some((record) => record.view && record.view.arrays.extended);
  }

  marked(place) {
    return place && { points: new Set(place.points || []), centroid: place.centroid, radius: place.radius };
  }

  // A recording is unpacked when it is first looked at.
  choose(index) {
    this.player.stop();
    const record = this.records[index];
    if (record.view && !record.unpacked) {
      const arrays = Object.fromEntries(Object.entries(record.view.arrays).map(([name, packed]) => [name, unpack(packed)]));
      record.unpacked = { ...record.view, arrays };
    }
    this.record = record;
    this.curve = this.curves[record.name] || {};
    const lengths = [record.frames, (this.curve.baseline || []).length, record.view ? record.view.frames[record.view.frames.length - 1] + 1 : 0];
    this.frames = Math.max(1, ...lengths.map((n) => n || 0));
    this.window = record.role === "case" && this.diagnosis.when ? this.diagnosis.when.frames : null;
    element("recording").value = index;
    element("frame").max = this.frames - 1;
    this.offer();
    this.seek(this.interesting());
  }

  // What this recording has can be switched on, the rest cannot.
  offer() {
    const has = (name) => Boolean(this.record.view && this.record.view.arrays[name]);
    const form = element("panel");
    for (const radio of form.elements.twin) radio.disabled = radio.value !== "baseline" && !has("extended");
    if (!has("extended")) this.twin = "baseline";
    form.elements.twin.value = this.twin;
    for (const name of ["force", "controllers"]) form.elements[name].disabled = !has(name);
    for (const name of ["predicted", "residual"]) form.elements[name].disabled = !has("baseline") && !has("extended");
    form.elements.ground.disabled = !this.scene.ground;
    form.elements.patch.disabled = this.record.role !== "case" || !this.mark;
    const view = this.record.view || {};
    element("residual-key").hidden = !view.residual;
    element("residual-end").textContent = view.residual ? `${mm(view.residual)} off` : "";
    element("force-key").hidden = !view.force;
    element("force-key").textContent = view.force ? `largest arrows: about ${+view.force.toPrecision(2)} m/s²` : "";
    element("thinned").hidden = !view.points || view.points.length === view.of;
    element("thinned").textContent = view.points ? `${view.points.length} of ${view.of} points are drawn` : "";
  }

  // The frame to open with: where the twin is worst, in the window of onset if there is one.
  interesting() {
    const [first, last] = this.window || [0, this.frames];
    let best = Math.min(Math.max(0, first), this.frames - 1);
    const errors = this.curve.baseline || [];
    for (let t = best; t < Math.min(last, errors.length); t++) if ((errors[t] || 0) > (errors[best] || 0)) best = t;
    return best;
  }

  seek(frame) {
    this.frame = Math.max(0, Math.min(this.frames - 1, frame));
    element("frame").value = this.frame;
    element("now").textContent = `${this.frame} / ${this.frames - 1}`;
    this.draw();
  }

  stored() {
    const kept = this.record.view.frames;
    return kept.reduce((best, frame, k) => (Math.abs(frame - this.frame) < Math.abs(kept[best] - this.frame) ? k : best), 0);
  }

  draw() {
    const shades = colours();
    this.drawView(shades);
    const { context, width, height } = fitted(element("curve"));
    const { curve, frames, window, frame: now } = this;
    const trainEnd = this.record.role === "transfer" ? 0 : this.record.train_end; // of a transfer no frame was fitted
    const series = ["baseline", "extended"].filter((name) => curve[name]).map((name) => ({ values: curve[name], colour: shades[name] }));
    const level = curve.noise_floor;
    const floor = level === null || level === undefined ? null : { value: level, colour: shades.floor };
    drawCurve(context, { width, height, series, frames, trainEnd, window, floor, now, unit: { scale: 1000, name: "mm" }, colours: shades });
    const part = trainEnd > 0 && trainEnd < frames ? (now < trainEnd ? ", fitted" : ", held out") : "";
    const said = [["baseline", "as it was"], ["extended", "with the extension"]].filter(([name]) => curve[name]);
    const pieces = said.map(([name, words]) => [shades[name], `${words}: ${mm(curve[name][now])}`]);
    if (floor) pieces.push([shades.floor, `noise floor: ${mm(level)}`]);
    if (this.window) pieces.push([shades.scale[1], `shaded: frames ${this.window[0]} to ${this.window[1] - 1}, when it acts`]);
    element("readout").replaceChildren(`Mean track error at frame ${now}${part}. `, ...pieces.map(([colour, text]) => this.legend(colour, text)));
  }

  legend(colour, text) {
    const sign = document.createElement("b");
    sign.style.color = colour;
    sign.textContent = "■ ";
    const piece = document.createElement("span");
    const words = document.createElement("bdi");
    words.textContent = text;
    piece.append(sign, words);
    return piece;
  }

  drawView(shades) {
    const { context, width, height } = fitted(element("scene"));
    if (!this.record.view) {
      context.fillStyle = shades.quiet;
      context.font = "14px system-ui, sans-serif";
      context.textAlign = "center";
      context.fillText("no points were stored for this recording", width / 2, height / 2);
      return;
    }
    const form = element("panel").elements;
    const names = ["observed", "predicted", "residual", "force", "patch", "controllers", "ground", "follow"];
    const show = Object.fromEntries(names.map((name) => [name, form[name].checked && !form[name].disabled]));
    const twins = this.twin === "both" ? ["baseline", "extended"] : [this.twin];
    twins.forEach((twin, k) => {
      const box = { x: (k * width) / twins.length, y: 0, width: width / twins.length, height };
      const caption = this.record.view.arrays[twin] ? { baseline: "twin as it was", extended: "twin with the extension" }[twin] : "observed";
      const { camera, mark } = this;
      const frame = this.stored();
      drawScene(context, { camera, box, recording: this.record.unpacked, frame, twin, show, mark, ground: this.scene.ground, colours: shades, caption });
    });
    if (twins.length > 1) line(context, [[width / 2, 0], [width / 2, height]], shades.line, 1);
  }

  // A located cluster, shown in the case at its first frame.
  show(index) {
    const cluster = this.clusters[index];
    this.mark = this.marked(cluster);
    this.choose(Math.max(0, this.records.findIndex((record) => record.role === "case")));
    if (cluster.frames) this.seek(cluster.frames[0]);
    element("where").scrollIntoView();
    element("scene").focus({ preventScroll: true });
  }

  compare() {
    const index = this.records.findIndex((record) => record.view && record.view.arrays.extended);
    if (!(this.record.view && this.record.view.arrays.extended)) this.choose(index);
    this.twin = "both";
    this.offer();
    element("where").scrollIntoView();
    this.seek(0);
    this.player.play();
  }

  listen() {
    element("recording").addEventListener("change", (event) => this.choose(Number(event.target.value)));
    element("frame").addEventListener("input", (event) => { this.player.stop(); this.seek(Number(event.target.value)); });
    const state = () => ({ frame: this.frame, last: this.frames - 1, fps: this.record.fps });
    this.player = new Player(element("play"), state, (frame) => this.seek(frame));
    element("compare").addEventListener("click", () => this.compare());
    element("panel").addEventListener("submit", (event) => event.preventDefault());
    element("panel").addEventListener("change", (event) => {
      if (event.target.name === "twin") this.twin = event.target.value;
      this.draw();
    });
    document.querySelectorAll("[data-cluster]").forEach((button) => {
      button.addEventListener("click", () => this.show(Number(button.dataset.cluster)));
    });
    this.listenToScene(element("scene"));
    const curve = element("curve");
    const seek = (event) => { this.player.stop(); this.seek(frameAxis(curve.clientWidth, this.frames).frame(event.offsetX)); };
    curve.addEventListener("pointerdown", (event) => { curve.setPointerCapture(event.pointerId); seek(event); });
    curve.addEventListener("pointermove", (event) => { if (curve.hasPointerCapture(event.pointerId)) seek(event); });
    const sizes = new ResizeObserver(() => this.draw());
    for (const canvas of [element("scene"), curve]) sizes.observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  listenToScene(scene) {
    turnable(scene, () => this.camera, () => this.draw(), { " ": () => this.player.toggle() });
    scene.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.camera.scale(Math.exp(-event.deltaY / 500));
      this.draw();
    }, { passive: false });
  }
}

// What became of the page can be read from outside: "drawn", or the error.
window.addEventListener("error", (event) => { document.documentElement.dataset.state = `error: ${event.message}`; });
new Page(embedded("diagnosis"), embedded("scene-data")).start();
document.documentElement.dataset.state = "drawn";
