// The page of a fleet: the rig under the cursor, in all figures at once; a click leads to its page.
document.documentElement.classList.add("scripted");
const rigs = JSON.parse(document.getElementById("rigs").textContent);
const page = (rig) => `rigs/${encodeURIComponent(rigs[rig])}/report.html`;
const drawings = [];

class Ranks {
  constructor(group) {
    this.svg = group.ownerSVGElement;
    Object.assign(this, JSON.parse(group.dataset.spec));
    drawings.push(this);
    this.svg.style.cursor = "crosshair";
    this.svg.addEventListener("pointermove", (event) => this.point(event));
    this.svg.addEventListener("pointerleave", () => show());
    this.svg.addEventListener("click", async (event) => { const rig = await this.at(event); if (rig !== undefined && !event.target.closest("a")) location.href = page(rig); });
  }
  async ready() {
    if (!this.order) {
      this.values = await load(this.k);
      const order = Array.from(this.values.keys()).filter((rig) => Number.isFinite(this.values[rig]));
      order.sort((a, b) => this.values[a] - this.values[b] || a - b);
      this.rank = new Map(order.map((rig, rank) => [rig, rank]));
      this.order = order;
    }
    return this;
  }
  place(rig) {
    const [left, top, width, height] = this.box, [low, high] = this.x, value = this.values[rig];
    if (!Number.isFinite(value)) return undefined;
    const at = this.log ? Math.log(value) : value;
    return [left + width * (at - low) / (high - low), top + height * (1 - (this.rank.get(rig) + 0.5) / this.order.length)];
  }
  // The nearest point: ranks about the cursor's height are enough to look at.
  async at(event) {
    await this.ready();
    const box = this.svg.getBoundingClientRect(), scale = this.svg.viewBox.baseVal.width / box.width;
    const x = (event.clientX - box.left) * scale, y = (event.clientY - box.top) * scale;
    const [, top, , height] = this.box, count = this.order.length;
    const middle = count * (1 - (y - top) / height), reach = Math.max(3, count * 30 / height);
    let best, least = 30 ** 2;
    for (let rank = Math.max(0, Math.floor(middle - reach)); rank < Math.min(count, middle + reach); rank++) {
      const [a, b] = this.place(this.order[rank]), far = (a - x) ** 2 + (b - y) ** 2;
      if (far < least) { least = far; best = this.order[rank]; }
    }
    return best;
  }
  async point(event) {
    const turn = this.turn = (this.turn ?? 0) + 1, rig = await this.at(event);
    if (turn === this.turn) show(rig);
  }
  mark(rig) {
    this.marked?.remove();
    const at = rig === undefined ? undefined : this.place(rig);
    if (!at) return;
    this.marked = element("g", { class: "readout" }, this.svg);
    element("circle", { cx: at[0], cy: at[1], r: 6, style: "fill:none;stroke:var(--warm);stroke-width:2" }, this.marked);
    const end = at[0] > 0.6 * this.svg.viewBox.baseVal.width;
    element("text", { x: at[0] + (end ? -11 : 11), y: at[1] + 4, "font-size": 12, "text-anchor": end ? "end" : "start", style: "fill:var(--ink)" }, this.marked, `${rigs[rig]}: ${words(this.values[rig], 4)}`);
  }
}

async function show(rig) {
  if (rig !== undefined) await Promise.all(drawings.map((d) => d.ready()));
  for (const drawing of drawings) drawing.mark(rig);
}

for (const group of document.querySelectorAll("g.ranked")) new Ranks(group);

const finder = document.querySelector(".finder");
finder.hidden = false;
const field = finder.querySelector("input"), answer = finder.querySelector("output"), found = finder.querySelector("datalist");
field.addEventListener("input", () => {
  const part = field.value.trim().toLowerCase(), hits = [];
  for (let rig = 0; part && rig < rigs.length && hits.length < 12; rig++) if (rigs[rig].toLowerCase().includes(part)) hits.push(rig);
  const rig = hits.find((one) => rigs[one].toLowerCase() === part) ?? (hits.length === 1 ? hits[0] : undefined);
  found.replaceChildren(...hits.map((one) => Object.assign(document.createElement("option"), { value: rigs[one] })));
  answer.replaceChildren();
  if (rig !== undefined) answer.append(Object.assign(document.createElement("a"), { href: page(rig), textContent: `page of ${rigs[rig]}` }));
  else if (part && !hits.length) answer.append("no such rig");
  show(rig);
});
finder.addEventListener("submit", (event) => { event.preventDefault(); answer.querySelector("a")?.click(); });
