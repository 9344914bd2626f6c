// The page: one robot at a time, its sphere, and what the reader does with both.
import { loadMuJoCo, unpackNumbers } from "./blobs.js";
import { palette, shade, signed } from "./colours.js";
import { copy, makeKeeping, words } from "./keeping.js";
import { between, makeRobot, place, placeOn } from "./physics.js";
import { makeRobotView } from "./robot.js";
import { gradient, makeGlobe, makeGround, makeMap, withColours } from "./sphere.js";
import { arc, listen, makeSteering } from "./steering.js";
import { makeTrace } from "./trace.js";

const data = JSON.parse(document.getElementById("data").textContent);
const element = (id) => document.getElementById(id);
const SLOW = .2;  // of real time
const FALL_SECONDS = 1.2;  // a fallen robot is shown for this long
const SHOVE = 1;  // m/s by which a push changes the speed of a free body

const globe = makeGlobe(element("globe")), map = makeMap(element("map")), trace = makeTrace(element("trace"));
const still = matchMedia("(prefers-reduced-motion: reduce)").matches;  // it starts in a pause, and the globe does not glide
const reader = { playing: !still, slow: false, byHand: false };  // by hand, time passes only by calls of `advance`
let physics = null;  // MuJoCo, once it is loaded
let show = null;  // the robot on the page

const units = (unit) => unit === "degrees" ? "°" : ` ${unit}`;
const named = (task) => task.target === null ? task.name : signed(task.target, Number.isInteger(task.target) ? 0 : 1);

// Puts a robot on the page; it stands in its first pose until MuJoCo is there.
function open(index) {
  const description = data.robots[index], { tasks, view } = description;
  show?.robot?.close();
  const quantities = description.quantities.map(withColours);
  show = {
    index, description, tasks, quantities, robot: null, owed: 0, fallen: 0, pose: view.first, changed: true, grasp: null,
    grounds: quantities.map((quantity) => makeGround(quantity, description.ground)), quantity: 0,
    view: makeRobotView(element("robot"), view, tasks), keeping: makeKeeping(description.name), speed: null,
  };
  show.steering = makeSteering(tasks, () => { show.changed = true; });
  show.quantity = show.steering.task.asks;
  trace.clear();
  element("title").textContent = description.name;
  document.title = `${description.name} · ear explore`;
  [...element("robots").children].forEach((made, at) => made.setAttribute("aria-pressed", at === index));
  buttons();
  legend();
  if (physics) start(show);
}

async function start(opened) {
  const constants = await unpackNumbers(`constants-${opened.index}`), mj = await physics;
  if (show !== opened) return;
  try {
    opened.robot = makeRobot(mj, opened.description, constants);
    opened.view.camera.jump(root());
    window.ear.ready = performance.now();
    tell();
  } catch (error) { fail(error); }
}
function fail(error) {
  notice(`MuJoCo cannot run in this browser: ${error.message}`);
  throw error;
}

