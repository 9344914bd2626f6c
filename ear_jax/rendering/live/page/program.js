// Programs: JAX functions as lists of instructions, made by programs.py.

const bits = new Uint32Array(1), rounded = new Float32Array(bits.buffer);

// One number from each operand; the names are JAX's.
const ELEMENTWISE = {
  abs: Math.abs, acos: Math.acos, acosh: Math.acosh, add: (a, b) => a + b, and: (a, b) => a && b, asin: Math.asin,
  asinh: Math.asinh, atan: Math.atan, atan2: Math.atan2, atanh: Math.atanh, bfloat16: bfloat16, cbrt: Math.cbrt,
  ceil: Math.ceil, clamp: (low, a, high) => Math.min(Math.max(a, low), high), cos: Math.cos, cosh: Math.cosh,
  div: (a, b) => a / b, eq: (a, b) => +(a === b), exp: Math.exp, exp2: (a) => 2 ** a, expm1: Math.expm1,
  floor: Math.floor, ge: (a, b) => +(a >= b), gt: (a, b) => +(a > b), is_finite: (a) => +Number.isFinite(a),
  le: (a, b) => +(a <= b), log: Math.log, log1p: Math.log1p, logistic: (a) => 1 / (1 + Math.exp(-a)),
  lt: (a, b) => +(a < b), max: Math.max, min: Math.min, mul: (a, b) => a * b, ne: (a, b) => +(a !== b), neg: (a) => -a,
  not: (a) => +!a, or: (a, b) => a || b, pow: Math.pow, rem: (a, b) => a % b,
  round_away: (a) => Math.sign(a) * Math.round(Math.abs(a)), round_even: roundEven,
  rsqrt: (a) => 1 / Math.sqrt(a), select_n: (which, ...cases) => cases[which], sign: Math.sign, sin: Math.sin,
  sinh: Math.sinh, sqrt: Math.sqrt, square: (a) => a * a, sub: (a, b) => a - b, tan: Math.tan, tanh: Math.tanh,
  trunc: Math.trunc, xor: (a, b) => +(!a !== !b),
};
const REDUCTIONS = {
  reduce_sum: [0, ELEMENTWISE.add], reduce_prod: [1, ELEMENTWISE.mul], reduce_max: [-Infinity, Math.max],
  reduce_min: [Infinity, Math.min], reduce_and: [1, ELEMENTWISE.and], reduce_or: [0, ELEMENTWISE.or],
};

// Rounds a half to the even neighbour.
function roundEven(a) { return Math.abs(a % 1) === .5 ? 2 * Math.round(a / 2) : Math.round(a); }

// Rounds to 16 bits, to the nearest even.
function bfloat16(a) {
  rounded[0] = a;
  bits[0] += 0x7fff + ((bits[0] >> 16) & 1);
  bits[0] &= 0xffff0000;
  return rounded[0];
}

// Returns the function (...inputs) → outputs of a program. Outputs are overwritten by the next call.
export function build(program, constants) {
  const slots = program.sizes.map((size) => new Float64Array(size));
  for (const [slot, from] of program.constants) slots[slot] = constants.subarray(from, from + program.sizes[slot]);
  const steps = program.steps.map(([name, result, ...operands]) => step(name, slots, slots[result], operands));
  const outputs = program.outputs.map((slot) => slots[slot]);
  return (...inputs) => {
    program.inputs.forEach((slot, index) => slots[slot].set(inputs[index]));
    for (const run of steps) run();
    return outputs;
  };
}

function step(name, slots, result, operands) {
  if (name === "take") return take(result, operands[0].map((slot) => slots[slot]), operands[1]);
  if (name === "multiply") return multiply(result, slots[operands[0]], slots[operands[1]], operands[2]);
  if (name in REDUCTIONS) return reduce(result, slots[operands[0]], ...REDUCTIONS[name]);
  if (!(name in ELEMENTWISE)) throw new Error(`unknown operation ${name}`);
  return each(result, operands.map((slot) => slots[slot]), ELEMENTWISE[name]);
}

function each(result, operands, compute) {
  const [a, b] = operands, strides = operands.map((operand) => +(operand.length > 1));
  const [stepA, stepB] = strides, count = result.length;
  if (operands.length === 1) return () => { for (let i = 0; i < count; i++) result[i] = compute(a[i]); };
  if (operands.length === 2)
    return () => { for (let i = 0; i < count; i++) result[i] = compute(a[i * stepA], b[i * stepB]); };
  return () => {
    for (let i = 0; i < count; i++) result[i] = compute(...operands.map((operand, k) => operand[i * strides[k]]));
  };
}

// Without positions, all of the operands, one after the other.
function take(result, operands, positions) {
  const places = [];
  for (const operand of operands) for (let i = 0; i < operand.length; i++) places.push([operand, i]);
  const sources = positions ? positions.map((position) => places[position]) : places;
  return () => { for (let i = 0; i < sources.length; i++) result[i] = sources[i][0][sources[i][1]]; };
}

function reduce(result, rows, start, combine) {
  const width = rows.length / result.length;
  return () => {
    for (let row = 0; row < result.length; row++) {
      let value = start;
      for (let i = 0; i < width; i++) value = combine(value, rows[row * width + i]);
      result[row] = value;
    }
  };
}

// [m, inner] times [inner, n]. Hidden layers of a policy are full of zeros, which are skipped.
function multiply(result, rows, columns, inner) {
  const across = columns.length / inner, down = rows.length / inner;
  return () => {
    result.fill(0);
    for (let row = 0; row < down; row++)
      for (let i = 0; i < inner; i++) {
        const factor = rows[row * inner + i];
        if (factor === 0) continue;
        const from = i * across, to = row * across;
        for (let column = 0; column < across; column++) result[to + column] += factor * columns[from + column];
      }
  };
}
