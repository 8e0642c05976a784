// Where a point is that several photographs show, and on which line of a photograph one that another shows.

import { Matrix3, Vector3 } from "three";

const LEAST_SINE = Math.sin(Math.PI / 180); // between rays that meet: at a degree depth is uncertain by 80 times the width
const LINE_STEPS = 240;
const NEAREST = 1e-2, FARTHEST = 1e2; // of the line, in radii of the model

// The place nearest to all rays, by least squares; null where they are too few or nearly parallel.
export function meetingOf(rays) {
  const wide = rays.some((one, i) => rays.slice(i + 1).some((other) => one.ray.clone().cross(other.ray).length() > LEAST_SINE));
  if (!wide) return null;
  const sum = new Array(9).fill(0), target = new Vector3();
  for (const { eye, ray } of rays) {
    const d = ray.toArray(), along = ray.dot(eye);
    for (let k = 0; k < 9; k++) sum[k] += Number(k % 4 === 0) - d[Math.floor(k / 3)] * d[k % 3];
    target.add(eye).addScaledVector(ray, -along);
  }
  return target.applyMatrix3(new Matrix3().set(...sum).invert());
}

// The pixels, as a list of connected parts, on which `lens` shows what lies on a ray.
export function lineOf(lens, { eye, ray }, radius) {
  const parts = [[]];
  for (let step = 0; step <= LINE_STEPS; step++) {
    const away = radius * NEAREST * (FARTHEST / NEAREST) ** (step / LINE_STEPS);
    const pixel = lens.pixel(eye.clone().addScaledVector(ray, away));
    if (pixel) parts.at(-1).push(pixel);
    else if (parts.at(-1).length) parts.push([]);
  }
  return parts.filter((part) => part.length > 1);
}
