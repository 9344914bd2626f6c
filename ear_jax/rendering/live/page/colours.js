// Colours of what the robot does, and of the page.

export const rgb = (hex) => [1, 3, 5].map((from) => parseInt(hex.slice(from, from + 2), 16));
export const css = (colour) => `rgb(${colour.map(Math.round).join(" ")})`;
export const mix = (one, other, share) => one.map((part, index) => part + share * (other[index] - part));

// The colour of a value of a quantity, red, green and blue.
export function shade(quantity, value) {
  const [low, high] = quantity.scale, { period } = quantity;
  const share = period ? (((value - low) % period) + period) % period / period : (value - low) / ((high - low) || 1);
  const { colours } = quantity, at = Math.max(0, Math.min(1, share)) * (colours.length - 1), below = Math.floor(at);
  return mix(colours[below], colours[Math.min(below + 1, colours.length - 1)], at - below);
}

// The page's own colours, which follow the system's light or dark scheme.
export function palette() {
  const style = getComputedStyle(document.documentElement);
  const names = ["ink", "dim", "line", "page", "sky", "haze", "floor", "tile", "mark"];
  return Object.fromEntries(names.map((name) => [name, rgb(style.getPropertyValue(`--${name}`).trim())]));
}

// A canvas sized for the screen's pixels: its pen, and its width and height in CSS pixels.
export function surface(canvas) {
  const dense = Math.min(2, window.devicePixelRatio || 1), width = canvas.clientWidth, height = canvas.clientHeight;
  const [across, down] = [Math.round(width * dense), Math.round(height * dense)];
  if (canvas.width !== across || canvas.height !== down) [canvas.width, canvas.height] = [across, down];
  const pen = canvas.getContext("2d");
  pen.setTransform(dense, 0, 0, dense, 0, 0);
  return [pen, width, height];
}

// A number with a true minus sign and without a negative zero.
export const signed = (value, digits) =>
  value.toFixed(digits).replace(/^-(0(?:\.0*)?)$/, "$1").replace("-", "\u2212");
