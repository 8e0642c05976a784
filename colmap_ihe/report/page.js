// The small workings of a page: before and after, copying, and folded parts on paper.
for (const group of document.querySelectorAll("[data-compare]")) {
  const range = group.querySelector("input[type=range]");
  const show = () => {
    group.querySelector(".compare").style.setProperty("--split", `${range.value}%`);
    range.setAttribute("aria-valuetext", `Rec.709 on the left ${range.value} percent, the chosen grey on the rest`);
  };
  range.addEventListener("input", show);
  show();
}
for (const select of document.querySelectorAll("select[data-shows]")) {
  const parts = [...document.querySelectorAll(`[data-of="${select.dataset.shows}"]`)];
  const show = () => parts.forEach((part, i) => { part.hidden = i !== select.selectedIndex; });
  select.closest("[hidden]")?.removeAttribute("hidden");
  select.addEventListener("change", show);
  show();
}
for (const button of document.querySelectorAll("button[data-copies]")) {
  const source = document.getElementById(button.dataset.copies);
  const label = button.textContent;
  const byHand = () => {
    getSelection().selectAllChildren(source);
    return document.execCommand("copy");
  };
  button.hidden = false;
  button.addEventListener("click", async () => {
    let done = true;
    try {
      await navigator.clipboard.writeText(source.innerText);
    } catch {
      done = byHand();
    }
    button.textContent = done ? "Copied" : "Selected: copy with the keyboard";
    setTimeout(() => { button.textContent = label; }, 2500);
  });
}
for (const figure of document.querySelectorAll("[data-zoom]")) {
  const [frame, image, said] = [".zoomed", "img", "output"].map((name) => figure.querySelector(name));
  let times = 1;
  const zoom = (by) => {
    const middle = [0, 1].map((i) => (i ? frame.scrollTop + frame.clientHeight / 2 : frame.scrollLeft + frame.clientWidth / 2) / times);
    times = by ? Math.min(Math.max(times * by, 1), 8) : 1;
    image.style.width = `${100 * times}%`;
    frame.scrollTo(middle[0] * times - frame.clientWidth / 2, middle[1] * times - frame.clientHeight / 2);
    said.textContent = times > 1 ? `${times} times as large; scroll to move` : "";
  };
  figure.querySelector(".zoom").hidden = false;
  for (const button of figure.querySelectorAll("button")) button.addEventListener("click", () => zoom(Number(button.dataset.by)));
  frame.addEventListener("keydown", (event) => {
    const by = { "+": 2, "=": 2, "-": 0.5, "0": 0 }[event.key];
    if (by === undefined || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    zoom(by);
  });
}
const opened = [], shown = [];
addEventListener("beforeprint", () => {
  for (const part of document.querySelectorAll("details:not([open])")) {
    part.open = true;
    opened.push(part);
  }
  for (const part of document.querySelectorAll("[data-of][hidden]")) {
    part.hidden = false;
    shown.push(part);
    for (const image of part.querySelectorAll("img")) image.loading = "eager";
  }
});
addEventListener("afterprint", () => {
  for (const part of opened.splice(0)) part.open = false;
  for (const part of shown.splice(0)) part.hidden = true;
});
