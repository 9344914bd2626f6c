// Steering: the embedding in use, and the ways to choose another.
import { angles, axes, blend, dot, onSphere, seen, unflat, unit, unseen } from "./sphere.js";

const TURN = .06, MOVE = .04;  // radians for one key
const REACH = .09;  // radians: a pointer is at a task's dot, or on the arc between two
const POLE = 1.45;  // radians: the globe is never seen from straight above

export function makeSteering(tasks, changed) {
  const middle = Math.floor((tasks.length - 1) / 2);
  const steering = { code: null, task: null, pair: [middle, middle], share: 1, held: null };

  steering.choose = (code) => {
    [steering.code, steering.task] = [unit(code), null];
    reveal();
    changed();
  };
  // Goes exactly to a trained task; the blend then reaches from the task before to this one.
  steering.go = (index) => {
    if (index !== steering.pair[1]) steering.pair = [steering.pair[1], index];
    else if (steering.pair[0] === index) steering.pair = [Math.max(0, index - 1), index];
    [steering.code, steering.task, steering.share] = [tasks[index].lte, tasks[index], 1];
    reveal();
    changed();
  };
  steering.mix = (share) => {
    const [one, other] = steering.pair.map((index) => tasks[index]);
    steering.share = share;
    steering.code = share === 0 ? one.lte : share === 1 ? other.lte : blend(one.lte, other.lte, share);
    steering.task = share === 0 ? one : share === 1 ? other : null;
    reveal();
    changed();
  };
  // Begins a drag: goes to the task whose dot is there, or else to the embedding itself.
  steering.hold = (code) => {
    const away = tasks.map((task) => angle(task.lte, code)), least = Math.min(...away);
    steering.held = least < REACH ? away.indexOf(least) : null;
    if (steering.held === null) steering.choose(code); else steering.go(steering.held);
  };
  // Goes on with it: a drag from one dot toward another keeps to the arc between them, a blend of the two tasks.
  steering.drag = (code) => {
    const { held } = steering, arcs = held === null ? [] : tasks
      .map((task, index) => ({ index, ...nearest(tasks[held].lte, task.lte, code) }))
      .filter(({ index, away }) => index !== held && away < REACH);
    if (!arcs.length) return steering.choose(code);
    const { index, share } = arcs.reduce((one, other) => other.away < one.away ? other : one);
    steering.pair = [held, index];
    steering.mix(share);
  };
  steering.turn = (east, north) => {
    const view = steering.view;
    steering.view = { east: view.east + east, north: Math.max(-POLE, Math.min(POLE, view.north + north)) };
    steering.aim = null;
    changed();
  };
  // Turns the globe on toward its aim; `seconds` since the last call.
  steering.glide = (seconds) => {
    const { view, aim } = steering;
    if (!aim) return;
    const share = 1 - Math.exp(-7 * seconds), east = Math.atan2(Math.sin(aim.east - view.east), Math.cos(aim.east - view.east));
    steering.view = { east: view.east + share * east, north: view.north + share * (aim.north - view.north) };
    if (Math.hypot(east, aim.north - view.north) < .01) steering.aim = null;
    changed();
  };
  // Aims the globe at the embedding if that is on the far side, or near the edge.
  function reveal() {
    if (seen(axes(steering.view), steering.code)[2] < .3) steering.aim = toward(steering.code);
  }
  steering.view = toward(tasks[middle].lte);
  steering.go(middle);
  return steering;
}

// The view in which an embedding is near the middle of the globe.
function toward(code) {
  const [east, north] = angles(code);
  return { east: east + .3, north: Math.max(-1.2, Math.min(1.2, .8 * north)) };
}

// Lets a pointer and keys on the globe and the flat map steer.
export function listen(globe, globeCanvas, map, steering) {
  let turning = null;
  const at = (event) => {
    const box = globeCanvas.getBoundingClientRect(), radius = globe.radius();
    return [(event.clientX - box.left - box.width / 2) / radius, -(event.clientY - box.top - box.height / 2) / radius];
  };
  function point(event, steer) {
    steering.aim = null;
    const [x, y] = at(event), far = Math.hypot(x, y), frame = axes(steering.view);
    const reached = far < 1 ? [x, y, Math.sqrt(1 - far * far)] : [x / far, y / far, 0];
    const code = unseen(frame, reached);
    steer(code);
    if (far > .97) steering.turn(.03 * reached[0], .03 * reached[1]);
    steering.aim = null;
  }
  globeCanvas.addEventListener("pointerdown", (event) => {
    globeCanvas.setPointerCapture(event.pointerId);
    const turns = event.button === 2 || event.shiftKey || Math.hypot(...at(event)) > 1.06;
    turning = turns ? [event.clientX, event.clientY] : null;
    if (!turning) point(event, steering.hold);
  });
  globeCanvas.addEventListener("pointermove", (event) => {
    if (!event.buttons) return;
    if (!turning) return point(event, steering.drag);
    const radius = globe.radius();
    steering.turn((turning[0] - event.clientX) / radius, (event.clientY - turning[1]) / radius);
    turning = [event.clientX, event.clientY];
  });
  globeCanvas.addEventListener("contextmenu", (event) => event.preventDefault());
  globeCanvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    steering.turn((event.deltaX || event.deltaY) / 400, event.deltaX ? event.deltaY / 400 : 0);
  }, { passive: false });

  const onMap = (event, steer) => {
    const box = map.getBoundingClientRect();
    const code = unflat(4 * (event.clientX - box.left) / box.width - 2, 1 - 2 * (event.clientY - box.top) / box.height);
    if (code) steer(code);
  };
  map.addEventListener("pointerdown", (event) => { map.setPointerCapture(event.pointerId); onMap(event, steering.hold); });
  map.addEventListener("pointermove", (event) => { if (event.buttons) onMap(event, steering.drag); });
  for (const canvas of [globeCanvas, map])
    canvas.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
      if (!step) return;
      event.preventDefault();
      if (event.shiftKey) return steering.turn(TURN * step[0], TURN * step[1]);
      if (canvas === globeCanvas) {
        const frame = axes(steering.view), [x, y, z] = seen(frame, steering.code);
        return steering.choose(unseen(frame, [x + MOVE * step[0], y + MOVE * step[1], z]));
      }
      const [east, north] = angles(steering.code);
      steering.choose(onSphere(east + MOVE * step[0], Math.max(-1.55, Math.min(1.55, north + MOVE * step[1]))));
    });
}

// The arc of a blend, in points of the sphere.
export function arc(one, other) {
  const whole = angle(one, other), count = Math.max(2, Math.ceil(whole / .06));
  if (whole < NONE || whole > HALF) return [one, other];
  return Array.from({ length: count + 1 }, (_, index) => blend(one, other, shareAt(whole, whole * index / count)));
}
// The place on that arc that is nearest to a point of the sphere, as a share of the blend, and how far away it is.
export function nearest(one, other, code) {
  const whole = angle(one, other);
  if (whole < NONE || whole > HALF) return { share: 0, away: Infinity };
  const ahead = unit(other.map((part, axis) => part - dot(one, other) * one[axis]));
  const share = shareAt(whole, Math.max(0, Math.min(whole, Math.atan2(dot(code, ahead), dot(code, one)))));
  return { share, away: angle(blend(one, other, share), code) };
}
const NONE = 1e-6, HALF = Math.PI - 1e-3;  // radians: an arc of no length, and one without a direction
const angle = (one, other) => Math.acos(Math.max(-1, Math.min(1, dot(one, other))));
const shareAt = (whole, part) => Math.sin(part) / (Math.sin(part) + Math.sin(whole - part));
