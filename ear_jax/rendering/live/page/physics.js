// A robot in MuJoCo under its policy.
import { build } from "./program.js";

const PUSH_SECONDS = 0.1;  // a push is a force for this long
const PULL = 12;  // acceleration in m/s² of a free body of the robot's mass, for each metre that it is pulled
const LIMIT = 30;  // m/s², the strongest pull

// Makes the robot of a description; `constants` are those of its programs.
export function makeRobot(mj, description, constants) {
  const model = mj.MjModel.from_xml_string(description.model.xml), data = new mj.MjData(model);
  model.geom_margin.set(description.model.margins);
  const programs = {};
  for (const [name, program] of Object.entries(description.programs)) programs[name] = build(program, constants);
  const mass = model.body_mass.reduce((sum, one) => sum + one, 0);
  const timestep = model.opt.timestep, dt = timestep * description.substeps;
  const robot = {
    model, data, mass, dt, time: 0, fell: false, resets: 0, steps: 0, body: model.jnt_bodyid[0],
    push: null, pull: null, kept: Math.max(1, Math.round(description.window / dt)),
    before: null, now: null,  // positions and orientations of all bodies, a MuJoCo step apart
  };
  let history = [], outcomes = [], substep = 0, start = 0, previous = null, control = null;

  const state = () => {
    const leaves = [data.qpos, data.qvel, data.qacc_warmstart];
    if (model.nmocap) leaves.push(data.mocap_pos);
    if (model.na) leaves.push(data.act);
    return leaves;
  };
  const copied = () => state().map((leaf) => Float64Array.from(leaf));
  const look = () => ({ xpos: Float64Array.from(data.xpos), xmat: Float64Array.from(data.xmat) });
  const tracked = () => description.bodies.flatMap((body) => [...data.xpos.subarray(3 * body, 3 * body + 3)]);

  robot.reset = () => {
    mj.mj_resetData(model, data);
    const leaves = description.starts[start++ % description.starts.length];
    state().forEach((leaf, index) => leaf.set(leaves[index]));
    mj.mj_forward(model, data);
    data.qacc_warmstart.set(leaves[2]);
    history = []; outcomes = []; substep = 0; robot.fell = false; robot.push = null;
    robot.before = robot.now = look();
  };

  function decide(code) {
    const seen = Float64Array.from(programs.observe(...state())[0]);
    history = history.length ? [...history.slice(1), seen] : Array(description.history).fill(seen);
    const action = programs.act(history.flatMap((one) => [...one]), code)[0];
    const [ctrl, ...leaves] = programs.actuate(...state(), action);
    control = Float64Array.from(ctrl);
    state().forEach((leaf, index) => leaf.set(leaves[index]));
    data.ctrl.set(control);
    previous = copied();
  }

  // One MuJoCo step; the policy acts at the first of each `substeps`.
  robot.step = (code) => {
    if (substep === 0) decide(code);
    force();
    mj.mj_step(model, data);
    mj.mj_kinematics(model, data);
    robot.time += timestep;
    [robot.before, robot.now] = [robot.now, look()];
    substep = (substep + 1) % description.substeps;
    if (substep !== 0) return;
    robot.steps++;
    const outcome = programs.outcome(...previous, control, ...state(), tracked());
    outcomes.push(outcome.map((leaf) => leaf[0]));
    if (outcomes.length > robot.kept) outcomes.shift();
    robot.fell = programs.terminated(...state())[0][0] !== 0 || !data.qpos.every(Number.isFinite);
  };

  function force() {
    const applied = data.xfrc_applied;
    applied.fill(0);
    if (robot.push) {
      const at = 6 * robot.body;
      robot.push.impulse.forEach((part, axis) => { applied[at + axis] += part / PUSH_SECONDS; });
      if ((robot.push.left -= timestep) <= 0) robot.push = null;
    }
    if (robot.pull) {
      const { body, from, to } = robot.pull, point = place(robot.now, body, from);
      const pulled = [0, 1, 2].map((axis) => PULL * mass * (to[axis] - point[axis]));
      const share = Math.min(1, LIMIT * mass / Math.max(1e-9, Math.hypot(...pulled)));
      const arm = [0, 1, 2].map((axis) => point[axis] - data.xipos[3 * body + axis]);
      pulled.forEach((part, axis) => { applied[6 * body + axis] += share * part; });
      cross(arm, pulled).forEach((part, axis) => { applied[6 * body + 3 + axis] += share * part; });
    }
  }

  // Gives the robot an impulse, newton seconds along x, y and z.
  robot.shove = (impulse) => { robot.push = { impulse, left: PUSH_SECONDS }; };

  // Outcomes by name, averaged over the last second; null right after a start.
  robot.means = () => {
    if (!outcomes.length) return null;
    const sums = outcomes.reduce((all, one) => all.map((sum, index) => sum + one[index]));
    const means = sums.map((sum) => sum / outcomes.length), leaves = means.map((mean) => [mean]);
    const named = Object.fromEntries(description.outcomes.map((name, index) => [name, means[index]]));
    named[description.quantities[0].name] = programs.achieved(...leaves, ...leaves)[0][0];
    return named;
  };
  robot.close = () => { data.delete(); model.delete(); };  // MuJoCo's memory is not the browser's to free
  robot.act = (obs, code) => Array.from(programs.act(obs, code)[0]);
  robot.reset();
  return robot;
}

// The place in the world of a point that is fixed to a body.
export function place(pose, body, point) {
  return [0, 1, 2].map((axis) => pose.xpos[3 * body + axis] +
    point.reduce((sum, part, index) => sum + part * pose.xmat[9 * body + 3 * axis + index], 0));
}

// The point in a body's frame that is at a place in the world.
export function placeOn(pose, body, there) {
  const away = there.map((part, axis) => part - pose.xpos[3 * body + axis]);
  return [0, 1, 2].map((axis) => away.reduce((sum, part, row) => sum + part * pose.xmat[9 * body + 3 * row + axis], 0));
}

// The pose between two, a share of the way from the first; bodies turn little in a MuJoCo step.
export function between(one, other, share) {
  const mixed = (from, to) => from.map((value, index) => value + share * (to[index] - value));
  return { xpos: mixed(one.xpos, other.xpos), xmat: mixed(one.xmat, other.xmat) };
}

export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
