// The cameras: frusta with their photographs on them, and one photograph over the model as it was taken.

import {
  BufferAttribute, BufferGeometry, CanvasTexture, DoubleSide, Group, LineBasicMaterial, LineSegments, Mesh, MeshBasicMaterial,
  Texture, Vector3,
} from "three";

const CELL = 128; // pixels of a photograph on its frustum

function frusta(cameras) {
  const ends = cameras.flatMap(({ centre, corners }) => corners.flatMap(
    (corner, i) => [...centre, ...corner, ...corner, ...corners[(i + 1) % 4]],
  ));
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(ends), 3));
  const drawn = new LineSegments(geometry, new LineBasicMaterial({ color: 0xb4552d }));
  drawn.frustumCulled = false;
  return drawn;
}

// A rectangle for each camera, at the corners of its picture; `uvOf(i)`: left, top, right, bottom, top 1.
function sheets(cameras, uvOf) {
  const geometry = new BufferGeometry();
  const uv = cameras.flatMap((_, i) => {
    const [left, top, right, bottom] = uvOf(i);
    return [left, top, right, top, right, bottom, left, bottom];
  });
  const corners = new Float32Array(cameras.flatMap((camera) => camera.corners.flat()));
  geometry.setAttribute("position", new BufferAttribute(corners, 3));
  geometry.setAttribute("uv", new BufferAttribute(new Float32Array(uv), 2));
  geometry.setIndex(cameras.flatMap((_, i) => [0, 3, 1, 1, 3, 2].map((k) => 4 * i + k)));
  return geometry;
}

// The picture of a camera as a lattice, each place of it on its ray: as straight as the model, whatever the lens does.
// `grid`: rows of places, in steps of the edges from the top left corner to the right and down.
function latticeOf({ corners, box }, grid) {
  const [topLeft, topRight, , bottomLeft] = corners.map((corner) => new Vector3(...corner));
  const right = topRight.sub(topLeft), down = bottomLeft.sub(topLeft);
  const size = grid.length, places = [], uv = [], index = [];
  for (let row = 0; row < size; row++) {
    for (let column = 0; column < size; column++) {
      const [along, below] = [grid[row][2 * column], grid[row][2 * column + 1]];
      places.push(...topLeft.clone().addScaledVector(right, along).addScaledVector(down, below).toArray());
      uv.push(box[0] + ((box[2] - box[0]) * column) / (size - 1), 1 - box[1] - ((box[3] - box[1]) * row) / (size - 1));
      const at = row * size + column;
      if (row < size - 1 && column < size - 1) index.push(at, at + size, at + 1, at + 1, at + size, at + size + 1);
    }
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(places), 3));
  geometry.setAttribute("uv", new BufferAttribute(new Float32Array(uv), 2));
  geometry.setIndex(index);
  return geometry;
}

// The pictures of the page by the names of their photographs.
function thumbnails() {
  const images = document.querySelectorAll("img[data-photograph]");
  return new Map([...images].map((image) => [image.dataset.photograph, image]));
}

// All thumbnails on one canvas, each filling a square cell.
async function mosaic(cameras, images) {
  const across = Math.max(1, Math.ceil(Math.sqrt(cameras.length)));
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = across * CELL;
  const pen = canvas.getContext("2d");
  pen.fillStyle = "#c9c4ba"; // where there is no picture
  pen.fillRect(0, 0, canvas.width, canvas.height);
  await Promise.all(cameras.map(async ({ name, box }, i) => {
    const image = images.get(name);
    if (!image) return;
    await image.decode();
    const { naturalWidth: w, naturalHeight: h } = image;
    const [left, top, right, bottom] = box;
    pen.drawImage(image, left * w, top * h, (right - left) * w, (bottom - top) * h,
      (i % across) * CELL, Math.floor(i / across) * CELL, CELL, CELL);
  }));
  return canvas;
}

export function createPhotographs({ cameras, grids }, ask) {
  const group = new Group();
  const images = thumbnails();
  group.add(frusta(cameras));
  let pictures = null, over = null, latest = 0;

  const addressOf = (index) => cameras[index].picture ?? images.get(cameras[index].name)?.src;

  async function fill() {
    const across = Math.max(1, Math.ceil(Math.sqrt(cameras.length)));
    const map = new CanvasTexture(await mosaic(cameras, images));
    const cell = (i) => [(i % across) / across, 1 - Math.floor(i / across) / across];
    const geometry = sheets(cameras, (i) => [cell(i)[0], cell(i)[1], cell(i)[0] + 1 / across, cell(i)[1] - 1 / across]);
    pictures = new Mesh(geometry, new MeshBasicMaterial({ map, side: DoubleSide }));
    pictures.frustumCulled = false;
    group.add(pictures);
    ask();
  }
  // The camera whose picture the ray meets first, and how far off; null where it meets none.
  function under(ray) {
    if (!pictures || !group.visible) return null;
    const hit = ray.intersectObject(pictures)[0];
    return hit ? { index: Math.floor(hit.faceIndex / 2), distance: hit.distance } : null;
  }
  function hide(scene) {
    latest++;
    if (!over) return;
    scene.remove(over);
    over.material.map.dispose();
    over = null;
    ask();
  }
  // Lays the photograph over what is drawn of the model; returns its sheet, null if there is no picture, or if another
  // was chosen meanwhile.
  async function show(index, scene, opacity) {
    hide(scene);
    const number = latest;
    const camera = cameras[index];
    const address = addressOf(index);
    if (!address) return null;
    const image = new Image();
    image.src = address;
    await image.decode();
    if (number !== latest) return null;
    const map = new Texture(image);
    map.needsUpdate = true;
    const material = new MeshBasicMaterial({ map, side: DoubleSide, transparent: true, opacity, depthTest: false, depthWrite: false });
    over = new Mesh(latticeOf(camera, grids[camera.grid]), material);
    over.frustumCulled = false;
    over.renderOrder = 2;
    scene.add(over);
    ask();
    return over;
  }
  function fade(opacity) {
    if (!over) return;
    over.material.opacity = opacity;
    ask();
  }
  return { group, addressOf, fill, under, show, hide, fade, get open() { return Boolean(over); } };
}
