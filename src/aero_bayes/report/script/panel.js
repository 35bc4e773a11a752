// One pair of axes of a still figure, drawn anew for another stretch of time.
class Panel {
  constructor(group) {
    Object.assign(this, JSON.parse(group.dataset.spec));
    [this.left, this.top, this.width, this.height] = this.box;
    this.group = group;
    this.title = group.querySelector("text");
    this.axis = group.querySelector(".y.axis");
    this.home = this.x;
    this.stillAxis = this.axis.innerHTML;
    this.layers = [...group.querySelectorAll("path[data-spec]")].map((path) => {
      const { stroke, fill } = path.style;
      return { ...JSON.parse(path.dataset.spec), path, colour: stroke && stroke !== "none" ? stroke : fill, still: path.getAttribute("d"), style: path.style.cssText };
    });
    this.line = element("path", { class: "cursor" }, group);
    const end = this.left + this.width;
    this.readout = element("text", { class: "readout", x: end, y: this.top - 13, "text-anchor": "end", "font-size": 11.5 }, group);
  }
  async load() {
    for (const layer of this.layers) {
      layer.time = await load(layer.t);
      const low = await total(layer.y);
      layer.high = layer.u ? await total(layer.u) : low;
      layer.low = low;
    }
  }
  // Least and greatest value of every pixel column within the range; each sample where there are fewer than columns.
  reduce(layer, [first, last]) {
    const { time, low, high } = layer, columns = Math.round(this.width), scale = this.width / (last - first);
    const from = Math.max(0, index(time, first) - 1), to = Math.min(time.length, index(time, last) + 1), found = [];
    layer.fine = to - from <= columns;
    for (let i = from, column = -1; i < to; i++) {
      const at = (time[i] - first) * scale, own = layer.fine ? i : Math.floor(at);
      if (own !== column) found.push({ x: layer.fine ? at : own, low: NaN, high: NaN, sum: 0, count: 0 });
      column = own;
      const group = found.at(-1), a = this.f * low[i], b = this.f * high[i];
      if (a === a) { if (!(group.low <= a)) group.low = a; group.sum += a; group.count++; }
      if (b === b && !(group.high >= b)) group.high = b;
    }
    if (layer.k !== "mean") return found;
    const near = (k) => found.slice(Math.max(0, k - 4), k + 5).reduce(([sum, count], g) => [sum + g.sum, count + g.count], [0, 0]);
    return found.map((g, k) => { const [sum, count] = near(k), mean = sum / count; return { x: g.x, low: mean, high: mean }; });
  }
  draw(range) {
    const known = this.layers.map((layer) => this.reduce(layer, range).filter((g) => g.high >= g.low || g.high !== g.high));
    let low = Infinity, high = -Infinity;
    this.layers.forEach((layer, k) => { if (layer.k !== "dots") for (const g of known[k]) { if (g.low < low) low = g.low; if (g.high > high) high = g.high; } });
    if (this.fixed || !(high >= low)) [low, high] = this.y;
    else {
      const spare = 0.08 * (high - low) || 0.1 * Math.abs(high) || 1;
      [low, high] = [low - spare, high + spare];
    }
    this.range = range;
    this.down = (v) => tenth(this.top + this.height * (1 - (v - low) / (high - low)));
    this.axis.replaceChildren();
    const right = this.left + this.width, foot = this.top + this.height;
    for (const tick of niceTicks(low, high, this.ticks)) {
      element("path", { d: `M${this.left} ${this.down(tick)}H${right}`, class: "grid" }, this.axis);
      element("text", { x: this.left - 6, y: this.down(tick) + 4, "text-anchor": "end", "font-size": 11.5, class: "tick" }, this.axis, words(tick));
    }
    element("path", { d: `M${this.left} ${foot}H${right}`, class: "grid" }, this.axis);
    for (const level of this.levels) if (level > low && level < high) element("path", { d: `M${this.left} ${this.down(level)}H${right}`, class: "level" }, this.axis);
    this.layers.forEach((layer, k) => this.trace(layer, known[k]));
  }
  // The path of a layer: a line through each group's ends, a band, or dots. A cloud of few samples is a line with dots.
  trace(layer, groups) {
    const { path, k, u, fine, held } = layer, bare = k === "area" && !u && fine, x = (g) => tenth(this.left + g.x), down = this.down;
    const size = parseFloat(path.style.strokeWidth) || 1, edge = (v) => Math.min(Math.max(down(v), this.top + size), this.top + this.height - size);
    let d = "", open = null;
    if (k === "mean" && fine) groups = [];
    if (k === "area" && !bare && groups.length) d = `M${groups.map((g) => `${x(g)} ${down(g.high)}`).join("L")}L${groups.toReversed().map((g) => `${x(g)} ${down(g.low)}`).join("L")}Z`;
    else for (const g of groups) {
      if (g.high !== g.high) { open = fine ? null : open; continue; }
      if (k === "dots") { d += `M${x(g)} ${edge(g.high)}h0`; continue; }
      if (open && held && fine) d += `H${x(g)}`;
      d += `${open ? "L" : "M"}${x(g)} ${down(g.low)}`;
      if (down(g.low) - down(g.high) > 0.7) d += `V${down(g.high)}`;
      if (bare && this.width / groups.length > 5) d += `m-1.5 0h3m-1.5 -1.5v3m0 -1.5`;
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
    this.range = this.home;
  }
  values(x) {
    const found = [];
    for (const layer of this.layers.filter((l) => l.n)) {
      let i = Math.min(layer.time.length - 1, index(layer.time, x));
      if (i > 0 && (layer.held ? layer.time[i] > x : x - layer.time[i - 1] < layer.time[i] - x)) i--;
      const text = layer.u ? `${words(this.f * layer.low[i], 4)} … ${words(this.f * layer.high[i], 4)}` : words(this.f * layer.low[i], 4);
      found.push([layer.n, text, layer.colour]);
    }
    return found;
  }
  point(x, narrow, first) {
    const range = this.range ?? this.home, at = this.left + this.width * (x - range[0]) / (range[1] - range[0]);
    const inside = x !== null && at >= this.left && at <= this.left + this.width;
    this.line.setAttribute("d", inside ? `M${tenth(at)} ${this.top}V${this.top + this.height}` : "");
    this.readout.replaceChildren();
    if (this.title) this.title.style.display = inside && narrow ? "none" : "";
    if (!inside) return "";
    if (first) element("tspan", { class: "time" }, this.readout, `t = ${words(x, 5)} s`);
    for (const [name, text, colour] of this.values(x)) element("tspan", { dx: this.readout.firstChild ? 9 : 0, style: `fill:${colour}` }, this.readout, `${name} ${text}`);
    return `${this.title?.textContent}: ${this.values(x).map(([n, t]) => `${n} ${t}`).join(", ")}`;
  }
}
