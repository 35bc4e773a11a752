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
    cell.group.closest("svg").setAttribute("role", "group"); // no longer a mere picture: it holds sliders
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
