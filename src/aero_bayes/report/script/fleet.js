
// The page of a fleet: finds a rig by a part of its name, and links to its page.
document.documentElement.classList.add("scripted");
const rigs = JSON.parse(document.getElementById("rigs").textContent);
const finder = document.querySelector(".finder");
finder.hidden = false;
const field = finder.querySelector("input"), answer = finder.querySelector("output"), found = finder.querySelector("datalist");
field.addEventListener("input", () => {
  const part = field.value.trim().toLowerCase(), hits = part ? rigs.filter((name) => name.toLowerCase().includes(part)).slice(0, 12) : [];
  const rig = hits.find((name) => name.toLowerCase() === part) ?? (hits.length === 1 ? hits[0] : undefined);
  found.replaceChildren(...hits.map((name) => Object.assign(document.createElement("option"), { value: name })));
  answer.replaceChildren();
  if (rig !== undefined) answer.append(Object.assign(document.createElement("a"), { href: `rigs/${encodeURIComponent(rig)}/report.html`, textContent: `page of ${rig}` }));
  else if (part && !hits.length) answer.append("no such rig");
});
finder.addEventListener("submit", (event) => { event.preventDefault(); answer.querySelector("a")?.click(); });
