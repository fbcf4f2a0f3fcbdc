// Shows one recording at a time: pictures or points, curves and scores, all at the frame of the slider.

const SERIES = 8; // colours; further methods have them again, dashed
const FEW = 60; // points, as on a cable, are drawn larger

function made(tag, attributes = {}, ...children) {
  const found = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name in found && name !== "style") found[name] = value;
    else found.setAttribute(name, value);
  }
  found.append(...children);
  return found;
}

// A long name that may go on in the next line after each underscore.
function broken(name) {
  return name.split("_").flatMap((part, k) => (k ? ["_", made("wbr"), part] : [part]));
}

function shades(methods) {
  const style = getComputedStyle(document.documentElement);
  const get = (name) => style.getPropertyValue(`--${name}`).trim();
  const names = ["ink", "quiet", "line", "grid", "observed"];
  const series = Object.fromEntries(methods.map((method, k) => [method, get(`series-${k % SERIES}`)]));
  return { ...Object.fromEntries(names.map((name) => [name, get(name)])), series };
}

class Report {
  constructor(run) {
    this.run = run;
    this.hidden = new Set();
    this.colours = shades(run.methods);
    this.dashed = (method) => run.methods.indexOf(method) >= SERIES;
  }

  start() {
    document.querySelectorAll("table.sortable").forEach(sortable);
    if (!this.run.exhibits.length) return;
    element("viewer").hidden = false;
    const groups = new Map();
    this.run.exhibits.forEach((exhibit, index) => {
      if (!groups.has(exhibit.collection)) groups.set(exhibit.collection, made("optgroup", { label: exhibit.collection }));
      groups.get(exhibit.collection).append(new Option(this.title(exhibit), index));
    });
    element("exhibit").append(...groups.values());
    this.listen();
    const wanted = this.run.exhibits.findIndex((_, index) => `#recording-${index}` === location.hash);
    this.choose(Math.max(0, wanted));
  }

  title({ name, sources, transfer }) {
    return transfer ? `${name}, by twins of ${this.several(sources)}` : name;
  }

  several(names) {
    return names.length > 3 ? `${names.length} recordings` : names.join(" + ");
  }

  choose(index) {
    this.player.stop();
    const exhibit = this.run.exhibits[index];
    this.index = index;
    this.exhibit = exhibit;
    element("exhibit").value = index;
    element("previous").disabled = index === 0;
    element("next").disabled = index === this.run.exhibits.length - 1;
    element("frame").max = exhibit.frames - 1;
    element("about").textContent = this.about();
    element("outline-line").hidden = !exhibit.pictures;
    const drawn = exhibit.pictures ? "" : "Grey: recorded, coloured: the twin's surface, squares: hands or driven markers. Drag or use the arrow keys to turn the drawings, plus and minus to zoom. ";
    const thinned = exhibit.kept.length < exhibit.frames ? `Of ${exhibit.frames} frames ${exhibit.kept.length} are here; the nearest is shown.` : "";
    element("hint").textContent = drawn + thinned;
    this.offer();
    this.furnish();
    this.seek(exhibit.train_end && exhibit.train_end < exhibit.frames ? exhibit.train_end : exhibit.frames - 1);
  }

  about() {
    const { sources, transfer, seed, frames, train_end: end, no_pictures: why } = this.exhibit;
    const fitted = transfer ? `Fitted on ${this.several(sources)} and placed in frame 0 of this recording; no other frame of it was fitted.`
      : `Fitted on frames 0 to ${end - 1}${end < frames ? `; frames ${end} to ${frames - 1} were never seen` : ""}.`;
    return `${fitted} Seed ${seed}.${why ? ` Drawn as points: ${why}.` : ""}`;
  }

  // One switch for each method.
  offer() {
    const legend = element("methods-shown").querySelector("legend");
    const switches = this.exhibit.methods.map((method) => {
      const box = made("input", { type: "checkbox", checked: !this.hidden.has(method) });
      box.addEventListener("change", () => {
        this.hidden[box.checked ? "delete" : "add"](method);
        this.furnish();
        this.draw();
      });
      return made("label", {}, box, this.sign(method), method);
    });
    element("methods-shown").replaceChildren(legend, ...switches);
  }

  sign(method) {
    const found = made("span", { className: `sign${this.dashed(method) ? " dashed" : ""}` });
    found.style.color = this.colours.series[method];
    return found;
  }

  get visible() {
    return this.exhibit.methods.filter((method) => !this.hidden.has(method));
  }

