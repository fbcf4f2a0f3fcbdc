// The 3D view of a diagnosis: what was observed, what the twin says, what is missing, drawn back to front.

// Draws one recording at one stored frame into `box`. `twin` is "baseline" or "extended", `show` the ticked boxes, `mark` the highlighted place.
function drawScene(context, { camera, box, recording, frame, twin, show, mark, ground, colours, caption }) {
  const reach = show.follow ? recording.reach : recording.radius;
  camera.aim(show.follow ? recording.path[frame] : recording.centre, reach, box);
  context.save();
  context.beginPath();
  context.rect(box.x, box.y, box.width, box.height);
  context.clip();
  if (show.ground && ground) drawGround(context, camera, recording, ground, colours);
  for (const item of sceneItems({ camera, recording, frame, twin, show, mark, colours }).sort((a, b) => a.depth - b.depth)) item.draw(context);
  drawScaleBar(context, camera, box, colours);
  drawAxes(context, camera, box, colours);
  context.fillStyle = colours.quiet;
  context.font = "13px system-ui, sans-serif";
  context.textAlign = "left";
  context.fillText(caption, box.x + 12, box.y + 22);
  context.restore();
}

function sceneItems({ camera, recording, frame, twin, show, mark, colours }) {
  const { observed, force, controllers } = recording.arrays;
  const predicted = recording.arrays[twin];
  const stops = colours.scale.map(channels);
  const items = [];
  const centres = [];
  for (let i = 0; i < observed.count; i++) {
    const seen = observed.at(frame, i);
    const said = predicted && predicted.at(frame, i);
    const a = seen && camera.project(seen);
    const b = said && camera.project(said);
    const colour = a && b && recording.residual ? mixed(stops, length(minus(said, seen)) / recording.residual) : null;
    if (colour && show.residual) items.push({ depth: (a[2] + b[2]) / 2, draw: (c) => line(c, [a, b], colour, 1.5) });
    if (a && show.observed) items.push({ depth: a[2], draw: (c) => disc(c, a, 2, colours.observed) });
    if (b && show.predicted) items.push({ depth: b[2], draw: (c) => (colour ? disc(c, b, 3, colour) : ring(c, b, 2.5, colours.observed, 1)) });
    const start = said || seen;
    const pull = show.force && force && recording.force && force.at(frame, i);
    if (pull && start && length(pull) > 0.08 * recording.force) {
      const to = camera.project(along(start, (0.4 * recording.reach) / recording.force, pull));
      items.push({ depth: to[2], draw: (c) => arrow(c, camera.project(start), to, colours.force) });
    }
    if (show.patch && mark && mark.points.has(recording.points[i]) && (seen || said)) {
      centres.push(seen || said);
      const at = a || b;
      items.push({ depth: at[2] + 1e-6, draw: (c) => ring(c, at, 5.5, colours.ring, 1.4) });
    }
  }
  if (show.patch && mark && mark.radius) {
    const middle = centres.length ? centres.reduce((sum, p) => along(sum, 1 / centres.length, p), [0, 0, 0]) : mark.centroid;
    if (middle) {
      const at = camera.project(middle);
      items.push({ depth: Infinity, draw: (c) => ring(c, at, Math.max(7, camera.pixels * mark.radius), colours.ring, 1.2, [5, 4]) });
    }
  }
  for (let i = 0; show.controllers && controllers && i < controllers.count; i++) {
    const hand = controllers.at(frame, i);
    const at = hand && camera.project(hand);
    if (at) items.push({ depth: at[2], draw: (c) => square(c, at, 3, colours.hand) });
  }
  return items;
}
