// The picture of the robot: ground, shadows, shapes, and what is asked of it.
import { makeCamera } from "./camera.js";
import { css, mix, shade, signed, surface } from "./colours.js";
import { cross, place } from "./physics.js";
import { unit } from "./sphere.js";

const LIGHT = unit([-.35, -.5, .8]);  // toward the light
const WHITE = [255, 255, 255], BLACK = [10, 14, 22];

export function makeRobotView(canvas, view, tasks) {
  const camera = makeCamera(view), shadows = document.createElement("canvas");
  const bright = Math.max(...view.shapes.map((shape) => luminance(shape.colour)));
  const trail = [];

  // Draws a pose. `scene` has the colour and value of what it does, its push, the task asked, and the page's palette.
  function draw(pose, scene) {
    const [pen, width, height] = surface(canvas);
    camera.resize(width, height);
    sky(pen, scene.palette);
    floor(pen, scene.palette);
    if (camera.kind === "runs") distances(pen, scene.palette);
    if (camera.kind === "roams") way(pen, scene);
    if (camera.kind === "roams" && scene.quantity.period === 360) compass(pen, pose, scene);
    if (camera.kind !== "fixed") shadow(pen, pose);
    const still = [], moving = [];
    for (const shape of view.shapes) collect(shape, pose, scene, shape.body ? moving : still);
    if (tasks.some((task) => task.goal)) goals(scene, moving);
    for (const pieces of [still, moving]) {
      pieces.sort((one, other) => other.depth - one.depth);
      for (const piece of pieces) piece.paint(pen);
    }
    if (scene.force) arrow(pen, ...scene.force, "#d5000f");
  }

  function sky(pen, palette) {
    const edge = Math.max(0, Math.min(camera.height, camera.horizon()));
    const above = pen.createLinearGradient(0, 0, 0, edge || 1);
    above.addColorStop(0, css(palette.sky)); above.addColorStop(1, css(palette.haze));
    pen.fillStyle = above; pen.fillRect(0, 0, camera.width, camera.height);
  }

  function floor(pen, palette) {
    const edge = camera.horizon(), { width, height } = camera, top = Math.max(0, edge);
    pen.fillStyle = css(palette.floor); pen.fillRect(0, top, width, height - top);
    const [x, y] = camera.at, reach = camera.kind === "runs" ? 26 : 14;
    pen.fillStyle = css(palette.tile);
    pen.beginPath();
    for (let column = Math.floor(x - reach); column < x + reach; column++)
      for (let row = Math.floor(y - reach); row < y + reach; row++)
        if ((column + row) % 2 === 0) quad(pen, column, row);
    pen.fill();
    const fog = pen.createLinearGradient(0, top, 0, top + .34 * (height - top));
    fog.addColorStop(0, css(palette.haze)); fog.addColorStop(1, css(palette.haze).replace(")", " / 0)"));
    pen.fillStyle = fog; pen.fillRect(0, top, width, .34 * (height - top));
  }
  function quad(pen, x, y) {
    const corners = [[x, y, 0], [x + 1, y, 0], [x + 1, y + 1, 0], [x, y + 1, 0]].map(camera.project);
    if (corners.includes(null)) return;
    corners.forEach((corner, index) => index ? pen.lineTo(corner[0], corner[1]) : pen.moveTo(corner[0], corner[1]));
    pen.closePath();
  }

  // Metres along the track, in front of the robot.
  function distances(pen, palette) {
    const reach = camera.width / 2 / camera.project([camera.at[0], camera.at[1], 0])[2] + 1;
    pen.textAlign = "center"; pen.textBaseline = "middle"; pen.fillStyle = css(palette.mark);
    for (let x = Math.ceil(camera.at[0] - reach); x < camera.at[0] + reach; x++) {
      const seen = camera.project([x, camera.at[1] - .12 * view.length - .12, 0]);
      if (!seen) continue;
      pen.font = `600 ${Math.max(9, Math.min(15, .09 * seen[2]))}px system-ui, sans-serif`;
      pen.fillText(signed(x, 0) + " m", seen[0], seen[1]);
    }
  }

  function compass(pen, pose, scene) {
    const centre = [pose.xpos[3 * scene.body], pose.xpos[3 * scene.body + 1], 0], radius = 1.15 * view.length;
    const at = (degrees, far) => camera.project([
      centre[0] + far * Math.cos(degrees * Math.PI / 180), centre[1] + far * Math.sin(degrees * Math.PI / 180), 0]);
    const ring = Array.from({ length: 73 }, (_, index) => at(5 * index, radius));
    const strip = (points, style, wide) => {
      pen.beginPath();
      points.filter(Boolean).forEach((one, index) => index ? pen.lineTo(one[0], one[1]) : pen.moveTo(one[0], one[1]));
      pen.strokeStyle = style; pen.lineWidth = wide; pen.stroke();
    };
    strip(ring, css(scene.palette.mark), 1.5);
    pen.font = "600 12px system-ui, sans-serif"; pen.textAlign = "center"; pen.textBaseline = "middle";
    pen.fillStyle = css(scene.palette.mark);
    for (let degrees = 0; degrees < 360; degrees += 45) {
      strip([at(degrees, .96 * radius), at(degrees, 1.04 * radius)], css(scene.palette.mark), 2);
      const there = at(degrees, 1.17 * radius);
      if (there) pen.fillText(`${degrees}°`, there[0], there[1]);
    }
    const point = (degrees, style, wide) => {
      const [from, to] = [at(degrees, .25 * radius), at(degrees, .98 * radius)];
      if (from && to) arrow(pen, from, to, style, wide);
    };
    if (scene.asked !== null) point(scene.asked, css(scene.palette.ink).replace(")", " / .35)"), 8);
    if (scene.value !== null) point(scene.value, css(scene.colour), 4);
  }

  // The way behind a robot that roams.
  function way(pen, scene) {
    pen.lineCap = "round"; pen.lineWidth = 3;
    trail.forEach((one, index) => {
      const [from, to] = [index ? trail[index - 1] : one, one].map((spot) => camera.project([spot.x, spot.y, 0]));
      if (!from || !to) return;
      pen.globalAlpha = index / trail.length;
      pen.strokeStyle = css(one.colour);
      pen.beginPath(); pen.moveTo(from[0], from[1]); pen.lineTo(to[0], to[1]); pen.stroke();
    });
    pen.globalAlpha = 1;
  }
  function leave(x, y, colour) {
    const last = trail[trail.length - 1];
    if (last && Math.hypot(last.x - x, last.y - y) < .08) return;
    trail.push({ x, y, colour });
    if (trail.length > 160) trail.shift();
  }

  // Shadows are one shape, so that those which overlap are no darker.
  function shadow(pen, pose) {
    [shadows.width, shadows.height] = [canvas.width, canvas.height];
    const dark = shadows.getContext("2d");
    dark.setTransform(pen.getTransform());
    dark.beginPath();
    for (const shape of view.shapes) {
      if (!shape.body || !shape.ends) continue;
      const [a, b] = shape.ends.map((end) => { const [x, y, z] = place(pose, shape.body, end); return [x + .25 * z, y + .2 * z]; });
      const turn = Math.atan2(b[1] - a[1], b[0] - a[0]), rim = [];
      for (let i = 0; i < 14; i++) {
        const angle = turn + Math.PI / 2 + (i < 7 ? i : i - 1) * Math.PI / 6, [x, y] = i < 7 ? a : b;
        rim.push(camera.project([x + shape.radius * Math.cos(angle), y + shape.radius * Math.sin(angle), 0]));
      }
      if (rim.includes(null)) continue;
      rim.forEach((one, index) => index ? dark.lineTo(one[0], one[1]) : dark.moveTo(one[0], one[1]));
      dark.closePath();
    }
    dark.fill();
    pen.globalAlpha = .22; pen.drawImage(shadows, 0, 0, camera.width, camera.height); pen.globalAlpha = 1;
  }

  function collect(shape, pose, scene, pieces) {
    if (shape.ends) {
      const [a, b] = shape.ends.map((end) => camera.project(place(pose, shape.body, end)));
      if (!a || !b) return;
      const colour = mix(BLACK, scene.colour, .62 + .38 * luminance(shape.colour) / bright);
      pieces.push({ depth: (a[3] + b[3]) / 2, paint: (pen) => capsule(pen, a, b, shape.radius, colour) });
      return;
    }
    const spots = shape.vertices.map((vertex) => place(pose, shape.body, vertex)), dots = spots.map(camera.project);
    for (const face of shape.faces) {
      const [a, b, c] = face.map((index) => dots[index]);
      if (!a || !b || !c || (b[0] - a[0]) * (c[1] - a[1]) >= (b[1] - a[1]) * (c[0] - a[0])) continue;
      const [p, q, r] = face.map((index) => spots[index]);
      const normal = unit(cross(q.map((part, axis) => part - p[axis]), r.map((part, axis) => part - p[axis])));
      const lit = normal.reduce((sum, part, axis) => sum + part * LIGHT[axis], 0);
      const style = css(mix(BLACK, mix(shape.colour, WHITE, .12), .5 + .5 * Math.max(0, lit)));
      pieces.push({ depth: (a[3] + b[3] + c[3]) / 3, paint: (pen) => triangle(pen, a, b, c, style) });
    }
  }

  function goals(scene, pieces) {
    for (const task of tasks) {
      const at = camera.project(task.goal), chosen = task === scene.task;
      const colour = task.target === null ? WHITE : shade(scene.quantity, task.target);
      if (at) pieces.push({ depth: at[3], paint: (pen) => {
        capsule(pen, at, at, chosen ? .022 : .011, colour);
        if (!chosen) return;
        pen.beginPath(); pen.arc(at[0], at[1], .04 * at[2], 0, 7);
        pen.strokeStyle = "#d5000f"; pen.lineWidth = 3; pen.stroke();
      } });
    }
  }

  // The moving shape at a point of the picture, or the nearest one: its body, the place on it, and its distance.
  function grab(pose, x, y) {
    let best = null;
    for (const shape of view.shapes) {
      if (!shape.body) continue;
      const points = shape.ends ? [0, .25, .5, .75, 1].map((share) => mix(...shape.ends, share)) : shape.vertices;
      for (const point of points) {
        const there = place(pose, shape.body, point), seen = camera.project(there);
        const away = seen ? Math.hypot(seen[0] - x, seen[1] - y) : Infinity;
        if (!best || away < best.away) best = { body: shape.body, there, away, depth: seen?.[3] };
      }
    }
    return best;
  }
  return { camera, draw, leave, grab, clear: () => { trail.length = 0; } };
}

