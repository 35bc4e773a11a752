// Every figure as a file: the picture as it is seen, and its numbers.
const KEPT = ["fill", "fill-opacity", "stroke", "stroke-opacity", "stroke-width", "stroke-dasharray", "stroke-linecap", "display"];
class Saver {
  constructor(box) {
    this.box = box;
    this.time = [...links.values()].flatMap((link) => link.figures).find((figure) => figure.element === box);
    this.bar = Object.assign(document.createElement("div"), { className: "tools save" });
    const name = this.svg?.getAttribute("aria-label") ?? "figure", file = name.replace(/[^\p{L}\d]+/gu, "_").slice(0, 60);
    const kinds = [["PNG", () => this.png()], ["SVG", () => new Blob([this.picture()], { type: "image/svg+xml" })]];
    if (this.time || box.querySelector(".numbers table")) kinds.push(["CSV", () => this.csv()]);
    for (const [kind, make] of kinds) {
      const button = Object.assign(document.createElement("button"), { type: "button", textContent: kind, title: `Save as ${kind}` });
      button.setAttribute("aria-label", `Save as ${kind}: ${name}`);
      button.addEventListener("click", async () => {
        const href = URL.createObjectURL(await make());
        Object.assign(document.createElement("a"), { href, download: `${file}.${kind.toLowerCase()}` }).click();
        setTimeout(() => URL.revokeObjectURL(href), 60000);
      });
      this.bar.append(button);
    }
    const numbers = box.querySelector(".numbers");
    if (numbers) numbers.querySelector("summary").after(this.bar);
    else box.append(this.bar);
  }
  get svg() {
    const drawings = [...this.box.querySelectorAll("svg.plot")];
    return drawings.find((svg) => svg.getBoundingClientRect().width > 0) ?? drawings[0];
  }
  // The drawing with its colours written out, on the page's ground, its legend below.
  picture() {
    const { svg } = this, copy = svg.cloneNode(true), { width, height } = svg.viewBox.baseVal;
    const own = [...copy.querySelectorAll("*")];
    [...svg.querySelectorAll("*")].forEach((element, k) => {
      const style = getComputedStyle(element);
      for (const property of KEPT) own[k].style.setProperty(property, style.getPropertyValue(property));
      own[k].removeAttribute("data-spec");
    });
    for (const element of copy.querySelectorAll(".cursor, .readout, .mark, a")) element.remove();
    const labels = [...this.box.querySelectorAll(".legend span")], tall = height + (labels.length ? 22 : 0);
    copy.prepend(element("rect", { width, height: tall, fill: ink("--ground") }, copy));
    const legend = element("text", { x: 3, y: height + 14, "font-size": 11.5 }, copy);
    for (const label of labels) element("tspan", { dx: 12, fill: getComputedStyle(label.querySelector("i")).backgroundColor }, legend, `━ ${label.textContent}`);
    for (const [key, value] of Object.entries({ xmlns: SVG, width, height: tall, viewBox: `0 0 ${width} ${tall}`, "font-family": getComputedStyle(svg).fontFamily })) copy.setAttribute(key, value);
    return new XMLSerializer().serializeToString(copy);
  }
  async png() {
    const image = new Image();
    image.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(this.picture())}`;
    await image.decode();
    const canvas = Object.assign(document.createElement("canvas"), { width: 2 * image.width, height: 2 * image.height });
    canvas.getContext("2d").drawImage(image, 0, 0, canvas.width, canvas.height);
    return new Promise((done) => canvas.toBlob(done, "image/png"));
  }
  // Every sample of the curves within the stretch that is seen, else the figure's table.
  async csv() {
    let rows;
    if (this.time) rows = await this.samples();
    else {
      const text = (cell) => [...cell.childNodes].map((node) => node.textContent.trim()).join(" ").replaceAll("−", "-").replaceAll("\u202f", "").replace(/^–$/, "");
      rows = [...this.box.querySelectorAll(".numbers tr")].map((row) => [...row.children].map(text));
    }
    const cell = (value) => (typeof value === "number" ? (Number.isFinite(value) ? String(+value.toPrecision(7)) : "") : /[",\n]/.test(value) ? `"${value.replaceAll('"', '""')}"` : value);
    return new Blob([rows.map((row) => row.map(cell).join(",")).join("\n"), "\n"], { type: "text/csv" });
  }
  async samples() {
    const { panels, range } = this.time.drawings[0], columns = [], heads = [];
    let last = "";
    for (const panel of panels) {
      await panel.load();
      for (const layer of panel.layers.filter((l) => l.n)) {
        const from = index(layer.time, range[0]), to = index(layer.time, range[1] * (1 + 1e-12));
        const add = (head, values, factor) => { heads.push(head); columns.push(Array.from(values.slice(from, Math.max(to, from + 1)), (v) => factor * v)); };
        if (layer.t !== last) add("time (s)", layer.time, 1);
        last = layer.t;
        const title = `${panel.title.textContent}: ${layer.n}`;
        add(layer.u ? `${title}, low` : title, layer.low, panel.f);
        if (layer.u) add(`${title}, high`, layer.high, panel.f);
      }
    }
    const size = Math.max(...columns.map((values) => values.length));
    return [heads, ...Array.from({ length: size }, (_, i) => columns.map((values) => values[i] ?? NaN))];
  }
}
