// Steering: the embedding in use, and the ways to choose another.
import { angles, axes, blend, dot, onSphere, seen, unflat, unit, unseen } from "./sphere.js";

const TURN = .06, MOVE = .04;  // radians for one key
const POLE = 1.45;  // radians: the globe is never seen from straight above

export function makeSteering(tasks, changed) {
  const middle = Math.floor((tasks.length - 1) / 2), steering = { code: null, task: null, pair: [middle, middle], share: 1 };

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
  function point(event) {
    steering.aim = null;
    const [x, y] = at(event), far = Math.hypot(x, y), frame = axes(steering.view);
    const reached = far < 1 ? [x, y, Math.sqrt(1 - far * far)] : [x / far, y / far, 0];
    const code = unseen(frame, reached);
    steering.choose(code);
    if (far > .97) steering.turn(.03 * reached[0], .03 * reached[1]);
    steering.aim = null;
  }
  globeCanvas.addEventListener("pointerdown", (event) => {
    globeCanvas.setPointerCapture(event.pointerId);
    const turns = event.button === 2 || event.shiftKey || Math.hypot(...at(event)) > 1.06;
    turning = turns ? [event.clientX, event.clientY] : null;
    if (!turning) point(event);
  });
  globeCanvas.addEventListener("pointermove", (event) => {
    if (!event.buttons) return;
    if (!turning) return point(event);
    const radius = globe.radius();
    steering.turn((turning[0] - event.clientX) / radius, (event.clientY - turning[1]) / radius);
    turning = [event.clientX, event.clientY];
  });
  globeCanvas.addEventListener("contextmenu", (event) => event.preventDefault());
  globeCanvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    steering.turn((event.deltaX || event.deltaY) / 400, event.deltaX ? event.deltaY / 400 : 0);
  }, { passive: false });

  const onMap = (event) => {
    const box = map.getBoundingClientRect();
    const code = unflat(4 * (event.clientX - box.left) / box.width - 2, 1 - 2 * (event.clientY - box.top) / box.height);
    if (code) steering.choose(code);
  };
  map.addEventListener("pointerdown", (event) => { map.setPointerCapture(event.pointerId); onMap(event); });
  map.addEventListener("pointermove", (event) => { if (event.buttons) onMap(event); });
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
  const angle = Math.acos(Math.max(-1, Math.min(1, dot(one, other)))), count = Math.max(2, Math.ceil(angle / .06));
  if (angle < 1e-6 || angle > Math.PI - 1e-3) return [one, other];
  return Array.from({ length: count + 1 }, (_, index) => {
    const [a, b] = [Math.sin(angle * (1 - index / count)), Math.sin(angle * index / count)];
    return unit(one.map((part, axis) => a * part + b * other[axis]));
  });
}
