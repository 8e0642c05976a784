// Picking points with the pointer, and the distance between them.

import { Vector3 } from "three";

const PICK_PX = [5, 10, 20]; // a point is looked for this near the pointer, the nearest circle first

// The point that lies nearest to `x`, `y` on the canvas, and before others there; null if none does.
export function nearest(cloud, camera, canvas, x, y) {
  camera.updateMatrixWorld();
  const m = camera.projectionMatrix.clone().multiply(camera.matrixWorldInverse).elements;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  const found = PICK_PX.map(() => ({ index: -1, depth: Infinity }));
  const p = cloud.positions;
  for (let i = 0; i < cloud.count; i++) {
    const [a, b, c] = [p[3 * i], p[3 * i + 1], p[3 * i + 2]];
    const w = m[3] * a + m[7] * b + m[11] * c + m[15];
    if (w <= 0) continue;
    const dx = ((m[0] * a + m[4] * b + m[8] * c + m[12]) / w / 2 + 0.5) * width - x;
    const dy = (0.5 - (m[1] * a + m[5] * b + m[9] * c + m[13]) / w / 2) * height - y;
    const away = dx * dx + dy * dy;
    for (let k = 0; k < PICK_PX.length; k++) {
      if (away < PICK_PX[k] ** 2 && w < found[k].depth) found[k] = { index: i, depth: w };
    }
  }
  const index = found.find((f) => f.index >= 0)?.index ?? -1;
  return index < 0 ? null : new Vector3().fromArray(p, 3 * index);
}

// A length in units of the model, in words. `scale`: metres a unit, null where it is not known.
export function lengthInWords(units, scale) {
  if (!scale) return `${units.toPrecision(4)} model units`;
  const metres = units * scale;
  return metres < 0.1 ? `${(1000 * metres).toPrecision(3)} mm` : `${metres.toPrecision(4)} m`;
}