/* Buttons and texts. */
function button(text, act, title = "") {
  const made = document.createElement("button");
  made.type = "button";
  made.textContent = text;
  made.title = title;
  made.addEventListener("click", act);
  return made;
}
function buttons() {
  const { tasks, steering, keeping } = show;
  element("tasks").replaceChildren(...tasks.map((task, index) => button(named(task), () => go(index), task.name)));
  element("kept").replaceChildren(...keeping.all().flatMap(({ name, lte }) => [
    button(name, () => steering.choose(lte), words(lte)),
    button("×", () => { keeping.change(name, null); buttons(); }, `forget ${name}`),
  ]));
  show.changed = true;
}
function go(index) {
  show.steering.go(index);
  if (show.quantity !== show.tasks[index].asks) { show.quantity = show.tasks[index].asks; legend(); }
}
function legend() {
  const { quantities } = show, quantity = quantities[show.quantity], [low, high] = quantity.scale;
  const digits = high - low < 3 ? 1 : 0;
  const turns = quantity.unit === "degrees" ? "°" : "";
  element("low").textContent = signed(low, digits) + turns;
  element("high").textContent = signed(high, digits) + turns;
  element("bar").style.background = gradient(quantity);
  element("unit").textContent = (turns ? "" : quantity.unit) + (show.description.ground.falls ? " · grey: falls" : "");
  element("choice").replaceChildren(...(quantities.length < 2 ? [] : quantities.map((one, index) => {
    const made = button(one.name, () => { show.quantity = index; legend(); });
    made.setAttribute("aria-pressed", index === show.quantity);
    return made;
  })));
  show.changed = true;
}
function notice(text) { if (element("notice").textContent !== text) element("notice").textContent = text; }
function tell() {
  const { robot, steering, tasks, quantities } = show, quantity = quantities[show.quantity], means = robot?.means();
  element("value").textContent = means ? signed(means[quantity.name], quantity.period ? 0 : 2) + units(quantity.unit) : "…";
  const [one, other] = steering.pair.map((index) => named(tasks[index]));
  const target = steering.task?.target ?? null;
  element("asked").textContent = steering.task
    ? `trained task ${steering.task.name}${target === null ? "" : `: asked ${named(steering.task)}${units(quantities[0].unit)}`}`
    : "an embedding it never trained on";
  element("from").textContent = one;
  element("to").textContent = other;
  if (document.activeElement !== element("share")) element("share").value = steering.share;
  element("lte").textContent = words(steering.code);
  [...element("tasks").children].forEach((made, index) => made.setAttribute("aria-pressed", tasks[index] === steering.task));
  element("pause").textContent = reader.playing ? "pause" : "play";
  element("slow").setAttribute("aria-pressed", reader.slow);
  const waiting = !robot ? "starting MuJoCo …" : show.fallen > 0 ? "fell · starts again" : "";
  notice(waiting || (reader.playing ? "" : "paused"));
}

/* Time. */
const root = () => show.pose.xpos.slice(3 * (show.robot?.body ?? 1), 3 * (show.robot?.body ?? 1) + 3);
function advance(seconds) {
  const { robot, steering, view } = show;
  if (show.fallen > 0) {
    show.fallen -= seconds;
    if (show.fallen <= 0) restart();
    return;
  }
  const step = robot.model.opt.timestep;
  for (show.owed += seconds; show.owed >= step && !robot.fell; show.owed -= step) {
    const { steps } = robot;
    robot.step(steering.code);
    if (robot.steps > steps) trace.add(robot.time, robot.means());
  }
  if (robot.fell) { robot.resets++; show.fallen = FALL_SECONDS; show.owed = 0; }
  show.pose = between(robot.before, robot.now, Math.min(1, show.owed / step));
  view.camera.follow(root(), Math.max(...show.pose.xpos.filter((_, index) => index % 3 === 2)), seconds);
}
function restart() {
  show.robot.reset();
  [show.fallen, show.owed, show.pose] = [0, 0, show.robot.now];
  show.view.camera.jump(root());
  show.view.clear();
}
function shove() {
  const { robot, view } = show, impulse = SHOVE * robot.mass;
  robot.shove(view.camera.kind === "roams" ? [0, impulse, 0] : [-impulse, 0, 0]);
}

/* Drawing. */
let colours = palette();
function drawPlaces() {
  const { steering, tasks, keeping } = show, ground = show.grounds[show.quantity];
  const scene = {
    code: steering.code,
    arc: arc(...steering.pair.map((index) => tasks[index].lte)),
    points: [
      ...tasks.map((task) => ({ lte: task.lte, label: named(task) })),
      ...keeping.all().map(({ name, lte }) => ({ lte, label: name, kept: true })),
    ],
  };
  const key = `${show.index} ${show.quantity}`;
  globe.draw(scene, steering.view, ground, key);
  map.draw(scene, ground, key);
}
function drawRobot() {
  const { robot, view, steering, pose } = show, quantity = show.quantities[show.quantity];
  const value = robot?.means()?.[quantity.name] ?? null, body = robot?.body ?? 1;
  const colour = value === null ? [150, 158, 168] : shade(quantity, value);
  const asked = steering.task?.asks === show.quantity ? steering.task.target : null;
  const at = root();
  if (robot && reader.playing) view.leave(at[0], at[1], colour);
  const pull = robot?.pull;
  const force = pull && [place(pose, pull.body, pull.from), pull.to].map(view.camera.project);
  view.draw(pose, {
    colour, value, quantity, body, asked, palette: colours, task: steering.task,
    force: force && !force.includes(null) ? force : robot?.push ? shoveArrow(at, robot.push.impulse) : null,
  });
  trace.draw(quantity, robot?.time ?? 0, asked, colours);
}
function shoveArrow(at, impulse) {
  const size = Math.hypot(...impulse), ends = [-1.1, -.25].map((far) => at.map((part, axis) => part + far * impulse[axis] / size));
  const seen = ends.map(show.view.camera.project);
  return seen.includes(null) ? null : seen;
}

