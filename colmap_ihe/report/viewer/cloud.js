// A cloud and its cameras, from the data of the page to what three.js draws.

import {
  BufferAttribute, BufferGeometry, LineBasicMaterial, LineSegments, Points, ShaderMaterial, Vector3,
} from "three";

const RAMP = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]]; // heights, from the lowest

// Little work a point: drawing in software is bound by it.
const VERTEX = `
attribute vec4 tint;
uniform float size, reference;
varying vec3 shade;
void main() {
  gl_Position = projectionMatrix * (modelViewMatrix * vec4(position, 1.0));
  gl_PointSize = clamp(size * reference / gl_Position.w, 1.0, 32.0);
  shade = tint.rgb;
}`;

const FRAGMENT = `
varying vec3 shade;
void main() { gl_FragColor = vec4(shade, 1.0); }`;

function bytes(base64) {
  const text = atob(base64);
  const out = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) out[i] = text.charCodeAt(i);
  return out;
}

// The cloud in the script element `id`, with its positions in units of the model.
export function decode(id) {
  const data = JSON.parse(document.getElementById(id).textContent);
  const quantised = new Uint16Array(bytes(data.positions).buffer);
  const positions = new Float32Array(quantised.length);
  for (let i = 0; i < quantised.length; i++) {
    positions[i] = data.low[i % 3] + (quantised[i] / 65535) * data.extent[i % 3];
  }
  return { ...data, quantised, positions, tints: bytes(data.tints), count: quantised.length / 3 };
}

export function quantile(values, share) {
  return values.length ? values[Math.min(values.length - 1, Math.floor(share * values.length))] : 0;
}

// The middle of the cloud, its radius and its heights, without the few points that lie far out.
export function frameOf(cloud) {
  const some = Math.min(cloud.count, 20000);
  const axes = [0, 1, 2].map((a) => Float32Array.from({ length: some }, (_, i) => cloud.positions[3 * i + a]).sort());
  const low = axes.map((v) => quantile(v, 0.02));
  const high = axes.map((v) => quantile(v, 0.98));
  const middle = new Vector3(...low.map((v, a) => (v + high[a]) / 2));
  const radius = Math.hypot(...low.map((v, a) => (high[a] - v) / 2)) || 1;
  return { middle, radius, heights: [low[1], Math.max(high[1], low[1] + 1e-6)] };
}

// (N, 4) bytes to draw points in, of which the last is not used.
export function tintsIn(mode, cloud, frame) {
  if (mode === "colour") return cloud.tints;
  const tints = new Uint8Array(cloud.tints.length);
  const [low, high] = frame.heights;
  for (let i = 0; i < cloud.count; i++) {
    if (mode === "grey") {
      tints.fill(cloud.tints[4 * i + 3], 4 * i, 4 * i + 3);
      continue;
    }
    const at = (RAMP.length - 1) * Math.min(1, Math.max(0, (cloud.positions[3 * i + 1] - low) / (high - low)));
    const step = Math.min(RAMP.length - 2, Math.floor(at));
    for (let k = 0; k < 3; k++) tints[4 * i + k] = RAMP[step][k] + (at - step) * (RAMP[step + 1][k] - RAMP[step][k]);
  }
  return tints;
}

export function pointsOf(cloud) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(cloud.quantised, 3, true));
  geometry.setAttribute("tint", new BufferAttribute(cloud.tints.slice(), 4, true));
  const uniforms = { size: { value: 2 }, reference: { value: 1 } };
  const material = new ShaderMaterial({ uniforms, vertexShader: VERTEX, fragmentShader: FRAGMENT });
  const points = new Points(geometry, material);
  points.position.set(...cloud.low);
  points.scale.set(...cloud.extent);
  points.frustumCulled = false;
  return points;
}

export function frustaOf(cameras) {
  const ends = [];
  for (const { centre, corners } of cameras) {
    corners.forEach((corner, i) => ends.push(...centre, ...corner, ...corner, ...corners[(i + 1) % 4]));
  }
  return lines(new Float32Array(ends), 0xb4552d);
}

function lines(ends, color) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(ends, 3));
  const drawn = new LineSegments(geometry, new LineBasicMaterial({ color }));
  drawn.frustumCulled = false;
  return drawn;
}
