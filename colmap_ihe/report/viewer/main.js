// The viewer of a page: mesh, cloud and cameras. scripts/build-viewer makes ../viewer.js of it and of its neighbours here.

import { ColorManagement, LinearSRGBColorSpace, Ray, Scene, WebGLRenderer } from "three";
import { createControl } from "./control.js";
import { decode, frameOf, pointsOf } from "./cloud.js";
import { read } from "./data.js";
import { createEdl } from "./edl.js";
import { exposureOf } from "./exposure.js";
import { createLens } from "./lens.js";
import { createLoop } from "./loop.js";
import { createMarks } from "./marks.js";
import { createPhotographs } from "./photographs.js";
import { onCloud, onSurface, rayThrough } from "./picking.js";
import { createScale } from "./scale.js";
import { createSection, sectionUniforms } from "./section.js";
import { surfaceOf } from "./surface.js";
import { createTools, download } from "./tools.js";
import { createView } from "./view.js";

const STILL_RATIO = 1.5; // least pixels of the drawing to one of the page where nothing moves, against stairs at edges

const BESIDE = 0.01; // of the distance: what stands so near before a place is the surface that it lies on

const viewer = document.getElementById("viewer");
const part = (name) => viewer.querySelector(`[data-part="${name}"]`);

function rendererOf(canvas) {
  ColorManagement.enabled = false; // photographs and colours are drawn as they are stored
  const renderer = new WebGLRenderer({ canvas, alpha: true, antialias: false, preserveDrawingBuffer: true });
  renderer.outputColorSpace = LinearSRGBColorSpace;
  return renderer;
}