const luminance = (colour) => .3 * colour[0] + .59 * colour[1] + .11 * colour[2] || 1;

function triangle(pen, a, b, c, style) {
  pen.beginPath(); pen.moveTo(a[0], a[1]); pen.lineTo(b[0], b[1]); pen.lineTo(c[0], c[1]); pen.closePath();
  pen.fillStyle = pen.strokeStyle = style; pen.lineWidth = .6; pen.fill(); pen.stroke();
}

// A capsule between two projected points, round and lit from above on the left.
function capsule(pen, a, b, radius, colour) {
  const [x, y, wide] = [b[0] - a[0], b[1] - a[1], radius * a[2]], narrow = radius * b[2], long = Math.hypot(x, y);
  const thick = Math.max(wide, narrow);
  pen.beginPath();
  let style;
  const light = mix(colour, WHITE, .45), dark = mix(colour, BLACK, .45);
  if (long <= Math.abs(wide - narrow) + .5) {
    const end = wide > narrow ? a : b;
    style = pen.createRadialGradient(end[0] - .35 * thick, end[1] - .4 * thick, .1 * thick, end[0], end[1], 1.05 * thick);
    pen.arc(end[0], end[1], thick, 0, 7);
  } else {
    const turn = Math.atan2(y, x), open = Math.acos(Math.max(-1, Math.min(1, (wide - narrow) / long)));
    pen.arc(a[0], a[1], wide, turn + open, turn - open);
    pen.arc(b[0], b[1], narrow, turn - open, turn + open);
    pen.closePath();
    const side = .4 * y - x < 0 ? 1 : -1, [nx, ny] = [side * y / long * thick, side * -x / long * thick];
    style = pen.createLinearGradient(a[0] + nx, a[1] + ny, a[0] - nx, a[1] - ny);
  }
  style.addColorStop(0, css(light)); style.addColorStop(.45, css(colour)); style.addColorStop(1, css(dark));
  pen.fillStyle = style; pen.fill();
  pen.strokeStyle = "rgb(10 14 22 / .55)"; pen.lineWidth = 1; pen.stroke();
}

function arrow(pen, from, to, style, wide = 4) {
  const turn = Math.atan2(to[1] - from[1], to[0] - from[0]), head = 3 * wide;
  const long = Math.hypot(to[0] - from[0], to[1] - from[1]);
  if (long < 2) return;
  const neck = [to[0] - head * Math.cos(turn), to[1] - head * Math.sin(turn)];
  pen.strokeStyle = pen.fillStyle = style; pen.lineWidth = wide; pen.lineCap = "butt";
  if (long > head) { pen.beginPath(); pen.moveTo(from[0], from[1]); pen.lineTo(...neck); pen.stroke(); }
  pen.beginPath(); pen.moveTo(to[0], to[1]);
  for (const side of [2.6, -2.6]) pen.lineTo(to[0] + head * Math.cos(turn + side), to[1] + head * Math.sin(turn + side));
  pen.closePath(); pen.fill();
}
