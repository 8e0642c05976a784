// Where the model is looked at from: perspective or orthographic, from a side, from a camera, turned by hand.

import { OrthographicCamera, PerspectiveCamera, Spherical, Vector3 } from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { quantile } from "./cloud.js";

export const FIELD = 45; // degrees from top to bottom
const FLIGHT_MS = 450;
const QUARTER = Math.PI / 2;

const halfTangent = (degrees) => Math.tan((degrees * Math.PI) / 360);
const around = (theta, phi) => new Vector3().setFromSpherical(new Spherical(1, phi, theta).makeSafe());

// The angle about the vertical at which whoever photographed stood, in the mean.
export function frontOf(cameras, frame) {
  const offsets = cameras.map(({ centre }) => new Vector3(...centre).sub(frame.middle));
  const mean = offsets.reduce((sum, v) => sum.addScaledVector(v, 1 / offsets.length), new Vector3());
  const from = Math.hypot(mean.x, mean.z) > 0.2 * frame.radius ? mean : offsets[0] ?? new Vector3(0, 0, 1);
  return Math.atan2(from.x, from.z);
}

export function createView(canvas, { frame, cameras }, changed) {
  const near = frame.radius / 500, far = frame.radius * 200;
  const perspective = new PerspectiveCamera(FIELD, 1, near, far);
  const flat = new OrthographicCamera(-1, 1, 1, -1, -far, far);
  const controls = new OrbitControls(perspective, canvas);
  const front = frontOf(cameras, frame);
  const calm = matchMedia("(prefers-reduced-motion: reduce)");
  let camera = perspective, aspect = 1, half = 1, flight = 0, reach = 1;

  controls.addEventListener("change", changed);
  const distance = () => camera.position.distanceTo(controls.target);

  function shape() {
    perspective.aspect = aspect;
    perspective.updateProjectionMatrix();
    Object.assign(flat, { left: -half * aspect, right: half * aspect, top: half, bottom: -half });
    flat.updateProjectionMatrix();
  }
  function resize(width, height) {
    aspect = width / height;
    shape();
  }
  function land(position, target) {
    camera.position.copy(position);
    controls.target.copy(target);
    controls.update();
    changed();
  }
  // To a place, at once or in a short flight.
  function fly(position, target, { field = FIELD, atOnce = false } = {}) {
    const from = { position: camera.position.clone(), target: controls.target.clone(), field: perspective.fov };
    const began = performance.now(), number = ++flight;
    const step = () => {
      if (number !== flight) return;
      const share = atOnce || calm.matches ? 1 : Math.min(1, (performance.now() - began) / FLIGHT_MS);
      const eased = share * share * (3 - 2 * share);
      perspective.fov = from.field + (field - from.field) * eased;
      shape();
      land(from.position.clone().lerp(position, eased), from.target.clone().lerp(target, eased));
      if (share < 1) requestAnimationFrame(step);
    };
    step();
  }
  // How far off nearly all points are within the picture.
  function fitting(from) {
    const right = new Vector3(0, 1, 0).cross(from).normalize();
    const up = from.clone().cross(right);
    const tall = halfTangent(FIELD);
    const point = new Vector3();
    const needed = Float32Array.from(frame.places.slice(0, 5000), (place) => {
      point.copy(place).sub(frame.middle);
      const aside = Math.max(Math.abs(point.dot(right)) / (tall * aspect), Math.abs(point.dot(up)) / tall);
      return aside + (camera === flat ? 0 : point.dot(from));
    }).sort();
    return Math.max(1.08 * quantile(needed, 0.99), 0.5 * frame.radius);
  }
  function lookAlong(from, atOnce) {
    reach = fitting(from);
    half = reach * halfTangent(FIELD);
    flat.zoom = 1;
    fly(from.clone().setLength(reach).add(frame.middle), frame.middle, { atOnce });
  }
  const sides = {
    home: () => around(front + 0.35, 1.32), front: () => around(front, QUARTER), back: () => around(front + 2 * QUARTER, QUARTER),
    left: () => around(front - QUARTER, QUARTER), right: () => around(front + QUARTER, QUARTER), top: () => around(front, 0),
  };
  // As the photograph was taken, turning about what lies in its middle.
  function fromCamera({ centre, corners }) {
    setFlat(false);
    const eye = new Vector3(...centre);
    const [topLeft, topRight, , bottomLeft] = corners.map((corner) => new Vector3(...corner));
    const middle = corners.reduce((sum, corner) => sum.addScaledVector(new Vector3(...corner), 0.25), new Vector3());
    const ahead = middle.sub(eye);
    const tall = topLeft.distanceTo(bottomLeft) / 2, wide = topLeft.distanceTo(topRight) / 2;
    const field = (360 / Math.PI) * Math.atan((1.04 * Math.max(tall, wide / aspect)) / ahead.length());
    const depth = Math.max(frame.middle.clone().sub(eye).dot(ahead.normalize()), 0.2 * frame.radius);
    fly(eye, eye.clone().addScaledVector(ahead, depth), { field: Math.min(120, Math.max(5, field)) });
  }
  function setFlat(wanted) {
    if ((camera === flat) === wanted) return;
    const offset = camera.position.clone().sub(controls.target);
    if (wanted) {
      half = offset.length() * halfTangent(perspective.fov);
      flat.zoom = 1;
    } else {
      offset.setLength((half / flat.zoom) / halfTangent(perspective.fov));
    }
    camera = wanted ? flat : perspective;
    controls.object = camera;
    shape();
    land(offset.add(controls.target), controls.target.clone());
  }
  function turn(left, up) {
    const round = new Spherical().setFromVector3(camera.position.clone().sub(controls.target));
    round.theta -= left;
    round.phi -= up;
    land(new Vector3().setFromSpherical(round.makeSafe()).add(controls.target), controls.target.clone());
  }
  function zoom(factor) {
    if (camera === flat) flat.zoom /= factor;
    shape();
    const offset = camera.position.clone().sub(controls.target).multiplyScalar(camera === flat ? 1 : factor);
    land(offset.add(controls.target), controls.target.clone());
  }
  return {
    canvas, controls, front, planes: { near, far }, resize, turn, zoom, fromCamera, setFlat, distance,
    get camera() { return camera; },
    get isFlat() { return camera === flat; },
    // How large a point is drawn: as at the distance of the first view.
    get pointReference() {
      return camera === flat ? flat.zoom : (reach * halfTangent(FIELD)) / halfTangent(perspective.fov);
    },
    look: (side, atOnce = false) => lookAlong(sides[side](), atOnce),
  };
}
