// The ray of each pixel of a photograph, and the pixel of each place: as its lens has them, to a hundredth of a pixel.

import { Matrix3, Vector3 } from "three";

const ROUNDS = 20, STEP = 1e-5, NEAR = 1e-9;

// What each of `size` evenly spaced values counts at a share of the way through them, for the polynomial through all
// (barycentric form; Berrut and Trefethen 2004).
function countsAt(share, size) {
  const at = share * (size - 1), nearest = Math.round(at);
  if (Math.abs(at - nearest) < 1e-12) return Array.from({ length: size }, (_, k) => Number(k === nearest));
  let binomial = 1;
  const counts = Array.from({ length: size }, (_, k) => {
    if (k) binomial *= -(size - k) / k;
    return binomial / (at - k);
  });
  const sum = counts.reduce((a, b) => a + b, 0);
  return counts.map((count) => count / sum);
}

// `grid`: rows of places of a lattice of pixels, in steps of the edges of the picture as it stands before its camera.
export function createLens({ centre, corners, box, size }, grid) {
  const eye = new Vector3(...centre);
  const [topLeft, topRight, , bottomLeft] = corners.map((corner) => new Vector3(...corner));
  const right = topRight.sub(topLeft), down = bottomLeft.sub(topLeft), ahead = topLeft.clone().sub(eye);
  const inPlane = new Matrix3().set(right.x, down.x, ahead.x, right.y, down.y, ahead.y, right.z, down.z, ahead.z).invert();
  const [left, top, wide, tall] = [box[0], box[1], box[2] - box[0], box[3] - box[1]];

  // Steps to the right and down, of shares of the lattice.
  function stepsAt(across, below) {
    const columns = countsAt(across, grid.length), rows = countsAt(below, grid.length);
    const sum = [0, 0];
    grid.forEach((row, r) => columns.forEach((count, c) => {
      sum[0] += rows[r] * count * row[2 * c];
      sum[1] += rows[r] * count * row[2 * c + 1];
    }));
    return sum;
  }
  // The shares whose steps those are (Newton), null where the picture has none.
  function sharesAt(along, under) {
    let [a, b] = [along, under];
    for (let round = 0; round < ROUNDS; round++) {
      const at = stepsAt(a, b), da = stepsAt(a + STEP, b), db = stepsAt(a, b + STEP);
      const [xa, ya, xb, yb] = [da[0] - at[0], da[1] - at[1], db[0] - at[0], db[1] - at[1]].map((v) => v / STEP);
      const det = xa * yb - xb * ya, x = along - at[0], y = under - at[1];
      const [moveA, moveB] = [(x * yb - y * xb) / det, (y * xa - x * ya) / det];
      if (!Number.isFinite(moveA + moveB)) return null;
      a = Math.min(1.5, Math.max(-0.5, a + moveA));
      b = Math.min(1.5, Math.max(-0.5, b + moveB));
      if (Math.hypot(moveA, moveB) < NEAR) return a >= 0 && a <= 1 && b >= 0 && b <= 1 ? [a, b] : null;
    }
    return null;
  }
  return {
    size,
    eye,
    // The direction of a pixel, of length 1.
    ray([x, y]) {
      const [along, under] = stepsAt((x / size[0] - left) / wide, (y / size[1] - top) / tall);
      return ahead.clone().addScaledVector(right, along).addScaledVector(down, under).normalize();
    },
    // The pixel of a place of the model, null where the photograph does not show it.
    pixel(place) {
      const { x, y, z } = place.clone().sub(eye).applyMatrix3(inPlane);
      const shares = z > 0 ? sharesAt(x / z, y / z) : null;
      return shares && [(left + wide * shares[0]) * size[0], (top + tall * shares[1]) * size[1]];
    },
  };
}