async function start() {
  const canvas = viewer.querySelector("canvas");
  const data = read("scene");
  const cloud = decode(read("cloud"));
  const frame = frameOf(cloud, data.cameras);
  const cuts = sectionUniforms();
  const surface = await surfaceOf("surface", frame, data.weights, cuts);
  const points = pointsOf(cloud, frame, cuts);
  viewer.hidden = false;
  const renderer = rendererOf(canvas);
  const fullRatio = Math.min(window.devicePixelRatio || 1, 2);
  const scene = new Scene(), over = new Scene(); // the latter lies over the former
  const edl = createEdl(renderer);
  const marks = createMarks(over, canvas, fullRatio);
  const photographs = createPhotographs(data, () => loop.ask());
  scene.add(points.object, photographs.group);
  if (surface) scene.add(surface.object);
  const size = part("size");
  let ratio = 0, exposure = null;

  function sharpness(effort) {
    const wanted = effort < 1 ? fullRatio * Math.max(0.4, Math.min(1, 0.35 + 0.65 * effort)) : Math.max(fullRatio, STILL_RATIO);
    const rounded = Math.round(wanted * 8) / 8;
    if (rounded === ratio) return;
    ratio = rounded;
    renderer.setPixelRatio(ratio);
  }
  function paint(effort) {
    sharpness(effort);
    const faces = surface?.object.visible ? surface.thin(effort) : 0;
    let drawn = 0;
    if (points.object.visible) {
      drawn = points.thin(effort, Number(size.value) * ratio, view.pointReference);
      edl(scene, view.camera, ratio);
    } else {
      renderer.render(scene, view.camera);
    }
    renderer.autoClear = false;
    renderer.render(over, view.camera);
    renderer.autoClear = true;
    marks.follow(view.camera);
    return { points: drawn, faces, ratio };
  }
  const loop = createLoop(canvas, paint);
  const view = createView(canvas, { frame, cameras: data.cameras }, () => loop.moved());
  const section = createSection(cuts, [points.object, ...(surface ? [surface.object] : [])], {
    cloud, front: view.front, part, scene: over, ask: loop.ask,
  });
  const control = part("control-name") && createControl({
    part, cameras: data.cameras, lenses: data.cameras.map((camera) => createLens(camera, data.grids[camera.grid])),
    addressOf: photographs.addressOf, hides, radius: frame.radius, title: document.title,
  });
  const tools = createTools({
    part, marks, data, scale: createScale(data.metric), ask: loop.ask, canvas, title: document.title, control,
  });

  // Whether the mesh stands between an eye and a place on it.
  function hides(eye, place) {
    const away = place.distanceTo(eye), ray = new Ray(eye, place.clone().sub(eye).normalize());
    const first = surface && onSurface(surface, ray, { keeps: () => true });
    return Boolean(first) && first.distanceTo(eye) < (1 - BESIDE) * away;
  }

  function resize() {
    const { clientWidth: width, clientHeight: height } = canvas;
    if (!width || !height) return;
    renderer.setSize(width, height, false);
    view.resize(width, height);
    loop.ask();
  }
  function colour(mode) {
    const onPoints = mode === "points" || !surface;
    points.object.visible = onPoints;
    if (surface) surface.object.visible = !onPoints;
    if (onPoints) points.colour(mode);
    else surface.colour(mode);
    part("size-field").hidden = !onPoints;
    loop.ask();
  }
  // Cameras stand in the way of one that looks from among them.
  function showCameras(outside) {
    photographs.group.visible = outside && (part("cameras")?.checked ?? false);
    if (!outside) return;
    photographs.hide(over);
    exposed(null);
    if (part("from")) part("from").value = "";
    for (const name of ["fade-field", "alike-field"]) if (part(name)) part(name).hidden = true;
  }
  function exposed(levels) {
    exposure = levels;
    surface?.expose(part("alike")?.checked ? levels : null);
    loop.ask();
  }
  function look(side, atOnce) {
    showCameras(true);
    view.look(side, atOnce);
  }
  async function lookFrom(index) {
    part("flat").checked = false;
    showCameras(false);
    part("from").value = String(index);
    part("fade-field").hidden = false;
    view.fromCamera(data.cameras[index]);
    exposed(null);
    const sheet = await photographs.show(index, over, Number(part("fade").value));
    if (!sheet || !surface) return;
    part("alike-field").hidden = false;
    exposed(exposureOf(renderer, surface, sheet, data.cameras[index], view.planes));
  }
  function placeAt(x, y) {
    const ray = rayThrough(view, x, y);
    return surface?.object.visible ? onSurface(surface, ray.ray, section) : onCloud(cloud, view, x, y, section);
  }
  function picked(x, y) {
    if (tools.active) return tools.pick(placeAt(x, y));
    const ray = rayThrough(view, x, y);
    const camera = photographs.under(ray);
    if (!camera) return null;
    const before = surface?.object.visible ? placeAt(x, y) : null;
    return before && before.distanceTo(ray.ray.origin) < camera.distance ? null : lookFrom(camera.index);
  }

  listen(canvas, view, picked, { look, leave: () => photographs.open && showCameras(true), stop: tools.stop });
  for (const choice of viewer.querySelectorAll("[data-mode]")) {
    choice.addEventListener("change", () => choice.checked && colour(choice.dataset.mode));
  }
  for (const button of viewer.querySelectorAll("[data-side]")) button.addEventListener("click", () => look(button.dataset.side));
  part("flat").addEventListener("change", (e) => { showCameras(true); view.setFlat(e.target.checked); });
  size.addEventListener("input", loop.ask);
  part("cameras")?.addEventListener("change", () => { showCameras(true); loop.ask(); });
  data.cameras.forEach(({ name }, i) => part("from")?.add(new Option(name, String(i))));
  part("from")?.addEventListener("change", (e) => (e.target.value === "" ? look("home") : lookFrom(Number(e.target.value))));
  part("fade")?.addEventListener("input", (e) => photographs.fade(Number(e.target.value)));
  part("alike")?.addEventListener("change", () => exposed(exposure));
  part("picture").addEventListener("click", () => savePicture(canvas));
  setUpFullScreen(part("screen"));

  renderer.setPixelRatio(fullRatio);
  resize();
  const fill = Math.sqrt((2.2 * canvas.clientWidth * canvas.clientHeight) / Math.max(cloud.count, 1));
  size.value = String(Math.min(5, Math.max(1.5, fill)));
  colour(viewer.querySelector("[data-mode]:checked").dataset.mode);
  look("home", true);
  new ResizeObserver(resize).observe(canvas);
  canvas.addEventListener("drawn", () => photographs.fill(), { once: true });
}

