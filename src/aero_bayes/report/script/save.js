// Every figure as a file: the picture as it is seen, and its numbers.
const KEPT = ["fill", "fill-opacity", "stroke", "stroke-opacity", "stroke-width", "stroke-dasharray", "stroke-linecap", "vector-effect", "font-size", "display"];
class Saver {
  constructor(box) {
    Object.assign(this, { box, svg: box.querySelector("svg.plot") });
    this.time = [...links.values()].flatMap((link) => link.figures).find((figure) => figure.element === box);
    const bar = Object.assign(document.createElement("div"), { className: "tools save" }), numbers = box.querySelector(".numbers");
    const name = this.svg.getAttribute("aria-label"), file = name.replace(/[^\p{L}\d]+/gu, "_").slice(0, 60);
    const kinds = [["PNG", () => this.png()], ["SVG", () => new Blob([this.picture()], { type: "image/svg+xml" })]];
    if (numbers) kinds.push(["CSV", () => this.csv()]);
    bar.append(...kinds.map(([kind, make]) => button(kind, `Save as ${kind}: ${name}`, async () => {
      const href = URL.createObjectURL(await make());
      Object.assign(document.createElement("a"), { href, download: `${file}.${kind.toLowerCase()}` }).click();
      setTimeout(() => URL.revokeObjectURL(href), 60000);
    })));
    if (numbers) numbers.querySelector("summary").after(bar);
    else box.append(bar);
  }
  // The drawing with its colours written out, on the page's ground, its legend below.
  picture() {
    const { svg } = this, copy = svg.cloneNode(true), own = [...copy.querySelectorAll("*")], labels = [...this.box.querySelectorAll(".legend span")];
    const box = svg.getBoundingClientRect(), fluid = svg.classList.contains("fluid"), style = getComputedStyle(svg);
    const [width, tall] = fluid ? [box.width, box.height] : [svg.viewBox.baseVal.width, svg.viewBox.baseVal.height], left = fluid ? parseFloat(style.marginLeft) : 0;
    [...svg.querySelectorAll("*")].forEach((element, k) => {
      for (const property of KEPT) own[k].style.setProperty(property, getComputedStyle(element).getPropertyValue(property));
      own[k].removeAttribute("data-spec");
    });
    for (const element of copy.querySelectorAll(".cursor, .readout, .mark")) element.remove();
    const across = width + left + (fluid ? 14 : 0), height = tall + (labels.length ? 22 : 0), whole = document.createElementNS(SVG, "svg");
    for (const [key, value] of Object.entries({ xmlns: SVG, width: across, height, "font-family": style.fontFamily })) whole.setAttribute(key, value);
    element("rect", { width: across, height, fill: getComputedStyle(document.body).backgroundColor }, whole);
    for (const [key, value] of Object.entries({ x: left, width, height: tall, overflow: "visible" })) copy.setAttribute(key, value);
    whole.append(copy);
    const legend = element("text", { x: 3, y: tall + 14, "font-size": 11.5 }, whole);
    for (const label of labels) element("tspan", { dx: 12, fill: getComputedStyle(label.querySelector("i")).backgroundColor }, legend, `━ ${label.textContent}`);
    return new XMLSerializer().serializeToString(whole);
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
    const text = (cell) => [...cell.childNodes].map((node) => node.textContent.trim()).join(" ").replaceAll("−", "-").replaceAll("\u202f", "").replace(/^–$/, "");
    const rows = this.time ? await this.samples() : [...this.box.querySelectorAll(".numbers tr")].map((row) => [...row.children].map(text));
    const cell = (value) => (typeof value === "number" ? (Number.isFinite(value) ? String(+value.toPrecision(7)) : "") : /[",\n]/.test(value) ? `"${value.replaceAll('"', '""')}"` : value);
    return new Blob([rows.map((row) => row.map(cell).join(",")).join("\n"), "\n"], { type: "text/csv" });
  }
  async samples() {
    const { panels, range } = this.time, columns = [], heads = [];
    let last = "";
    for (const panel of panels) {
      await panel.load();
      for (const { n, t, u, time, low, high } of panel.layers.filter((layer) => layer.n)) {
        const from = index(time, range[0]), to = index(time, range[1] * (1 + 1e-12));
        const add = (head, values) => { heads.push(head); columns.push([...values.slice(from, Math.max(to, from + 1))]); };
        if (t !== last) add("time (s)", time);
        last = t;
        add(`${panel.title}: ${n}${u ? ", low" : ""}`, low);
        if (u) add(`${panel.title}: ${n}, high`, high);
      }
    }
    const size = Math.max(...columns.map((values) => values.length));
    return [heads, ...Array.from({ length: size }, (_, i) => columns.map((values) => values[i] ?? NaN))];
  }
}
