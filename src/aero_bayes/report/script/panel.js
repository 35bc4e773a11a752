// One pair of axes of a still figure, drawn anew for another stretch of time.
class Panel {
  constructor(group) {
    Object.assign(this, JSON.parse(group.dataset.spec));
    this.title = group.querySelector("text").textContent;
    this.axis = group.querySelector(".y.axis");
    this.home = this.x;
    this.stillAxis = this.axis.innerHTML;
    this.layers = [...group.querySelectorAll("path[data-spec]")].map((path) => {
      const { stroke, fill } = path.style;
      return { ...JSON.parse(path.dataset.spec), path, colour: stroke && stroke !== "none" ? stroke : fill, still: path.getAttribute("d"), style: path.style.cssText };
    });
    this.line = element("line", { class: "cursor", y1: this.top, y2: this.top }, group);
    this.readout = element("text", { class: "readout", x: "100%", y: this.top - 13, "text-anchor": "end" }, group);
  }
  async load() {
    for (const layer of this.layers) {
      [layer.time, layer.low] = await Promise.all([load(layer.t), load(layer.y)]);
      layer.high = layer.u ? await load(layer.u) : layer.low;
    }
  }
  // Least and greatest value of every pixel column within the range; each sample where there are fewer than columns.
  reduce(layer, [first, last], columns) {
    const { time, low, high } = layer, scale = WIDTH / (last - first), step = WIDTH / columns;
    const from = Math.max(0, index(time, first) - 1), to = Math.min(time.length, index(time, last) + 1), found = [];
    layer.fine = to - from <= columns;
    for (let i = from, column = -1; i < to; i++) {
      const at = (time[i] - first) * scale, own = layer.fine ? i : Math.floor(at / step);
      if (own !== column) found.push({ x: layer.fine ? at : own * step, low: NaN, high: NaN, sum: 0, count: 0 });
      column = own;
      const group = found.at(-1), a = low[i], b = high[i];
      if (a === a) { if (!(group.low <= a)) group.low = a; group.sum += a; group.count++; }
      if (b === b && !(group.high >= b)) group.high = b;
    }
    if (layer.k !== "mean") return found;
    const near = (k) => found.slice(Math.max(0, k - 4), k + 5).reduce(([sum, count], g) => [sum + g.sum, count + g.count], [0, 0]);
    return found.map((g, k) => { const [sum, count] = near(k), mean = sum / count; return { x: g.x, low: mean, high: mean }; });
  }
  draw(range, columns) {
    const known = this.layers.map((layer) => this.reduce(layer, range, columns));
    let [low, high] = [Infinity, -Infinity];
    this.layers.forEach((layer, k) => { if (layer.k !== "dots") for (const g of known[k]) { if (g.low < low) low = g.low; if (g.high > high) high = g.high; } });
    const spare = 0.08 * (high - low) || 0.1 * Math.abs(high) || 1;
    [low, high] = this.fixed || !(high >= low) ? this.y : [low - spare, high + spare];
    this.down = (v) => tenth(this.height * (1 - (v - low) / (high - low)));
    this.axis.replaceChildren();
    const rule = (y, kind) => element("line", { class: kind, x2: "100%", y1: y, y2: y }, this.axis);
    for (const tick of niceTicks(low, high, this.ticks)) {
      const y = this.top + this.down(tick);
      rule(y, "grid");
      element("text", { class: "tick", x: -6, y: y + 4, "text-anchor": "end" }, this.axis, words(tick));
    }
    rule(this.top + this.height, "grid");
    for (const level of this.levels) if (level > low && level < high) rule(this.top + this.down(level), "level");
    this.layers.forEach((layer, k) => this.trace(layer, known[k]));
  }
  // The path of a layer: a line through each group's ends, a band, or dots. A cloud of few samples is a line.
  trace(layer, groups) {
    const { path, k, u, fine, held } = layer, bare = k === "area" && !u && fine, x = (g) => tenth(g.x), down = this.down;
    const size = parseFloat(path.style.strokeWidth) || 1, edge = (v) => Math.min(Math.max(down(v), size), this.height - size);
    let d = "", open = null;
    if (k === "mean" && fine) groups = [];
    if (k === "area" && !bare) groups = groups.filter((g) => g.high >= g.low);
    if (k === "area" && !bare && groups.length) d = `M${groups.map((g) => `${x(g)} ${down(g.high)}`).join("L")}L${groups.toReversed().map((g) => `${x(g)} ${down(g.low)}`).join("L")}Z`;
    else for (const g of groups) {
      if (g.high !== g.high) { open = fine ? null : open; continue; }
      if (k === "dots") { d += `M${x(g)} ${edge(g.high)}h0`; continue; }
      if (open && held && fine) d += `H${x(g)}`;
      d += `${open ? "L" : "M"}${x(g)} ${down(g.low)}`;
      if (down(g.low) - down(g.high) > 0.7) d += `V${down(g.high)}`;
      open = g;
    }
    path.setAttribute("d", d);
    path.dataset.drawn = "";
    path.style.cssText = bare ? `fill:none;stroke:${layer.colour};stroke-width:1.2` : layer.style;
  }
  // The still picture again.
  restore() {
    for (const { path, still, style } of this.layers) { path.setAttribute("d", still); path.style.cssText = style; delete path.dataset.drawn; }
    this.axis.innerHTML = this.stillAxis;
  }
  values(x) {
    return this.layers.filter((layer) => layer.n).map(({ n, u, held, time, low, high, colour }) => {
      let i = Math.min(time.length - 1, index(time, x));
      if (i > 0 && (held ? time[i] > x : x - time[i - 1] < time[i] - x)) i--;
      return [n, u ? `${words(low[i], 4)} … ${words(high[i], 4)}` : words(low[i], 4), colour];
    });
  }
  // The cursor at a time, a share of the width; what is read there, in words.
  point(x, share, first) {
    const inside = x !== null && share >= 0 && share <= 1, found = inside ? this.values(x) : [];
    for (const end of ["x1", "x2"]) this.line.setAttribute(end, percent(share));
    this.line.setAttribute("y2", this.top + (inside ? this.height : 0));
    this.readout.replaceChildren();
    if (inside && first) element("tspan", { class: "time" }, this.readout, `t = ${words(x, 5)} s`);
    for (const [name, text, colour] of found) element("tspan", { dx: this.readout.firstChild ? 9 : 0, style: `fill:${colour}` }, this.readout, `${name} ${text}`);
    return inside ? `${this.title}: ${found.map(([n, t]) => `${n} ${t}`).join(", ")}` : "";
  }
}
