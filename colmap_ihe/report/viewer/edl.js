// Eye-dome lighting: points that stand before others get a dark edge (after Boucheny 2009).

import {
  DepthTexture, Mesh, NearestFilter, OrthographicCamera, PlaneGeometry, Scene, ShaderMaterial, Vector2, WebGLRenderTarget,
} from "three";

const FRAGMENT = `
uniform sampler2D picture, depths;
uniform vec2 texel, planes;
uniform bool flat_;
uniform float reach;
varying vec2 at;
float away(vec2 place) {
  float d = texture2D(depths, place).r;
  if (d >= 1.0) return -1.0;
  if (flat_) return 40.0 * d * (planes.y - planes.x) / planes.y;
  return log2(planes.x * planes.y / (planes.y - d * (planes.y - planes.x)));
}
void main() {
  vec4 colour = texture2D(picture, at);
  float own = away(at), shade = 0.0;
  if (own > -1.0) {
    for (int i = 0; i < 4; i++) {
      vec2 side = i < 2 ? vec2(float(2 * i - 1), 0.0) : vec2(0.0, float(2 * i - 5));
      float other = away(at + reach * texel * side);
      if (other > -1.0) shade += max(0.0, own - other - 0.004);
    }
    colour.rgb *= exp(-10.0 * min(shade, 0.06));
  }
  gl_FragColor = colour;
}`;

export function createEdl(renderer) {
  const size = new Vector2();
  const target = new WebGLRenderTarget(1, 1, { minFilter: NearestFilter, magFilter: NearestFilter, depthTexture: new DepthTexture(1, 1) });
  const uniforms = {
    picture: { value: target.texture }, depths: { value: target.depthTexture }, texel: { value: new Vector2() },
    planes: { value: new Vector2() }, flat_: { value: false }, reach: { value: 1 },
  };
  const vertexShader = "varying vec2 at; void main() { at = uv; gl_Position = vec4(position.xy, 0.0, 1.0); }";
  const material = new ShaderMaterial({ uniforms, vertexShader, fragmentShader: FRAGMENT, depthTest: false, transparent: true });
  const scene = new Scene();
  const sheet = new Mesh(new PlaneGeometry(2, 2), material);
  sheet.frustumCulled = false;
  scene.add(sheet);
  const eye = new OrthographicCamera(-1, 1, 1, -1, 0, 1);

  // Draws `things` as seen by `camera`, with `ratio` pixels of the drawing to one of the page.
  return function render(things, camera, ratio) {
    uniforms.reach.value = 1.5 * ratio;
    renderer.getDrawingBufferSize(size);
    if (target.width !== size.x || target.height !== size.y) target.setSize(size.x, size.y);
    uniforms.texel.value.set(1 / size.x, 1 / size.y);
    uniforms.planes.value.set(camera.near, camera.far);
    uniforms.flat_.value = Boolean(camera.isOrthographicCamera);
    renderer.setRenderTarget(target);
    renderer.clear();
    renderer.render(things, camera);
    renderer.setRenderTarget(null);
    renderer.render(scene, eye);
  };
}
