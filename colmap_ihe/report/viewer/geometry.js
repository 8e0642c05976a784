// Figures of picked points: no drawing, no page.

import { Vector3 } from "three";

export function lengthOf(points) {
  return points.slice(1).reduce((sum, point, i) => sum + point.distanceTo(points[i]), 0);
}

// The area of a polygon seen at right angles to its mean plane (Newell's method).
export function areaOf(points) {
  const sum = new Vector3();
  points.forEach((point, i) => sum.add(point.clone().cross(points[(i + 1) % points.length])));
  return sum.length() / 2;
}

// Coordinates in the model's own frame, as mesh.ply and fused.ply have them.
export function inModel(point, { rotation, middle }) {
  return middle.map((offset, column) => offset + point.toArray().reduce((sum, v, row) => sum + v * rotation[row][column], 0));
}
