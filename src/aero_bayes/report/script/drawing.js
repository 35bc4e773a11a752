// One drawing of a figure: its panels, its time axis, and what mouse and fingers do on it.
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
    const { link } = this.figure, key = () => (link.range ? `${link.range}` : "");
    if (key() !== (this.drawn ?? "") || link.cursor !== null) await (this.ready ??= Promise.all(this.panels.map((p) => p.load())));
    if (key() !== (this.drawn ?? "")) {
      this.drawn = key();
      for (const panel of this.panels) if (link.range) panel.draw(this.range); else panel.restore();
      this.ticks();
    }
    this.said = this.panels.map((p, k) => p.point(link.cursor, this.narrow, k === 0)).filter(Boolean).join("; ");
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
    const { svg, figure } = this;
    const value = (share) => this.range[0] + share * (this.range[1] - this.range[0]);
    let start = null;
    svg.addEventListener("pointerdown", (event) => {
      if (event.button) return;
      start = { share: this.at(event), range: this.range, pan: event.shiftKey || event.pointerType === "touch" };
      try { svg.setPointerCapture(event.pointerId); } catch { /* a pointer that has gone */ }
      if (event.pointerType !== "touch") event.preventDefault();
      figure.element.focus({ preventScroll: true });
    });
    svg.addEventListener("pointermove", (event) => {
      const share = this.at(event);
      if (!start) { figure.link.point(value(share)); return; }
      start.moved ||= Math.abs(share - start.share) > 0.02;
      if (start.pan && start.moved) {
        const shift = (start.share - share) * (start.range[1] - start.range[0]);
        figure.link.show([start.range[0] + shift, start.range[1] + shift]);
      } else if (!start.pan) {
        const ends = [start.share, share].sort((a, b) => a - b);
        this.mark.setAttribute("x", this.left + ends[0] * this.width);
        this.mark.setAttribute("width", (ends[1] - ends[0]) * this.width);
      }
    });
    const stop = (event) => {
      if (start && !start.pan && event.type === "pointerup") {
        const ends = [start.share, this.at(event)].sort((a, b) => a - b);
        if (ends[1] - ends[0] > 0.01) figure.link.show(ends.map(value));
      }
      if (start?.pan && !start.moved && event.type === "pointerup") figure.link.point(value(this.at(event)));  // a tap
      this.mark.setAttribute("width", 0);
      start = null;
    };
    for (const name of ["pointerup", "pointercancel"]) svg.addEventListener(name, stop);
    svg.addEventListener("pointerleave", (event) => { if (!start && event.pointerType !== "touch") figure.link.point(null); });
    svg.addEventListener("dblclick", () => figure.link.show(null));
    svg.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !figure.element.contains(document.activeElement)) return;
      event.preventDefault();
      if (Math.abs(event.deltaX) > Math.abs(event.deltaY)) figure.link.pan(event.deltaX / 600);
      else figure.link.zoom(Math.exp(event.deltaY / 300), value(this.at(event)));
    }, { passive: false });
  }
}