let before = null, told = 0;
function tick(now) {
  const seconds = before === null ? 0 : Math.min(.1, (now - before) / 1000);
  before = now;
  pulling();
  show.steering.glide(still ? 9 : seconds);
  if (show.robot && reader.playing && !reader.byHand) advance(seconds * (reader.slow ? SLOW : 1));
  if (show.changed) { show.changed = false; drawPlaces(); told = 0; }
  drawRobot();
  if (now - told > 120) { told = now; tell(); }
  if (!window.ear.drawn) window.ear.drawn = performance.now();
  requestAnimationFrame(tick);
}

/* Input. */
const steering = new Proxy({}, {  // of the robot on the page
  get: (_, name) => show.steering[name], set: (_, name, value) => { show.steering[name] = value; return true; },
});
listen(globe, element("globe"), element("map"), steering);
const stage = element("robot");
const spot = (event) => { const box = stage.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
stage.addEventListener("pointerdown", (event) => {
  if (!show.robot) return;
  const [x, y] = spot(event), held = show.view.grab(show.pose, x, y);
  if (!held || held.away > 70) return;
  stage.setPointerCapture(event.pointerId);
  stage.classList.add("held");
  show.robot.pull = { body: held.body, from: placeOn(show.pose, held.body, held.there), to: held.there };
  show.grasp = { depth: held.depth, x, y };
});
stage.addEventListener("pointermove", (event) => { if (show.grasp) [show.grasp.x, show.grasp.y] = spot(event); });
function pulling() {  // the pointer keeps its place on the picture while the camera moves on
  if (!show.grasp || !show.robot?.pull) return;
  show.robot.pull.to = show.view.camera.unproject(show.grasp.x, show.grasp.y, show.grasp.depth);
}
for (const name of ["pointerup", "pointercancel", "lostpointercapture"])
  stage.addEventListener(name, () => { if (show.robot) show.robot.pull = null; show.grasp = null; stage.classList.remove("held"); });

const actions = {
  " ": () => { reader.playing = !reader.playing; }, s: () => { reader.slow = !reader.slow; }, p: () => show.robot && shove(),
  r: () => show.robot && restart(), "[": () => beside(-1), "]": () => beside(1),
};
function beside(step) {
  const { tasks } = show, { task, pair } = show.steering, here = task ? tasks.indexOf(task) : pair[1];
  go((here + step + tasks.length) % tasks.length);
}
for (const [id, key] of [["pause", " "], ["slow", "s"], ["shove", "p"], ["reset", "r"]])
  element(id).addEventListener("click", () => { actions[key](); tell(); });
document.addEventListener("keydown", (event) => {
  if (event.target.closest("input, button, summary") || event.ctrlKey || event.metaKey || event.altKey) return;
  const act = actions[event.key.toLowerCase()];
  if (act) { event.preventDefault(); act(); tell(); }
});
element("share").addEventListener("input", (event) => show.steering.mix(Number(event.target.value)));
element("keep").addEventListener("submit", (event) => {
  event.preventDefault();
  const name = element("name").value.trim();
  if (!name) return element("name").focus();
  show.keeping.change(name, show.steering.code);
  element("name").value = "";
  buttons();
});
element("copy").addEventListener("click", async () => {
  const done = await copy(words(show.steering.code), element("lte"));
  element("copy").textContent = done ? "copied" : "select and copy";
  setTimeout(() => { element("copy").textContent = "copy"; }, 1500);
});
window.addEventListener("resize", () => { show.changed = true; });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { colours = palette(); show.changed = true; });

/* Begin. `window.ear` is for tests and for the curious. */
window.ear = {
  get show() { return show; }, reader, go, open, advance, drawn: 0, ready: 0, robots: data.robots.map((robot) => robot.name),
  box: (id) => element(id).getBoundingClientRect(),
};
if (data.robots.length > 1)
  element("robots").replaceChildren(...data.robots.map((robot, index) => button(robot.name, () => open(index))));
open(0);
requestAnimationFrame((now) => {
  tick(now);
  setTimeout(() => { physics = loadMuJoCo(); physics.catch(fail); start(show); });
});