// Pointer, wheel and keys of the canvas.
function listen(canvas, view, picked, { look, leave, stop }) {
  let pressed = null;
  canvas.addEventListener("pointerdown", (e) => {
    pressed = [e.clientX, e.clientY];
    view.controls.enableZoom = true;
    canvas.focus({ preventScroll: true });
  }, { capture: true });
  canvas.addEventListener("pointerup", (e) => {
    if (!pressed || e.button !== 0 || Math.hypot(e.clientX - pressed[0], e.clientY - pressed[1]) > 5) return;
    const box = canvas.getBoundingClientRect();
    picked(e.clientX - box.left, e.clientY - box.top);
  });
  view.controls.addEventListener("change", () => { if (view.held) leave(); });
  view.controls.addEventListener("start", () => { view.held = true; });
  view.controls.addEventListener("end", () => { view.held = false; });
  // The wheel scrolls the page until the viewer has the focus.
  view.controls.enableZoom = false;
  canvas.addEventListener("focus", () => { view.controls.enableZoom = true; });
  canvas.addEventListener("blur", () => { view.controls.enableZoom = false; });
  const turned = (left, up) => () => { leave(); view.turn(left, up); };
  const zoomed = (factor) => () => { leave(); view.zoom(factor); };
  const keys = {
    ArrowLeft: turned(-0.08, 0), ArrowRight: turned(0.08, 0), ArrowUp: turned(0, 0.08), ArrowDown: turned(0, -0.08),
    "+": zoomed(0.9), "=": zoomed(0.9), "-": zoomed(1 / 0.9), _: zoomed(1 / 0.9), Home: () => look("home"),
    Enter: () => picked(canvas.clientWidth / 2, canvas.clientHeight / 2), Escape: stop,
  };
  canvas.addEventListener("keydown", (e) => {
    if (e.ctrlKey || e.metaKey || e.altKey || !Object.hasOwn(keys, e.key)) return;
    if (e.key === "Escape" && document.fullscreenElement) return;
    e.preventDefault();
    keys[e.key]();
  });
}

// What is seen, on the colour of the stage, as a PNG file.
function savePicture(canvas) {
  const copy = document.createElement("canvas");
  copy.width = canvas.width;
  copy.height = canvas.height;
  const pen = copy.getContext("2d");
  pen.fillStyle = getComputedStyle(canvas.parentElement).backgroundColor;
  pen.fillRect(0, 0, copy.width, copy.height);
  pen.drawImage(canvas, 0, 0);
  copy.toBlob((blob) => download(blob, "view.png"));
}

function setUpFullScreen(button) {
  button.hidden = !document.fullscreenEnabled;
  button.addEventListener("click", () => (document.fullscreenElement ? document.exitFullscreen() : viewer.requestFullscreen()));
  document.addEventListener("fullscreenchange", () => {
    button.setAttribute("aria-pressed", String(Boolean(document.fullscreenElement)));
  });
}

const missing = document.getElementById("no-viewer");
if (!document.createElement("canvas").getContext("webgl2")) {
  missing.textContent = "The model cannot be drawn: WebGL is missing in this browser.";
} else if (typeof DecompressionStream === "undefined") {
  missing.textContent = "The model cannot be drawn: this browser is older than 2023.";
} else {
  missing.hidden = true;
  start();
}
