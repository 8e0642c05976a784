// How the exposure of a photograph differs from that of the texture, which has one for all of them.

import { PerspectiveCamera, Vector3, WebGLRenderTarget } from "three";

const SIDE = 192; // pixels, in which both are compared
const LEAST = 300; // pixels of the mesh, below which nothing is said
const MOST_GAIN = 2; // as where the texture is made, dense/texture/exposure.py
const ROUNDS = 10, NOISE = 2 / 255;

function eyeOf({ centre, corners }, { near, far }) {
  const eye = new Vector3(...centre), places = corners.map((corner) => new Vector3(...corner));
  const middle = places.reduce((sum, place) => sum.addScaledVector(place, 0.25), new Vector3());
  const ahead = middle.distanceTo(eye), aside = Math.max(...places.map((place) => place.distanceTo(middle)));
  const camera = new PerspectiveCamera((360 / Math.PI) * Math.atan(aside / ahead), 1, near, far);
  camera.position.copy(eye);
  camera.lookAt(middle);
  return camera;
}

function drawn(renderer, target, object, camera) {
  const pixels = new Uint8Array(4 * SIDE * SIDE);
  renderer.setRenderTarget(target);
  renderer.clear();
  renderer.render(object, camera);
  renderer.readRenderTargetPixels(target, 0, 0, SIDE, SIDE, pixels);
  renderer.setRenderTarget(null);
  return pixels;
}

// Gain and offset by which values come nearest to those that are wanted: least absolute differences, by least squares
// that are weighted anew, since leaves before the model or people are wrong by much.
function matched(values, wanted) {
  let gain = 1, offset = 0;
  for (let round = 0; round < ROUNDS; round++) {
    let [all, x, y, xx, xy] = [0, 0, 0, 0, 0];
    values.forEach((own, i) => {
      const weight = round ? 1 / Math.max(NOISE, Math.abs(gain * own + offset - wanted[i])) : 1;
      all += weight;
      x += weight * own;
      y += weight * wanted[i];
      xx += weight * own * own;
      xy += weight * own * wanted[i];
    });
    const spread = xx - (x * x) / all;
    gain = spread > 0 ? (xy - (x * y) / all) / spread : 1;
    gain = Math.min(MOST_GAIN, Math.max(1 / MOST_GAIN, gain));
    offset = (y - gain * x) / all;
  }
  return { gain, offset };
}

// { gain, offset } of red, green and blue, by which the `surface` looks as exposed as the `sheet` of a photograph before
// its camera; null where they have too little in common.
export function exposureOf(renderer, surface, sheet, camera, planes) {
  const target = new WebGLRenderTarget(SIDE, SIDE), eye = eyeOf(camera, planes);
  const model = surface.asStored((object) => drawn(renderer, target, object, eye));
  const { opacity } = sheet.material;
  sheet.material.opacity = 1;
  const photograph = drawn(renderer, target, sheet, eye);
  sheet.material.opacity = opacity;
  target.dispose();
  const both = [];
  for (let i = 3; i < model.length; i += 4) if (model[i] === 255 && photograph[i] === 255) both.push(i - 3);
  if (both.length < LEAST) return null;
  const of = (pixels, channel) => both.map((i) => pixels[i + channel] / 255);
  const levels = [0, 1, 2].map((channel) => matched(of(model, channel), of(photograph, channel)));
  return { gain: levels.map(({ gain }) => gain), offset: levels.map(({ offset }) => offset) };
}
