// What lies under a place of the canvas: on the mesh, or the nearest point of the cloud.

import { Raycaster, Vector2, Vector3, Vector4 } from "three";

const PICK_PX = [10, 26]; // how far a point may lie from the place, at first and if there is none

export function rayThrough(view, x, y) {
  const caster = new Raycaster();
  const { clientWidth: width, clientHeight: height } = view.canvas;
  caster.setFromCamera(new Vector2((2 * x) / width - 1, 1 - (2 * y) / height), view.camera);
  return caster;
}

// Where the ray meets the mesh first, within the section box; null where it does not. In the steps of the mesh's
// positions the ray is another one, at the same parameter (after Moeller and Trumbore).
export function onSurface(surface, ray, section) {
  const scale = surface.extent.map((extent) => 65535 / (extent || 1));
  const o = ray.origin.toArray().map((v, a) => (v - surface.low[a]) * scale[a]);
  const d = ray.direction.toArray().map((v, a) => v * scale[a]);
  const { positions: p, faces } = surface;
  let best = Infinity;
  for (let i = 0; i < faces.length; i += 3) {
    const a = 3 * faces[i], b = 3 * faces[i + 1], c = 3 * faces[i + 2];
    const ux = p[b] - p[a], uy = p[b + 1] - p[a + 1], uz = p[b + 2] - p[a + 2];
    const vx = p[c] - p[a], vy = p[c + 1] - p[a + 1], vz = p[c + 2] - p[a + 2];
    const nx = d[1] * vz - d[2] * vy, ny = d[2] * vx - d[0] * vz, nz = d[0] * vy - d[1] * vx;
    const det = ux * nx + uy * ny + uz * nz;
    if (Math.abs(det) < 1e-9) continue;
    const sx = o[0] - p[a], sy = o[1] - p[a + 1], sz = o[2] - p[a + 2];
    const u = (sx * nx + sy * ny + sz * nz) / det;
    if (u < 0 || u > 1) continue;
    const qx = sy * uz - sz * uy, qy = sz * ux - sx * uz, qz = sx * uy - sy * ux;
    const v = (d[0] * qx + d[1] * qy + d[2] * qz) / det;
    if (v < 0 || u + v > 1) continue;
    const t = (vx * qx + vy * qy + vz * qz) / det;
    if (t > 0 && t < best && section.keeps(ray.at(t, new Vector3()))) best = t;
  }
  return best < Infinity ? ray.at(best, new Vector3()) : null;
}

// The point of the cloud that is nearest to the eye among those near the place.
export function onCloud(cloud, view, x, y, section) {
  const { clientWidth: width, clientHeight: height } = view.canvas;
  view.camera.updateMatrixWorld();
  const project = view.camera.projectionMatrix.clone().multiply(view.camera.matrixWorldInverse);
  const found = PICK_PX.map(() => ({ index: -1, depth: Infinity }));
  const place = new Vector4(), point = new Vector3();
  for (let i = 0; i < cloud.count; i++) {
    point.fromArray(cloud.positions, 3 * i);
    place.set(point.x, point.y, point.z, 1).applyMatrix4(project);
    if (place.w <= 0) continue;
    const away = Math.hypot(((place.x / place.w + 1) / 2) * width - x, ((1 - place.y / place.w) / 2) * height - y);
    if (away > PICK_PX.at(-1) || !section.keeps(point)) continue;
    const depth = place.z / place.w;
    for (let k = 0; k < PICK_PX.length; k++) {
      if (away < PICK_PX[k] && depth < found[k].depth) found[k] = { index: i, depth };
    }
  }
  const index = found.find((f) => f.index >= 0)?.index ?? -1;
  return index < 0 ? null : new Vector3().fromArray(cloud.positions, 3 * index);
}
