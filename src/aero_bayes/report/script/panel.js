// One pair of axes of a still figure, drawn anew for another stretch of time.
class Panel {
  constructor(group) {
    Object.assign(this, JSON.parse(group.dataset.spec));
    [this.left, this.top, this.width, this.height] = this.box;
    this.group = group;
    this.title = group.querySelector("text");
    this.axis = group.querySelector(".y.axis");
    this.home = this.x;
    this.layers = [...group.querySelectorAll("path[data-spec]")].map((path) => {
      const { stroke, fill } = path.style;
      return { ...JSON.parse(path.dataset.spec), path, colour: stroke && stroke !== "none" ? stroke : fill };
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
  // Least and greatest value of every pixel column within the range.
  reduce(layer, [first, last], wide) {
    const { time, low, high } = layer, columns = Math.round(this.width / wide);
    const from = Math.max(0, index(time, first) - 1), to = Math.min(time.length, index(time, last) + 1);
    layer.fine = to - from <= 2 * columns;
    const size = layer.fine ? to - from : columns, across = columns / (last - first);
    const x = new Float64Array(size), lows = new Float64Array(size).fill(NaN), highs = new Float64Array(size).fill(NaN);
    const sums = layer.k === "mean" ? [new Float64Array(size), new Float64Array(size)] : null;
    for (let i = from; i < to; i++) {
      const at = (time[i] - first) * across, a = this.f * low[i], b = this.f * high[i];
      const c = layer.fine ? i - from : Math.min(columns - 1, Math.max(0, Math.floor(at)));
      x[c] = layer.fine ? at * this.width / columns : c * this.width / columns;
      if (a === a) { if (!(lows[c] <= a)) lows[c] = a; if (sums) { sums[0][c] += a; sums[1][c]++; } }
      if (b === b && !(highs[c] >= b)) highs[c] = b;
    }
    if (sums) {
      const half = layer.fine ? 0 : 4;
      for (let c = 0; c < size; c++) {
        let sum = 0, count = 0;
        for (let k = Math.max(0, c - half); k <= Math.min(size - 1, c + half); k++) { sum += sums[0][k]; count += sums[1][k]; }
        lows[c] = highs[c] = count ? sum / count : NaN;
      }
    }
    Object.assign(layer, { x, lows, highs });
  }
  draw(range, wide) {
    let low = Infinity, high = -Infinity;
    for (const layer of this.layers) {
      this.reduce(layer, range, wide);
      if (layer.k !== "dots") for (let c = 0; c < layer.x.length; c++) { if (layer.lows[c] < low) low = layer.lows[c]; if (layer.highs[c] > high) high = layer.highs[c]; }
    }
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
  }
  // The data go to a canvas, which takes a fifth of the time that changing the paths would.
  paint(context) {
    context.save();
    context.beginPath();
    context.rect(this.left, this.top, this.width, this.height);
    context.clip();
    for (const layer of this.layers) {
      if (layer.k === "mean" && layer.fine) continue;
      const { x, lows, highs, colour, fine } = layer, style = layer.path.style, bare = layer.k === "area" && !layer.u && fine;
      context.fillStyle = context.strokeStyle = ink(colour);
      context.globalAlpha = layer.k === "area" && !bare ? +style.fillOpacity || 1 : 1;
      context.lineWidth = bare ? 1.2 : parseFloat(style.strokeWidth) || 1;
      context.lineJoin = "bevel";
      const at = (c) => this.left + x[c], known = (c) => highs[c] >= lows[c];
      if (layer.k === "dots") {
        const size = parseFloat(style.strokeWidth), edge = (v) => Math.min(Math.max(this.down(v), this.top + size), this.top + this.height - size);
        for (let c = 0; c < x.length; c++) if (known(c)) { context.beginPath(); context.arc(at(c), edge(highs[c]), size / 2, 0, 7); context.fill(); }
        continue;
      }
      if (layer.k === "area" && !fine) {
        const wide = x[1] - x[0];
        for (let c = 0; c < x.length; c++) if (known(c)) { const top = this.down(highs[c]); context.fillRect(at(c), top, wide, Math.max(1, this.down(lows[c]) - top)); }
        continue;
      }
      context.beginPath();
      if (layer.u && fine) {
        let first = true;
        for (let c = 0; c < x.length; c++) if (known(c)) { context[first ? "moveTo" : "lineTo"](at(c), this.down(highs[c])); first = false; }
        for (let c = x.length - 1; c >= 0; c--) if (known(c)) context.lineTo(at(c), this.down(lows[c]));
        context.fill();
        continue;
      }
      let open = false;
      for (let c = 0; c < x.length; c++) {
        if (!known(c)) { open = open && !fine; continue; }
        const y = this.down(lows[c]);
        if (open && layer.held && fine) context.lineTo(at(c), this.down(lows[c - 1]));
        context[open ? "lineTo" : "moveTo"](at(c), y);
        if (y - this.down(highs[c]) > 0.7) context.lineTo(at(c), this.down(highs[c]));
        open = true;
      }
      context.stroke();
      if (bare && this.width / x.length > 5) for (let c = 0; c < x.length; c++) if (known(c)) { context.beginPath(); context.arc(at(c), this.down(lows[c]), DOT, 0, 7); context.fill(); }
    }
    context.restore();
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