  furnish() {
    const { exhibit } = this;
    if (exhibit.points && !exhibit.unpacked) {
      const { recorded, hands, methods } = exhibit.points;
      const twins = Object.fromEntries(Object.entries(methods).map(([name, one]) => [name, unpack(one)]));
      exhibit.unpacked = { recorded: unpack(recorded), hands: unpack(hands), twins };
      exhibit.camera = new Camera(exhibit.points.up);
    }
    this.panels = ["", ...this.visible].map((method) => this.panel(method));
    element("panels").replaceChildren(...this.panels.map(({ figure }) => figure));
    const names = Object.keys(exhibit.curves).filter((metric) => Object.keys(exhibit.curves[metric]).length);
    this.plots = names.map((metric) => this.plot(metric));
    element("curves").replaceChildren(...this.plots.map(({ figure }) => figure));
    element("scores").replaceChildren(this.scores());
    this.sizes.disconnect();
    for (const { canvas } of [...this.panels, ...this.plots]) if (canvas) this.sizes.observe(canvas);
  }

  // What was recorded (no method), or one method's twin.
  panel(method) {
    const { pictures, points } = this.exhibit;
    const box = made("div", { className: `picture${points ? " drawn" : ""}` });
    box.style.aspectRatio = pictures ? `${pictures.width} / ${pictures.height}` : "4 / 3";
    const words = made("p", { hidden: true });
    const caption = made("figcaption", {}, made("b", {}, method || "recorded"));
    const found = { method, box, words };
    if (pictures) {
      found.image = made("img", { className: pictures.width < 200 ? "coarse" : "", alt: "" });
      box.append(found.image);
      box.insertAdjacentHTML("beforeend", "<svg aria-hidden='true'><path></path></svg>");
      box.lastChild.setAttribute("viewBox", `0 0 ${pictures.width} ${pictures.height}`);
      found.path = box.lastChild.firstChild;
    } else {
      found.canvas = made("canvas", { tabIndex: 0, role: "img" });
      box.append(found.canvas);
      const { camera } = this.exhibit; // all drawings of a recording turn together
      turnable(found.canvas, () => camera, () => this.draw());
    }
    box.append(words);
    found.figure = made("figure", {}, box, caption);
    if (method) found.figure.style.borderTopColor = this.colours.series[method];
    return found;
  }

  plot(metric) {
    const canvas = made("canvas", { role: "img", "aria-label": `${metric} of each method by frame; the values are below` });
    const caption = made("figcaption", { "aria-live": "off" });
    const found = { metric, canvas, caption, unit: this.unit(metric) };
    found.figure = made("figure", {}, made("h3", {}, this.heading(metric)), canvas, caption);
    const frame = (event) => frameAxis(canvas.clientWidth, this.exhibit.frames).frame(event.offsetX);
    canvas.addEventListener("pointerdown", (event) => { this.player.stop(); canvas.setPointerCapture(event.pointerId); this.seek(frame(event)); });
    canvas.addEventListener("pointermove", (event) => {
      if (canvas.hasPointerCapture(event.pointerId)) this.seek(frame(event));
      else { this.hovered = frame(event); this.drawCurves(); }
    });
    canvas.addEventListener("pointerleave", () => { this.hovered = null; this.drawCurves(); });
    return found;
  }

  // Lengths are shown in millimetres, everything else as it is.
  unit(metric) {
    const name = this.run.units[metric];
    return name === "m" ? { scale: 1000, name: "mm", digits: 2 } : { scale: 1, name, digits: 3 };
  }

  heading(metric) {
    const { name } = this.unit(metric);
    return name ? `${metric} [${name}]` : metric;
  }

  said(value, { scale, digits }) {
    return value === null || value === undefined ? "-" : (scale * value).toFixed(digits);
  }

  scores() {
    const rows = this.exhibit.rows.filter((row) => !this.hidden.has(row.method));
    const metrics = this.run.shown.filter((metric) => rows.some((row) => row.values[metric] !== null && metric in row.values));
    const ended = (row) => (row.status === "ok" ? row.note : this.ended(row)) || "";
    const why = rows.some(ended); // a column only where there is something to say
    const heads = ["method", "task", ...metrics.map((metric) => this.heading(metric)), "frames", ...(why ? [""] : [])];
    const lines = rows.map((row) => {
      const values = metrics.map((metric) => {
        const title = row.missing[metric] || "";
        return made("td", title && row.values[metric] === null ? { title } : {}, this.said(row.values[metric], this.unit(metric)));
      });
      const names = [made("th", { scope: "row" }, row.method), made("td", { className: "text" }, row.task)];
      const last = why ? [made("td", { className: "text why" }, ended(row))] : [];
      return made("tr", {}, ...names, ...values, made("td", {}, `${row.frames || ""}`), ...last);
    });
    const head = made("thead", {}, made("tr", {}, ...heads.map((name) => made("th", { scope: "col" }, ...broken(name)))));
    const table = made("table", { className: "scores" }, head, made("tbody", {}, ...lines));
    return made("div", { className: "scroll", tabIndex: 0, role: "region", "aria-label": "Scores of these roll-outs" }, table);
  }

  ended({ status, reason, diverged_frame: frame }) {
    return `${status}${status === "diverged" ? ` at frame ${frame}` : ""}: ${reason}`;
  }

