// Draws all figures of a page and gives what is wrong with it as somebody sees it.
(async () => {
  const deadline = Date.now() + 30000;
  while (!window.drawAll && Date.now() < deadline) await new Promise(r => setTimeout(r, 20));
  if (!window.drawAll) return ["figures are never drawn"];
  window.drawAll();
  await new Promise(r => setTimeout(r, 60));
  const faults = [], wide = document.documentElement.scrollWidth;
  if (wide > window.innerWidth) faults.push(`${wide} px wide in a window of ${window.innerWidth}`);
  const shown = e => { const r = e.getBoundingClientRect(); return r.width > 1 && r.height > 1; };
  const words = e => e.textContent.trim();
  function overlaps(elements, where) {
    const boxes = elements.filter(e => shown(e) && words(e)).map(e => [e.getBoundingClientRect(), words(e)]);
    boxes.sort((a, b) => a[0].top - b[0].top);
    for (let i = 0; i < boxes.length; i++)
      for (let j = i + 1; j < boxes.length && boxes[j][0].top < boxes[i][0].bottom; j++) {
        const [a, s] = boxes[i], [b, t] = boxes[j];
        const x = Math.min(a.right, b.right) - Math.max(a.left, b.left);
        const y = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
        if (x > 2 && y > 3) faults.push(`${where}: "${s}" lies on "${t}"`);
      }
  }
  overlaps([...document.querySelectorAll("main h1, main h2, main h3, main p, .keys button, .tag, th")], "page");
  for (const div of document.querySelectorAll(".plot")) {
    const box = div.getBoundingClientRect(), texts = [...div.querySelectorAll("svg text")];
    overlaps(texts, div.id);
    for (const t of texts.filter(t => shown(t) && words(t))) {
      const r = t.getBoundingClientRect();
      if (r.left < box.left - 2 || r.right > box.right + 2) faults.push(`${div.id}: "${words(t)}" is cut`);
    }
    const keys = div.parentNode.querySelector(".keys").getBoundingClientRect();
    if (keys.bottom > box.top + 1) faults.push(`${div.id}: its key lies on it`);
    if (!div.querySelector("svg path")) faults.push(`${div.id}: nothing is drawn`);
    if (!div.getAttribute("aria-label")) faults.push(`${div.id}: no words for those who do not see it`);
  }
  return faults;
})()
