// Lengths, areas and places in words. `scale`: metres a unit of the model, null where it is not known.

export function lengthInWords(units, scale) {
  if (!scale) return `${units.toPrecision(4)} model units`;
  const metres = units * scale;
  return metres < 0.1 ? `${(1000 * metres).toPrecision(3)} mm` : `${metres.toPrecision(4)} m`;
}

export function areaInWords(units, scale) {
  return scale ? `${(units * scale * scale).toPrecision(4)} m²` : `${units.toPrecision(4)} square model units`;
}

export function placeInWords(coordinates, scale) {
  const digits = (v) => (Math.abs(v) < 1e-9 ? "0" : v.toFixed(Math.max(0, 3 - Math.max(0, Math.floor(Math.log10(Math.abs(v))) - 2))));
  return coordinates.map((v, i) => `${"XYZ"[i]} ${digits(v * (scale ?? 1))}`).join(", ");
}
