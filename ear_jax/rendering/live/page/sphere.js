// The sphere of task embeddings: its geometry, and its pictures as a globe and as a flat map.
import { css, mix, rgb, shade, surface } from "./colours.js";

const FALL = [120, 120, 126];

export const unit = (v) => { const length = Math.hypot(...v) || 1; return v.map((part) => part / length); };
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const angles = (code) => [Math.atan2(code[1], code[0]), Math.asin(Math.max(-1, Math.min(1, code[2])))];
export const onSphere = (east, north) =>
  [Math.cos(north) * Math.cos(east), Math.cos(north) * Math.sin(east), Math.sin(north)];
// A blend of two embeddings, all of the second at a share of 1.
export const blend = (one, other, share) => unit(mix(one, other, share));

// Mollweide's map, 4 wide and 2 high.
export function flat(code) {
  const [east, north] = angles(code);
  let turn = north;
  for (let round = 0; round < 12; round++)  // Newton's method
    turn -= (2 * turn + Math.sin(2 * turn) - Math.PI * Math.sin(north)) / (2 + 2 * Math.cos(2 * turn) + 1e-9);
  return [2 * east / Math.PI * Math.cos(turn), Math.sin(turn)];
}
export function unflat(x, y) {  // null beside the map
  if (Math.abs(y) >= 1) return null;
  const turn = Math.asin(y), east = Math.PI * x / (2 * Math.cos(turn));
  return Math.abs(east) > Math.PI ? null : onSphere(east, Math.asin((2 * turn + Math.sin(2 * turn)) / Math.PI));
}

// Colours of a quantity all over the sphere, stored as an octahedron unfolded to a square.
export function makeGround(quantity, ground) {
  const size = ground.size, values = bytes(quantity.ground), fell = bytes(ground.fell);
  const colours = new Float32Array(3 * values.length);
  const [low, high] = quantity.scale;
  values.forEach((value, index) => {
    const colour = mix(shade(quantity, low + value / 255 * (high - low)), FALL, .85 * Math.max(0, fell[index] / 255 - .1));
    colours.set(colour, 3 * index);
  });
  return { size, colours };
}
const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));

// Writes the colour at a direction into four bytes, darkened by `light`.
function paint(ground, x, y, z, light, pixels, at) {
  const whole = Math.abs(x) + Math.abs(y) + Math.abs(z);
  let u = x / whole, v = y / whole;
  if (z < 0) [u, v] = [(1 - Math.abs(v)) * (u >= 0 ? 1 : -1), (1 - Math.abs(u)) * (v >= 0 ? 1 : -1)];
  const { size, colours } = ground, last = size - 1;
  const column = Math.max(0, Math.min(last, (u + 1) / 2 * size - .5)), row = Math.max(0, Math.min(last, (v + 1) / 2 * size - .5));
  const left = Math.floor(column), top = Math.floor(row), across = column - left, down = row - top;
  const a = 3 * (top * size + left), b = left < last ? a + 3 : a, below = top < last ? 3 * size : 0;
  for (let part = 0; part < 3; part++) {
    const upper = colours[a + part] + across * (colours[b + part] - colours[a + part]);
    const lower = colours[a + below + part] + across * (colours[b + below + part] - colours[a + below + part]);
    pixels[at + part] = light * (upper + down * (lower - upper));
  }
}

function picture(width, height, fill) {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [width, height];
  const pen = canvas.getContext("2d"), image = pen.createImageData(width, height);
  for (let row = 0; row < height; row++) for (let column = 0; column < width; column++)
    fill(column, row, image.data, 4 * (row * width + column));
  pen.putImageData(image, 0, 0);
  return canvas;
}

// The globe, seen from a direction (`east`, `north`); a point of the picture is right, up and toward the viewer.
export function axes(view) {
  const toward = onSphere(view.east, view.north), right = [-Math.sin(view.east), Math.cos(view.east), 0];
  const up = [-Math.sin(view.north) * Math.cos(view.east), -Math.sin(view.north) * Math.sin(view.east), Math.cos(view.north)];
  return { right, up, toward };
}
export const seen = (frame, code) => [dot(code, frame.right), dot(code, frame.up), dot(code, frame.toward)];
export const unseen = (frame, [right, up, toward]) =>
  [0, 1, 2].map((axis) => right * frame.right[axis] + up * frame.up[axis] + toward * frame.toward[axis]);

