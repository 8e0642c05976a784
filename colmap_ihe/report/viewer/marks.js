// What is drawn over the model: picked points, the lines between them, and the numbers of notes.

import { BufferAttribute, BufferGeometry, LineBasicMaterial, LineSegments, Points, PointsMaterial, Vector3 } from "three";

const OVER = { color: 0xd81b60, depthTest: false };

function layer(scene, make) {
  const object = make(new BufferGeometry());
  object.frustumCulled = false;
  object.renderOrder = 3;
  scene.add(object);
  return object;
}

function place(object, points) {
  const flat = new Float32Array(points.flatMap((point) => point.toArray()));
  object.geometry.dispose();
  object.geometry = new BufferGeometry();
  object.geometry.setAttribute("position", new BufferAttribute(flat, 3));
  object.visible = points.length > 0;
}

export function createMarks(scene, canvas, ratio) {
  const dots = layer(scene, (g) => new Points(g, new PointsMaterial({ ...OVER, size: 9 * ratio, sizeAttenuation: false })));
  const lines = layer(scene, (g) => new LineSegments(g, new LineBasicMaterial(OVER)));
  const pins = [];

  // `paths`: lists of points, each joined by lines and closed if its third entry says so.
  function show(paths) {
    place(dots, paths.flatMap(({ points }) => points));
    place(lines, paths.flatMap(({ points, closed }) => points.flatMap((point, i) => {
      const next = points[i + 1] ?? (closed && points.length > 2 ? points[0] : null);
      return next ? [point, next] : [];
    })));
  }
  function pin(point, text) {
    const label = document.createElement("span");
    label.className = "pin";
    label.textContent = text;
    label.ariaHidden = "true";
    canvas.parentElement.append(label);
    pins.push({ point, label });
  }
  function unpin() {
    for (const { label } of pins.splice(0)) label.remove();
  }
  const at = new Vector3();
  function follow(camera) {
    for (const { point, label } of pins) {
      at.copy(point).project(camera);
      label.hidden = Math.abs(at.x) > 1 || Math.abs(at.y) > 1 || at.z > 1;
      label.style.left = `${50 + 50 * at.x}%`;
      label.style.top = `${50 - 50 * at.y}%`;
    }
  }
  show([]);
  return { show, pin, unpin, follow };
}
