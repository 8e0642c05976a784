// The section box: six planes about the model, turned to its front, each moved by a slider.

import { Box3, Box3Helper, Group, Matrix3, Matrix4, Vector3 } from "three";
import { quantile } from "./cloud.js";
import { setCutting } from "./shading.js";

const STEPS = 1000;
const SIDES = ["left", "right", "bottom", "top", "back", "front"]; // low and high of x, y, z

export function sectionUniforms() {
  return {
    sectionTurn: { value: new Matrix3() },
    sectionLow: { value: new Vector3().setScalar(-1e30) }, sectionHigh: { value: new Vector3().setScalar(1e30) },
  };
}

// Cuts `objects`, whose materials hold the `uniforms`.
export function createSection(uniforms, objects, { cloud, front, part, scene, ask }) {
  const turn = new Matrix4().makeRotationY(-front);
  uniforms.sectionTurn.value.setFromMatrix4(turn);
  const [low, high] = boundsOf(cloud, turn);
  const box = new Box3();
  const holder = new Group();
  holder.rotation.y = front;
  holder.visible = false;
  holder.add(new Box3Helper(box, 0x2e6eb2));
  scene.add(holder);
  const on = part("section");
  const sliders = SIDES.map((side) => part(`cut-${side}`));

  function show() {
    const cuts = on.checked;
    for (let axis = 0; axis < 3; axis++) {
      const [from, to] = [0, 1].map((end) => Number(sliders[2 * axis + end].value));
      const extent = high.getComponent(axis) - low.getComponent(axis);
      const at = (step) => low.getComponent(axis) + (extent * step) / STEPS;
      box.min.setComponent(axis, at(Math.min(from, to)));
      box.max.setComponent(axis, at(Math.max(from, to)));
      uniforms.sectionLow.value.setComponent(axis, cuts && Math.min(from, to) > 0 ? box.min.getComponent(axis) : -1e30);
      uniforms.sectionHigh.value.setComponent(axis, cuts && Math.max(from, to) < STEPS ? box.max.getComponent(axis) : 1e30);
    }
    holder.visible = cuts;
    for (const object of objects) setCutting(object, cuts);
    ask();
  }
  function reset() {
    on.checked = false;
    sliders.forEach((slider, i) => { slider.value = i % 2 ? STEPS : 0; });
    show();
  }
  const inside = new Vector3();
  // Whether a place is drawn.
  function keeps(place) {
    if (!on.checked) return true;
    inside.copy(place).applyMatrix3(uniforms.sectionTurn.value);
    return [0, 1, 2].every((axis) => inside.getComponent(axis) >= uniforms.sectionLow.value.getComponent(axis)
      && inside.getComponent(axis) <= uniforms.sectionHigh.value.getComponent(axis));
  }
  on.addEventListener("change", () => {
    if (on.checked) sliders[0].closest("details").open = true;
    show();
  });
  for (const slider of sliders) slider.addEventListener("input", () => { on.checked = true; show(); });
  part("section-reset").addEventListener("click", reset);
  return { keeps };
}

// The lowest and highest places of the cloud in the turned frame, without the few that lie far out.
function boundsOf(cloud, turn) {
  const some = Math.min(cloud.count, 20000);
  const places = Array.from({ length: some }, (_, i) => new Vector3().fromArray(cloud.positions, 3 * i).applyMatrix4(turn));
  const low = new Vector3(), high = new Vector3();
  for (let axis = 0; axis < 3; axis++) {
    const sorted = Float32Array.from(places, (place) => place.getComponent(axis)).sort();
    const [from, to] = [quantile(sorted, 0.002), quantile(sorted, 0.998)];
    const margin = 0.03 * (to - from) || 1e-6;
    low.setComponent(axis, from - margin);
    high.setComponent(axis, to + margin);
  }
  return [low, high];
}
