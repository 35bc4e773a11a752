// The series embedded in the page, and small tools of drawing.
const SVG = "http://www.w3.org/2000/svg", WIDTH = 1000;
const store = JSON.parse(document.getElementById("series").textContent);
const arrays = new Map(), links = new Map();

// Data: differences of whole numbers, split into byte planes, deflated; zero stands for a gap.
async function unpack(key) {
  const { d, n, lo, step, even } = store[key], values = new Float64Array(n);
  if (even) return values.map((_, i) => lo + step * i);
  const bytes = Uint8Array.from(atob(d), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const flat = new Uint8Array(await new Response(stream).arrayBuffer());
  let whole = 0;
  for (let i = 0; i < n; i++) {
    const z = flat[i] | (flat[n + i] << 8) | (flat[2 * n + i] << 16);
    whole += (z >>> 1) ^ -(z & 1);
    values[i] = whole === 0 ? NaN : lo + (whole - 1) * step;
  }
  return values;
}
const load = (key) => arrays.get(key) ?? arrays.set(key, unpack(key)).get(key);
// Numbers: the same round ticks as the still picture.
function niceTicks(low, high, most) {
  if (!(high > low) || most < 1) return [];
  const power = 10 ** (Math.floor(Math.log10((high - low) / most)) - 1);
  for (const scale of [1, 10, 100, 1000]) for (const factor of [1, 2, 2.5, 5]) {
    const step = factor * scale * power, first = Math.ceil(low / step - 1e-9), last = Math.floor(high / step + 1e-9);
    if (last - first < most) return Array.from({ length: last - first + 1 }, (_, i) => (first + i) * step);
  }
  return [];
}
const words = (v, digits = 6) => Number.isFinite(v) ? (Math.abs(v) < 1e-12 ? "0" : String(+v.toPrecision(digits)).replace("-", "−")) : "no reading";
const percent = (share) => `${(100 * share).toFixed(2)}%`;
const tenth = (v) => Math.round(v * 10) / 10;
function index(time, x) {
  let low = 0, high = time.length;
  while (low < high) { const mid = (low + high) >> 1; if (time[mid] < x) low = mid + 1; else high = mid; }
  return low;
}
function element(name, attributes, parent, text) {
  const made = document.createElementNS(SVG, name);
  for (const key in attributes) made.setAttribute(key, attributes[key]);
  if (text !== undefined) made.textContent = text;
  parent.append(made);
  return made;
}
function button(textContent, title, act) {
  const made = Object.assign(document.createElement("button"), { type: "button", textContent, title });
  made.setAttribute("aria-label", title);
  made.addEventListener("click", act);
  return made;
}
