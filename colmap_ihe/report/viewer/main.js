// The viewer of a page: a cloud of points with the cameras that saw it. scripts/build-viewer makes ../viewer.js of it.

import {
  BufferAttribute, BufferGeometry, LineBasicMaterial, LineSegments, PerspectiveCamera, Points, PointsMaterial, Scene,
  ShaderMaterial, Spherical, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

const FRAME_MS = 25; // aimed at while moving: a thinner cloud is drawn where all of it would take longer
const LEAST_POINTS = 10000;
const REST_MS = 180; // without movement, after which all points are drawn
const PICK_PX = [5, 10, 20]; // a point is looked for this near the pointer, the nearest circle first
const LARGEST = 2; // how much larger points are, at most, in a thinner cloud
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

function decode(id) {
  const data = JSON.parse(document.getElementById(id).textContent);
  const quantised = new Uint16Array(bytes(data.positions).buffer);
  const positions = new Float32Array(quantised.length);
  for (let i = 0; i < quantised.length; i++) {
    positions[i] = data.low[i % 3] + (quantised[i] / 65535) * data.extent[i % 3];
  }
  return { ...data, quantised, positions, tints: bytes(data.tints), count: quantised.length / 3 };
}

function quantile(values, share) {
  return values.length ? values[Math.min(values.length - 1, Math.floor(share * values.length))] : 0;
}

// The middle of the cloud, its radius and its heights, without the few points that lie far out.
function frameOf(cloud) {
  const some = Math.min(cloud.count, 20000);
  const axes = [0, 1, 2].map((a) => Float32Array.from({ length: some }, (_, i) => cloud.positions[3 * i + a]).sort());
  const low = axes.map((v) => quantile(v, 0.02));
  const high = axes.map((v) => quantile(v, 0.98));
  const middle = new Vector3(...low.map((v, a) => (v + high[a]) / 2));
  const radius = Math.hypot(...low.map((v, a) => (high[a] - v) / 2)) || 1;
  return { middle, radius, heights: [low[1], Math.max(high[1], low[1] + 1e-6)] };
}

// (N, 4) bytes to draw points in, of which the last is not used.
function tintsIn(mode, cloud, frame) {
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

function pointsOf(cloud) {
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

function frustaOf(cameras) {
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

function start(viewer) {
  const canvas = viewer.querySelector("canvas");
  const part = (name) => viewer.querySelector(`[data-part="${name}"]`);
  const cloud = decode("cloud");
  const frame = frameOf(cloud);
  const renderer = new WebGLRenderer({ canvas, alpha: true, antialias: false, preserveDrawingBuffer: true });
  renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
  const scene = new Scene();
  const camera = new PerspectiveCamera(45, 1, frame.radius / 500, frame.radius * 200);
  const controls = new OrbitControls(camera, canvas);
  const points = pointsOf(cloud);
  const frusta = frustaOf(cloud.cameras);
  scene.add(points, frusta);

  const size = part("size");
  let budget = Math.min(cloud.count, 60000);
  let asked = false, moving = false, resting = 0, last = 0, pace = FRAME_MS;

  function draw(now) {
    asked = false;
    const took = now - last;
    last = now;
    if (moving && took < 300) {
      pace = 0.8 * pace + 0.2 * took;
      const wanted = budget * Math.min(1.1, FRAME_MS / pace);
      budget = Math.min(cloud.count, Math.max(LEAST_POINTS, wanted));
    }
    const drawn = moving ? Math.round(budget) : cloud.count;
    points.geometry.setDrawRange(0, drawn);
    const larger = Math.min(LARGEST, Math.sqrt(cloud.count / Math.max(drawn, 1)));
    points.material.uniforms.size.value = Number(size.value) * renderer.getPixelRatio() * larger;
    renderer.render(scene, camera);
    canvas.dispatchEvent(new CustomEvent("drawn", { detail: { points: drawn } }));
  }
  function ask() {
    if (!asked) {
      asked = true;
      requestAnimationFrame(draw);
    }
  }
  function moved() {
    moving = true;
    clearTimeout(resting);
    resting = setTimeout(() => { moving = false; ask(); }, REST_MS);
    ask();
  }

  function place(from) {
    const distance = fitting(from);
    controls.target.copy(frame.middle);
    camera.position.copy(from).setLength(distance).add(frame.middle);
    points.material.uniforms.reference.value = distance;
    controls.update();
    moved();
  }
  // How far off nearly all points are within the picture.
  function fitting(from) {
    const back = from.clone().normalize();
    const right = new Vector3(0, 1, 0).cross(back).normalize();
    const up = back.clone().cross(right);
    const tall = Math.tan((camera.fov * Math.PI) / 360);
    const point = new Vector3();
    const needed = Float32Array.from({ length: Math.min(cloud.count, 5000) }, (_, i) => {
      point.fromArray(cloud.positions, 3 * i).sub(frame.middle);
      const aside = Math.max(Math.abs(point.dot(right)) / (tall * camera.aspect), Math.abs(point.dot(up)) / tall);
      return aside + point.dot(back);
    }).sort();
    return Math.max(1.08 * quantile(needed, 0.98), 0.5 * frame.radius);
  }
  // The side that the photographs were taken from, a little turned and raised.
  function side() {
    const offsets = cloud.cameras.map(({ centre }) => new Vector3(...centre).sub(frame.middle));
    const mean = offsets.reduce((sum, v) => sum.addScaledVector(v, 1 / offsets.length), new Vector3());
    const from = mean.length() > 0.2 * frame.radius ? mean : offsets[0] ?? new Vector3(0, 0, 1);
    const round = new Spherical().setFromVector3(from.length() > 0 ? from : new Vector3(0, 0, 1));
    round.theta += 0.35;
    round.phi = Math.min(round.phi, 1.35);
    return new Vector3().setFromSpherical(round.makeSafe());
  }
  const home = () => place(side());

  function resize() {
    const { clientWidth: width, clientHeight: height } = canvas;
    if (!width || !height) return;
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    ask();
  }

  function turn(left, up) {
    const offset = camera.position.clone().sub(controls.target);
    const round = new Spherical().setFromVector3(offset);
    round.theta -= left;
    round.phi -= up;
    camera.position.copy(controls.target).add(offset.setFromSpherical(round.makeSafe()));
    controls.update();
    moved();
  }
  function zoom(factor) {
    camera.position.sub(controls.target).multiplyScalar(factor).add(controls.target);
    controls.update();
    moved();
  }

  const marks = [];
  const markGeometry = new BufferGeometry();
  const markEnds = new BufferAttribute(new Float32Array(6), 3);
  markGeometry.setAttribute("position", markEnds);
  const over = { color: 0xd81b60, depthTest: false };
  const dots = new Points(markGeometry, new PointsMaterial({ ...over, size: 9 * renderer.getPixelRatio(), sizeAttenuation: false }));
  const ruler = new LineSegments(markGeometry, new LineBasicMaterial(over));
  for (const mark of [ruler, dots]) {
    mark.frustumCulled = false;
    mark.renderOrder = 1;
    scene.add(mark);
  }

  function nearest(x, y) {
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
  function length(units) {
    const scale = cloud.metres_per_unit;
    if (!scale) return `${units.toPrecision(4)} model units`;
    const metres = units * scale;
    return metres < 0.1 ? `${(1000 * metres).toPrecision(3)} mm` : `${metres.toPrecision(4)} m`;
  }
  function say(text) {
    part("reading").textContent = text;
  }
  function mark(point) {
    if (!point) return say("No point there. Pick again.");
    if (marks.length === 2) marks.length = 0;
    marks.push(point);
    showMarks();
    say(marks.length === 1 ? "First point set. Pick the second." : `Distance: ${length(marks[0].distanceTo(marks[1]))}`);
  }
  function showMarks() {
    marks.forEach((point, i) => markEnds.setXYZ(i, point.x, point.y, point.z));
    markEnds.needsUpdate = true;
    dots.visible = marks.length > 0;
    ruler.visible = marks.length === 2;
    markGeometry.setDrawRange(0, marks.length);
    ask();
  }

  const measure = part("measure");
  const measuring = () => measure.getAttribute("aria-pressed") === "true";
  measure.addEventListener("click", () => {
    measure.setAttribute("aria-pressed", String(!measuring()));
    viewer.classList.toggle("measuring", measuring());
    marks.length = 0;
    showMarks();
    say(measuring() ? "Pick the first point: click it, or bring it to the cross with the keys and press Enter." : "");
    if (measuring()) canvas.focus({ preventScroll: true });
  });
  let pressed = null;
  canvas.addEventListener("pointerdown", (e) => {
    pressed = [e.clientX, e.clientY];
    controls.enableZoom = true;
    canvas.focus({ preventScroll: true });
  }, { capture: true });
  canvas.addEventListener("pointerup", (e) => {
    if (!measuring() || !pressed || Math.hypot(e.clientX - pressed[0], e.clientY - pressed[1]) > 4) return;
    const box = canvas.getBoundingClientRect();
    mark(nearest(e.clientX - box.left, e.clientY - box.top));
  });
  // The wheel scrolls the page until the viewer has the focus.
  controls.enableZoom = false;
  canvas.addEventListener("focus", () => { controls.enableZoom = true; });
  canvas.addEventListener("blur", () => { controls.enableZoom = false; });
  controls.addEventListener("change", moved);

  const keys = {
    ArrowLeft: () => turn(-0.08, 0), ArrowRight: () => turn(0.08, 0),
    ArrowUp: () => turn(0, 0.08), ArrowDown: () => turn(0, -0.08),
    "+": () => zoom(0.9), "=": () => zoom(0.9), "-": () => zoom(1 / 0.9), _: () => zoom(1 / 0.9), Home: home,
    Enter: () => measuring() && mark(nearest(canvas.clientWidth / 2, canvas.clientHeight / 2)),
  };
  canvas.addEventListener("keydown", (e) => {
    if (e.ctrlKey || e.metaKey || e.altKey || !Object.hasOwn(keys, e.key)) return;
    e.preventDefault();
    keys[e.key]();
  });

  part("home").addEventListener("click", home);
  part("mode").addEventListener("change", (e) => {
    const tint = points.geometry.getAttribute("tint");
    tint.array.set(tintsIn(e.target.value, cloud, frame));
    tint.needsUpdate = true;
    ask();
  });
  size.addEventListener("input", ask);
  part("cameras")?.addEventListener("change", (e) => {
    frusta.visible = e.target.checked;
    ask();
  });
  const from = part("from");
  cloud.cameras.forEach(({ name }, i) => from?.add(new Option(name, String(i))));
  from?.addEventListener("change", () => {
    const chosen = cloud.cameras[Number(from.value)];
    if (from.value === "" || !chosen) return home();
    const centre = new Vector3(...chosen.centre);
    const ahead = chosen.corners.reduce((sum, c) => sum.addScaledVector(new Vector3(...c), 0.25), new Vector3()).sub(centre);
    const depth = Math.max(frame.middle.clone().sub(centre).dot(ahead) / ahead.length(), 0.2 * frame.radius);
    controls.target.copy(centre).addScaledVector(ahead.normalize(), depth);
    camera.position.copy(centre).addScaledVector(ahead, -0.02 * depth);
    controls.update();
    moved();
  });

  viewer.hidden = false;
  resize();
  const fill = Math.sqrt((1.1 * canvas.clientWidth * canvas.clientHeight) / Math.max(cloud.count, 1));
  size.value = String(Math.min(5, Math.max(1.5, fill)));
  showMarks();
  home();
  new ResizeObserver(resize).observe(canvas);
}

const viewer = document.getElementById("viewer");
const missing = document.getElementById("no-viewer");
if (document.createElement("canvas").getContext("webgl2")) {
  missing.hidden = true;
  start(viewer);
} else {
  missing.textContent = "This browser cannot draw in three dimensions (WebGL is missing or switched off), "
    + "so the point cloud is not shown. All else on this page works.";
}
