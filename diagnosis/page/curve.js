// Errors by frame, with the end of the fitted frames and the frame that is shown.

const MARGIN = { left: 52, right: 14, top: 26, bottom: 30 };

const finite = (values) => (values || []).filter((v) => v !== null && v !== undefined);

// Where the curve has its frames: x of a frame, and the frame at an x.
function frameAxis(width, frames) {
  const step = (width - MARGIN.left - MARGIN.right) / Math.max(1, frames - 1);
  return {
    x: (frame) => MARGIN.left + step * frame,
    frame: (x) => Math.max(0, Math.min(frames - 1, Math.round((x - MARGIN.left) / step))),
  };
}

// `series` are {values, colour, dash}, by frame, null where there is none; `unit` is {scale, name}: what values are multiplied by, and what it is called then.
// Optional: `window` [first, last) is shaded, `floor` {value, colour} is a level, frames from `trainEnd` on were not fitted.
function drawCurve(context, { width, height, series, frames, trainEnd, window, floor, now, unit, colours }) {
  context.clearRect(0, 0, width, height);
  context.font = "12px system-ui, sans-serif";
  const axis = frameAxis(width, frames);
  const bottom = height - MARGIN.bottom;
  const label = (text, x, y, align, colour = colours.quiet) => {
    context.fillStyle = colour;
    context.textAlign = align;
    context.fillText(text, x, y);
  };
  const all = [...series.flatMap(({ values }) => finite(values)), ...finite([floor && floor.value])];
  if (!all.length) {
    label("no error was measured on this recording", width / 2, height / 2, "center");
    return;
  }
  // A roll-out that blows up would flatten all the rest: it is cut at ten times what nine tenths of the frames stay below.
  const sorted = all.slice().sort((a, b) => a - b);
  const top = 1.08 * Math.min(sorted[sorted.length - 1], 10 * sorted[Math.floor(0.9 * (sorted.length - 1))]) || 1 / unit.scale;
  const y = (value) => bottom - ((bottom - MARGIN.top) * Math.min(value, 1.2 * top)) / top;

  if (window) {
    const [left, right] = [axis.x(window[0]), axis.x(Math.min(window[1], frames) - 1)];
    context.fillStyle = colours.window;
    context.fillRect(left - 1, MARGIN.top, Math.max(3, right - left + 2), bottom - MARGIN.top);
  }
  const step = round((unit.scale * top) / 3);
  for (let tick = 0; tick <= unit.scale * top; tick += step) {
    line(context, [[MARGIN.left, y(tick / unit.scale)], [width - MARGIN.right, y(tick / unit.scale)]], colours.line, 1);
    label(`${+tick.toPrecision(3)}`, MARGIN.left - 8, y(tick / unit.scale) + 4, "right");
  }
  label(unit.name, MARGIN.left - 8, MARGIN.top - 10, "right");
  const every = Math.max(1, round(frames / Math.max(3, width / 110)));
  for (let frame = 0; frame < frames; frame += every) label(`${frame}`, axis.x(frame), bottom + 18, "center");

  if (trainEnd > 0 && trainEnd < frames) {
    const x = axis.x(trainEnd - 0.5);
    line(context, [[x, MARGIN.top - 6], [x, bottom]], colours.quiet, 1, [2, 3]);
    label("fitted", x - 6, MARGIN.top - 10, "right");
    label("held out", x + 6, MARGIN.top - 10, "left");
  }
  if (floor) line(context, [[MARGIN.left, y(floor.value)], [width - MARGIN.right, y(floor.value)]], floor.colour, 1.5, [6, 4]);
  context.save();
  context.beginPath();
  context.rect(MARGIN.left - 2, MARGIN.top, width - MARGIN.left - MARGIN.right + 4, bottom - MARGIN.top + 2);
  context.clip();
  for (const { values, colour, dash } of series) {
    let run = [];
    const flush = () => {
      if (run.length === 1) disc(context, run[0], 2, colour);
      else if (run.length) line(context, run, colour, 2, dash);
      run = [];
    };
    values.forEach((value, frame) => (value === null ? flush() : run.push([axis.x(frame), y(value)])));
    flush();
  }
  context.restore();
  line(context, [[axis.x(now), MARGIN.top], [axis.x(now), bottom]], colours.ink, 1);
  for (const { values, colour } of series) {
    const value = values[now];
    if (value !== null && value !== undefined) disc(context, [axis.x(now), y(value)], 4, colour);
  }
}
