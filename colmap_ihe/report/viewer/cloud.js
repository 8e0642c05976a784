// The cloud of points: round discs, drawn as many as there is time for.

import { BufferAttribute, BufferGeometry, Points, ShaderMaterial, Vector3 } from "three";
import { bytes } from "./data.js";
import { RAMP, SECTION, rampAt } from "./shading.js";

const SOME = 20000; // points that stand for all
const BACKGROUND = 2.5, MOST_CAMERAS = 50;

// Little work a point: drawing in software is bound by it.
const VERTEX = `
attribute vec4 tint;
uniform float size, reference;
varying vec3 shade, place;
void main() {
  vec4 world = modelMatrix * vec4(position, 1.0);
  place = world.xyz;
  gl_Position = projectionMatrix * (viewMatrix * world);
  gl_PointSize = clamp(size * reference / gl_Position.w, 1.0, 32.0);
  shade = tint.rgb;
}`;

const FRAGMENT = `
varying vec3 shade, place;
${SECTION}
void main() {
  vec2 off = gl_PointCoord - 0.5;
  if (dot(off, off) > 0.25 || cut(place)) discard;
  gl_FragColor = vec4(shade, 1.0);
}`;

// The cloud with its positions in units of the model.
export function decode(data) {
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

// Places of the cloud, 20,000 at most, without the background: what is more than 2.5 times as far from the nearest camera
// as the median, as in the survey. With many cameras some of them stand for all.
function foregroundOf(cloud, cameras) {
  const places = Array.from({ length: Math.min(cloud.count, SOME) }, (_, i) => new Vector3().fromArray(cloud.positions, 3 * i));
  const every = Math.ceil(cameras.length / MOST_CAMERAS);
  const eyes = cameras.filter((_, i) => i % every === 0).map(({ centre }) => new Vector3(...centre));
  if (!eyes.length) return places;
  const away = Float32Array.from(places, (place) => Math.min(...eyes.map((eye) => place.distanceToSquared(eye))));
  const most = BACKGROUND ** 2 * quantile(away.slice().sort(), 0.5);
  return places.filter((_, i) => away[i] <= most);
}

// The middle of the cloud, its radius and its heights, without background and the few points that lie far out.
export function frameOf(cloud, cameras) {
  const places = foregroundOf(cloud, cameras);
  const axes = [0, 1, 2].map((a) => Float32Array.from(places, (place) => place.getComponent(a)).sort());
  const low = axes.map((v) => quantile(v, 0.02));
  const high = axes.map((v) => quantile(v, 0.98));
  const middle = new Vector3(...low.map((v, a) => (v + high[a]) / 2));
  const radius = Math.hypot(...low.map((v, a) => (high[a] - v) / 2)) || 1;
  return { places, middle, radius, heights: [low[1], Math.max(high[1], low[1] + 1e-6)] };
}

// (N, 4) bytes to draw points in, of which the last is not used.
function tintsIn(mode, cloud, frame) {
  if (mode === "points") return cloud.tints;
  const tints = new Uint8Array(cloud.tints.length);
  const [low, high] = frame.heights;
  for (let i = 0; i < cloud.count; i++) {
    if (mode === "grey") tints.fill(cloud.tints[4 * i + 3], 4 * i, 4 * i + 3);
    else tints.set(rampAt(RAMP, (cloud.positions[3 * i + 1] - low) / (high - low)), 4 * i);
  }
  return tints;
}

export function pointsOf(cloud, frame, section) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(cloud.quantised, 3, true));
  geometry.setAttribute("tint", new BufferAttribute(cloud.tints.slice(), 4, true));
  const uniforms = { size: { value: 2 }, reference: { value: 1 }, ...section };
  const object = new Points(geometry, new ShaderMaterial({ uniforms, vertexShader: VERTEX, fragmentShader: FRAGMENT }));
  object.position.set(...cloud.low);
  object.scale.set(...cloud.extent);
  object.frustumCulled = false;

  function colour(mode) {
    const tint = geometry.getAttribute("tint");
    tint.array.set(tintsIn(mode, cloud, frame));
    tint.needsUpdate = true;
  }
  // As many as `effort`, a share, and the larger for it; how many those are.
  function thin(effort, size, reference) {
    const drawn = Math.max(Math.min(cloud.count, 5000), Math.round(effort * cloud.count));
    geometry.setDrawRange(0, drawn);
    uniforms.size.value = size * Math.min(2, Math.sqrt(cloud.count / Math.max(drawn, 1)));
    uniforms.reference.value = reference;
    return drawn;
  }
  return { object, colour, thin };
}