export function makeGlobe(canvas) {
  let drawn = null, key = "";
  const radius = () => Math.min(canvas.clientWidth, canvas.clientHeight) / 2 - 14;
  return {
    radius,
    draw(scene, view, ground, version) {
      const [pen, width, height] = surface(canvas), frame = axes(view), size = 2 * Math.round(radius());
      const dense = Math.min(1.5, window.devicePixelRatio || 1), pixels = Math.round(size * dense);
      const wanted = [view.east, view.north, pixels, version].join();
      if (wanted !== key) {
        key = wanted;
        drawn = picture(pixels, pixels, (column, row, data, at) => {
          const x = 2 * (column + .5) / pixels - 1, y = 1 - 2 * (row + .5) / pixels, square = x * x + y * y;
          if (square > 1.03) return;
          const z = Math.sqrt(Math.max(0, 1 - square)), [a, b, c] = unseen(frame, [x, y, z]);
          paint(ground, a, b, c, .7 + .34 * Math.max(0, .25 * y - .2 * x + .9 * z), data, at);
          data[at + 3] = 255 * Math.max(0, Math.min(1, (1 - Math.sqrt(square)) * pixels / 2 + .5));
        });
      }
      pen.clearRect(0, 0, width, height);
      pen.drawImage(drawn, width / 2 - size / 2, height / 2 - size / 2, size, size);
      const on = (code) => {
        const [x, y, z] = seen(frame, code);
        return { x: width / 2 + size / 2 * x, y: height / 2 - size / 2 * y, hidden: z < 0 };
      };
      annotate(pen, scene, on, width);
    },
  };
}

export function makeMap(canvas) {
  let drawn = null, key = "";
  return {
    draw(scene, ground, version) {
      const [pen, width, height] = surface(canvas), dense = Math.min(1.5, window.devicePixelRatio || 1);
      const [across, down] = [Math.round(width * dense), Math.round(height * dense)], wanted = [across, down, version].join();
      if (wanted !== key) {
        key = wanted;
        drawn = picture(across, down, (column, row, data, at) => {
          const x = 4 * (column + .5) / across - 2, y = 1 - 2 * (row + .5) / down, far = Math.hypot(x / 2, y) / .999;
          const here = unflat(x / Math.max(1, far), y / Math.max(1, far));  // the edge goes on outside, and is cut off
          paint(ground, ...here, 1, data, at);
          data[at + 3] = 255;
        });
      }
      pen.clearRect(0, 0, width, height);
      pen.save();
      pen.beginPath(); pen.ellipse(width / 2, height / 2, width / 2, height / 2, 0, 0, 7); pen.clip();
      pen.drawImage(drawn, 0, 0, width, height);
      pen.restore();
      const on = (code) => { const [x, y] = flat(code); return { x: (x + 2) / 4 * width, y: (1 - y) / 2 * height, hidden: false }; };
      annotate(pen, scene, on, width);
    },
  };
}

// The arc of the blend, the tasks, what is kept, and the embedding in use.
function annotate(pen, scene, on, width) {
  line(pen, scene.arc.map(on), width);
  pen.font = "600 11px system-ui, sans-serif"; pen.textBaseline = "middle"; pen.lineJoin = "round";
  const taken = [];  // places of labels; one that would lie on another is left out
  for (const point of scene.points) {
    const { x, y, hidden } = on(point.lte);
    pen.globalAlpha = hidden ? .22 : 1;
    pen.beginPath();
    if (point.kept) pen.rect(x - 4, y - 4, 8, 8); else pen.arc(x, y, 4, 0, 7);
    pen.fillStyle = "white"; pen.strokeStyle = "#10151d"; pen.lineWidth = 1.5; pen.fill(); pen.stroke();
    if (!hidden && taken.every((other) => Math.abs(other.x - x) > 16 || Math.abs(other.y - y) > 10)) {
      taken.push({ x, y });
      label(pen, point.label, x, y, width, scene.code === point.lte ? 15 : 8);
    }
  }
  const { x, y, hidden } = on(scene.code);
  pen.globalAlpha = hidden ? .4 : 1;
  for (const [style, wide] of [["white", 5.5], ["#d5000f", 3]]) {
    pen.beginPath(); pen.arc(x, y, 10, 0, 7); pen.strokeStyle = style; pen.lineWidth = wide; pen.stroke();
  }
  pen.globalAlpha = 1;
}
function line(pen, points, width) {
  for (const [style, wide] of [["rgb(0 0 0 / .45)", 3.5], ["white", 1.8]]) {
    pen.beginPath();
    points.forEach((point, index) => {
      const before = points[index - 1];
      const joined = before && Math.abs(point.x - before.x) < width / 4 && !point.hidden && !before.hidden;
      if (joined) pen.lineTo(point.x, point.y); else pen.moveTo(point.x, point.y);
    });
    pen.strokeStyle = style; pen.lineWidth = wide; pen.stroke();
  }
}
function label(pen, text, x, y, width, away) {
  const right = x > width - 50;
  pen.textAlign = right ? "right" : "left";
  pen.strokeStyle = "white"; pen.lineWidth = 3; pen.strokeText(text, x + (right ? -away : away), y);
  pen.fillStyle = "#10151d"; pen.fillText(text, x + (right ? -away : away), y);
}

// A quantity with its colours as numbers.
export const withColours = (quantity) => ({ ...quantity, colours: quantity.shades.map(rgb) });
// The colour scale as a CSS gradient.
export const gradient = (quantity) => `linear-gradient(to right, ${quantity.colours.map(css).join(", ")})`;
