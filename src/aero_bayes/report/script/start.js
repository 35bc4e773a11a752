// Every figure with a time axis, and every pair plot of the page.
document.documentElement.classList.add("scripted");
for (const box of document.querySelectorAll("figure[data-link]")) new Figure(box);
for (const box of document.querySelectorAll("figure.pairs")) new Pairs(box);
const again = () => { for (const link of links.values()) { for (const f of link.figures) for (const d of f.drawings) d.drawn = undefined; link.schedule(); } };
addEventListener("resize", again);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", again);
