// Control points: a point is named, clicked in photographs, and comes out as lines of control/observations.csv.

import { createKeep } from "./keep.js";
import { createPane } from "./pane.js";
import { lineOf, meetingOf } from "./sights.js";

const quoted = (text) => (/["',;\t\r\n]|^\s|\s$/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
const KEPT = "This browser keeps them for this page.", LOST = "This browser keeps nothing for this page: copy them before you leave it.";
const told = ([x, y]) => `${x.toFixed(1)}, ${y.toFixed(1)}`;

// `addressOf(i)`: the picture of a camera; `hides(eye, place)`: whether the model stands between.
export function createControl({ part, cameras, lenses, addressOf, hides, radius, title }) {
  // Pixels hold for every model of these photographs.
  const keep = createKeep(`colmap-ihe control of ${title}, ${location.pathname}`, restore);
  const points = new Map(); // by name: `onModel`, a place or null, and `sights`, pixels by the number of the camera
  const choice = part("control-photograph"), name = part("control-name");
  const [x, y] = ["x", "y"].map((axis) => part(`control-${axis}`));
  const pane = createPane(part("control-picture"), part("control-magnify"), moved);
  const say = (text) => { part("control-said").textContent = text; };
  let elsewhere = [], latest = 0, shown = { image: null, address: "" };

  function pointOf(key = name.value.trim()) {
    if (!points.has(key)) points.set(key, { onModel: null, sights: new Map() });
    return points.get(key);
  }
  const raysOf = ({ sights }, without) => [...sights].filter(([i]) => i !== without).map(
    ([i, pixel]) => ({ eye: lenses[i].eye, ray: lenses[i].ray(pixel) }),
  );
  // Where the point is, by all photographs but one, else by the model.
  const placeOf = (point, without) => meetingOf(raysOf(point, without)) ?? point.onModel;

  function guidesOf(index) {
    const point = pointOf(), place = placeOf(point, index), rays = raysOf(point, index);
    return {
      predicted: place && lenses[index].pixel(place), sought: Boolean(place),
      lines: place ? [] : rays.flatMap((ray) => lineOf(lenses[index], ray, radius)),
    };
  }
  function inWords(index, { predicted, lines, sought }) {
    const set = pointOf().sights.get(index);
    const away = set && predicted ? `, ${Math.hypot(set[0] - predicted[0], set[1] - predicted[1]).toFixed(1)} px from where the others see it` : "";
    if (set) return `Set at ${told(set)}${away}.`;
    if (predicted) return `Expected at ${told(predicted)}. Click where it is.`;
    if (sought) return "This photograph does not show it.";
    return lines.length ? "It is on the line. Click where it is." : "Click where it is.";
  }
  async function show() {
    const number = ++latest, index = Number(choice.value);
    part("control-pane").hidden = choice.value === "" || !addressOf(index);
    if (choice.value === "") return;
    if (!addressOf(index)) return say("The page holds no picture of this photograph.");
    if (addressOf(index) !== shown.address) {
      const image = new Image(), address = addressOf(index);
      image.src = address;
      await image.decode();
      if (number !== latest) return; // another was chosen meanwhile
      shown = { image, address };
    } // else at once: what is typed next is not written over
    const { size } = lenses[index], guides = guidesOf(index);
    const at = pointOf().sights.get(index) ?? guides.predicted ?? size.map((v) => v / 2);
    pane.show({ image: shown.image, size, ...guides }, at);
    fields(at);
    const coarse = size[0] / shown.image.naturalWidth;
    say(`${inWords(index, guides)}${coarse > 1.05 ? ` A pixel of this picture is ${coarse.toFixed(1)} of the photograph.` : ""}`);
  }
  function fields(pixel) {
    x.value = pixel[0].toFixed(1);
    y.value = pixel[1].toFixed(1);
  }
  function moved(pixel, chosen) {
    fields(pixel);
    if (chosen) set(pixel);
  }
  function set(pixel) {
    if (!name.value.trim()) {
      latest++; // what a change of the name began is not to speak after this
      name.focus();
      return say("Give the point its name first.");
    }
    pointOf().sights.set(Number(choice.value), pixel);
    store();
    list();
    return show();
  }
  // Those of photographs that this page has not stay too: another page of the project may have them.
  function store() {
    const here = [...points].flatMap(([key, { sights }]) => [...sights].map(([i, pixel]) => [key, cameras[i].name, ...pixel]));
    const rows = [...elsewhere, ...here];
    part("control-kept").textContent = keep.write(rows.length ? rows : null) ? KEPT : LOST;
  }
  function restore(rows) {
    const number = new Map(cameras.map((camera, i) => [camera.name, i]));
    for (const { sights } of points.values()) sights.clear();
    elsewhere = [];
    for (const row of rows ?? []) {
      const [key, photograph, ...pixel] = row;
      if (!number.has(photograph)) elsewhere.push(row);
      else pointOf(key).sights.set(number.get(photograph), pixel);
    }
    list();
  }
  function list() {
    const rows = [...points].flatMap(([key, { sights }]) => [...sights].map(([index, pixel]) => ({ key, index, pixel })));
    part("control-done").hidden = rows.length === 0;
    const line = ({ key, index, pixel }) => [quoted(cameras[index].name), quoted(key), ...pixel.map((v) => v.toFixed(2))].join(",");
    document.getElementById("control-lines").textContent = rows.map(line).join("\n");
  }
  function remove() {
    pointOf().sights.delete(Number(choice.value));
    store();
    list();
    show();
  }
  // The next photograph in which the point is not set, and likely to be seen.
  function next() {
    const point = pointOf(), place = placeOf(point, -1), from = choice.value === "" ? -1 : Number(choice.value);
    if (!place) return say("Pick the point on the model first, or click it in two photographs.");
    const turn = cameras.map((_, i) => (from + 1 + i) % cameras.length);
    const found = turn.find((i) => !point.sights.has(i) && addressOf(i) && lenses[i].pixel(place) && !hides(lenses[i].eye, place));
    if (found === undefined) return say("No other photograph shows it.");
    choice.value = String(found);
    return show();
  }
  cameras.forEach((camera, i) => choice.add(new Option(camera.name, String(i))));
  choice.addEventListener("change", show);
  name.addEventListener("change", show);
  for (const field of [x, y]) {
    field.addEventListener("change", () => { if (x.value && y.value) pane.move([Number(x.value), Number(y.value)], false); });
  }
  part("control-set").addEventListener("click", () => set(pane.cross));
  part("control-remove").addEventListener("click", remove);
  part("control-next").addEventListener("click", next);
  restore(keep.read());
  store();
  if (points.size) part("control-done").closest("details").open = true;
  return {
    // The point lies at a place of the model, as picked there.
    pick(place) {
      pointOf().onModel = place;
      say("");
      next();
    },
  };
}
