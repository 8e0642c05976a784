// The viewer of a page: a cloud of points with the cameras that saw it. scripts/build-viewer makes ../viewer.js of it.

import {
  BufferAttribute, BufferGeometry, LineBasicMaterial, LineSegments, PerspectiveCamera, Points, PointsMaterial, Scene,
  Spherical, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { decode, frameOf, frustaOf, pointsOf, quantile, tintsIn } from "./cloud.js";
import { lengthInWords, nearest } from "./measure.js";

const FIELD = 45; // degrees from top to bottom
const FRAME_MS = 28; // aimed at while moving: a thinner cloud is drawn where all of it would take longer
const LEAST_POINTS = 10000;
const REST_MS = 180; // without movement, after which all points are drawn
const LARGEST = 2; // how much larger points are, at most, in a thinner cloud

// How much larger things look than in the field of view of the start.
function narrowing(degrees) {
  return Math.tan((FIELD * Math.PI) / 360) / Math.tan((degrees * Math.PI) / 360);
}

function start(viewer) {
  const canvas = viewer.querySelector("canvas");
  const part = (name) => viewer.querySelector(`[data-part="${name}"]`);
  const cloud = decode("cloud");
  const frame = frameOf(cloud);
  const renderer = new WebGLRenderer({ canvas, alpha: true, antialias: false, preserveDrawingBuffer: true });
  renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
  const scene = new Scene();
  const camera = new PerspectiveCamera(FIELD, 1, frame.radius / 500, frame.radius * 200);
  const controls = new OrbitControls(camera, canvas);
  const points = pointsOf(cloud);
  const frusta = frustaOf(cloud.cameras);
  scene.add(points, frusta);

  const size = part("size");
  let budget = Math.min(cloud.count, 60000);
  let asked = false, moving = false, going = false, resting = 0, last = 0, pace = FRAME_MS, reach = 1;

  function draw(now) {
    asked = false;
    const took = now - last;
    last = now;
    if (moving && going) {
      pace = 0.8 * pace + 0.2 * took;
      const wanted = budget * Math.min(1.1, FRAME_MS / pace);
      budget = Math.min(cloud.count, Math.max(LEAST_POINTS, wanted));
    }
    const drawn = moving ? Math.round(budget) : cloud.count;
    points.geometry.setDrawRange(0, drawn);
    const larger = Math.min(LARGEST, Math.sqrt(cloud.count / Math.max(drawn, 1)));
    points.material.uniforms.size.value = Number(size.value) * renderer.getPixelRatio() * larger;
    points.material.uniforms.reference.value = reach * narrowing(camera.fov);
    renderer.render(scene, camera);
    going = moving;
    if (moving) ask(); // the next frame at once, so that the time between two is what drawing takes
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
    reach = distance;
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
  function home() {
    lens(FIELD, true);
    place(side());
  }
  // The field of view in degrees; the cameras stand in the way of one that looks from among them.
  function lens(degrees, outside) {
    camera.fov = degrees;
    camera.updateProjectionMatrix();
    frusta.visible = outside && (part("cameras")?.checked ?? false);
    if (outside && part("from")) part("from").value = "";
  }
  // As the photograph was taken, turning about what lies in its middle.
  function lookFrom({ centre, corners }) {
    const eye = new Vector3(...centre);
    const [topLeft, , , bottomLeft] = corners.map((corner) => new Vector3(...corner));
    const middle = corners.reduce((sum, corner) => sum.addScaledVector(new Vector3(...corner), 0.25), new Vector3());
    const ahead = middle.sub(eye);
    const field = (360 / Math.PI) * Math.atan(topLeft.distanceTo(bottomLeft) / 2 / ahead.length());
    lens(Math.min(100, Math.max(5, field)), false);
    const depth = Math.max(frame.middle.clone().sub(eye).dot(ahead.normalize()), 0.2 * frame.radius);
    controls.target.copy(eye).addScaledVector(ahead, depth);
    camera.position.copy(eye);
    controls.update();
    moved();
  }

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
  const dot = { ...over, size: 9 * renderer.getPixelRatio(), sizeAttenuation: false };
  const dots = new Points(markGeometry, new PointsMaterial(dot));
  const ruler = new LineSegments(markGeometry, new LineBasicMaterial(over));
  for (const mark of [ruler, dots]) {
    mark.frustumCulled = false;
    mark.renderOrder = 1;
    scene.add(mark);
  }

  function say(text) {
    part("reading").textContent = text;
  }
  function mark(point) {
    if (!point) return say("No point there. Pick again.");
    if (marks.length === 2) marks.length = 0;
    marks.push(point);
    showMarks();
    say(marks.length === 1 ? "First point set. Pick the second."
      : `Distance: ${lengthInWords(marks[0].distanceTo(marks[1]), cloud.metres_per_unit)}`);
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
    mark(nearest(cloud, camera, canvas, e.clientX - box.left, e.clientY - box.top));
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
    Enter: () => measuring() && mark(nearest(cloud, camera, canvas, canvas.clientWidth / 2, canvas.clientHeight / 2)),
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
    const chosen = from.value === "" ? null : cloud.cameras[Number(from.value)];
    if (chosen) lookFrom(chosen);
    else home();
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
