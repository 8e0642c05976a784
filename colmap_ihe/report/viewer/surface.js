// The mesh: textured, or in one of the looks that show its shape.

import {
  BufferAttribute, BufferGeometry, DoubleSide, LinearFilter, LinearMipmapLinearFilter, Mesh, ShaderMaterial, Texture,
  Vector2, Vector3,
} from "three";
import { read, unpacked } from "./data.js";
import { RAMP, SECTION } from "./shading.js";

const LOOKS = { texture: 0, clay: 1, normals: 2, height: 3, grey: 4 };
const UV_STEPS = 16383;
const LITTLE = 0.2, AMPLE = 0.6; // of the effort of all triangles: below and above which the fewest and more are drawn

const VERTEX = `
#ifdef COLOURED
attribute vec3 tint;
varying vec3 shade;
#endif
varying vec3 place, facing, turned;
varying vec2 at;
void main() {
  vec4 world = modelMatrix * vec4(position, 1.0);
  place = world.xyz;
  turned = normal;
  facing = mat3(viewMatrix) * normal;
  at = uv;
  #ifdef COLOURED
  shade = tint;
  #endif
  gl_Position = projectionMatrix * (viewMatrix * world);
}`;

const FRAGMENT = `
uniform int look;
uniform sampler2D picture;
uniform vec3 weights, gain, offset, ramp[5];
uniform vec2 heights;
#ifdef COLOURED
varying vec3 shade;
#endif
varying vec3 place, facing, turned;
varying vec2 at;
${SECTION}
vec3 photographed() {
  #ifdef COLOURED
  return shade;
  #else
  return texture2D(picture, at).rgb;
  #endif
}
void main() {
  if (cut(place)) discard;
  vec3 n = normalize(facing);
  n = n.z < 0.0 ? -n : n;
  float lit = 0.35 + 0.5 * max(dot(n, vec3(-0.4, 0.55, 0.733)), 0.0) + 0.15 * n.z + 0.1 * n.y;
  vec3 colour;
  if (look == 1) colour = vec3(0.86, 0.82, 0.76) * lit;
  else if (look == 2) colour = 0.5 + 0.5 * normalize(turned);
  else if (look == 3) {
    float share = 4.0 * clamp((place.y - heights.x) / (heights.y - heights.x), 0.0, 1.0);
    int step = int(min(share, 3.0));
    colour = mix(ramp[step], ramp[step + 1], share - float(step)) * (0.45 + 0.6 * lit);
  } else {
    colour = photographed();  // which holds its light already
    colour = look == 4 ? vec3(dot(colour, weights)) : gain * colour + offset;
  }
  gl_FragColor = vec4(colour, 1.0);
}`;

async function pictureOf(address) {
  const image = new Image();
  image.src = address;
  await image.decode();
  const texture = new Texture(image);
  texture.flipY = false;
  texture.minFilter = LinearMipmapLinearFilter;
  texture.magFilter = LinearFilter;
  texture.needsUpdate = true;
  return texture;
}

async function geometryOf(data) {
  const geometry = new BufferGeometry();
  const [positions, normals] = await Promise.all([data.positions, data.normals].map(unpacked));
  const quantised = Uint16Array.from(positions);
  geometry.setAttribute("position", new BufferAttribute(quantised, 3, true));
  geometry.setAttribute("normal", new BufferAttribute(Int8Array.from(normals), 3, true));
  if (data.uv) {
    const uv = Float32Array.from(await unpacked(data.uv), (step) => step / UV_STEPS);
    geometry.setAttribute("uv", new BufferAttribute(uv, 2));
  } else {
    geometry.setAttribute("tint", new BufferAttribute(Uint8Array.from(await unpacked(data.colours)), 3, true));
  }
  return geometry;
}

// The surface of the page, null where it has none.
export async function surfaceOf(id, frame, weights, section) {
  const data = read(id);
  if (!data) return null;
  const levels = await Promise.all([data.faces, ...data.coarser].map(async (faces) => {
    return new BufferAttribute(Uint32Array.from(await unpacked(faces)), 1);
  }));
  const [geometry, picture] = await Promise.all([geometryOf(data), data.texture ? pictureOf(data.texture) : null]);
  const uniforms = {
    look: { value: 0 }, picture: { value: picture }, weights: { value: new Vector3(...weights) },
    gain: { value: new Vector3(1, 1, 1) }, offset: { value: new Vector3() },
    heights: { value: new Vector2(...frame.heights) },
    ramp: { value: RAMP.map((rgb) => new Vector3(...rgb).divideScalar(255)) }, ...section,
  };
  const material = new ShaderMaterial({
    uniforms, vertexShader: VERTEX, fragmentShader: FRAGMENT, side: DoubleSide, defines: picture ? {} : { COLOURED: 1 },
  });
  const object = new Mesh(geometry, material);
  object.position.set(...data.low);
  object.scale.set(...data.extent);
  object.frustumCulled = false;
  const shape = { positions: geometry.getAttribute("position").array, faces: levels[0].array };
  let level = levels.length - 1; // in the first picture, which is not to wait
  geometry.setIndex(levels[level]);
  // All triangles, or fewer where the effort, a share, does not reach; how many those are. A level once left comes back
  // only where there is much more time than it needs, else the model would flicker.
  function thin(effort) {
    if (effort >= 1) level = 0;
    else if (effort < LITTLE) level = levels.length - 1;
    else if (level === 0 || effort > AMPLE) level = Math.min(1, levels.length - 1);
    geometry.setIndex(levels[level]);
    return geometry.index.count / 3;
  }
  // In the exposure of a photograph, null for its own.
  function expose(levels) {
    uniforms.gain.value.set(...(levels?.gain ?? [1, 1, 1]));
    uniforms.offset.value.set(...(levels?.offset ?? [0, 0, 0]));
  }
  // Draws the surface in the colours that it has, whatever is shown.
  function asStored(draw) {
    const look = uniforms.look.value, { visible } = object;
    expose(null);
    uniforms.look.value = LOOKS.texture;
    object.visible = true;
    const result = draw(object);
    uniforms.look.value = look;
    object.visible = visible;
    return result;
  }
  return {
    object, thin, expose, asStored, ...shape, low: data.low, extent: data.extent, textured: Boolean(picture),
    colour: (mode) => { uniforms.look.value = LOOKS[mode]; },
  };
}
