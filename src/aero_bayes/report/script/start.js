// Every figure with a time axis, every file, and the section that is read.
document.documentElement.classList.add("scripted");
for (const box of document.querySelectorAll("figure[data-link]")) new Figure(box);
for (const box of document.querySelectorAll("figure")) if (box.querySelector("svg.plot")) new Saver(box);
const seen = new IntersectionObserver((entries) => {
  for (const { target, isIntersecting } of entries) {
    const link = document.querySelector(`nav a[href="#${target.id}"]`);
    if (!link) continue;
    if (isIntersecting) link.setAttribute("aria-current", "true"); else link.removeAttribute("aria-current");
    if (isIntersecting) link.parentNode.scrollLeft = link.offsetLeft - 20;
  }
}, { rootMargin: "-25% 0px -74% 0px" });
for (const section of document.querySelectorAll("main > section[id]")) seen.observe(section);
