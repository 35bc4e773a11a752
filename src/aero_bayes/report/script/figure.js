// All figures of one recording: they show one stretch of time and one cursor.
class Link {
  constructor() { Object.assign(this, { figures: [], range: null, cursor: null, pending: false }); }
  get whole() {
    const { even, n, lo, step, ends } = store[this.figures[0].panels[0].layers[0].t];
    return even ? [lo, lo + (n - 1) * step] : ends;
  }
  get now() { return this.range ?? this.figures[0].home; }
  show(range) {
    if (range) {
      const [first, last] = this.whole, [low, high] = range;
      const width = Math.min(last - first, Math.max((last - first) / 1e5, high - low)), start = Math.min(last - width, Math.max(first, low));
      range = [start, start + width];
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

// One figure: its panels, its time axis, and what mouse, fingers and keys do on it.
class Figure {
  constructor(box) {
    Object.assign(this, { element: box, svg: box.querySelector("svg.plot"), visible: false, drawn: "", said: "" });
    this.panels = [...box.querySelectorAll("g.panel")].map((group) => new Panel(group));
    this.axis = box.querySelector(".x.axis");
    this.home = this.panels[0].home;
    this.mark = element("rect", { class: "mark", width: 0, height: "100%" }, this.svg);
    this.link = links.get(box.dataset.link) ?? links.set(box.dataset.link, new Link()).get(box.dataset.link);
    this.link.figures.push(this);
    box.tabIndex = 0;
    this.tools();
    this.listen();
    box.addEventListener("keydown", (event) => this.key(event));
    new IntersectionObserver(([seen]) => { this.visible = seen.isIntersecting; this.refresh(); }, { rootMargin: "200px" }).observe(box);
  }
  get range() { return this.link.range ?? this.home; }
  async refresh() {
    this.bar.querySelector(".back").disabled = this.link.range === null;
    if (!this.visible) return;
    if (`${this.link.range ?? ""}` !== this.drawn || this.link.cursor !== null) await (this.ready ??= Promise.all(this.panels.map((p) => p.load())));
    const { range, cursor } = this.link, key = `${range ?? ""}`, [low, high] = this.range;  // as they are once the series are loaded
    if (key !== this.drawn) {
      this.drawn = key;
      const columns = Math.round(this.svg.getBoundingClientRect().width) || WIDTH;
      for (const panel of this.panels) if (range) panel.draw(range, columns); else panel.restore();
      this.ticks();
    }
    this.svg.classList.toggle("pointed", cursor !== null);
    this.said = this.panels.map((p, k) => p.point(cursor, (cursor - low) / (high - low), k === 0)).filter(Boolean).join("; ");
  }
  ticks() {
    const label = this.axis.lastElementChild, { top, height } = this.panels.at(-1), [low, high] = this.range, foot = top + height;
    this.axis.replaceChildren();
    element("line", { class: "base", x2: "100%", y1: foot, y2: foot }, this.axis);
    for (const tick of niceTicks(low, high, 8)) {
      const x = percent((tick - low) / (high - low));
      element("line", { class: "base", x1: x, x2: x, y1: foot, y2: foot + 3 }, this.axis);
      element("text", { class: "tick", x, y: foot + 15, "text-anchor": "middle" }, this.axis, words(tick, 8));
    }
    this.axis.append(label);
  }
  listen() {
    const { svg, link } = this, value = (share) => this.range[0] + share * (this.range[1] - this.range[0]);
    const at = (event) => { const { left, width } = svg.getBoundingClientRect(); return Math.min(1, Math.max(0, (event.clientX - left) / width)); };
    const mark = (a, b) => { this.mark.setAttribute("x", percent(Math.min(a, b))); this.mark.setAttribute("width", percent(Math.abs(a - b))); };
    let start = null;
    svg.addEventListener("pointerdown", (event) => {
      if (event.button) return;
      start = { share: at(event), range: this.range, pan: event.shiftKey || event.pointerType === "touch" };
      try { svg.setPointerCapture(event.pointerId); } catch { /* a pointer that has gone */ }
      if (event.pointerType !== "touch") event.preventDefault();
      this.element.focus({ preventScroll: true });
    });
    svg.addEventListener("pointermove", (event) => {
      const share = at(event);
      if (!start) { link.point(value(share)); return; }
      start.moved ||= Math.abs(share - start.share) > 0.02;
      if (!start.pan) mark(start.share, share);
      else if (start.moved) link.show(start.range.map((end) => end + (start.share - share) * (start.range[1] - start.range[0])));
    });
    const stop = (event) => {
      const share = at(event);
      if (start && event.type === "pointerup") {
        if (!start.pan && Math.abs(share - start.share) > 0.01) link.show([start.share, share].sort((a, b) => a - b).map(value));
        if (start.pan && !start.moved) link.point(value(share));  // a tap
      }
      mark(0, 0);
      start = null;
    };
    for (const name of ["pointerup", "pointercancel"]) svg.addEventListener(name, stop);
    svg.addEventListener("pointerleave", (event) => { if (!start && event.pointerType !== "touch") link.point(null); });
    svg.addEventListener("dblclick", () => link.show(null));
    svg.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !this.element.contains(document.activeElement)) return;
      event.preventDefault();
      if (Math.abs(event.deltaX) > Math.abs(event.deltaY)) link.pan(event.deltaX / 600);
      else link.zoom(Math.exp(event.deltaY / 300), value(at(event)));
    }, { passive: false });
  }
  tools() {
    const { link } = this, actions = [["−", "Zoom out", () => link.zoom(1.6)], ["+", "Zoom in", () => link.zoom(1 / 1.6)],
      ["◂", "Earlier", () => link.pan(-0.3)], ["▸", "Later", () => link.pan(0.3)], ["Reset", "Reset to the still picture", () => link.show(null)]];
    const said = (className) => Object.assign(document.createElement("span"), { className });
    this.bar = Object.assign(document.createElement("div"), { className: "tools" });
    this.bar.append(...actions.map(([label, title, act]) => button(label, title, act)));
    this.bar.lastChild.className = "back";
    const hint = said("hint");
    hint.textContent = "drag: zoom · shift-drag: move · Ctrl-wheel: zoom · keys + − ← → 0, shift ← → reads values";
    this.live = said("spoken");
    this.live.setAttribute("aria-live", "polite");
    this.bar.append(hint, this.live);
    this.svg.before(this.bar);
  }
  async key(event) {
    if (event.target !== this.element || event.ctrlKey || event.metaKey || event.altKey) return;
    const { link } = this, [low, high] = this.range, sign = event.key === "ArrowLeft" ? -1 : 1;
    if (/^Arrow(Left|Right)$/.test(event.key) && event.shiftKey) {
      const x = (link.cursor ?? 0.5 * (low + high)) + sign * (high - low) / 100;
      link.cursor = Math.min(high, Math.max(low, x));
      await this.refresh();
      link.schedule();
      this.live.textContent = `${words(link.cursor, 5)} s; ${this.said}`;
    } else if (/^Arrow(Left|Right)$/.test(event.key)) link.pan(0.2 * sign);
    else if (event.key === "+" || event.key === "=") link.zoom(1 / 1.6);
    else if (event.key === "-") link.zoom(1.6);
    else if (event.key === "0" || event.key === "Escape") { link.cursor = null; link.show(null); }
    else return;
    event.preventDefault();
  }
}
