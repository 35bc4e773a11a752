"use strict";
(() => {
  // Draws the page's still figures anew for another stretch of time, from the series embedded in the page.
  const SVG = "http://www.w3.org/2000/svg", NARROW = 600, DOT = 2.2;
  const store = JSON.parse(document.getElementById("series").textContent);
  const arrays = new Map(), sums = new Map(), links = new Map();

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
  async function total(terms) {
    const name = JSON.stringify(terms);
    if (!sums.has(name)) {
      const parts = await Promise.all(terms.map(([, key]) => load(key)));
      const sum = terms.length === 1 && terms[0][0] === 1 ? parts[0] : new Float64Array(parts[0].length);
      if (sum !== parts[0]) parts.forEach((part, k) => part.forEach((v, i) => { sum[i] += terms[k][0] * v; }));
      sums.set(name, sum);
    }
    return sums.get(name);
  }

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
  const ink = (colour) => getComputedStyle(document.documentElement).getPropertyValue(colour.replace(/^var\(|\)$/g, ""));
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
    reduce(layer, [first, last]) {
      const { time, low, high } = layer, columns = Math.round(this.width);
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
    draw(range) {
      let low = Infinity, high = -Infinity;
      for (const layer of this.layers) {
        this.reduce(layer, range);
        for (let c = 0; c < layer.x.length; c++) { if (layer.lows[c] < low) low = layer.lows[c]; if (layer.highs[c] > high) high = layer.highs[c]; }
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
        context.lineJoin = "round";
        const at = (c) => this.left + x[c], known = (c) => highs[c] >= lows[c];
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
          if (highs[c] !== lows[c]) context.lineTo(at(c), this.down(highs[c]));
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

  class Drawing {
    constructor(svg, figure) {
      this.svg = svg;
      this.figure = figure;
      this.panels = [...svg.querySelectorAll("g.panel[data-spec]")].map((group) => new Panel(group));
      this.axis = svg.querySelector(".x.axis");
      this.narrow = svg.viewBox.baseVal.width < NARROW;
      this.home = this.panels[0].home;
      const { left, width } = this.panels[0];
      this.mark = element("rect", { class: "mark", y: 0, height: svg.viewBox.baseVal.height, width: 0, x: left }, svg);
      Object.assign(this, { left, width });
      this.listen();
    }
    get shown() { return this.svg.getBoundingClientRect().width > 0; }
    get range() { return this.figure.link.range ?? this.home; }
    async refresh() {
      if (!this.shown || !this.figure.visible) return;
      const { link } = this.figure, key = () => (link.range ? link.range.join() : "");
      if (key() !== (this.drawn ?? "") || link.cursor !== null) await (this.ready ??= Promise.all(this.panels.map((p) => p.load())));
      if (key() !== (this.drawn ?? "")) {
        this.drawn = key();
        for (const panel of this.panels) panel.draw(this.range);
        this.paint();
        this.ticks();
      }
      this.said = this.panels.map((p, k) => p.point(link.cursor, this.narrow, k === 0)).filter(Boolean).join("; ");
    }
    paint() {
      const { width, height } = this.svg.viewBox.baseVal, box = this.svg.getBoundingClientRect(), zoomed = this.figure.link.range !== null;
      const scale = Math.min(2, devicePixelRatio) * box.width / width;
      if (!this.canvas) {
        this.canvas = document.createElement("canvas");
        this.canvas.setAttribute("aria-hidden", "true");
        this.svg.before(this.canvas);
      }
      for (const panel of this.panels) for (const layer of panel.layers) layer.path.style.display = zoomed ? "none" : "";
      this.canvas.style.display = zoomed ? "" : "none";
      if (!zoomed) return;
      if (this.canvas.width !== Math.round(width * scale)) Object.assign(this.canvas, { width: Math.round(width * scale), height: Math.round(height * scale) });
      const context = this.canvas.getContext("2d");
      context.setTransform(scale, 0, 0, scale, 0, 0);
      context.clearRect(0, 0, width, height);
      for (const panel of this.panels) panel.paint(context);
    }
    ticks() {
      const foot = this.panels.at(-1).top + this.panels.at(-1).height, [low, high] = this.range;
      const label = [...this.axis.querySelectorAll("text")].at(-1);
      this.axis.replaceChildren();
      element("path", { d: `M${this.left} ${foot}H${this.left + this.width}`, class: "base" }, this.axis);
      for (const tick of niceTicks(low, high, this.narrow ? 4 : 8)) {
        const x = tenth(this.left + this.width * (tick - low) / (high - low));
        element("path", { d: `M${x} ${foot}v3`, class: "base" }, this.axis);
        element("text", { x, y: foot + 15, "text-anchor": "middle", "font-size": 11.5, class: "tick" }, this.axis, words(tick, 8));
      }
      this.axis.append(label);
    }
    at(event) {
      const box = this.svg.getBoundingClientRect(), scale = this.svg.viewBox.baseVal.width / box.width;
      return Math.min(1, Math.max(0, ((event.clientX - box.left) * scale - this.left) / this.width));
    }
    listen() {
      const { svg, figure } = this, fingers = new Map();
      const value = (share) => this.range[0] + share * (this.range[1] - this.range[0]);
      let start = null;
      svg.addEventListener("pointerdown", (event) => {
        if (event.button) return;
        fingers.set(event.pointerId, this.at(event));
        start = { share: this.at(event), range: this.range, pan: event.shiftKey || event.pointerType === "touch" };
        try { svg.setPointerCapture(event.pointerId); } catch { /* a pointer that has gone */ }
        if (event.pointerType !== "touch") event.preventDefault();
        figure.element.focus({ preventScroll: true });
      });
      svg.addEventListener("pointermove", (event) => {
        const share = this.at(event);
        if (!start) { figure.link.point(value(share)); return; }
        const before = [...fingers.values()];
        fingers.set(event.pointerId, share);
        const now = [...fingers.values()];
        if (now.length === 2) {
          const [gap, was] = [Math.abs(now[0] - now[1]), Math.abs(before[0] - before[1])];
          if (gap > 0.02 && was > 0.02) figure.link.zoom(was / gap, value(0.5 * (now[0] + now[1])));
        } else if (start.pan) {
          const shift = (start.share - share) * (start.range[1] - start.range[0]);
          figure.link.show([start.range[0] + shift, start.range[1] + shift]);
        } else {
          const ends = [start.share, share].sort((a, b) => a - b);
          this.mark.setAttribute("x", this.left + ends[0] * this.width);
          this.mark.setAttribute("width", (ends[1] - ends[0]) * this.width);
        }
      });
      const stop = (event) => {
        fingers.delete(event.pointerId);
        if (start && !start.pan && event.type === "pointerup") {
          const ends = [start.share, this.at(event)].sort((a, b) => a - b);
          if (ends[1] - ends[0] > 0.01) figure.link.show(ends.map(value));
        }
        this.mark.setAttribute("width", 0);
        if (!fingers.size) start = null;
      };
      for (const name of ["pointerup", "pointercancel"]) svg.addEventListener(name, stop);
      svg.addEventListener("pointerleave", () => { if (!start) figure.link.point(null); });
      svg.addEventListener("dblclick", () => figure.link.show(null));
      svg.addEventListener("wheel", (event) => {
        if (!event.ctrlKey && !figure.element.contains(document.activeElement)) return;
        event.preventDefault();
        if (Math.abs(event.deltaX) > Math.abs(event.deltaY)) figure.link.pan(event.deltaX / 600);
        else figure.link.zoom(Math.exp(event.deltaY / 300), value(this.at(event)));
      }, { passive: false });
    }
  }

  // All figures of one recording: they show one stretch of time and one cursor.
  class Link {
    constructor() { Object.assign(this, { figures: [], range: null, cursor: null, pending: false }); }
    get whole() {
      const keys = this.figures.flatMap((f) => f.drawings.flatMap((d) => d.panels.flatMap((p) => p.layers.map((l) => l.t))));
      const { even, n, lo, step, ends } = store[keys[0]];
      return even ? [lo, lo + (n - 1) * step] : ends;
    }
    get now() { return this.range ?? this.figures.map((f) => f.drawings[0].home)[0]; }
    show(range) {
      if (range) {
        const [first, last] = this.whole, least = (last - first) / 1e5;
        let [low, high] = range;
        const width = Math.min(last - first, Math.max(least, high - low));
        low = Math.min(last - width, Math.max(first, low));
        range = [low, low + width];
      }
      this.range = range;
      this.schedule();
    }
    zoom(factor, about) {
      const [low, high] = this.now;
      about ??= this.cursor ?? 0.5 * (low + high);
      this.show([about - (about - low) * factor, about + (high - about) * factor]);
    }
    pan(share) { const [low, high] = this.now, by = share * (high - low); this.show([low + by, high + by]); }
    point(x) { if (x !== this.cursor) { this.cursor = x; this.schedule(); } }
    schedule() {
      if (this.pending) return;
      this.pending = true;
      requestAnimationFrame(async () => {
        this.pending = false;
        for (const figure of this.figures) await figure.refresh();
      });
    }
  }

  class Figure {
    constructor(box) {
      this.element = box;
      this.visible = false;
      this.link = links.get(box.dataset.link) ?? links.set(box.dataset.link, new Link()).get(box.dataset.link);
      this.link.figures.push(this);
      this.drawings = [...box.querySelectorAll("svg.plot")].map((svg) => new Drawing(svg, this));
      box.tabIndex = 0;
      this.tools();
      box.addEventListener("keydown", (event) => this.key(event));
      new IntersectionObserver(([seen]) => { this.visible = seen.isIntersecting; this.refresh(); }, { rootMargin: "200px" }).observe(box);
    }
    async refresh() {
      for (const drawing of this.drawings) await drawing.refresh();
      for (const button of this.element.querySelectorAll(".tools .back")) button.disabled = this.link.range === null;
    }
    tools() {
      const bar = document.createElement("div"), actions = [["−", "Zoom out", () => this.link.zoom(1.6)], ["+", "Zoom in", () => this.link.zoom(1 / 1.6)],
        ["◂", "Earlier", () => this.link.pan(-0.3)], ["▸", "Later", () => this.link.pan(0.3)], ["Reset", "Reset to the still picture", () => this.link.show(null)]];
      bar.className = "tools";
      for (const [label, title, act] of actions) {
        const button = document.createElement("button");
        Object.assign(button, { type: "button", textContent: label, title });
        button.setAttribute("aria-label", title);
        if (label === "Reset") button.className = "back";
        button.addEventListener("click", act);
        bar.append(button);
      }
      const hint = document.createElement("span");
      hint.className = "hint";
      hint.textContent = "drag: zoom · shift-drag: move · Ctrl-wheel: zoom · keys + − ← → 0, shift ← → reads values";
      this.live = document.createElement("span");
      this.live.className = "spoken";
      this.live.setAttribute("aria-live", "polite");
      bar.append(hint, this.live);
      this.element.querySelector(".stage").before(bar);
    }
    async key(event) {
      if (event.target !== this.element || event.ctrlKey || event.metaKey || event.altKey) return;
      const { link } = this, [low, high] = link.range ?? this.drawings[0].home, sign = event.key === "ArrowLeft" ? -1 : 1;
      if (event.key.startsWith("Arrow") && event.shiftKey && /Left|Right/.test(event.key)) {
        const x = (link.cursor ?? 0.5 * (low + high)) + sign * (high - low) / 100;
        link.cursor = Math.min(high, Math.max(low, x));
        await this.refresh();
        link.schedule();
        this.live.textContent = `${words(link.cursor, 5)} s; ${this.drawings.find((d) => d.shown)?.said ?? ""}`;
      } else if (/^Arrow(Left|Right)$/.test(event.key)) link.pan(0.2 * sign);
      else if (event.key === "+" || event.key === "=") link.zoom(1 / 1.6);
      else if (event.key === "-") link.zoom(1.6);
      else if (event.key === "0" || event.key === "Escape") { link.cursor = null; link.show(null); }
      else return;
      event.preventDefault();
    }
  }

  // Draws of the posterior: those that are marked in one cell are marked in all.
  class Pairs {
    constructor(box) {
      this.box = box;
      this.live = Object.assign(document.createElement("p"), { className: "brushed", textContent: "Drag over a cell to mark draws in all of them; on a histogram, keys ← → move the mark, Esc takes it away." });
      this.live.setAttribute("aria-live", "polite");
      box.querySelector(".stage").before(this.live);
      this.cells = [...box.querySelectorAll("g.cell")].map((group) => ({ ...JSON.parse(group.dataset.spec), group }));
      this.load();
    }
    async load() {
      this.draws = {};
      for (const name of new Set(this.cells.map((c) => c.x))) this.draws[name] = await load(`draws/${name}`);
      for (const cell of this.cells) {
        cell.cloud = element("path", { class: "draws" }, cell.group);
        cell.picked = element("path", { class: "draws picked" }, cell.group);
        cell.brush = element("rect", { class: "mark", width: 0, height: 0 }, cell.group);
        cell.cover = element("rect", { x: cell.box[0], y: cell.box[1], width: cell.box[2], height: cell.box[2], class: "cover" }, cell.group);
        this.listen(cell);
      }
      this.draw(null);
    }
    place(cell, i) {
      const [left, top, side] = cell.box, across = (v, [low, high]) => (v - low) / (high - low);
      const x = across(this.draws[cell.x][i], cell.rx);
      return [left + side * x, cell.y ? top + side * (1 - across(this.draws[cell.y][i], cell.ry)) : top + side * (0.97 - 0.12 * ((i * 0.618) % 1))];
    }
    draw(chosen) {
      const size = this.draws[this.cells[0].x].length;
      for (const cell of this.cells) {
        let all = "", picked = "";
        for (let i = 0; i < size; i++) {
          const [x, y] = this.place(cell, i), [left, top, side] = cell.box;
          if (x < left || x > left + side || y < top || y > top + side) continue;
          if (chosen?.has(i)) picked += `M${tenth(x)} ${tenth(y)}h0`; else if (cell.y) all += `M${tenth(x)} ${tenth(y)}h0`;
        }
        cell.cloud.setAttribute("d", all);
        cell.picked.setAttribute("d", picked);
      }
    }
    pick(cell, x1, x2, y1, y2) {
      const chosen = new Set(), size = this.draws[cell.x].length, [left, top, side] = cell.box;
      for (let i = 0; i < size; i++) { const [x, y] = this.place(cell, i); if (x >= x1 && x <= x2 && (!cell.y || (y >= y1 && y <= y2))) chosen.add(i); }
      for (const other of this.cells) other.brush.setAttribute("width", 0);
      const set = { x: x1, width: x2 - x1, y: cell.y ? y1 : top, height: cell.y ? y2 - y1 : side };
      for (const key in set) cell.brush.setAttribute(key, set[key]);
      this.draw(chosen);
      const value = (x) => words(cell.rx[0] + (cell.rx[1] - cell.rx[0]) * (x - left) / side, 4);
      this.live.textContent = `${chosen.size} of ${size} draws marked, ${cell.x} from ${value(x1)} to ${value(x2)}` + this.medians(chosen, cell.x);
    }
    medians(chosen, without) {
      const middle = (values) => values.sort()[values.length >> 1];
      return chosen.size ? "; medians there: " + Object.keys(this.draws).filter((n) => n !== without).map((n) => `${n} ${words(middle(Float64Array.from(chosen, (i) => this.draws[n][i])), 4)}`).join(", ") : "";
    }
    clear() { for (const cell of this.cells) cell.brush.setAttribute("width", 0); this.draw(null); this.live.textContent = "No draws are marked."; }
    listen(cell) {
      const svg = cell.group.ownerSVGElement, [left, top, side] = cell.box;
      const at = (event) => {
        const p = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
        return [Math.min(left + side, Math.max(left, p.x)), Math.min(top + side, Math.max(top, p.y))];
      };
      let start = null;
      cell.cover.addEventListener("pointerdown", (event) => { start = at(event); cell.cover.setPointerCapture(event.pointerId); event.preventDefault(); });
      cell.cover.addEventListener("pointermove", (event) => {
        if (!start) return;
        const now = at(event), sort = (a, b) => (a < b ? [a, b] : [b, a]);
        this.pick(cell, ...sort(start[0], now[0]), ...sort(start[1], now[1]));
      });
      cell.cover.addEventListener("pointerup", (event) => { const now = at(event); if (start && Math.hypot(now[0] - start[0], now[1] - start[1]) < 3) this.clear(); start = null; });
      if (cell.y) return;
      let fifth = -1;
      cell.cover.setAttribute("tabindex", 0);
      cell.cover.setAttribute("role", "slider");
      cell.cover.setAttribute("aria-label", `Mark draws by ${cell.x}`);
      for (const [key, value] of [["valuemin", 1], ["valuemax", 8], ["valuenow", 1]]) cell.cover.setAttribute(`aria-${key}`, value);
      cell.cover.addEventListener("keydown", (event) => {
        const step = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 }[event.key];
        if (event.key === "Escape") this.clear();
        if (!step) return;
        fifth = Math.min(7, Math.max(0, fifth + step));
        cell.cover.setAttribute("aria-valuenow", fifth + 1);
        this.pick(cell, left + side * fifth / 8, left + side * (fifth + 1) / 8, top, top + side);
        event.preventDefault();
      });
    }
  }

  document.documentElement.classList.add("scripted");
  for (const box of document.querySelectorAll("figure[data-link]")) new Figure(box);
  for (const box of document.querySelectorAll("figure.pairs")) new Pairs(box);
  const again = () => { for (const link of links.values()) { for (const f of link.figures) for (const d of f.drawings) d.drawn = undefined; link.schedule(); } };
  addEventListener("resize", again);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", again);
})();
