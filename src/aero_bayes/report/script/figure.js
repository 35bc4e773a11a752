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
