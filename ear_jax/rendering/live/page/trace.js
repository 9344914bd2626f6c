// The trace: what the robot did over the last seconds.
import { css, shade, signed, surface } from "./colours.js";

const SECONDS = 10;

export function makeTrace(canvas) {
  let samples = [];  // time, value of each quantity
  return {
    clear: () => { samples = []; },
    add(time, values) {
      const last = samples[samples.length - 1];
      if (last && time - last.time < .03) return;
      samples.push({ time, values });
      while (samples[0].time < time - SECONDS) samples.shift();
    },
    // Draws a quantity up to `time`, and the value asked if there is one.
    draw(quantity, time, asked, palette) {
      const [pen, width, height] = surface(canvas), left = 44, right = 8, top = 8, bottom = 18;
      const [low, high] = range(quantity), { period } = quantity;
      const x = (moment) => width - right - (time - moment) / SECONDS * (width - left - right);
      const y = (value) => top + (high - value) / (high - low) * (height - top - bottom);
      pen.clearRect(0, 0, width, height);
      pen.font = "11px system-ui, sans-serif"; pen.fillStyle = css(palette.dim); pen.strokeStyle = css(palette.line);
      pen.lineWidth = 1; pen.textBaseline = "middle"; pen.textAlign = "right";
      for (const value of ticks(low, high, period)) {
        pen.beginPath(); pen.moveTo(left, y(value)); pen.lineTo(width - right, y(value)); pen.stroke();
        pen.fillText(signed(value, high - low < 3 ? 1 : 0), left - 6, y(value));
      }
      pen.textAlign = "left"; pen.textBaseline = "bottom";
      pen.fillText(`${SECONDS} s ago`, left, height - 2);
      pen.textAlign = "right"; pen.fillText("now", width - right, height - 2);
      if (asked !== null) {
        pen.setLineDash([5, 4]); pen.strokeStyle = css(palette.dim); pen.lineWidth = 1.5;
        pen.beginPath(); pen.moveTo(left, y(asked)); pen.lineTo(width - right, y(asked)); pen.stroke();
        pen.setLineDash([]);
      }
      pen.lineWidth = 2.5; pen.lineCap = "round";
      samples.forEach((sample, index) => {
        const before = samples[index - 1], value = sample.values[quantity.name];
        if (!before || sample.time - before.time > .3) return;
        const was = before.values[quantity.name];
        if (period && Math.abs(value - was) > period / 2) return;
        pen.strokeStyle = css(shade(quantity, value));
        pen.beginPath(); pen.moveTo(x(before.time), clamp(y(was))); pen.lineTo(x(sample.time), clamp(y(value))); pen.stroke();
      });
      function clamp(height_) { return Math.max(top - 4, Math.min(height - bottom + 4, height_)); }
    },
  };
}

function range(quantity) {
  const [low, high] = quantity.scale, margin = quantity.period ? 0 : .06 * (high - low);
  return [low - margin, high + margin || 1];
}
function ticks(low, high, period) {
  if (period) return [0, period / 4, period / 2, 3 * period / 4, period];
  const rough = (high - low) / 7, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((times) => times * power).find((value) => value >= rough);
  const found = [];
  for (let value = Math.ceil(low / step) * step; value <= high; value += step) found.push(value);
  return found;
}
