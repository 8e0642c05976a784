// Measuring and notes: a tool is chosen, places are picked, what comes of them is told and listed.

import { Vector3 } from "three";
import { areaOf, inModel, lengthOf } from "./geometry.js";
import { createKeep } from "./keep.js";
import { areaInWords, lengthInWords, placeInWords } from "./words.js";

const START = "click a place, or bring it to the cross with the keys and press Enter.";
const NAMES = { control: "Control point" };
const ENOUGH = { distance: 2, polyline: 2, area: 3, point: 1, note: 1, control: 1 };
const WHOLE = { distance: 2, point: 1, note: 1 }; // after so many points a measurement is done

export function createTools({ part, marks, data, scale, ask, canvas, title, control }) {
  const buttons = [...document.querySelectorAll("#viewer [data-tool]")];
  // With the frame of the model: a note on another model of the project would lie anywhere.
  const keep = createKeep(`colmap-ihe notes of ${title}, ${[data.middle, data.rotation].flat(2).join(" ")}`, restore);
  let done = [];
  let tool = "", points = [];

  const say = (text) => { part("reading").textContent = text; };

  function inWords({ kind, points: of }) {
    if (kind === "area") return `Area: ${areaInWords(areaOf(of), scale.value)}, around it ${lengthInWords(lengthOf([...of, of[0]]), scale.value)}`;
    if (kind === "distance" || kind === "polyline") {
      const rise = of.at(-1).y - of[0].y;
      return `${kind === "distance" ? "Distance" : "Polyline"}: ${lengthInWords(lengthOf(of), scale.value)}, height difference ${
        rise < 0 ? "−" : ""}${lengthInWords(Math.abs(rise), scale.value)}`;
    }
    return `Point: ${placeInWords(inModel(of[0], data), scale.value)}${scale.value ? " m" : " model units"}`;
  }
  const store = () => keep.write(done.length ? done : null);
  function restore(stored) {
    done = (stored ?? []).map((m) => ({ ...m, points: m.points.map(({ x, y, z }) => new Vector3(x, y, z)) }));
    list();
  }
  function list() {
    part("measured").replaceChildren(...done.filter((m) => m.kind !== "note").map((m) => {
      const item = document.createElement("li");
      item.textContent = inWords(m);
      return item;
    }));
    marks.unpin();
    part("notes").replaceChildren(...done.filter((m) => m.kind === "note").map(noteItem));
    part("export").hidden = done.length === 0;
    marks.show([...done, { kind: tool, points }].map((m) => ({ points: m.points, closed: m.kind === "area" })));
    part("known").hidden = scale.metric || !lastDistance();
    part("forget").hidden = scale.metric || !scale.value;
    ask();
  }
  function noteItem(note, i) {
    marks.pin(note.points[0], String(i + 1));
    const item = document.createElement("li"), text = document.createElement("textarea"), remove = document.createElement("button");
    text.value = note.text;
    text.rows = 2;
    text.ariaLabel = `Text of note ${i + 1}`;
    text.addEventListener("input", () => { note.text = text.value; store(); });
    remove.type = "button";
    remove.textContent = "Remove";
    remove.ariaLabel = `Remove note ${i + 1}`;
    remove.addEventListener("click", () => { done.splice(done.indexOf(note), 1); store(); list(); });
    item.append(text, remove);
    return item;
  }
  const lastDistance = () => done.findLast((m) => m.kind === "distance");

  function finish() {
    if (!tool) return say("Choose a tool first.");
    if (points.length < ENOUGH[tool]) return say(`A ${tool} needs ${ENOUGH[tool]} places, ${points.length} ${points.length === 1 ? "is" : "are"} picked.`);
    const measurement = { kind: tool, points, text: "" };
    done.push(measurement);
    store();
    part("measured").closest("details").open = true;
    points = [];
    list();
    if (measurement.kind !== "note") return say(inWords(measurement));
    part("notes").lastElementChild.querySelector("textarea").focus();
    return say("Note set. Write its text below.");
  }
  function pick(point) {
    if (!point) return say("Nothing there. Pick again.");
    if (tool === "control") {
      choose("");
      return control.pick(point);
    }
    points.push(point);
    if (points.length === WHOLE[tool]) return finish();
    list();
    const more = tool === "distance" ? "Pick the second." : points.length >= ENOUGH[tool] ? `${inWords({ kind: tool, points })}. Pick more, or Finish.` : "Pick the next.";
    return say(`${points.length} picked. ${more}`);
  }
  function choose(chosen) {
    tool = tool === chosen ? "" : chosen;
    points = [];
    for (const button of buttons) button.setAttribute("aria-pressed", String(button.dataset.tool === tool));
    document.getElementById("viewer").classList.toggle("measuring", Boolean(tool));
    list();
    say(tool ? `${NAMES[tool] ?? tool[0].toUpperCase() + tool.slice(1)}: ${START}` : "");
    if (tool) canvas.focus({ preventScroll: true });
  }
  function undo() {
    if (!points.pop()) done.pop();
    store();
    list();
    say(points.length ? `${points.length} picked.` : "");
  }
  function known() {
    const metres = Number(part("known-length").value.replace(",", "."));
    if (!(metres > 0)) return say("Expected a length in metres, as 1.25.");
    scale.set(metres, lengthOf(lastDistance().points));
    list();
    part("known-how").hidden = false;
    part("known-line").textContent = `A,B,${metres}`;
    return say(`${inWords(lastDistance())}. The address of this page keeps the scale.`);
  }
  function save() {
    const one = ({ kind, points: of, text }) => ({ kind, points: of.map((point) => inModel(point, data)), ...(kind === "note" ? { text } : { in_words: inWords({ kind, points: of }) }) });
    const content = { project: title, metres_per_unit: scale.value, frame: "the model's own, as in mesh.ply", items: done.map(one) };
    download(new Blob([JSON.stringify(content, null, 2)], { type: "application/json" }), "notes.json");
  }
  for (const button of buttons) button.addEventListener("click", () => choose(button.dataset.tool));
  part("finish").addEventListener("click", finish);
  part("undo").addEventListener("click", undo);
  part("known-set").addEventListener("click", known);
  part("forget").addEventListener("click", () => { scale.forget(); list(); });
  part("export").addEventListener("click", save);
  restore(keep.read());
  if (done.length) part("measured").closest("details").open = true;
  return { pick, stop: () => { if (tool) choose(tool); }, get active() { return Boolean(tool); } };
}

export function download(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}
