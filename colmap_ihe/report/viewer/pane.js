// One photograph, flat, as it was taken, with a cross that a click or keys move.

const KEYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const MARK = "#d81b60", GUIDE = "#ffb000";

// `changed(pixel, chosen)`: the cross was moved, by a click or Enter for good.
export function createPane(canvas, magnify, changed) {
  const pen = canvas.getContext("2d");
  let shown = null, cross = null;

  // Shares of the picture at the left top of what is seen, and how much of it is seen.
  function window_() {
    const part = 1 / Number(magnify.value);
    return [0, 1].map((k) => Math.min(1 - part, Math.max(0, cross[k] / shown.size[k] - part / 2))).concat(part);
  }
  function onCanvas([x, y]) {
    const [left, top, part] = window_();
    return [((x / shown.size[0] - left) / part) * canvas.width, ((y / shown.size[1] - top) / part) * canvas.height];
  }
  function strokes(colour, width, trace) {
    for (const [style, wide] of [["#000", width + 2], [colour, width]]) {
      pen.strokeStyle = style;
      pen.lineWidth = wide;
      pen.beginPath();
      trace();
      pen.stroke();
    }
  }
  function crossAt(pixel, reach, gap) {
    const [x, y] = onCanvas(pixel);
    for (const [dx, dy] of Object.values(KEYS)) {
      pen.moveTo(x + gap * dx, y + gap * dy);
      pen.lineTo(x + reach * dx, y + reach * dy);
    }
  }
  function draw() {
    if (!shown) return;
    const ratio = canvas.width / Math.max(1, canvas.clientWidth);
    const [left, top, part] = window_();
    const { naturalWidth: w, naturalHeight: h } = shown.image;
    pen.imageSmoothingEnabled = part * w > canvas.width; // magnified, pixels are to be seen
    pen.drawImage(shown.image, left * w, top * h, part * w, part * h, 0, 0, canvas.width, canvas.height);
    for (const line of shown.lines) {
      strokes(GUIDE, ratio, () => line.forEach((pixel, i) => pen[i ? "lineTo" : "moveTo"](...onCanvas(pixel))));
    }
    if (shown.predicted) {
      strokes(GUIDE, 2 * ratio, () => pen.arc(...onCanvas(shown.predicted), 12 * ratio, 0, 2 * Math.PI));
    }
    strokes(MARK, ratio, () => crossAt(cross, 16 * ratio, 3 * ratio));
  }
  function fit() {
    if (!shown || !canvas.clientWidth) return;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    canvas.width = Math.round(canvas.clientWidth * ratio);
    canvas.height = Math.round((canvas.width * shown.size[1]) / shown.size[0]);
    draw();
  }
  function move(to, chosen) {
    cross = to.map((v, k) => Math.min(shown.size[k], Math.max(0, v)));
    draw();
    changed(cross, chosen);
  }
  canvas.addEventListener("click", (e) => {
    if (!shown) return;
    const box = canvas.getBoundingClientRect(), [left, top, part] = window_();
    move([(left + (part * (e.clientX - box.left)) / box.width) * shown.size[0],
      (top + (part * (e.clientY - box.top)) / box.height) * shown.size[1]], true);
  });
  canvas.addEventListener("keydown", (e) => {
    if (!shown || e.ctrlKey || e.metaKey || e.altKey) return;
    const way = KEYS[e.key];
    if (!way && e.key !== "Enter") return;
    e.preventDefault();
    if (!way) return move(cross, true);
    const step = (e.shiftKey ? 20 : 1) / Number(magnify.value) * (shown.size[0] / shown.image.naturalWidth);
    move([cross[0] + step * way[0], cross[1] + step * way[1]], false);
  });
  magnify.addEventListener("input", draw);
  new ResizeObserver(fit).observe(canvas);
  return {
    get cross() { return cross; },
    move,
    // `what`: image, size of the photograph in pixels, predicted pixel or null, lines; `at`: where the cross stands.
    show(what, at) {
      shown = what;
      cross = at;
      fit();
    },
  };
}
