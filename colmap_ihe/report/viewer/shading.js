// What surface and points share of their colours and of the section box.

export const RAMP = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]]; // heights, from the lowest

export function rampAt(ramp, share) {
  const at = (ramp.length - 1) * Math.min(1, Math.max(0, share));
  const step = Math.min(ramp.length - 2, Math.floor(at));
  return ramp[step].map((from, k) => from + (at - step) * (ramp[step + 1][k] - from));
}

// True of what lies outside the section box, which is turned about the vertical. A shader that may discard is slower, so
// it can do so only while the box cuts.
export const SECTION = `
#ifdef CUTTING
uniform mat3 sectionTurn;
uniform vec3 sectionLow, sectionHigh;
bool cut(vec3 place) {
  vec3 inside = sectionTurn * place;
  return any(lessThan(inside, sectionLow)) || any(greaterThan(inside, sectionHigh));
}
#else
bool cut(vec3 place) { return false; }
#endif`;

export function setCutting(object, cuts) {
  const { material } = object;
  if (("CUTTING" in material.defines) === cuts) return;
  if (cuts) material.defines.CUTTING = 1;
  else delete material.defines.CUTTING;
  material.needsUpdate = true;
}
