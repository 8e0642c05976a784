// When to draw: nothing while nothing changes, less of the model while it turns, all of it when it stands still.

const FRAME_MS = 32; // aimed at while moving
const LEAST = 0.04; // of the effort that all of the model takes
const REST_MS = 180; // without movement, after which all is drawn

// `paint(effort)` draws, with an effort from 0 to 1, and tells what it drew.
export function createLoop(canvas, paint) {
  let asked = false, moving = false, going = false, resting = 0, last = 0, pace = FRAME_MS, effort = 0.3;

  function draw(now) {
    asked = false;
    const took = now - last;
    last = now;
    if (moving && going) {
      pace = 0.7 * pace + 0.3 * took;
      effort = Math.min(1, Math.max(LEAST, effort * Math.min(1.1, Math.max(0.6, FRAME_MS / pace))));
    }
    const drawn = paint(moving ? effort : 1);
    going = moving;
    if (moving) ask(); // the next frame at once, so that the time between two is what drawing takes
    canvas.dispatchEvent(new CustomEvent("drawn", { detail: { ...drawn, whole: !moving } }));
  }
  function ask() {
    if (asked) return;
    asked = true;
    requestAnimationFrame(draw);
  }
  function moved() {
    moving = true;
    clearTimeout(resting);
    resting = setTimeout(() => { moving = false; ask(); }, REST_MS);
    ask();
  }
  return { ask, moved };
}