  seek(frame) {
    this.frame = Math.max(0, Math.min(this.exhibit.frames - 1, frame));
    this.draw();
  }

  // The place of the kept frame that is nearest.
  get stored() {
    const { kept } = this.exhibit;
    return kept.reduce((best, frame, k) => (Math.abs(frame - this.frame) < Math.abs(kept[best] - this.frame) ? k : best), 0);
  }

  draw() {
    const { frames, train_end: end, transfer } = this.exhibit;
    const part = transfer ? "never fitted" : this.frame < end ? "fitted" : "held out";
    element("frame").value = this.frame;
    element("frame").setAttribute("aria-valuetext", `frame ${this.frame} of ${frames - 1}, ${part}`);
    element("now").textContent = `${this.frame} / ${frames - 1}, ${part}`;
    this.panels.forEach((panel) => (panel.canvas ? this.drawPoints(panel) : this.drawPicture(panel)));
    this.drawCurves();
  }

  drawPicture({ method, image, path, words }) {
    const { pictures, name, kept, reasons } = this.exhibit;
    const k = this.stored;
    const source = (method ? pictures.methods[method] || [] : pictures.recorded)[k];
    image.hidden = !source;
    if (source) image.src = source;
    image.alt = `${name}, frame ${kept[k]}, ${method ? `as the twin of ${method} looks` : "as recorded"}`;
    path.setAttribute("d", element("outline").checked && source ? pictures.outlines[k] : "");
    words.hidden = Boolean(source);
    words.textContent = source ? "" : reasons[method] || "no picture of this frame";
  }

  drawPoints({ method, canvas, words }) {
    const { points, unpacked, camera, name, kept, reasons } = this.exhibit;
    const k = this.stored;
    const twin = method && unpacked.twins[method];
    const shown = !method || Boolean(twin && [...Array(twin.count).keys()].some((i) => twin.at(k, i)));
    words.hidden = shown;
    words.textContent = shown ? "" : reasons[method] || "it has left the scene";
    canvas.setAttribute("aria-label", `${name}, frame ${kept[k]}: recorded points${method ? ` and the twin of ${method}` : ""}. Arrow keys turn the view.`);
    const { context, width, height } = fitted(canvas);
    camera.aim(points.centre, points.radius, { x: 0, y: 0, width, height });
    const items = [];
    const add = (cloud, mark) => {
      for (let i = 0; i < cloud.count; i++) {
        const at = cloud.at(k, i) && camera.project(cloud.at(k, i));
        if (at) items.push({ depth: at[2], draw: () => mark(at) });
      }
    };
    const size = unpacked.recorded.count < FEW ? 1.6 : 1;
    add(unpacked.recorded, (at) => disc(context, at, 2.3 * size, this.colours.observed));
    if (twin) add(twin, (at) => disc(context, at, 1.6 * size, this.colours.series[method]));
    add(unpacked.hands, (at) => square(context, at, 1.2, this.colours.ink));
    items.sort((a, b) => a.depth - b.depth).forEach(({ draw }) => draw());
    drawScaleBar(context, camera, { x: 0, y: 0, width, height }, this.colours);
  }

  drawCurves() {
    const now = this.hovered ?? this.frame;
    const { frames, train_end: trainEnd } = this.exhibit;
    for (const { metric, canvas, caption, unit } of this.plots) {
      const curves = this.exhibit.curves[metric];
      const methods = this.visible.filter((method) => curves[method]);
      const series = methods.map((method) => ({ values: curves[method], colour: this.colours.series[method], dash: this.dashed(method) ? [5, 4] : [] }));
      const { context, width, height } = fitted(canvas);
      drawCurve(context, { width, height, series, frames, trainEnd, now, unit, colours: this.colours });
      const values = methods.map((method) => made("span", {}, this.sign(method), `${method}: ${this.said(curves[method][now], unit)}`));
      caption.replaceChildren(`frame ${now} `, ...values);
    }
  }

  listen() {
    this.sizes = new ResizeObserver(() => this.draw());
    element("exhibit").addEventListener("change", (event) => this.choose(Number(event.target.value)));
    element("previous").addEventListener("click", () => this.choose(this.index - 1));
    element("next").addEventListener("click", () => this.choose(this.index + 1));
    element("frame").addEventListener("input", (event) => { this.player.stop(); this.seek(Number(event.target.value)); });
    const state = () => ({ frame: this.frame, last: this.exhibit.frames - 1, fps: this.exhibit.fps });
    this.player = new Player(element("play"), state, (frame) => this.seek(frame));
    element("outline").addEventListener("change", () => this.draw());
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      this.colours = shades(this.run.methods);
      this.offer();
      this.furnish();
      this.draw();
    });
  }
}

// What became of the page can be read from outside: "drawn", or the error.
window.addEventListener("error", (event) => { document.documentElement.dataset.state = `error: ${event.message}`; });
new Report(embedded("run")).start();
document.documentElement.dataset.state = "drawn";
